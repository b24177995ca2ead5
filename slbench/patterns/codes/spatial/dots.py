"""Dots of an M-array in a picture: where they are, which they are, and what lies between them.

The grid's steps in the picture are the first lags at which the picture is like itself.
Dots are peaks of the picture smoothed by 0.18 pitches, found to a fraction of a pixel where the
smoothed picture's gradient is zero.  What a cell of a pitch squared has above its dark ground says
which size a dot has: large ones have four times the light of small ones, and albedo and lens change
both alike.  A dot is believed where as many windows agree on its place as one has dots along a
side, which is so all along an edge of what is seen but at its corners; outermost dots, of which the
edge may have cut a part, are left out then.  Pixels between three dots of one cell of the grid have
their places by an affine map: the surface is taken for a plane there.

Noise dg of the gradient moves a peak by dx = -H^-1 dg, H being the second derivatives; the variance
of dg is that of the pixels under the square of the smoothing's derivative.  A pixel that has the
shares s_i of its three dots is off by -J sum s_i dx_i, with the map's Jacobian J.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from slbench.patterns.base import FloatArray, Observed

#: Camera pixels of a pitch below which dots are not told apart.
_LEAST_PITCH = 6.0
#: Deviation of the Gaussian that finds dots, pitches.
_SMOOTHING = 0.18
#: Largest slope of a step against its direction, and least likeness as a share of the largest.
_CONE, _AS_ALIKE = 0.4, 0.7
#: Light of a dot, as a share of the most nearby, from which it is a large one.
_LARGE_FROM = 0.5
#: How far a neighbour may be from where it would be on an even grid, pitches.
_ASTRAY = 0.4
#: Steps to the zero of a gradient; the first leaves some hundredths of a pixel.
_STEPS = 3


@dataclass(frozen=True, eq=False)
class SeenDots:
    """Dots of a picture.

    Parameters
    ----------
    at : (D, 2) float64
        Column and row, px.
    covariance : (D, 2, 2) float64
        Of either, px^2.
    large : (D,) bool
    steps : (2, 2) float64
        From dot to dot along rows and along columns, column and row, px.
    modulation, mean : (V, U) float64
        Half the difference, and mean, of the brightest and the darkest nearby, DN.
    """

    at: FloatArray
    covariance: FloatArray
    large: NDArray[np.bool_]
    steps: FloatArray
    modulation: FloatArray
    mean: FloatArray


def seen_dots(frame: FloatArray, observed: Observed) -> SeenDots:
    """Find the dots of a frame (V, U), none where it has no grid or too fine a one."""
    bad = ~(np.isfinite(frame) & (frame < observed.saturation))
    frame = np.where(np.isfinite(frame), frame, 0.0)
    steps = _steps(frame)
    pitch = np.diag(steps)
    if pitch.min() < _LEAST_PITCH:
        blank = np.zeros(frame.shape)
        none = np.empty((0, 2))
        return SeenDots(none, np.empty((0, 2, 2)), np.empty(0, bool), steps, blank, blank)
    scale = tuple(_SMOOTHING * pitch[::-1])
    cell = tuple(int(n) for n in np.rint(pitch[::-1]))
    about = tuple(n + n // 2 for n in cell)
    smooth = ndimage.gaussian_filter(frame, scale)
    dark, bright = ndimage.minimum_filter(smooth, about), ndimage.maximum_filter(smooth, about)
    modulation, mean = 0.5 * (bright - dark), 0.5 * (bright + dark)
    least = np.maximum(
        observed.min_modulation, observed.min_snr * np.sqrt(observed.noise.variance(bright))
    )
    near = tuple(2 * int(0.3 * n) + 1 for n in cell)
    peak = (smooth == ndimage.maximum_filter(smooth, near)) & (modulation >= least)
    peak &= (smooth - dark >= least) & ~ndimage.maximum_filter(bad, cell)
    row, column = np.nonzero(peak)
    light = (ndimage.uniform_filter(frame, cell) - dark)[row, column]
    sparse = np.zeros(frame.shape)
    sparse[row, column] = light
    most = ndimage.maximum_filter(sparse, tuple(4 * n + 1 for n in cell))[row, column]
    variance = observed.noise.variance(frame)
    at, covariance, good = _refined(frame, variance, np.column_stack((row, column)), scale)
    large = light > _LARGE_FROM * most
    at, covariance = at[good][:, ::-1], covariance[good][:, ::-1, ::-1]
    return SeenDots(at, covariance, large[good], steps, modulation, mean)


def _steps(frame: FloatArray) -> FloatArray:
    """Return the steps, column and row, from dot to dot along rows and columns, (2, 2), px.

    They are the first lags, within some twenty degrees of either direction, at which the picture
    is like itself.  Zero where it never is.
    """
    height, width = frame.shape
    power = np.abs(np.fft.rfft2(frame - frame.mean(), (2 * height, 2 * width))) ** 2
    alike = np.fft.fftshift(np.fft.irfft2(power, (2 * height, 2 * width)))
    along = alike[:, width : width + width // 2], alike[height : height + height // 2].T
    first, second = _first_peak(along[0]), _first_peak(along[1])[::-1]
    return np.array((first, second))


def _first_peak(alike: FloatArray) -> tuple[float, float]:
    """Return the place of the first peak from the middle of the first column to the right."""
    middle, length = alike.shape[0] // 2, alike.shape[1]
    off = np.abs(np.arange(alike.shape[0]) - middle)[:, np.newaxis]
    cone = np.where(off > _CONE * np.arange(length), -np.inf, alike)
    best = cone.max(axis=0)
    rising = np.flatnonzero(np.diff(best) > 0.0)
    if not len(rising):
        return 0.0, 0.0
    best[: rising[0]] = 0.0
    inner = best[1:-1]
    high = (inner >= best[:-2]) & (inner >= best[2:]) & (inner > _AS_ALIKE * max(best.max(), 0.0))
    if not high.any():
        return 0.0, 0.0
    peak = int(np.argmax(high)) + 1
    return float(peak), float(np.argmax(cone[:, peak]) - middle)


def _refined(
    frame: FloatArray, variance: FloatArray, peaks: NDArray[np.intp], scale: tuple[float, ...]
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return place (D, 2), covariance (D, 2, 2) and validity (D,) of peaks, row before column."""
    derivatives = [
        ndimage.spline_filter(ndimage.gaussian_filter(frame, scale, order))
        for order in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    ]
    at = peaks.astype(np.float64)
    good = np.ones(len(at), bool)
    inverse = np.empty((len(at), 2, 2))
    for _ in range(_STEPS):
        gy, gx, yy, xy, xx = (
            ndimage.map_coordinates(one, at.T, prefilter=False, mode="nearest")
            for one in derivatives
        )
        bend = yy * xx - xy**2
        good &= (yy < 0.0) & (bend > 0.0)
        bend = np.where(good, bend, 1.0)
        inverse = np.stack((xx, -xy, -xy, yy), axis=-1).reshape(-1, 2, 2) / bend[:, None, None]
        step = np.einsum("dij,dj->di", inverse, np.column_stack((gy, gx)))
        good &= np.abs(at - step - peaks).max(axis=1, initial=0.0) <= max(scale)
        at = np.where(good[:, None], at - step, peaks)
    # Peaks whose smoothing reaches over the border are pulled by it.
    margin = 3.0 * np.array(scale)
    good &= ((at >= margin) & (at <= np.array(frame.shape) - 1 - margin)).all(axis=1)
    noise = np.zeros_like(inverse)
    for k in range(2):
        carried = variance
        for axis in range(2):
            half = int(4.0 * scale[axis] + 0.5)
            impulse = np.zeros(2 * half + 1)
            impulse[half] = 1.0
            kernel = ndimage.gaussian_filter1d(impulse, scale[axis], order=int(axis == k))
            carried = ndimage.correlate1d(carried, kernel**2, axis)
        noise[:, k, k] = ndimage.map_coordinates(carried, at.T, order=1, mode="nearest")
    return at, inverse @ noise @ inverse, good


def numbered(
    seen: SeenDots,
    columns: int,
    window: int,
    windows: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.int64]:
    """Return the place of every dot in the array, column and row, (D, 2); -1 for none.

    Parameters
    ----------
    seen : SeenDots
    columns : int
        Dots in a row of the array.
    window : int
        Dots along a side of a window.
    windows : (W,) int64, (W,) int64
        Numbers of all windows, increasing, and the flat places of their first dots.
    """
    count = len(seen.at)
    places = np.full((count, 2), -1)
    if not count:
        return places
    right, down = _neighbours(seen, 0), _neighbours(seen, 1)
    own = np.full((window, window, count), count)
    own[0, 0] = np.arange(count)
    for row in range(window):
        if row:
            own[row, 0] = down[own[row - 1, 0]]
        for column in range(1, window):
            own[row, column] = right[own[row, column - 1]]
            if row:  # by either way
                closed = down[own[row - 1, column]] == own[row, column]
                own[row, column] = np.where(closed, own[row, column], count)
    own = own[:, :, (own < count).all(axis=(0, 1))]
    powers = 1 << np.arange(window * window).reshape(window, window)
    number = np.einsum("ijw,ij->w", seen.large[own].astype(np.int64), powers)
    known, first = windows
    slot = np.minimum(np.searchsorted(known, number), len(known) - 1)
    found = known[slot] == number
    shift = columns * np.arange(window)[:, np.newaxis] + np.arange(window)
    votes = first[slot[found]] + shift[:, :, np.newaxis]
    ballots = np.stack((own[:, :, found].ravel(), votes.ravel()), axis=1)
    pairs, counts = np.unique(ballots, axis=0, return_counts=True)
    best, second = np.zeros(count, np.int64), np.zeros(count, np.int64)
    chosen = np.full(count, -1)
    for k in np.argsort(counts, kind="stable"):  # the last one of a dot has most votes
        dot = pairs[k, 0]
        best[dot], second[dot], chosen[dot] = counts[k], best[dot], pairs[k, 1]
    sure = (best >= window) & (best > second)
    inner = np.zeros((2, 2, count + 1), bool)  # has a neighbour on either side, along either axis
    for side, after in zip(inner, (right, down), strict=True):
        side[0, :count] = after[:count] < count
        side[1, after[:count]] = True
    sure &= inner[..., :count].all(axis=(0, 1))
    sure &= np.bincount(chosen[sure], minlength=int(chosen.max(initial=0)) + 1)[chosen] == 1
    places[sure] = np.column_stack((chosen[sure] % columns, chosen[sure] // columns))
    return places


def _neighbours(seen: SeenDots, axis: int) -> NDArray[np.int64]:
    """Return the next dot along an axis of the picture, (D + 1,); D for none, and of none."""
    at = seen.at @ np.linalg.inv(seen.steps)
    count = len(at)
    tree, ahead = cKDTree(at), np.eye(2)[axis]
    _, after = tree.query(at + ahead, distance_upper_bound=_ASTRAY)
    _, before = tree.query(at - ahead, distance_upper_bound=_ASTRAY)
    after, before = np.append(after, count), np.append(before, count)
    mutual: NDArray[np.int64] = np.where(before[after] == np.arange(count + 1), after, count)
    return mutual


def between(
    seen: SeenDots, cells: NDArray[np.int64], pitch_px: float, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Return place and standard deviation of every pixel, (2, V U) each, NaN for none.

    Parameters
    ----------
    seen : SeenDots
    cells : (D, 2) int64
        Place of every dot in the array, column and row; -1 for none.
    pitch_px : float
        Distance between dots on the panel, px.
    shape : (int, int)
        Rows and columns of the picture.
    """
    place, sigma = np.full((2, *shape), np.nan), np.full((2, *shape), np.nan)
    corners = _triangles(seen, cells) if len(cells) else np.empty((0, 3), np.int64)
    if len(corners):
        at, panel = seen.at[corners], (cells[corners] + 0.5) * pitch_px - 0.5
        # From steps in the picture to shares of the second and third dot, to steps on the panel.
        shares = np.linalg.inv((at[:, 1:] - at[:, :1]).transpose(0, 2, 1))
        sides = panel[:, 1:] - panel[:, :1]
        jacobian = np.einsum("sia,sib->sab", sides, shares)
        noise = np.einsum("sab,sibc,sac->sia", jacobian, seen.covariance[corners], jacobian)
        low = np.ceil(at.min(axis=1)).astype(np.int64)
        width, height = (at.max(axis=1) - low).max(axis=0).astype(np.int64) + 1
        column = low[:, :1] + np.arange(width)
        for line in range(height):  # a row of every triangle
            row = np.broadcast_to(low[:, 1:] + line, column.shape)
            off = np.stack((column, row), axis=-1) - at[:, :1]
            two = np.einsum("sij,spj->spi", shares, off)
            weight = np.concatenate((1.0 - two.sum(axis=2, keepdims=True), two), axis=2)
            k, p = np.nonzero((weight >= 0.0).all(axis=2))
            own, pixel = weight[k, p], (slice(None), row[k, p], column[k, p])
            place[pixel] = np.einsum("pi,pia->ap", own, panel[k])
            sigma[pixel] = np.sqrt(np.einsum("pi,pia->ap", own**2, noise[k]))
    return place.reshape(2, -1), sigma.reshape(2, -1)


def _triangles(seen: SeenDots, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the dots at the right angle and at the ends of the legs of triangles, (S, 3).

    They halve the cells of the grid that have all their dots; of three dots there is one.
    """
    count = len(cells)
    known = cells[:, 0] >= 0
    table = np.full(cells.max(axis=0, initial=0) + 2, count)
    table[tuple(cells[known].T)] = np.flatnonzero(known)
    a, b = table[:-1, :-1].ravel(), table[1:, :-1].ravel()
    c, d = table[:-1, 1:].ravel(), table[1:, 1:].ravel()
    halves = np.concatenate([np.column_stack(one) for one in ((a, b, c), (d, c, b))])
    lone = np.concatenate(
        [
            np.column_stack((b, d, a))[c == count],
            np.column_stack((c, a, d))[b == count],
        ]
    )
    corners = np.concatenate((halves, lone))
    corners = corners[(corners < count).all(axis=1)]
    # Dots on either side of a step are neighbours on the panel alone.
    legs = (seen.at[corners[:, 1:]] - seen.at[corners[:, :1]]) @ np.linalg.inv(seen.steps)
    astray = np.linalg.norm(legs - (cells[corners[:, 1:]] - cells[corners[:, :1]]), axis=2)
    near: NDArray[np.int64] = corners[(astray <= _ASTRAY).all(axis=1)]
    return near
