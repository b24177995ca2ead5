"""An array of square pyramids on a plate, for the resolution of height against spacing.

Object frame: origin at the middle of the array; z = 0 on the plate's top face, which is the
reference face outside the array and between the pyramids.  Targets are the apexes, row by
row, each row towards +x and the rows from +y to -y.
"""

import math
from typing import Annotated

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature
from slbench.objects.registry import ArtefactKind
from slbench.objects.targets.common import WIDEST, Micrometres, cells, spacings
from slbench.objects.targets.tiles import PLAIN, Tile, ring_tile, tiled_plate

#: Share of the border strip's width that is left out of the reference on either side.
_MARGIN = 0.15


class PyramidArrayParameters(Parameters):
    """Size of a pyramid array.

    Parameters
    ----------
    rows, columns : int
        Pyramids along y and along x.
    pitch_um : float
        Their spacing.
    base_um : float
        Side of a pyramid's base: up to 98 % of the pitch, or all of it.
    height_um : float
        Of the apex above the plate.
    margin_mm : float
        Width of the flat border about the array.
    thickness_mm : float
        Extent below z = 0.
    """

    rows: Annotated[int, Interval(ge=1, le=200)] = 8
    columns: Annotated[int, Interval(ge=1, le=200)] = 8
    pitch_um: Micrometres = 100.0
    base_um: Micrometres = 80.0
    height_um: Micrometres = 40.0
    margin_mm: Length = 0.1
    thickness_mm: Length = 0.5


def build_pyramid_array(parameters: PyramidArrayParameters, name: str, where: str) -> Artefact:
    """Build a pyramid array.

    Parameters
    ----------
    parameters : PyramidArrayParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the feature ``reference``, in the flat border at -y; certified are size, height
        of the apexes, base, and angle of the flanks to the plate.

    Raises
    ------
    InputError
        If the pyramids overlap, or nearly touch.
    """
    pitch, base = parameters.pitch_um, parameters.base_um
    if base != pitch and base > WIDEST * pitch:
        expected = f"at most {WIDEST * pitch:g}, or {pitch:g} for pyramids that touch"
        raise InputError(f"{where}.base_um", expected, base)
    centres_x, lines_x = cells(parameters.columns, 1e-3 * pitch, parameters.margin_mm)
    centres_y, lines_y = cells(parameters.rows, 1e-3 * pitch, parameters.margin_mm)
    apex = np.array([[0.0, 0.0, 1e-3 * parameters.height_um]])
    # Indices into the four corners of the base, and the apex.
    flanks = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    if base == pitch:
        pyramid = Tile(apex, flanks)
    else:
        foot = 0.5e-3 * base * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
        pyramid = ring_tile(foot, apex, flanks)
    choice = np.pad(np.ones((parameters.rows, parameters.columns), dtype=np.int64), 1)
    plate = tiled_plate(lines_x, lines_y, choice, [PLAIN, pyramid], parameters.thickness_mm)
    x, y = np.meshgrid(centres_x, centres_y[::-1])
    border = parameters.margin_mm
    inner = _MARGIN * border
    reference = PlaneFeature(
        REFERENCE,
        0.0,
        0.0,
        (float(lines_x[0]) + inner, float(lines_x[-1]) - inner),
        (float(lines_y[0]) + inner, float(lines_y[0]) + border - inner),
    )
    return Artefact(
        name=name,
        kind="pyramid_array",
        parameters=parameters.model_dump(),
        mesh=plate.mesh,
        certified={
            "size_x_mm": 1e-3 * pitch * parameters.columns + 2.0 * border,
            "size_y_mm": 1e-3 * pitch * parameters.rows + 2.0 * border,
            "size_z_mm": parameters.thickness_mm + 1e-3 * parameters.height_um,
            "reference_flatness_um": 0.0,
            "height_um": parameters.height_um,
            "base_um": base,
            "flank_angle_deg": math.degrees(math.atan2(2.0 * parameters.height_um, base)),
        }
        | ({"pitch_x_um": pitch} if parameters.columns > 1 else {})
        | ({"pitch_y_um": pitch} if parameters.rows > 1 else {}),
        features=(reference,),
        targets=np.column_stack([x.ravel(), y.ravel(), np.full(x.size, apex[0, 2])]),
    )


def measure_pyramid_array(artefact: Artefact) -> dict[str, float]:
    """Measure the pyramids from the faces that are neither level nor upright.

    Parameters
    ----------
    artefact : Artefact
        A pyramid array.

    Returns
    -------
    dict of str to float
        ``height_um``, mean height of the apexes; ``base_um``, mean length of the flanks'
        edges at z = 0; ``flank_angle_deg``, mean angle of the flanks to the plate;
        ``pitch_x_um, pitch_y_um``, NaN where there is one pyramid along an axis.
    """
    corners = artefact.mesh.vertices[artefact.mesh.faces]
    normals = artefact.mesh.as_trimesh.face_normals
    flanks = (normals[:, 2] > 1e-6) & (normals[:, 2] < 1.0 - 1e-12)
    vertices = corners[flanks].reshape(-1, 3)
    apexes = np.unique(vertices[vertices[:, 2] > 0.0], axis=0)
    sides = np.roll(corners[flanks], -1, axis=1) - corners[flanks]
    level = np.abs(sides[:, :, 2]) == 0.0
    tilt = np.arctan2(np.hypot(normals[flanks, 0], normals[flanks, 1]), normals[flanks, 2])
    pitch_x, pitch_y = spacings(apexes)
    return {
        "height_um": 1e3 * float(apexes[:, 2].mean()),
        "base_um": 1e3 * float(np.linalg.norm(sides[level], axis=1).mean()),
        "flank_angle_deg": math.degrees(float(tilt.mean())),
        "pitch_x_um": 1e3 * pitch_x,
        "pitch_y_um": 1e3 * pitch_y,
    }


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(PyramidArrayParameters, build_pyramid_array, measure_pyramid_array)
