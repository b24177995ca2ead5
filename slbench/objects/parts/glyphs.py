"""Outlines of characters, for relief: from the DejaVu Sans Bold that Matplotlib brings along.

The font's own outlines are taken, in its integer design units and without hinting, so that
text has the same shape on every machine.  They are straight lines and quadratic Bezier curves
(TrueType); a ring samples them at a stated spacing and has a point at each of their ends.
"""

import functools
from pathlib import Path

import matplotlib
import numpy as np
import shapely
from matplotlib.ft2font import FT2Font, LoadFlags
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.wording import shown

#: Matplotlib gives outlines in 64ths, also in design units.
_UNIT = 64.0
_MOVE, _LINE, _CURVE = 1, 2, 3

Ring = NDArray[np.float64]


def text_outlines(text: str, height_mm: float, spacing_mm: float, where: str) -> list[list[Ring]]:
    """Outlines of the characters of a text, the text's bounding box centred on the origin.

    Characters stand next to one another by their advance widths, without kerning.

    Parameters
    ----------
    text : str
        One line.
    height_mm : float
        Height of the bounding box of all outlines.
    spacing_mm : float
        Largest distance of neighbouring points of a ring.
    where : str
        Where the text was read, for error messages.

    Returns
    -------
    list of list of (k, 2) ndarray of float
        Closed rings of each character that is not blank, the last point not repeated; the
        ink is to the left of each ring: outer rings are counter-clockwise, holes clockwise.

    Raises
    ------
    InputError
        If a character has no glyph in the font, or all of the text is blank.
    """
    font = _font()
    characters, advance = [], 0.0
    for character in text:
        if font.get_char_index(ord(character)) == 0:
            raise InputError(where, f"characters of {font.family_name}", repr(character))
        glyph = font.load_char(ord(character), flags=LoadFlags.NO_SCALE)
        vertices, codes = font.get_path()
        start = np.array([advance, 0.0])
        pieces = [[piece + start for piece in ring] for ring in _rings(vertices * _UNIT, codes)]
        if pieces:
            characters.append(pieces)
        advance += glyph.horiAdvance
    if not characters:
        raise InputError(where, "text with something to see", shown(text))
    # The box of the curves, not of their control points; fine enough to be within a millionth.
    fine = [_sampled(ring, 4.0) for pieces in characters for ring in pieces]
    low, high = np.concatenate(fine).min(axis=0), np.concatenate(fine).max(axis=0)
    scale = height_mm / (high[1] - low[1])
    centre = 0.5 * (low + high)
    return [
        [_sampled([(piece - centre) * scale for piece in ring], spacing_mm) for ring in pieces]
        for pieces in characters
    ]


def polygon_of(rings: list[Ring]) -> shapely.Geometry:
    """Area that rings enclose by the even-odd rule.

    Parameters
    ----------
    rings : list of (k, 2) ndarray of float
        Rings that do not cross.

    Returns
    -------
    shapely Polygon or MultiPolygon
        The area.
    """
    polygons = [shapely.Polygon(ring) for ring in rings]
    return functools.reduce(shapely.symmetric_difference, polygons)


@functools.cache
def _font() -> FT2Font:
    return FT2Font(str(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf")))


def _rings(vertices: NDArray[np.float64], codes: NDArray[np.integer]) -> list[list[Ring]]:
    """Split an outline into rings of pieces: (2, 2) lines and (3, 2) curves, ink to the left."""
    rings: list[list[Ring]] = []
    at = 0
    while at < len(codes):
        if codes[at] == _MOVE:
            rings.append([])
            at += 1
        elif codes[at] in (_LINE, _CURVE):
            size = 1 if codes[at] == _LINE else 2
            rings[-1].append(vertices[at - 1 : at + size])
            at += size
        else:
            at += 1  # closing point: the outlines of the font end where they began
    # TrueType has the ink to the right.
    return [[piece[::-1] for piece in reversed(ring)] for ring in rings]


def _sampled(pieces: list[Ring], spacing: float) -> Ring:
    """Points along lines and curves, each piece's end left to the next."""
    points = []
    for piece in pieces:
        if np.array_equal(piece[0], piece[-1]):
            continue
        # A Bezier curve is nowhere faster than its degree times its longest control side.
        degree = len(piece) - 1
        longest = np.linalg.norm(np.diff(piece, axis=0), axis=1).max()
        count = int(np.ceil(degree * longest / spacing))
        t = np.arange(count)[:, None] / count
        if degree == 1:
            points.append((1.0 - t) * piece[0] + t * piece[1])
        else:
            points.append((1 - t) ** 2 * piece[0] + 2 * t * (1 - t) * piece[1] + t**2 * piece[2])
    return np.concatenate(points)
