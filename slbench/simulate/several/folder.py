"""What a scan of several cameras and projectors leaves in its folder."""

from __future__ import annotations

from pathlib import Path

from slbench.capture.capture import MANIFEST
from slbench.capture.captures import RIG, folder_names, pair_name
from slbench.cloud.decoded import grey_image
from slbench.core.errors import warn_user
from slbench.core.io import OutputFolder, write_json, write_ply
from slbench.core.show.drawing import write_figure
from slbench.scene.model import Scene
from slbench.score.joint import joint_errors
from slbench.simulate.folder import replaced_doubt, run_parameters, write_scan_into
from slbench.simulate.several.scan import RigScan


def _folder(scene: Scene) -> OutputFolder:
    """Return what such a scan writes: of each pair a folder, and of all of them together."""
    names = folder_names(scene.rig.pairs).values()
    return OutputFolder("scan", (MANIFEST, RIG, *names, "cloud.ply", "score.json", "summary.png"))


def check_rig_folder(scene: Scene, folder: str | Path, where: object | None = None) -> None:
    """Check that a scan of a scene's devices may be written to a folder, before it is made.

    Raises
    ------
    InputError
        If what slbench did not write is in the way.

    Warns
    -----
    InputWarning
        If the folder holds a scan of another scene, which will be replaced.
    """
    _folder(scene).check(folder, where)
    if doubt := replaced_doubt(scene, folder):
        warn_user(folder, doubt, stacklevel=3)


def write_rig_scan(result: RigScan, folder: str | Path, *, picture: bool = True) -> None:
    """Write the files of a scan; nothing appears in `folder` until all are complete.

    A folder of each pair, such as ``left-projector``, is as
    :func:`slbench.simulate.folder.write_scan` writes it.  Beside them stand ``capture.toml``, of
    all pairs, with ``rig.yaml``; the joint ``cloud.ply`` (with ``rays``, ``residual``, ``camera``
    and ``error``), ``score.json``, ``summary.png`` and ``provenance.json``.

    Parameters
    ----------
    result : RigScan
    folder : path
    picture : bool
        False leaves out all ``summary.png``.

    Warns
    -----
    InputWarning
        As :func:`check_rig_folder`.
    """
    if doubt := replaced_doubt(result.scene, folder):
        warn_user(folder, doubt)
    kind, run = _folder(result.scene), result.run
    provenance = run_parameters(result.scene, run), run.seed
    with kind.writing(folder, *provenance, timings=run.seconds) as root:
        result.captures().write_into(root)
        for pair, one in result.scans.items():
            write_scan_into(one, root / pair_name(pair), picture=picture)
        cloud = result.cloud
        if len(cloud):
            grey = {
                camera: next(
                    grey_image(one.capture, one.phase)
                    for pair, one in result.scans.items()
                    if pair.camera == camera
                )
                for camera in cloud.shapes
            }
            error = joint_errors(cloud, result.truth)[:, 2]
            write_ply(root / "cloud.ply", cloud.points, cloud.fields(grey) | {"error": error})
        write_json(root / "score.json", result.to_dict())
        if picture:
            write_figure(result, root / "summary.png")
