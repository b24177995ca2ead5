"""Motion estimated from the frames themselves.

Four and more shifts of one fringe set fit a sinusoid with frames to spare.  Where the surface has
moved between them they fit none, but for the right motion: what is left of the frames, looked up
along the motion and fitted by its shifts (:mod:`slbench.cloud.motion.at_rest`), is noise alone.
The velocity is the one that leaves the least squares, by Gauss and Newton's method, from rest.
Pixels at edges, which no motion explains, have less weight (J. W. Tukey's biweight), and frames are
blurred a little first, so that looking them up between pixels does not lessen their noise.

*What is told.*  A plain surface looks the same wherever it slides along itself: such a velocity
cannot be seen, and does no harm.  Derivatives of noise are held apart from those of the picture by
frames of noise alone; a direction along which the picture's are not larger is left at rest and said
to be unseen, as is one whose deviation is beyond :data:`UNSEEN_PX` over the set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from slbench.capture.capture import Capture
from slbench.cloud.motion.at_rest import (
    Fitted,
    at_rest,
    check_compensation,
    radians_per_px,
    times_of,
)
from slbench.cloud.motion.following import Following
from slbench.cloud.triangulation import PointCloud, triangulate
from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.show.display import numbers
from slbench.patterns import Fringes
from slbench.patterns.base import Placed, extent
from slbench.rig.motion import Motion

Array = NDArray[np.float64]

#: Pixels that are looked at.
_PIXELS = 6_000
#: Median of the size of a number of unit deviation.
_HALF_NORMAL = 0.6745
#: Steps of Gauss and Newton's method, and when it has come to its end: of the motion within the
#: set, px.
_STEPS, _DONE_PX = 12, 2e-3
#: Steps in which all pixels have the same weight.
_PLAIN_STEPS = 3
#: Motion within the set by which derivatives are taken, px.
_TRIED_PX = 0.05
#: A direction is unseen whose motion within the set is not known to so much, px.
UNSEEN_PX = 0.3
#: A direction is unseen along which all derivatives are not so many times those of noise (squares).
_ABOVE_NOISE = 2.0
#: Residuals beyond so many medians have no weight.
_MEDIANS = 3.0
#: Blur of the frames, px: at one pixel, noise of a cubic spline is nearly the same everywhere.
_BLUR_PX = 1.0
#: How often points are measured, at rest and by the motion that was found.
_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class EstimatedMotion:
    """A velocity that frames tell.

    Parameters
    ----------
    motion : Motion
    covariance : (3, 3) float
        Of the velocity, (mm/s)^2, by the scatter of the residuals; of seen directions.
    unseen : (k, 3) float
        Directions of unit length along which nothing is told.
    """

    motion: Motion
    covariance: Array
    unseen: Array

    def __repr__(self) -> str:
        return f"<EstimatedMotion {self}>"

    def __str__(self) -> str:
        deviations = np.sqrt(np.diag(self.covariance))
        text = f"{numbers(self.motion.velocity_mm_per_s)} ± {numbers(deviations)} mm/s"
        if not len(self.unseen):
            return text
        return f"{text}, unseen along " + " and ".join(f"({numbers(one)})" for one in self.unseen)


def estimated_motion(capture: Capture) -> EstimatedMotion:
    """Estimate the velocity of what a capture sees.

    Parameters
    ----------
    capture : Capture
        With its rig and its timing, and a fringe set of four shifts or more.

    Returns
    -------
    EstimatedMotion
        Without rotation.

    Raises
    ------
    InputError
        As :func:`slbench.cloud.motion.at_rest`, and for a sequence without such a set.
    """
    check_compensation(capture)
    assert capture.rig is not None
    assert capture.timing is not None
    shots = capture.apart()
    sets = [
        placed
        for placed in shots.sequence.placed()
        if isinstance(placed.code, Fringes) and len(placed.frames) > 3
    ]
    if not sets:
        expected = "a fringe set of four shifts or more, by which motion is estimated"
        raise InputError("motion", expected, shots.sequence.name)
    found = EstimatedMotion(Motion(), np.zeros((3, 3)), np.eye(3))
    still = shots.decode(max_order_residual=0.5)
    for k in range(_ROUNDS):
        if k:
            still = at_rest(capture, found.motion.at).decode(max_order_residual=0.5)
        cloud = triangulate(capture.rig, still)
        if not len(cloud):
            raise InputError("motion", "points to follow from frame to frame", "none")
        search = _Search(capture, shots, sets, cloud)
        found = search.solved(np.array(found.motion.velocity_mm_per_s))
    return found


class _Search:
    """What is left of the frames of fringe sets, by velocity."""

    def __init__(
        self, capture: Capture, shots: Capture, sets: Sequence[Placed], cloud: PointCloud
    ) -> None:
        assert capture.rig is not None
        assert capture.timing is not None
        self._rig, self._cloud = capture.rig, cloud
        self._sets = [(one, one.code) for one in sets if isinstance(one.code, Fringes)]
        u, v = cloud.pixels.T
        measured = v * shots.frames.shape[2] + u
        self._pixels = measured[:: max(1, -(-len(measured) // _PIXELS))].astype(np.intp)
        self._panel, self._channels = shots.sequence.panel, capture.sequence.channels
        self._middles = times_of(capture)
        used = [k for one in sets for k in one.frames]
        black = 0.0 if shots.noise is None else shots.noise.offset_dn
        self._frames = {
            k: _smooth(np.nan_to_num(shots.frames[k].astype(np.float64)) - black) for k in used
        }
        self._path = Following(capture.rig, cloud, capture.timing, self._middles, self._pixels)
        self._noise_dn = float(np.median([_noise_dn(shots.frames[k], self._pixels) for k in used]))
        rng = generator(0)
        self._noise = {k: _smooth(rng.normal(size=shots.frames.shape[1:])) for k in used}
        times = [self._middles[k // self._channels] for k in used]
        #: Pixels that a velocity of 1 mm/s is within the set.
        self.px_per_speed = (max(times) - min(times)) * self._px_per_mm()

    def _px_per_mm(self) -> float:
        """Return how far the points' median moves on sensor or panel, by the better seen one."""
        ways = []
        for device in (self._rig.camera, self._rig.projector):
            _, jacobian = device.project_with_jacobian(self._cloud.points)
            ways.append(float(np.nanmedian(np.linalg.norm(jacobian, axis=(1, 2)))))
        return max(ways)

    def left(self, velocity: Array, frames: Mapping[int, Array] | None = None) -> Array:
        """Return residuals (R, P) by a velocity, of other frames if they are given."""
        given = self._frames if frames is None else frames
        motion = Motion(velocity_mm_per_s=tuple(velocity.tolist()))
        pictures = {frame // self._channels for frame in given}
        at = {k: self._path.at(k, motion.at) for k in pictures}
        found = []
        for one, code in self._sets:
            axis = code.axis
            turned = [at[k // self._channels][1][:, "uv".index(axis)] for k in one.frames]
            shifts = code.steps(extent(self._panel, axis))[:, np.newaxis]
            shifts = shifts - radians_per_px(one, self._panel) * np.stack(turned)
            looked = []
            for k in one.frames:
                pixels, _, light = at[k // self._channels]
                looked.append(_between(given[k], pixels) / light)
            found.append(Fitted.of(np.stack(looked), shifts).residual)
        return np.concatenate(found)

    def _derivatives(
        self, velocity: Array, left: Array, step: float, frames: Mapping[int, Array] | None = None
    ) -> Array:
        """Return the derivatives of residuals by the velocity, (3, R, P)."""
        tried = [self.left(velocity + step * own, frames) - left for own in np.eye(3)]
        return np.stack(tried) / step

    def solved(self, start: Array) -> EstimatedMotion:
        """Return the velocity that leaves the least, from a start (3,)."""
        velocity, step = start, _TRIED_PX / self.px_per_speed
        # Frames of noise alone, once: they hardly depend on where they are looked up.
        noise = self.left(velocity, self._noise)
        of_noise = self._derivatives(velocity, noise, step, self._noise)
        for k in range(_STEPS):
            left = self.left(velocity)
            slopes = self._derivatives(velocity, left, step)
            # At first what moves leaves more than an edge does, and more where it tells more.
            weight = _biweight(left) if k >= _PLAIN_STEPS else np.ones(left.shape[1])
            for one in (slopes, of_noise):  # at the picture's border
                weight[~np.isfinite(one).all(axis=(0, 1))] = 0.0
            freedom = weight.sum() * sum(len(one.frames) - 3 for one, _ in self._sets)
            information = _products(slopes, slopes, weight)
            along = _products(slopes, left[np.newaxis], weight)[:, 0]
            floor = self._noise_dn**2 * _products(of_noise, of_noise, weight)
            known = self._noise_dn**2 * float(np.nansum(weight * noise * noise) / freedom)
            seen, unseen = self._directions(information, floor, known)
            change = -seen @ np.linalg.solve(seen.T @ information @ seen, seen.T @ along)
            velocity = velocity + change
            done = np.linalg.norm(change) * self.px_per_speed < _DONE_PX
            if done and k >= _PLAIN_STEPS:
                break
        variance = float(np.nansum(weight * left * left) / freedom)
        # Blurred pixels are not independent: so many are one.
        spacing = len(self._cloud) / len(self._pixels)
        alike = max(1.0, 4.0 * np.pi * _BLUR_PX**2 / spacing)
        inverse = np.linalg.inv(seen.T @ information @ seen)
        covariance = seen @ inverse @ seen.T * variance * alike
        motion = Motion(velocity_mm_per_s=tuple(velocity.tolist()))
        return EstimatedMotion(motion, covariance, unseen.T)

    def _directions(self, information: Array, floor: Array, variance: float) -> tuple[Array, Array]:
        """Return directions (3, k) that are seen, and those (3, 3 - k) that are not."""
        values, vectors = np.linalg.eigh(information)
        of_noise = np.einsum("ij,ik,kj->j", vectors, floor, vectors)
        deviation = np.sqrt(variance / np.maximum(values - of_noise, 1e-300)) * self.px_per_speed
        seen = (values > _ABOVE_NOISE * of_noise) & (deviation < UNSEEN_PX)
        return vectors[:, seen], vectors[:, ~seen]


def _noise_dn(frame: NDArray[Any], pixels: NDArray[np.intp]) -> float:
    """Return the deviation of a frame's noise, DN, by what no smooth picture has.

    J. Immerkaer, "Fast noise variance estimation", Comput. Vis. Image Underst. 64(2), 1996; with
    the median, which edges hardly change.
    """
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
    seen = ndimage.convolve(np.nan_to_num(frame.astype(np.float64)), mask, mode="mirror")
    return float(np.median(np.abs(seen.ravel()[pixels]))) / (6.0 * _HALF_NORMAL)


def _smooth(frame: Array) -> Array:
    """Return the coefficients of a cubic spline through a blurred frame."""
    blurred = ndimage.gaussian_filter(frame, _BLUR_PX, mode="mirror")
    return np.asarray(ndimage.spline_filter(blurred, order=3, mode="mirror"))


def _between(coefficients: Array, pixels: Array) -> Array:
    """Return a frame at places (P, 2), NaN beyond its borders."""
    places = pixels.T[::-1]
    found = ndimage.map_coordinates(coefficients, places, order=3, mode="mirror", prefilter=False)
    last = np.array(coefficients.shape)[:, np.newaxis] - 1
    with np.errstate(invalid="ignore"):
        found[~((places >= 0) & (places <= last)).all(axis=0)] = np.nan
    return np.asarray(found)


def _biweight(left: Array) -> Array:
    """Return the weight of each pixel by what is left of it, (P,); none of one without numbers."""
    size = np.sqrt(np.sum(left * left, axis=0))
    share = size / (_MEDIANS * np.nanmedian(size))
    return np.where(share < 1.0, (1.0 - share**2) ** 2, 0.0)


def _products(one: Array, other: Array, weight: Array) -> Array:
    """Return weighed sums over residuals of products, (i, R, P) and (j, R, P) to (i, j)."""
    known = weight > 0.0
    return np.einsum("irp,jrp,p->ij", one[..., known], other[..., known], weight[known])
