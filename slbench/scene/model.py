"""A scene: rig, objects, materials, light, detector and patterns of one measurement.

:class:`Scene` is the value that everything after it takes; a TOML file in ``scenes/`` is how
people write one (:mod:`slbench.scene.file`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from slbench.capture.focus import Focus
from slbench.core.errors import InputError
from slbench.detector.emva1288 import Detector
from slbench.objects import Artefact
from slbench.patterns import PatternSequence
from slbench.rig import Pose, Rig
from slbench.scene.materials import Material


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An artefact somewhere in the world.

    Parameters
    ----------
    artefact : Artefact
    pose : Pose
    material : Material
        Of all parts that `materials` does not name.
    materials : mapping of str to Material
        By part of the artefact.
    """

    artefact: Artefact
    pose: Pose = field(default_factory=Pose)
    material: Material = field(default_factory=Material)
    materials: Mapping[str, Material] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for part in self.materials:
            if part not in self.artefact.parts:
                known = ", ".join(self.artefact.parts)
                raise InputError(f"{self.artefact.name}: materials", f"parts {known}", part)


@dataclass(frozen=True)
class Light:
    """Light beside the projector's direct beam.

    Parameters
    ----------
    ambient_w_per_mm2 : float
        Irradiance of uniform surroundings on an unobstructed surface.
    bounces : int
        Interreflections followed after the direct light.
    """

    ambient_w_per_mm2: float = 0.0
    bounces: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.ambient_w_per_mm2 < np.inf:
            raise InputError("light ambient", "zero or a positive irradiance", self)
        if not 0 <= self.bounces <= 16:
            raise InputError("light bounces", "0 to 16", self.bounces)


@dataclass(frozen=True)
class Exposure:
    """How long the camera exposes.

    Parameters
    ----------
    time_s : float or None
        An absolute exposure; needs a camera with an aperture.  None chooses the exposure by
        the picture of the fully lit panel.
    white_level : float
        Where the automatic exposure puts that picture's 99th percentile of the lit pixels,
        as a fraction of full well.
    vibration_px : float
        Standard deviation of the picture's shift from frame to frame, along u and v.
    """

    time_s: float | None = None
    white_level: float = 0.8
    vibration_px: float = 0.0

    def __post_init__(self) -> None:
        if self.time_s is not None and not 0 < self.time_s < np.inf:
            raise InputError("exposure time", "a positive time (s)", self.time_s)
        if not 0 < self.white_level <= 1:
            raise InputError("exposure white_level", "a fraction in (0, 1]", self.white_level)
        if not 0 <= self.vibration_px <= 10:
            raise InputError("exposure vibration", "0 to 10 px", self.vibration_px)


@dataclass(frozen=True, eq=False)
class Scene:
    """A whole measurement.

    Parameters
    ----------
    name : str
    rig : Rig
    objects : tuple of SceneObject
        At least one; the index is the object id of the ground truth.
    sequence : PatternSequence
    detector : Detector
    exposure : Exposure
    light : Light
    samples : int
        Monte Carlo samples a pixel.
    specification : dict
        The scene file's content, for provenance.
    focus : Focus or None
        Settings of a focus stack; None for one picture with the focus of the rig.
    """

    name: str
    rig: Rig
    objects: tuple[SceneObject, ...]
    sequence: PatternSequence
    detector: Detector = field(default_factory=Detector)
    exposure: Exposure = field(default_factory=Exposure)
    light: Light = field(default_factory=Light)
    samples: int = 64
    specification: dict[str, Any] = field(default_factory=dict)
    focus: Focus | None = None

    def __post_init__(self) -> None:
        if not self.objects:
            raise InputError(f"scene {self.name}: objects", "at least one object", "none")
        if not 1 <= self.samples <= 65536:
            raise InputError(f"scene {self.name}: samples", "1 to 65536", self.samples)
        panel = (self.rig.projector.width, self.rig.projector.height)
        if self.sequence.panel != panel:
            raise InputError(
                f"scene {self.name}: patterns",
                f"a sequence for the projector's {panel[0]} x {panel[1]} panel",
                f"{self.sequence.panel[0]} x {self.sequence.panel[1]}",
            )

    def with_patterns(self, text: str, shifts: int = 3, axes: str = "u") -> Self:
        """Return the scene with another pattern sequence (see `PatternSequence.parse`)."""
        return replace(
            self, sequence=PatternSequence.parse(text, self.sequence.panel, shifts, axes)
        )

    def focused(self, setting: int) -> Self:
        """Return the scene at one setting of its focus stack."""
        if self.focus is None or not 0 <= setting < len(self.focus):
            count = 0 if self.focus is None else len(self.focus)
            raise InputError(f"scene {self.name}: focus setting", f"0..{count - 1}", setting)
        return replace(self, rig=self.focus.rig(self.rig, setting), focus=None)

    def all_in_focus(self) -> Self:
        """Return the scene through pinholes: what a perfect focus stack would see."""
        return replace(self, rig=self.rig.pinholes(), focus=None)

    def coarser(self, divisor: int, samples: int) -> Self:
        """Return the scene seen by a camera of fewer, larger pixels, for a quick look."""
        camera = self.rig.camera
        u, v = camera.centre
        smaller = replace(
            camera,
            width=max(camera.width // divisor, 1),
            height=max(camera.height // divisor, 1),
            pitch_mm=(camera.pitch_mm[0] * divisor, camera.pitch_mm[1] * divisor),
            # The panel's corner stays where it is; it is half a pixel from the first centre.
            principal_point=((u + 0.5) / divisor - 0.5, (v + 0.5) / divisor - 0.5),
        )
        return replace(self, rig=self.rig.having(camera=smaller), samples=samples)
