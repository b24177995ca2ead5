"""The tables and keys of a scene file, and what their values may be.

The unit of a number is in its key; an unknown key, a missing one or a value of the wrong kind
is refused with the key's full name.  ``docs/reference/scene-files.md`` lists the keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from slbench.capture.exposures import Exposures
from slbench.capture.focus import MAX_SETTINGS, Focus
from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.units import Unit
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import (
    Barrel,
    Blur,
    Bounces,
    Coordinate,
    Count,
    Fraction,
    Measure,
    NotNegative,
    Samples,
    Seed,
    Shading,
    Share,
    Vector,
    Vibration,
)
from slbench.patterns.given import PatternsTable
from slbench.rig import Pose, Rig
from slbench.rig.motion import Compensation, Motion
from slbench.rig.optics.response import ResponseCurve
from slbench.scene.colour import Colour
from slbench.scene.devices.optics import CameraOptics, Optics, ProjectorOptics
from slbench.scene.environment import Environment, environment_of
from slbench.scene.frame_errors import BitPlanes, Drift, Trigger


class LensBeside(Parameters):
    """Keys of a device that a calibration does not have, beside the rig's file that is one."""

    pitch_um: Measure | tuple[Measure, Measure] | None = None
    f_number: Measure | None = None
    aperture_radius_mm: NotNegative | None = None
    focus_distance_mm: Measure | None = None
    natural_vignetting: bool | None = None
    wavelength_nm: NotNegative | None = None
    blur_px: Blur | None = None
    body_mm: tuple[Measure, Measure, Measure] | None = None
    barrel_mm: Barrel | None = None

    @model_validator(mode="after")
    def _one_aperture(self) -> LensBeside:
        if self.f_number is not None and self.aperture_radius_mm is not None:
            raise ValueError("f_number or aperture_radius_mm, not both")
        return self

    def stated(self, role: str, entries: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is stated, as entries of a rig's file, in place of those that it has.

        Raises
        ------
        InputError
            For an f-number where nobody states the pitch, which makes the focal length.
        """
        given = {key: getattr(self, key) for key in type(self).model_fields}
        if isinstance(self.pitch_um, float):
            given["pitch_um"] = (self.pitch_um, self.pitch_um)
        found = {f"{key}_{role}": _as_entry(one) for key, one in given.items() if one is not None}
        if self.f_number is not None:
            pitch = found.get(f"pitch_um_{role}", entries.get(f"pitch_um_{role}"))
            if pitch is None:
                expected = "pitch_um beside it, as the rig's file has none"
                raise InputError(f"{role}.f_number", expected, self.f_number)
            focal = np.ravel(entries[f"K_{role}"])[0] * 1e-3 * np.ravel(pitch)[0]
            del found[f"f_number_{role}"]
            found[f"aperture_radius_mm_{role}"] = float(focal / (2.0 * self.f_number))
        return found


def _as_entry(value: Any) -> Any:
    """Return a value of a table as a rig's file has it."""
    if isinstance(value, bool):
        return int(value)
    return np.array(value, dtype=np.float64) if isinstance(value, tuple) else value


class CameraBeside(LensBeside):
    """``[camera]`` beside a rig's file."""

    fill_factor: Fraction | None = None
    shading: Shading | None = None


class ProjectorBeside(LensBeside):
    """``[projector]`` beside a rig's file."""

    flux_w: Measure | None = None
    bit_depth: Annotated[int, Field(ge=0, le=16)] | None = None
    gamma: Measure | None = None
    response: ResponseCurve | None = None

    def stated(self, role: str, entries: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is stated, as entries of a rig's file."""
        found = super().stated(role, entries)
        if role == "projector" and "flux_w_projector" in found:  # of the only one
            found["flux_w"] = found.pop("flux_w_projector")
        return found


class NamedCameraBeside(CameraBeside):
    """``[cameras.NAME]`` beside a rig's file of several devices."""

    detector: dict[str, Any] = Field(default_factory=dict)

    def stated(self, role: str, entries: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is stated of the lens, as entries of a rig's file."""
        found = super().stated(role, entries)
        del found[f"detector_{role}"]
        return found


class PlaceTable(Parameters):
    """An explicit pose: where a device stands and what it looks at."""

    position_mm: Vector
    target_mm: Vector = (0.0, 0.0, 0.0)
    down: Vector = (0.0, -1.0, 0.0)


#: Names of devices become those of folders.
DeviceName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=50)]


class RigTable(Parameters):
    """``[rig]``: where the devices stand, by a design, by places, or from a file.

    A design and the places ``camera`` and ``projector`` are of the devices that are called so;
    ``[rig.cameras]`` and ``[rig.projectors]`` have places of further ones, by name.
    """

    z_ref_mm: Coordinate | None = None
    w_mm: Coordinate | None = None
    h_mm: Coordinate | None = None
    l_mm: Coordinate | None = None
    alpha_p_deg: Coordinate | None = None
    beta_p_deg: Coordinate | None = None
    camera: PlaceTable | None = None
    projector: PlaceTable | None = None
    cameras: dict[DeviceName, PlaceTable] = Field(default_factory=dict)
    projectors: dict[DeviceName, PlaceTable] = Field(default_factory=dict)
    file: str | None = None
    volume_mm: tuple[Measure, Measure, Measure] | None = None
    motion: Motion | None = None

    @model_validator(mode="after")
    def _one_way(self) -> RigTable:
        design = self.design_values()
        own = self.camera is not None or self.projector is not None
        if any(value is not None for value in design):
            alone = not own and self.file is None
            right = alone and all(value is not None for value in design)
        elif self.file is not None:
            right = not (own or self.cameras or self.projectors)
        else:
            devices = (self.camera or self.cameras, self.projector or self.projectors)
            right = all(devices)
        if not right:
            raise ValueError(
                "either the six of z_ref_mm w_mm h_mm l_mm alpha_p_deg beta_p_deg, "
                "or camera and projector (cameras and projectors where they have names), or file"
            )
        return self

    def design_values(self) -> tuple[float | None, ...]:
        """Return z_ref, w, h, l (mm), alpha_p and beta_p (degrees); None where not given."""
        return (self.z_ref_mm, self.w_mm, self.h_mm, self.l_mm, self.alpha_p_deg, self.beta_p_deg)

    @property
    def names(self) -> dict[str, tuple[str, ...]]:
        """Names of the devices that stand here, by role; none where they are a file's."""
        if self.file is not None:
            return {"camera": (), "projector": ()}
        designed = self.z_ref_mm is not None
        return {
            role: (*((role,) if designed or getattr(self, role) is not None else ()), *further)
            for role, further in (("camera", self.cameras), ("projector", self.projectors))
        }


class ObjectTable(Parameters):
    """``[[objects]]``: a shape and its place."""

    artefact: str | None = None
    mesh: str | None = None
    unit: Unit | None = None
    centre: bool = False
    normals: Literal["file", "facets", "smooth"] | None = None
    kind: str | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)
    position_mm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    material: str | None = None
    materials: dict[str, str] = Field(default_factory=dict)
    distractor: bool = False
    velocity_mm_per_s: Vector = (0.0, 0.0, 0.0)
    rotation_deg_per_s: Vector = (0.0, 0.0, 0.0)
    rotation_centre_mm: Vector | None = None

    def motion(self) -> Motion | None:
        """Return how the object moves; None where it does not."""
        found = Motion(
            velocity_mm_per_s=self.velocity_mm_per_s,
            rotation_deg_per_s=self.rotation_deg_per_s,
            centre_mm=self.rotation_centre_mm,
        )
        return None if found.is_rest else found

    @model_validator(mode="after")
    def _one_shape(self) -> ObjectTable:
        if sum(way is not None for way in (self.artefact, self.mesh, self.kind)) != 1:
            raise ValueError("one of artefact (a name), mesh (a file with its unit) or kind")
        more = self.centre or self.normals is not None
        if (self.mesh is None) != (self.unit is None) or (more and self.mesh is None):
            raise ValueError("a unit with a mesh file; unit, centre, normals with nothing else")
        if self.parameters and self.kind is None:
            raise ValueError("parameters with a kind only")
        return self


class LightTable(Parameters):
    """``[light]``: ambient light and bounces."""

    ambient_w_per_m2: NotNegative = 0.0
    bounces: Bounces = 0


class EnvironmentTable(Parameters):
    """``[environment]``: light that comes from around, by direction."""

    map: Literal["overcast", "workshop", "window"] | None = None
    file: str | None = None
    irradiance_w_per_m2: Measure | None = None
    scale: Measure | None = None
    rotation_deg: Coordinate = 0.0

    @model_validator(mode="after")
    def _one_way(self) -> EnvironmentTable:
        if (self.map is None) == (self.file is None):
            raise ValueError("one of map (a name) or file")
        if self.map is not None and self.irradiance_w_per_m2 is None:
            raise ValueError("irradiance_w_per_m2 beside map")
        if self.scale is not None and (self.file is None or self.irradiance_w_per_m2 is not None):
            raise ValueError("scale beside file only, where no irradiance_w_per_m2 is given")
        return self

    def environment(self, folder: Path, place: Pose) -> Environment:
        """Return the map, ahead along x and up along z of a place; its file is in a folder."""
        stated, source = self.irradiance_w_per_m2, self.map or Path()  # one of them, by _one_way
        return environment_of(
            source if self.file is None else resources.inside(folder, self.file),
            irradiance_w_per_mm2=None if stated is None else stated * 1e-6,
            scale=1.0 if self.scale is None else self.scale,
            rotation_deg=self.rotation_deg,
            place=place.rotation,
        )


class BitPlanesTable(Parameters):
    """``[exposure.bit_planes]``: grey levels of a micromirror device, and the exposure's time."""

    period_ms: Measure | None = None
    periods: Measure | None = None
    planes: Annotated[int, Field(ge=1, le=16)] | None = None
    first: Literal["most", "least"] = "most"
    start: Share = 0.0
    free_running: bool = False

    @model_validator(mode="after")
    def _one_way(self) -> BitPlanesTable:
        if (self.period_ms is None) == (self.periods is None):
            raise ValueError("one of period_ms or periods")
        if self.free_running and self.start:
            raise ValueError("a start of frames that are not free_running")
        return self

    def value(self) -> BitPlanes:
        """Return what the table says."""
        rest = self.model_dump(exclude={"period_ms"})
        period = None if self.period_ms is None else self.period_ms * 1e-3
        return BitPlanes(period_s=period, **rest)


class ExposureTable(Parameters):
    """``[exposure]``: time or level, several exposures, vibration and frame errors."""

    time_ms: Measure | None = None
    exposures_ms: Exposures | None = None
    bracket: Exposures | None = None
    white_level: Fraction = 0.8
    vibration_px: Vibration = 0.0
    bit_planes: BitPlanesTable | None = None
    trigger: Trigger | None = None
    drift: Drift | None = None
    frame_period_ms: Measure | None = None
    rolling_shutter_ms: NotNegative = 0.0
    pulse_ms: Measure | None = None
    multiplexed: bool = False

    @model_validator(mode="after")
    def _one_way(self) -> ExposureTable:
        beside = (self.time_ms, self.bracket)
        if self.exposures_ms is not None and any(one is not None for one in beside):
            raise ValueError("exposures_ms alone, or a bracket of time_ms or the white_level")
        return self

    def exposures(self) -> tuple[float | None, tuple[float, ...]]:
        """Return the exposure's time, ms, and the factors of it at which pictures are taken."""
        if self.exposures_ms is None:
            return self.time_ms, self.bracket or (1.0,)
        shortest = min(self.exposures_ms)
        return shortest, tuple(one / shortest for one in self.exposures_ms)


class DecodeTable(Parameters):
    """``[decode]``: how frames are decoded."""

    motion: Compensation = "none"


class FocusTable(Parameters):
    """``[focus]``: settings of a focus stack, by distances or by a sweep."""

    camera_mm: Annotated[tuple[Measure, ...], Field(min_length=1)] | None = None
    projector_mm: Annotated[tuple[Measure, ...], Field(min_length=1)] | None = None
    heights_mm: Annotated[tuple[Coordinate, ...], Field(min_length=1)] | None = None
    settings: Annotated[int, Field(ge=1, le=MAX_SETTINGS)] | None = None
    move: Literal["both", "camera", "projector"] = "both"
    apart: bool = False

    @model_validator(mode="after")
    def _one_way(self) -> FocusTable:
        distances = self.camera_mm is not None or self.projector_mm is not None
        ways = (distances, self.heights_mm is not None, self.settings is not None)
        if sum(ways) != 1:
            raise ValueError("camera_mm or projector_mm (or both), or heights_mm, or settings")
        if distances and (self.apart or self.move != "both"):
            raise ValueError("move and apart with heights_mm or settings only")
        return self

    def heights(self, depth_mm: float) -> tuple[float, ...] | None:
        """Return the heights of a sweep through a volume; None where distances are stated."""
        if self.settings is None:
            return self.heights_mm
        # The middles of slices of the volume.
        slices = (np.arange(self.settings) + 0.5) / self.settings - 0.5
        return tuple((depth_mm * slices).tolist())

    def focus(self, rig: Rig, place: Pose) -> Focus:
        """Return the settings; a sweep in `settings` goes through the height of the volume."""
        heights = self.heights(rig.volume_mm[2])
        if heights is not None:
            return Focus.sweep(rig, heights, self.move, self.apart, place)
        kept = rig.camera.lens.focus_distance_mm, rig.projector.lens.focus_distance_mm
        count = len(self.camera_mm or self.projector_mm or ())
        return Focus(
            {
                "camera": self.camera_mm or (kept[0],) * count,
                "projector": self.projector_mm or (kept[1],) * count,
            }
        )


class DeviceErrors(Parameters):
    """Standard deviations of a device's parameters (:mod:`slbench.rig.parameters`)."""

    # Of both, or all three, independently:
    focal_px: NotNegative | None = None
    centre_px: NotNegative | None = None
    rotation_rad: NotNegative | None = None
    translation_mm: NotNegative | None = None
    fx_px: NotNegative | None = None
    fy_px: NotNegative | None = None
    cx_px: NotNegative | None = None
    cy_px: NotNegative | None = None
    k1: NotNegative | None = None
    k2: NotNegative | None = None
    p1: NotNegative | None = None
    p2: NotNegative | None = None
    k3: NotNegative | None = None
    rx_rad: NotNegative | None = None
    ry_rad: NotNegative | None = None
    rz_rad: NotNegative | None = None
    tx_mm: NotNegative | None = None
    ty_mm: NotNegative | None = None
    tz_mm: NotNegative | None = None
    tau_x_rad: NotNegative | None = None
    tau_y_rad: NotNegative | None = None

    def deviations(self) -> dict[str, float]:
        """Return deviations by parameter; a parameter's own comes before its group's."""
        found: dict[str, float] = {}
        for group, members in _GROUPS.items():
            shared = getattr(self, group)
            found |= {name: shared for name in members if shared}
        own = {name: getattr(self, name) for name in type(self).model_fields if name not in _GROUPS}
        found |= {name: value for name, value in own.items() if value is not None}
        return {name: value for name, value in found.items() if value}


#: Groups of parameters, each of which has the group's deviation.
_GROUPS = {
    "focal_px": ("fx_px", "fy_px"),
    "centre_px": ("cx_px", "cy_px"),
    "rotation_rad": ("rx_rad", "ry_rad", "rz_rad"),
    "translation_mm": ("tx_mm", "ty_mm", "tz_mm"),
}


class ErrorsTable(Parameters):
    """``[calibration.std]``: how far a calibration's parameters are off."""

    camera: DeviceErrors = DeviceErrors()
    projector: DeviceErrors = DeviceErrors()


class CalibrationTable(Parameters):
    """``[calibration]``: what is measured with, instead of the rig that is rendered."""

    rig: str | None = None
    model: str | None = None
    std: ErrorsTable | None = None
    covariance: str | None = None
    seed: Seed = 0
    redraw: bool = False
    align: bool = False

    @model_validator(mode="after")
    def _one_way(self) -> CalibrationTable:
        drawn = [name for name in ("std", "covariance") if getattr(self, name) is not None]
        if self.model is not None and (self.rig is not None or drawn):
            raise ValueError("a model, or a rig and its errors, not both")
        if len(drawn) > 1:
            raise ValueError("std or covariance, not both")
        if not drawn and self.rig is None and self.model is None and not self.align:
            raise ValueError("a rig, a model, std, covariance or align")
        if self.redraw and not drawn:
            raise ValueError("redraw with std or covariance only")
        return self

    def deviations(self) -> dict[str, float]:
        """Return standard deviations by parameter of the rig; none where none is stated."""
        if self.std is None:
            return {}
        devices = {"camera": self.std.camera, "projector": self.std.projector}
        return {
            f"{role}.{name}": value
            for role, one in devices.items()
            for name, value in one.deviations().items()
        }


class RenderTable(Parameters):
    """``[render]``."""

    samples: Samples = 16


class PreviewTable(Parameters):
    """``[preview]``: what ``--preview`` makes of the camera."""

    divisor: Count | None = None
    samples: Samples = 16


class NamedCamera(CameraOptics):
    """``[cameras.NAME]``: a camera of that name, and its own detector."""

    # In the place of keys of [detector].
    detector: dict[str, Any] = Field(default_factory=dict)


class SceneTables(Parameters):
    """A whole scene file."""

    # The name becomes a folder's.
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    description: str = ""
    # What ran (slbench.scene.file.extended): path and SHA-256.
    modules: tuple[dict[str, str], ...] = ()
    camera: CameraOptics | None = None
    projector: ProjectorOptics | None = None
    # By name, and complete: what is common to all is filled in (with_common).
    cameras: dict[DeviceName, NamedCamera] = Field(default_factory=dict)
    projectors: dict[DeviceName, ProjectorOptics] = Field(default_factory=dict)
    # Its keys are those of its kind (slbench.detector.base).
    detector: dict[str, Any] = Field(default_factory=dict)
    rig: RigTable
    objects: Annotated[tuple[ObjectTable, ...], Field(min_length=1)]
    # Their keys are those of the BSDFs (slbench.scene.surfaces.bsdfs).
    materials: dict[str, dict[str, Any]] = Field(default_factory=dict)
    light: LightTable = LightTable()
    environment: EnvironmentTable | None = None
    exposure: ExposureTable = ExposureTable()
    patterns: PatternsTable = PatternsTable()
    focus: FocusTable | None = None
    calibration: CalibrationTable | None = None
    colour: Colour | None = None
    decode: DecodeTable = DecodeTable()
    render: RenderTable = RenderTable()
    preview: PreviewTable = PreviewTable()
    # What the rig design needs of the hardware (slbench.design.rig.hardware); a scan does not.
    design: dict[str, Any] = Field(default_factory=dict)
    # What an uncertainty budget needs beside the scene (slbench.bench.budget.inputs).
    budget: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _devices(self) -> SceneTables:
        for role, names in self.rig.names.items():
            if getattr(self, role) is None and set(names) - set(getattr(self, f"{role}s")):
                raise ValueError("a [camera] and a [projector] table")
        return self

    def key(self, name: str, role: str | None = None) -> str:
        """Return the key of a device's table, by its name: ``camera``, ``cameras.left``.

        `role` is that of a device of a rig's file, whatever its name.
        """
        for key in ("cameras", "projectors"):
            if name in getattr(self, key) or name in getattr(self.rig, key):
                return f"{key}.{name}"
        return role or name

    def optics(self, role: Literal["camera", "projector"]) -> dict[str, Optics]:
        """Return the tables of all cameras or projectors that stand in ``[rig]``, by name."""
        own, further = getattr(self, role), getattr(self, f"{role}s")
        return {name: further.get(name, own) for name in self.rig.names[role]}


class SceneOfFile(SceneTables):
    """A whole scene file whose rig is a file's; tables of devices add to it."""

    camera: CameraBeside = CameraBeside()  # type: ignore[assignment]
    projector: ProjectorBeside = ProjectorBeside()  # type: ignore[assignment]
    cameras: dict[DeviceName, NamedCameraBeside] = Field(default_factory=dict)  # type: ignore[assignment]
    projectors: dict[DeviceName, ProjectorBeside] = Field(default_factory=dict)  # type: ignore[assignment]

    def beside(self, entries: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """Return what stands beside the rig's file, as its entries, by the table that states it.

        Raises
        ------
        InputError
            For the table of a device that the file has not.
        """
        volume = self.rig.volume_mm
        found = {"rig": {} if volume is None else {"volume_mm": np.array(volume, np.float64)}}
        for role in ("camera", "projector"):
            common, own = getattr(self, role), getattr(self, f"{role}s")
            named = entries.get(f"{role}s")
            names = named.split() if isinstance(named, str) else [role]
            for name in own:
                if name not in names or named is None:
                    expected = f"a {role} of the rig's file, {', '.join(names)}"
                    raise InputError(f"{role}s.{name}", expected, quoted(name, names))
            for name in names:
                key = f"{role}s.{name}" if name in own else role
                stated = own.get(name, common).stated(name, entries)
                found[key] = found.get(key, {}) | stated
        return found


def tables_of(content: Mapping[str, Any]) -> type[SceneTables]:
    """Return the model of a scene's content: of a rig that is a file's, or described in it."""
    rig = content.get("rig")
    keys = set(rig) if isinstance(rig, dict) else set()
    return SceneOfFile if "file" in keys <= {"file", "volume_mm", "motion"} else SceneTables


def with_common(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scene's content with what named devices have in common filled in.

    A device that stands in ``[rig.cameras]`` has the keys of ``[camera]``, but for those that its
    own ``[cameras.NAME]`` states; likewise projectors.
    """
    result = dict(content)
    for role in ("camera", "projector"):
        named, common = content.get(f"{role}s"), content.get(role)
        if isinstance(named, Mapping) and isinstance(common, Mapping):
            result[f"{role}s"] = {
                name: {**common, **own} if isinstance(own, Mapping) else own
                for name, own in named.items()
            }
    return result
