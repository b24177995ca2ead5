"""``slbench calibrate run``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    Json,
    Preview,
    SceneChanges,
    SceneName,
    Seed,
    Weights,
    listed,
    load_changed,
    print_json,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError, warn_user
from slbench.core.validation.types import Interval, Micrometres, Samples, Step, Steps

#: Of a stage, at least as many as the cubic model needs.
Heights = Annotated[int, Interval(ge=4, le=1000)]

#: Heights and shifts of a preview.  The methods are compared on every other height: seven leave
#: four to fit to, as many as a cubic in the height needs.
_PREVIEW = (7, 2)


@command("slbench calibrate run ch8-grid-stack --preview --out out/calibration")
def run(
    scene: SceneName,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/calibration"),
    z_steps: Annotated[
        Heights | None, typer.Option(help="Heights of the stage.  [default: 11]")
    ] = None,
    y_steps: Annotated[
        Steps | None, typer.Option(help="Shifts of the stage along y.  [default: 6]")
    ] = None,
    y_step_um: Annotated[Step, typer.Option(help="Size of a shift.")] = 20.0,
    stage_um: Annotated[
        Micrometres, typer.Option(help="Standard deviation of the stage's position.")
    ] = 0.0,
    remapping: Annotated[
        Literal["ring", "bilinear"],
        typer.Option(help="Phase of a dot: from a ring around it, or bilinear at its centre."),
    ] = "ring",
    weights: Weights = "lit",
    divisor: Annotated[
        Steps | None, typer.Option(help="Camera pixels put together, to be quicker.")
    ] = None,
    spp: Annotated[Samples | None, typer.Option(help="Monte Carlo samples a pixel.")] = None,
    models: Annotated[
        str | None,
        typer.Option(help="Candidates.  [default: those of M1,M2,M3,M4 that points allow]"),
    ] = None,
    baselines: Annotated[
        str | None,
        typer.Option(help="Methods to compare with, by commas.  [default: all that there are]"),
    ] = None,
    multivariate: Annotated[
        bool, typer.Option("--multivariate", help="Fit x, y and z together.")
    ] = False,
    keep: Annotated[
        Path | None,
        typer.Option(help="Folder for the captures too, which slbench calibrate points reads."),
    ] = None,
    seed: Seed = 0,
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    changes: SceneChanges = None,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Render the calibration experiment: dots on a stage to a model."""
    import numpy as np

    from slbench.calibration.baselines import calibration_baselines, compare_methods
    from slbench.calibration.models.polynomials import calibration_models
    from slbench.calibration.selection import forms_for, select_models
    from slbench.report.page import check_page_path, write_page
    from slbench.report.pages.calibration import calibration_page
    from slbench.twin.captures import kept
    from slbench.twin.experiment import (
        Y_STEPS,
        Z_STEPS,
        run_experiment,
        sampling_doubt,
        stage_positions,
    )
    from slbench.twin.report import (
        CALIBRATION_FOLDER,
        tables,
        to_dict,
        write_experiment,
        write_points,
    )

    CALIBRATION_FOLDER.check(out, "--out")
    if page is not None:
        check_page_path(page)
    if not np.isfinite(y_step_um) or not np.isfinite(stage_um):
        raise InputError("stage", "finite lengths (um)", f"{y_step_um}, {stage_um}")
    loaded = load_changed(scene, changes, preview=preview, allow_modules=allow_modules)
    chosen = None if models is None else listed(models, calibration_models, "--models")
    methods = None if baselines is None else listed(baselines, calibration_baselines, "--baselines")
    if divisor is not None:
        loaded = loaded.coarser(divisor, loaded.samples)
    if spp is not None:
        loaded = replace(loaded, samples=spp)
    few = _PREVIEW if preview else (Z_STEPS, Y_STEPS)
    positions = stage_positions(loaded, z_steps or few[0], y_steps or few[1], 1e-3 * y_step_um)
    with progress(as_json) as report, kept(keep, loaded, positions, seed) as on_capture:
        found = run_experiment(
            loaded,
            positions,
            stage_sigma_mm=1e-3 * stage_um,
            remapping=remapping,
            weights=weights,
            seed=seed,
            keep=on_capture,
            on_progress=report,
        )
    if doubt := sampling_doubt(found, loaded.samples):
        warn_user(f"scene {loaded.name}", doubt)
    camera, projector = loaded.rig.camera, loaded.rig.projector
    parameters = {
        "scene": loaded.specification,
        "camera_px": [camera.width, camera.height],
        "samples": loaded.samples,
        "z_steps": len(np.unique(positions[:, 2])),
        "positions": len(positions),
        "stage_um": stage_um,
        "remapping": remapping,
        "weights": weights,
    }
    # Hours of rendering: kept whatever the points are good for.
    write_points(found, out, parameters, seed)
    try:
        forms = chosen or forms_for(len(found.points))
        selection = select_models(found.points, forms=forms, multivariate=multivariate, seed=seed)
    except InputError as problem:
        got = f"{problem.got} (the points are kept in {out / 'points.csv'})"
        raise InputError(problem.where, problem.expected, got) from None
    try:
        comparison = compare_methods(
            found.points,
            (camera.width, camera.height),
            (projector.width, projector.height),
            baselines=methods,
            seed=seed,
        )
    except InputError:  # too few heights or dots in common: no baselines, but a calibration
        comparison = None
    write_experiment(found, selection, comparison, out, parameters, seed)
    written = {"out": str(out)} | ({} if keep is None else {"captures": str(keep)})
    if page is not None:
        whole = calibration_page(
            found.points,
            selection,
            comparison,
            experiment=found,
            parameters=parameters,
            seed=seed,
            title=f"Calibration by {loaded.name}",
        )
        write_page(whole, page)
        written["report"] = str(page)
    if as_json:
        print_json(to_dict(found, selection, comparison) | written)
        return
    print(tables(found, selection, comparison))
    print(f"Written to {out}: open {page or out / 'models.png'}")
