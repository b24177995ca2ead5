"""A calibration grid: dots at a regular pitch on a flat plate, of another material.

The thesis calibrates its micro-scale scanner with a fixed-frequency distortion target, chrome
dots on opal glass: spacing 125 um, dot diameter 62.5 um (thesis table 11; its section 8.3
says "a radius of 62.5 um", with which the dots would touch).

The edges of the dots are geometry: every dot is a polygon of the circle's area, so a centroid
or an area taken from it is the circle's, and its edge is off by less than 2.1e-4 of the
radius with the fewest segments allowed, which is 6.3 nm for the dots of the thesis.  Dots and
plate are coplanar: the chrome's thickness of about 0.1 um is left out.

Parts: ``dots`` and ``plate`` (the rest of the top face, walls and bottom).  Object frame:
origin at the middle of the top face, which is the reference face, z = 0; the plate lies
below.  Targets are the true centres, row by row, each row towards +x and the rows from +y to
-y: the order in which OpenCV finds them when they are seen from above with +y up.
"""

import math

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Length
from slbench.objects.artefact import Artefact
from slbench.objects.registry import ArtefactKind
from slbench.objects.targets.common import (
    WIDEST,
    Count,
    Micrometres,
    Segments,
    cells,
    discs_of,
    spacings,
    top_face,
)
from slbench.objects.targets.tiles import PLAIN, disc_tile, tiled_plate


class CalibrationGridParameters(Parameters):
    """Size of a calibration grid.

    Parameters
    ----------
    rows, columns : int
        Dots along y and along x.
    dot_diameter_um, pitch_um : float
        Diameter and spacing of the dots.
    margin_mm : float
        From the outermost dots' centres to the plate's edge; more than half a pitch.
    thickness_mm : float
        Extent along z.
    segments : int
        Sides of the polygon that a dot is; a multiple of 4.
    """

    rows: Count = 9
    columns: Count = 9
    dot_diameter_um: Micrometres = 62.5
    pitch_um: Micrometres = 125.0
    margin_mm: Length = 0.25
    thickness_mm: Length = 1.5
    segments: Segments = 128


def build_calibration_grid(
    parameters: CalibrationGridParameters, name: str, where: str
) -> Artefact:
    """Build a calibration grid.

    Parameters
    ----------
    parameters : CalibrationGridParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the feature ``reference``, the whole top face; certified are size, flatness,
        pitch along x and y, and dot diameter.

    Raises
    ------
    InputError
        If the dots touch, or the margin cuts them.
    """
    pitch = 1e-3 * parameters.pitch_um
    if parameters.dot_diameter_um > WIDEST * parameters.pitch_um:
        expected = f"at most {WIDEST * parameters.pitch_um:g}, for dots that stand apart"
        raise InputError(f"{where}.dot_diameter_um", expected, parameters.dot_diameter_um)
    if parameters.margin_mm < 0.5 * pitch + 1e-3:
        expected = f"at least {0.5 * pitch + 1e-3:g}, half a pitch and 0.001"
        raise InputError(f"{where}.margin_mm", expected, parameters.margin_mm)
    border = parameters.margin_mm - 0.5 * pitch
    centres_x, lines_x = cells(parameters.columns, pitch, border)
    centres_y, lines_y = cells(parameters.rows, pitch, border)
    disc = disc_tile(0.5e-3 * parameters.dot_diameter_um, parameters.segments)
    choice = np.pad(np.ones((parameters.rows, parameters.columns), dtype=np.int64), 1)
    plate = tiled_plate(lines_x, lines_y, choice, [PLAIN, disc], parameters.thickness_mm)
    dots = (plate.face_tiles == 1) & (plate.face_numbers < parameters.segments)
    x, y = np.meshgrid(centres_x, centres_y[::-1])
    return Artefact(
        name=name,
        kind="calibration_grid",
        parameters=parameters.model_dump(),
        mesh=plate.mesh,
        certified={
            "size_x_mm": (parameters.columns - 1) * pitch + 2.0 * parameters.margin_mm,
            "size_y_mm": (parameters.rows - 1) * pitch + 2.0 * parameters.margin_mm,
            "reference_flatness_um": 0.0,
            "pitch_x_um": parameters.pitch_um,
            "pitch_y_um": parameters.pitch_um,
            "dot_diameter_um": parameters.dot_diameter_um,
        },
        features=(top_face(plate.mesh),),
        parts={"dots": np.flatnonzero(dots), "plate": np.flatnonzero(~dots)},
        targets=np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]),
    )


def measure_calibration_grid(artefact: Artefact) -> dict[str, float]:
    """Measure pitch and diameter of the dots from the faces of the part ``dots``.

    Parameters
    ----------
    artefact : Artefact
        A calibration grid.

    Returns
    -------
    dict of str to float
        ``pitch_x_um, pitch_y_um``, the mean distance of neighbouring centroids, and
        ``dot_diameter_um``, that of the circle of the dots' mean area.
    """
    centres, areas = discs_of(artefact, "dots")
    pitch_x, pitch_y = spacings(centres)
    return {
        "pitch_x_um": 1e3 * pitch_x,
        "pitch_y_um": 1e3 * pitch_y,
        "dot_diameter_um": 2e3 * math.sqrt(float(areas.mean()) / math.pi),
    }


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(CalibrationGridParameters, build_calibration_grid, measure_calibration_grid)
