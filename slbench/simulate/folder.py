"""What a scan leaves in its folder."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from slbench.capture.capture import CAPTURE_ENTRIES
from slbench.cloud.decoded import grey_image
from slbench.cloud.files.write import point_fields
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import warn_user
from slbench.core.io import OutputFolder, write_json, write_ply, write_png
from slbench.core.show.drawing import write_figure
from slbench.objects import Mesh
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.points import point_errors
from slbench.simulate.scan import Run, Scan
from slbench.simulate.sharp import all_in_focus

SCAN_FOLDER = OutputFolder(
    "scan",
    (
        *CAPTURE_ENTRIES,
        "stack",
        "all-in-focus",
        "truth.exr",
        "instances.png",
        "transport.npz",
        "cloud.ply",
        "score.json",
        "summary.png",
    ),
)


def check_scan_folder(scene: Scene, folder: str | Path, where: object | None = None) -> None:
    """Check that a scan may be written to a folder, before the work that makes it.

    Raises
    ------
    InputError
        As :meth:`OutputFolder.check`.

    Warns
    -----
    InputWarning
        If the folder holds a scan of another scene, which will be replaced.
    """
    SCAN_FOLDER.check(folder, where)
    if doubt := replaced_doubt(scene, folder):
        warn_user(folder, doubt, stacklevel=3)


def replaced_doubt(scene: Scene, folder: str | Path) -> str | None:
    """Question the writing of a scan to a folder that holds one of another scene."""
    held = SCAN_FOLDER.parameters(folder).get("scene")
    name = held.get("name") if isinstance(held, dict) else None
    if not isinstance(name, str) or name == scene.name:
        return None
    return f"its scan of {name} is replaced by one of {scene.name}"


def write_scan(result: Scan, folder: str | Path, *, picture: bool = True) -> list[Path]:
    """Write a scan's files; nothing appears in `folder` until all are complete.

    Parameters
    ----------
    result : Scan
    folder : path
    picture : bool
        False leaves out ``summary.png``.

    Returns
    -------
    list of Path
        Frames and manifest (``capture.toml``, ``frames/``, ``rig.yaml``), ``truth.exr``,
        ``instances.png`` (16 bit, 0 where no object is, k + 1 for object k), ``transport.npz``,
        ``cloud.ply`` (where there are points), ``score.json`` (what the
        scan says of itself; without scores the number of points),
        ``summary.png``, ``provenance.json``; with focus settings also ``stack/``
        and ``all-in-focus/``, the expected frames through pinholes.

    Warns
    -----
    InputWarning
        As :func:`check_scan_folder`.
    """
    if doubt := replaced_doubt(result.scene, folder):
        warn_user(folder, doubt)
    provenance = scan_parameters(result), result.run.seed
    with SCAN_FOLDER.writing(folder, *provenance, timings=result.run.seconds) as temporary:
        write_scan_into(result, temporary, picture=picture)
        names = [entry.name for entry in temporary.iterdir()]
    return [Path(folder) / name for name in sorted([*names, SCAN_FOLDER.provenance])]


def write_scan_into(result: Scan, root: Path, *, picture: bool = True) -> None:
    """Write a scan's files as part of a folder that is being made; see :func:`write_scan`."""
    result.capture.write_into(root)
    scene = result.scene
    if scene.focus is not None:
        result.stack.write_into(root / "stack")
        light = result.transport, scene.detector, scene.exposure
        all_in_focus(result.stack, *light).write_into(root / "all-in-focus")
    result.truth.save(root / "truth.exr")
    write_png(root / "instances.png", result.truth.instances)
    result.transport.save(root / "transport.npz")
    if len(result.cloud):
        grey = grey_image(result.capture, result.phase)
        _write_points(root / "cloud.ply", result.cloud, result.truth, grey)
    write_json(root / "score.json", result.to_dict())
    if picture:
        write_figure(result, root / "summary.png")


def scan_parameters(result: Scan) -> dict[str, Any]:
    """Return what a scan depends on beside its seed, for its provenance."""
    return run_parameters(result.scene, result.run)


def run_parameters(scene: Scene, run: Run) -> dict[str, Any]:
    """Return what a run depends on beside its seed: the scene with the samples that were used."""
    return {
        "scene": scene.specification,
        "patterns": scene.sequence.to_dict(),
        "samples": scene.samples,
        "noise": run.noise,
        "variant": run.variant,
        "objects": [
            {"name": item.artefact.name, "sha256": _digest(item.artefact.mesh)}
            for item in scene.objects
        ],
    }


def _digest(mesh: Mesh) -> str:
    """Return a hash of a mesh, which tells whether two scans saw the same object."""
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()


def _write_points(
    path: str | Path,
    cloud: PointCloud,
    truth: GroundTruth | None = None,
    grey: NDArray[Any] | None = None,
) -> None:
    """Write a cloud as binary PLY with ``sigma``, ``u`` and, given truth, ``error`` (all mm).

    ``error`` is the signed height error, NaN where truth has no lit point.  Normals go with them,
    and grey values where an image (V, U) of them is given.
    """
    fields = point_fields(cloud, grey)
    if truth is not None:
        fields["error"] = point_errors(cloud, truth)[:, 2]
    write_ply(path, cloud.points, fields)
