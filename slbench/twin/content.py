"""The scene file of a twin."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.io import write_toml
from slbench.core.show.display import brief
from slbench.objects import Artefact, build_artefact, load_artefact
from slbench.objects.mesh.file import SUFFIXES
from slbench.patterns import Fringes
from slbench.rig import Pose
from slbench.rig.opencv import write_rig
from slbench.twin.placing import Place

#: Irradiance of the surroundings that ambient light is fitted with.
AMBIENT_W_PER_M2 = 1.0


@dataclass(frozen=True, kw_only=True)
class TwinObject:
    """An object of the twin and about where it is.

    Parameters
    ----------
    shape : str
        ``"plane"``, as large as what is seen of it; the name of a shipped artefact; or a mesh
        file.
    unit : str or None
        Of a mesh file.
    material : str
        A preset's name.
    start : Pose or None
        Looked for by default.
    """

    shape: str
    unit: str | None = None
    material: str = "matt-white-spray"
    start: Pose | None = None

    __repr__ = brief

    def artefact(self) -> Artefact:
        """Return its artefact; a plane of any size.

        Raises
        ------
        InputError
            For no artefact, or a mesh file without a unit.
        """
        if self.shape == "plane":
            return build_artefact("plane", {"size_mm": [1e3, 1e3]}, "plane")
        if Path(self.shape).suffix.lower() in SUFFIXES:
            if self.unit is None:
                raise InputError(self.shape, "the unit of the mesh file, such as mm", "none")
            given = {"path": self.shape, "unit": self.unit}
            return build_artefact("mesh", given, self.shape, name=Path(self.shape).stem)
        return load_artefact(self.shape)


def twin_content(
    name: str,
    capture: Capture,
    objects: Sequence[TwinObject],
    places: Sequence[Place],
    given: Mapping[str, dict[str, Any]],
    bounces: int | None,
    samples: int,
) -> tuple[dict[str, Any], dict[str, Path]]:
    """Return a scene's content, but for its light, and the mesh files that it names."""
    from scipy.spatial.transform import Rotation

    files: dict[str, Path] = {}
    rows = []
    for one, placed in zip(objects, places, strict=True):
        shape: dict[str, Any] = {"artefact": one.shape}
        if one.shape == "plane":
            shape = {"kind": "plane", "parameters": {"size_mm": _plane_size(placed)}}
        elif Path(one.shape).suffix.lower() in SUFFIXES:
            files[Path(one.shape).name] = Path(one.shape)
            shape = {"mesh": Path(one.shape).name, "unit": one.unit}
        turn = Rotation.from_matrix(placed.pose.rotation).as_euler("XYZ", degrees=True)
        where = {"position_mm": placed.pose.position.tolist(), "rotation_deg": turn.tolist()}
        rows.append(shape | where | {"material": one.material})
    alone = all(one.shape == "plane" for one in objects) and len(objects) == 1
    light = {
        "ambient_w_per_m2": AMBIENT_W_PER_M2,
        "bounces": (0 if alone else 2) if bounces is None else bounces,
    }
    tables = {key: dict(given[key]) for key in ("camera", "projector", "detector", "exposure")}
    tables["camera"]["shading"] = []  # fitted, as is the blur where fringes tell it
    if has_fringes(capture):
        tables["projector"]["blur_px"] = 0.0
    return {
        "name": name,
        "description": "Twin of a scanner, by what it photographed",
        "rig": {"file": "rig.yaml"},
        **tables,
        "light": light,
        "objects": rows,
        "patterns": {"parts": capture.sequence.to_dict()["parts"]},
        "render": {"samples": samples},
    }, files


def _plane_size(placed: Place) -> list[float]:
    """Return the size of a plate that reaches as far as the points on it."""
    on_it = np.isfinite(placed.residual_mm)
    local = placed.pose.to_local(placed.truth.point[on_it])
    reach = np.abs(local[:, :2]).max(axis=0)
    return (2.0 * reach).tolist()


def write_scene(
    folder: Path, content: Mapping[str, Any], capture: Capture, files: Mapping[str, Path]
) -> None:
    """Write a twin's scene, its rig and its meshes."""
    assert capture.rig is not None
    write_rig(folder / "rig.yaml", capture.rig, capture.rig_covariance)
    for name, path in files.items():
        shutil.copyfile(path, folder / name)
    write_toml(folder / "twin.toml", content)


def has_fringes(capture: Capture) -> bool:
    """Tell whether a capture has fringes, whose contrast tells the projector's blur."""
    return any(isinstance(part, Fringes) for part in capture.sequence.parts)
