"""Compiled loops that decode the fringe sets of one axis in one pass over their frames.

Vector instructions need an arc tangent without branches or calls, hence the polynomial below.
"""

import math
from typing import Any

import numpy as np
from numba import boolean, float32, float64, int64, njit, uint8, void

from slbench.patterns.kernels.blocks import BLOCK, FAST, FRAMES, PAD

# A pixel is not told apart from the other end of the panel within this many standard
# deviations (fringes alone code the panel as a circle).
END_SIGMAS = 3.0

TWO_PI = 2.0 * math.pi
ROOT_3 = math.sqrt(3.0)
# Faults of a pixel, a bit each; what is first is the cause of those that follow.
_SATURATED, _DIM, _COARSE, _ORDER, _END = 1, 2, 4, 8, 16
# Noise puts a pixel beyond the end of the panel by no more than this, finest fringes.
_BEYOND = 0.25

# atan(t)/t as a polynomial in t^2 on [0, 1]: Chebyshev interpolation of degree 17, computed
# in extended precision.  Its error is below 1e-15.
_ATAN = (
    0.9999999999999989,
    -0.33333333333263054,
    0.19999999992239326,
    -0.14285713944806105,
    0.11111103176823416,
    -0.09090796078620071,
    0.07691234183949187,
    -0.06659472643502581,
    0.05846984819645122,
    -0.05131901809763576,
    0.043860350489841264,
    -0.03501816332245653,
    0.02476285435931459,
    -0.014612809913960518,
    0.006739821006485727,
    -0.0022397252451628446,
    0.0004717596271075308,
    -4.696723073720932e-05,
)


@njit(fastmath=FAST, error_model="numpy")
def angle(y: float, x: float) -> float:
    """Return atan2(y, x) in [0, 2 pi) to 2e-15 rad, NaN for (0, 0), without branches."""
    ax, ay = abs(x), abs(y)
    t = min(ax, ay) / max(ax, ay)
    z = t * t
    r = _ATAN[17]
    r = r * z + _ATAN[16]
    r = r * z + _ATAN[15]
    r = r * z + _ATAN[14]
    r = r * z + _ATAN[13]
    r = r * z + _ATAN[12]
    r = r * z + _ATAN[11]
    r = r * z + _ATAN[10]
    r = r * z + _ATAN[9]
    r = r * z + _ATAN[8]
    r = r * z + _ATAN[7]
    r = r * z + _ATAN[6]
    r = r * z + _ATAN[5]
    r = r * z + _ATAN[4]
    r = r * z + _ATAN[3]
    r = r * z + _ATAN[2]
    r = r * z + _ATAN[1]
    r = r * z + _ATAN[0]
    r = r * t
    r = 0.5 * math.pi - r if ay > ax else r
    r = math.pi - r if x < 0.0 else r
    return TWO_PI - r if y < 0.0 else r


@njit(fastmath=FAST, error_model="numpy", no_cpython_wrapper=True)
def _read(
    frames: Any,
    checked: Any,
    most: Any,
    first: int,
    shifts: int,
    weights: Any,
    start: int,
    sums: Any,
    flags: Any,
    n: int,
) -> None:
    """Sum the frames of one fringe set over a block; search those that are to be checked.

    The sums are plain, and the Fourier components.  Pixels are flagged that have a value above
    `most`, or none that is a number.
    """
    for k in range(checked.shape[0]):
        row = checked[k]
        for i in range(n):
            # The comparison is this way round so that NaN is flagged.
            flags[i] |= np.uint8(0) if frames[row, start + i] <= most else np.uint8(1)
    total, cosine, sine = sums[0], sums[1], sums[2]
    for i in range(n):
        total[i] = 0.0
        cosine[i] = 0.0
        sine[i] = 0.0
    # Four frames at a time quarter the traffic of the sums; the last are filled up with
    # repeats of the very last, of weight zero.
    for k in range(0, shifts, 4):
        row0, row1 = first + k, first + min(k + 1, shifts - 1)
        row2, row3 = first + min(k + 2, shifts - 1), first + min(k + 3, shifts - 1)
        c0, c1, c2, c3 = weights[k, 0], weights[k + 1, 0], weights[k + 2, 0], weights[k + 3, 0]
        s0, s1, s2, s3 = weights[k, 1], weights[k + 1, 1], weights[k + 2, 1], weights[k + 3, 1]
        w1 = 1.0 if k + 1 < shifts else 0.0
        w2 = 1.0 if k + 2 < shifts else 0.0
        w3 = 1.0 if k + 3 < shifts else 0.0
        for i in range(n):
            at = start + i
            value0, value1 = np.float64(frames[row0, at]), np.float64(frames[row1, at])
            value2, value3 = np.float64(frames[row2, at]), np.float64(frames[row3, at])
            total[i] += (value0 + w1 * value1) + (w2 * value2 + w3 * value3)
            cosine[i] = (cosine[i] + (c0 * value0 + c1 * value1)) + (c2 * value2 + c3 * value3)
            sine[i] = (sine[i] + (s0 * value0 + s1 * value1)) + (s2 * value2 + s3 * value3)


@njit(fastmath=FAST, error_model="numpy", no_cpython_wrapper=True)
def _unwrap(
    link: Any, ratio: float, limit: float, slack: Any, absolute: Any, faults: Any, off: Any, n: int
) -> None:
    """Unwrap a phase from the absolute one before it, which it replaces.

    A pixel is at fault whose order is off a whole number by more than `limit` and `slack`.
    """
    for i in range(n):
        exact = (ratio * absolute[i] - link[i]) / TWO_PI
        order = np.floor(exact + 0.5)
        off[i] = exact - order
        absolute[i] = TWO_PI * order + link[i]
        faults[i] |= 0 if abs(exact - order) <= limit + slack[i] else _ORDER


@njit(fastmath=FAST, error_model="numpy", no_cpython_wrapper=True)
def _search(
    phases: Any, counts: Any, closed: bool, limit: float, absolute: Any, faults: Any, n: int
) -> None:
    """Take the combination of orders whose phases agree best (number-theoretic)."""
    last = counts.shape[0] - 1
    finest = counts[last]
    squares = 0.0
    for s in range(last + 1):
        squares += counts[s] * counts[s]
    rows = np.empty((4, BLOCK + PAD))
    total, along, best, order = rows[0], rows[1], rows[2], rows[3]
    for i in range(n):
        best[i] = np.inf
        order[i] = 0.0
    top = int(np.ceil(finest - 1e-9))
    for k in range(0 if closed else -1, top if closed else top + 1):
        for i in range(n):
            total[i] = 0.0
            along[i] = 0.0
        for s in range(last):
            ratio = counts[s] / finest
            link = phases[s]
            for i in range(n):
                exact = ratio * (phases[last, i] / TWO_PI + k) - link[i] / TWO_PI
                off = exact - np.floor(exact + 0.5)
                total[i] += off * off
                along[i] += counts[s] * off
        for i in range(n):
            place = phases[last, i] / TWO_PI + k
            apart = total[i] - along[i] * along[i] / squares
            inside = closed | ((place >= -_BEYOND) & (place <= finest + _BEYOND))
            better = (apart < best[i]) & inside
            best[i] = apart if better else best[i]
            order[i] = k if better else order[i]
    for i in range(n):
        absolute[i] = phases[last, i] + TWO_PI * order[i]
        faults[i] |= 0 if (best[i] <= limit * limit) & (best[i] < np.inf) else _ORDER


@njit
def _first_rule(faults: int) -> int:
    """Return the number of the lowest bit that is set, from 1; 0 for none."""
    if faults == 0:
        return 0
    rule = 1
    while not faults & (1 << (rule - 1)):
        rule += 1
    return rule


@njit(
    void(
        FRAMES,
        int64,
        int64[::1],
        int64[:, ::1],
        float64[:, :, ::1],
        float64[:, ::1],
        float64[::1],
        int64,
        float64[::1],
        float64[:, ::1],
        float64[::1],
        boolean[::1],
        float64,
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float32[::1],
        float32[::1],
        boolean[::1],
        float64[:, ::1],
        float32[:, ::1],
        uint8[::1],
        int64,
        int64,
    ),
    fastmath=FAST,
    error_model="numpy",
    nogil=True,
    cache=True,
)
def decode_fringes(
    frames: Any,
    kind: int,
    checked: Any,
    sets: Any,
    weights: Any,
    tilts: Any,
    harmonics: Any,
    way: int,
    counts: Any,
    factors: Any,
    links: Any,
    compares: Any,
    size: float,
    scale: Any,
    reference: Any,
    reference_sigma: Any,
    noise: Any,
    limits: Any,
    coordinate: Any,
    sigma: Any,
    modulation: Any,
    mean: Any,
    mask: Any,
    relative: Any,
    residual: Any,
    dropped: Any,
    begin: int,
    end: int,
) -> None:
    """Decode the fringe sets of one panel axis at pixels `begin` to `end`.

    Parameters
    ----------
    frames, kind : tuple of (F, P) arrays, int
        Frames, one row each (:func:`slbench.patterns.kernels.blocks.by_type`).
    checked : (C,) int64
        Indices of the frames that are searched for saturated and non-finite pixels.
    sets : (S, 2) int64
        First frame and number of frames N of each set, by rising fringe count.
    weights : (S, K, 2) float64
        Weights of the frames of each set, scaled as cos and sin for k < N; zero from there to K,
        the largest N rounded up to a multiple of four.
    tilts : (S, 2) float64
        What of both components is in the sum of each set's frames, beside N times their mean.
    harmonics : (0,), (1,) or (7,) float64
        How the noise of the last set varies with its phase: not at all, as that of three equal
        steps, or by these forms (:func:`slbench.patterns.fringes.weights.noise_forms`).
    way : int
        0: unwrapped along a chain; 1: by the best combination of orders; 2: not unwrapped.
    counts : (S,) float64
        Fringes across the panel.
    factors : (T, S) float64
        Of each link of the chain: multiples of the sets' phases that are summed.
    links : (T,) float64
        Fringes of each link.
    compares : (T,) bool
        Links that are only compared with the last absolute phase.
    size : float
        Panel pixels along the axis.
    scale : (3,) float64
        Of the last set: pixels per radian, radians of the whole panel, whole panels per radian
        (zero where the panel is not closed).
    reference : (P,) float64
        Coordinate from a coarser code, px, that the first link is unwrapped from, or shape (0,)
        where it is absolute itself.
    reference_sigma : (P,) or (1,) float64
        Deviation of the coarser code's coordinate, px, as that of a uniform error; or shape (0,).
    noise : (3,) float64
        Noise variance at the offset, variance per DN above it, offset.
    limits : (4,) float64
        Largest value that is not saturated, least squared modulation, least squared ratio of
        modulation to noise, largest residual of an order.
    coordinate, sigma : (P,) float64
        Panel coordinate and its standard deviation in pixels, NaN where masked out; written, as
        are those that follow.  They may be `reference` and `reference_sigma`.
    modulation, mean : (P,) float32
        Of the last set.
    mask : (P,) bool
    relative : (S, P) float64
        Relative phase of every set, or shape (S, 0) when it is not wanted.
    residual : (S, P) float32
        Fringe order of every set less the whole number it is rounded to, turns, or shape (S, 0);
        not written for a set whose order is not found.
    dropped : (P,) uint8
        By which rule a pixel is masked out (:class:`slbench.patterns.base.Rule`), or shape (0,).
    begin, end : int
    """
    frames8, frames16, frames32, frames64 = frames
    n_sets, n_links = sets.shape[0], links.shape[0]
    alone = reference.shape[0] == 0  # no coarser code
    closed = scale[2] > 0.0  # the panel's two ends coincide
    unsure = alone & (not closed) & (way == 0)  # a base phase may slip past an end
    keep = relative.shape[1] > 0
    keep_residual = residual.shape[1] > 0
    to_pixels, whole, turns_per_radian = scale[0], scale[1], scale[2]
    # A place beyond the panel is a wrong order, but a coarser code's own affair.
    beyond = TWO_PI * _BEYOND * to_pixels if alone else np.inf
    alpha, beta, offset = noise[0], noise[1], noise[2]
    most, least_square, least_ratio, limit = limits[0], limits[1], limits[2], limits[3]
    # Rows of one array: the compiler knows that they do not overlap.
    scratch = np.empty((10, BLOCK + PAD))
    total, cosine, sine = scratch[0], scratch[1], scratch[2]
    square, variance, absolute = scratch[3], scratch[4], scratch[5]
    off, slack, above, below = scratch[6], scratch[7], scratch[8], scratch[9]
    phases = np.empty((n_sets + 1, BLOCK + PAD))  # the last row is a beat's
    faults = np.empty(BLOCK, np.int64)
    singles = np.full(n_links, -1)  # the set of a link that is no beat
    for t in range(n_links):
        used = 0.0
        for s in range(n_sets):
            used += abs(factors[t, s])
            if factors[t, s] == 1.0:
                singles[t] = s
        if used != 1.0:
            singles[t] = -1
    flags = np.empty(BLOCK, np.uint8)
    flagged = np.uint8(1) if kind < 2 and most < 0.0 else np.uint8(0)  # no integer is below zero

    for block in range(begin, end, BLOCK):
        start, n = np.uintp(block), np.uintp(min(BLOCK, end - block))
        for i in range(n):
            flags[i] = flagged
        if unsure:
            for i in range(n):
                above[i] = 0.0
                below[i] = 1.0
        for s in range(n_sets):
            first, shifts = sets[s, 0], sets[s, 1]
            looked = checked if s == 0 else checked[:0]
            row = weights[s]
            if kind == 0:
                limit8 = np.uint8(most)
                _read(frames8, looked, limit8, first, shifts, row, start, scratch, flags, n)
            elif kind == 1:
                limit16 = np.uint16(most)
                _read(frames16, looked, limit16, first, shifts, row, start, scratch, flags, n)
            elif kind == 2:
                limit32 = np.float32(most)
                _read(frames32, looked, limit32, first, shifts, row, start, scratch, flags, n)
            else:
                _read(frames64, looked, most, first, shifts, row, start, scratch, flags, n)
            if s == 0:
                for i in range(n):
                    faults[i] = flags[i]
            to_square = 4.0 / (shifts * shifts)
            per_shift = 1.0 / shifts
            if tilts[s, 0] != 0.0 or tilts[s, 1] != 0.0:  # shifts that do not fill a turn
                for i in range(n):
                    total[i] -= tilts[s, 0] * cosine[i] + tilts[s, 1] * sine[i]
            phase = phases[s]
            for i in range(n):
                phase[i] = angle(sine[i], cosine[i])
                own = to_square * (cosine[i] * cosine[i] + sine[i] * sine[i])
                noisy = alpha + beta * max(per_shift * total[i] - offset, 0.0)
                good = (own >= least_square) & (own >= least_ratio * noisy)
                faults[i] |= 0 if good else _DIM
                square[i] = own
                variance[i] = noisy
            if unsure and factors[0, s] != 0.0:
                weight = factors[0, s] * factors[0, s] * 2.0 / shifts
                for i in range(n):  # a fraction is added: dividing takes longer than all of it
                    above[i] = above[i] * square[i] + weight * variance[i] * below[i]
                    below[i] *= square[i]
            if keep:
                for i in range(n):
                    relative[s, start + i] = phase[i]

        for i in range(n):
            absolute[i] = phases[n_sets - 1, i]
        if way == 1:
            _search(phases, counts, closed, limit, absolute, faults, n)
        for t in range(n_links):
            link = phases[n_sets]
            if singles[t] >= 0:
                link = phases[singles[t]]
            else:
                for i in range(n):
                    link[i] = 0.0
                for s in range(n_sets):
                    for i in range(n):
                        link[i] += factors[t, s] * phases[s, i]
                for i in range(n):
                    link[i] -= TWO_PI * np.floor(link[i] / TWO_PI)
            if t == 0 and alone:
                # Less than one fringe leaves a gap, in whose middle noise on either side is parted.
                gap = (1.0 - links[0]) * math.pi
                for i in range(n):
                    absolute[i] = link[i] - TWO_PI if link[i] > TWO_PI - gap else link[i]
                if unsure:
                    for i in range(n):
                        apart = min(absolute[i], TWO_PI * links[0] - absolute[i]) + gap
                        sure = apart * apart * below[i] >= END_SIGMAS * END_SIGMAS * above[i]
                        faults[i] |= 0 if sure & (apart >= 0.0) else _END
                continue
            ratio = links[t]
            for i in range(n):
                slack[i] = 0.0
            if t > 0:
                ratio /= links[t - 1] if not compares[t] else counts[n_sets - 1]
            else:
                for i in range(n):
                    absolute[i] = (reference[start + i] + 0.5) * (TWO_PI / size)
                each = reference_sigma.shape[0] > 1
                for i in range(n):
                    # The coarse place is anywhere within its own cell, which tells fringes apart
                    # where it is no wider than one.
                    known = reference_sigma[start + i if each else np.uintp(0)]
                    slack[i] = ROOT_3 * known * ratio / size
                    faults[i] |= 0 if slack[i] <= 0.5 + 1e-9 else _COARSE
            if compares[t]:
                for i in range(n):
                    above[i] = absolute[i]
                _unwrap(link, ratio, limit, slack, above, faults, off, n)
            else:
                _unwrap(link, ratio, limit, slack, absolute, faults, off, n)
            if keep_residual and singles[t] >= 0:
                for i in range(n):
                    residual[singles[t], start + i] = off[i]
        if way == 1 and keep_residual:
            for s in range(n_sets - 1):
                ratio = counts[s] / counts[n_sets - 1]
                for i in range(n):
                    exact = (ratio * absolute[i] - phases[s, i]) / TWO_PI
                    residual[s, start + i] = exact - np.floor(exact + 0.5)

        if harmonics.shape[0] == 1:  # three equal steps
            for i in range(n):
                radius = math.sqrt(square[i])
                cos_phi = cosine[i] / (1.5 * radius)
                variance[i] -= 0.5 * beta * radius * (cos_phi * (4.0 * cos_phi * cos_phi - 3.0))
        elif harmonics.shape[0] > 1:
            h = harmonics
            for i in range(n):
                c, s_ = math.cos(phases[n_sets - 1, i]), math.sin(phases[n_sets - 1, i])
                quadratic = h[0] * c * c + h[1] * c * s_ + h[2] * s_ * s_
                cubic = c * c * (h[3] * c + h[4] * s_) + s_ * s_ * (h[5] * c + h[6] * s_)
                variance[i] = quadratic * variance[i] + cubic * beta * math.sqrt(square[i])
        per_shift = 1.0 / sets[n_sets - 1, 1]
        for i in range(n):
            # A phase past either end of the panel belongs to the other end (see decode).
            turns = np.floor(absolute[i] * turns_per_radian)
            place = (absolute[i] - whole * turns) * to_pixels  # from the panel's edge
            deviation = to_pixels * math.sqrt(2.0 * per_shift * max(variance[i], 0.0) / square[i])
            near = END_SIGMAS * deviation if closed else -beyond
            within = (place >= near) & (place <= size - near) & (square[i] < np.inf)
            fault = faults[i] | (0 if within else _END)
            faults[i] = fault
            coordinate[start + i] = place - 0.5 if fault == 0 else np.nan
            sigma[start + i] = deviation if fault == 0 else np.nan
        for i in range(n):
            modulation[start + i] = math.sqrt(square[i])
        for i in range(n):
            mean[start + i] = per_shift * total[i]
        for i in range(n):
            mask[start + i] = faults[i] == 0
        if dropped.shape[0] > 0:
            for i in range(n):
                dropped[start + i] = _first_rule(faults[i])


@njit(fastmath=FAST, error_model="numpy", no_cpython_wrapper=True)
def _fit(
    frames: Any, first: int, weights: Any, shown: Any, start: int, n: int, sums: Any, out: Any
) -> None:
    """Fit a sinusoid to the frames of a set over a block, and return what is left of them."""
    count = weights.shape[0]
    mean, cosine, sine, left = sums[0], sums[1], sums[2], sums[3]
    for i in range(n):
        mean[i] = 0.0
        cosine[i] = 0.0
        sine[i] = 0.0
        left[i] = 0.0
    for k in range(count):
        row = first + k
        c, s, w = weights[k, 0], weights[k, 1], weights[k, 2]
        for i in range(n):
            value = np.float64(frames[row, start + i])
            cosine[i] += c * value
            sine[i] += s * value
            mean[i] += w * value
    for k in range(count):
        row = first + k
        c, s = shown[k, 0], shown[k, 1]
        for i in range(n):
            off = np.float64(frames[row, start + i]) - (mean[i] + c * cosine[i] + s * sine[i])
            left[i] += off * off
    for i in range(n):
        out[start + i] = math.sqrt(left[i] / (count - 3))


@njit(
    void(
        FRAMES,
        int64,
        int64,
        float64[:, ::1],
        float64[:, ::1],
        float32[::1],
        int64,
        int64,
    ),
    fastmath=FAST,
    error_model="numpy",
    nogil=True,
    cache=True,
)
def fit_residual(
    frames: Any,
    kind: int,
    first: int,
    weights: Any,
    shown: Any,
    residual: Any,
    begin: int,
    end: int,
) -> None:
    """Find the residual of the sinusoidal fit of one fringe set at pixels `begin` to `end`.

    Parameters
    ----------
    frames, kind : tuple of (F, P) arrays, int
    first : int
        First frame of the set.
    weights : (N, 3) float64
        Of b cos phi, b sin phi and the mean; N >= 4.
    shown : (N, 2) float64
        cos e_k and sin e_k.
    residual : (P,) float32
        Root of the sum of squares over N - 3 degrees of freedom, DN; written.
    begin, end : int
    """
    frames8, frames16, frames32, frames64 = frames
    sums = np.empty((4, BLOCK + PAD))
    for block in range(begin, end, BLOCK):
        start, n = np.uintp(block), np.uintp(min(BLOCK, end - block))
        if kind == 0:
            _fit(frames8, first, weights, shown, start, n, sums, residual)
        elif kind == 1:
            _fit(frames16, first, weights, shown, start, n, sums, residual)
        elif kind == 2:
            _fit(frames32, first, weights, shown, start, n, sums, residual)
        else:
            _fit(frames64, first, weights, shown, start, n, sums, residual)
