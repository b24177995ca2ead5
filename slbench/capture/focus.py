"""Focus settings of a stack: which distances the devices are focused at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.rig import Rig

#: More settings than any stack has are a slip.
MAX_SETTINGS = 1000


@dataclass(frozen=True)
class Focus:
    """Focus settings of a stack: one distance of each device a setting.

    Parameters
    ----------
    camera_mm, projector_mm : tuple of float
        Distances in focus along the axes, equally many, at least one.
    """

    camera_mm: tuple[float, ...]
    projector_mm: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.camera_mm or len(self.camera_mm) != len(self.projector_mm):
            got = f"{len(self.camera_mm)} and {len(self.projector_mm)}"
            raise InputError("focus", "as many distances of the camera as of the projector", got)
        if len(self.camera_mm) > MAX_SETTINGS:
            raise InputError("focus", f"at most {MAX_SETTINGS} settings", len(self.camera_mm))
        for distance in (*self.camera_mm, *self.projector_mm):
            if not 0 < distance < np.inf:
                raise InputError("focus", "positive distances (mm)", distance)

    def __len__(self) -> int:
        return len(self.camera_mm)

    @classmethod
    def sweep(
        cls,
        rig: Rig,
        heights_mm: Sequence[float],
        move: Literal["both", "camera", "projector"] = "both",
        apart: bool = False,
    ) -> Self:
        """Return settings that focus on points above the origin, one after the other.

        Parameters
        ----------
        rig : Rig
        heights_mm : sequence of float
            Heights z of the points.
        move : {"both", "camera", "projector"}
            Which device follows; the other keeps its focus.
        apart : bool
            Every height of the camera with every one of the projector; together otherwise.
        """
        if move not in ("both", "camera", "projector"):
            raise InputError("focus move", "both, camera or projector", move)
        distances = []
        for name, device in (("camera", rig.camera), ("projector", rig.projector)):
            if move in ("both", name):
                points = np.array([[0.0, 0.0, z] for z in heights_mm]).reshape(-1, 3)
                depth = (points - device.pose.position) @ device.pose.rotation[:, 2]
                distances.append([float(d) for d in depth])
            else:
                distances.append([device.lens.focus_distance_mm] * len(heights_mm))
        if apart:
            if move != "both":
                raise InputError("focus", "apart only where both devices move", move)
            pairs = [(c, p) for c in distances[0] for p in distances[1]]
            distances = [[c for c, _ in pairs], [p for _, p in pairs]]
        return cls(tuple(distances[0]), tuple(distances[1]))
