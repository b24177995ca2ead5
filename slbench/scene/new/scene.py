"""The text of a new scene file, each number with where it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slbench import objects
from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.objects.artefact import Artefact
from slbench.scene.devices.optics import CameraOptics, ProjectorOptics
from slbench.scene.model import USUAL_PATTERNS
from slbench.scene.new.devices import Lenses, camera_table, projector_table
from slbench.scene.new.entries import Entry, written
from slbench.scene.new.hardware import HardwareFile
from slbench.scene.new.place import Place

_MATERIAL, _STAGE = "matt-white-spray", "dark-stage"
#: The stage, in fields of the camera, and its largest side.
_STAGE_FIELDS, _LARGEST_STAGE_MM = 1.5, 1e4


@dataclass(frozen=True)
class Item:
    """What is measured.

    Parameters
    ----------
    name : str
        Of a shipped artefact, or a file in the scene's folder: an artefact's, or a mesh.
    unit : str or None
        Of a mesh; None is mm.
    """

    name: str
    unit: str | None = None

    def load(self, folder: Path) -> tuple[Artefact, list[Entry]]:
        """Return the artefact, and the lines that name it in a scene of a folder.

        Raises
        ------
        InputError
            If there is none, or its file stands elsewhere.
        """
        path, known = Path(self.name), resources.names("objects")
        is_mesh = self.name not in known and path.suffix.lower() != ".toml"
        if self.unit is not None and not is_mesh:
            raise InputError("--unit", "a mesh file as --object", self.name)
        if self.name in known:
            return objects.load_artefact(self.name), [Entry("artefact", self.name, "--object")]
        if not path.is_file():
            raise InputError("--object", "a file, or an artefact", quoted(self.name, known))
        if path.resolve().parent != folder.resolve():
            expected = f"an artefact's name, or a file in the folder of the scene, {folder}"
            raise InputError("--object", expected, self.name)
        if not is_mesh:
            return objects.load_artefact(path), [Entry("artefact", path.name, "--object")]
        unit = self.unit or "mm"
        parameters = {"path": path.name, "unit": unit, "centre": True}
        made = objects.build_artefact("mesh", parameters, "--object", name=path.stem, folder=folder)
        return made, [
            Entry("mesh", path.name, "--object"),
            Entry("unit", unit, "--unit" if self.unit else "assumed: --unit states it"),
            Entry("centre", True, "its place does not depend on the file's origin"),
        ]


def new_scene(
    camera: HardwareFile,
    projector: HardwareFile,
    lenses: Lenses,
    place: Place,
    item: Item,
    path: Path,
    made_by: str,
) -> str:
    """Return the text of a new scene file.

    Parameters
    ----------
    camera, projector : HardwareFile
    lenses : Lenses
    place : Place
    item : Item
    path : Path
        Where it is to stand.
    made_by : str
        What makes it, for its first line.

    Raises
    ------
    InputError
        For what cannot be, naming the option.
    """
    artefact, shape = item.load(path.parent)
    x, z = place.projector()
    eye, eye_optics = camera_table(camera, lenses, place.focus_mm)
    beam, beam_optics = projector_table(projector, lenses, math.hypot(x, z))
    bounds = artefact.mesh.bounds
    box = np.maximum(np.ceil(bounds[1] - bounds[0]), 1.0)
    tables = {
        "[camera]": eye,
        "[projector]": beam,
        "[rig]": [
            *_rig(place, beam_optics),
            Entry("volume_mm", box, "derived: the box of the object, rounded up"),
        ],
        "[patterns]": [
            Entry("sequence", USUAL_PATTERNS, "assumed: fringe counts across the panel"),
            Entry("shifts", 4, "assumed: of each"),
        ],
        "[[objects]]": [
            *shape,
            Entry("position_mm", -bounds.mean(axis=0), "derived: its middle is in the origin"),
            # A mesh file that states colours keeps them.
            *([] if artefact.surfaces else [Entry("material", _MATERIAL, "assumed")]),
        ],
    }
    used = {one.name: one for one in (camera, projector)}
    lines = [
        f"# Written by {made_by}",
        "# What is not here of camera, detector and projector, and the sources of that:",
        *(line for one in used.values() for line in _sources(one)),
        f"extends = {written(list(used))}",
        f"name = {written(_plain_name(path))}",
    ]
    for heading, entries in tables.items():
        lines += ["", heading, *map(str, entries)]
    if artefact.kind != "plane":
        height = float(bounds[1, 2] - bounds[0, 2])
        lines += ["", "[[objects]]", *map(str, _stage(eye_optics, place.focus_mm, height))]
    return "\n".join(lines) + "\n"


def _sources(file: HardwareFile) -> list[str]:
    """Return the lines of a hardware file, with what it says is not confirmed."""
    lines = [f"#   {file.name}: {file.title}"]
    if file.unconfirmed:
        lines.append(f"#   not confirmed in {file.name}: {', '.join(file.unconfirmed)}")
    return lines


def _rig(place: Place, optics: ProjectorOptics) -> list[Entry]:
    """Return where both stand: the picture's middle is on the origin, as the camera's is."""
    x, z = place.projector()
    why, lower = place.words(), _lower(optics, math.hypot(x, z))
    if lower:
        side = "below" if lower > 0 else "above"
        why += f"; {abs(lower):.5g} mm {side} its picture's middle, by its offset"
    beam = {"position_mm": [x, -lower, z]}
    if lower:
        beam["target_mm"] = [0.0, -lower, 0.0]
    return [
        Entry("camera", {"position_mm": [0.0, 0.0, place.focus_mm]}, "--focus-mm above the origin"),
        Entry("projector", beam, why),
    ]


def _lower(optics: ProjectorOptics, distance_mm: float) -> float:
    """Return how far a projector's axis is below the middle of its picture, mm."""
    if optics.axis_px is None:
        return 0.0
    device = optics.arguments(distance_mm)
    rows = optics.axis_px[1] - (optics.resolution_px[1] - 1) / 2.0
    return float(rows * device["pitch_mm"][1] * distance_mm / device["lens"].focal_length_mm)


def _stage(optics: CameraOptics, distance_mm: float, height_mm: float) -> list[Entry]:
    """Return a dark plate under an object, larger than the camera's field."""
    c = optics.arguments(distance_mm)["lens"].focal_length_mm
    panel = 1e-3 * np.multiply(optics.resolution_px, optics.pitches_um)
    size = np.minimum(np.ceil(_STAGE_FIELDS * panel * distance_mm / c), _LARGEST_STAGE_MM)
    return [
        Entry("kind", "plane", "the stage"),
        Entry("parameters", {"size_mm": size}, "derived: more than the camera sees"),
        Entry("position_mm", [0.0, 0.0, -height_mm / 2], "derived: under the object"),
        Entry("material", _STAGE, "assumed"),
    ]


def _plain_name(path: Path) -> str:
    """Return a scene's name by that of its file."""
    name = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in path.stem)
    return name[:100] if name[:1].isalnum() else f"scene{name}"[:100]
