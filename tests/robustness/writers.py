"""Every command that writes, with two runs each whose results differ: rows for the kill driver.

A new command that writes is killed by adding a row.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from calibration_data import rig_points
from datasets_small import write_dataset
from focus_stacks import slanted_plane
from scenes_small import run_cli, write_scene
from stage_views import stage_views

from slbench.core.io import write_ply, write_png, write_table

HARDWARE = "hardware/macro-ch6"


@dataclass(frozen=True)
class Writer:
    """A command and what it writes.

    Parameters
    ----------
    words : callable
        ``words(inputs, out)`` gives the command's words but for `old` and `new`.
    old, new : tuple of str
        Words of the two runs; None where nothing may be there before.
    needs : tuple of callable
        What makes the inputs.
    out : str
        What is given as ``out``: a folder, or a file that others may stand beside.
    dear : bool
        Whether a run takes more than some seconds of processor time.
    """

    words: Callable[[Path, Path], list[object]]
    old: tuple[str, ...] | None
    new: tuple[str, ...]
    out: str = "out"
    needs: tuple[Callable[[Path], None], ...] = ()
    dear: bool = False


def _scene(root: Path) -> None:
    write_scene(root)


def _scan(root: Path) -> None:
    need(root, _scene)
    words = "scan", root / "small.toml", "--out", root / "scan", "--no-picture"
    assert run_cli(*words).status == 0


def _stack(root: Path) -> None:
    (root / "deep").mkdir()
    write_scene(root / "deep", focus={"settings": 2}, patterns={"sequence": "1,8"})
    words = "scan", root / "deep" / "small.toml", "--out", root / "deep-scan", "--no-picture"
    assert run_cli(*words).status == 0


def _photographs(root: Path) -> None:
    (root / "photographs").mkdir()
    for k, frame in enumerate(slanted_plane(5, (48, 64)).stack()):
        pixels = np.clip(np.rint(255 * frame), 0, 255).astype(np.uint8)
        write_png(root / "photographs" / f"{k}.png", pixels)


def _views(root: Path) -> None:
    views = stage_views("rough", 3, seed=7, count=4000)
    (root / "views").mkdir()
    for k, cloud in enumerate(views.clouds):
        write_ply(root / "views" / f"{k}.ply", cloud, {})
    write_table(root / "stage.csv", ("x_mm", "y_mm", "z_mm"), views.positions)


def _points(root: Path) -> None:
    rig_points(60, 0.02).write(root / "points.csv")


def _model(root: Path) -> None:
    need(root, _points)
    assert run_cli("calibrate", "fit", root / "points.csv", "--out", root / "m.json").status == 0


def _claims(root: Path) -> None:
    need(root, _scene)
    claim = '[[claim]]\nname = "a"\nscene = "small.toml"\nquantity = "smooth_rms_px.u"\n'
    claims = root / "some.claims.toml"
    claims.write_text(claim + "repeats = 2\nmax = 0.5\n", encoding="utf-8")


def _dataset(root: Path) -> None:
    write_dataset(root / "set")


def need(root: Path, *makers: Callable[[Path], None]) -> None:
    """Make inputs that are not there yet."""
    for make in makers:
        done = root / f".{make.__name__}"
        if not done.exists():
            make(root)
            done.touch()


SEEDS = ("--seed", "1"), ("--seed", "2")
PAIR = ("--set", "1,8", "--set", "1,4")
FEW = ("--heights", "2", "--max-fringes", "8")
NEW = (
    *("--camera", "basler-aca1920-40um", "--projector", "ti-lightcrafter", "--focus-mm", "300"),
    *("--baseline-mm", "110", "--object", "plane", "--overwrite"),
)

WRITERS = {
    "scan": Writer(
        lambda i, o: ["scan", i / "small.toml", "--out", o],
        *SEEDS,
        needs=(_scene,),
    ),
    "decode": Writer(
        lambda i, o: ["decode", i / "scan", "--out", o],
        (),
        ("--min-modulation", "100"),
        needs=(_scan,),
    ),
    "fuse": Writer(
        lambda i, o: ["fuse", i / "photographs", "--out", o],
        (),
        ("--method", "pyramid"),
        "out.png",
        needs=(_photographs,),
    ),
    "fuse a stack": Writer(
        lambda i, o: ["fuse", i / "deep-scan" / "stack", "--out", o],
        (),
        ("--method", "modulation"),
        needs=(_stack,),
    ),
    "register": Writer(
        lambda i, o: ["register", i / "views", "--positions", i / "stage.csv", "--out", o],
        ("--stage-um", "5"),
        ("--stage-um", "6"),
        needs=(_views,),
    ),
    "calibrate fit": Writer(
        lambda i, o: ["calibrate", "fit", i / "points.csv", "--out", o],
        ("--models", "M1"),
        ("--models", "M2"),
        "out.json",
        needs=(_points,),
    ),
    "calibrate apply": Writer(
        lambda i, o: ["calibrate", "apply", i / "m.json", i / "scan", "--out", o],
        (),
        ("--min-modulation", "40"),
        "out.ply",
        needs=(_model, _scan),
    ),
    "compare": Writer(
        lambda i, o: ["compare", i / "small.toml", *PAIR, "--repeats", 2, "--out", o],
        *SEEDS,
        needs=(_scene,),
    ),
    "check": Writer(
        lambda i, o: ["check", i / "some.claims.toml", "--update", "--baseline", o],
        *SEEDS,
        "out.json",
        needs=(_claims,),
    ),
    "design rig": Writer(
        lambda i, o: ["design", "rig", HARDWARE, "--evaluations", 100, "--out", o], *SEEDS
    ),
    "design patterns": Writer(
        lambda i, o: ["design", "patterns", "--width-px", 640, "--plot", o],
        ("--noise-rad", "0.03"),
        ("--noise-rad", "0.05"),
        "out.png",
    ),
    "design noise": Writer(
        lambda i, o: ["design", "noise", i / "small.toml", *FEW, "--repeats", 2, "--out", o],
        *SEEDS,
        dear=True,
        needs=(_scene,),
    ),
    "design verify": Writer(
        lambda i, o: ["design", "verify", HARDWARE, "--count", 3, "--spp", 1, "--out", o],
        *SEEDS,
        dear=True,
    ),
    "dataset export": Writer(
        lambda i, o: ["dataset", "export", i / "set", "--out", o],
        None,
        ("--format", "frames"),
        needs=(_dataset,),
    ),
    "rig convert": Writer(
        lambda i, o: ["rig", "convert", i / "scan" / "rig.yaml", o],
        None,
        (),
        "out.yaml",
        needs=(_scan,),
    ),
    "objects build": Writer(
        lambda i, o: ["objects", "build", "spur-gear", "--out", o],
        (),
        ("--set", "teeth=30"),
        "out.stl",
    ),
    "scene new": Writer(
        lambda i, o: ["scene", "new", o, *NEW],
        ("--lens-mm", "25"),
        ("--lens-mm", "35"),
        "out.toml",
    ),
    "scene show": Writer(
        lambda i, o: ["scene", "show", "--out", o], ("plane",), ("sphere",), "out.png", dear=True
    ),
    "export": Writer(
        lambda i, o: ["export", "sphere", o, "--pinhole"],
        ("--frame", "0"),
        ("--frame", "1"),
        "out.xml",
    ),
}
