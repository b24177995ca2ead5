"""Focus settings of a stack: which distances the devices are focused at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.core.validation.types import MaxLen, Measure, MinLen
from slbench.core.validation.values import Value
from slbench.rig import Pose, Rig

#: More settings than any stack has are a slip.
MAX_SETTINGS = 1000


@dataclass(frozen=True)
class Focus(Value):
    """Focus settings of a stack: one distance of each device a setting.

    Parameters
    ----------
    distances_mm : mapping of str to tuple of float
        By device: distances in focus along its axis, equally many, at least one.
    """

    distances_mm: dict[str, Annotated[tuple[Measure, ...], MinLen(1), MaxLen(MAX_SETTINGS)]]

    __repr__ = brief

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = {name: len(values) for name, values in self.distances_mm.items()}
        if len(set(counts.values())) != 1:
            got = " and ".join(f"{count} of the {name}" for name, count in counts.items())
            raise InputError("focus", "as many distances of every device", got)

    def __len__(self) -> int:
        return len(next(iter(self.distances_mm.values())))

    def rig(self, rig: Rig, setting: int) -> Rig:
        """Return the rig at one of the settings."""
        return rig.focused({name: values[setting] for name, values in self.distances_mm.items()})

    @classmethod
    def sweep(
        cls,
        rig: Rig,
        heights_mm: Sequence[float],
        move: str = "both",
        apart: bool = False,
        place: Pose | None = None,
    ) -> Self:
        """Return settings that focus on points above a place, one after the other.

        Parameters
        ----------
        rig : Rig
        heights_mm : sequence of float
            Heights z of the points.
        move : str
            Which device follows, by name, the others keep their focus; "both" moves all.
        apart : bool
            Every height of a device with every one of the others; together otherwise.
        place : Pose, optional
            Heights are along its z from its origin; the world's frame by default.
        """
        if move not in ("both", *rig.devices):
            raise InputError("focus move", f"both or one of {', '.join(rig.devices)}", move)
        if apart and move != "both":
            raise InputError("focus", "apart only where both devices move", move)
        distances = []
        for name, device in rig.devices.items():
            if move in ("both", name):
                points = np.array([[0.0, 0.0, z] for z in heights_mm]).reshape(-1, 3)
                points = points if place is None else place.to_world(points)
                depth = (points - device.pose.position) @ device.pose.rotation[:, 2]
                distances.append([float(d) for d in depth])
            else:
                distances.append([device.lens.focus_distance_mm] * len(heights_mm))
        settings = product(*distances) if apart else zip(*distances, strict=True)
        return cls(dict(zip(rig.devices, zip(*settings, strict=True), strict=True)))
