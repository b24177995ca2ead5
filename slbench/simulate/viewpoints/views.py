"""Viewpoints: the poses of a part in which it is scanned, and the file that holds them.

``views.toml`` is written by ``slbench design views``, or by hand: poses of one object of a scene,
in the world, and what counts as a measurement of its surface.  The part is scanned alone; what
else stands in the scene is left out, as it would not move with the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slbench.core.errors import InputError
from slbench.core.io import read_toml, write_toml
from slbench.core.show.display import brief
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import FINITE, Interval, Step, Vector
from slbench.core.validation.values import validated
from slbench.rig import Pose, Rig
from slbench.scene.model import Scene

Array = NDArray[np.float64]

#: Views of one part: a row of clouds, each of which is traced.
MOST_VIEWS = 100
#: Samples of a surface: fewer tell little, more take memory.
SampleCount = Annotated[int, Interval(ge=100, le=2_000_000)]
Incidence = Annotated[float, FINITE, Interval(ge=1.0, le=90.0)]
#: At 80 degrees a pixel covers six times as much of a surface as of one that faces it.
MAX_INCIDENCE_DEG = 80.0
Measurements = Annotated[int, Interval(ge=1, le=MOST_VIEWS)]
#: A name that is a file's, too.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=60)]


class _View(Parameters):
    """``[[views]]``."""

    name: Name
    position_mm: Vector
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    description: str = ""


class _ViewsFile(Parameters):
    """``views.toml``."""

    views: Annotated[tuple[_View, ...], Field(min_length=1, max_length=MOST_VIEWS)]
    # Of the scene it was planned for; a scan says if it is of another.
    scene: str | None = None
    part: str | None = None
    object: Annotated[int, Field(ge=0, le=10_000)] = 0
    min_measurements: Measurements = 1
    max_std_um: Step | None = None
    max_incidence_deg: Incidence = MAX_INCIDENCE_DEG
    within_volume: bool = True
    samples: SampleCount = 20_000
    predicted_coverage: Annotated[float, Field(ge=0.0, le=1.0)] | None = None


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A pose of the part in the world, with a name."""

    name: str
    pose: Pose
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class Counting:
    """What counts as measured, in a plan and in a scan alike.

    Parameters
    ----------
    min_measurements : int
        Views that have to measure a place of the surface.
    max_std_mm : float
        Largest standard deviation (by noise) of a measurement; infinite for any.
    max_incidence_deg : float
        Largest angle between the surface's normal and the ways to both lenses: beyond, a pixel
        covers more of the surface than its noise tells of.
    within_volume : bool
        Whether points outside the measurement volume do not count.
    samples : int
        Of the surface (:mod:`slbench.simulate.viewpoints.samples`).
    """

    min_measurements: int = 1
    max_std_mm: float = float("inf")
    max_incidence_deg: float = MAX_INCIDENCE_DEG
    within_volume: bool = True
    samples: int = 20_000


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """Views of one object of a scene.

    Parameters
    ----------
    views : tuple of Viewpoint
        Names are distinct.
    counting : Counting
    object : int
        Index of the part in the scene.
    scene, part : str or None
        Names of what it was planned for.
    predicted_coverage : float or None
        Share of the surface that the plan expects to be measured.
    """

    views: tuple[Viewpoint, ...]
    counting: Counting = Counting()
    object: int = 0
    scene: str | None = None
    part: str | None = None
    predicted_coverage: float | None = None

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.views)

    def write(self, path: str | Path) -> None:
        """Write ``views.toml``."""
        counting = self.counting
        table: dict[str, Any] = {
            "scene": self.scene,
            "part": self.part,
            "object": self.object,
            "min_measurements": counting.min_measurements,
            "max_std_um": 1e3 * counting.max_std_mm if np.isfinite(counting.max_std_mm) else None,
            "max_incidence_deg": counting.max_incidence_deg,
            "within_volume": counting.within_volume,
            "samples": counting.samples,
            "predicted_coverage": self.predicted_coverage,
            "views": [
                {"name": view.name, **pose_keys(view.pose), "description": view.description}
                for view in self.views
            ],
        }
        write_toml(path, {key: value for key, value in table.items() if value is not None})


def read_views(path: str | Path) -> Viewpoints:
    """Read ``views.toml``.

    Raises
    ------
    InputError
        Naming the file and the key of the first thing that cannot be used.
    """
    from scipy.spatial.transform import Rotation

    path = Path(path)
    file = validated(_ViewsFile, read_toml(path), path.name, separator=": ")
    names = [view.name for view in file.views]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path.name}: views", "a name of its own for each", f"two of {twice}")
    views = tuple(
        Viewpoint(
            view.name,
            Pose(
                Rotation.from_euler("XYZ", view.rotation_deg, degrees=True).as_matrix(),
                np.array(view.position_mm),
            ),
            view.description,
        )
        for view in file.views
    )
    counting = Counting(
        min_measurements=file.min_measurements,
        max_std_mm=np.inf if file.max_std_um is None else 1e-3 * file.max_std_um,
        max_incidence_deg=file.max_incidence_deg,
        within_volume=file.within_volume,
        samples=file.samples,
    )
    return Viewpoints(
        views,
        counting,
        file.object,
        file.scene,
        file.part,
        file.predicted_coverage,
    )


def pose_keys(pose: Pose) -> dict[str, list[float]]:
    """Return a pose as the keys of ``[[objects]]``."""
    import warnings

    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():  # at a middle angle of 90 degrees one of many is as good
        warnings.simplefilter("ignore", UserWarning)
        angles = Rotation.from_matrix(pose.rotation).as_euler("XYZ", degrees=True)
    return {"position_mm": pose.position.tolist(), "rotation_deg": angles.tolist()}


def alone(scene: Scene, which: int, pose: Pose | None = None) -> Scene:
    """Return a scene with one of its objects alone, in a pose or where it is.

    Raises
    ------
    InputError
        If the scene has no such object.
    """
    if not 0 <= which < len(scene.objects):
        expected = f"one of the {len(scene.objects)} objects of the scene, from 0"
        raise InputError(f"scene {scene.name}: object", expected, which)
    part = scene.objects[which]
    if pose is not None:
        part = replace(part, pose=pose)
    tables = scene.specification.get("objects", ())
    own = dict(tables[which]) if which < len(tables) else {}
    specification = {**scene.specification, "objects": [own | pose_keys(part.pose)]}
    return replace(scene, objects=(part,), specification=specification)


def moved(rig: Rig, motion: Pose) -> Rig:
    """Return a rig whose devices have been moved together."""
    devices = {name: one.posed(motion.after(one.pose)) for name, one in rig.devices.items()}
    return rig.having(**devices)


def within_incidence(
    rig: Rig, points: Array, normals: Array, max_incidence_deg: float
) -> NDArray[np.bool_]:
    """Return which points (N, 3) face both lenses of a rig within an angle."""
    found = np.ones(len(points), np.bool_)
    for device in (rig.camera, rig.projector):
        toward = device.chief_origin(points) - points
        least = np.cos(np.deg2rad(max_incidence_deg)) * np.linalg.norm(toward, axis=1)
        found &= np.sum(toward * normals, axis=1) >= least
    return found


def inside_volume(rig: Rig, place: Pose, points: Array) -> NDArray[np.bool_]:
    """Return a mask of world points (N, 3) inside the measurement volume, which is at a place."""
    half = 0.5 * np.array(rig.volume_mm)
    return np.asarray(np.all(np.abs(place.to_local(points)) <= half, axis=1))


def names_of(count: int) -> Sequence[str]:
    """Return names of so many views, in the order of their numbers."""
    width = len(str(count))
    return [f"view-{k + 1:0{max(width, 2)}d}" for k in range(count)]
