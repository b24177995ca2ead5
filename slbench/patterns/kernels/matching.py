"""The loops of matching: the place whose code vector a pixel's frames fit best, and its refinement.

*Search.*  Orthonormal vectors ``q_j(x)`` span what a place may show beyond the offsets; the score
is the sum of squares of the frames' components along them, where those are positive (a gain is).
With one vector it is the square of the zero-mean normalised cross-correlation times the energy of
the frames about their mean.  Every place is tried.  Scores of a block of pixels stay in the
second-level cache; the highest of each group of places is kept, so that they are gone through once.

*Refinement.*  Gauss-Newton on the place, the gains and offsets eliminated by orthogonalisation,
every frame with the weight of its own noise.  What is left of the derivative once gains and offsets
have taken their parts is the Fisher information F of the place.  Where a lens has blurred what was
shown, the residual r is no noise, and the likelihood's own curvature K = F - c'' r is less: noise
moves its summit by the variance F / K^2 (P. J. Huber, Proc. 5th Berkeley Symp. 1, 1967).
"""

from math import sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.patterns.kernels.blocks import FAST

#: Pixels of a block: its scores at a thousand places are 128 kB.
BLOCK = 64
#: Places of a group, whose highest score is kept.
GROUP = 8
#: Frames that are multiplied and added at once, while a sum is in a register.
CHUNK = 4
#: Panel pixels beside the best that are of the same peak whatever their scores: a camera pixel may
#: see both.
NEAR = 2


def padded(basis: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a basis (X, J, N) with null vectors and frames up to whole groups and chunks."""
    places, _, frames = basis.shape
    return np.pad(basis, ((0, -places % GROUP), (0, 0), (0, -frames % CHUNK)))


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _score(block: Any, basis: Any, x: int, scores: Any, one: Any, two: Any) -> None:
    """Write the scores of places `x` and ``x + 1`` for a block of pixels.

    Two places by four frames: what the loops load serves several products.
    """
    zero = np.float32(0.0)
    for j in range(basis.shape[1]):
        for k in range(0, basis.shape[2], CHUNK):
            a0, a1 = basis[x, j, k], basis[x, j, k + 1]
            a2, a3 = basis[x, j, k + 2], basis[x, j, k + 3]
            b0, b1 = basis[x + 1, j, k], basis[x + 1, j, k + 1]
            b2, b3 = basis[x + 1, j, k + 2], basis[x + 1, j, k + 3]
            if k == 0:
                for b in range(BLOCK):
                    v0, v1, v2, v3 = block[0, b], block[1, b], block[2, b], block[3, b]
                    one[b] = a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
                    two[b] = b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3
            else:
                for b in range(BLOCK):
                    v0, v1 = block[k, b], block[k + 1, b]
                    v2, v3 = block[k + 2, b], block[k + 3, b]
                    one[b] += a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
                    two[b] += b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3
        if j == 0:
            for b in range(BLOCK):
                u, v = max(one[b], zero), max(two[b], zero)
                scores[x, b] = u * u
                scores[x + 1, b] = v * v
        else:
            for b in range(BLOCK):
                u, v = max(one[b], zero), max(two[b], zero)
                scores[x, b] += u * u
                scores[x + 1, b] += v * v


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def search(
    pixels: Any, basis: Any, beside: int, first: Any, last: Any, best: Any, energy: Any, rival: Any,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Find the best place of pixels ``start`` to ``stop``, and the best of another peak.

    Parameters
    ----------
    pixels : (N, P) float32
        The frames of the code.
    basis : (X, J, N) float32
        Of whole groups of places and chunks of frames (:func:`padded`).
    beside : int
        Places beside the best that are of the same peak whatever their scores.
    first, last : (P,) int32
        Places between which to search, both included.
    best : (P,) int32
        Written: the place of the highest score.
    energy, rival : (P,) float32
        Written: its score, and that of the best place of another peak (zero without one), DN^2.
    """
    n_frames = pixels.shape[0]
    scores = np.empty((basis.shape[0], BLOCK), np.float32)
    tops = np.empty((basis.shape[0] // GROUP, BLOCK), np.float32)
    block = np.zeros((basis.shape[2], BLOCK), np.float32)
    one, two = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    for begin in range(start, stop, BLOCK):
        size = min(BLOCK, stop - begin)
        low, high = basis.shape[0], 0
        common_low, common_high = 0, basis.shape[0]
        for b in range(size):
            mean = np.float32(0.0)
            for k in range(n_frames):
                mean += pixels[k, begin + b]
            mean /= n_frames
            for k in range(n_frames):
                block[k, b] = pixels[k, begin + b] - mean
            low = min(low, first[begin + b])
            high = max(high, last[begin + b] + 1)
            common_low = max(common_low, first[begin + b])
            common_high = min(common_high, last[begin + b] + 1)
        low, high = low // GROUP, (high + GROUP - 1) // GROUP
        for g in range(low, high):
            x = g * GROUP
            for y in range(x, x + GROUP, 2):
                _score(block, basis, y, scores, one, two)
            if x < common_low or x + GROUP > common_high:
                for b in range(size):
                    for y in range(x, x + GROUP):
                        if y < first[begin + b] or y > last[begin + b]:
                            scores[y, b] = -1.0
            for b in range(BLOCK):
                tops[g, b] = max(
                    max(
                        max(scores[x, b], scores[x + 1, b]),
                        max(scores[x + 2, b], scores[x + 3, b]),
                    ),
                    max(
                        max(scores[x + 4, b], scores[x + 5, b]),
                        max(scores[x + 6, b], scores[x + 7, b]),
                    ),
                )
        low_place, high_place = low * GROUP, high * GROUP - 1
        for b in range(size):
            group, top = low, np.float32(-1.0)
            for g in range(low, high):
                if tops[g, b] > top:
                    group, top = g, tops[g, b]
            centre = group * GROUP
            while scores[centre, b] < top:
                centre += 1
            x = centre
            while x > low_place and scores[x - 1, b] <= scores[x, b]:
                x -= 1
            left = max(min(x, centre - beside), low_place)
            x = centre
            while x < high_place and scores[x + 1, b] <= scores[x, b]:
                x += 1
            right = min(max(x, centre + beside), high_place)
            # What is beside the peak in the groups that it ends in; the others are whole.
            second = np.float32(0.0)
            for y in range(left // GROUP * GROUP, left):
                second = max(second, scores[y, b])
            for y in range(right + 1, (right // GROUP + 1) * GROUP):
                second = max(second, scores[y, b])
            for g in range(low, left // GROUP):
                second = max(second, tops[g, b])
            for g in range(right // GROUP + 1, high):
                second = max(second, tops[g, b])
            best[begin + b] = centre
            energy[begin + b] = top
            rival[begin + b] = second


#: Share of the slope's square that is left beside gain and offset, below which there is none.
LEAST_SLOPE = 1e-9
#: Least curvature, of the Fisher information: less is no summit.
LEAST_CURVATURE = 0.2


@njit(cache=True, nogil=True)
def refine(
    pixels: Any, pieces: Any, groups: Any, offsets: Any, reach: Any, half: float, noise: Any,
    best: Any, place: Any, information: Any, gain: Any, residual: Any, whole_place: Any,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Refine the best places below a pixel, and find how well they are known.

    Parameters
    ----------
    pixels : (N, P) float32
    pieces : (X - 1, 4, N) float64
        Cubic between places ``x`` and ``x + 1``, coefficients of ``t^0`` to ``t^3``.
    groups, offsets : (N,) int64
        Which gain and which offset a frame has, numbered from zero.
    reach : (X,) float64
        How far from a place the refined one may lie.
    half : float
        Half a panel pixel, in places: as far as the panel goes beyond the outer ones.
    noise : (3,) float64
        Constant variance, gain and offset of the noise (:class:`NoiseModel`).
    best : (P,) int32
    place, information : (P,) float64
        Written: the refined place, and the inverse of its variance, px^-2.
    gain, residual : (P,) float64
        Written: the least gain, and the sum of squared residuals over their variances.
    whole_place : (P,) float64
        Written: that sum at the best place itself.
    """
    n_frames = pixels.shape[0]
    n_gains, n_offsets = groups.max() + 1, offsets.max() + 1
    n_linear = n_gains + n_offsets
    columns = np.empty((n_linear, n_frames))
    triangle = np.empty((n_linear, n_linear))
    solution = np.empty(n_linear)
    rest, root = np.empty(n_frames), np.empty(n_frames)
    value, slope, bend = np.empty(n_frames), np.empty(n_frames), np.empty(n_frames)
    last = float(pieces.shape[0])
    for p in range(start, stop):
        for k in range(n_frames):
            light = max(float(pixels[k, p]) - noise[2], 0.0)
            root[k] = 1.0 / sqrt(noise[0] + noise[1] * light)
        centre = float(best[p])
        allowed = reach[best[p]]
        x = centre
        fisher, curvature = 0.0, 1.0
        for step_number in range(12):
            piece = min(int(max(x, 0.0)), pieces.shape[0] - 1)
            t = x - piece
            for k in range(n_frames):
                a, b, c, d = (
                    pieces[piece, 0, k], pieces[piece, 1, k],
                    pieces[piece, 2, k], pieces[piece, 3, k],
                )  # fmt: skip
                value[k] = a + t * (b + t * (c + t * d))
                slope[k] = b + t * (2.0 * c + t * 3.0 * d)
                bend[k] = 2.0 * c + t * 6.0 * d
            columns[:] = 0.0
            for k in range(n_frames):
                columns[offsets[k], k] = root[k]
                columns[n_offsets + groups[k], k] = root[k] * value[k]
                rest[k] = root[k] * pixels[k, p]
            for i in range(n_linear):
                for j in range(i):
                    dot = 0.0
                    for k in range(n_frames):
                        dot += columns[j, k] * columns[i, k]
                    triangle[j, i] = dot
                    for k in range(n_frames):
                        columns[i, k] -= dot * columns[j, k]
                norm = 0.0
                for k in range(n_frames):
                    norm += columns[i, k] ** 2
                norm = sqrt(norm)
                triangle[i, i] = norm
                if norm < 1e-9:
                    norm = np.inf
                dot = 0.0
                for k in range(n_frames):
                    columns[i, k] /= norm
                    dot += columns[i, k] * rest[k]
                solution[i] = dot
                for k in range(n_frames):
                    rest[k] -= dot * columns[i, k]
            for i in range(n_linear - 1, -1, -1):
                for j in range(i + 1, n_linear):
                    solution[i] -= triangle[i, j] * solution[j]
                solution[i] = solution[i] / triangle[i, i] if triangle[i, i] >= 1e-9 else 0.0
            smallest = np.inf
            for i in range(n_offsets, n_linear):
                smallest = min(smallest, solution[i])
            gain[p] = smallest
            total = 0.0
            for k in range(n_frames):
                total += rest[k] ** 2
            residual[p] = total
            if step_number == 0:
                whole_place[p] = total
            whole, turned = 0.0, 0.0
            for k in range(n_frames):
                factor = root[k] * solution[n_offsets + groups[k]]
                slope[k] *= factor
                whole += slope[k] ** 2
                turned += factor * bend[k] * rest[k]
            for i in range(n_linear):
                dot = 0.0
                for k in range(n_frames):
                    dot += columns[i, k] * slope[k]
                for k in range(n_frames):
                    slope[k] -= dot * columns[i, k]
            fisher, moment = 0.0, 0.0
            for k in range(n_frames):
                fisher += slope[k] ** 2
                moment += slope[k] * rest[k]
            if not fisher > LEAST_SLOPE * whole:
                # All frames turn over here, as those of an exclusive or do: gain and offset follow
                # every place between.
                fisher = 0.0
                break
            curvature = max(1.0 - turned / fisher, LEAST_CURVATURE)
            step = min(max(moment / fisher, -0.5), 0.5)
            moved = min(max(x + step, centre - allowed), centre + allowed)
            moved = min(max(moved, -half), last + half)
            step = moved - x
            x = moved
            if abs(step) < 1e-4:
                break
        place[p] = x
        information[p] = fisher * curvature**2
