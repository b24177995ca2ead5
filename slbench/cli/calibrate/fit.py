"""``slbench calibrate fit`` and ``apply``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from slbench.cli.common import Json, Seed, new_app, print_json, print_table
from slbench.core.errors import InputError

app = new_app("Calibrate by one polynomial model of all pixels, and measure with it.")

_FIT = "slbench calibrate fit points.csv --out model.json --json"
_APPLY = "slbench calibrate apply model.json out/coin --out cloud.ply"


@app.command(epilog=f"Example: {_FIT}")
def fit(
    points: Annotated[
        Path,
        typer.Argument(help="CSV: u_c,v_c,u_p,v_p,x_mm,y_mm,z_mm; with axes u, v_p may be nan."),
    ],
    out: Annotated[Path, typer.Option(help="Model to write (.json).")] = Path("model.json"),
    axes: Annotated[str, typer.Option(help="Panel axes that the model uses: u or uv.")] = "u",
    models: Annotated[
        str, typer.Option(help="Candidates: M1 linear, M2 interactions, M3 quadratic, M4 cubic.")
    ] = "M1,M2,M3,M4",
    multivariate: Annotated[
        bool, typer.Option("--multivariate", help="Fit x, y and z together.")
    ] = False,
    validation: Annotated[
        float, typer.Option(help="Share of the points that validate and do not train.")
    ] = 0.2,
    seed: Seed = 0,
    report: Annotated[
        Path | None, typer.Option(help="Report to write too: one HTML page (.html).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Fit the models of every world coordinate robustly and choose by cross-validation."""
    from slbench.calibration.models.points import CalibrationPoints
    from slbench.calibration.selection import select_models
    from slbench.report.page import check_page_path, write_page
    from slbench.report.pages.calibration import calibration_page
    from slbench.twin.report import gross_note

    _check_suffix(out, ".json")
    if report is not None:
        check_page_path(report)
    data = CalibrationPoints.read(points)
    selection = select_models(
        data,
        axes=axes,  # type: ignore[arg-type]
        forms=[name.strip() for name in models.split(",")],
        multivariate=multivariate,
        validation=validation,
        seed=seed,
    )
    selection.model.save(out)
    written = {"out": str(out)}
    if report is not None:
        parameters = {
            "points": str(points),
            "axes": axes,
            "models": models,
            "multivariate": multivariate,
            "validation": validation,
        }
        title = f"Calibration by {points.name}"
        page = calibration_page(data, selection, parameters=parameters, seed=seed, title=title)
        write_page(page, report)
        written["report"] = str(report)
    if as_json:
        print_json(selection.to_dict() | {"axes": axes, **written})
        return
    print_table(_scores(selection))
    rms, mad = (1e3 * value for value in selection.isometric.values())
    print(f"3-D validation error: RMS {rms:.4g} µm, MAD {mad:.4g} µm")
    if len(selection.gross):
        print(gross_note(selection))
    for name, forms in selection.scores.items():
        for form, score in forms.items():
            if not score.converged:
                print(f"{name}, {form}: not converged in {score.iterations} iterations")
    print(f"Written to {' and '.join(written.values())}")


def _scores(selection: Any) -> Table:
    """Lay the scores of all models out as in thesis fig. 30-32 and table 13, in µm."""
    from slbench.twin.report import score_rows

    table = Table(title="errors / µm; * selected by the least CV")
    for name in ("model", "train RMS", "validation RMS", "validation MAD", "√residual MS", "CV"):
        table.add_column(name, justify="left" if name == "model" else "right")
    for name, form, selected, *errors in score_rows(selection):
        mark = " *" if selected else ""
        table.add_row(f"{name} {form}{mark}", *(f"{value:.4g}" for value in errors))
    return table


@app.command(epilog=f"Example: {_APPLY}")
def apply(
    model: Annotated[Path, typer.Argument(help="Model that `calibrate fit` wrote.")],
    capture: Annotated[
        Path, typer.Argument(help="A folder of frames with a capture.toml beside them.")
    ],
    out: Annotated[Path, typer.Option(help="Cloud to write (.ply).")] = Path("cloud.ply"),
    inside_only: Annotated[
        bool, typer.Option("--inside-only", help="Leave out what the model would extrapolate to.")
    ] = False,
    min_modulation: Annotated[
        float | None,
        typer.Option(min=0.0, help="Least modulation of a valid pixel, DN; 3, or the capture's."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Decode frames and turn every pixel into a point by a calibration model."""
    from slbench.calibration.apply import measure
    from slbench.calibration.models.model import CalibrationModel
    from slbench.capture.capture import Capture
    from slbench.core.io import write_ply

    _check_suffix(out, ".ply")
    calibration = CalibrationModel.load(model)
    phase = Capture.load(capture).decode(min_modulation=min_modulation)
    measured = measure(calibration, phase)
    outside = int(np.count_nonzero(measured.extrapolated))
    decoded = len(measured.cloud)
    if inside_only:
        measured = measured.inside()
    count = len(measured.cloud)
    if count == 0:
        expected = "pixels in the model's domain" if decoded else "pixels that can be decoded"
        raise InputError(capture, expected, f"none of {decoded}" if decoded else "none")
    if 2 * outside > decoded:
        share = f"{outside} of {decoded} pixels are outside the model's domain"
        print(f"warning: {share}: another camera, or a larger object?", file=sys.stderr)
    sigma = measured.sigma_total_mm
    fields = {"sigma": sigma, "extrapolated": measured.extrapolated.astype(np.float64)}
    write_ply(out, measured.cloud.points, fields)
    result = {
        "points": count,
        "outside": outside,
        "predicted_sigma_mm": float(np.median(sigma)),
        "out": str(out),
    }
    if as_json:
        print_json(result)
        return
    print(f"{count} points, {outside} of {decoded} pixels outside the model's domain", end="")
    print(" left out" if inside_only else "")
    print(f"predicted standard deviation: {1e3 * float(np.median(sigma)):.4g} µm (median)")
    print(f"Written to {out}")


def _check_suffix(path: Path, suffix: str) -> None:
    """Refuse an output of another kind, or a folder, before the work is done."""
    if path.suffix.lower() != suffix or path.is_dir():
        raise InputError("--out", f"the name of a file that ends in {suffix}", path)
