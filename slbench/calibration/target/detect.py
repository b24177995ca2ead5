"""Find the dots of a calibration target in an image, to a few hundredths of a pixel.

*Finding* is a circular Hough transform, as in the thesis (5.4.3, 8.3.3), of the gradient
kind (T. J. Atherton, D. J. Kerbyson, "Size invariant circle detection", Image and Vision
Computing 17, 1999): each pixel casts its gradient's magnitude as a vote at a distance of one
radius along its gradient, so polarity counts and no edge image is needed.  An octave of radii
shares an accumulator, and each octave has its own level of an image pyramid, so that
radii need not be known and large dots cost no more than small ones.

*Refining* is an ellipse fitted to sub-pixel points of the edge (:mod:`~.edges`).  A weighted
centroid was the alternative.  For small dots in even light the two are equal; but the
centroid's scatter does not fall with the size of the dot, as the fit's does, and uneven light
and whatever else lies in its window move it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import KDTree

from slbench.calibration.target.edges import SAMPLES_AT_ONCE, Ellipses, locate, refine, sample_rays
from slbench.core.errors import InputError
from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Least radius that can be measured, px: below it no ray has plateaus on both sides.
MIN_RADIUS_PX = 3.0
#: Radii of an octave's accumulator, in pixels of its pyramid level; octaves overlap.
_RADII = np.geomspace(2.8, 8.0, 9)
#: Standard deviation of the blur that collects the votes for a centre, px of the level.
_SMEAR_PX = 1.2
#: Least contrast of a dot as a fraction of the image's range, and in standard deviations of
#: its noise.
_LEAST_CONTRAST, _LEAST_SNR = 0.1, 3.0
#: Gradients below this many of the image's noise do not vote: three standard deviations of
#: the gradient after smoothing.
_GRADIENT_NOISE = 0.4
#: Least votes of a candidate, as a fraction of a full outline of the least contrast; blur
#: and ellipticity spread the votes.
_LEAST_VOTES = 0.5
#: Most candidates of a level: a picture of anything else has to end too.
_MOST_CANDIDATES = 4000
#: Fraction of its outline that a dot shows at least, and that a whole dot shows.
_LEAST_COVERAGE, _WHOLE = 0.45, 0.85
#: Least ratio of the axes: a circle seen at 72 deg.
_FLATTEST = 0.3
#: Largest standard deviation of a centre, as a fraction of the radius.
_WORST_SD = 0.1
_SMALLEST_IMAGE = 12


@dataclass(frozen=True)
class Dots:
    """Dots found in an image, n of them, from top to bottom.

    Parameters
    ----------
    centres : (n, 2) float
        Centres (u, v) of the ellipses, px; integers are pixel centres.
    semi_axes : (n, 2) float
        Major and minor semi-axis, px.
    orientation : (n,) float
        Angle of the major axis from u towards v, rad, in (-pi/2, pi/2].
    sd : (n,) float
        Predicted standard deviation of a centre along either axis, px, from the scatter of
        the edge points about the ellipse: right within a factor of two.  What moves the whole
        outline is not in it, such as a lopsided blur.
    contrast : (n,) float
        Brightness outside less inside, without sign, in the image's units.
    edge_width : (n,) float
        Distance from 10 % to 90 % of the edge, px; grows with defocus.
    coverage : (n,) float
        Fraction of the outline where an edge was found.
    partial : (n,) bool
        Whether the dot is cut: by the border of the image, or of what is lit.
    """

    centres: Array
    semi_axes: Array
    orientation: Array
    sd: Array
    contrast: Array
    edge_width: Array
    coverage: Array
    partial: NDArray[np.bool_]

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def radii(self) -> Array:
        """Geometric mean of the semi-axes, (n,), px."""
        return np.sqrt(self.semi_axes[:, 0] * self.semi_axes[:, 1])

    def select(self, which: NDArray[Any]) -> Self:
        """Return some of the dots, by mask or by index."""
        return type(self)(**{f.name: getattr(self, f.name)[which] for f in fields(self)})


def detect_dots(
    image: NDArray[Any],
    *,
    dark: bool = True,
    min_radius_px: float | None = None,
    max_radius_px: float | None = None,
    keep_partial: bool = False,
) -> Dots:
    """Find dots and measure their centres.

    Parameters
    ----------
    image : (V, U) uint8, uint16 or float
    dark : bool
        Whether the dots are darker than what surrounds them.
    min_radius_px, max_radius_px : float, optional
        Range of radii; by default 3 px to a quarter of the image's shorter side.  A narrower
        range is faster.
    keep_partial : bool
        Keep dots that are cut; their centres are less certain and may be biased.

    Returns
    -------
    Dots

    Raises
    ------
    InputError
        For what is no grey image, values that are not finite, a range of radii that is empty,
        or when no dot, or none that is whole, is found.
    """
    picture = checked_image("detect_dots: image", image)
    low, high = _radius_range(picture.shape, min_radius_px, max_radius_px)
    signed = picture if dark else -picture
    places, radii = _candidates(signed, low, high)
    ellipses = locate(signed, places, radii)
    ellipses = _once_each(ellipses.select(_sound(ellipses, low, high)))
    ellipses = refine(signed, ellipses, _room(ellipses, signed.shape))
    ellipses = _once_each(ellipses.select(_sound(ellipses, low, high)))
    if len(ellipses) == 0:
        raise InputError("detect_dots: image", "round dots", "none")
    partial = ellipses.coverage < _WHOLE
    if not keep_partial:
        if np.all(partial):
            found = f"{len(ellipses)} that are cut"
            raise InputError("detect_dots: image", "dots that are wholly in view", found)
        ellipses, partial = ellipses.select(~partial), partial[~partial]
    order = np.lexsort(ellipses.centres.T)
    ellipses, partial = ellipses.select(order), partial[order]
    semi_axes, orientation = ellipses.axes()
    return Dots(
        ellipses.centres,
        semi_axes,
        orientation,
        ellipses.sd,
        ellipses.contrast,
        ellipses.width,
        ellipses.coverage,
        partial,
    )


def checked_image(where: str, image: NDArray[Any]) -> Array:
    """Return a grey image as float64, or raise InputError."""
    if not isinstance(image, np.ndarray) or image.ndim != 2:
        got = image.shape if isinstance(image, np.ndarray) else type(image).__name__
        raise InputError(where, "a grey image of shape (V, U)", got)
    if image.dtype.kind not in "uif" or min(image.shape) < _SMALLEST_IMAGE:
        expected = f"numbers, at least {_SMALLEST_IMAGE} x {_SMALLEST_IMAGE} of them"
        raise InputError(where, expected, f"{image.shape} of {image.dtype}")
    picture = image.astype(np.float64)
    if not np.all(np.isfinite(picture)):
        raise InputError(where, "finite values", f"{np.sum(~np.isfinite(picture))} others")
    return picture


def _radius_range(
    shape: tuple[int, ...], low: float | None, high: float | None
) -> tuple[float, float]:
    """Check the range of radii and fill in what is not given."""
    largest = 0.25 * min(shape)
    for name, value in (("min_radius_px", low), ("max_radius_px", high)):
        if value is not None and not MIN_RADIUS_PX <= value < np.inf:
            raise InputError(f"detect_dots: {name}", f"at least {MIN_RADIUS_PX:g}", value)
    least = MIN_RADIUS_PX if low is None else low
    most = max(largest, least) if high is None else high
    if least > most or least > 0.5 * min(shape):
        expected = f"a range of radii within an image of {shape[1]} x {shape[0]} px"
        raise InputError("detect_dots: radii", expected, f"{least:g} to {most:g}")
    return least, most


def _noise(image: Array) -> float:
    """Estimate the noise's standard deviation (J. Immerkaer, CVIU 64, 1996), by the median."""
    kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
    return 1.4826 * float(np.median(np.abs(cv2.filter2D(image, -1, kernel)[::3, ::3])))


def _candidates(image: Array, low: float, high: float) -> tuple[Array, Array]:
    """Find where dark dots may be, and their approximate radii: (n, 2) and (n,)."""
    # Of a smoothed image: one hot pixel must not set the range.
    level, scale = cv2.GaussianBlur(image, (0, 0), 1.0), 1.0
    contrast = float(np.ptp(np.percentile(level[::3, ::3], [0.5, 99.5])))
    noise = _noise(image)
    least = max(_LEAST_CONTRAST * contrast, _LEAST_SNR * noise)
    everything = []
    while contrast > 0.0 and scale * _RADII[0] < 1.2 * high and min(level.shape) > 2:
        if scale * _RADII[-1] > 0.8 * low:
            places, votes = _hough(level, least, noise)
            # A level of the pyramid keeps every other pixel, from the first.
            places *= scale
            radii, step = _first_radii(image, places, 1.3 * scale * _RADII[-1])
            good = (radii > 0.6 * low) & (radii < 1.5 * high) & (step > least)
            everything.append(np.column_stack((places, radii, votes))[good])
        level, scale = cv2.pyrDown(level), 2.0 * scale
    found = np.concatenate(everything) if everything else np.empty((0, 4))
    # Levels overlap: of candidates for one dot keep that with the most votes.
    found = found[np.argsort(-found[:, 3], kind="stable")]
    found = found[_first_within(found[:, :2], 0.5 * found[:, 2])]
    return found[:, :2], found[:, 2]


def _first_radii(image: Array, centres: Array, reach_px: float) -> tuple[Array, Array]:
    """Estimate the radii of dark dots whose centres are roughly known.

    Parameters
    ----------
    image : (V, U) float
    centres : (n, 2) float
    reach_px : float
        Up to which radius to look.

    Returns
    -------
    radii : (n,) float
        Where the median over 16 rays first crosses half the way from the centre's value to
        the brightest; NaN where it does not.
    contrast : (n,) float
        From the centre's value to the brightest.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    steps = np.linspace(0.0, reach_px, 65)
    radii, contrast = np.full(len(centres), np.nan), np.zeros(len(centres))
    at_once = SAMPLES_AT_ONCE // (steps.size * angle.size)
    for first in range(0, len(centres), at_once):
        some = slice(first, first + at_once)
        count = len(centres[some])
        rays = np.empty((count, angle.size, steps.size))
        upright = np.tile(np.eye(2), (count, 1, 1))
        positions = np.tile(steps, (count, 1))
        sample_rays(image, centres[some], upright, np.cos(angle), np.sin(angle), positions, rays)
        # Beyond the border: as at the centre, so that it ends no profile.
        rays = np.where(np.isnan(rays), rays[:, :1, :1], rays)
        profile = np.median(rays, axis=1)
        inside = profile[:, :3].mean(axis=1)
        contrast[some] = profile.max(axis=1) - inside
        above = profile > (inside + 0.5 * contrast[some])[:, None]
        crossing = np.argmax(above, axis=1)
        found = above.any(axis=1) & (crossing > 0)
        radii[some] = np.where(found, (crossing - 0.5) * steps[1], np.nan)
    return radii, contrast


def _hough(level: Array, least: float, noise: float) -> tuple[Array, Array]:
    """Find centres of an octave of dark circles in a level of the pyramid.

    Parameters
    ----------
    level : (V, U) float
    least : float
        Least contrast of a dot.
    noise : float
        Of the image.

    Returns
    -------
    places : (n, 2) float
    votes : (n,) float
        Contrast times the fraction of the outline that votes for the place.
    """
    # Scaled so that a gradient's integral across an edge is the edge's contrast.
    du, dv = (cv2.Scharr(level, cv2.CV_64F, *order) / 32.0 for order in ((1, 0), (0, 1)))
    magnitude = np.hypot(du, dv)
    # An edge blurred over the whole of the smallest dot is this steep.
    steepness = max(0.1 * least / _RADII[0], _GRADIENT_NOISE * noise)
    row, column = np.nonzero(magnitude > steepness)
    votes = np.zeros(level.shape)
    _vote(row, column, du[row, column], dv[row, column], _RADII, votes)
    smooth = cv2.GaussianBlur(votes, (0, 0), _SMEAR_PX)
    smooth *= 2.0 * np.pi * _SMEAR_PX**2
    peak = (smooth == cv2.dilate(smooth, np.ones((5, 5)))) & (smooth > _LEAST_VOTES * least)
    row, column = np.nonzero(peak)
    best = np.argsort(-smooth[row, column], kind="stable")[:_MOST_CANDIDATES]
    row, column = row[best], column[best]
    return np.column_stack((column, row)).astype(np.float64), smooth[row, column]


@njit(cache=True)
def _vote(row, column, du, dv, radii, votes):  # type: ignore[no-untyped-def]
    """Each pixel adds its gradient's magnitude at each radius on its dark side."""
    for i in range(len(row)):
        weight = np.hypot(du[i], dv[i])
        for radius in radii:
            u = int(np.rint(column[i] - radius * du[i] / weight))
            v = int(np.rint(row[i] - radius * dv[i] / weight))
            if 0 <= u < votes.shape[1] and 0 <= v < votes.shape[0]:
                votes[v, u] += weight / (2.0 * np.pi * radius)


def _first_within(places: Array, reach: Array) -> NDArray[np.bool_]:
    """Return a mask of places (n, 2) that no earlier kept one reaches, nor they it; reach (n,)."""
    kept = np.ones(len(places), dtype=np.bool_)
    if len(places) == 0:
        return kept
    tree = KDTree(places)
    for i, near in enumerate(tree.query_ball_point(places, reach)):
        if kept[i]:
            kept[[j for j in near if j > i]] = False
    return kept


def _room(ellipses: Ellipses, shape: tuple[int, ...]) -> Array:
    """Distance from each dot's centre to half way to the next, or the border, (n,)."""
    centres = ellipses.centres
    border = np.minimum(centres, np.array(shape[::-1]) - 1.0 - centres).min(axis=1)
    # A dot that the border cuts is measured as if it did not, and found cut.
    room = np.where(border > ellipses.radii, border, np.inf)
    if len(centres) > 1:
        room = np.minimum(room, 0.5 * KDTree(centres).query(centres, k=2)[0][:, 1])
    return room


def _sound(ellipses: Ellipses, low: float, high: float) -> NDArray[np.bool_]:
    """Return a mask of fits that are dots, whole or cut."""
    semi_axes, _ = ellipses.axes()
    sound = (ellipses.coverage > _LEAST_COVERAGE) & (ellipses.radii >= low)
    sound &= (ellipses.radii <= high) & (semi_axes[:, 1] > _FLATTEST * semi_axes[:, 0])
    # Scatter of the edge that is a sizeable part of the dot: no ellipse.
    return sound & (ellipses.sd < _WORST_SD * ellipses.radii)


def _once_each(ellipses: Ellipses) -> Ellipses:
    """Keep one of fits that came to the same dot: the one with the best outline."""
    ellipses = ellipses.select(np.argsort(-ellipses.coverage, kind="stable"))
    return ellipses.select(_first_within(ellipses.centres, ellipses.radii))
