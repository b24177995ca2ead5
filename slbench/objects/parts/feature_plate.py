"""A plate with two bores, a pin, a cone and a ball: what features on a part are tried on.

The features that a coordinate measuring machine is asked for, on one small part whose dimensions
are exact.  Round walls are polygons of equal area, the ball encloses the certified sphere's volume.

Object frame: x along the plate, y across it, z up; the origin in the middle of its top face, which
is the reference face.
"""

import math

import manifold3d
import numpy as np
import trimesh.nsphere

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Length
from slbench.objects.artefact import REFERENCE, Artefact, Mesh, PlaneFeature
from slbench.objects.mesh.booleans import cylinder, to_mesh, to_solid
from slbench.objects.mesh.circles import FormError, circle_segments, circumradius, measure_circle
from slbench.objects.mesh.solids import prism
from slbench.objects.registry import ArtefactKind
from slbench.objects.shapes.sphere import SphereParameters, build_sphere

#: Columns of the layout, as shares of the plate's length: bores, reference, pin, cone and ball.
_BORES, _PIN, _RIGHT, _ROW = -0.32, 0.12, 0.34, 0.25
#: How far the cone goes on into the plate, as a share of its thickness.
_INSIDE = 0.1


class FeaturePlateParameters(Parameters):
    """Size of the plate and its features.

    Parameters
    ----------
    length_mm, width_mm, thickness_mm : float
        The plate.
    bore_diameter_mm, bore_depth_mm : float
        Two blind bores, side by side across the plate.
    pin_diameter_mm, pin_height_mm : float
        A pin in the middle.
    cone_base_mm, cone_top_mm, cone_height_mm : float
        Diameters and height of a frustum.
    ball_diameter_mm, ball_height_mm : float
        A ball, and its highest point above the plate: less than its diameter, so that it is sunk.
    max_form_error_um : float
        Largest distance of round walls from true ones.
    """

    length_mm: Length
    width_mm: Length
    thickness_mm: Length
    bore_diameter_mm: Length
    bore_depth_mm: Length
    pin_diameter_mm: Length
    pin_height_mm: Length
    cone_base_mm: Length
    cone_top_mm: Length
    cone_height_mm: Length
    ball_diameter_mm: Length
    ball_height_mm: Length
    max_form_error_um: FormError = 0.5


def build_feature_plate(parameters: FeaturePlateParameters, name: str, where: str) -> Artefact:
    """Build the plate.

    Parameters
    ----------
    parameters : FeaturePlateParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        Of the parts ``plate``, ``bores``, ``pin``, ``cone`` and ``ball``; its one feature is the
        ``reference``, a strip of the top face.  A file declares the others.

    Raises
    ------
    InputError
        If a feature meets another, the edge or the bottom.
    """
    p = parameters
    _check(p, where)
    x, y, half = p.length_mm / 2, p.width_mm / 2, p.thickness_mm / 2
    profile = [(-x, -p.thickness_mm), (x, -p.thickness_mm), (x, 0.0), (-x, 0.0)]
    plate = to_solid(prism(profile, p.width_mm))
    form = p.max_form_error_um
    bore = cylinder(p.bore_diameter_mm / 2, -p.bore_depth_mm, half, form)
    pin = cylinder(p.pin_diameter_mm / 2, -half, p.pin_height_mm, form)
    cone = _frustum(p)
    ball_form = SphereParameters(radius_mm=p.ball_diameter_mm / 2, max_form_error_um=form)
    ball = to_solid(build_sphere(ball_form, name, where).mesh)
    solid = plate
    for sign in (-1.0, 1.0):
        solid -= bore.translate([_BORES * p.length_mm, sign * _ROW * p.width_mm, 0.0])
    solid += pin.translate([_PIN * p.length_mm, 0.0, 0.0])
    solid += cone.translate([_RIGHT * p.length_mm, -_ROW * p.width_mm, 0.0])
    lift = p.ball_height_mm - p.ball_diameter_mm / 2
    solid += ball.translate([_RIGHT * p.length_mm, _ROW * p.width_mm, lift])
    owners = {
        plate.original_id(): "plate",
        bore.original_id(): "bores",
        pin.original_id(): "pin",
        cone.original_id(): "cone",
        ball.original_id(): "ball",
    }
    mesh, parts = to_mesh(solid, owners)
    low = _BORES * p.length_mm + p.bore_diameter_mm / 2
    high = _PIN * p.length_mm - p.pin_diameter_mm / 2
    margin = 0.15 * (high - low)
    strip = PlaneFeature(REFERENCE, 0.0, 0.0, (low + margin, high - margin), (-0.9 * y, 0.9 * y))
    return Artefact(
        name=name,
        kind="feature_plate",
        parameters=p.model_dump(),
        mesh=mesh,
        certified={
            "bore_1_diameter_mm": p.bore_diameter_mm,
            "bore_2_diameter_mm": p.bore_diameter_mm,
            "bore_distance_mm": 2.0 * _ROW * p.width_mm,
            "bore_depth_mm": p.bore_depth_mm,
            "pin_diameter_mm": p.pin_diameter_mm,
            "pin_height_mm": p.pin_height_mm,
            "cone_angle_deg": 2.0 * _half_angle(p),
            "ball_diameter_mm": p.ball_diameter_mm,
            "ball_height_mm": p.ball_height_mm,
            "reference_flatness_um": 0.0,
        },
        features=(strip,),
        parts=parts,
    )


def _half_angle(p: FeaturePlateParameters) -> float:
    return math.degrees(math.atan2(p.cone_base_mm - p.cone_top_mm, 2.0 * p.cone_height_mm))


def _frustum(p: FeaturePlateParameters) -> manifold3d.Manifold:
    """Draw the cone on into the plate, so that no faces coincide."""
    segments = circle_segments(p.cone_base_mm / 2, p.max_form_error_um)
    inside = _INSIDE * p.thickness_mm
    slope = (p.cone_base_mm - p.cone_top_mm) / (2.0 * p.cone_height_mm)
    low = circumradius(p.cone_base_mm / 2 + slope * inside, segments)
    top = circumradius(p.cone_top_mm / 2, segments)
    body = manifold3d.Manifold.cylinder(p.cone_height_mm + inside, low, top, segments)
    return body.translate([0.0, 0.0, -inside]).as_original()


def _check(p: FeaturePlateParameters, where: str) -> None:
    inside = _INSIDE * p.thickness_mm
    widest = p.cone_base_mm + (p.cone_base_mm - p.cone_top_mm) * inside / p.cone_height_mm
    column = (0.5 - _RIGHT) * p.length_mm  # from the last column to the edge
    across = min(_ROW, 0.5 - _ROW) * p.width_mm  # from a row to the edge or the middle
    for key, value, limit in (
        ("bore_diameter_mm", p.bore_diameter_mm, 1.8 * min((0.5 + _BORES) * p.length_mm, across)),
        ("bore_depth_mm", p.bore_depth_mm, 0.9 * p.thickness_mm),
        ("pin_diameter_mm", p.pin_diameter_mm, 0.2 * p.length_mm),
        ("cone_top_mm", p.cone_top_mm, 0.9 * p.cone_base_mm),
        ("cone_base_mm", max(widest, p.cone_base_mm), 1.8 * min(column, across)),
        ("ball_diameter_mm", p.ball_diameter_mm, 1.8 * min(column, across)),
        ("ball_height_mm", p.ball_height_mm, 0.9 * p.ball_diameter_mm),
        ("ball_diameter_mm", p.ball_diameter_mm - p.ball_height_mm, 0.9 * p.thickness_mm),
    ):
        if value > limit:
            expected = f"a feature that is clear of others: at most {limit:.4g} mm"
            raise InputError(f"{where}.{key}", expected, f"{value:.4g} mm")


def measure_feature_plate(artefact: Artefact) -> dict[str, float]:
    """Measure the certified dimensions back from the mesh.

    Parameters
    ----------
    artefact : Artefact
        The plate.

    Returns
    -------
    dict of str to float
        Diameters from the areas that rims enclose, heights from their planes, the ball from the
        vertices on it.
    """
    mesh, parts = artefact.mesh, artefact.parts
    bores = _vertices(mesh, parts["bores"])
    rims = [
        measure_circle(_at(bores[np.sign(bores[:, 1]) == side], 0.0)[:, :2]) for side in (-1.0, 1.0)
    ]
    pin, cone, ball = (_vertices(mesh, parts[part]) for part in ("pin", "cone", "ball"))
    base = measure_circle(_at(cone, 0.0)[:, :2])[1]
    top = measure_circle(_at(cone, cone[:, 2].max())[:, :2])[1]
    slope = 0.5 * (base - top) / float(cone[:, 2].max())
    centre, radius, _ = trimesh.nsphere.fit_nsphere(ball[ball[:, 2] > 1e-9])
    # Corners stand out; the ball's own volume is that of the sphere between them and the facets.
    size = artefact.parameters["ball_diameter_mm"]
    form = SphereParameters(
        radius_mm=size / 2, max_form_error_um=artefact.parameters["max_form_error_um"]
    )
    whole = build_sphere(form, "ball", "").mesh
    corner = float(np.linalg.norm(whole.vertices, axis=1).mean())
    true = (whole.volume * 0.75 / math.pi) ** (1.0 / 3.0)
    diameter = 2.0 * radius * true / corner
    return {
        "bore_1_diameter_mm": rims[0][1],
        "bore_2_diameter_mm": rims[1][1],
        "bore_distance_mm": float(np.linalg.norm(rims[1][0] - rims[0][0])),
        "bore_depth_mm": -float(bores[:, 2].min()),
        "pin_diameter_mm": measure_circle(_at(pin, pin[:, 2].max())[:, :2])[1],
        "pin_height_mm": float(pin[:, 2].max()),
        "cone_angle_deg": 2.0 * math.degrees(math.atan(slope)),
        "ball_diameter_mm": diameter,
        "ball_height_mm": float(centre[2]) + diameter / 2,
    }


def _vertices(mesh: Mesh, faces: np.ndarray) -> np.ndarray:
    return np.asarray(mesh.vertices[np.unique(mesh.faces[faces])])


def _at(vertices: np.ndarray, height: float) -> np.ndarray:
    return np.asarray(vertices[np.abs(vertices[:, 2] - height) < 1e-9])


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(FeaturePlateParameters, build_feature_plate, measure_feature_plate)
