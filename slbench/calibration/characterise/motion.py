r"""Motion between repeats: vibration and a flickering lamp, told by the repeats' differences.

A repeat that is moved by a little, ``s`` px, and lit by a share ``g`` more differs from the mean of
all by ``-s . grad f + g f`` and terms in the curvature.  ``s`` and ``g`` are found by least squares
over the whole picture, smoothed a little first (B. D. Lucas and T. Kanade, Proc. IJCAI, 1981, for
one displacement of the whole).  Noise in the slopes would make displacements too small; its known
part is taken out of the normal equations (W. A. Fuller, *Measurement Error Models*, 1987, 2.2).

Displacements of R repeats of K frames are taken apart as in a two-way analysis of variance:
a mean a frame, a mean a repeat, and what is left, each frame's own, which is the vibration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.frames import Shot, unsaturated
from slbench.calibration.characterise.quantity import LEVEL, Quantity, Untold
from slbench.patterns.base import Code

Array = NDArray[np.float64]

#: Smoothing of differences and of slopes alike, px.
_SIGMA = 1.0
#: A slope by seven pixels and a mean across it (A. Savitzky and M. J. E. Golay, Anal. Chem. 36,
#: 1964), for what is taken out: noise and PRNU, which do not move with the picture, hardly count in
#: it.  It takes a part of fine fringes' slope, so that the displacement itself is found by the
#: derivative of a Gaussian, beside differences that are smoothed by the same.
_SLOPE = np.array([22.0, -67.0, -58.0, 0.0, 58.0, 67.0, -22.0]) / 252.0
_ACROSS = np.array([-2.0, 3.0, 6.0, 7.0, 6.0, 3.0, -2.0]) / 21.0
#: What is left out beside saturated pixels and the picture's edge, px.
_BORDER = 5
#: A displacement is told where its variance by noise is less than this share of all.
_TOLD = 0.25
#: Probability by chance of what is taken for vibration.
_CHANCE = 1e-3
#: Squared slopes along an axis that tell: of those along the other, and of those with noise.
_FAINT, _CLEAN = 0.02, 0.2
#: Times that a displacement is found, and deviations beyond which a pixel is left out of the next.
_PASSES, _OUTLIER = 3, 6.0
#: Noise, DN, that rounding alone makes, and how many times its variance the light's contrast is.
_LEAST_NOISE, _CONTRAST = 0.3, 25.0
#: Pixels that a displacement needs.
_LEAST = 400


class Moves(NamedTuple):
    """How each repeat of a frame differs from their mean."""

    shift_px: Array
    """(R, 2), along u and v."""
    variance_px2: Array
    """(2,), of each by noise; infinite where the picture does not tell."""
    flicker: Array
    """(R,), relative."""
    flicker_variance: float
    """By noise; infinite where the picture does not tell."""


def moves_of(stack: NDArray[np.float32], top: float) -> tuple[Moves, NDArray[np.float32]]:
    """Return how repeats differ from their mean, and the repeats with that taken out.

    Parameters
    ----------
    stack : (R, V, U) float32
    top : float
        Of the range, DN.
    """
    from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter

    count = len(stack)
    good = unsaturated(list(stack), top)
    lost = ~np.isfinite(stack).all(axis=0)
    if lost.any() and not lost.all():
        # Filters would spread what is no number; the nearest pixel's makes no edge.
        nearest = distance_transform_edt(lost, return_distances=False, return_indices=True)
        stack = stack[:, nearest[0], nearest[1]]
    mean = stack.mean(axis=0)
    kept = ~binary_dilation(~good, iterations=_BORDER)
    if lost.any():
        kept &= ~binary_dilation(lost, iterations=2 * _BORDER)
    kept[:_BORDER] = kept[-_BORDER:] = False
    kept[:, :_BORDER] = kept[:, -_BORDER:] = False
    none = Moves(np.zeros((count, 2)), np.full(2, np.inf), np.zeros(count), np.inf)
    if np.count_nonzero(kept) < _LEAST:
        return none, np.where(lost, np.float32(np.nan), stack)
    first = _slope(mean, 1), _slope(mean, 0)
    second = np.stack([_slope(first[0], 1), _slope(first[0], 0), _slope(first[1], 0)])
    pictures = np.stack([*first, mean, np.ones_like(mean)])
    smooth = gaussian_filter(pictures, (0.0, _SIGMA, _SIGMA))
    exact = np.stack([_gaussian(mean, 1), _gaussian(mean, 0), *smooth[2:]])
    rest = stack - mean
    differences = gaussian_filter(rest, (0.0, _SIGMA, _SIGMA))
    smooth_second = gaussian_filter(second, (0.0, _SIGMA, _SIGMA))
    found, variance = np.zeros((count, 4)), np.full((count, 4), np.inf)
    share = _noise_share(_smoothed_slope)
    told = np.zeros((count, 4))
    still = rest
    for _ in range(_PASSES):
        left = still[:, kept]
        usual = max(1.4826 * float(np.median(np.abs(left))), _LEAST_NOISE)
        left = left[np.abs(left) <= _OUTLIER * usual]  # the median of whole numbers is coarse
        sigma = float(np.sqrt(np.mean(left**2) * count / (count - 1.0))) + 1e-6
        # The curvature of fringes is their light: what is of second order would count as flicker.
        straight = differences - np.tensordot(_squares(found), smooth_second, axes=1)
        for k in range(count):
            # What moves by itself, a hand or a shadow, is no motion of the whole.
            own = kept & (np.abs(still[k]) <= _OUTLIER * max(sigma, usual))
            if np.count_nonzero(own) >= _LEAST:
                noise = sigma**2 / count
                found[k], _ = _fitted(straight[k], smooth, own, noise, share)
                told[k], variance[k] = _fitted(
                    straight[k], exact, own, noise, _noise_share(_gaussian)
                )
        moved = np.tensordot(found.astype(np.float32), pictures, axes=1)
        still = rest - moved - np.tensordot(_squares(found), second, axes=1)
    # Displacements are relative to the mean of all repeats.
    spread = sigma**2 * variance.max(axis=0) * (1.0 - 1.0 / count)
    # A brighter repeat's slopes are steeper.
    shift = -told[:, :2] / (1.0 + told[:, 2:3])
    still = np.where(lost, np.float32(np.nan), still + mean)
    return Moves(shift, spread[:2], told[:, 2], float(spread[2])), still


def _squares(found: Array) -> NDArray[np.float32]:
    """Return by how much of each second slope repeats differ from their mean, (R, 3)."""
    u, v = found[:, 0], found[:, 1]
    squares = np.stack([0.5 * u**2, u * v, 0.5 * v**2], axis=1)
    return (squares - squares.mean(axis=0)).astype(np.float32)


def _slope(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    from scipy.ndimage import correlate1d

    along = correlate1d(values, _SLOPE, axis=axis, mode="nearest")
    return np.asarray(correlate1d(along, _ACROSS, axis=1 - axis, mode="nearest"))


def _smoothed_slope(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(_slope(values, axis), _SIGMA))


def _gaussian(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return the slope of values smoothed by the Gaussian of the differences."""
    from scipy.ndimage import gaussian_filter

    order = [0, 0]
    order[axis] = 1
    return np.asarray(gaussian_filter(values, _SIGMA, order))


@cache
def _noise_share(slope: Callable[[NDArray[np.float32], int], NDArray[np.float32]]) -> float:
    """Return the variance of a slope of white noise of unit variance."""
    impulse = np.zeros((65, 65), np.float32)
    impulse[32, 32] = 1.0
    return float((slope(impulse, 0).astype(np.float64) ** 2).sum())


def _fitted(
    difference: NDArray[np.float32],
    pictures: NDArray[np.float32],
    kept: NDArray[np.bool_],
    noise: float,
    share: float,
) -> tuple[Array, Array]:
    """Return the shares of slopes, light and a constant in a difference, and their variances.

    Parameters
    ----------
    difference : (V, U)
    pictures : (4, V, U)
        Slopes along u and v, light, a constant; all are smoothed.
    kept : (V, U) bool
    noise : float
        Variance of the noise of the mean of all repeats, DN^2.
    share : float
        Of it in a slope, a pixel^2.

    Returns
    -------
    shares, variances : (4,) float
        Zero and infinite where a picture is not told from noise or from a constant; variances are
        for noise of unit variance.
    """
    columns = pictures[:, kept].astype(np.float64)
    normal = columns @ columns.T
    corrected = normal.copy()
    corrected[[0, 1], [0, 1]] -= noise * columns.shape[1] * share
    slope = np.diag(corrected)[:2]
    # What a displacement along the other axis does to second order would count along a faint one.
    moved = slope >= np.maximum(_FAINT * slope.max(), _CLEAN * np.diag(normal)[:2])
    used = np.array([*moved, columns[2].var() > _CONTRAST * noise, True])
    scale = (np.sqrt(np.diag(normal)) + 1e-12)[used]
    bread = np.linalg.pinv(corrected[np.ix_(used, used)] / np.outer(scale, scale), rcond=1e-9)
    bread /= np.outer(scale, scale)
    found, variance = np.zeros(4), np.full(4, np.inf)
    found[used] = bread @ (columns[used] @ difference[kept])
    # Whole sums of smoothed white noise have the variance of those that are not smoothed.
    variance[used] = np.diag(bread @ normal[np.ix_(used, used)] @ bread)
    return found, variance


def vibration(
    found: Sequence[Shot], moves: Mapping[int, Moves]
) -> tuple[list[Quantity], list[Untold]]:
    """Return the vibration from frame to frame and what is common to the frames of a repeat.

    Parameters
    ----------
    found : sequence of Shot
    moves : mapping of int to Moves
        Of what was repeated, by its place in `found`.
    """
    from scipy.stats import chi2

    name = "vibration"
    told = [
        (moves[k], shot)
        for k, shot in enumerate(found)
        if k in moves and shot.level is None and np.isfinite(moves[k].variance_px2).any()
    ]
    lost = Untold(name, "no fringes were captured twice", "the same set twice or more, in folders")
    if not told:
        return [], [lost]
    # Repeats of as many frames as there are of the usual number; each from another capture.
    counts = [len(one.shift_px) for one, _ in told]
    repeats = max(set(counts), key=counts.count)
    own = [one for one, _ in told if len(one.shift_px) == repeats]
    squares, freedom, noise, common = 0.0, 0, 0.0, 0.0
    for axis in range(2):
        usable = [one for one in own if np.isfinite(one.variance_px2[axis])]
        if not usable:
            continue
        shift = np.stack([one.shift_px[:, axis] for one in usable])  # (K, R), zero mean over R
        false = float(np.mean([one.variance_px2[axis] for one in usable]))
        frames = len(shift)
        together = shift.mean(axis=0)
        left = shift - together if frames > 1 else shift
        degrees = (repeats - 1) * max(frames - 1, 1)
        variance = float((left**2).sum()) / degrees
        false *= repeats / (repeats - 1.0)
        if (
            false > _TOLD * variance or (left**2).sum() / chi2.isf(_CHANCE, degrees) < false
        ):  # the picture hardly changes along this axis
            continue
        squares += variance * degrees
        noise += false * degrees
        freedom += degrees
        if frames > 1:
            common = max(common, float((together**2).sum()) / (repeats - 1) - variance / frames)
    if not freedom:
        largest = min(
            float(np.sqrt(np.min(one.variance_px2))) for one in own if one.variance_px2.size
        )
        why = f"repeats differ by noise alone: less than {2.0 * largest:.2g} px"
        return [], [Untold(name, why, "finer fringes or more light, if that is not little enough")]
    mean, false = squares / freedom, noise / freedom
    ends = squares / chi2.ppf([0.5 + 0.5 * LEVEL, 0.5 - 0.5 * LEVEL], freedom)
    value, low, high = (float(np.sqrt(max(x - false, 0.0))) for x in (mean, *ends))
    method = f"displacements of {repeats} repeats of {len(own)} frames, each frame's own"
    rest = Quantity(
        name=name,
        value=value,
        low=low,
        high=high,
        unit="px",
        method=method,
        key=("exposure", "vibration_px"),
        note=(
            f"what the frames of a repeat share is apart: {np.sqrt(common):.2g} px"
            if common > 0.0
            else ""
        ),
    )
    return [rest], []


def of_codes(found: Sequence[Shot], moves: Mapping[int, Moves]) -> dict[Code, Array]:
    """Return the displacements of the repeats of each code's frames, (frames * R, 2) px."""
    shifts: dict[Code, list[Array]] = {}
    for k, one in moves.items():
        shifts.setdefault(found[k].code, []).append(one.shift_px)
    return {code: np.concatenate(own) for code, own in shifts.items()}


def flicker(moves: Mapping[int, Moves]) -> list[Quantity]:
    """Return how much the light differs from repeat to repeat, relative."""
    from scipy.stats import chi2

    told = [one for one in moves.values() if np.isfinite(one.flicker_variance)]
    freedom = sum(len(one.flicker) - 1 for one in told)
    squares = sum(float((one.flicker**2).sum()) for one in told)
    if not freedom:
        return []
    false = sum(len(one.flicker) * one.flicker_variance for one in told) / freedom
    ends = squares / chi2.ppf([0.5 + 0.5 * LEVEL, 0.5 - 0.5 * LEVEL], freedom)
    value, low, high = (float(np.sqrt(max(x - false, 0.0))) for x in (squares / freedom, *ends))
    method = f"brightness of {freedom + len(told)} repeated frames"
    if low == 0.0:  # none that would be seen
        return []
    return [
        Quantity(
            name="flicker", value=value, low=low, high=high, unit="of the light", method=method
        )
    ]
