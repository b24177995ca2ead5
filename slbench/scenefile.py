"""Scene files: TOML to :class:`slbench.scene.Scene`.

The unit of a number is in its key; an unknown key, a missing one or a value of the wrong kind
is refused with the key's full name.  ``docs/scene-files.md`` lists the keys.  A path written
in a scene is relative to the scene's folder and cannot leave it.

``extends = "..."`` takes everything from another scene first: tables are merged key by key,
anything else (lists too) is replaced.  What several scenes share thus stands once, in
``scenes/hardware``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from slbench import objects, resources
from slbench.detector import Detector
from slbench.errors import InputError
from slbench.io import read_toml
from slbench.materials import PRESETS, Material
from slbench.patterns import PatternSequence
from slbench.rig import Camera, DesignVariables, Lens, Pose, Projector, Rig
from slbench.rig.opencv import read_rig
from slbench.scene import MAX_SETTINGS, Exposure, Focus, Light, Scene, SceneObject
from slbench.validation import Finite, Parameters, validated

#: Width of a preview where the scene states no divisor, px.
_PREVIEW_WIDTH = 320

Positive = Annotated[float, Field(ge=1e-9, le=1e9, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]


class Optics(Parameters):
    """What camera and projector have in common."""

    resolution_px: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
    pitch_um: Positive | tuple[Positive, Positive]
    focal_length_mm: Positive | None = None
    f_number: Positive | None = None
    aperture_radius_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    focus_distance_mm: Positive | None = None
    magnification: Positive | None = None
    numerical_aperture: Annotated[float, Field(ge=0, lt=1)] | None = None
    natural_vignetting: bool = True
    principal_point_px: tuple[Finite, Finite] | None = None
    distortion: tuple[Finite, Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 0.0, 0.0)
    tilt_deg: tuple[Finite, Finite] = (0.0, 0.0)
    body_mm: tuple[Positive, Positive, Positive] | None = None

    @model_validator(mode="after")
    def _one_lens(self) -> Optics:
        if (self.focal_length_mm is None) == (self.magnification is None):
            raise ValueError(
                "focal_length_mm (perspective) or magnification (telecentric), one of them"
            )
        if self.f_number is not None and self.aperture_radius_mm is not None:
            raise ValueError("f_number or aperture_radius_mm, not both")
        if self.magnification is None and self.numerical_aperture is not None:
            raise ValueError("numerical_aperture with a telecentric lens only")
        if self.magnification is not None and (self.f_number or self.aperture_radius_mm):
            raise ValueError("numerical_aperture, not f_number or a radius, with a magnification")
        return self

    def arguments(self, distance_mm: float) -> dict[str, Any]:
        """Return the arguments of a device, focused at `distance_mm` by default."""
        focus = self.focus_distance_mm or distance_mm
        if self.magnification is not None:
            lens = Lens.telecentric(self.magnification, self.numerical_aperture or 0.0, focus)
        else:
            assert self.focal_length_mm is not None  # by _one_lens
            radius = self.aperture_radius_mm or 0.0
            if self.f_number is not None:
                radius = self.focal_length_mm / (2.0 * self.f_number)
            lens = Lens(
                self.focal_length_mm, radius, focus, natural_vignetting=self.natural_vignetting
            )
        pitch = self.pitch_um if isinstance(self.pitch_um, tuple) else (self.pitch_um,) * 2
        return {
            "width": self.resolution_px[0],
            "height": self.resolution_px[1],
            "pitch_mm": (pitch[0] * 1e-3, pitch[1] * 1e-3),
            "lens": lens,
            "principal_point": self.principal_point_px,
            "distortion": self.distortion,
            "body_mm": self.body_mm,
            "tilt_rad": (float(np.deg2rad(self.tilt_deg[0])), float(np.deg2rad(self.tilt_deg[1]))),
        }


class DetectorTable(Parameters):
    """A detector; what is not given is as Detector has it."""

    bit_depth: int | None = None
    full_well_e: Finite | None = None
    read_noise_e: Finite | None = None
    dark_current_e_per_s: Finite | None = None
    quantum_efficiency: Finite | None = None
    wavelength_nm: Finite | None = None
    prnu: Finite | None = None
    dsnu_e: Finite | None = None
    offset_dn: Finite | None = None
    gain_e_per_dn: Finite | None = None
    seed: int | None = None

    def detector(self) -> Detector:
        """Return the detector."""
        return Detector(**self.model_dump(exclude_none=True))


class ProjectorOptics(Optics):
    """The optical keys of a projector, and its light."""

    flux_w: Positive = 1.0
    bit_depth: Annotated[int, Field(ge=0, le=16)] = 8
    gamma: Positive = 1.0

    def arguments(self, distance_mm: float) -> dict[str, Any]:
        """Return the arguments of Projector, focused at `distance_mm` by default."""
        light = {"flux_w": self.flux_w, "bit_depth": self.bit_depth or None, "gamma": self.gamma}
        return super().arguments(distance_mm) | light


class _Place(Parameters):
    """An explicit pose: where a device stands and what it looks at."""

    position_mm: Vector3
    target_mm: Vector3 = (0.0, 0.0, 0.0)
    down: Vector3 = (0.0, -1.0, 0.0)


class _Rig(Parameters):
    z_ref_mm: Finite | None = None
    w_mm: Finite | None = None
    h_mm: Finite | None = None
    l_mm: Finite | None = None
    alpha_p_deg: Finite | None = None
    beta_p_deg: Finite | None = None
    camera: _Place | None = None
    projector: _Place | None = None
    file: str | None = None
    volume_mm: tuple[Positive, Positive, Positive] = (60.0, 70.0, 30.0)

    @model_validator(mode="after")
    def _one_way(self) -> _Rig:
        design = self.design_values()
        places = (self.camera, self.projector)
        ways = [
            all(value is not None for value in design),
            all(place is not None for place in places),
            self.file is not None,
        ]
        used = [
            any(value is not None for value in design),
            any(place is not None for place in places),
            self.file is not None,
        ]
        if sum(ways) != 1 or used != ways:
            raise ValueError(
                "either the six of z_ref_mm w_mm h_mm l_mm alpha_p_deg beta_p_deg, "
                "or camera and projector, or file"
            )
        return self

    def design_values(self) -> tuple[float | None, ...]:
        return (self.z_ref_mm, self.w_mm, self.h_mm, self.l_mm, self.alpha_p_deg, self.beta_p_deg)


class _Object(Parameters):
    artefact: str | None = None
    mesh: str | None = None
    unit: Literal["um", "mm", "cm", "inch", "m"] | None = None
    centre: bool = False
    kind: str | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)
    position_mm: Vector3 = (0.0, 0.0, 0.0)
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    material: str | None = None
    materials: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_shape(self) -> _Object:
        if sum(way is not None for way in (self.artefact, self.mesh, self.kind)) != 1:
            raise ValueError("one of artefact (a name), mesh (a file with its unit) or kind")
        if (self.mesh is None) != (self.unit is None) or (self.centre and self.mesh is None):
            raise ValueError("a unit with a mesh file, and unit and centre with nothing else")
        if self.parameters and self.kind is None:
            raise ValueError("parameters with a kind only")
        return self


class _Material(Parameters):
    bsdf: Literal["diffuse", "rough_plastic", "rough_conductor"] = "diffuse"
    albedo: Annotated[float, Field(ge=0, le=1)] = 0.7
    roughness: Annotated[float, Field(gt=0, le=1)] = 0.3
    eta: Positive | None = None
    k: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 2.93


class _Light(Parameters):
    ambient_w_per_m2: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    bounces: Annotated[int, Field(ge=0, le=16)] = 0


class _Exposure(Parameters):
    time_ms: Positive | None = None
    white_level: Annotated[float, Field(gt=0, le=1)] = 0.8
    vibration_px: Annotated[float, Field(ge=0, le=10)] = 0.0


class _Focus(Parameters):
    camera_mm: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    projector_mm: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    heights_mm: Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None
    settings: Annotated[int, Field(ge=1, le=MAX_SETTINGS)] | None = None
    move: Literal["both", "camera", "projector"] = "both"
    apart: bool = False

    @model_validator(mode="after")
    def _one_way(self) -> _Focus:
        distances = self.camera_mm is not None or self.projector_mm is not None
        ways = (distances, self.heights_mm is not None, self.settings is not None)
        if sum(ways) != 1:
            raise ValueError("camera_mm or projector_mm (or both), or heights_mm, or settings")
        if distances and (self.apart or self.move != "both"):
            raise ValueError("move and apart with heights_mm or settings only")
        return self

    def focus(self, rig: Rig) -> Focus:
        """Return the settings; a sweep in `settings` goes through the volume's height."""
        if self.settings is not None or self.heights_mm is not None:
            heights = self.heights_mm
            if heights is None:  # the middles of slices of the volume
                count = self.settings or 1
                slices = (np.arange(count) + 0.5) / count - 0.5
                heights = tuple((rig.volume_mm[2] * slices).tolist())
            return Focus.sweep(rig, heights, self.move, self.apart)
        kept = rig.camera.lens.focus_distance_mm, rig.projector.lens.focus_distance_mm
        count = len(self.camera_mm or self.projector_mm or ())
        return Focus(self.camera_mm or (kept[0],) * count, self.projector_mm or (kept[1],) * count)


class _Patterns(Parameters):
    sequence: str = "1,10,50"
    shifts: int = 3
    axes: str = "u"


class _Render(Parameters):
    samples: Annotated[int, Field(ge=1, le=65536)] = 64


class _Preview(Parameters):
    divisor: Annotated[int, Field(ge=1)] | None = None
    samples: Annotated[int, Field(ge=1, le=65536)] = 16


class _SceneFile(Parameters):
    # The name becomes a folder's.
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    description: str = ""
    camera: Optics | None = None
    projector: ProjectorOptics | None = None
    detector: DetectorTable = DetectorTable()
    rig: _Rig
    objects: Annotated[tuple[_Object, ...], Field(min_length=1)]
    materials: dict[str, _Material] = Field(default_factory=dict)
    light: _Light = _Light()
    exposure: _Exposure = _Exposure()
    patterns: _Patterns = _Patterns()
    focus: _Focus | None = None
    render: _Render = _Render()
    preview: _Preview = _Preview()
    # What the rig design needs of the hardware (slbench.design.hardware); a scan does not.
    design: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _devices(self) -> _SceneFile:
        if self.rig.file is None and (self.camera is None or self.projector is None):
            raise ValueError("a [camera] and a [projector] table")
        if self.rig.file is not None and (self.camera or self.projector):
            raise ValueError("no [camera] or [projector] beside rig.file, which holds both")
        return self


def load_scene(name_or_path: str | Path, *, preview: bool = False) -> Scene:
    """Load a scene from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A file, or the name of a shipped scene such as ``"step-block"``.
    preview : bool
        Fewer camera pixels and samples, so that a scan takes seconds: the scene's
        ``[preview]``, by default at most 320 pixels wide with 16 samples each.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        Naming the file and key of the first thing that cannot be used.
    """
    path = resources.find("scenes", name_or_path)
    scene, file = _load(path, _objects)
    if not preview:
        return scene
    divisor = file.preview.divisor or max(1, -(-scene.rig.camera.width // _PREVIEW_WIDTH))
    return scene.coarser(divisor, file.preview.samples)


def load_settings(path: Path) -> Scene:
    """Load a scene with a plane in the place of its objects, which cost most to load.

    That is all that exposing frames from light transport needs, however many its objects are
    and whether or not their files are at hand.

    Raises
    ------
    InputError
        As :func:`load_scene`, but for the objects.
    """
    return _load(path, lambda file, path: _placeholder())[0]


@cache
def _placeholder() -> tuple[SceneObject, ...]:
    return (SceneObject(objects.load("plane")),)


def _load(
    path: Path, build_objects: Callable[[_SceneFile, Path], tuple[SceneObject, ...]]
) -> tuple[Scene, _SceneFile]:
    content = read_merged(path)
    file = validated(_SceneFile, content, path.name, separator=": ")
    try:
        return _build(file, path, content, build_objects(file, path)), file
    except InputError as error:
        if error.where.startswith(path.name):
            raise
        raise InputError(f"{path.name}: {error.where}", error.expected, error.got) from None


def read_merged(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a scene file, merged into what it extends."""
    return extended(read_toml(path), path, seen)


def extended(content: dict[str, Any], path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Return a scene's content merged into what it extends; `path` is where it was read."""
    content = dict(content)
    base = content.pop("extends", None)
    if base is None:
        return content
    where = f"{path.name}: extends"
    if not isinstance(base, str):
        raise InputError(where, "a scene file beside it or the name of a shipped scene", repr(base))
    try:
        if base.endswith(".toml"):
            parent = resources.inside(path.parent, base)
        else:
            parent = resources.find("scenes", base)
    except InputError as error:
        raise InputError(where, error.expected, error.got) from None
    seen = (*seen, path.resolve())
    if parent.resolve() in seen:
        raise InputError(where, "a chain of scenes with an end", f"{base}, which comes again")
    return _merged(read_merged(parent, seen), content)


def _merged(base: dict[str, Any], content: dict[str, Any]) -> dict[str, Any]:
    result = dict(base)
    for key, value in content.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = _merged(result[key], value) if both else value
    return result


def _build(
    file: _SceneFile, path: Path, content: dict[str, Any], scene_objects: tuple[SceneObject, ...]
) -> Scene:
    rig = _rig(file, path.parent)
    panel = (rig.projector.width, rig.projector.height)
    return Scene(
        name=file.name,
        rig=rig,
        objects=scene_objects,
        sequence=PatternSequence.parse(
            file.patterns.sequence, panel, file.patterns.shifts, file.patterns.axes
        ),
        detector=file.detector.detector(),
        exposure=Exposure(
            None if file.exposure.time_ms is None else file.exposure.time_ms * 1e-3,
            file.exposure.white_level,
            file.exposure.vibration_px,
        ),
        light=Light(file.light.ambient_w_per_m2 * 1e-6, file.light.bounces),
        samples=file.render.samples,
        specification=content,
        focus=None if file.focus is None else file.focus.focus(rig),
    )


def _rig(file: _SceneFile, folder: Path) -> Rig:
    values = file.rig
    if values.file is not None:
        return read_rig(resources.inside(folder, values.file))
    assert file.camera is not None  # both by _devices
    assert file.projector is not None
    if values.camera is not None and values.projector is not None:
        poses = [
            Pose.looking_at(place.position_mm, place.target_mm, place.down)
            for place in (values.camera, values.projector)
        ]
    else:
        z_ref, w, h, length, alpha, beta = (float(x or 0.0) for x in values.design_values())
        design = DesignVariables(
            z_ref, w, h, length, float(np.deg2rad(alpha)), float(np.deg2rad(beta))
        )
        poses = list(design.poses())
        if poses[0].position[2] <= 0:
            raise InputError("rig.l_mm", "a camera in front of the reference plane", length)
    # In focus where the axis comes closest to the origin, unless the file says otherwise.
    camera_focus, projector_focus = (float(-pose.position @ pose.rotation[:, 2]) for pose in poses)
    for name, distance in (("camera", camera_focus), ("projector", projector_focus)):
        if distance <= 0:
            raise InputError(f"rig.{name}", "a device that faces the origin", "it faces away")
    camera = Camera(**file.camera.arguments(camera_focus), pose=poses[0])
    projector = Projector(**file.projector.arguments(projector_focus), pose=poses[1])
    return Rig(camera, projector, values.volume_mm)


def _objects(file: _SceneFile, path: Path) -> tuple[SceneObject, ...]:
    return tuple(_object(file, index, path) for index in range(len(file.objects)))


def _object(file: _SceneFile, index: int, path: Path) -> SceneObject:
    values = file.objects[index]
    where = f"{path.name}: objects[{index}]"
    if values.artefact is not None:
        given = values.artefact
        is_file = given.endswith(".toml") or "/" in given or "\\" in given
        artefact = objects.load(resources.inside(path.parent, given) if is_file else given)
    elif values.mesh is not None:
        parameters = {"path": values.mesh, "unit": values.unit, "centre": values.centre}
        artefact = objects.build(
            "mesh", parameters, where, name=Path(values.mesh).stem, folder=path.parent
        )
    else:
        assert values.kind is not None  # by _one_shape
        artefact = objects.build(
            values.kind, values.parameters, f"{where}.parameters", folder=path.parent
        )
    material = Material()
    if values.material is not None:
        material = _material(file, values.material, f"{where}.material")
    by_part = {
        part: _material(file, name, f"{where}.materials.{part}")
        for part, name in values.materials.items()
    }
    rotation = Rotation.from_euler("XYZ", values.rotation_deg, degrees=True).as_matrix()
    pose = Pose(rotation, np.array(values.position_mm))
    return SceneObject(artefact, pose, material, by_part)


def _material(file: _SceneFile, name: str, where: str) -> Material:
    """Return a material of the scene's own or a preset; the scene's own come first."""
    if name in file.materials:
        return Material(**file.materials[name].model_dump())
    if name in PRESETS:
        return PRESETS[name]
    known = ", ".join((*file.materials, *PRESETS))
    raise InputError(where, f"one of the materials {known}", name)
