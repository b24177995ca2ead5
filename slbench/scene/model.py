"""A scene: rig, objects, materials, light, detector and patterns of one measurement.

:class:`Scene` is the value that everything after it takes; a TOML file in ``scenes/`` is how
people write one (:mod:`slbench.scene.file`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from slbench.capture.exposures import Exposures, check_exposures
from slbench.capture.focus import Focus
from slbench.core.colour import BANDS, Band
from slbench.core.errors import InputError, located
from slbench.core.random import tagged_seed
from slbench.core.registry import quoted
from slbench.core.show.display import block, numbers
from slbench.core.validation.types import (
    Bounces,
    Fraction,
    MinLen,
    NotNegative,
    Positive,
    Samples,
    Vibration,
)
from slbench.core.validation.values import Value
from slbench.detector.base import DetectorModel
from slbench.detector.emva1288 import Detector
from slbench.objects import Artefact
from slbench.patterns import GivenPatterns, PatternSequence, PatternSource, read_patterns
from slbench.patterns.crosstalk import UNMIXED
from slbench.rig import Pair, Pose, Rig
from slbench.rig.motion import Compensation, FrameTiming, Motion, Moving, followed, seen_from
from slbench.scene.calibration import Calibration, calibration_of
from slbench.scene.colour import Colour
from slbench.scene.environment import Environment, Radiance
from slbench.scene.frame_errors import BitPlanes, Drift, Trigger
from slbench.scene.surfaces.materials import Material

#: Tag of the seeds of fixed patterns of further cameras.
_SENSORS = 1

#: What is projected on a scene that states no patterns.
USUAL_PATTERNS = "1,10,50"


@dataclass(frozen=True, eq=False)
class SceneObject(Value):
    """An artefact somewhere in the world.

    Parameters
    ----------
    artefact : Artefact
    pose : Pose
    material : Material
        Of all parts that `materials` does not name.
    materials : mapping of str to Material
        By part of the artefact; those of its mesh file are
        :func:`slbench.scene.surfaces.materials.own_materials`.
    distractor : bool
        Whether it is not of interest: data sets annotate the others.
    motion : Motion or None
        During a scan, from the pose at its middle (:mod:`slbench.rig.motion`); None for none.
    """

    artefact: Artefact
    pose: Pose = field(default_factory=Pose)
    material: Material = field(default_factory=Material)
    materials: Mapping[str, Material] = field(default_factory=dict)
    distractor: bool = False
    motion: Motion | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for part in self.materials:
            if part not in self.artefact.parts:
                known = ", ".join(self.artefact.parts)
                raise InputError(f"{self.artefact.name}: materials", f"parts {known}", part)
        inside = [
            (part, interior)
            for part in self.artefact.parts
            if (interior := self.material_of(part).bsdf.interior) is not None
        ]
        if inside and not self.artefact.mesh.is_watertight:
            expected = "a closed mesh for a material that light gets into"
            raise InputError(f"{self.artefact.name}: part {inside[0][0]}", expected, "an open one")
        if len({interior for _, interior in inside}) > 1:
            parts = " and ".join(part for part, _ in inside)
            raise InputError(f"{self.artefact.name}: parts {parts}", "one material inside", "more")

    def material_of(self, part: str) -> Material:
        """Return the material of a part, with the colours of the mesh where it asks for them.

        Raises
        ------
        InputError
            If it asks for colours or texture coordinates that the mesh does not have.
        """
        return self.materials.get(part, self.material).on(self.artefact, part)

    def in_band(self, k: int) -> Self:
        """Return the object in a band of light; itself where it is grey."""
        materials = {part: self.material_of(part) for part in self.artefact.parts}
        found = {part: material.in_band(k) for part, material in materials.items()}
        alike = all(found[part] is materials[part] for part in found)
        return self if alike else replace(self, materials=found)

    @property
    def middle(self) -> NDArray[np.float64]:
        """The middle of the box about the object, along its own axes, (3,), mm in the world."""
        return self.pose.to_world(self.artefact.mesh.bounds.mean(axis=0))

    @property
    def moves(self) -> bool:
        """Whether the object moves during a scan."""
        return self.motion is not None and not self.motion.is_rest

    def moved_by(self, time_s: float) -> Pose:
        """Return what has moved the object at a time, from the pose that it has at zero."""
        return Pose() if self.motion is None else self.motion.at(time_s, self.middle)

    def at(self, time_s: float) -> Self:
        """Return the object where it is at a time, at rest."""
        return replace(self, pose=followed(self.pose, self.moved_by(time_s)), motion=None)

    def __repr__(self) -> str:
        materials = (self.material, *self.materials.values())
        looks = {type(material.bsdf).__name__ for material in materials}
        where = numbers(self.pose.position)
        return f"<SceneObject {self.artefact.name}, {' and '.join(sorted(looks))}, at ({where}) mm>"


@dataclass(frozen=True)
class Light(Value):
    """Light beside the projector's direct beam.

    Parameters
    ----------
    ambient_w_per_mm2 : float
        Irradiance of uniform surroundings on an unobstructed surface.
    bounces : int
        Interreflections followed after the direct light.
    environment : Environment or None
        Surroundings of which the radiance depends on the direction, beside the uniform ones.
    """

    ambient_w_per_mm2: NotNegative = 0.0
    bounces: Bounces = 0
    environment: Environment | None = None

    @property
    def has_surroundings(self) -> bool:
        """Whether light comes from elsewhere than the projector."""
        return self.ambient_w_per_mm2 > 0.0 or self.environment is not None

    def dimmed(self, factor: float) -> Light:
        """Return the light with all that comes from around times a factor."""
        around = self.environment if factor > 0.0 else None
        if around is not None and factor != 1.0:
            radiance = Radiance(np.float32(factor) * around.radiance.values)
            around = replace(around, radiance=radiance)
        return replace(self, ambient_w_per_mm2=factor * self.ambient_w_per_mm2, environment=around)


@dataclass(frozen=True)
class Exposure(Value):
    """How long the camera exposes.

    Parameters
    ----------
    time_s : float or None
        An absolute exposure; needs a camera with an aperture.  None chooses the exposure by
        the picture of the fully lit panel.
    white_level : float
        Where the automatic exposure puts that picture's 99th percentile of the lit pixels,
        as a fraction of saturation.
    vibration_px : float
        Standard deviation of the picture's shift from frame to frame, along u and v.
    bit_planes : BitPlanes or None
    trigger : Trigger or None
    drift : Drift or None
        Frame errors (:mod:`slbench.scene.frame_errors`); None for none.
    bracket : tuple of float
        Every picture is taken at so many exposures, which are the one that the rest says times
        these factors (:mod:`slbench.capture.exposures`); (1.0,) is that one alone.
    frame_period_s : float or None
        From a picture to the next, for what moves; None for as short as can be.
    rolling_shutter_s : float
        How much later the last row is exposed than the first.
    pulse_s : float or None
        How long of the exposure the projector shines on each row: over so long motion is smeared.
        None for all of it.  The light is that of the whole exposure.
    multiplexed : bool
        Several projectors light the scene at the same time; they take turns otherwise.
    """

    time_s: Positive | None = None
    white_level: Fraction = 0.8
    vibration_px: Vibration = 0.0
    bit_planes: BitPlanes | None = None
    trigger: Trigger | None = None
    drift: Drift | None = None
    bracket: Exposures = (1.0,)
    frame_period_s: Positive | None = None
    rolling_shutter_s: NotNegative = 0.0
    pulse_s: Positive | None = None
    multiplexed: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_exposures(self.bracket, "exposure.bracket")
        if len(self.bracket) > 1 and self.has_frame_errors:
            expected = "one exposure beside bit_planes, trigger and drift"
            raise InputError("exposure.bracket", expected, f"{len(self.bracket)}")

    def single(self) -> Self:
        """Return the exposure that the bracket's factors are of, alone."""
        return replace(self, bracket=(1.0,))

    def open_s(self, exposure_s: float) -> float:
        """Return how long a row collects the projector's light."""
        return exposure_s if self.pulse_s is None else self.pulse_s

    def timing(self, exposure_s: float) -> FrameTiming:
        """Return when pictures of an exposure are taken.

        Each row of a picture sees its own pattern alone: the panel waits for the last row.

        Raises
        ------
        InputError
            For a period that is too short for that.
        """
        least = self.open_s(exposure_s) + self.rolling_shutter_s
        period = least if self.frame_period_s is None else self.frame_period_s
        if period < least * (1.0 - 1e-9):
            expected = f"at least {1e3 * least:.4g} ms, exposure (or pulse) and rolling shutter"
            raise InputError("exposure.frame_period_ms", expected, f"{1e3 * period:.4g}")
        return FrameTiming(period_s=period, rolling_s=self.rolling_shutter_s)

    @property
    def has_frame_errors(self) -> bool:
        """Whether pictures are off by bit planes, lost triggers or a lamp's drift."""
        return any(one is not None for one in (self.bit_planes, self.trigger, self.drift))

    def without_frame_errors(self) -> Self:
        """Return the exposure of a projector and a trigger without fault."""
        return replace(self, bit_planes=None, trigger=None, drift=None)

    def of_pictures(self, count: int) -> Self:
        """Return the exposure of so many pictures, without lost triggers of later ones."""
        if self.trigger is None:
            return self
        lost = tuple(k for k in self.trigger.lost if k < count)
        return replace(self, trigger=replace(self.trigger, lost=lost))


@dataclass(frozen=True, eq=False)
class Scene(Value):
    """A whole measurement.

    Parameters
    ----------
    name : str
    rig : Rig
    objects : tuple of SceneObject
        At least one; the index is the object id of the ground truth.
    sequence : PatternSequence
    detector : DetectorModel
    exposure : Exposure
    light : Light
    samples : int
        Monte Carlo samples a pixel.
    specification : dict
        The scene file's content, for provenance.
    focus : Focus or None
        Settings of a focus stack; None for one picture with the focus of the rig.
    calibration : Calibration or None
        What it is measured with; None for the rig that is rendered.
    colour : Colour or None
        Three bands of light; None for one.  Colour patterns that state no cross-talk of their own
        (:attr:`PatternSequence.assumed`) are taken apart by its own.
    rig_motion : Motion or None
        Of all devices during a scan, about the world's origin where it has no centre; points are
        those of the rig at the middle of the scan.
    detectors : mapping of str to DetectorModel
        Of cameras, by name, whose detectors are other ones than `detector`.
    compensate : {"none", "known", "estimated"}
        Whether motion is taken out of the frames before they are decoded
        (:mod:`slbench.cloud.motion`): that which is stated, or what the frames tell of it.
    """

    name: str
    rig: Rig
    objects: Annotated[tuple[SceneObject, ...], MinLen(1)]
    sequence: PatternSequence
    detector: DetectorModel = field(default_factory=Detector)
    exposure: Exposure = field(default_factory=Exposure)
    light: Light = field(default_factory=Light)
    samples: Samples = 16
    specification: dict[str, Any] = field(default_factory=dict)
    focus: Focus | None = None
    calibration: Calibration | None = None
    colour: Colour | None = None
    rig_motion: Motion | None = None
    detectors: Mapping[str, DetectorModel] = field(default_factory=dict)
    compensate: Compensation = "none"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.focus is not None and self.moves:
            expected = "none with motion: every setting is a scan of its own"
            raise InputError(f"scene {self.name}: focus", expected, f"{len(self.focus)} settings")
        if len(self.exposure.bracket) > 1 and self.moves:
            expected = "one exposure with motion, as pictures follow one another"
            raise InputError("exposure.bracket", expected, f"{len(self.exposure.bracket)}")
        object.__setattr__(self, "sequence", _calibrated(self.sequence, self.colour))
        self._check_bracket()
        first, *further = self.rig.projectors
        panel = _panel(self.rig, first)
        if self.sequence.panel != panel:
            raise InputError(
                f"scene {self.name}: patterns",
                f"a sequence for the projector's {panel[0]} x {panel[1]} panel",
                f"{self.sequence.panel[0]} x {self.sequence.panel[1]}",
            )
        if self.calibration is not None and len(self.rig.pairs) > 1:
            expected = "a rig of one camera and one projector"
            raise InputError(
                f"scene {self.name}: calibration", expected, ", ".join(self.rig.devices)
            )
        for name in further:
            with located(f"scene {self.name}: projector {name}"):
                self._sequence_of(name)

    def __repr__(self) -> str:
        sizes = [f"{name} {one.width} x {one.height} px" for name, one in self.rig.devices.items()]
        names = [item.artefact.name for item in self.objects]
        return block(
            f"Scene {self.name}: {', '.join(names[:4])}{' ...' if len(names) > 4 else ''}",
            ", ".join(sizes[:4]) + (" ..." if len(sizes) > 4 else ""),
            f"patterns {{{self.sequence.name}}}, {self.sequence.n_frames} frames; "
            f"{self.samples} samples a pixel",
            "" if self.colour is None else "in colour",
            "" if self.focus is None else f"{len(self.focus)} focus settings",
            "" if self.calibration is None else f"measured with {self.calibration.source}",
        )

    def _check_bracket(self) -> None:
        """Refuse several exposures where a pixel cannot take the frames of one."""
        if len(self.exposure.bracket) == 1:
            return
        got = ""
        if self.colour is not None:
            got = "a scene in colour"
        elif self.focus is not None:
            got = "focus settings"
        elif any(part.spatial for part in self.sequence.parts):
            got = f"patterns decoded by their neighbours, {self.sequence.name}"
        if got:
            where = f"scene {self.name}: exposure"
            raise InputError(where, "one exposure (exposures_ms, bracket)", f"several, and {got}")

    def with_patterns(
        self,
        patterns: PatternSource,
        shifts: int = 3,
        axes: str = "u",
        *,
        folder: Path | None = None,
        allow_modules: bool = False,
    ) -> Self:
        """Return the scene with other patterns.

        Parameters
        ----------
        patterns : str, path, PatternSequence, Code or callable
            Short text, a TOML file, a folder of pictures, ``module:object``, or an object
            (:func:`slbench.patterns.read_patterns`, which has the parameters in full).
        shifts : int
            Phase shifts where short text states none.
        axes : {"u", "v", "uv", "vu"}
            Axes that short text codes.
        folder : path, optional
            Of the file that names the patterns.
        allow_modules : bool
            Run the Python modules that they name.
        """
        panel = self.sequence.panel
        found = read_patterns(
            patterns, panel, shifts=shifts, axes=axes, folder=folder, allow_modules=allow_modules
        )
        return replace(self, sequence=found.sequence)

    def with_changed_patterns(
        self,
        patterns: PatternSource | None,
        shifts: int | None,
        axes: str | None,
        *,
        folder: Path | None = None,
        allow_modules: bool = False,
        names: tuple[str, str] = ("shifts", "axes"),
    ) -> Self:
        """Return the scene with what a user states of its patterns; the rest is the scene's own.

        Parameters
        ----------
        patterns, shifts, axes
            As for :meth:`with_patterns`; None as the scene's file has it.
        folder, allow_modules
            Likewise.
        names : (str, str)
            What shifts and axes are called, for messages.

        Raises
        ------
        InputError
            Also for shifts or axes of patterns that state their own.
        """
        own = self.specification.get("patterns", {})
        stated = [name for name, value in zip(names, (shifts, axes), strict=True) if value]
        source = own.get("sequence", USUAL_PATTERNS) if patterns is None else patterns
        panel, many = self.sequence.panel, shifts or own.get("shifts", 3)
        along = axes or own.get("axes", "u")
        if patterns is not None:
            found = read_patterns(
                *(source, panel),
                shifts=many,
                axes=along,
                folder=folder,
                allow_modules=allow_modules,
            )
        elif "parts" in own or not stated:
            found = GivenPatterns(self.sequence.name, self.sequence, own_axes=True)
        else:  # in words, or they could not be changed
            changed = replace(
                PatternSequence.parse(str(source), panel, many, along),
                crosstalk=self.sequence.crosstalk,
                assumed=self.sequence.assumed,
            )
            found = GivenPatterns(changed.name, changed, own_axes=False)
        if stated and found.own_axes:
            expected = f"none beside patterns that state their own, {found.name}"
            raise InputError(stated[0], expected, shifts or axes)
        if shifts is not None and "@" in str(source):
            raise InputError(names[0], "no shifts (@) in the patterns too", source)
        return replace(self, sequence=found.sequence)

    def in_band(self, band: Band) -> Self:
        """Return the scene of one band of a scene in colour: a scene that is not.

        Materials have their values there, lenses their scales, ambient light its factor.

        Parameters
        ----------
        band : {"red", "green", "blue"}

        Raises
        ------
        InputError
            For another band, or a scene that is not in colour.
        """
        if self.colour is None:
            raise InputError(f"scene {self.name}: band", "a scene in colour ([colour])", band)
        if band not in BANDS:
            raise InputError(f"scene {self.name}: band", " or ".join(BANDS), quoted(band, BANDS))
        k = BANDS.index(band)
        items = tuple(item.in_band(k) for item in self.objects)
        return replace(
            self,
            rig=self.colour.rig(self.rig, k),
            objects=items,
            light=self.light.dimmed(self.colour.ambient[k]),
            colour=None,
        )

    def pair(self, pair: Pair) -> Self:
        """Return the scene of one camera and one projector, which keep their names.

        The projector shows the scene's patterns, for a panel of its own size.  The camera has its
        own detector, or the scene's: then each camera but the first has one of the same make, whose
        fixed pattern is another.

        Raises
        ------
        InputError
            If the rig has no such device.
        """
        rig = self.rig.pair(pair)
        if self.rig.pairs == (pair,):
            return self
        focus = self.focus
        if focus is not None:
            focus = Focus({name: focus.distances_mm[name] for name in pair})
        return replace(
            self,
            rig=rig,
            sequence=self._sequence_of(pair.projector),
            detector=self._detector_of(pair.camera),
            detectors={},
            focus=focus,
        )

    def _sequence_of(self, projector: str) -> PatternSequence:
        panel = _panel(self.rig, projector)
        return (
            self.sequence if panel == self.sequence.panel else replace(self.sequence, panel=panel)
        )

    def _detector_of(self, camera: str) -> DetectorModel:
        if camera in self.detectors:
            return self.detectors[camera]
        index, detector = list(self.rig.cameras).index(camera), self.detector
        seed = getattr(detector, "seed", None)
        if not index or not isinstance(seed, int):
            return detector
        other: Any = detector  # of which only a dataclass is known
        return replace(other, seed=tagged_seed(seed, _SENSORS, index))

    @property
    def moves(self) -> bool:
        """Whether objects or the rig move during a scan."""
        rig = self.rig_motion is not None and not self.rig_motion.is_rest
        return rig or any(item.moves for item in self.objects)

    def at(self, time_s: float) -> Self:
        """Return the scene as it is at a time of the scan, at rest."""
        by = Pose() if self.rig_motion is None else self.rig_motion.at(time_s)
        devices = {
            name: one.posed(followed(one.pose, by)) for name, one in self.rig.devices.items()
        }
        return replace(
            self,
            rig=self.rig.having(**devices) if self.rig_motion is not None else self.rig,
            objects=tuple(item.at(time_s) for item in self.objects),
            rig_motion=None,
        )

    def at_rest(self) -> Self:
        """Return the scene as it is in the middle of a scan, at rest."""
        return self.at(0.0) if self.moves else self

    def path_of(self, item: SceneObject) -> Moving:
        """Return the motion of an object as the rig sees it."""

        def path(time_s: float) -> Pose:
            rig = Pose() if self.rig_motion is None else self.rig_motion.at(time_s)
            return seen_from(item.moved_by(time_s), rig)

        return path

    @property
    def common_path(self) -> Moving:
        """The motion of all objects that move in the rig's eyes; what rests is not looked at.

        Raises
        ------
        InputError
            If objects move otherwise than others.
        """

        def alike(path: Moving, other: Moving) -> bool:
            # Two poses of a uniform motion tell it.
            ends = [(path(time), other(time)) for time in (-1.0, 0.5)]
            return all(
                np.allclose(one.rotation, two.rotation, atol=1e-9)
                and np.allclose(one.position, two.position, atol=1e-6)
                for one, two in ends
            )

        every = [self.path_of(item) for item in self.objects]
        paths = [path for path in every if not alike(path, lambda time_s: Pose())] or every
        if not all(alike(paths[0], path) for path in paths[1:]):
            expected = "one motion of all objects that move, to take it out"
            raise InputError(f"scene {self.name}: decode.motion", expected, "several")
        return paths[0]

    @property
    def place(self) -> Pose:
        """Where the measurement volume is, z towards the camera (:func:`place_of`)."""
        return place_of(self.rig, self.objects)

    @property
    def rigs(self) -> tuple[Rig, ...]:
        """The rig at each focus setting; the rig itself where there are none."""
        if self.focus is None:
            return (self.rig,)
        return tuple(self.focus.rig(self.rig, k) for k in range(len(self.focus)))

    def focused(self, setting: int) -> Self:
        """Return the scene at one setting of its focus stack."""
        if self.focus is None or not 0 <= setting < len(self.focus):
            count = 0 if self.focus is None else len(self.focus)
            raise InputError(f"scene {self.name}: focus setting", f"0..{count - 1}", setting)
        return replace(self, rig=self.focus.rig(self.rig, setting), focus=None)

    def all_in_focus(self) -> Self:
        """Return the scene through lenses without defocus: what a perfect stack sees."""
        return replace(self, rig=self.rig.all_in_focus(), focus=None)

    def coarser(self, divisor: int, samples: int) -> Self:
        """Return the scene seen by a camera of fewer, larger pixels, for a quick look.

        It is the same instrument: what is stated a pixel is carried over, so that errors in
        millimetres and completeness are those of the full scene, within what larger pixels see.
        """
        cameras = {name: one.coarser(divisor) for name, one in self.rig.cameras.items()}
        exposure = replace(self.exposure, vibration_px=self.exposure.vibration_px / divisor)
        coarse = replace(self, rig=self.rig.having(**cameras), exposure=exposure, samples=samples)
        if self.calibration is None:
            return coarse
        return replace(coarse, calibration=self.calibration.coarser(divisor))

    def measured_with(
        self, path: str | Path, *, align: bool = False, where: str = "measured_with"
    ) -> Self:
        """Return the scene measured with another rig, or a calibration model.

        Parameters
        ----------
        path : path
            A rig (``.yaml``, ``.yml``) or a calibration model (``.json``), for the scene's cameras
            as they are: before :meth:`coarser`.
        align : bool
            Whether points are moved to the truth by the best rigid motion before they are scored.
        where : str
            What gave it, for messages.

        Raises
        ------
        InputError
            For a file that cannot be used, and a rig of other devices than the scene's.
        """
        made = calibration_of(path, self.rig, align=align, where=where)
        table = {"measured_with": str(path), "sha256": made.digest, "align": align}
        return replace(
            self, calibration=made, specification=self.specification | {"calibration": table}
        )


def _panel(rig: Rig, projector: str) -> tuple[int, int]:
    one = rig.projectors[projector]
    return (one.width, one.height)


def _calibrated(sequence: PatternSequence, colour: Colour | None) -> PatternSequence:
    """Return a sequence with the cross-talk of a scene, unless it states one of its own.

    Raises
    ------
    InputError
        For pictures of other than three channels in a scene of three, and channels that cannot be
        told apart.
    """
    if sequence.crosstalk is None:
        return sequence
    if colour is not None and sequence.channels != len(BANDS):
        expected = f"{len(BANDS)} channels a picture, those of the scene's colour"
        raise InputError("patterns: crosstalk", expected, sequence.channels)
    if sequence.crosstalk != sequence.assumed:
        return sequence
    matrix = colour.crosstalk if colour is not None and colour.unmix else UNMIXED
    if matrix == sequence.crosstalk:
        return sequence
    # Another scene takes its own in turn.
    return replace(sequence, crosstalk=matrix, assumed=matrix)


def place_of(rig: Rig, objects: Sequence[SceneObject]) -> Pose:
    """Return where the measurement volume is, z towards the camera.

    That is the world's frame.  Where its origin is not before the devices (the world is the
    camera's frame) it is about the first object, turned as the camera is.
    """
    if rig.faces_origin:
        return Pose()
    camera = next(iter(rig.cameras.values())).pose
    return Pose(camera.rotation * [1.0, -1.0, -1.0], objects[0].middle)
