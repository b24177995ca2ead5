"""An asymmetric circle grid for OpenCV's calibration: dots on a plate, rows staggered.

Row i has its dots at ``x = (2 j + i mod 2) s, y = i s`` (the layout of OpenCV's camera
calibration sample), with s the spacing; a dot's nearest neighbours are ``sqrt(2) s`` away.
The edges of the dots are geometry: polygons of the circle's area, off the circle by less
than 2.1e-4 of its radius.

Parts: ``dots`` and ``plate`` (the rest of the top face, walls and bottom).  Object frame:
origin at the middle of the top face, which is the reference face, z = 0; the plate lies
below.  Targets are the true centres, row by row, each row towards +x and the rows from +y to
-y, the first row not shifted: the order of ``cv2.findCirclesGrid`` with the pattern size
``(columns, rows)`` and ``CALIB_CB_ASYMMETRIC_GRID``, seen from above with +y up.
"""

import math
from typing import Annotated

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import Artefact
from slbench.objects.registry import ArtefactKind
from slbench.objects.targets.common import (
    WIDEST,
    Count,
    Segments,
    cells,
    discs_of,
    spacings,
    top_face,
)
from slbench.objects.targets.tiles import PLAIN, disc_tile, tiled_plate


class CircleGridParameters(Parameters):
    """Size of an asymmetric circle grid.

    Parameters
    ----------
    columns, rows : int
        Dots in a row, and rows; OpenCV's pattern size.
    spacing_mm : float
        Distance of neighbouring rows; half the distance of neighbours in a row.
    dot_diameter_mm : float
        Diameter of the dots; less than the spacing.
    margin_mm : float
        From the outermost dots' centres to the plate's edge.
    thickness_mm : float
        Extent along z.
    segments : int
        Sides of the polygon that a dot is; a multiple of 4.
    """

    columns: Count = 4
    rows: Annotated[int, Interval(ge=3, le=200)] = 11
    spacing_mm: Length = 4.0
    dot_diameter_mm: Length = 3.0
    margin_mm: Length = 5.0
    thickness_mm: Length = 3.0
    segments: Segments = 128


def build_circle_grid(parameters: CircleGridParameters, name: str, where: str) -> Artefact:
    """Build an asymmetric circle grid.

    Parameters
    ----------
    parameters : CircleGridParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the feature ``reference``, the whole top face; certified are size, flatness,
        spacing along x and y, and dot diameter.

    Raises
    ------
    InputError
        If the dots nearly fill their cells, or the margin cuts them.
    """
    spacing, diameter = parameters.spacing_mm, parameters.dot_diameter_mm
    if diameter > WIDEST * spacing:
        raise InputError(f"{where}.dot_diameter_mm", f"at most {WIDEST * spacing:g}", diameter)
    if parameters.margin_mm < 0.5 * spacing + 1e-3:
        expected = f"at least {0.5 * spacing + 1e-3:g}, half a spacing and 0.001"
        raise InputError(f"{where}.margin_mm", expected, parameters.margin_mm)
    columns, rows = parameters.columns, parameters.rows
    border = parameters.margin_mm - 0.5 * spacing
    centres_x, lines_x = cells(2 * columns, spacing, border)
    centres_y, lines_y = cells(rows, spacing, border)
    disc = disc_tile(0.5 * diameter, parameters.segments)
    # Rows from the top, as OpenCV counts them; the plate's start at the least y.
    has_dot = (np.arange(2 * columns) + np.arange(rows)[:, None]) % 2 == 0
    choice = np.pad(has_dot[::-1].astype(np.int64), 1)
    plate = tiled_plate(lines_x, lines_y, choice, [PLAIN, disc], parameters.thickness_mm)
    dots = (plate.face_tiles == 1) & (plate.face_numbers < parameters.segments)
    row, column = np.nonzero(has_dot)
    return Artefact(
        name=name,
        kind="circle_grid",
        parameters=parameters.model_dump(),
        mesh=plate.mesh,
        certified={
            "size_x_mm": (2 * columns - 1) * spacing + 2.0 * parameters.margin_mm,
            "size_y_mm": (rows - 1) * spacing + 2.0 * parameters.margin_mm,
            "reference_flatness_um": 0.0,
            "spacing_x_mm": spacing,
            "spacing_y_mm": spacing,
            "dot_diameter_mm": diameter,
        },
        features=(top_face(plate.mesh),),
        parts={"dots": np.flatnonzero(dots), "plate": np.flatnonzero(~dots)},
        targets=np.column_stack([centres_x[column], centres_y[::-1][row], np.zeros(len(row))]),
    )


def measure_circle_grid(artefact: Artefact) -> dict[str, float]:
    """Measure spacing and diameter of the dots from the faces of the part ``dots``.

    Parameters
    ----------
    artefact : Artefact
        A circle grid.

    Returns
    -------
    dict of str to float
        ``spacing_x_mm, spacing_y_mm``, the mean distance of neighbouring columns (a row has
        a dot in every other one) and rows, and ``dot_diameter_mm``, that of the circle of
        the dots' mean area.
    """
    centres, areas = discs_of(artefact, "dots")
    spacing_x, spacing_y = spacings(centres)
    return {
        "spacing_x_mm": spacing_x,
        "spacing_y_mm": spacing_y,
        "dot_diameter_mm": 2.0 * math.sqrt(float(areas.mean()) / math.pi),
    }


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(CircleGridParameters, build_circle_grid, measure_circle_grid)
