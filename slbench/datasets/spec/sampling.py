"""From a specification to the scene of one sample: draws, and what they must meet.

A draw depends on the specification, the seed, the sample's index and the number of the draw
alone.  What is drawn is put into the scene's tables, so that the scene file of a sample is
complete and loads like any other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.io import plain, write_toml
from slbench.core.random import derived_seed
from slbench.core.validation.values import validated
from slbench.datasets.spec.clutter import Resting
from slbench.datasets.spec.distributions import Distribution, column, find, put, stream
from slbench.datasets.spec.distributions import Path as Place
from slbench.datasets.spec.embedded import file_names, map_names, picture_names
from slbench.datasets.spec.specification import Specification
from slbench.datasets.store.sample import RIG, SCENE
from slbench.datasets.store.shards import key
from slbench.rig.opencv import write_rig
from slbench.scene.devices.optics import CameraOptics
from slbench.scene.file import load_scene, load_settings, objects_of
from slbench.scene.model import Scene
from slbench.simulate.stack import check_frame_errors

#: Width and Monte Carlo samples of a preview, where the scene does not say.
_PREVIEW_WIDTH, _PREVIEW_SAMPLES = 320, 16
#: Draws of an object that are tried at least before it is refused, and how often the same error may
#: come in succession.
_TRIED, _SAME = 100, 10
_OUTSIDE = "an object outside the measurement volume"


@dataclass(frozen=True)
class Draw:
    """What was drawn once for a sample.

    Parameters
    ----------
    kind : str or None
        Name of the drawn object, the first where there are several; None where the specification
        has none to choose from.
    values : dict
        By column of the index.
    table : dict
        Content of the scene file, with its settings of a preview.
    pictures : tuple of str
        Files that the patterns show.
    wanted : int
        Objects of interest, the first of the scene's.
    resting : Resting or None
        How drawn objects come to rest.
    """

    kind: str | None
    values: dict[str, Any]
    table: dict[str, Any]
    pictures: tuple[str, ...] = ()
    wanted: int = 1
    resting: Resting | None = None


def sample_seed(seed: int, sample: int) -> int:
    """Return the seed of a sample's light and of its first capture."""
    return derived_seed(seed, sample)


def capture_seed(of_sample: int, pattern_set: int, repeat: int) -> int:
    """Return the seed of a capture; the first one has the sample's own."""
    if (pattern_set, repeat) == (0, 0):
        return of_sample
    return derived_seed(of_sample, pattern_set, repeat)


def draw(
    specification: Specification,
    seed: int,
    sample: int,
    number: int = 0,
    *,
    kind: int | None = None,
    which: str = "objects",
) -> Draw:
    """Draw the parameters of a sample.

    Parameters
    ----------
    specification : Specification
        Resolved.
    seed, sample : int
    number : int
        Which draw: 0, and further ones where constraints were not met.
    kind : int, optional
        Index of the object, instead of a drawn one; it is the only one then.
    which : {"objects", "distractors"}
        The list that `kind` is an index of.

    Returns
    -------
    Draw
    """
    table: dict[str, Any] = plain(specification.scene)
    values: dict[str, Any] = {}
    name, resting, wanted = None, None, 1

    def drawn(tables: Any, slot_of: Callable[[Place], str]) -> None:
        for place, distribution in list(find(tables, specification.name)):
            label = column(place, distribution) + slot_of(place)
            values[label] = distribution.draw(stream(seed, sample, number, label))
            put(tables, place, values[label])

    slots: list[tuple[str, str]] = []
    if specification.clutter is not None:
        clutter, numbers = specification.clutter, (1, 0)
        if kind is None:
            # Once a sample, as kinds are.
            numbers = (
                _count(clutter.limits("count"), seed, sample, "[count]"),
                _count(clutter.limits("distractors"), seed, sample, "[distractors]"),
            )
        values |= {"count": numbers[0], "distractors": numbers[1]}
        slots, wanted = list(clutter.slots(numbers)), numbers[0]
        if clutter.poses == "resting":
            resting = Resting(len(slots), (seed, sample, number), clutter)
    elif specification.objects:
        slots = [("", "objects")]
    if kind is not None:
        slots, wanted = [("", which)], int(which == "objects")
    placed = []
    for slot, among in slots:
        chosen, called = _chosen(specification, among, seed, sample, slot, kind)
        placed.append(chosen)
        if slot:
            values[f"kind{slot}"] = called
        else:
            name = called
    if placed:
        table["objects"] = [*placed, *table.get("objects", [])]

    def slot_of(place: Place) -> str:
        if place[0] != "objects" or not isinstance(place[1], int) or place[1] >= len(slots):
            return ""
        return slots[place[1]][0]

    drawn(table, slot_of)
    for (slot, _), chosen in zip(slots, placed, strict=True):
        materials = _own_materials(specification, chosen, slot)
        if materials:
            drawn(materials, lambda place, own=slot: own)  # type: ignore[misc]
            table["materials"] = {**table.get("materials", {}), **materials}
    table["name"] = f"{specification.name}-{key(sample)}"
    if specification.modules:
        table["modules"] = list(specification.modules)
    pictures = tuple(one for patterns in specification.patterns for one in patterns.files or ())
    return Draw(name, values, table, pictures, wanted, resting)


def _count(limits: tuple[int, int], seed: int, sample: int, name: str) -> int:
    """Draw how many objects a sample has."""
    if limits[0] == limits[1]:
        return limits[0]
    return int(Distribution(integers=limits).draw(stream(seed, sample, 0, name)))


def _chosen(
    specification: Specification, among: str, seed: int, sample: int, slot: str, kind: int | None
) -> tuple[dict[str, Any], str]:
    """Return the table of the object of a slot, its values not yet drawn, and what it is called."""
    tables = specification.drawn_from(among)
    if kind is None:
        weights = tuple(float(table["weight"]) for table in tables)
        choice = Distribution(choice=tuple(range(len(tables))), weights=weights)
        # Once a sample: what is rejected must not change how often a kind comes.  No column has
        # this stream, its name is no word.
        kind = int(choice.draw(stream(seed, sample, 0, f"[objects]{slot}")))
    chosen = plain(tables[kind])
    name = chosen.pop("name")
    del chosen["weight"]
    if among == "distractors":
        chosen["distractor"] = True
    return chosen, name


def _own_materials(
    specification: Specification, chosen: dict[str, Any], slot: str
) -> dict[str, Any]:
    """Return the specification's materials that an object takes, and name them after its slot."""
    known, found = specification.materials or {}, {}

    def taken(name: Any) -> Any:
        if name not in known:
            return name
        own = f"{name}{slot or '_0'}"
        found[own] = plain(known[name])
        return own

    if "material" in chosen:
        chosen["material"] = taken(chosen["material"])
    if isinstance(chosen.get("materials"), dict):
        chosen["materials"] = {part: taken(name) for part, name in chosen["materials"].items()}
    return found


def _coarsen(table: dict[str, Any], width: int, settings: Mapping[str, Any]) -> int:
    """Give a valid scene fewer, larger pixels and fewer samples, as ``Scene.coarser`` does.

    Returns the divisor; a camera that stands in the rig's file is left as it is.
    """
    samples = settings.get("samples", _PREVIEW_SAMPLES)
    table["render"] = {**table.get("render", {}), "samples": samples}
    divisor = int(settings.get("divisor") or max(1, -(-width // _PREVIEW_WIDTH)))
    if "vibration_px" in table.get("exposure", {}):
        shaken = table["exposure"]["vibration_px"] / divisor
        table["exposure"] = {**table["exposure"], "vibration_px": shaken}
    camera = table.get("camera")
    if camera is None:
        return divisor
    width, height = camera["resolution_px"]
    pitches = validated(CameraOptics, camera, "camera").pitches_um
    camera.pop("sensor_format", None)
    camera["resolution_px"] = [max(width // divisor, 1), max(height // divisor, 1)]
    camera["pitch_um"] = [p * divisor for p in pitches]
    u, v = camera.get("principal_point_px", [(width - 1) / 2, (height - 1) / 2])
    camera["principal_point_px"] = [(u + 0.5) / divisor - 0.5, (v + 0.5) / divisor - 0.5]
    camera["blur_px"] = camera.get("blur_px", 0.0) / divisor
    camera["fill_factor"] = camera.get("fill_factor", 1.0) / divisor**2
    own = table.get("calibration", {}).get("std", {}).get("camera", {})
    for name in own:
        if name.endswith("_px"):  # of the pixels that are left
            own[name] /= divisor
    return divisor


def place_scene(drawn: Draw, files: Mapping[str, bytes], folder: Path, preview: bool) -> Scene:
    """Write a draw's scene to a folder, with the files that it names, and load it.

    Its modules are run: the person who loaded the specification allowed them.

    Parameters
    ----------
    drawn : Draw
    files : mapping of str to bytes
        Of the specification.
    folder : Path
        Empty; gets ``scene.toml``, ``rig.yaml``, the meshes that the scene names and the pictures
        that the patterns show.
    preview : bool
        Fewer camera pixels and Monte Carlo samples.

    Raises
    ------
    InputError
        If what was drawn makes no scene; it names files as they are called in `folder`.
    """
    try:
        return _placed(drawn, files, folder, preview)
    except InputError as error:
        # Where the folder stands is nothing to the user, and another one each time.
        said = (error.where, error.expected, str(error.got))
        raise InputError(*(text.replace(f"{folder}/", "") for text in said)) from None


def _placed(drawn: Draw, files: Mapping[str, bytes], folder: Path, preview: bool) -> Scene:
    wanted = {name for table in drawn.table["objects"] for name in file_names(table)}
    wanted.update(picture_names(drawn.table.get("materials", {})))
    wanted.update(map_names(drawn.table.get("environment", {})))
    from_file = "file" in drawn.table["rig"]
    modules = drawn.table.get("modules", ())
    for name in (*sorted(wanted), *drawn.pictures, *modules, *([RIG] if from_file else [])):
        (folder / name).write_bytes(files[name])
    table, divisor = plain(drawn.table), 1
    if drawn.resting is not None:
        _rest(drawn.resting, table, folder)
    if preview:
        # All but the objects, which cost most, is checked before it is reckoned with.
        write_toml(folder / SCENE, table)
        width = load_settings(folder / SCENE, allow_modules=True).rig.camera.width
        divisor = _coarsen(table, width, table.get("preview", {}))
    table.pop("preview", None)
    write_toml(folder / SCENE, table)
    scene = load_scene(folder / SCENE, allow_modules=True)
    if from_file and preview:
        # The table's vibration is in the coarse pixels already.
        scene = replace(scene.coarser(divisor, scene.samples), exposure=scene.exposure)
    write_rig(folder / RIG, scene.rig)
    return scene


def _rest(resting: Resting, table: dict[str, Any], folder: Path) -> None:
    """Put the poses in which the drawn objects come to rest into a scene's tables."""
    write_toml(folder / SCENE, table)
    # All but the objects, which may be a module's.
    rig = load_settings(folder / SCENE, allow_modules=True).rig
    if not rig.faces_origin:
        expected = "a rig that looks at the world's origin, for objects on a table"
        raise InputError("clutter", expected, "one that does not")
    built = objects_of(table, folder / SCENE)[: resting.count]
    width, height, _ = rig.volume_mm
    poses = resting.poses([item.artefact for item in built], (width, height))
    for item, pose in zip(table["objects"], poses, strict=False):
        item |= pose


def outside_volume(scene: Scene, wanted: int = 1) -> bool:
    """Return whether one of the first objects sticks out of the measurement volume."""
    half = 0.5 * np.array(scene.rig.volume_mm)
    for item in scene.objects[:wanted]:
        placed = scene.place.to_local(item.pose.to_world(item.artefact.mesh.vertices))
        if np.any(np.abs(placed) > half):
            return True
    return False


def check(
    specification: Specification, files: Mapping[str, bytes], seed: int, preview: bool, folder: Path
) -> None:
    """Check that every object can be drawn and its scene built, without rendering.

    Parameters
    ----------
    specification, files
        As :func:`slbench.datasets.spec.specification.load` gives them.
    seed : int
    preview : bool
    folder : Path
        To work in; subfolders are made.

    Raises
    ------
    InputError
        If no draw makes a scene that a sample can have, saying what is wrong with the last.
    """
    kinds: list[tuple[str, int | None]] = [
        (which, k)
        for which in ("objects", "distractors")
        for k in range(len(specification.drawn_from(which)))
    ]
    if specification.clutter is not None or not kinds:
        kinds.append(("objects", None))
    # As many as several samples have: that few draws fail says little of the others'.
    draws = max(specification.constraints.max_draws, _TRIED)
    for which, kind in kinds:
        problems: list[str | InputError] = []
        for number in range(draws):
            drawn = draw(specification, seed, 0, number, kind=kind, which=which)
            place = folder / f"{which}-{kind}-{number}"
            place.mkdir()
            problem = _problem(specification, drawn, files, place, preview)
            if problem is None:
                break
            problems.append(problem)
            # What depends on the draw says so; what does not will not come right.
            if isinstance(problem, InputError) and (
                list(map(str, problems[-_SAME:])) == [str(problem)] * _SAME
            ):
                where = _as_called(_place(problem.where, which, kind), files)
                got = _as_called(str(problem.got), files)
                raise InputError(f"{specification.name}: {where}", problem.expected, got)
        if problem is not None:
            what = "scene" if kind is None else f"{which}[{kind}] ({drawn.kind})"
            expected = f"a draw of {len(problems)} that makes a sample"
            got = f"none: {_as_called(str(problem), files)}"
            raise InputError(f"{specification.name}: {what}", expected, got)


def _place(where: str, which: str, kind: int | None) -> str:
    """Return where the specification says what stands at a place of a drawn scene."""
    place = where.removeprefix(SCENE).removeprefix(": ")
    first = "objects[0]"  # the drawn object
    if kind is not None and place.startswith(first):
        return f"{which}[{kind}]{place.removeprefix(first)}"
    if place == "clutter":
        return place
    return f"scene: {place}" if place else "scene"


def _as_called(text: str, files: Mapping[str, bytes]) -> str:
    """Return a message with the names of files as the user wrote them."""
    for name in files:
        text = text.replace(name, name.removeprefix("mesh."))
    return text


def _problem(
    specification: Specification,
    drawn: Draw,
    files: Mapping[str, bytes],
    folder: Path,
    preview: bool,
) -> str | InputError | None:
    """Return why a draw cannot make a sample, None if it may."""
    try:
        scene = place_scene(drawn, files, folder, preview)
        for patterns in specification.patterns:
            check_frame_errors(patterns.of(scene, folder))
    except InputError as error:
        return error
    if scene.moves:
        expected = "nothing that moves (a sample has one light transport)"
        raise InputError(f"scene {scene.name}", expected, "a velocity or rotation")
    if specification.constraints.inside_volume and outside_volume(scene, drawn.wanted):
        return _OUTSIDE
    return None
