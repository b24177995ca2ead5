"""``slbench scan``, ``decode`` and ``export``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from slbench.cli.common import (
    Json,
    Preview,
    SceneName,
    Seed,
    check_folder,
    print_json,
    print_table,
    progress,
)
from slbench.core.errors import InputError
from slbench.core.io import atomic_folder, write_exr, write_json, write_provenance


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    block = "slbench scan step-block --patterns 1,10,50 --steps 3 --out out/block"
    app.command(epilog=f"Example: {block}")(scan)
    app.command(epilog="Example: slbench decode out/step-block --out decoded")(decode)
    app.command(epilog="Example: slbench export sphere out/sphere.xml --pinhole")(export)


def scan(
    scene: SceneName,
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
    weights: Annotated[
        str, typer.Option(help="Focus stacks: sharp by lit frames' texture, or by modulation.")
    ] = "lit",
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    preview: Preview = False,
    as_json: Json = False,
) -> None:
    """Measure a scene: trace, capture, decode, triangulate and score it."""
    from slbench.report.page import check_page_path, write_page
    from slbench.report.pages.scan import scan_page
    from slbench.scene.file import load_scene
    from slbench.simulate.folder import write_scan
    from slbench.simulate.scan import scan as run

    loaded = load_scene(scene, preview=preview)
    if patterns is not None or steps is not None or axes is not None:
        given: dict[str, Any] = {"sequence": "1,10,50", "shifts": 3, "axes": "u"}
        given |= loaded.specification.get("patterns", {})
        text = given["sequence"] if patterns is None else patterns
        if steps is not None and "@" in text:
            raise InputError("--steps", "no shifts (@) in the patterns too", text)
        loaded = loaded.with_patterns(
            text, steps or given["shifts"], given["axes"] if axes is None else axes
        )
    if weights not in ("lit", "modulation"):
        raise InputError("--weights", "lit or modulation", weights)
    folder = out or Path("out") / loaded.name
    check_folder(folder)
    if page is not None:
        check_page_path(page)
    with progress(as_json) as report:
        result = run(
            loaded,
            seed=seed,
            noise=noise,
            samples=spp,
            weights=weights,  # type: ignore[arg-type]
            on_progress=report,
        )
        write_scan(result, folder)
        if page is not None:
            write_page(scan_page(result), page)
    if as_json:
        written = {"out": folder} if page is None else {"out": folder, "report": page}
        print_json(result.to_dict() | written)
    else:
        print_table(_scan_table(result))
        print(f"Written to {folder}: open {page or folder / 'summary.png'}")


def _scan_table(result: Any) -> Table:
    """Lay a scan's score out for people."""
    from slbench.report.pages.scan import overall_rows, seconds

    score = result.score
    table = Table(title=f"{result.scene.name}, patterns {{{result.scene.sequence.name}}}")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    um = 1e3
    rows = overall_rows(result)
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
    rows += [
        (f"spacing {s.nominal_mm:g} mm", f"{s.measured_mm:.4f} mm, {s.name}")
        for s in score.spacings
    ]
    if result.fusion is not None:
        fusion = result.fusion
        rows += [
            (
                f"phase of {fusion.finest} fringes, {place} the depth of field",
                f"fused {fused.phase_rms:.4f} rad, middle setting {middle.phase_rms:.4f} rad",
            )
            for place, fused, middle in (
                ("inside", fusion.fused_inside, fusion.middle_inside),
                ("outside", fusion.fused_outside, fusion.middle_outside),
            )
        ]
    rows.append(("seconds", seconds(result)))
    for row in rows:
        table.add_row(*row)
    return table


def decode(
    folder: Annotated[
        Path, typer.Argument(help="A folder of frames with a capture.toml beside them.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: FOLDER/decoded]")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig (OpenCV YAML) to triangulate with.")] = None,
    min_modulation: Annotated[
        float | None,
        typer.Option(min=0.0, help="Least modulation of a valid pixel, DN; 3, or the capture's."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Decode frames from disk, simulated or photographed, and triangulate where a rig is known."""
    from slbench.capture.capture import Capture
    from slbench.cloud.triangulation import triangulate
    from slbench.rig.opencv import read_rig
    from slbench.simulate.folder import write_cloud

    target = out or (folder if folder.is_dir() else folder.parent) / "decoded"
    check_folder(target)
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
        print_json(result | {"out": str(target)})
        return
    for key, value in result.items():
        print(f"{key}: {'-' if value is None else value}")
    print(f"Written to {target}")


def export(
    scene: SceneName,
    path: Annotated[Path, typer.Argument(help="The XML file to write.")],
    frame: Annotated[int, typer.Option(min=0, help="Which frame of the scene's patterns.")] = 0,
    pinhole: Annotated[
        bool, typer.Option(help="Replace the projector's lens by a pinhole without fall-off.")
    ] = False,
) -> None:
    """Write a scene as Mitsuba XML, where Mitsuba's stock plugins can express it."""
    from slbench.patterns import panel_response
    from slbench.scene.file import load_scene
    from slbench.simulate.render.translate import export_xml

    if path.suffix.lower() != ".xml":
        raise InputError("path", "a name that ends in .xml", path)
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
