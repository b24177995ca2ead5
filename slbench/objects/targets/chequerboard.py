"""A chequerboard for OpenCV's calibration: black and white squares with a white border.

Parts: ``black`` and ``white`` (white squares, border, walls and bottom).  Object frame:
origin at the middle of the top face, which is the reference face, z = 0; the plate lies
below.  The square at -x, +y is white.  Targets are the true inner corners, row by row, each
row towards +x and the rows from +y to -y: the order of ``cv2.findChessboardCornersSB`` with
the pattern size ``(columns, rows)``, seen from above with +y up.  The older
``cv2.findChessboardCorners`` begins at a black square, and so gives the reverse order.  OpenCV
can tell which end is up only if one of rows and columns is odd and the other even.
"""

import numpy as np

from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Length
from slbench.objects.artefact import Artefact
from slbench.objects.registry import ArtefactKind
from slbench.objects.targets.common import Count, cells, spacings, top_face
from slbench.objects.targets.tiles import PLAIN, tiled_plate


class ChequerboardParameters(Parameters):
    """Size of a chequerboard.

    Parameters
    ----------
    columns, rows : int
        Inner corners in a row, and rows of them; OpenCV's pattern size.  There is one square
        more either way.
    square_mm : float
        Side of a square.
    margin_mm : float
        Width of the white border.
    thickness_mm : float
        Extent along z.
    """

    columns: Count = 9
    rows: Count = 6
    square_mm: Length = 5.0
    margin_mm: Length = 5.0
    thickness_mm: Length = 3.0


def build_chequerboard(parameters: ChequerboardParameters, name: str, where: str) -> Artefact:
    """Build a chequerboard.

    Parameters
    ----------
    parameters : ChequerboardParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read (they are all valid here).

    Returns
    -------
    Artefact
        With the feature ``reference``, the whole top face; certified are size, flatness and
        the sides of a square.
    """
    columns, rows, square = parameters.columns + 1, parameters.rows + 1, parameters.square_mm
    lines_x = cells(columns, square, parameters.margin_mm)[1]
    lines_y = cells(rows, square, parameters.margin_mm)[1]
    # Rows from the top; the plate's start at the least y.
    is_black = (np.arange(columns) + np.arange(rows)[:, None]) % 2 == 1
    choice = np.pad(is_black[::-1].astype(np.int64), 1)
    plate = tiled_plate(lines_x, lines_y, choice, [PLAIN, PLAIN], parameters.thickness_mm)
    x, y = np.meshgrid(lines_x[2:-2], lines_y[-3:1:-1])
    return Artefact(
        name=name,
        kind="chequerboard",
        parameters=parameters.model_dump(),
        mesh=plate.mesh,
        certified={
            "size_x_mm": columns * square + 2.0 * parameters.margin_mm,
            "size_y_mm": rows * square + 2.0 * parameters.margin_mm,
            "reference_flatness_um": 0.0,
            "square_x_mm": square,
            "square_y_mm": square,
        },
        features=(top_face(plate.mesh),),
        parts={
            "black": np.flatnonzero(plate.face_tiles == 1),
            "white": np.flatnonzero(plate.face_tiles != 1),
        },
        targets=np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]),
    )


def measure_chequerboard(artefact: Artefact) -> dict[str, float]:
    """Measure the squares from the faces of the part ``black``.

    Parameters
    ----------
    artefact : Artefact
        A chequerboard.

    Returns
    -------
    dict of str to float
        ``square_x_mm, square_y_mm``, the mean distance of neighbouring lines through
        the corners of the black squares.
    """
    faces = artefact.mesh.faces[artefact.parts["black"]]
    corners = artefact.mesh.vertices[faces].reshape(-1, 3)
    square_x, square_y = spacings(corners)
    return {"square_x_mm": square_x, "square_y_mm": square_y}


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(ChequerboardParameters, build_chequerboard, measure_chequerboard)
