"""The diagnosis of a capture: its panel coordinates against those that the shape would have."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slbench.bench.diagnose.accept import accepted, doubt_unit
from slbench.bench.diagnose.diagnosis import Diagnosis
from slbench.bench.diagnose.panel import Samples, Waves, judge, terms_of
from slbench.bench.diagnose.rim import inner
from slbench.bench.diagnose.shape import (
    MIN_POINTS,
    Plane,
    Shape,
    ShapeKind,
    Sphere,
    fit_shape,
    kind_of,
)
from slbench.cloud.decoded import Decoded
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError
from slbench.patterns.base import Axis
from slbench.rig import Device, Rig
from slbench.score.features import MAX_INCIDENCE

Array = NDArray[np.float64]

#: Points that are regressed; image lines are left out beyond.
_MOST = 1 << 18
#: Step by which the shape is moved for derivatives, mm.
_STEP_MM = 1e-4


def diagnose_capture(
    decoded: Decoded,
    *,
    shape: ShapeKind | Literal["auto"] = "auto",
    region: tuple[int, int, int, int] | None = None,
    diameter_mm: float | None = None,
    where: object = "capture",
) -> Diagnosis:
    """Say what the errors of a plane or a sphere come from, by a capture of it.

    Parameters
    ----------
    decoded : Decoded
        With points.
    shape : {"auto", "plane", "sphere"}
    region : (u, v, width, height), optional
        Window of camera pixels with the object.
    diameter_mm : float, optional
        Of the sphere, as it is known.
    where : object
        What to call the capture in messages.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        Without a rig, for fewer than 500 points, or points that are no plane and no sphere.

    Warns
    -----
    InputWarning
        For points of which a twentieth is off the shape.
    """
    cloud, rig = decoded.cloud, decoded.capture.rig
    if cloud is None or rig is None:
        raise InputError(
            where, "a capture with a rig, to know where its points are (--rig)", "none"
        )
    if region is not None:
        u, v = cloud.pixels.T
        left, top, width, height = region
        inside = (u >= left) & (u < left + width) & (v >= top) & (v < top + height)
        cloud = cloud.chosen(inside)
    fitted = _facing(fit_shape(cloud.points, shape, where), rig)
    if isinstance(fitted, Sphere):
        seen = [_faced(device, fitted, cloud.points) for device in (rig.camera, rig.projector)]
        cloud = cloud.chosen(np.logical_and(*seen))
    cloud = cloud.chosen(inner(cloud.pixels))
    fitted = _facing(fit_shape(cloud.points, kind_of(fitted), where), rig)
    axis, samples = _samples(decoded, rig, cloud, fitted)
    if len(samples.pixels) < MIN_POINTS:
        raise InputError(where, f"{MIN_POINTS} points at least on the shape", len(samples.pixels))
    step = -(-len(samples.pixels) // _MOST)
    samples = samples.chosen(samples.pixels[:, 1] % step == 0)
    doubt_unit(cloud.points, where)
    waves = _waves(decoded, axis, samples)
    accept = accepted(fitted, cloud.points, where)
    result = judge(samples, partial(terms_of, waves=waves), waves, fitted, accept)
    notes = [f"of two coded axes, {axis} alone is looked at"] if len(cloud.axes) > 1 else []
    if decoded.noise_kind == "lower bound":
        notes.append("predicted noise is a lower bound: rounding alone")
    result = replace(result, source=str(where), notes=tuple(notes), diameter_mm=diameter_mm)
    if isinstance(fitted, Sphere):
        own = fitted.diameter_deviation_mm(cloud.points, result["noise"].rms_mm)
        result = replace(result, diameter_deviation_mm=own)
    return result


def _facing(shape: Shape, rig: Rig) -> Shape:
    """Return the shape, a plane with its normal towards the camera."""
    if isinstance(shape, Plane):
        toward = rig.camera.chief_origin(shape.centre[None])[0] - shape.centre
        if toward @ shape.normal < 0.0:
            return Plane(-shape.normal, shape.centre)
    return shape


def _faced(device: Device, sphere: Sphere, points: Array) -> NDArray[np.bool_]:
    """Return which points turn no further than 60 degrees from a device."""
    toward = device.chief_origin(points) - points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    return np.asarray(np.sum(toward * sphere.outward(points), axis=1) > np.cos(MAX_INCIDENCE))


def _samples(decoded: Decoded, rig: Rig, cloud: PointCloud, shape: Shape) -> tuple[Axis, Samples]:
    """Return the points as camera and projector see them, by the axis that tells the distance."""
    gains = np.sum(cloud.sensitivity * shape.outward(cloud.points)[:, None], axis=2)
    k = int(np.argmax(np.median(np.abs(gains), axis=0)))
    axis = cloud.axes[k]
    origins, directions = rig.camera.unproject(cloud.pixels)

    def seen(where: Shape) -> Array:
        return np.asarray(
            rig.projector.project(where.met(origins, directions))[:, 0 if axis == "u" else 1]
        )

    predicted = seen(shape)
    moved = [(seen(shape.moved(j, _STEP_MM)) - predicted) / _STEP_MM for j in range(shape.freedom)]
    u, v = cloud.pixels.T
    samples = Samples(
        cloud.pixels,
        cloud.pixels.astype(np.float64),
        decoded.phase.coordinate[axis][v, u],
        predicted,
        np.stack(moved, axis=1),
        gains[:, k],
        cloud.sigma_px[:, k],
    )
    finite = np.isfinite(samples.jacobian.sum(axis=1) + predicted + samples.gain)
    return axis, samples.chosen(finite)


def _waves(decoded: Decoded, axis: Axis, samples: Samples) -> Waves:
    """Return what the coordinate was measured by."""
    sequence = decoded.capture.sequence
    placed = sequence.finest(axis)
    count = None if placed is None else placed.code.fringe_count(sequence.panel)
    u, v = samples.pixels.T
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast = decoded.phase.modulation[v, u] / decoded.phase.mean[v, u]
    shifts = 0 if placed is None or not count else len(placed.frames)
    period = sequence.size(axis) / float(count) if count else None
    return Waves(period, shifts, float(np.median(contrast)))
