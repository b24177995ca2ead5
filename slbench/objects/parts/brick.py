"""A brick with an array of pins: equal steps at known places, with steep walls between them.

The thesis measures a LEGO part with an array of protruding pins (thesis fig. 14a).  The
default sizes are those that hobbyists measure on such bricks: pins of 4.8 mm at a pitch of
8.0 mm, 1.8 mm high on a body of 9.6 mm with a clearance of 0.1 mm to each neighbour.

Object frame: columns of pins along x and rows along y, the origin in the middle of the
body's top face, which is the reference face at z = 0; the pins stand on it and the solid
body lies below.
"""

import itertools
import math
from typing import Annotated

import manifold3d
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import REFERENCE, Artefact, Mesh, PlaneFeature
from slbench.objects.mesh.circles import FormError, circle, circle_segments, measure_circle
from slbench.objects.registry import ArtefactKind

Clearance = Annotated[float, Interval(ge=0.0, le=1e4)]


class BrickParameters(Parameters):
    """Size of a brick.

    Parameters
    ----------
    columns : int
        Pins along x.
    rows : int
        Pins along y; two at least, for the reference is the strip between two rows.
    pitch_mm : float
        Distance of neighbouring pins' axes.
    pin_diameter_mm, pin_height_mm : float
        Size of a pin.
    body_height_mm : float
        Height of the body without pins.
    clearance_mm : float
        By how much the body ends short of half a pitch beyond the outer pins.
    margin_fraction : float
        Distance of the interiors from edges, as a share of the pin's diameter.
    max_form_error_um : float
        Largest distance of a pin's wall from the true cylinder.
    """

    columns: Annotated[int, Interval(ge=1, le=32)]
    rows: Annotated[int, Interval(ge=2, le=32)]
    pitch_mm: Length = 8.0
    pin_diameter_mm: Length = 4.8
    pin_height_mm: Length = 1.8
    body_height_mm: Length = 9.6
    clearance_mm: Clearance = 0.1
    margin_fraction: Annotated[float, Interval(ge=0.0, le=0.4)] = 0.1
    max_form_error_um: FormError = 0.5


def build_brick(parameters: BrickParameters, name: str, where: str) -> Artefact:
    """Build a brick.

    Parameters
    ----------
    parameters : BrickParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features ``reference``, the strip between the two rows in the middle, and
        ``pin_ROW_COLUMN``, each pin's top, counted from 1 at the corner of lowest x and y.
        Certified are the pins' heights, diameter and pitch, and the size of the brick.

    Raises
    ------
    InputError
        If the pins leave no strip of the reference between them or overhang the body.
    """
    p = parameters
    # Corners of a pin's polygon stand out of its circle by up to the form error.
    margin = p.margin_fraction * p.pin_diameter_mm + 1e-3 * p.max_form_error_um
    widest = p.pitch_mm - 2.0 * p.clearance_mm - 2.0 * margin
    if p.pin_diameter_mm >= widest:
        expected = f"less than {widest:.6g}, for pins with margins at a pitch of {p.pitch_mm:g}"
        raise InputError(f"{where}.pin_diameter_mm", expected, p.pin_diameter_mm)
    if p.pin_diameter_mm <= 2.0 * margin:
        expected = (
            f"less than {1e3 * (0.5 - p.margin_fraction) * p.pin_diameter_mm:.3g} for pins of "
        )
        expected += f"{p.pin_diameter_mm:g} mm"
        raise InputError(f"{where}.max_form_error_um", expected, p.max_form_error_um)

    size = p.pitch_mm * np.array([p.columns, p.rows]) - 2.0 * p.clearance_mm
    x = p.pitch_mm * (np.arange(p.columns) - (p.columns - 1) / 2)
    y = p.pitch_mm * (np.arange(p.rows) - (p.rows - 1) / 2)
    centres = np.array([(cx, cy) for cy in y for cx in x])
    rim = circle(p.pin_diameter_mm / 2, circle_segments(p.pin_diameter_mm / 2, p.max_form_error_um))

    below = (p.rows - 1) // 2
    strip = 0.5 * (p.pitch_mm - p.pin_diameter_mm) - margin
    middle = 0.5 * (y[below] + y[below + 1])
    reach = size[0] / 2 - margin
    inner = (p.pin_diameter_mm / 2 - margin) / math.sqrt(2.0)
    faces = [
        PlaneFeature(REFERENCE, 0.0, 0.0, (-reach, reach), (middle - strip, middle + strip))
    ] + [
        PlaneFeature(
            f"pin_{row + 1}_{column + 1}",
            p.pin_height_mm,
            p.pin_height_mm,
            (x[column] - inner, x[column] + inner),
            (y[row] - inner, y[row] + inner),
        )
        for row, column in itertools.product(range(p.rows), range(p.columns))
    ]
    return Artefact(
        name=name,
        kind="brick",
        parameters=p.model_dump(),
        mesh=_mesh(size, p.body_height_mm, p.pin_height_mm, centres, rim),
        certified={
            "size_x_mm": float(size[0]),
            "size_y_mm": float(size[1]),
            "size_z_mm": p.body_height_mm + p.pin_height_mm,
            "reference_flatness_um": 0.0,
            "pin_diameter_mm": p.pin_diameter_mm,
            "pitch_mm": p.pitch_mm,
            **{f"{face.name}_height_mm": face.height_mm for face in faces[1:]},
        },
        features=tuple(faces),
    )


def measure_brick(artefact: Artefact) -> dict[str, float]:
    """Measure a brick's pins back from its mesh.

    Parameters
    ----------
    artefact : Artefact
        The brick; its features say where the pins are.

    Returns
    -------
    dict of str to float
        ``pin_diameter_mm``, the mean over all pins, each the diameter of the circle with
        the area of its rim; ``pitch_mm``, the mean distance of neighbouring rims' centroids.
    """
    mesh = artefact.mesh
    top = mesh.vertices[mesh.vertices[:, 2] == mesh.bounds[1, 2], :2]
    places = np.array([(np.mean(pin.x_mm), np.mean(pin.y_mm)) for pin in artefact.steps])
    _, nearest = cKDTree(places).query(top)
    rims = [measure_circle(top[nearest == i]) for i in range(len(places))]
    centres = np.array([centre for centre, _ in rims])
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)
    np.fill_diagonal(apart, np.inf)
    # Neighbours along a diagonal are 1.41 pitches away.
    return {
        "pin_diameter_mm": float(np.mean([diameter for _, diameter in rims])),
        "pitch_mm": float(apart[apart < 1.2 * apart.min()].mean()),
    }


def _mesh(
    size: NDArray[np.float64],
    body: float,
    pin: float,
    centres: NDArray[np.float64],
    rim: NDArray[np.float64],
) -> Mesh:
    """Box with pins; only the flat faces are triangulated, all coordinates are as given."""
    corners = 0.5 * size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    foot = (centres[:, None] + rim).reshape(-1, 2)
    count, pins = len(rim), len(centres)

    def at(points: NDArray[np.float64], z: float) -> NDArray[np.float64]:
        return np.column_stack([points, np.full(len(points), z)])

    # Bottom corners, then the top face's corners and the pins' feet, then the pins' tops.
    vertices = np.concatenate([at(corners, -body), at(corners, 0.0), at(foot, 0.0), at(foot, pin)])
    feet = 8 + np.arange(count * pins).reshape(pins, count)
    # Holes run clockwise.
    outline = [corners, *foot.reshape(pins, count, 2)[:, ::-1]]
    numbers = np.concatenate([np.arange(4, 8), feet[:, ::-1].ravel()])
    face = numbers[np.asarray(manifold3d.triangulate(outline), dtype=np.int64)]
    cap = np.asarray(manifold3d.triangulate([rim]), dtype=np.int64)
    caps = feet[:, 0, None, None] + count * pins + cap
    walls = [_wall(np.arange(4), np.arange(4, 8))]
    walls += [_wall(ring, ring + count * pins) for ring in feet]
    faces = [np.array([[0, 2, 1], [0, 3, 2]]), face, caps.reshape(-1, 3), *walls]
    return Mesh(vertices, np.concatenate(faces))


def _wall(lower: NDArray[np.int64], upper: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces between two rings of vertices, counter-clockwise from above, one over the other."""
    next_lower, next_upper = np.roll(lower, -1), np.roll(upper, -1)
    quads = [lower, next_lower, next_upper, lower, next_upper, upper]
    return np.stack(quads, axis=1).reshape(-1, 3)


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(BrickParameters, build_brick, measure_brick)
