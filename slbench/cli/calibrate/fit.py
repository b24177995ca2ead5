"""``slbench calibrate fit``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.common import Json, Seed, listed, print_json, print_table
from slbench.cli.lazy import command
from slbench.core.validation.types import Proportion


@command("slbench calibrate fit points.csv --out model.json --json")
def fit(
    points: Annotated[
        Path,
        typer.Argument(
            help="CSV: u_c,v_c,u_p,v_p,x_mm,y_mm,z_mm and perhaps position; with axes u, v_p may "
            "be nan."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Model to write (.json).")] = Path("model.json"),
    axes: Annotated[Literal["u", "uv"], typer.Option(help="Panel axes that the model uses.")] = "u",
    models: Annotated[
        str, typer.Option(help="Candidates: M1 linear, M2 interactions, M3 quadratic, M4 cubic.")
    ] = "M1,M2,M3,M4",
    multivariate: Annotated[
        bool, typer.Option("--multivariate", help="Fit x, y and z together.")
    ] = False,
    validation: Annotated[
        Proportion,
        typer.Option(help="Share that validates and does not train: points, or positions."),
    ] = 0.2,
    seed: Seed = 0,
    report: Annotated[
        Path | None, typer.Option(help="Report to write too: one HTML page (.html).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Fit models to points robustly; choose by cross-validation.

    Every world coordinate has a model of its own, or all together one. Points that do not fit the
    others (wrong fringe orders) are left out and counted. With a column "position", whole positions
    of the stage validate and are left out, as their points share an error.
    """
    from slbench.calibration.models.points import CalibrationPoints
    from slbench.calibration.models.polynomials import calibration_models
    from slbench.calibration.selection import select_models
    from slbench.calibration.summary import gross_note, not_converged, position_note, score_table
    from slbench.core.io import check_output_file

    check_output_file(out, (".json",))
    if report is not None:
        from slbench.report.page import check_page_path, write_page
        from slbench.report.pages.calibration import calibration_page

        check_page_path(report)
    data = CalibrationPoints.read(points)
    selection = select_models(
        data,
        axes=axes,
        forms=listed(models, calibration_models, "--models"),
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
    print_table(score_table(selection))
    rms, mad, right = (1e3 * value for value in selection.isometric.values())
    wrong = len(selection.gross_validation)
    without = f" ({right:.4g} µm without {wrong} left out)" if wrong else ""
    print(f"3-D validation error: RMS {rms:.4g} µm{without}, MAD {mad:.4g} µm")
    print(position_note(data, selection))
    if len(selection.gross) + wrong:
        print(gross_note(data, selection))
    for sentence in not_converged(selection):
        print(sentence)
    print(f"Written to {' and '.join(written.values())}")
