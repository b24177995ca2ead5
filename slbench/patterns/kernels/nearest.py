"""The panel pixel whose vector is nearest to a camera pixel's, among hundreds of thousands.

A k-d tree (J. L. Bentley, CACM 18(9), 1975) of equal leaves, its nodes numbered as those of a heap,
with the box of each node.  A leaf is gone through at once, place beside place.  What a camera
pixel's neighbour has found, and the panel pixels around it, come first: in most pictures the tree
is then only asked whether there is a nearer one.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.patterns.kernels.blocks import FAST

#: Places of a leaf.
LEAF = 64
#: Most that a rival is away from the best place, px along each axis.
FARTHEST = 8
#: Panel pixels on either side of what a neighbour has found that are looked at first.
AROUND = 3


@dataclass(frozen=True)
class Tree:
    """A k-d tree of V unit vectors of N numbers, in L leaves.

    Parameters
    ----------
    low, high : (2 L, N) float32
        Box of each node; node 1 is the root, ``2 k`` and ``2 k + 1`` stand below node `k`.
    leaves : (L, N, LEAF) float32
        Vectors, filled up with what is far from all.
    places : (L, LEAF) int32
        Which places they are; -1 where filled up.
    """

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    leaves: NDArray[np.float32]
    places: NDArray[np.int32]

    @classmethod
    def of(cls, vectors: NDArray[np.float32], places: NDArray[np.intp]) -> "Tree":
        """Return the tree of unit vectors (V, N) of panel pixels `places` (V,)."""
        depth = max(int(np.ceil(np.log2(len(vectors) / LEAF))), 0)
        count = 1 << depth
        order = np.arange(len(vectors))
        edges = np.array([0, len(vectors)])
        for _ in range(depth):
            middles = (edges[:-1] + edges[1:]) // 2
            for start, middle, stop in zip(edges[:-1], middles, edges[1:], strict=True):
                own = vectors[order[start:stop]]
                widest = own[:, np.argmax(np.ptp(own, axis=0))]
                order[start:stop] = order[start:stop][np.argpartition(widest, middle - start)]
            edges = np.sort(np.concatenate((edges, middles)))
        frames = vectors.shape[1]
        low, high = np.empty((2, 2 * count, frames), np.float32)
        leaves = np.full((count, frames, LEAF), 1e3, np.float32)
        numbers = np.full((count, LEAF), -1, np.int32)
        for leaf, (start, stop) in enumerate(pairwise(edges)):
            own = vectors[order[start:stop]]
            low[count + leaf], high[count + leaf] = own.min(axis=0), own.max(axis=0)
            leaves[leaf, :, : stop - start] = own.T
            numbers[leaf, : stop - start] = places[order[start:stop]]
        for node in range(count - 1, 0, -1):
            low[node] = np.minimum(low[2 * node], low[2 * node + 1])
            high[node] = np.maximum(high[2 * node], high[2 * node + 1])
        return cls(low, high, leaves, numbers)


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _outside(query: Any, low: Any, high: Any, node: int) -> Any:
    """Return the squared distance of a vector from the box of a node."""
    total = np.float32(0.0)
    for k in range(query.shape[0]):
        out = max(max(low[node, k] - query[k], query[k] - high[node, k]), np.float32(0.0))
        total += out * out
    return total


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _distances(query: Any, leaf: Any, squares: Any) -> None:
    """Write the squared distances of a vector from those of a leaf (N, LEAF)."""
    squares[:] = 0.0
    for k in range(query.shape[0]):
        value = query[k]
        for i in range(LEAF):
            squares[i] += (leaf[k, i] - value) ** 2


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def find(
    queries: Any, panel: Any, width: int, low: Any, high: Any, leaves: Any, places: Any,
    chosen: Any, own: Any, apart: Any, limit: Any, doubt: Any, best: Any, distance: Any,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Find the nearest vector of pixels ``chosen[start:stop]``, or a rival of what they have.

    Parameters
    ----------
    queries : (P, N) float32
        Unit vectors.
    panel : (H W, N) float32
        Unit vectors of all panel pixels; NaN for those without a code.
    width : int
        Panel pixels of a row.
    low, high, leaves, places
        See :class:`Tree`.
    chosen : (M,) int64
        Pixels to look at.
    own : (P,) int64
        Place that a pixel has; -1 to search for it.
    apart : (2, P) float32
        Columns and rows that a rival is away from it, at least along one of them more.
    limit : (P,) float32
        Squared distance beyond which nothing is looked at.
    doubt : (P,) float32
        Squared distance below which two places far from each other show that nothing can be sure:
        the search is given up.
    best : (P,) int32
        Written: the nearest place, or the first rival that is found; -1 without one, or given up.
    distance : (P,) float32
        Written: its squared distance.
    """
    depth = 2 * int(np.log2(leaves.shape[0])) + 4
    waiting, far = np.empty(depth, np.int64), np.empty(depth, np.float32)
    squares = np.empty(LEAF, np.float32)
    first = leaves.shape[0]
    before = -1
    for p in chosen[start:stop]:
        query = queries[p]
        radius, found, mine = limit[p], -1, own[p]
        row, column = mine // width, mine % width
        witness, doubtful = -1, doubt[p]
        if mine < 0 and before >= 0:
            middle, line = before % width, before // width
            for y in range(max(line - AROUND, 0), min(line + AROUND + 1, panel.shape[0] // width)):
                for x in range(max(middle - AROUND, 0), min(middle + AROUND + 1, width)):
                    place = y * width + x
                    square = np.float32(0.0)
                    for k in range(query.shape[0]):
                        square += (panel[place, k] - query[k]) ** 2
                    if square < radius:
                        radius, found = square, place
        waiting[0], far[0], count = 1, 0.0, 1
        while count > 0:
            count -= 1
            node = waiting[count]
            if far[count] >= radius:
                continue
            if node < first:
                left = _outside(query, low, high, 2 * node)
                right = _outside(query, low, high, 2 * node + 1)
                # The nearer child is taken from the top of the pile.
                nearer = 0 if left <= right else 1
                waiting[count], far[count] = 2 * node + 1 - nearer, max(left, right)
                waiting[count + 1], far[count + 1] = 2 * node + nearer, min(left, right)
                count += 2
                continue
            _distances(query, leaves[node - first], squares)
            for i in range(LEAF):
                if squares[i] < doubtful:
                    place = places[node - first, i]
                    if witness < 0:
                        witness = place
                    across = abs(place % width - witness % width)
                    if max(across, abs(place // width - witness // width)) > 2 * FARTHEST:
                        count, found = 0, -1
                        break
                if squares[i] < radius:
                    place = places[node - first, i]
                    if mine >= 0:
                        across, along = abs(place % width - column), abs(place // width - row)
                        if across <= apart[0, p] and along <= apart[1, p]:
                            continue
                        count = 0
                    radius, found = squares[i], place
        best[p], distance[p] = found, radius
        if found >= 0 and mine < 0:
            before = found
