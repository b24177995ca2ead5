"""The command line: ``slbench scan``, ``decode``, ``export``, ``doctor``.

Each command reads like the sentence it is: load, do, write, print.  Results go to stdout (a
table, or with ``--json`` one JSON object at its end), everything else to stderr.  Exit status:
0 success, 1 a check failed, 2 bad input, in one line.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from slbench import __version__, resources
from slbench.errors import InputError
from slbench.io import atomic_folder, plain, write_exr, write_json, write_provenance

app = typer.Typer(
    name="slbench",
    help="A physically based synthetic structured-light scanner and test bench.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

# Typer carries its own copy of Click from 0.20 on; this is its usage error in every version.
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]

_messages = Console(stderr=True, highlight=False)


def main() -> None:
    """Run the command line and exit."""
    try:
        status = app(standalone_mode=False)
    except InputError as error:
        status = _refuse(str(error))
    except _UsageError as error:
        status = _refuse(error.format_message())  # type: ignore[attr-defined]
    except MemoryError as error:
        status = _refuse(f"memory: expected enough for this scene, got {error}")
    except (typer.Abort, KeyboardInterrupt):
        status = 130
    except BrokenPipeError:
        status = 0
    sys.exit(status if isinstance(status, int) else 0)


def _refuse(message: str) -> int:
    print("error: " + " ".join(message.split()), file=sys.stderr)
    return 2


@contextmanager
def _progress(quiet: bool) -> Iterator[Any]:
    """Yield a callback (stage, fraction) that draws a bar on a terminal and is quiet elsewhere."""
    if quiet or not _messages.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description:>12}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=_messages, transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, fraction: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=fraction)

        yield report


def _print_json(values: dict[str, Any]) -> None:
    print(json.dumps(plain(values), ensure_ascii=False, allow_nan=False))


Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of every random draw.")]


def _version(value: bool) -> None:
    if value:
        print(__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command(epilog="Example: slbench scan step-block --patterns 1,10,50 --steps 3 --out out/block")
def scan(
    scene: Annotated[str, typer.Argument(help="A scene file, or the name of a shipped scene.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: out/NAME]")
    ] = None,
    patterns: Annotated[
        str | None,
        typer.Option(help='Pattern sequence: "1,10,50", "1,16@8", "gray+16@8".'),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=3, help="Phase shifts of each fringe set.")
    ] = None,
    axes: Annotated[str | None, typer.Option(help="Coded panel axes: u, v or uv.")] = None,
    spp: Annotated[
        int | None, typer.Option(min=1, max=65536, help="Monte Carlo samples a pixel.")
    ] = None,
    seed: Seed = 0,
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Detector noise; rounding stays.")
    ] = True,
    as_json: Json = False,
) -> None:
    """Measure a scene: trace, capture, decode, triangulate and score it."""
    from slbench.scan import scan as run
    from slbench.scan import write_scan
    from slbench.scenefile import load_scene

    loaded = load_scene(scene)
    if patterns is not None or steps is not None or axes is not None:
        given: dict[str, Any] = {"sequence": "1,10,50", "shifts": 3, "axes": "u"}
        given |= loaded.specification.get("patterns", {})
        loaded = loaded.with_patterns(
            patterns or given["sequence"], steps or given["shifts"], axes or given["axes"]
        )
    folder = out or Path("out") / loaded.name
    with _progress(as_json) as report:
        result = run(loaded, seed=seed, noise=noise, samples=spp, on_progress=report)
        write_scan(result, folder)
    if as_json:
        _print_json(result.to_dict() | {"out": str(folder)})
    else:
        console = Console(highlight=False)
        console.print(_scan_table(result))
        console.print(f"Written to {folder}: open {folder / 'summary.png'}", soft_wrap=True)


def _scan_table(result: Any) -> Table:
    """Lay a scan's score out for people."""
    score, seconds = result.score, result.seconds
    table = Table(title=f"{result.scene.name}, patterns {{{result.scene.sequence.name}}}")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    um = 1e3
    rows: list[tuple[str, str]] = [
        ("points", f"{score.points}"),
        ("completeness", f"{100 * score.completeness:.2f} % of lit pixels"),
        ("median error", f"{um * score.median_abs_mm:.2f} µm"),
        ("95th percentile", f"{um * score.p95_abs_mm:.2f} µm"),
        ("RMS error, edges included", f"{um * score.rms_mm:.2f} µm"),
        ("RMS error, smooth surface", f"{um * score.smooth_rms_mm:.2f} µm"),
        ("predicted from noise alone", f"{um * score.predicted_sigma_mm:.2f} µm"),
        ("renderer's own floor", f"{result.floor_rms_px:.4f} px"),
    ]
    rows += [
        (
            f"step {step.nominal_mm:g} mm",
            f"{step.measured_mm:.4f} mm, error {um * (step.measured_mm - step.nominal_mm):+.2f} µm",
        )
        for step in score.steps
    ]
    rows += [
        (f"flatness of {p.object}, {p.name}", f"{um * p.flatness_mm:.1f} µm") for p in score.planes
    ]
    rows += [
        (
            f"radius {s.nominal_radius_mm:g} mm",
            f"{s.radius_mm:.4f} mm, form {um * s.form_mm:.1f} µm",
        )
        for s in score.spheres
    ]
    rows.append(("seconds", ", ".join(f"{k} {v:.2f}" for k, v in seconds.items())))
    for row in rows:
        table.add_row(*row)
    return table


@app.command(epilog="Example: slbench decode out/step-block --out decoded")
def decode(
    folder: Annotated[
        Path, typer.Argument(help="A folder of frames with a capture.toml beside them.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: FOLDER/decoded]")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig (OpenCV YAML) to triangulate with.")] = None,
    min_modulation: Annotated[
        float, typer.Option(min=0.0, help="Least modulation of a valid pixel, DN.")
    ] = 3.0,
    as_json: Json = False,
) -> None:
    """Decode frames from disk, simulated or photographed, and triangulate where a rig is known."""
    from slbench.capture import Capture
    from slbench.reconstruct import triangulate
    from slbench.rig.opencv import read_rig
    from slbench.scan import write_cloud

    shots = Capture.load(folder)
    if rig is not None:
        shots = replace(shots, rig=read_rig(rig))
    phase = shots.decode(min_modulation=min_modulation)
    channels = {
        "modulation": phase.modulation,
        "mean": phase.mean,
        "mask": phase.mask,
        **{f"panel.{axis}": values for axis, values in phase.coordinate.items()},
        **{f"sigma.{axis}": values for axis, values in phase.sigma.items()},
    }
    result: dict[str, Any] = {
        "patterns": shots.sequence.name,
        "frames": len(shots.frames),
        "valid_pixels": int(np.count_nonzero(phase.mask)),
        "points": None,
        "predicted_sigma_mm": None,
    }
    target = out or (folder if folder.is_dir() else folder.parent) / "decoded"
    with atomic_folder(target) as temporary:
        write_exr(temporary / "phase.exr", {k: v.astype(np.float32) for k, v in channels.items()})
        if shots.rig is not None:
            cloud = triangulate(shots.rig, phase)
            result["points"] = len(cloud)
            if len(cloud):
                write_cloud(temporary / "cloud.ply", cloud)
                result["predicted_sigma_mm"] = float(np.median(cloud.sigma_total_mm))
        write_json(temporary / "decode.json", result)
        write_provenance(temporary, {"folder": str(folder), "rig": str(rig) if rig else None}, None)
    if as_json:
        _print_json(result | {"out": str(target)})
        return
    for key, value in result.items():
        print(f"{key}: {'-' if value is None else value}")
    print(f"Written to {target}")


@app.command(epilog="Example: slbench export sphere out/sphere.xml --frame 3")
def export(
    scene: Annotated[str, typer.Argument(help="A scene file, or the name of a shipped scene.")],
    path: Annotated[Path, typer.Argument(help="The XML file to write.")],
    frame: Annotated[int, typer.Option(min=0, help="Which frame of the scene's patterns.")] = 0,
    pinhole: Annotated[
        bool, typer.Option(help="Replace the projector's lens by a pinhole without fall-off.")
    ] = False,
) -> None:
    """Write a scene as Mitsuba XML, where Mitsuba's stock plugins can express it."""
    from slbench.patterns import panel_response
    from slbench.render.translate import export_xml
    from slbench.scenefile import load_scene

    loaded = load_scene(scene)
    if pinhole:
        projector = loaded.rig.projector
        lens = replace(projector.lens, aperture_radius_mm=0.0, natural_vignetting=False)
        loaded = replace(loaded, rig=replace(loaded.rig, projector=replace(projector, lens=lens)))
    axis, profile = loaded.sequence.profile(frame)
    projector = loaded.rig.projector
    values = panel_response(profile, projector.bit_depth, projector.gamma)
    shape = (projector.height, projector.width)
    panel = np.broadcast_to(values if axis == "u" else values[:, None], shape)
    for written in export_xml(loaded, path, panel):
        print(written)


@app.command(epilog="Example: slbench scenes")
def scenes() -> None:
    """List the shipped scenes."""
    from slbench.io import read_toml

    for name in resources.names("scenes"):
        content = read_toml(resources.find("scenes", name))
        print(f"{name:16} {content.get('description', '')}")


@app.command(epilog="Example: slbench doctor --json")
def doctor(as_json: Json = False) -> None:
    """Check the installation: versions, backend, LLVM, GPU, and a test render."""
    from slbench.doctor import diagnose, exit_status, report

    diagnosis = diagnose()
    if as_json:
        _print_json(diagnosis)
    else:
        Console(highlight=False).print(report(diagnosis))
    raise typer.Exit(exit_status(diagnosis))


if __name__ == "__main__":
    main()
