"""Scene files: TOML to :class:`slbench.scene.model.Scene`.

Keys and their values are :mod:`slbench.scene.tables`'s.  A path written in a scene is relative
to the scene's folder and cannot leave it.

``extends = "..."`` takes everything from another scene first: tables are merged key by key,
anything else (lists too) is replaced.  What several scenes share thus stands once, in
``scenes/hardware``.  A list of names is taken one after the other.  A detector or a material of
another kind has other keys, and is replaced.

``[set]`` changes single keys of what a scene extends, elements of its lists too:
``"objects[0].position_mm[2]" = 1.5`` (:mod:`slbench.scene.changes`).  A user's own changes, of
``load_scene`` and ``--set``, come last.

``modules = ["my_codes.py"]`` names Python files beside the scene that add to the registries
(:mod:`slbench.core.modules`); those of a scene that is extended run first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from slbench import objects
from slbench.core import resources
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import read_toml
from slbench.core.modules import load_modules
from slbench.core.registry import quoted
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.detector.base import DEFAULT as DEFAULT_DETECTOR
from slbench.detector.base import DetectorModel
from slbench.patterns import PatternSequence, read_patterns
from slbench.patterns.given import PatternsTable
from slbench.rig import VOLUME_MM, Camera, DesignVariables, Pose, Projector, Rig
from slbench.rig.files.entries import rig_entries
from slbench.rig.opencv import rig_of
from slbench.rig.optics.response import Response
from slbench.scene.calibration import Calibration, read_calibration
from slbench.scene.changes import (
    Change,
    Changes,
    apply_changes,
    listed,
    naming_changes,
    read_changes,
)
from slbench.scene.devices.detector import read_detector
from slbench.scene.doubts import scene_doubts
from slbench.scene.model import USUAL_PATTERNS, Exposure, Light, Scene, SceneObject, place_of
from slbench.scene.surfaces.bsdfs import DEFAULT as DEFAULT_BSDF
from slbench.scene.surfaces.materials import PRESETS, Material, own_materials
from slbench.scene.tables import PlaceTable, SceneOfFile, SceneTables, tables_of, with_common

#: Width of a preview where the scene states no divisor, px.
_PREVIEW_WIDTH = 320


def load_scene(
    name_or_path: str | Path,
    *,
    preview: bool = False,
    allow_modules: bool = False,
    changes: Changes = (),
    measured_with: str | Path | None = None,
    align: bool = False,
) -> Scene:
    """Load a scene from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A file, or the name of a shipped scene such as ``"step-block"``.
    preview : bool
        Fewer camera pixels and samples, so that a scan takes seconds: the scene's
        ``[preview]``, by default at most 320 pixels wide with 16 samples each.
    allow_modules : bool
        Run the Python modules that the file names: code of its author.
    changes : sequence of str, or mapping
        Of the file's keys: ``["camera.f_number=8"]`` or ``{"camera.f_number": 8}``
        (:mod:`slbench.scene.changes`).  The scene's ``specification`` has them, in their places and
        listed as ``set``.
    measured_with : path, optional
        A rig (``.yaml``) or a calibration model (``.json``) by which points are computed, instead
        of the scene's own rig and of what its ``[calibration]`` says.
    align : bool
        Whether points are moved to the truth by the best rigid motion before they are scored.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        Naming the file and key, or the change, of the first thing that cannot be used.

    Warns
    -----
    InputWarning
        For what can be used and was probably meant otherwise (:mod:`slbench.scene.doubts`).

    Examples
    --------
    >>> load_scene("plane", changes=["camera.f_number=8"]).rig.camera.lens.aperture_radius_mm
    1.0
    """
    path = resources.find("scenes", name_or_path)
    scene, file = _load(path, _objects, allow_modules, read_changes(changes))
    if measured_with is not None:
        scene = scene.measured_with(measured_with, align=align)
    elif align:
        made = replace(scene.calibration or Calibration(), align=True)
        table = scene.specification.get("calibration", {}) | {"align": True}
        specification = scene.specification | {"calibration": table}
        scene = replace(scene, calibration=made, specification=specification)
    _question(scene, file, path)
    if not preview:
        return scene
    widest = max(camera.width for camera in scene.rig.cameras.values())
    divisor = file.preview.divisor or max(1, -(-widest // _PREVIEW_WIDTH))
    return scene.coarser(divisor, file.preview.samples)


def scene_of(content: dict[str, Any], path: Path) -> Scene:
    """Return the scene of a file's content, which need not be written yet.

    Parameters
    ----------
    content : dict
        As the file has it, before what it extends.
    path : Path
        Where the file is to stand.

    Raises
    ------
    InputError
        As :func:`load_scene`.

    Warns
    -----
    InputWarning
        As :func:`load_scene`.
    """
    scene, file = _scene(extended(content, path), path, _objects, False)
    _question(scene, file, path)
    return scene


def objects_of(content: dict[str, Any], path: Path) -> tuple[SceneObject, ...]:
    """Return the objects of a scene's content, merged already: its ``specification``.

    Parameters
    ----------
    content : dict
    path : Path
        Where a file of that content would stand: what it names is relative to it.

    Raises
    ------
    InputError
        As :func:`load_scene`.
    """
    bare = {key: value for key, value in content.items() if key not in ("set", "modules")}
    bare = {key: value for key, value in bare.items() if key != "calibration"}
    tables = validated(tables_of(bare), with_common(bare), path.name, separator=": ")
    return _objects(tables, path)


def load_settings(path: Path, *, allow_modules: bool = False) -> Scene:
    """Load a scene with a plane in the place of its objects, which cost most to load.

    That is all that exposing frames from light transport needs, however many its objects are
    and whether or not their files are at hand.  An environment map is left out for the same
    reason.

    Raises
    ------
    InputError
        As :func:`load_scene`, but for the objects.
    """
    return _load(path, None, allow_modules)[0]


@cache
def _placeholder() -> tuple[SceneObject, ...]:
    return (SceneObject(objects.load_artefact("plane")),)


def _load(
    path: Path,
    build_objects: Callable[[SceneTables, Path], tuple[SceneObject, ...]] | None,
    allow_modules: bool,
    changes: Sequence[Change] = (),
) -> tuple[Scene, SceneTables]:
    return _scene(read_merged(path, allow_modules), path, build_objects, allow_modules, changes)


def _scene(
    content: dict[str, Any],
    path: Path,
    build_objects: Callable[[SceneTables, Path], tuple[SceneObject, ...]] | None,
    allow_modules: bool,
    changes: Sequence[Change] = (),
) -> tuple[Scene, SceneTables]:
    """Return the scene of a merged content; without its light, where no objects are built."""
    content = apply_changes(content, changes)
    with naming_changes(path.name, changes):
        content = _with_curve(content, path)
        file = validated(tables_of(content), with_common(content), path.name, separator=": ")
        if changes:  # for whoever asks where a result comes from
            content["set"] = listed(changes)
        with located(path.name):
            if build_objects is None:
                bare = file.model_copy(update={"environment": None})
                return _build(bare, path, content, _placeholder(), allow_modules), file
            return _build(file, path, content, build_objects(file, path), allow_modules), file


def _question(scene: Scene, file: SceneTables, path: Path) -> None:
    for what, doubt in scene_doubts(scene, file):
        warn_user(f"{path.name}: {what}", doubt, stacklevel=3)


def read_merged(
    path: Path, allow_modules: bool = False, seen: tuple[Path, ...] = ()
) -> dict[str, Any]:
    """Read a scene file, merged into what it extends; see :func:`extended`."""
    return extended(read_toml(path), path, allow_modules, seen)


def extended(
    content: dict[str, Any], path: Path, allow_modules: bool = False, seen: tuple[Path, ...] = ()
) -> dict[str, Any]:
    """Return a scene's content merged into what it extends, and run its modules.

    Parameters
    ----------
    content : dict
    path : Path
        Where it was read.
    allow_modules : bool
        Whether modules may be run.
    seen : tuple of Path
        Files that extend this one.

    Returns
    -------
    dict
        ``modules`` in it are names and SHA-256, of all files in the order in which they ran.
    """
    content = dict(content)
    base = content.pop("extends", None)
    own_changes = _own_changes(content.pop("set", {}), f"{path.name}: set")
    content = _with_curve(content, path)
    merged = content if base is None else _with_base(content, base, path, allow_modules, seen)
    merged = apply_changes(merged, own_changes) if own_changes else merged
    names = content.get("modules", ())
    own = load_modules(names, path.parent, allow_modules, f"{path.name}: modules")
    before = () if base is None else merged.get("modules", ())
    merged.pop("modules", None)
    return merged | {"modules": (*before, *own)} if before or own else merged


def _with_curve(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return content with the curve of the projector's response that it names a file of.

    The file is relative to the scene that names it, whatever extends that; what was read goes
    with the scene into all that is made of it.
    """
    result = dict(content)
    found = _response_of(content.get("projector"), f"{path.name}: projector", path)
    if found is not None:
        result["projector"] = found
    named = content.get("projectors")
    for name, table in named.items() if isinstance(named, dict) else ():
        found = _response_of(table, f"{path.name}: projectors.{name}", path)
        if found is not None:
            result["projectors"] = {**result["projectors"], name: found}
    return result


def _response_of(projector: Any, where: str, path: Path) -> dict[str, Any] | None:
    """Return a projector's table with the curve that it names a file of; None without any."""
    given = projector.get("response") if isinstance(projector, dict) else None
    if not isinstance(given, str):
        return None
    with located(f"{where}.response"):
        curve = Response.read(resources.inside(path.parent, given)).curve
    return {**projector, "response": [list(pair) for pair in curve or ()]}


def _own_changes(table: Any, where: str) -> tuple[Change, ...]:
    """Return the changes of a file's ``[set]``, whose keys are written in quotation marks."""
    if not isinstance(table, dict):
        raise InputError(where, 'a table, such as "camera.f_number" = 8', shown(table))
    for key, value in table.items():
        if isinstance(value, dict):
            expected = (
                f'the key in quotation marks, such as "{key}.{next(iter(value), "f_number")}"'
            )
            raise InputError(f"{where}.{key}", expected, shown(value))
    return read_changes({key: None if v == "" else v for key, v in table.items()}, where)


def _with_base(
    content: dict[str, Any], base: Any, path: Path, allow_modules: bool, seen: tuple[Path, ...]
) -> dict[str, Any]:
    """Return content merged into what it extends, each of several before the next."""
    where = f"{path.name}: extends"
    seen = (*seen, path.resolve())
    merged: dict[str, Any] = {}
    modules: tuple[Any, ...] = ()
    for one in base if isinstance(base, list) and base else [base]:
        read = read_merged(_base_path(one, where, path, seen), allow_modules, seen)
        modules += tuple(read.pop("modules", ()))
        merged = _merged(merged, read)
    own = {key: value for key, value in content.items() if key != "modules"}
    return _merged(merged, own) | ({"modules": modules} if modules else {})


def _base_path(base: Any, where: str, path: Path, seen: tuple[Path, ...]) -> Path:
    """Return where a scene is that another extends."""
    if not isinstance(base, str):
        expected = "a scene file beside it or the name of a shipped scene, or a list of them"
        raise InputError(where, expected, repr(base))
    try:
        if base.lower().endswith(".toml"):
            parent = resources.inside(path.parent, base)
        else:
            parent = resources.find("scenes", base)
    except InputError as error:
        raise InputError(where, error.expected, error.got) from None
    if parent.resolve() in seen:
        raise InputError(where, "a chain of scenes with an end", f"{base}, which comes again")
    return parent


def _merged(base: dict[str, Any], content: dict[str, Any]) -> dict[str, Any]:
    result = dict(base)
    for key, value in content.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        merge = both and not _of_another_kind(result[key], value)
        result[key] = _merged(result[key], value) if merge else value
    return result


def _of_another_kind(base: dict[str, Any], table: dict[str, Any]) -> bool:
    """Return whether a detector or a material is of another kind than that it would extend."""
    return any(
        word in table and table[word] != base.get(word, default)
        for word, default in (("kind", DEFAULT_DETECTOR), ("bsdf", DEFAULT_BSDF))
    )


def _build(
    file: SceneTables,
    path: Path,
    content: dict[str, Any],
    scene_objects: tuple[SceneObject, ...],
    allow_modules: bool,
) -> Scene:
    rig = _rig(file, path)
    first = next(iter(rig.projectors.values()))
    panel = (first.width, first.height)
    time_ms, bracket = file.exposure.exposures()
    return Scene(
        name=file.name,
        rig=rig,
        objects=scene_objects,
        sequence=_patterns(file.patterns, panel, path.parent, allow_modules),
        detector=read_detector(file.detector, f"{path.name}: detector"),
        exposure=Exposure(
            None if time_ms is None else time_ms * 1e-3,
            file.exposure.white_level,
            file.exposure.vibration_px,
            None if file.exposure.bit_planes is None else file.exposure.bit_planes.value(),
            file.exposure.trigger,
            file.exposure.drift,
            bracket,
            _seconds(file.exposure.frame_period_ms),
            1e-3 * file.exposure.rolling_shutter_ms,
            _seconds(file.exposure.pulse_ms),
            file.exposure.multiplexed,
        ),
        light=_light(file, path, place_of(rig, scene_objects)),
        samples=file.render.samples,
        specification=content,
        focus=None if file.focus is None else file.focus.focus(rig, place_of(rig, scene_objects)),
        calibration=None
        if file.calibration is None
        else read_calibration(file.calibration, rig, path),
        colour=file.colour,
        rig_motion=file.rig.motion,
        detectors=_detectors(file, path),
        compensate=file.decode.motion,
    )


def _seconds(milliseconds: float | None) -> float | None:
    return None if milliseconds is None else milliseconds * 1e-3


def _detectors(file: SceneTables, path: Path) -> dict[str, DetectorModel]:
    """Return the detectors of cameras that state keys of their own, beside ``[detector]``."""
    found: dict[str, DetectorModel] = {}
    for name, table in file.cameras.items():
        if table.detector:
            common = file.detector
            if _of_another_kind(common, table.detector):
                common = {}
            where = f"{path.name}: cameras.{name}.detector"
            found[name] = read_detector({**common, **table.detector}, where)
    return found


def _light(file: SceneTables, path: Path, place: Pose) -> Light:
    environment = None
    if file.environment is not None:
        with located(f"{path.name}: environment"):
            environment = file.environment.environment(path.parent, place)
    return Light(file.light.ambient_w_per_m2 * 1e-6, file.light.bounces, environment)


def _patterns(
    table: PatternsTable, panel: tuple[int, int], folder: Path, allow_modules: bool
) -> PatternSequence:
    """Return the scene's own patterns: parts, or what its ``sequence`` says or names."""
    if table.parts is not None:
        stated = read_patterns(table.content(panel), panel, folder=folder)
        return table.coloured(stated.sequence)
    found = read_patterns(
        USUAL_PATTERNS if table.sequence is None else table.sequence,
        panel,
        shifts=table.shifts or 3,
        axes=table.axes or "u",
        folder=folder,
        allow_modules=allow_modules,
    )
    return table.coloured(found.sequence)


def _rig(file: SceneTables, path: Path) -> Rig:
    values = file.rig
    if isinstance(file, SceneOfFile):
        assert values.file is not None  # by tables_of
        entries = rig_entries(resources.inside(path.parent, values.file))
        with located(path.name):
            beside = file.beside(entries.values)
        for table, stated in beside.items():
            entries = entries.beside(stated, f"{path.name}: {table}")
        rig = rig_of(entries, looked_at=np.array(file.objects[0].position_mm))
        if not rig.projectors:
            expected = "a rig with a projector, which lights the scene"
            raise InputError(f"{path.name}: rig.file", expected, "cameras alone")
        return rig
    poses = _poses(file, path)
    # In focus where the axis comes closest to the origin, unless the file says otherwise.
    for name, pose in poses.items():
        if pose.origin_depth <= 0:
            expected = "a device that faces the origin"
            raise InputError(f"rig.{file.key(name)}", expected, "it faces away")
    cameras: dict[str, Camera] = {}
    for name, optics in file.optics("camera").items():
        with located(f"{path.name}: {file.key(name)}"):
            arguments = optics.arguments(poses[name].origin_depth)
            cameras[name] = Camera(**arguments, pose=poses[name])
    projectors: dict[str, Projector] = {}
    for name, optics in file.optics("projector").items():
        with located(f"{path.name}: {file.key(name)}"):
            arguments = optics.arguments(poses[name].origin_depth)
            projectors[name] = Projector(**arguments, pose=poses[name])
    return Rig(cameras, projectors, values.volume_mm or VOLUME_MM)


def _poses(file: SceneTables, path: Path) -> dict[str, Pose]:
    """Return the poses of all devices by name, and check that tables are of devices."""
    values, names = file.rig, file.rig.names
    for role, own in names.items():
        known = list(own)
        for name in getattr(file, f"{role}s"):
            if name not in known:
                expected = f"the name of a {role} that stands in [rig], {', '.join(known)}"
                raise InputError(f"{path.name}: {role}s.{name}", expected, quoted(name, known))
    both = [*names["camera"], *names["projector"]]
    if twice := [name for name in both if both.count(name) > 1]:
        expected = "a name of its own for every device"
        raise InputError(f"{path.name}: rig", expected, f"{twice[0]!r} twice")
    places: dict[str, PlaceTable | None] = {"camera": values.camera, "projector": values.projector}
    places |= values.cameras | values.projectors
    poses = {
        name: Pose.looking_at(place.position_mm, place.target_mm, place.down)
        for name, place in places.items()
        if place is not None
    }
    if values.z_ref_mm is not None:
        z_ref, w, h, length, alpha, beta = (float(x or 0.0) for x in values.design_values())
        design = DesignVariables(
            z_ref, w, h, length, float(np.deg2rad(alpha)), float(np.deg2rad(beta))
        )
        designed = design.poses()
        if designed[0].position[2] <= 0:
            raise InputError("rig.l_mm", "a camera in front of the reference plane", length)
        poses |= dict(zip(("camera", "projector"), designed, strict=True))
    return poses


def _objects(file: SceneTables, path: Path) -> tuple[SceneObject, ...]:
    where = f"{path.name}: materials"
    own = {
        name: Material.from_table(table, f"{where}.{name}", path.parent)
        for name, table in file.materials.items()
    }
    return tuple(_object(file, index, path, own) for index in range(len(file.objects)))


def _object(
    file: SceneTables, index: int, path: Path, materials: Mapping[str, Material]
) -> SceneObject:
    values = file.objects[index]
    where = f"{path.name}: objects[{index}]"
    if values.artefact is not None:
        given = values.artefact
        is_file = given.lower().endswith(".toml") or "/" in given or "\\" in given
        artefact = objects.load_artefact(resources.inside(path.parent, given) if is_file else given)
    elif values.mesh is not None:
        parameters: dict[str, Any] = {"path": values.mesh, "unit": values.unit}
        parameters |= {"centre": values.centre, "normals": values.normals or "file"}
        artefact = objects.build_artefact(
            "mesh", parameters, where, name=Path(values.mesh).stem, folder=path.parent
        )
    else:
        assert values.kind is not None  # by _one_shape
        artefact = objects.build_artefact(
            values.kind, values.parameters, f"{where}.parameters", folder=path.parent
        )
    material, of_file = Material(), own_materials(artefact)
    if values.material is not None:
        material, of_file = _material(materials, values.material, f"{where}.material"), {}
    by_part = of_file | {
        part: _material(materials, name, f"{where}.materials.{part}")
        for part, name in values.materials.items()
    }
    rotation = np.eye(3)
    if any(values.rotation_deg):
        from scipy.spatial.transform import Rotation  # a third of a second, for few scenes

        rotation = Rotation.from_euler("XYZ", values.rotation_deg, degrees=True).as_matrix()
    pose = Pose(rotation, np.array(values.position_mm))
    with located(where):
        return SceneObject(artefact, pose, material, by_part, values.distractor, values.motion())


def _material(own: Mapping[str, Material], name: str, where: str) -> Material:
    """Return a material of the scene's own or a preset; the scene's own come first."""
    if name in own or name in PRESETS:
        return own[name] if name in own else PRESETS[name]
    known = [*own, *PRESETS]
    raise InputError(where, f"one of the materials {', '.join(known)}", quoted(name, known))
