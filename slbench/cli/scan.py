"""``slbench scan``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.cli.common import (
    Align,
    AllowModules,
    Json,
    MeasuredWith,
    Preview,
    SceneChanges,
    SceneName,
    Seed,
    Weights,
    load_changed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import (
    FINITE,
    Interval,
    Measure,
    Micrometres,
    Samples,
    Shifts,
)

if TYPE_CHECKING:
    from rich.table import Table

    from slbench.scene.model import Scene
    from slbench.score.fusion import FusionScore
    from slbench.score.points import Score
    from slbench.simulate.scan import Scan


#: A tilt of a stage, mrad.
StageTilt = Annotated[float, FINITE, Interval(ge=0.0, le=100.0)]
#: Frames of an adaptive scan: two sets at least.
MaxFrames = Annotated[int, Interval(ge=6, le=1000)]


@command(
    "slbench scan step-block --patterns 1,10,50 --set camera.f_number=8 "
    "--measured-with calibrated.yaml --align --out out/block"
)
def scan(
    scene: SceneName,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: out/NAME]")
    ] = None,
    patterns: Annotated[
        str | None,
        typer.Option(
            help='"1,10,50", "gray+16@8", in colour "1,16@3+rgb"; a TOML file, a folder of '
            "pictures, mine.py:SET."
        ),
    ] = None,
    steps: Annotated[Shifts | None, typer.Option(help="Phase shifts of each fringe set.")] = None,
    axes: Annotated[Literal["u", "v", "uv"] | None, typer.Option(help="Coded panel axes.")] = None,
    spp: Annotated[Samples | None, typer.Option(help="Monte Carlo samples a pixel.")] = None,
    seed: Seed = 0,
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Detector noise; rounding stays.")
    ] = True,
    weights: Weights = "lit",
    score: Annotated[
        bool,
        typer.Option("--score/--no-score", help="Score the points against the truth."),
    ] = True,
    picture: Annotated[
        bool, typer.Option("--picture/--no-picture", help="Draw summary.png.")
    ] = True,
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    views: Annotated[
        Path | None, typer.Option(help="views.toml: scan its views of one part, and merge them.")
    ] = None,
    register: Annotated[
        bool, typer.Option("--register/--known-poses", help="Register views where it helps.")
    ] = True,
    stage_um: Annotated[
        Micrometres, typer.Option(help="By which views are off the poses told, each axis.")
    ] = 0.0,
    tilt_mrad: Annotated[
        StageTilt, typer.Option(help="By which they are tilted, each axis.")
    ] = 0.0,
    adaptive: Annotated[
        bool,
        typer.Option(
            "--adapt/--no-adapt", help="Choose fringes, exposures and masks by what is seen."
        ),
    ] = False,
    max_frames: Annotated[
        MaxFrames | None,
        typer.Option(help="With --adapt: frames to take at most.  [default: 30]"),
    ] = None,
    want_um: Annotated[
        Measure | None,
        typer.Option(help="With --adapt: 95th percentile of the deviations to stop at, µm."),
    ] = None,
    changes: SceneChanges = None,
    measured_with: MeasuredWith = None,
    align: Align = False,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Measure a scene: trace, capture, decode, triangulate, score.

    With --adapt the next fringes are chosen by what was seen so far, and the log says why.
    """
    loaded = load_changed(
        scene,
        changes,
        preview=preview,
        allow_modules=allow_modules,
        measured_with=measured_with,
        align=align,
    )
    if adaptive:
        others: dict[str, object] = {
            "--patterns": patterns,
            "--steps": steps,
            "--axes": axes,
            "--report": page,
            "--views": views,
            "--stage-um": stage_um or None,
            "--tilt-mrad": tilt_mrad or None,
        }
        for name, value in others.items():
            if value is not None:
                raise InputError(name, "none with --adapt, which chooses columns itself", value)
        _run_adaptive(
            loaded,
            out or Path("out") / f"{loaded.name}-adaptive",
            max_frames,
            want_um,
            seed=seed,
            noise=noise,
            samples=spp,
            score=score,
            as_json=as_json,
        )
        return
    for name, budget in {"--max-frames": max_frames, "--want-um": want_um}.items():
        if budget is not None:
            raise InputError(name, "--adapt beside it", budget)
    if patterns is not None or steps is not None or axes is not None:
        loaded = loaded.with_changed_patterns(
            patterns, steps, axes, allow_modules=allow_modules, names=("--steps", "--axes")
        )
    folder = out or Path("out") / loaded.name
    if views is not None:
        from slbench.cli.scan_views import scan_viewpoints

        if page is not None:
            raise InputError("--report", "none beside --views", page)
        scan_viewpoints(
            loaded,
            views,
            folder,
            seed=seed,
            noise=noise,
            samples=spp,
            weights=weights,
            score=score,
            refine=register,
            stage_um=stage_um,
            tilt_mrad=tilt_mrad,
            picture=picture,
            as_json=as_json,
        )
        return
    if stage_um or tilt_mrad or not register:
        option = "--stage-um" if stage_um else "--tilt-mrad" if tilt_mrad else "--known-poses"
        raise InputError(option, "--views beside it", "none")
    given: dict[str, Any] = {"seed": seed, "noise": noise, "samples": spp}
    given |= {"weights": weights, "score": score}
    if len(loaded.rig.pairs) > 1:
        _scan_rig(loaded, given, folder, picture, page, as_json)
        return
    from slbench.simulate.folder import check_scan_folder, write_scan
    from slbench.simulate.scan import scan as run

    check_scan_folder(loaded, folder, "--out")
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    with progress(as_json) as report:
        result = run(loaded, **given, on_progress=report)
        write_scan(result, folder, picture=picture)
        if page is not None:
            from slbench.report.page import write_page
            from slbench.report.pages.scan import scan_page

            write_page(scan_page(result), page)
    if as_json:
        written = {"out": folder} if page is None else {"out": folder, "report": page}
        print_json(result.to_dict() | {"seconds": dict(result.run.seconds)} | written)
    else:
        print_table(_scan_table(result))
        shown = page or (folder / "summary.png" if picture else None)
        print(f"Written to {folder}" + (f": open {shown}" if shown else ""))


def _scan_rig(
    scene: Scene,
    given: dict[str, Any],
    folder: Path,
    picture: bool,
    page: Path | None,
    as_json: bool,
) -> None:
    """Measure a scene by several cameras or projectors."""
    from slbench.simulate.several.folder import check_rig_folder, write_rig_scan
    from slbench.simulate.several.scan import scan_rig

    check_rig_folder(scene, folder, "--out")
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    with progress(as_json) as report:
        result = scan_rig(scene, **given, on_progress=report)
        write_rig_scan(result, folder, picture=picture)
        if page is not None:
            from slbench.report.page import write_page
            from slbench.report.pages.rig_scan import rig_scan_page

            write_page(rig_scan_page(result), page)
    written = {"out": folder} if page is None else {"out": folder, "report": page}
    if as_json:
        print_json(result.to_dict() | {"seconds": dict(result.run.seconds)} | written)
        return
    rows = result.rows()
    if result.score is not None:
        rows += _feature_rows(result.score.points)
    print_table(_laid_out(result.title, rows, result.run.seconds))
    print_table(result.table())
    shown = page or (folder / "summary.png" if picture else None)
    print(f"Written to {folder}" + (f": open {shown}" if shown else ""))


def _run_adaptive(
    scene: Scene,
    folder: Path,
    max_frames: int | None,
    want_um: float | None,
    *,
    seed: int,
    noise: bool,
    samples: int | None,
    score: bool,
    as_json: bool,
) -> None:
    """Measure a scene adaptively, write what came out, and print the log."""
    from slbench.design.adaptive.adapt import MAX_FRAMES
    from slbench.design.adaptive.scan import ADAPTIVE_FOLDER, scan_adaptively, write_adaptive_scan

    ADAPTIVE_FOLDER.check(folder, "--out")
    with progress(as_json) as report:
        result = scan_adaptively(
            scene,
            max_frames=MAX_FRAMES if max_frames is None else max_frames,
            want_um=want_um,
            seed=seed,
            noise=noise,
            samples=samples,
            score=score,
            on_progress=report,
        )
        write_adaptive_scan(result, folder)
    if as_json:
        print_json(result.to_dict() | {"seconds": dict(result.seconds), "out": folder})
        return
    for line in result.adapted.log():
        print(line)
    if result.score is not None:
        for name, value in result.score.rows():
            print(f"{name}: {value}")
    print(f"Written to {folder}")


def _scan_table(result: Scan) -> Table:
    """Lay a scan's score out for people."""
    title = f"{result.scene.name}, patterns {{{result.scene.sequence.name}}}"
    rows = result.rows()
    if result.scores is not None:
        rows += _feature_rows(result.scores.points) + _fusion_rows(result.scores.fusion)
    return _laid_out(title, rows, result.run.seconds)


def _laid_out(title: str, rows: list[tuple[str, str]], seconds: Mapping[str, float]) -> Table:
    from rich.table import Table

    table = Table(title=title)
    table.add_column("quantity")
    table.add_column("value", justify="right")
    times = ", ".join(f"{stage} {value:.2f}" for stage, value in seconds.items())
    for row in (*rows, ("seconds", times)):
        table.add_row(*row)
    return table


def _declared_rows(score: Score) -> list[tuple[str, str]]:
    """Return what a part's file declares, (quantity, value)."""
    um = 1e3
    rows = [
        (
            f"diameter {f.nominal_diameter_mm:g} mm, {f.name}",
            f"{f.diameter_mm:.4f} mm, u {um * f.diameter_uncertainty_mm:.2f} µm",
        )
        for f in (*score.cylinders, *score.circles)
    ]
    rows += [
        (
            f"cone {c.nominal_angle_deg:.4g} deg, {c.name}",
            f"{c.angle_deg:.4f} deg, u {c.angle_uncertainty_deg:.4f} deg",
        )
        for c in score.cones
    ]
    for d in score.dimensions:
        limits = f", {d.tolerance}: {d.verdict}" if d.verdict else ""
        value = f"{d.measured:.4f} {d.unit}, u {d.uncertainty:.4f} {d.unit}{limits}"
        rows.append((f"{d.name} ({d.type})", value))
    return rows


def _feature_rows(score: Score) -> list[tuple[str, str]]:
    """Return the features of a score, (quantity, value)."""
    um = 1e3
    rows = [
        (
            f"step {step.nominal_mm:g} mm",
            f"{step.measured_mm:.4f} mm, error {um * step.deviation_mm:+.2f} µm, "
            f"u {um * step.uncertainty_mm:.2f} µm",
        )
        for step in score.steps
    ]
    rows += [
        (f"flatness of {p.object}, {p.name}", f"{um * p.flatness_mm:.1f} µm") for p in score.planes
    ]
    rows += [
        (
            f"radius {s.nominal_radius_mm:g} mm",
            f"{s.radius_mm:.4f} mm, u {um * s.radius_uncertainty_mm:.2f} µm, "
            f"form {um * s.form_mm:.1f} µm",
        )
        for s in score.spheres
    ]
    rows += [
        (
            f"spacing {s.nominal_mm:g} mm",
            f"{s.measured_mm:.4f} mm, u {um * s.uncertainty_mm:.2f} µm, {s.name}",
        )
        for s in score.spacings
    ]
    return [*rows, *_declared_rows(score)]


def _fusion_rows(fusion: FusionScore | None) -> list[tuple[str, str]]:
    """Return what a fused stack is worth, (quantity, value)."""
    if fusion is None:
        return []
    return [
        (
            f"phase of {fusion.finest:g} fringes, {place} the depth of field",
            f"fused {fused.phase_rms:.4f} rad, middle setting {middle.phase_rms:.4f} rad",
        )
        for place, fused, middle in (
            ("inside", fusion.fused_inside, fusion.middle_inside),
            ("outside", fusion.fused_outside, fusion.middle_outside),
        )
    ]
