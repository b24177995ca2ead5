"""Sparse rows of a light transport matrix, added up from samples.

A row is a camera pixel, a column a node of the blurred panels (:mod:`slbench.simulate.footprints`)
or, where both panel axes are kept, a panel pixel.  Samples come in two independent halves: their
sum is the row, their difference its Monte Carlo error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.core.threads import in_bands
from slbench.rig.optics.spread import RING_SOFTENING, Spread
from slbench.simulate.footprints import SHARP, STEP, BlurredPanel, Levels, light

if TYPE_CHECKING:
    import scipy.sparse

#: Pixels that are worth a thread.
_LEAST = 1 << 12
#: Up to so many columns are sorted by insertion alone.
_INSERTED = 32
#: Levels of a pixel that are so close are one.
_NEIGHBOURS = 2
#: Entries that 32 bits count.
_MOST_INT32 = np.iinfo(np.int32).max
#: Entries that a thread merges before it packs them: they stay in the cache.
_TEMPORARY = 1 << 16
#: Points that stand for a footprint in two dimensions, on a spiral of equal shares: two a panel
#: pixel of its area, within limits.
_LEAST_POINTS, _MOST_POINTS = 16, 512
_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


class SampleBlock(NamedTuple):
    """Samples of a block of pixels: (pixels, samples) float32 arrays.

    Those of each bounce follow those of the one before; half of a bounce's samples belong to
    either of two independent sets.

    Parameters
    ----------
    weights : array
        Radiance a unit of the panel's, already over the number of samples.  Zero: none; negative:
        what it would be, but the zone of the lens that was looked at is hidden.
    axes : mapping of 0 (u), 1 (v) to (places, shifts, circles)
        Place of the footprint's middle on the panel, px; from there to the middle of the zone;
        half width of the geometric disc.
    share : float
        Radius of a disc of a zone's area, as a share of the lens's.
    bounce : int
        Samples a bounce.
    """

    weights: NDArray[np.float32]
    axes: Mapping[int, tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]]
    share: float
    bounce: int


@dataclass(frozen=True)
class SparseRows:
    """A block of matrix rows in CSR form.

    Parameters
    ----------
    indptr : (rows + 1,) int32, or int64 where there are more entries than that counts
    indices : (nonzeros,) uint16 or uint32
        Columns, ascending within a row.
    data : (nonzeros,) float32
    width : int
        Columns of the matrix.
    blurred : BlurredPanel or None
        What the columns stand for; None: the panel's pixels.
    differences : (nonzeros,) float32 or None
        Half the difference between the rows of either half of the samples: an estimate of the
        rows' Monte Carlo error with one degree of freedom.
    """

    indptr: NDArray[np.signedinteger]
    indices: NDArray[np.unsignedinteger]
    data: NDArray[np.float32]
    width: int
    blurred: BlurredPanel | None = None
    differences: NDArray[np.float32] | None = None

    @classmethod
    def concatenate(cls, blocks: list[SparseRows]) -> SparseRows:
        """Stack blocks of rows, emptying `blocks`: pages are touched as blocks are freed."""
        width = blocks[0].width
        lengths = np.concatenate([np.diff(block.indptr) for block in blocks])
        indptr = row_starts(lengths)
        indices = np.empty(indptr[-1], blocks[0].indices.dtype)
        data, differences = np.empty(indptr[-1], np.float32), np.empty(indptr[-1], np.float32)
        start = 0
        while blocks:
            block = blocks.pop(0)
            stop = start + block.data.size
            indices[start:stop] = block.indices
            data[start:stop] = block.data
            differences[start:stop] = block.differences
            start = stop
        return cls(indptr, indices, data, width, differences=differences)

    def band(self, first: int, last: int) -> SparseRows:
        """Return rows `first` to `last`; nothing is copied but the row starts."""
        start, stop = self.indptr[first], self.indptr[last]
        indptr = self.indptr[first : last + 1] - start
        differences = None if self.differences is None else self.differences[start:stop]
        return replace(
            self,
            indptr=indptr,
            indices=self.indices[start:stop],
            data=self.data[start:stop],
            differences=differences,
        )

    def chosen(self, rows: NDArray[np.intp]) -> SparseRows:
        """Return some of the rows (k,), in the order given."""
        counts = np.diff(self.indptr)[rows]
        indptr = row_starts(counts)
        # Each row's entries follow one another: where the row starts, and how far on.
        within = np.arange(int(indptr[-1])) - np.repeat(indptr[:-1], counts)
        entries = np.repeat(self.indptr[:-1][rows], counts) + within
        differences = None if self.differences is None else self.differences[entries]
        return replace(
            self,
            indptr=indptr,
            indices=self.indices[entries],
            data=self.data[entries],
            differences=differences,
        )

    def scaled(self, factors: NDArray[np.float64]) -> SparseRows:
        """Return the rows multiplied by `factors` (rows,)."""
        repeated = np.repeat(factors.astype(np.float32), np.diff(self.indptr))
        differences = None if self.differences is None else self.differences * repeated
        return replace(self, data=self.data * repeated, differences=differences)

    def rounded(self, bits: int) -> SparseRows:
        """Return the rows with `bits` of their weights' mantissas, rounded to nearest.

        A relative error of at most ``2**-(bits + 1)``; the zeros behind them deflate away.
        """
        drop = np.uint32(23 - bits)
        if drop == 0:
            return self
        weights = self.data.view(np.uint32) + np.uint32(1 << (int(drop) - 1))
        weights >>= drop
        weights <<= drop
        return replace(self, data=weights.view(np.float32))

    def half(self) -> SparseRows:
        """Return the rows of one half of the samples."""
        assert self.differences is not None  # whoever asks has looked
        return replace(self, data=self.data + self.differences, differences=None)

    def tocsr(self) -> scipy.sparse.csr_array:
        """Return the matrix from panel pixels to rows as a SciPy sparse array of float32."""
        import scipy.sparse  # a scan does without

        matrix = scipy.sparse.csr_array(
            (self.data, self.indices.astype(np.int64), self.indptr),
            shape=(self.indptr.size - 1, self.width),
        )
        return matrix if self.blurred is None else matrix @ self.blurred.matrix()


def row_starts(counts: NDArray[np.integer]) -> NDArray[np.signedinteger]:
    """Return where rows of `counts` entries start, and the end: (rows + 1,)."""
    total = int(counts.sum(dtype=np.int64))
    kind = np.int32 if total <= _MOST_INT32 else np.int64
    starts: NDArray[np.signedinteger] = np.zeros(counts.size + 1, kind)
    np.cumsum(counts, dtype=starts.dtype, out=starts[1:])
    return starts


class LineRows:
    """Rows along one panel axis, block by block: columns are nodes of blurred panels.

    Parameters
    ----------
    levels, across : Levels
        Along the axis, and along the other one, where the panel ends too.
    axis : {0, 1}
    """

    def __init__(self, levels: Levels, across: Levels, axis: int) -> None:
        self.levels, self.across, self.axis = levels, across, axis
        self.blocks: list[tuple[SparseRows, int]] = []

    def add(self, given: SampleBlock) -> None:
        """Add the rows of a block of pixels."""
        own, other = given.axes[self.axis], given.axes[1 - self.axis]
        circles = own[2]
        largest = float(circles.max(initial=0.0))
        count = self.levels.count(largest)
        grids = self.levels.grids(count)
        stride = int(grids.nodes.max())
        ends = (*self.across.spread.lines(), self.across.size)
        kept = (grids.first, grids.spacing, grids.nodes, grids.sharp, self.levels.scale, stride)

        def merge(first: int, last: int, out: _Scratch) -> None:
            # NumPy's logarithm works on many numbers at a time.
            scaled = circles[first:last] / np.float32(self.levels.scale)
            scaled = np.log1p(scaled * scaled)
            levels = (scaled * np.float32(0.5 / STEP) + np.float32(0.5)).astype(np.uint16)
            lanes = (given.weights, *own, levels, *other, given.share, given.bounce)
            _merge_lines(*lanes, *ends, *kept, *out, first, last)

        block = _merged(merge, given.weights.shape, 4, count * stride)
        self.blocks.append((block, stride))

    def result(self) -> SparseRows:
        """Return all rows, their columns the nodes that are used; the blocks are emptied."""
        stride = max(stride for _, stride in self.blocks)
        for block, own in self.blocks:
            if own != stride:
                level = block.indices // np.uint32(own)
                block.indices[:] += level * np.uint32(stride - own)
        rows = SparseRows.concatenate([block for block, _ in self.blocks])
        self.blocks = []
        levels = int(rows.indices.max(initial=0)) // stride + 1
        lowest, highest = np.full(levels, stride, np.int64), np.full(levels, -1, np.int64)
        _extents(rows.indices, stride, lowest, highest)
        used = np.flatnonzero(highest >= 0)
        blurred = BlurredPanel(self.levels, used, lowest[used], (highest - lowest + 1)[used])
        kind = np.uint16 if blurred.width <= 1 << 16 else np.uint32
        shifts = np.zeros(levels, np.int64)
        shifts[used] = blurred.starts[:-1] - blurred.first - used * stride
        indices: NDArray[np.unsignedinteger] = np.empty(rows.indices.size, kind)
        in_bands(
            lambda first, last: _shift(rows.indices, stride, shifts, indices, first, last),
            indices.size,
            1 << 16,
        )
        return replace(rows, indices=indices, width=blurred.width, blurred=blurred)


class PointRows:
    """Rows of the full matrix, block by block: columns are panel pixels, row-major."""

    def __init__(self, spread: Spread, panel: tuple[int, int], aspect: float) -> None:
        self.spread, self.panel, self.aspect = spread, panel, aspect
        self.blocks: list[SparseRows] = []

    def add(self, given: SampleBlock) -> None:
        """Add the rows of a block of pixels."""
        (u, shift_u, circles), (v, shift_v, _) = given.axes[0], given.axes[1]
        rings = self.spread.rings()
        rest = 2.0 * self.spread.blur_px + self.spread.diffraction_px
        points = _points(float(circles.max(initial=0.0)), rest)
        lanes = (given.weights, u, v, shift_u, shift_v, circles, given.share, given.bounce)
        width, height = self.panel
        kept = (rings.values, rings.edge, rest, self.aspect, width, height)

        def merge(first: int, last: int, out: _Scratch) -> None:
            _merge_points(*lanes, *kept, *out, first, last)

        self.blocks.append(_merged(merge, given.weights.shape, points, width * height))

    def result(self) -> SparseRows:
        """Return all rows; the blocks are emptied."""
        return SparseRows.concatenate(self.blocks)


class _Scratch(NamedTuple):
    """Where a thread adds up a few pixels.

    Keys, sums and differences are (pixels, most), and ``counts`` says how many there are.
    ``added`` has a sum and a difference a key, and ``owner`` the pixel whose they are.
    """

    keys: NDArray[np.uint32]
    sums: NDArray[np.float32]
    differences: NDArray[np.float32]
    counts: NDArray[np.int32]
    added: NDArray[np.float32]
    owner: NDArray[np.int32]


def _merged(
    merge: Callable[[int, int, _Scratch], None], shape: tuple[int, ...], each: int, width: int
) -> SparseRows:
    """Merge samples (pixels, samples) of `each` entries into rows, a few pixels at a time.

    ``merge(first, last, scratch)`` adds up pixels first to last.
    """
    pixels, most = shape[0], max(1, shape[1] * each)
    step = max(1, min(pixels, _TEMPORARY // most))
    counts = np.zeros(pixels, np.int32)
    parts: dict[int, tuple[NDArray[Any], ...]] = {}

    def work(first: int, last: int) -> None:
        scratch = _Scratch(
            keys=np.empty((step, most), np.uint32),
            sums=np.empty((step, most), np.float32),
            differences=np.empty((step, most), np.float32),
            counts=np.empty(step, np.int32),
            added=np.empty((width, 2), np.float32),
            owner=np.full(width, -1, np.int32),
        )
        for start in range(first, last, step):
            stop = min(start + step, last)
            merge(start, stop, scratch)
            counts[start:stop] = scratch.counts[: stop - start]
            ends = row_starts(counts[start:stop])
            kinds = (np.uint32, np.float32, np.float32)
            parts[start] = tuple(np.empty(ends[-1], kind) for kind in kinds)
            _pack(*scratch[:3], ends, *parts[start])

    in_bands(work, pixels, _LEAST)
    ordered = [parts[start] for start in sorted(parts)]
    indices, data, halves = (np.concatenate(each) for each in zip(*ordered, strict=True))
    return SparseRows(row_starts(counts), indices, data, width, differences=halves)


@njit(cache=True, nogil=True)
def _sort(keys, n):  # type: ignore[no-untyped-def]
    """Sort the first n keys: D. L. Shell's "A high-speed sorting procedure" (CACM 2(7), 1959).

    Few are simply inserted.
    """
    gap = 1
    while n > _INSERTED and gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            value = keys[i]
            k = i
            while k >= gap and keys[k - gap] > value:
                keys[k] = keys[k - gap]
                k -= gap
            keys[k] = value
        gap //= 3


@njit(cache=True, nogil=True)
def _finish(keys, n, sums, differences, added):  # type: ignore[no-untyped-def]
    """Sort a pixel's keys and fetch their sums."""
    _sort(keys, n)
    for i in range(n):
        sums[i], differences[i] = added[keys[i], 0], added[keys[i], 1]


@njit(cache=True, nogil=True)
def _points(circle, rest):  # type: ignore[no-untyped-def]
    """Return the number of points for a disc and what the lens spreads besides, px."""
    radius = circle + rest
    if radius < SHARP:
        return 1
    return min(max(int(2.0 * np.pi * radius * radius), _LEAST_POINTS), _MOST_POINTS)


@njit(cache=True, nogil=True)
def _whole(weights, first, last):  # type: ignore[no-untyped-def]
    """Return whether a pixel sees all of the lens in one bounce, as far as it was looked at."""
    least = np.float32(0)
    for s in range(first, last):
        least = min(least, weights[s])
    return least >= np.float32(0)


@njit(cache=True, nogil=True)
def _one_level(weights, circles, zone, levels, first, last, known):  # type: ignore[no-untyped-def]
    """Give a pixel's samples of one bounce one level where theirs are neighbours.

    Their mean is as good as any of theirs, and the row has the nodes of one level.
    """
    least, most, total, count = 1 << 16, 0, 0, 0
    for s in range(first, last):
        if weights[s] <= 0.0:
            continue
        if not known:
            x = circles[s] * zone
            levels[s] = int(0.5 * math.log1p(x * x) / STEP + 0.5)
        level = int(levels[s])
        least, most = min(least, level), max(most, level)
        total, count = total + level, count + 1
    if 0 < most - least <= _NEIGHBOURS:
        mean = (2 * total + count) // (2 * count)
        for s in range(first, last):
            levels[s] = mean


@njit(cache=True, nogil=True, error_model="numpy")
def _merge_lines(  # type: ignore[no-untyped-def]
    weights, places, shifts, circles, levels, across, shifts_across, circles_across, share, bounce,
    lines, edge, size, origin, spacing, nodes, sharp, scale, stride,
    keys, sums, differences, counts, added, owner, first, last,
):  # fmt: skip
    """Add footprints along an axis up: a cubic B-spline over four nodes of a level."""
    parts = np.empty(4, np.float32)
    for p in range(first, last):
        own, n, whole = keys[p - first], 0, True
        number = bounce
        for s in range(weights.shape[1]):
            number += 1
            if number >= bounce:
                number, whole = 0, _whole(weights[p], s, s + bounce)
                zone = np.float32(1.0 if whole else share) / scale
                _one_level(weights[p], circles[p], zone, levels[p - first], s, s + bounce, whole)
            weight = weights[p, s]
            if weight <= 0.0:
                continue
            level, place = int(levels[p - first, s]), places[p, s]
            circle_across, place_across = circles_across[p, s], across[p, s]
            if not whole:
                place += shifts[p, s]
                circle_across *= share
                place_across += shifts_across[p, s]
            reach = circle_across + edge
            if place_across - reach < -0.5 or place_across + reach > size - 0.5:
                # The panel ends here: of a disc along one axis only so much lies on it.
                line = lines[int(circle_across / reach * (lines.shape[0] - 1) + 0.5)]
                inside = light(line, (size - 0.5 - place_across) / reach)
                inside -= light(line, (-0.5 - place_across) / reach)
                weight *= np.float32(inside)
                if weight <= 0.0:
                    continue
            at = (place - origin[level]) / spacing[level]
            if sharp[level]:
                low = math.floor(at + 0.5)
                high = low + 1
                parts[0] = 1.0
            else:
                low = math.floor(at) - 1
                high = low + 4
                t = at - low - 1
                parts[0] = (1.0 - t) ** 3 / 6.0
                parts[1] = 2.0 / 3.0 - t * t * (1.0 - 0.5 * t)
                parts[3] = t**3 / 6.0
                parts[2] = 1.0 - parts[0] - parts[1] - parts[3]
            if low < 0 or high > nodes[level]:
                continue
            half = weight if 2 * number < bounce else -weight
            for k in range(low, high):
                key = level * stride + k
                if owner[key] != p:
                    owner[key] = p
                    added[key, 0] = added[key, 1] = np.float32(0)
                    own[n] = key
                    n += 1
                added[key, 0] += weight * parts[k - low]
                added[key, 1] += half * parts[k - low]
        _finish(own, n, sums[p - first], differences[p - first], added)
        counts[p - first] = n


@njit(cache=True, nogil=True, error_model="numpy")
def _merge_points(  # type: ignore[no-untyped-def]
    weights, u, v, shift_u, shift_v, circles, share, bounce,
    rings, edge, rest, aspect, columns, lines,
    keys, sums, differences, counts, added, owner, first, last,
):  # fmt: skip
    """Add footprints in two dimensions up: points of equal shares on a turned spiral."""
    for p in range(first, last):
        own, n, whole = keys[p - first], 0, True
        for s in range(weights.shape[1]):
            if s % bounce == 0:
                whole = _whole(weights[p], s, s + bounce)
            if weights[p, s] <= 0.0:
                continue
            circle, u0, v0 = circles[p, s], u[p, s], v[p, s]
            if not whole:
                circle, u0, v0 = circle * share, u0 + shift_u[p, s], v0 + shift_v[p, s]
            points = _points(circle, rest)
            weight = weights[p, s] / points
            half = weight if s % bounce < bounce // 2 else -weight
            reach = circle + edge
            ring = rings[int(circle / reach * (rings.shape[0] - 1) + 0.5)]
            # Fractions of a place are as good as random for the turn of the spiral.
            turn = 2.0 * np.pi * ((u0 * 7.31 + v0 * 3.77) % 1.0)
            for m in range(points):
                x, y = u0, v0
                if points > 1:
                    energy = (m + 0.5) / points
                    place = np.sqrt(energy) * (ring.size - 1)
                    k = min(int(place), ring.size - 2)
                    radius = ring[k] + (place - k) * (ring[k + 1] - ring[k])
                    radius *= reach / (1.0 - energy + RING_SOFTENING)
                    angle = turn + m * _GOLDEN_ANGLE
                    x += radius * np.cos(angle)
                    y += radius * np.sin(angle) * aspect
                column, line = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
                if column < 0 or line < 0 or column >= columns or line >= lines:
                    continue
                key = line * columns + column
                if owner[key] != p:
                    owner[key] = p
                    added[key, 0] = added[key, 1] = np.float32(0)
                    own[n] = key
                    n += 1
                added[key, 0] += weight
                added[key, 1] += half
        _finish(own, n, sums[p - first], differences[p - first], added)
        counts[p - first] = n


@njit(cache=True, nogil=True)
def _pack(keys, sums, differences, ends, indices, data, halves):  # type: ignore[no-untyped-def]
    for p in range(ends.size - 1):
        start = ends[p]
        for i in range(ends[p + 1] - start):
            indices[start + i] = keys[p, i]
            data[start + i] = sums[p, i]
            halves[start + i] = differences[p, i]


@njit(cache=True, nogil=True)
def _extents(keys, stride, lowest, highest):  # type: ignore[no-untyped-def]
    for key in keys:
        level, node = key // stride, key % stride
        lowest[level] = min(lowest[level], node)
        highest[level] = max(highest[level], node)


@njit(cache=True, nogil=True)
def _shift(keys, stride, shifts, out, first, last):  # type: ignore[no-untyped-def]
    for i in range(first, last):
        out[i] = keys[i] + shifts[keys[i] // stride]
