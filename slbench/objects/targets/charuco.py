"""A ChArUco board: a chequerboard with an ArUco marker in each white square.

The pattern is what ``cv2.aruco.CharucoBoard`` draws (S. Garrido-Jurado et al., Pattern Recognition
47, 2014): the square at -x, +y is black, and markers are numbered row by row.

Parts: ``black`` (squares), ``markers`` (their black cells) and ``white`` (all else, border, walls
and bottom).  Object frame: origin at the middle of the top face, which is the reference face,
z = 0; the plate lies below.  Targets are the true inner corners, row by row, each row towards +x
and the rows from +y to -y: the numbers of ``cv2.aruco.CharucoDetector``, seen from above with +y
up.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Length
from slbench.objects.artefact import Artefact
from slbench.objects.registry import ArtefactKind
from slbench.objects.targets.common import Count, top_face
from slbench.objects.targets.tiles import PLAIN, tiled_plate

#: Cells of a marker's black frame, either side.
_FRAME = 1
_WHITE, _BLACK, _MARKER = 0, 1, 2


class CharucoParameters(Parameters):
    """Size of a ChArUco board.

    Parameters
    ----------
    columns, rows : int
        Squares in a row, and rows of them.
    square_mm, marker_mm : float
        Side of a square and of a marker, frame included; markers are smaller.
    dictionary : str
        Name of one of ``cv2.aruco``'s dictionaries.
    margin_mm : float
        Width of the white border.
    thickness_mm : float
        Extent along z.
    """

    columns: Count = 9
    rows: Count = 7
    square_mm: Length = 5.0
    marker_mm: Length = 3.75
    dictionary: str = "DICT_4X4_50"
    margin_mm: Length = 5.0
    thickness_mm: Length = 3.0


def build_charuco(parameters: CharucoParameters, name: str, where: str) -> Artefact:
    """Build a ChArUco board.

    Parameters
    ----------
    parameters : CharucoParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the feature ``reference``, the whole top face; certified are size, flatness and the
        sides of a square.

    Raises
    ------
    InputError
        If markers fill their squares, or the dictionary is not known or has too few.
    """
    columns, rows, square = parameters.columns, parameters.rows, parameters.square_mm
    marker, margin = parameters.marker_mm, parameters.margin_mm
    if marker > 0.95 * square:
        raise InputError(f"{where}.marker_mm", f"at most {0.95 * square:g}", marker)
    names = [known for known in dir(cv2.aruco) if known.startswith("DICT_")]
    if parameters.dictionary not in names:
        got = quoted(parameters.dictionary, names)
        raise InputError(f"{where}.dictionary", "a dictionary of cv2.aruco", got)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, parameters.dictionary))
    markers = columns * rows // 2
    if markers > len(dictionary.bytesList):
        expected = f"a dictionary of {markers} markers at least"
        raise InputError(f"{where}.dictionary", expected, parameters.dictionary)
    cell_count = dictionary.markerSize + 2 * _FRAME
    # Lines of a square: its border, then the marker's cells.
    inner = np.linspace(-0.5 * marker, 0.5 * marker, cell_count + 1) + 0.5 * square
    lines_x, lines_y = (
        np.concatenate(
            (
                [-margin],
                (square * np.arange(count)[:, None] + [0.0, *inner]).ravel(),
                [square * count, square * count + margin],
            )
        )
        - 0.5 * square * count
        for count in (columns, rows)
    )
    colours = _colours(parameters, dictionary, lines_x[1:-1], lines_y[1:-1])
    plate = tiled_plate(
        lines_x, lines_y, np.pad(colours, 1), [PLAIN, PLAIN, PLAIN], parameters.thickness_mm
    )
    x = square * (np.arange(1, columns) - 0.5 * columns)
    y = square * (0.5 * rows - np.arange(1, rows))
    corner_x, corner_y = np.meshgrid(x, y)
    return Artefact(
        name=name,
        kind="charuco",
        parameters=parameters.model_dump(),
        mesh=plate.mesh,
        certified={
            "size_x_mm": columns * square + 2.0 * margin,
            "size_y_mm": rows * square + 2.0 * margin,
            "reference_flatness_um": 0.0,
            "square_x_mm": square,
            "square_y_mm": square,
        },
        features=(top_face(plate.mesh),),
        parts={
            "black": np.flatnonzero(plate.face_tiles == _BLACK),
            "markers": np.flatnonzero(plate.face_tiles == _MARKER),
            "white": np.flatnonzero((plate.face_tiles != _BLACK) & (plate.face_tiles != _MARKER)),
        },
        targets=np.column_stack([corner_x.ravel(), corner_y.ravel(), np.zeros(x.size * y.size)]),
    )


def _colours(
    parameters: CharucoParameters,
    dictionary: cv2.aruco.Dictionary,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return which tile each cell between the lines is, the row of the least y first.

    A square's colour is that of its corner; a cell of a marker is looked up in the marker.
    """
    square, marker = parameters.square_mm, parameters.marker_mm
    columns, rows = parameters.columns, parameters.rows
    side = dictionary.markerSize + 2 * _FRAME
    middle_x, middle_y = 0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])
    column = np.floor(middle_x / square + 0.5 * columns).astype(np.int64)
    row = np.floor(0.5 * rows - middle_y / square).astype(np.int64)  # from the top
    across = (middle_x / square + 0.5 * columns - column - 0.5) * square / marker + 0.5
    down = (0.5 * rows - middle_y / square - row - 0.5) * square / marker + 0.5
    black = (column + row[:, None]) % 2 == 0
    tiles = np.where(black, _BLACK, _WHITE)
    # Markers are counted over the white squares, row by row.
    whites = np.cumsum([(np.arange(columns) + r) % 2 == 1 for r in range(rows)]).reshape(rows, -1)
    for i, (r, v) in enumerate(zip(row, down, strict=True)):
        for j, (c, u) in enumerate(zip(column, across, strict=True)):
            if tiles[i, j] == _WHITE and 0.0 < u < 1.0 and 0.0 < v < 1.0:
                picture = dictionary.generateImageMarker(int(whites[r, c]) - 1, side)
                if picture[int(v * side), int(u * side)] == 0:
                    tiles[i, j] = _MARKER
    return tiles


def measure_charuco(artefact: Artefact) -> dict[str, float]:
    """Measure the squares: those of the part ``black`` reach over all columns and rows.

    Parameters
    ----------
    artefact : Artefact
        A ChArUco board.

    Returns
    -------
    dict of str to float
        ``square_x_mm, square_y_mm``.
    """
    faces = artefact.mesh.faces[artefact.parts["black"]]
    extent = np.ptp(artefact.mesh.vertices[faces].reshape(-1, 3), axis=0)
    return {
        "square_x_mm": float(extent[0]) / artefact.parameters["columns"],
        "square_y_mm": float(extent[1]) / artefact.parameters["rows"],
    }


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(CharucoParameters, build_charuco, measure_charuco)
