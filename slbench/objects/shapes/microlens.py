"""A micro lens: a spherical cap on a square plate.

The cap is a polar mesh of near-equilateral facets, its base circle at z = 0.  Facets lie
inside the sphere through their corners, which is therefore a little larger than the certified
one: such that the mean distance of the facets from the centre, weighted by area, is the
certified radius, as a least-squares sphere through points all over the cap has it.  Both have
the same centre; the larger one passes through the base circle.

Parts: ``lens`` (the cap) and ``plate``.  Object frame: origin at the middle of the base
circle; z = 0 on the plate's top face.
"""

import math

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Length, Positive
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature, SphereFeature
from slbench.objects.registry import ArtefactKind
from slbench.objects.targets.tiles import ring_tile, tiled_plate

_FEWEST_RINGS = 4
#: 735,000 facets.
_MOST_RINGS = 350
#: Share of the strip beside the lens that is left out of the reference on either side.
_MARGIN = 0.15


class MicroLensParameters(Parameters):
    """Size of a micro lens and fineness of its mesh.

    Parameters
    ----------
    radius_of_curvature_mm : float
        Radius of the sphere.
    aperture_mm : float
        Diameter of the base circle; less than 1.9 radii of curvature.
    plate_mm : float
        Side of the plate; at least 1.1 apertures.
    thickness_mm : float
        Extent below z = 0.
    max_form_error_um : float
        Largest distance of the cap from the certified sphere.
    """

    radius_of_curvature_mm: Length = 0.5
    aperture_mm: Length = 0.4
    plate_mm: Length = 0.8
    thickness_mm: Length = 0.2
    max_form_error_um: Positive = 0.005


def build_micro_lens(parameters: MicroLensParameters, name: str, where: str) -> Artefact:
    """Build a micro lens.

    Parameters
    ----------
    parameters : MicroLensParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features ``reference``, a strip of the plate at -y, and ``sphere``;
        certified are the sphere's diameter and the aperture, the size along x and y, and
        the flatness of the plate.

    Raises
    ------
    InputError
        If the cap is nearly a hemisphere or more, does not fit the plate, or no mesh of
        reasonable size keeps the form error.
    """
    return cap_on_plate(parameters, "micro_lens", "lens", 1.0, name, where)


def cap_on_plate(
    parameters: MicroLensParameters, kind: str, part: str, side: float, name: str, where: str
) -> Artefact:
    """Build a cap on a plate; of the kind and with the name of the cap's part that are given.

    It stands on the plate (`side` 1) or is sunk into it (-1).
    """
    radius, aperture = parameters.radius_of_curvature_mm, parameters.aperture_mm
    if aperture > 1.9 * radius:
        raise InputError(f"{where}.aperture_mm", f"at most {1.9 * radius:g}", aperture)
    if parameters.plate_mm < 1.1 * aperture:
        raise InputError(f"{where}.plate_mm", f"at least {1.1 * aperture:g}", parameters.plate_mm)
    allowed = 1e-3 * parameters.max_form_error_um
    rings, error = _FEWEST_RINGS, math.inf
    while error > allowed:
        points, faces, centre, error = _balanced_cap(rings, radius, aperture)
        # The error goes down with the square of the rings; an even number has the points on
        # the axes that the plate's tile asks for.
        needed = max(rings * math.sqrt(error / allowed), rings + 1)
        if error > allowed and needed > _MOST_RINGS:
            least = 1e3 * error * (rings / _MOST_RINGS) ** 2
            expected = f"at least {1.1 * least:.3g}"
            raise InputError(f"{where}.max_form_error_um", expected, 1e3 * allowed)
        rings = 2 * math.ceil(0.5 * needed)
    base = int(np.count_nonzero(points[:, 2] == 0.0))
    points, centre = points * [1.0, 1.0, side], side * centre
    if side < 0.0 and parameters.thickness_mm < 1e-3 - points[:, 2].min():
        expected = f"at least {1e-3 - points[:, 2].min():.6g}, more than the depth"
        raise InputError(f"{where}.thickness_mm", expected, parameters.thickness_mm)
    half = 0.5 * parameters.plate_mm
    tile = ring_tile(points[:base], points[base:], faces)
    plate = tiled_plate([-half, half], [-half, half], [[0]], [tile], parameters.thickness_mm)
    lens = (plate.face_numbers >= 0) & (plate.face_numbers < len(faces))
    strip = half - 0.5 * aperture
    margin = _MARGIN * strip
    along = (-half + margin, half - margin)
    reference = PlaneFeature(REFERENCE, 0.0, 0.0, along, (-half + margin, -half + strip - margin))
    return Artefact(
        name=name,
        kind=kind,
        parameters=parameters.model_dump(),
        mesh=plate.mesh,
        certified={
            "size_x_mm": parameters.plate_mm,
            "size_y_mm": parameters.plate_mm,
            "reference_flatness_um": 0.0,
            "sphere_diameter_mm": 2.0 * radius,
            "aperture_mm": aperture,
        },
        features=(reference, SphereFeature("sphere", (0.0, 0.0, centre), radius)),
        parts={part: np.flatnonzero(lens), "plate": np.flatnonzero(~lens)},
    )


def measure_micro_lens(artefact: Artefact) -> dict[str, float]:
    """Measure the cap from the faces of the part ``lens``.

    Parameters
    ----------
    artefact : Artefact
        A micro lens.

    Returns
    -------
    dict of str to float
        ``sphere_diameter_mm``, twice the mean distance of the cap's facets from the centre,
        and ``aperture_mm``, twice that of its points at z = 0 from the axis.
    """
    return measure_cap(artefact, "lens")


def measure_cap(artefact: Artefact, part: str) -> dict[str, float]:
    """Measure the cap of :func:`cap_on_plate`."""
    (sphere,) = (f for f in artefact.features if isinstance(f, SphereFeature))
    corners = artefact.mesh.vertices[artefact.mesh.faces[artefact.parts[part]]]
    base = corners[corners[:, :, 2] == 0.0]
    return {
        "sphere_diameter_mm": 2.0 * _mean_radius(corners - sphere.centre_mm),
        "aperture_mm": 2.0 * float(np.hypot(base[:, 0], base[:, 1]).mean()),
    }


def _balanced_cap(
    rings: int, radius: float, aperture: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], float, float]:
    """Cap over z = 0 of the stated mean radius: points, faces, z of its centre, form error."""
    outer = radius
    for _ in range(4):  # the mean hardly depends on the opening: 1e-12 after two
        points, faces = _cap(rings, math.asin(0.5 * aperture / outer))
        outer = radius / _mean_radius(points[faces])
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    nearest = np.einsum("ij,ij->i", normals, a) / np.linalg.norm(normals, axis=1)
    error = max(outer - radius, radius - outer * float(nearest.min()))
    centre = -math.sqrt(outer**2 - (0.5 * aperture) ** 2)
    points = outer * points + [0.0, 0.0, centre]
    points[: 6 * rings, 2] = 0.0
    return points, faces, centre, error


def _cap(rings: int, opening: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Cap of the unit sphere about the origin: points, the base ring first, and faces."""
    sizes = np.array([6 * k for k in range(rings, 0, -1)] + [1])
    starts = np.concatenate([[0], np.cumsum(sizes)])
    points, faces = [], []
    for k, start, inner in zip(range(rings, 0, -1), starts, starts[1:], strict=False):
        angle = np.pi / 3.0 * np.arange(6 * k) / k
        polar = opening * k / rings
        x, y = math.sin(polar) * np.cos(angle), math.sin(polar) * np.sin(angle)
        points.append(np.stack([x, y, np.full_like(x, math.cos(polar))], axis=1))
        # In each of six sectors k facets with a side on this ring and k - 1 on the next.
        sector, i = (grid.ravel() for grid in np.mgrid[0:6, 0:k])
        outer_here, outer_next = sector * k + i, (sector * k + i + 1) % (6 * k)
        size = max(6 * (k - 1), 1)
        inner_here = (sector * (k - 1) + i) % size
        inner_next = (sector * (k - 1) + i + 1) % size
        faces.append(np.stack([start + outer_here, start + outer_next, inner + inner_here], 1))
        between = i < k - 1
        turned = np.stack([inner + inner_here, start + outer_next, inner + inner_next], axis=1)
        faces.append(turned[between])
    points.append(np.array([[0.0, 0.0, 1.0]]))
    return np.concatenate(points), np.concatenate(faces)


def _mean_radius(corners: NDArray[np.float64]) -> float:
    """Mean distance of facets, (m, 3, 3), from the origin, weighted by area."""
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    # The rule of edge midpoints integrates the quadratic sag of a facet exactly.
    middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
    return float(np.average(np.linalg.norm(middles, axis=2).mean(axis=1), weights=areas))


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(MicroLensParameters, build_micro_lens, measure_micro_lens)
