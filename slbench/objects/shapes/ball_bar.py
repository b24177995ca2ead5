"""A ball bar: two spheres of certified spacing, for sphere-spacing scores.

The probe of VDI/VDE 2634-2 and ISO 10360-13 for the error of sphere spacing: two balls of
known form on a stiff bar, the distance of their centres certified.  Here the balls stand on
stems on a bar that lies flat.  The mesh of each ball encloses the volume of the certified
sphere (:mod:`slbench.objects.shapes.sphere`), less the cap that its stem takes.

Object frame: the centres on the x axis, the origin half way between them; z up, the bar
below.  Its top face between the balls is the reference face.
"""

from typing import Annotated

import manifold3d
import numpy as np
import trimesh.nsphere
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature, SphereFeature
from slbench.objects.mesh.booleans import cylinder, to_mesh, to_solid
from slbench.objects.mesh.circles import FormError
from slbench.objects.mesh.solids import prism
from slbench.objects.registry import ArtefactKind
from slbench.objects.shapes.sphere import SphereParameters, build_sphere

#: Points within a fifth of the radius count as the sphere's; the bar must be further away.
_CLEAR = 0.25


class BallBarParameters(Parameters):
    """Size of a ball bar.

    Parameters
    ----------
    spacing_mm : float
        Certified distance of the centres.
    ball_diameter_mm : float
        Certified diameter of both balls.
    stem_diameter_mm : float
        Diameter of the stems.
    stem_length_mm : float
        Height of the balls' lowest points above the bar.
    bar_width_mm, bar_height_mm : float
        Cross-section of the bar, which ends flush with the balls.
    margin_fraction : float
        Distance of the reference's interior from the balls and edges, as a share of the
        bar's width.
    max_form_error_um : float
        Largest distance of the balls and stems from true spheres and cylinders.
    """

    spacing_mm: Length
    ball_diameter_mm: Length
    stem_diameter_mm: Length
    stem_length_mm: Length
    bar_width_mm: Length
    bar_height_mm: Length
    margin_fraction: Annotated[float, Interval(ge=0.0, le=0.45)] = 0.1
    max_form_error_um: FormError = 0.5


def build_ball_bar(parameters: BallBarParameters, name: str, where: str) -> Artefact:
    """Build a ball bar.

    Parameters
    ----------
    parameters : BallBarParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        Of the parts ``balls`` and ``bar`` (with the stems); features are ``ball_1``,
        ``ball_2`` and the ``reference``.  Certified are the spacing and both diameters.

    Raises
    ------
    InputError
        If the balls touch, the stems are as thick as the balls or the bar or too short to
        tell them from the balls, or no mesh of reasonable size keeps the form error.
    """
    p = parameters
    radius = p.ball_diameter_mm / 2
    margin = p.margin_fraction * p.bar_width_mm
    _check(p, margin, where)
    half = p.spacing_mm / 2
    top = -radius - p.stem_length_mm
    ball_parameters = SphereParameters(radius_mm=radius, max_form_error_um=p.max_form_error_um)
    ball = to_solid(build_sphere(ball_parameters, name, where).mesh)
    # Stems begin inside the bar and end inside the ball, so that no faces coincide.
    inside = 0.5 * p.bar_height_mm
    stem = cylinder(p.stem_diameter_mm / 2, top - inside, 0.0, p.max_form_error_um)
    end, bottom = half + radius, top - p.bar_height_mm
    profile = [(-end, bottom), (end, bottom), (end, top), (-end, top)]
    bar = to_solid(prism(profile, p.bar_width_mm))
    standing = [(stem + ball).translate([x, 0.0, 0.0]) for x in (-half, half)]
    solid = manifold3d.Manifold.batch_boolean([bar, *standing], manifold3d.OpType.Add)
    owners = {
        ball.original_id(): "balls",
        stem.original_id(): "bar",
        bar.original_id(): "bar",
    }
    mesh, parts = to_mesh(solid, owners)

    # Seen from above, the balls hide the bar beyond.
    reach = half - radius - margin
    side = p.bar_width_mm / 2 - margin
    return Artefact(
        name=name,
        kind="ball_bar",
        parameters=p.model_dump(),
        mesh=mesh,
        certified={
            "ball_spacing_mm": p.spacing_mm,
            "ball_1_diameter_mm": p.ball_diameter_mm,
            "ball_2_diameter_mm": p.ball_diameter_mm,
            "reference_flatness_um": 0.0,
        },
        features=(
            PlaneFeature(REFERENCE, 0.0, top, (-reach, reach), (-side, side)),
            SphereFeature("ball_1", (-half, 0.0, 0.0), radius),
            SphereFeature("ball_2", (half, 0.0, 0.0), radius),
        ),
        parts=parts,
    )


def measure_ball_bar(artefact: Artefact) -> dict[str, float]:
    """Measure the spacing of a ball bar back from its mesh.

    Parameters
    ----------
    artefact : Artefact
        The ball bar; its features say where the balls are.

    Returns
    -------
    dict of str to float
        ``ball_spacing_mm``, the distance of the centres of the spheres through the vertices
        of either ball's upper half.
    """
    first, second = (
        _centre(artefact.mesh.vertices, np.array(ball.centre_mm), ball.radius_mm)
        for ball in artefact.spheres
    )
    return {"ball_spacing_mm": float(np.linalg.norm(second - first))}


def _check(p: BallBarParameters, margin: float, where: str) -> None:
    if p.spacing_mm <= 1.4 * p.ball_diameter_mm:
        # At 1.2 diameters the points near one ball would take in the other's.
        expected = f"more than 1.4 x ball_diameter_mm = {1.4 * p.ball_diameter_mm:.6g}"
        raise InputError(f"{where}.spacing_mm", expected, p.spacing_mm)
    widest = min(0.7 * p.ball_diameter_mm, 0.9 * p.bar_width_mm)
    # A share of a scaled length may round above its limit, where both print the same.
    if p.stem_diameter_mm > widest * (1.0 + 1e-12):
        expected = f"at most {widest:.6g}: 0.7 of the ball's diameter, 0.9 of the bar's width"
        raise InputError(f"{where}.stem_diameter_mm", expected, p.stem_diameter_mm)
    shortest = _CLEAR * p.ball_diameter_mm / 2
    if p.stem_length_mm < shortest:
        expected = f"at least {shortest:.6g}, a quarter of the ball's radius"
        raise InputError(f"{where}.stem_length_mm", expected, p.stem_length_mm)
    gap = p.spacing_mm - p.ball_diameter_mm
    if gap <= 2.0 * margin:
        expected = f"less than {0.5 * gap / p.bar_width_mm:.4g}, half the gap over the bar's width"
        raise InputError(f"{where}.margin_fraction", expected, p.margin_fraction)


def _centre(
    vertices: NDArray[np.float64], near: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Centre of the sphere through the vertices about a place, by least squares."""
    local = vertices - near
    distance = np.linalg.norm(local, axis=1)
    # The lower half bears the stem's rim, whose vertices lie on facets and not on the sphere.
    points = local[(np.abs(distance / radius - 1.0) < 0.2) & (local[:, 2] > 0.0)]
    return near + trimesh.nsphere.fit_nsphere(points)[0]


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(BallBarParameters, build_ball_bar, measure_ball_bar)
