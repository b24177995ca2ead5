"""The report of a calibration: thesis tables 12 and 13, figures 30 to 32, residuals in space."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slbench.calibration.baselines import Comparison
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.selection import Selection
from slbench.calibration.summary import (
    criterion,
    gross_rows,
    gross_table,
    position_note,
    score_rows,
)
from slbench.core.io import provenance
from slbench.core.show.display import length_unit
from slbench.core.show.document import Cell, Cloud, Page, Part, Picture, Table
from slbench.twin.experiment import Experiment
from slbench.twin.report import (
    method_rows,
    models_figure,
    residuals_figure,
    validation_rows,
)

_UM = 1e3


def calibration_page(
    points: CalibrationPoints,
    selection: Selection,
    comparison: Comparison | None = None,
    *,
    experiment: Experiment | None = None,
    parameters: Mapping[str, Any],
    seed: int,
    title: str = "Calibration",
) -> Page:
    """Lay a calibration out as a report.

    Parameters
    ----------
    points : CalibrationPoints
    selection : Selection
        Of those points.
    comparison : Comparison, optional
        With the baselines.
    experiment : Experiment, optional
        Where the points come from one: its detections are scored, and the thesis's numbers
        stand beside ours.
    parameters : mapping
        For the provenance.
    seed : int
    title : str

    Returns
    -------
    Page
    """
    parts: list[Part] = [_validation(points, selection, experiment is not None)]
    if experiment is not None:
        parts.append(_detection(experiment))
    if comparison is not None:
        parts.append(_methods(comparison))
    parts += [_cloud(points, selection), _scores(selection)]
    if len(gross_rows(selection)):
        parts.append(gross_table(points, selection))
    pictures = (
        ("Errors of every model", models_figure(selection), "As thesis figs. 30 to 32."),
        (
            "Residuals of the validation points",
            residuals_figure(points, selection),
            "Over the volume, seen along y.",
        ),
    )
    parts += [Picture.drawn(name, figure, caption) for name, figure, caption in pictures]
    parts.append(_coefficients(selection))
    return Page(title, tuple(parts), provenance(parameters, seed))


def _validation(points: CalibrationPoints, selection: Selection, thesis: bool) -> Table:
    columns = ("coordinate", "model", "RMS / µm", "thesis / µm", "MAD / µm", "thesis / µm")
    rows: list[tuple[Cell, ...]] = [tuple(row) for row in validation_rows(selection)]
    if not thesis:
        keep = (0, 1, 2, 4)
        columns = tuple(columns[k] for k in keep)  # type: ignore[assignment]
        rows = [tuple(row[k] for k in keep) for row in rows]
    note = (
        f"{len(selection.train)} points train, {len(selection.validation)} validate; MAD is the "
        f"median of the absolute errors (thesis eq. 45). {position_note(points, selection)}."
    )
    name = "Validation errors" + (" (thesis table 13)" if thesis else "")
    return Table(name, columns, tuple(rows), note)


def _detection(experiment: Experiment) -> Table:
    """Summarise the detected less the projected true centres."""
    error = experiment.detection_px
    distance = np.linalg.norm(error, axis=1)
    bias, scatter = np.median(error, axis=0), np.std(error, axis=0)
    row = (*bias.tolist(), *scatter.tolist(), *np.percentile(distance, (50.0, 95.0)).tolist())
    columns = (
        *("bias u / px", "bias v / px", "scatter u / px", "scatter v / px"),
        *("median / px", "95th percentile / px"),
    )
    count = f"{len(experiment.points)} dots at {len(experiment.positions_mm)} stage positions"
    return Table("Detected centres", columns, (row,), f"{count}, against projected true centres.")


def _methods(comparison: Comparison) -> Table:
    columns = ("method", "RMS x / µm", "RMS y / µm", "RMS z / µm", "3-D RMS / µm", "answers / %")
    note = f"On {len(comparison.held_out)} of {comparison.planes} heights, held out of every fit."
    return Table("Methods", columns, tuple(method_rows(comparison)), note)


def _scores(selection: Selection) -> Table:
    columns = (
        *("coordinate", "model", "train RMS / µm", "validation RMS / µm", "validation MAD / µm"),
        *("√residual MS / µm", "CV / µm"),
    )
    rows: list[tuple[Cell, ...]] = []
    for name, form, selected, *errors in score_rows(selection):
        rows.append((name, f"{form}, selected" if selected else form, *errors))
    return Table(
        "All models",
        columns,
        tuple(rows),
        f"Selected by {criterion(selection)}; without the points left out, but MAD.",
    )


def _coefficients(selection: Selection) -> Table:
    """Return table 12: coefficients in raw pixels, a term a row."""
    coefficients = selection.model.raw_coefficients()
    terms = max(coefficients.values(), key=len)
    rows = tuple(
        (term, *(f"{c[term]:.6g}" if term in c else None for c in coefficients.values()))
        for term in terms
    )
    name = "Coefficients (thesis table 12)"
    return Table(name, ("term", *coefficients), rows, "In raw pixels; coordinates in mm.")


def _cloud(points: CalibrationPoints, selection: Selection) -> Cloud:
    """Return the points as the model has them, coloured by what it is off."""
    predicted = selection.model.predict(points.inputs(selection.model.axes))
    residual = predicted - points.world
    # Points left out have a table of their own: here they would rule the colours.
    kept = np.setdiff1d(np.arange(len(points)), gross_rows(selection))
    predicted, residual, points = predicted[kept], residual[kept], points.select(kept)
    # One unit for all: they are compared with each other.
    unit = length_unit(np.percentile(np.abs(residual), 98.0))
    residual *= unit.per_mm
    colours = {
        f"residual of {name} / {unit.name}": residual[:, k]
        for k, name in ((2, "z"), (0, "x"), (1, "y"))
    }
    colours[f"residual in space / {unit.name}"] = np.linalg.norm(residual, axis=1)
    caption = (
        "Markings where the model puts them, training and validation, without those left out; "
        "truth: nominal places."
    )
    return Cloud("Calibration points", predicted, colours, points.world, caption)
