"""Doubts about a new scene: options that are plausibly wrong."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import length
from slbench.rig.device import Device
from slbench.scene.model import Scene

Array = NDArray[np.float64]

#: Size of an object over the smaller side of the camera's field below which another unit is likely.
_SMALL = 0.02
#: Share of the camera's field, either way, that a projector's picture covers at least.
_COVERED = 0.9


def new_scene_doubts(scene: Scene) -> Iterator[tuple[str, str]]:
    """Question what is plausibly wrong about a new scene: (option, sentence)."""
    camera, projector = scene.rig.camera, scene.rig.projector
    seen, lit = _picture(camera), _picture(projector)
    size = np.array(scene.rig.volume_mm[:2])
    focus = camera.lens.focus_distance_mm
    fields = f"the camera sees {_by(seen)} mm at the object"
    if camera.lens.magnification > 1.0:
        times = f"the picture is {camera.lens.magnification:.3g} times the object"
        yield "--focus-mm", f"{length(focus)} is within twice the focal length: {times}"
    if size.max() < _SMALL * seen.min():
        other = f"{focus:.6g} µm would be {length(1e-3 * focus)}"
        yield "--focus-mm", f"{fields}, which is {_by(size)} mm; {other}"
    elif np.any(size > seen):
        yield "--lens-mm", f"{fields}, which is {_by(size)} mm: a shorter lens, or further away?"
    if np.any(lit < _COVERED * seen):
        dark = "what is beyond is dark in the frames"
        yield "--throw-ratio", f"{fields}, and the projector lights {_by(lit)} mm there; {dark}"


def _picture(device: Device) -> Array:
    """Return width and height of what a device sees, or lights, at the depth of the origin, mm."""
    depth = device.pose.origin_depth
    corners = device.frustum(depth, depth)[:4]
    return np.array(
        [np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[3] - corners[0])]
    )


def _by(sides: Array) -> str:
    return " x ".join(f"{side:.6g}" if side >= 1e3 else f"{side:.4g}" for side in sides)
