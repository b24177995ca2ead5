"""Free ways between points of surfaces and the lens of a device."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.rig import Device
from slbench.simulate.render.mitsuba import mi

Array = NDArray[np.float64]

#: How far off its surface a point's way begins, of its largest coordinate plus 1 mm: more than
#: single precision rounds, as Mitsuba does by itself.
_OFF = 1e-5


def free_view(
    geometry: Any, device: Device, point: Array, normal: Array, asked: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return a mask of points that face a device's lens centre with a free view of it.

    Parameters
    ----------
    geometry : mi.Scene
        What may stand between.
    device : Device
    point, normal : (N, 3) float
        On the surface, in the world, mm; NaN where they are not asked for.
    asked : (N,) bool
        Points of interest; False elsewhere.
    """
    source = device.chief_origin(point)
    facing = asked & (np.sum((source - point) * normal, axis=-1) > 0)
    facing &= device.pose.to_local(point)[:, 2] > 0
    scale = 1.0 + np.max(np.abs(np.nan_to_num(point)), axis=-1, keepdims=True)
    start = point + normal * scale * _OFF
    toward = source - start
    length = np.linalg.norm(toward, axis=-1)
    ray = mi.Ray3f(mi.Point3f(columns(start)), mi.Vector3f(columns(toward / length[:, None])))
    ray.maxt = mi.Float(np.nan_to_num(length).astype(np.float32))
    blocked = geometry.ray_test(ray, active=mi.Bool(facing))
    return facing & ~np.asarray(blocked.numpy(), dtype=bool)


def columns(vectors: Array) -> Any:
    """Return vectors (N, 3) as Dr.Jit takes them, in single precision; NaN as 0."""
    return np.ascontiguousarray(np.nan_to_num(vectors).T.astype(np.float32))
