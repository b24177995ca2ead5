"""Where the optical axes of a camera and a projector come closest: what a rig looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.rig.pose import Pose
from slbench.rig.rig import Rig

Array = NDArray[np.float64]

#: Square of the sine of an angle below which axes are parallel.
_PARALLEL = 1e-6
#: Distance of a volume, in baselines, where no axes tell it: rays meet at some 20 degrees.
_BASELINES = 3.0


@dataclass(frozen=True, eq=False)
class Closest:
    """The points of two axes that are nearest to each other, before both lenses.

    Parameters
    ----------
    camera_mm, projector_mm : float
        How far along each axis.
    gap_mm : float
        Between the two points.
    middle : (3,) float
        Halfway between them, mm in the world.
    """

    camera_mm: float
    projector_mm: float
    gap_mm: float
    middle: Array


def closest_axes(camera: Pose, projector: Pose) -> Closest | None:
    """Return where two axes come closest; None where they are parallel, or behind a lens."""
    a, b = camera.rotation[:, 2], projector.rotation[:, 2]
    apart = projector.position - camera.position
    cosine = float(a @ b)
    sine2 = 1.0 - cosine**2
    if sine2 < _PARALLEL:
        return None
    along_a = float(apart @ (a - cosine * b)) / sine2
    along_b = float(apart @ (cosine * a - b)) / sine2
    if min(along_a, along_b) <= 0.0:
        return None
    points = camera.position + along_a * a, projector.position + along_b * b
    gap = float(np.linalg.norm(points[0] - points[1]))
    return Closest(along_a, along_b, gap, 0.5 * (points[0] + points[1]))


def volume_place(rig: Rig) -> Pose:
    """Return where a rig without objects has its volume, z towards the camera.

    That is the world's frame.  Where its origin is not before both devices (the world is the
    camera's frame) it is where the axes come closest, turned as the camera is; or, where they
    never do, before the camera by some baselines.
    """
    if rig.faces_origin:
        return Pose()
    camera, projector = rig.camera.pose, rig.projector.pose
    closest = closest_axes(camera, projector)
    if closest is None:
        far = _BASELINES * float(np.linalg.norm(projector.position - camera.position)) or 1.0
        middle = camera.to_world(np.array([0.0, 0.0, far]))
    else:
        middle = closest.middle
    return Pose(camera.rotation * [1.0, -1.0, -1.0], middle)
