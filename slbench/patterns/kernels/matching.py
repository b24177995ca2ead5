"""The loops of matching: the place whose code vector a pixel's frames fit best, and its refinement.

*Search.*  Orthonormal vectors ``q_j(x)`` span what a place may show beyond the offsets; the score
is the sum of squares of the frames' components along them, where those are positive (a gain is).
With one vector it is the square of the zero-mean normalised cross-correlation times the energy of
the frames about their mean.  Scores of a block of pixels stay in the second-level cache.

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

from slbench.patterns.kernels.blocks import FAST

#: Pixels of a block: its scores at a thousand places are 128 kB.
BLOCK = 64
#: Places beside the best that are of the same peak whatever their scores: a pixel may see both.
NEAR = 2


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def search(
    pixels: Any, basis: Any, first: Any, last: Any, best: Any, energy: Any, rival: Any,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Find the best place of pixels ``start`` to ``stop``, and the best of another peak.

    Parameters
    ----------
    pixels : (N, P) float32
        The frames of the code.
    basis : (X, J, N) float32
    first, last : (P,) int32
        Places between which to search, both included.
    best : (P,) int32
        Written: the place of the highest score.
    energy, rival : (P,) float32
        Written: its score, and that of the best place of another peak (zero without one), DN^2.
    """
    n_frames = pixels.shape[0]
    places, vectors = basis.shape[0], basis.shape[1]
    scores = np.empty((places, BLOCK), np.float32)
    block = np.empty((n_frames, BLOCK), np.float32)
    sums = np.empty(BLOCK, np.float32)
    # Places are single numbers too, which lie side by side with scores in the registers.
    top, where = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    left, right = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    zero = np.float32(0.0)
    second = np.empty(BLOCK, np.float32)
    for begin in range(start, stop, BLOCK):
        size = min(BLOCK, stop - begin)
        block[:] = 0.0
        low, high = places, 0
        for b in range(size):
            mean = np.float32(0.0)
            for k in range(n_frames):
                mean += pixels[k, begin + b]
            mean /= n_frames
            for k in range(n_frames):
                block[k, b] = pixels[k, begin + b] - mean
            low = min(low, first[begin + b])
            high = max(high, last[begin + b] + 1)
        narrow = low > 0 or high < places
        for b in range(size):
            narrow |= first[begin + b] > low or last[begin + b] < high - 1
        for b in range(BLOCK):
            top[b], where[b] = -1.0, low
        for x in range(low, high):
            for j in range(vectors):
                factor = basis[x, j, 0]
                for b in range(BLOCK):
                    sums[b] = factor * block[0, b]
                for k in range(1, n_frames):
                    factor = basis[x, j, k]
                    for b in range(BLOCK):
                        sums[b] += factor * block[k, b]
                for b in range(BLOCK):
                    part = sums[b]
                    part = part if part > zero else zero
                    before = scores[x, b] if j > 0 else zero
                    scores[x, b] = before + part * part
            if narrow:
                for b in range(size):
                    if x < first[begin + b] or x > last[begin + b]:
                        scores[x, b] = -1.0
            here = np.float32(x)
            for b in range(BLOCK):
                value, highest, place = scores[x, b], top[b], where[b]
                where[b] = here if value > highest else place
                top[b] = value if value > highest else highest
        for b in range(BLOCK):
            centre = int(where[b])
            x = centre
            while x > low and scores[x - 1, b] <= scores[x, b]:
                x -= 1
            left[b] = min(x, centre - NEAR)
            x = centre
            while x < high - 1 and scores[x + 1, b] <= scores[x, b]:
                x += 1
            right[b] = max(x, centre + NEAR)
            second[b] = 0.0
        for x in range(low, high):
            here = np.float32(x)
            for b in range(BLOCK):
                value, highest = scores[x, b], second[b]
                other = (here < left[b]) | (here > right[b])
                second[b] = value if other & (value > highest) else highest
        for b in range(size):
            best[begin + b] = int(where[b])
            energy[begin + b] = top[b]
            rival[begin + b] = second[b]


#: Share of the slope's square that is left beside gain and offset, below which there is none.
LEAST_SLOPE = 1e-9
#: Least curvature, of the Fisher information: less is no summit.
LEAST_CURVATURE = 0.2


@njit(cache=True, nogil=True)
def refine(
    pixels: Any, pieces: Any, groups: Any, offsets: Any, reach: Any, noise: Any,
    best: Any, place: Any, information: Any, gain: Any, residual: Any, start: int, stop: int,
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
    noise : (3,) float64
        Constant variance, gain and offset of the noise (:class:`NoiseModel`).
    best : (P,) int32
    place, information : (P,) float64
        Written: the refined place, and the inverse of its variance, px^-2.
    gain, residual : (P,) float64
        Written: the least gain, and the sum of squared residuals over their variances.
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
        for _ in range(12):
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
            moved = min(max(moved, -0.5), last + 0.5)
            step = moved - x
            x = moved
            if abs(step) < 1e-4:
                break
        place[p] = x
        information[p] = fisher * curvature**2
