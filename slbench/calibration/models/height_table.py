r"""Look-up tables from the panel's coordinate to height, one of each camera pixel [55, 63].

A plane is captured at known heights.  Each pixel looks along one ray, on which the panel's
coordinate c and the height z are bound by a projective map, as of any two lines in one plane:

    c = (a + b z) / (1 + g z),    z = (c - a) / (b - g c)

with ``g = 0`` for the straight line of [63] and free for the reciprocal relation [55], whose
reference plane it does without.  As noise is in c, ``c + g z c = a + b z`` is solved by least
squares over the heights, about the means of both.  Lateral places are those of the pixel's ray at
the height: of the camera's in a rig.

**Wrong points.**  A wrong fringe order is an error of a whole period at a pixel, which few heights
cannot outvote.  The picture can: a plane's coordinate is smooth.  A polynomial through the medians
of blocks tells what lies off it (:func:`plane_coordinates`).
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.io import read_npz, write_npz
from slbench.core.show.display import brief
from slbench.patterns import Axis
from slbench.rig import Camera

Array = NDArray[np.float64]

Kind = Literal["linear", "reciprocal"]
KINDS: tuple[str, ...] = get_args(Kind)

#: Fewest heights that a pixel answers from: its three unknowns, and of a line one to spare.
LEAST_HEIGHTS = 3
#: Degree of the polynomial of a plane's coordinate, along either axis together.
_DEGREE = 4
#: Blocks along the longer side whose medians it goes through, at least so many pixels wide, and
#: how many of them must be known.
_BLOCKS, _LEAST_SIDE, _LEAST_PIXELS = 32, 4, 8
#: Robust deviations off it, and pixels of the panel, beyond which a coordinate is wrong.
_WRONG_SIGMAS, _WRONG_PX = 8.0, 0.5
#: How far beyond the heights seen a pixel still answers, as a share of their range.
_BEYOND = 0.02
#: Of the equations of a pixel, each scaled: beyond, its heights do not tell three unknowns.
_WORST_CONDITION = 1e12
#: Rounds of weighing blocks that do not lie on the plane less.
_ROUNDS = 50
#: Rows fitted at a time, which bounds the memory.
_BAND = 64
#: What a file of a table begins with.
_FILE = "slbench height table:"


@dataclass(frozen=True, eq=False, kw_only=True)
class HeightTable:
    """Heights by panel coordinate, of each pixel of a camera.

    Parameters
    ----------
    kind : {"linear", "reciprocal"}
    axis : {"u", "v"}
        Panel axis of the coordinate.
    coefficients : (V, U, 5) float
        ``c0, z0, a, b, g`` of ``c - c0 = (a + b (z - z0)) / (1 + g (z - z0))``; NaN at pixels
        that saw too few planes.
    sd_mm : (V, U) float
        What the planes are off at a pixel: standard deviation of a height.
    range_mm : (float, float)
        The heights that it was made from.
    lines : (V, U, 4) float
        ``x0, kx, y0, ky``: a pixel's ray is at ``x0 + kx z``, ``y0 + ky z``.
    """

    kind: Kind
    axis: Axis
    coefficients: Array
    sd_mm: Array
    range_mm: tuple[float, float]
    lines: Array

    __repr__ = brief

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask (V, U) of the pixels that answer."""
        return np.isfinite(self.coefficients[..., 0])

    def heights(self, coordinate: ArrayLike) -> tuple[Array, Array]:
        """Return heights and their derivative by the coordinate.

        Parameters
        ----------
        coordinate : (V, U) float
            Of the panel, px.

        Returns
        -------
        height, slope : (V, U) float
            mm, mm per px; NaN where a pixel does not answer.
        """
        c0, z0, a, b, g = np.moveaxis(self.coefficients, -1, 0)
        c = np.asarray(coordinate, dtype=np.float64) - c0
        with np.errstate(divide="ignore", invalid="ignore"):
            under = b - g * c
            return z0 + (c - a) / under, (b - g * a) / under**2

    def inside(self, height: Array) -> NDArray[np.bool_]:
        """Return a mask of heights within those that the table was made from, and a hair beyond."""
        low, high = self.range_mm
        slack = _BEYOND * (high - low)
        return (height >= low - slack) & (height <= high + slack)

    def save(self, path: str | Path) -> None:
        """Write the table as NPZ.

        Raises
        ------
        InputError
            If the name does not end in ``.npz``.
        """
        write_npz(
            path,
            kind=np.array(f"{_FILE} {self.kind} {self.axis}"),
            coefficients=self.coefficients,
            sd_mm=self.sd_mm,
            range_mm=np.array(self.range_mm),
            lines=self.lines,
        )

    @classmethod
    def load(cls, path: str | Path) -> HeightTable:
        """Read a table.

        Raises
        ------
        InputError
            If the file is missing, damaged or none of a table.
        """
        arrays = read_npz(path)
        kind = str(arrays.get("kind", ""))
        words = kind.removeprefix(_FILE).split()
        if not kind.startswith(_FILE) or len(words) != 2 or words[0] not in KINDS:
            raise InputError(path, "a table that calibrate planes wrote", "another NPZ")
        shape = arrays["sd_mm"].shape if "sd_mm" in arrays else ()
        wanted = {"coefficients": (*shape, 5), "lines": (*shape, 4), "range_mm": (2,)}
        for name, size in wanted.items():
            if len(shape) != 2 or name not in arrays or arrays[name].shape != size:
                raise InputError(f"{path}: {name}", f"an array of shape {size}", "another or none")
        low, high = arrays["range_mm"].tolist()
        return cls(
            kind=words[0],  # type: ignore[arg-type]
            axis=words[1],  # type: ignore[arg-type]
            coefficients=arrays["coefficients"].astype(np.float64),
            sd_mm=arrays["sd_mm"].astype(np.float64),
            range_mm=(float(low), float(high)),
            lines=arrays["lines"].astype(np.float64),
        )


def is_height_table(path: str | Path) -> bool:
    """Return whether a file is an archive, as tables are, rather than a model's JSON."""
    return Path(path).is_file() and zipfile.is_zipfile(path)


def fit_height_table(
    coordinates: ArrayLike,
    heights_mm: ArrayLike,
    camera: Camera,
    *,
    axis: Axis = "u",
    kind: Kind = "reciprocal",
) -> HeightTable:
    """Fit a table to planes at known heights.

    Parameters
    ----------
    coordinates : (m, V, U) float
        Panel coordinate that each plane was seen at, px; NaN where it was not.
    heights_mm : (m,) float
        World z of each plane, level.
    camera : Camera
        In the world of the heights; its rays give x and y.
    axis : {"u", "v"}
        Of the coordinates.
    kind : {"linear", "reciprocal"}

    Raises
    ------
    InputError
        For fewer than three different heights, or pictures that are not the camera's.
    """
    if kind not in KINDS:
        raise InputError("kind", "linear or reciprocal", repr(kind))
    c = np.asarray(coordinates, dtype=np.float64)
    z = np.asarray(heights_mm, dtype=np.float64)
    if len(np.unique(z)) < LEAST_HEIGHTS:
        expected = f"at least {LEAST_HEIGHTS} different ones"
        raise InputError("heights", expected, f"{len(np.unique(z))}")
    if c.shape != (len(z), camera.height, camera.width):
        expected = f"{len(z)} pictures of {camera.width} x {camera.height} px, the camera's"
        raise InputError("coordinates", expected, f"shape {c.shape}")
    table, sd = np.empty((*c.shape[1:], 5)), np.empty(c.shape[1:])
    for top in range(0, len(sd), _BAND):
        band = np.s_[top : top + _BAND]
        table[band], sd[band] = _fitted(c[:, band], z, kind)
    origin, direction = camera.unproject(camera.pixel_grid())
    with np.errstate(divide="ignore", invalid="ignore"):
        k = direction[..., :2] / direction[..., 2:]
    start = origin[..., :2] - k * origin[..., 2:]
    lines = np.stack((start[..., 0], k[..., 0], start[..., 1], k[..., 1]), axis=-1)
    return HeightTable(
        kind=kind,
        axis=axis,
        coefficients=table,
        sd_mm=sd,
        range_mm=(float(z.min()), float(z.max())),
        lines=lines,
    )


def _fitted(c: Array, z: Array, kind: Kind) -> tuple[Array, Array]:
    """Return coefficients (V, U, 5) and deviations (V, U) of some rows."""
    seen = np.isfinite(c)
    count = seen.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        c0 = np.where(seen, c, 0.0).sum(axis=0) / count
        z0 = np.where(seen, z[:, None, None], 0.0).sum(axis=0) / count
    d = np.where(seen, c - c0, 0.0)
    h = np.where(seen, z[:, None, None] - z0, 0.0)
    a, b, g = _projective(d, h, count) if kind == "reciprocal" else _straight(d, h)
    table = np.stack((c0, z0, a, b, g), axis=-1)
    free = 3 if kind == "reciprocal" else 2
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(seen, d - (a + b * h) / (1.0 + g * h), 0.0)
        spread = np.sqrt((off**2).sum(axis=0) / np.maximum(count - free, 1))
        sd = spread / np.abs(b - a * g)
    answers = (count >= LEAST_HEIGHTS) & np.isfinite(table).all(axis=-1) & (b != 0.0)
    table[~answers] = np.nan
    return table, np.where(answers, sd, np.nan)


def _straight(d: Array, h: Array) -> tuple[Array, Array, Array]:
    """Solve ``d = b h`` about the means: a and g are nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        b = (d * h).sum(axis=0) / (h * h).sum(axis=0)
    return np.zeros(b.shape), b, np.zeros(b.shape)


def _projective(d: Array, h: Array, count: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Solve ``d = a + b h - g h d`` at every pixel."""
    columns = (np.ones(1), h, -h * d)
    normal, right = np.empty((*count.shape, 3, 3)), np.empty((*count.shape, 3))
    for i, first in enumerate(columns):
        right[..., i] = (first * d).sum(axis=0) if i else 0.0
        for j, second in enumerate(columns):
            product = first * second
            normal[..., i, j] = count if not i and not j else product.sum(axis=0)
    # Of two heights or one nothing follows; what is left out there is told by the count.
    scale = np.sqrt(np.einsum("...ii->...i", normal))
    scale[scale == 0.0] = 1.0
    scaled = normal / scale[..., :, None] / scale[..., None, :]
    scaled[count < LEAST_HEIGHTS] = np.eye(3)
    scaled[np.linalg.cond(scaled) > _WORST_CONDITION] = np.nan
    with np.errstate(invalid="ignore"):
        found = np.linalg.solve(scaled, (right / scale)[..., None])[..., 0] / scale
    return found[..., 0], found[..., 1], found[..., 2]


def plane_coordinates(coordinate: ArrayLike) -> tuple[Array, int]:
    """Return a plane's coordinates without those that do not lie on it.

    Parameters
    ----------
    coordinate : (V, U) float
        Panel coordinate of a plane; NaN where it is not known.

    Returns
    -------
    cleaned : (V, U) float
        NaN too where the coordinate is off by more than eight robust deviations and half a
        pixel: wrong fringe orders, dust, what stands before the plane.
    wrong : int
        How many those are.

    Raises
    ------
    InputError
        If too little of the plane is seen to know where it is.
    """
    c = np.asarray(coordinate, dtype=np.float64)
    height, width = c.shape
    longer = max(height, width)
    side = max(_LEAST_SIDE, -(-longer // _BLOCKS))
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    enough = np.isfinite(_blocks(c, side)).sum(axis=-1) >= _LEAST_PIXELS
    if np.count_nonzero(enough) < 2 * len(powers):
        expected = f"a plane seen in {2 * len(powers)} blocks of {side} x {side} px at least"
        raise InputError("plane", expected, int(np.count_nonzero(enough)))
    v, u = ((n * side + 0.5 * (side - 1)) / longer for n in np.nonzero(enough))
    terms = np.stack([u**i * v**j for i, j in powers], axis=-1)
    weight = np.ones(len(terms))
    smooth = np.zeros(c.shape)
    for _ in range(_ROUNDS):
        # The median of what a block is off: without its slope, as soon as that is known.
        medians = np.nanmedian(_blocks(c - smooth, side)[enough], axis=-1)
        fit = np.linalg.lstsq(weight[:, None] * terms, weight * medians, rcond=None)[0]
        grid = np.zeros((_DEGREE + 1, _DEGREE + 1))
        for (i, j), value in zip(powers, fit, strict=True):
            grid[j, i] = value
        change = polynomial.polygrid2d(np.arange(height) / longer, np.arange(width) / longer, grid)
        smooth += change
        if np.abs(change).max() < 0.1 * _WRONG_PX:
            break
        # Least absolute deviations, by weights: what is far off has no more say for it.
        weight = 1.0 / np.sqrt(np.maximum(np.abs(medians - terms @ fit), 0.1 * _WRONG_PX))
    off = np.abs(c - smooth)
    limit = max(_WRONG_SIGMAS * 1.4826 * float(np.nanmedian(off)), _WRONG_PX)
    wrong = off > limit
    return np.where(wrong, np.nan, c), int(np.count_nonzero(wrong))


def _blocks(c: Array, side: int) -> Array:
    """Return a picture in square blocks, (rows, columns, side * side), NaN beyond its border."""
    height, width = c.shape
    rows, columns = -(-height // side), -(-width // side)
    padded = np.full((rows * side, columns * side), np.nan)
    padded[:height, :width] = c
    tiles = padded.reshape(rows, side, columns, side).transpose(0, 2, 1, 3)
    return tiles.reshape(rows, columns, -1)
