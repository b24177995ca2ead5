"""Motion compensation: frames of what moved, as they would be had it stood still at time zero.

With the motion known, a first decoding says where the point of each pixel is in every picture
(:mod:`slbench.cloud.motion.following`), and each frame is looked up there.  What is seen then is
the same point of the surface, lit by another place of the panel: fringes of n periods across W
pixels show

    I_k = a + b cos(phi + w d_k - e_k),   w = 2 pi n / W,

where d_k is by how much the point's panel coordinate has grown, and e_k the shift that was
projected.  These are frames of shifts e_k - w d_k, another list for each pixel; least squares
gives a, b and phi at time zero (:mod:`slbench.patterns.fringes.weights`), and from them the frames
of the projected shifts.  (Phase errors of motion, and their correction by shifts that are known:
L. Lu et al., "New approach for high-speed 3D shape measurement by motion compensation", Opt.
Express 21(25), 2013; S. Feng et al., "Robust dynamic 3-D measurements with motion-compensated
phase-shifting profilometry", Opt. Lasers Eng. 103, 2018.)

Other codes (Gray bits) show one of few values, and not how far they are off: their column is moved
by the mean of d over their frames, weighed by how many edges each has, as an edge of frame k is off
by d_k.  What bits of one pixel differ in is left; fringes behind them need no more.

*What is neglected.*  Points are matt, and their brightness follows the projector's light; ambient
light, gloss, shadows that move, and what appears from behind an edge are not known.  Frames are
interpolated between pixels by cubic splines, which lessens their noise, so that predicted
deviations are upper bounds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from slbench.capture.capture import Capture
from slbench.cloud.motion.following import Following
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.patterns import Axis, Fringes, PhaseMap
from slbench.patterns.base import Placed, extent
from slbench.rig.motion import Moving

Array = NDArray[np.float64]

#: Of the first decoding, which motion has spoilt, and of what it corrects.
ROUNDS = 2
#: A frame is looked up between pixels where it has moved by more, px.
_STILL_PX = 1e-4
#: Least determinant of a pixel's shifts, as a share of that of even ones.
_TOLD_APART = 1e-3
#: Pixels that are solved for together.
_PIXELS = 1 << 17


@dataclass(frozen=True, eq=False)
class AtRest:
    """A capture of what moved, as if it had stood still at time zero.

    Parameters
    ----------
    capture : Capture
        Float frames.
    drift_px : mapping of (int, axis) to (V, U) float
        By part of the sequence: how far its code is off along an axis.
    noise_gain : mapping of axis to (V, U) float
        What the shifts that were left make of the deviation of its finest fringes.
    """

    capture: Capture
    drift_px: Mapping[tuple[int, Axis], Array]
    noise_gain: Mapping[Axis, Array]

    __repr__ = brief

    def decode(self, **options: Any) -> PhaseMap:
        """Decode the frames; options are those of :meth:`Capture.decode`."""
        phase = self.capture.decode(drift=self.drift_px, **options)
        sigma = {
            axis: values * self.noise_gain.get(axis, 1.0) for axis, values in phase.sigma.items()
        }
        return replace(phase, sigma=sigma)


def at_rest(capture: Capture, moving: Moving, rounds: int = ROUNDS) -> AtRest:
    """Take known motion out of the frames of a capture.

    Parameters
    ----------
    capture : Capture
        With its rig and its timing.
    moving : callable
        The motion of all that is seen, as the rig sees it: ``Motion.at``.
    rounds : int
        How often the points that are followed are measured.

    Returns
    -------
    AtRest

    Raises
    ------
    InputError
        For a capture whose rig or timing is not known, with a projector that is not linear, or of
        which nothing is measured.
    """
    check_compensation(capture)
    assert capture.timing is not None
    assert capture.rig is not None
    middles = times_of(capture)
    shots = capture.apart()
    still = AtRest(shots, {}, {})
    for _ in range(rounds):
        cloud = triangulate(capture.rig, still.decode(max_order_residual=0.5))
        if not len(cloud):
            raise InputError("motion", "points to follow from frame to frame", "none")
        path = Following(capture.rig, cloud, capture.timing, middles)
        still = _stilled(shots, path, moving, capture.sequence.channels)
    return still


def check_compensation(capture: Capture) -> None:
    """Check that motion can be taken out of a capture's frames.

    Raises
    ------
    InputError
        As :func:`at_rest`.
    """
    capture.one_exposure("motion")
    if capture.rig is None:
        raise InputError("motion", "a rig, by which points are followed", "none")
    if capture.timing is None:
        raise InputError(
            "frame_period_ms", "the time from frame to frame, to follow motion", "none"
        )
    if capture.response is not None:
        expected = (
            "a linear projector, or pictures that undo its response, where motion is taken out"
        )
        raise InputError("response", expected, capture.response)


def times_of(capture: Capture) -> Array:
    """Return the time of the middle row of each picture, (M,), s."""
    assert capture.timing is not None
    sequence = capture.sequence
    pictures = -(-sequence.n_frames // sequence.channels)
    return capture.timing.middles(pictures, sequence.middle_picture)


def _stilled(shots: Capture, path: Following, moving: Moving, channels: int) -> AtRest:
    """Return the frames of a capture as they would be at time zero."""
    sequence, shape = shots.sequence, shots.frames.shape[1:]
    frames = np.empty(shots.frames.shape, np.float32)
    black = 0.0 if shots.noise is None else shots.noise.offset_dn
    shifts = np.empty((2, *shots.frames.shape), np.float32)
    for first in range(0, len(frames), channels):
        pixels, shift, light = path.at(first // channels, moving)
        for k in range(first, min(first + channels, len(frames))):
            looked = looked_up(shots.frames[k], pixels, path.own, shots.top_dn)
            even = (looked - black) / light.astype(np.float32) + black
            looked = np.where(looked >= shots.top_dn, looked, even)
            frames[k] = looked.reshape(shape)
            shifts[:, k] = shift.T.reshape(2, *shape)
    drift: dict[tuple[int, Axis], Array] = {}
    gains: dict[Axis, Array] = {}
    for placed in sequence.placed():
        own = slice(placed.frames.start, placed.frames.stop)
        if isinstance(placed.code, Fringes):
            axis = placed.code.axis
            turning = shifts["uv".index(axis), own] * radians_per_px(placed, sequence.panel)
            steps = placed.code.steps(extent(sequence.panel, axis))
            gain = _projected(frames[own], steps, turning, shots.top_dn)
            finest = sequence.finest(axis)
            if finest is not None and finest.index == placed.index:
                gains[axis] = gain
            continue
        for axis in placed.code.axes:
            weights = _edges(placed, axis, sequence.panel)
            moved = np.tensordot(weights, shifts["uv".index(axis), own], axes=1)
            drift[placed.index, axis] = np.asarray(moved, np.float64)
    top = shots.top_dn
    still = replace(
        shots,
        frames=frames,
        bit_depth=None,
        noise=shots.noise,
        saturation_dn=int(top) if np.isfinite(top) else None,
        min_modulation_dn=shots.min_modulation_dn,
        timing=None,
        pictures=None,
    )
    return AtRest(still, drift, gains)


def looked_up(frame: NDArray[Any], pixels: Array, own: Array, top_dn: float) -> NDArray[np.float32]:
    """Return a frame at places (P, 2) between pixels, (P,), by cubic splines.

    Parameters
    ----------
    frame : (V, U) array
    pixels : (P, 2) float
        (u, v); NaN comes of places that the frame does not have.
    own : (P, 2) float
        Pixels (u, v) that the places belong to: of a frame that does not move they are taken.
    top_dn : float
        Value at and above which a pixel is saturated, and so what is between it and others.
    """
    if np.nanmax(np.abs(pixels - own), initial=0.0) < _STILL_PX:
        columns, rows = own.astype(np.intp).T
        return np.asarray(frame[rows, columns], np.float32)
    places = np.ascontiguousarray(pixels.T[::-1])
    bad = ~np.isfinite(frame)
    saturated = frame >= top_dn
    values = np.where(bad, 0.0, frame).astype(np.float64)
    found = ndimage.map_coordinates(values, places, order=3, mode="mirror")
    for marked, value in ((saturated, top_dn), (bad, np.nan)):
        if marked.any():
            touched = ndimage.map_coordinates(marked.astype(np.float32), places, order=1)
            found[touched > 0.0] = value
    height, width = frame.shape
    with np.errstate(invalid="ignore"):
        inside = (places[0] >= 0) & (places[0] <= height - 1)
        inside &= (places[1] >= 0) & (places[1] <= width - 1)
    found[~inside] = np.nan
    return np.asarray(found, np.float32)


def radians_per_px(placed: Placed, panel: tuple[int, int]) -> float:
    """Return by how much the phase of a fringe set grows over a panel pixel."""
    count = placed.code.fringe_count(panel) or 0.0
    return 2.0 * np.pi * count / extent(panel, placed.code.axes[0])


def _edges(placed: Placed, axis: Axis, panel: tuple[int, int]) -> Array:
    """Return how much each frame of a code decides of its column, (N,): by its edges."""
    size = extent(panel, axis)
    found = np.zeros(len(placed.frames))
    for k in range(len(found)):
        if placed.code.varies(k) == axis:
            found[k] = np.abs(np.diff(placed.code.profile(k, size))).sum()
        elif placed.code.varies(k) == "uv":
            found[k] = 1.0
    return found / found.sum() if found.any() else np.full(len(found), 1.0 / len(found))


def _projected(
    frames: NDArray[np.float32], steps: Array, turning: NDArray[np.floating], top_dn: float
) -> Array:
    """Change frames (N, V, U) of shifts ``steps - turning`` into those of shifts `steps` (N,).

    What a sinusoid leaves of them stays, as far as the projected shifts leave it; pixels that
    saturate stay marked.

    Returns
    -------
    (V, U) float
        By how much the deviation of the phase grows.
    """
    count, shape = len(frames), frames.shape[1:]
    flat, turned = frames.reshape(count, -1), turning.reshape(count, -1)
    gain = np.empty(flat.shape[1])
    design = np.stack((np.cos(steps), np.sin(steps), np.ones(count)), axis=1)
    rest = np.eye(count) - design @ np.linalg.pinv(design)
    for first in range(0, flat.shape[1], _PIXELS):
        part = slice(first, first + _PIXELS)
        values = flat[:, part].astype(np.float64)
        saturated = (values >= top_dn).any(axis=0)
        fit = Fitted.of(values, steps[:, np.newaxis] - turned[:, part])
        gain[part] = fit.gain
        shown = design @ np.stack((fit.cosine, fit.sine, fit.mean))
        flat[:, part] = np.where(saturated, top_dn, shown + rest @ fit.residual)
    return gain.reshape(shape)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Sinusoids fitted to frames whose shifts differ from pixel to pixel.

    Parameters
    ----------
    mean, cosine, sine : (P,) float
        a, b cos phi and b sin phi; NaN where the shifts do not tell them.
    residual : (N, P) float
        What is left of the frames.
    gain : (P,) float
        Deviation of the phase, by that of even shifts (its mean square over all phases).
    """

    mean: Array
    cosine: Array
    sine: Array
    residual: Array
    gain: Array

    @classmethod
    def of(cls, frames: Array, shifts: Array) -> Fitted:
        """Fit ``a + b cos(phi - e_k)`` to frames (N, P) of shifts e_k (N, P), rad."""
        count = len(frames)
        cos, sin = np.cos(shifts), np.sin(shifts)
        mean_cos, mean_sin, mean = cos.mean(axis=0), sin.mean(axis=0), frames.mean(axis=0)
        cc = np.einsum("np,np->p", cos, cos) - count * mean_cos**2
        ss = np.einsum("np,np->p", sin, sin) - count * mean_sin**2
        cs = np.einsum("np,np->p", cos, sin) - count * mean_cos * mean_sin
        by_cos = np.einsum("np,np->p", frames, cos) - count * mean * mean_cos
        by_sin = np.einsum("np,np->p", frames, sin) - count * mean * mean_sin
        determinant = cc * ss - cs * cs
        determinant[determinant < _TOLD_APART * (0.5 * count) ** 2] = np.nan
        cosine = (ss * by_cos - cs * by_sin) / determinant
        sine = (cc * by_sin - cs * by_cos) / determinant
        centre = mean - cosine * mean_cos - sine * mean_sin
        residual = frames - (centre + cosine * cos + sine * sin)
        return cls(centre, cosine, sine, residual, np.sqrt(0.25 * count * (cc + ss) / determinant))
