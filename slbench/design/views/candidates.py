"""Poses that a stage can take up: on a turntable, on three linear axes, about a hemisphere.

All keep the rig and move the part.  Where a robot moves the rig, the world is seen from the rig:
what it measures is the same, as long as no light comes from elsewhere.

*Table.*  A part that stands on a table has its frame there: z up, in a stable pose or as the scene
has it.  Whatever is below the table's top neither sees nor lights the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.objects.resting import stable_poses
from slbench.rig import Pose
from slbench.scene.model import Scene

Array = NDArray[np.float64]
Stage = Literal["rotary", "xyz", "robot"]

#: Stable poses that a stage uses unless said otherwise; 0 keeps the pose of the scene.
USUAL_POSES: dict[Stage, int] = {"rotary": 4, "xyz": 0, "robot": 2}
#: Turns of the rig about its line of sight: the plane of triangulation decides what is in shadow.
_ROLLS = (0.0, 90.0)
#: Steps of a turntable are a multiple of this, so that few even views are among them.
_EVEN = 12
#: The golden angle, by which directions are spread over a hemisphere (R. Swinbank and R. J. Purser,
#: "Fibonacci grids", Q. J. R. Meteorol. Soc. 132, 2006).
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose of the part in the world.

    Parameters
    ----------
    pose : Pose
    resting : int
        Number of its stable pose from 0, or -1 where it is held as the scene has it.
    description : str
    table : Pose
        Of the table in the world, z up; the part is above its xy plane.
    stands : bool
        Whether there is a table.
    """

    pose: Pose
    resting: int
    description: str
    table: Pose
    stands: bool


@dataclass(frozen=True, kw_only=True)
class Staging:
    """What stage holds the part.

    Parameters
    ----------
    stage : {"rotary", "xyz", "robot"}
    count : int
        Candidates, about.
    stable_poses : int or None
        How many of the most probable stable poses are used; 0 keeps the pose of the scene, None
        is :data:`USUAL_POSES`.
    tilt_deg : float
        Of the turntable's axis against the line from the volume to the devices.
    least_elevation_deg : float
        Of a robot's views above the table.
    """

    stage: Stage = "rotary"
    count: int = 200
    stable_poses: int | None = None
    tilt_deg: float = 45.0
    least_elevation_deg: float = 20.0


def candidates(scene: Scene, staging: Staging) -> list[Candidate]:
    """Return the candidates of a stage, in a fixed order.

    Parameters
    ----------
    scene : Scene
        With the part alone.
    staging : Staging

    Raises
    ------
    InputError
        If the part has no stable pose and is to stand.
    """
    part, place = scene.objects[0], scene.place
    wanted = staging.stable_poses
    wanted = USUAL_POSES[staging.stage] if wanted is None else wanted
    held = place.inverse.after(part.pose).rotation
    rests: list[tuple[int, Array, str]] = [(-1, held, "as the scene has it")]
    if wanted:
        rotations, shares = stable_poses(part.artefact.mesh)
        if not len(shares):
            raise InputError(part.artefact.name, "a shape that stands on a table", "none")
        rests = [
            (k, rotation, f"stable pose {k + 1} ({100 * share:.0f} % of falls)")
            for k, (rotation, share) in enumerate(zip(rotations, shares, strict=True))
        ][:wanted]
    moves = _MOVES[staging.stage](staging, max(1, staging.count // len(rests)), scene)
    found = []
    for rest, rotation, standing in rests:
        corners = part.artefact.mesh.vertices @ rotation.T
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle = 0.5 * (low + high)
        # The middle of the part is that of the volume.
        on_table = Pose(rotation, -middle)
        top = Pose(np.eye(3), np.array([0.0, 0.0, low[2] - middle[2]]))
        for move, words in moves:
            moved = place.after(move)
            text = f"{words}, {standing}"
            found.append(Candidate(moved.after(on_table), rest, text, moved.after(top), wanted > 0))
    return found


def _turns(staging: Staging, count: int, scene: Scene) -> list[tuple[Pose, str]]:
    """Return the steps of a turntable."""
    steps = max(_EVEN, count // _EVEN * _EVEN)
    tilt = _about_x(np.deg2rad(staging.tilt_deg))
    return [
        (Pose(tilt @ _about_z(2.0 * np.pi * k / steps), np.zeros(3)), f"{360.0 * k / steps:.4g}°")
        for k in range(steps)
    ]


def _shifts(staging: Staging, count: int, scene: Scene) -> list[tuple[Pose, str]]:
    """Return shifts by which a part that is larger than the volume is moved through it."""
    part = scene.objects[0]
    rotation = scene.place.inverse.after(part.pose).rotation
    size = np.ptp(part.artefact.mesh.vertices @ rotation.T, axis=0)
    volume = np.array(scene.rig.volume_mm)
    reach = 0.5 * np.maximum(size - volume, 0.0) + 0.25 * volume
    along = max(1, round(count ** (1.0 / 3.0)))
    steps = np.linspace(-1.0, 1.0, along) if along > 1 else np.zeros(1)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3) * reach
    return [
        (Pose(np.eye(3), shift), "x {:.4g} y {:.4g} z {:.4g} mm".format(*shift)) for shift in grid
    ]


def _directions(staging: Staging, count: int, scene: Scene) -> list[tuple[Pose, str]]:
    """Return turns that bring a direction above the table to where the devices are."""
    many = max(1, count // len(_ROLLS))
    least = np.sin(np.deg2rad(staging.least_elevation_deg))
    found = []
    for k in range(many):
        up = 1.0 - (1.0 - least) * (k + 0.5) / many
        azimuth = k * _GOLDEN
        elevation = np.arcsin(up)
        # Turned about the table's z until the opposite direction is towards +y, then leant to +z.
        leant = _about_x(0.5 * np.pi - elevation) @ _about_z(-0.5 * np.pi - azimuth)
        words = (
            f"azimuth {np.rad2deg(azimuth + np.pi) % 360.0:.4g}°, "
            f"elevation {np.rad2deg(elevation):.4g}°"
        )
        found += [
            (Pose(_about_z(np.deg2rad(roll)) @ leant, np.zeros(3)), f"{words}, roll {roll:g}°")
            for roll in _ROLLS
        ]
    return found


_MOVES = {"rotary": _turns, "xyz": _shifts, "robot": _directions}


def uniform_turntables(found: Sequence[Candidate], most: int) -> dict[int, list[int]]:
    """Return the candidates of uniform turntables of up to so many views, by their number.

    They stand in the first stable pose; numbers that do not divide its steps are left out.
    """
    first = [k for k, one in enumerate(found) if one.resting == found[0].resting]
    return {
        count: first[:: len(first) // count]
        for count in range(1, most + 1)
        if len(first) % count == 0
    }


def _about_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
