"""Score any cloud: read it and what it is held against, and write what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from slbench.cloud.files.measured import MeasuredCloud
from slbench.cloud.files.panel import read_panel
from slbench.cloud.files.read import READERS, cloud_file, read_cloud
from slbench.core.errors import InputError
from slbench.core.io import OutputFolder, write_json, write_ply
from slbench.core.show.drawing import write_figure
from slbench.core.units import Unit
from slbench.core.validation.types import Positive
from slbench.core.validation.values import checked
from slbench.objects import Artefact, build_artefact, load_artefact
from slbench.rig import Pose
from slbench.score.clouds.against_part import score_against_part
from slbench.score.clouds.against_truth import ScannedTruth, score_against_truth, score_panel
from slbench.score.clouds.cloudscore import CloudScore

CLOUD_SCORE_FOLDER = OutputFolder("scored cloud", ("score.json", "score.png", "deviations.ply"))
_PANEL = "phase.exr"


@checked
def score_cloud(
    measured: str | Path | MeasuredCloud,
    *,
    truth: str | Path | None = None,
    artefact: str | Path | Artefact | None = None,
    mesh: str | Path | None = None,
    unit: Unit | None = None,
    mesh_unit: Unit = "mm",
    placed: bool = False,
    align: bool = False,
    start: Pose | None = None,
    expected_um: Positive | None = None,
) -> CloudScore:
    """Score a cloud of any scanner and decoder against exactly one reference.

    Parameters
    ----------
    measured : path or MeasuredCloud
        A cloud as :func:`slbench.read_cloud` reads it, a folder with one, or with `truth` a panel
        map (:func:`slbench.cloud.files.panel.read_panel`).
    truth : path, optional
        Folder of a scan, whose truth the cloud is compared with pixel by pixel.
    artefact : path, str or Artefact, optional
        A shipped artefact, or a TOML of one, aligned by its surface; features are certified.
    mesh : path, optional
        A mesh file, aligned by registration.
    unit : {"um", "mm", "cm", "inch", "m"}, optional
        Of the lengths of a cloud's file; see :func:`slbench.read_cloud`.
    mesh_unit : {"um", "mm", "cm", "inch", "m"}
        Of the mesh file.
    placed : bool
        Whether artefact or mesh stand in the cloud's frame already.
    align : bool
        With `truth`: whether the cloud is moved to it first, from any frame.
    start : Pose, optional
        About where the reference is in the cloud's frame; looked for by default.
    expected_um : float, optional
        Expected deviation of a point, instead of what the cloud says.

    Returns
    -------
    CloudScore

    Raises
    ------
    InputError
        For no reference or several, options that say nothing here, files that cannot be used, and
        a cloud of another part: one of which fewer than 70 % of the points lie within three
        expected deviations
        (:mod:`slbench.score.clouds.expected`).

    Warns
    -----
    InputWarning
        If the cloud is far larger or smaller than its reference, naming the likely unit.
    """
    given = {"truth": truth, "artefact": artefact, "mesh": mesh}
    named = [name for name, value in given.items() if value is not None]
    if len(named) != 1:
        raise InputError(
            "reference", "one of truth, artefact and mesh", " and ".join(named) or "none"
        )
    if truth is not None and placed:
        raise InputError("placed", "none with truth, in whose frame a cloud is", placed)
    if truth is None and align:
        raise InputError("align", "none with artefact or mesh, to which clouds are aligned", align)
    if start is not None and (placed or (truth is not None and not align)):
        raise InputError("start", "none where nothing is aligned", start)
    if mesh is None and mesh_unit != "mm":
        raise InputError("mesh_unit", "none without a mesh file, whose unit it is", mesh_unit)
    if unit is not None and isinstance(measured, MeasuredCloud):
        raise InputError("unit", "none with a cloud that was read, which is in mm", unit)
    parameters = {
        "measured": str(measured.source if isinstance(measured, MeasuredCloud) else measured),
        **{name: str(getattr(given[name], "name", given[name])) for name in named},
        **{"unit": unit, "mesh_unit": mesh_unit if mesh is not None else None},
        **{"placed": placed, "align": align, "expected_um": expected_um},
    }
    if truth is not None:
        found = _against_truth(measured, truth, unit, align, start, expected_um)
    else:
        part = _part(artefact, mesh, mesh_unit)
        cloud = measured if isinstance(measured, MeasuredCloud) else read_cloud(measured, unit)
        found = score_against_part(cloud, part, placed=placed, start=start, expected_um=expected_um)
    return replace(found, parameters=parameters)


def _part(artefact: str | Path | Artefact | None, mesh: str | Path | None, unit: Unit) -> Artefact:
    if isinstance(artefact, Artefact):
        return artefact
    if artefact is not None:
        return load_artefact(artefact)
    assert mesh is not None  # one of both is given
    table = {"path": str(mesh), "unit": unit}
    return build_artefact("mesh", table, str(mesh), name=Path(mesh).name)


def _against_truth(
    measured: str | Path | MeasuredCloud,
    folder: str | Path,
    unit: Unit | None,
    align: bool,
    start: Pose | None,
    expected_um: float | None,
) -> CloudScore:
    against = ScannedTruth.read(folder)
    if not isinstance(measured, MeasuredCloud):
        path = Path(measured)
        if path.is_dir() and (path / _PANEL).is_file() and not (path / "cloud.ply").is_file():
            path = path / _PANEL
        source = cloud_file(path) if path.suffix.lower() in READERS or path.is_dir() else path
        panel = read_panel(source, against.truth.status.shape) if source.is_file() else None
        if panel is not None:
            for name, value in {"unit": unit, "align": align or None}.items():
                if value is not None:
                    raise InputError(name, "none with a panel map, which has pixels", value)
            return score_panel(*panel, against, str(source), expected_um)
        measured = read_cloud(path, unit)
    return score_against_truth(measured, against, align=align, start=start, expected_um=expected_um)


def write_cloud_score(
    result: CloudScore,
    folder: str | Path,
    *,
    picture: bool = True,
    files: Mapping[str, Callable[[Path], None]] | None = None,
) -> None:
    """Write a cloud's score; nothing appears until all is complete.

    Parameters
    ----------
    result : CloudScore
    folder : path
        For ``score.json``, ``deviations.ply`` (in the reference's frame, with ``deviation``, mm),
        ``score.png`` and ``provenance.json``.
    picture : bool
        False leaves out ``score.png``.
    files : mapping of str to callable, optional
        What else is to stand there, and what writes it.
    """
    made = dict(files or {})
    if picture:
        made["score.png"] = partial(write_figure, result)
    with CLOUD_SCORE_FOLDER.writing(folder, dict(result.parameters), None) as temporary:
        write_json(temporary / "score.json", result.to_dict())
        fields = {"deviation": np.asarray(result.deviation_mm)}
        write_ply(temporary / "deviations.ply", result.points, fields)
        for name, write in made.items():
            write(temporary / name)
