"""Where the world is: at a board, or where the optical axes come closest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.bundle.adjustment.adjust import Adjusted
from slbench.calibration.bundle.views import BoardView
from slbench.rig import Pose, Rig

Array = NDArray[np.float64]

#: Camera axes turned by pi about x: z towards the devices.
_TOWARDS = np.diag([1.0, -1.0, -1.0])


def placed(found: Adjusted, views: Sequence[BoardView], world: str | None) -> Adjusted:
    """Carry rig and poses from the camera's frame to the world's."""
    rig = found.rig
    points = np.concatenate(
        [pose.to_world(v.points_mm) for pose, v in zip(found.poses, views, strict=True)]
    )
    if world is None:
        depth = _working_distance(rig, points)
        frame = Pose(_TOWARDS, np.array([0.0, 0.0, depth]))
    else:
        frame = found.poses[[view.name for view in views].index(world)]

    def carried(pose: Pose) -> Pose:
        return Pose(frame.rotation.T @ pose.rotation, frame.to_local(pose.position))

    size = 2.0 * np.abs(frame.to_local(points)).max(axis=0)
    volume = np.maximum(size, 1e-3).tolist()
    return replace(
        found,
        rig=Rig(
            rig.camera.posed(carried(rig.camera.pose)),
            rig.projector.posed(carried(rig.projector.pose)),
            (volume[0], volume[1], volume[2]),
        ),
        poses=tuple(carried(pose) for pose in found.poses),
    )


def _working_distance(rig: Rig, points: Array) -> float:
    """Return how far along the camera's axis that of the projector comes closest, mm.

    Where that is not among the boards (the axes are parallel, or an axis points away as with a
    lens that is shifted), the boards' middle.
    """
    place, along = rig.projector.pose.position, rig.projector.pose.rotation[:, 2]
    # Closest points of (0, 0, s) and place + t along.
    cosine = float(along[2])
    near, far = float(points[:, 2].min()), float(points[:, 2].max())
    margin = far - near
    if 1.0 - cosine**2 > 1e-6:
        distance = float((place[2] - cosine * (along @ place)) / (1.0 - cosine**2))
        if near - margin < distance < far + margin:
            return distance
    return 0.5 * (near + far)
