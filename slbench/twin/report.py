"""What a calibration experiment found: tables 12 and 13 and figures 30 to 32 of the thesis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.calibration.baselines import Comparison
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.selection import Selection
from slbench.calibration.summary import gross_note, gross_rows, position_note
from slbench.core.io import OutputFolder, atomic_path, write_json, write_table
from slbench.core.show.display import length_unit
from slbench.twin.experiment import Experiment

Array = NDArray[np.float64]

#: Thesis table 13: validation RMS and MAD, um.
THESIS_13 = {"x": (0.44, 0.34), "y": (0.57, 0.46), "z": (1.50, 1.24)}
#: Its last row, the root sum square.
THESIS_13_TOTAL = (1.67, 1.36)
_UM = 1e3


CALIBRATION_FOLDER = OutputFolder(
    "calibration experiment",
    (
        "points.csv",
        "detections.csv",
        "model.json",
        "calibration.json",
        "tables.md",
        "models.png",
        "residuals.png",
    ),
)


def write_points(
    experiment: Experiment, folder: str | Path, parameters: dict[str, Any], seed: int
) -> None:
    """Write what no fit is needed for: points, detections and provenance.

    Parameters
    ----------
    experiment : Experiment
    folder : path
        Gets ``points.csv``, ``detections.csv``, ``provenance.json``.
    parameters : dict
        For the provenance.
    seed : int
    """
    with CALIBRATION_FOLDER.writing(folder, parameters, seed) as temporary:
        _write_points(experiment, temporary)


def write_experiment(
    experiment: Experiment,
    selection: Selection,
    comparison: Comparison | None,
    folder: str | Path,
    parameters: dict[str, Any],
    seed: int,
) -> None:
    """Write points, model, scores, tables, figures and provenance to a folder.

    Parameters
    ----------
    experiment : Experiment
    selection : Selection
        Of the experiment's points.
    comparison : Comparison or None
        With the baselines, where there were heights enough.
    folder : path
        Gets ``points.csv``, ``detections.csv``, ``model.json``, ``calibration.json``,
        ``tables.md``, ``models.png``, ``residuals.png``, ``provenance.json``.
    parameters : dict
        For the provenance.
    seed : int
    """
    with CALIBRATION_FOLDER.writing(folder, parameters, seed) as temporary:
        _write_points(experiment, temporary)
        selection.model.save(temporary / "model.json")
        write_json(temporary / "calibration.json", to_dict(experiment, selection, comparison))
        with atomic_path(temporary / "tables.md") as path:
            text = f"{tables(experiment, selection, comparison)}\n{coefficients(selection)}"
            path.write_text(text, encoding="utf-8")
        pictures = {
            "models": models_figure(selection),
            "residuals": residuals_figure(experiment.points, selection),
        }
        for name, figure in pictures.items():
            FigureCanvasAgg(figure)
            with atomic_path(temporary / f"{name}.png") as path:
                figure.savefig(path, format="png")


def _write_points(experiment: Experiment, folder: Path) -> None:
    experiment.points.write(folder / "points.csv")
    write_table(
        folder / "detections.csv",
        ("position", "error_u_px", "error_v_px"),
        np.column_stack((experiment.position, experiment.detection_px)),
    )


def to_dict(
    experiment: Experiment, selection: Selection, comparison: Comparison | None
) -> dict[str, Any]:
    """Return the outcome as plain values for JSON; lengths in mm, detections in px."""
    error = np.linalg.norm(experiment.detection_px, axis=1)
    return selection.to_dict() | {
        "points": len(experiment.points),
        "positions": len(experiment.positions_mm),
        "positions_without_dots": len(experiment.without_dots),
        "detection": {
            "bias_px": np.median(experiment.detection_px, axis=0),
            "scatter_px": np.std(experiment.detection_px, axis=0),
            "median_px": float(np.median(error)),
            "p95_px": float(np.percentile(error, 95.0)),
            "sampling_px": experiment.sampling_px,
        },
        "baselines": None if comparison is None else comparison.to_dict(),
    }


def tables(experiment: Experiment, selection: Selection, comparison: Comparison | None) -> str:
    """Return table 13 and that of the methods as Markdown, the thesis's numbers beside ours."""
    empty = len(experiment.without_dots)
    lines = [
        f"{len(experiment.points)} dots at {len(experiment.positions_mm)} positions"
        + (f" ({empty} of them without dots)" if empty else "")
        + f"; {len(selection.train)} train, {len(selection.validation)} validate. "
        + f"{position_note(experiment.points, selection)}."
        + (f" {gross_note(experiment.points, selection)}." if len(gross_rows(selection)) else ""),
        "",
        "## Validation errors (thesis table 13), um",
        "",
        "| coordinate | model | RMS | thesis | MAD | thesis |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, form, rms, thesis_rms, mad, thesis_mad in validation_rows(selection):
        lines.append(f"| {name} | {form} | {rms:.3f} | {thesis_rms} | {mad:.3f} | {thesis_mad} |")
    if comparison is not None:
        lines += [
            "",
            f"## Methods on {len(comparison.held_out)} heights held out, um",
            "",
            "| method | RMS x | RMS y | RMS z | 3-D RMS | answers |",
            "| --- | --- | --- | --- | --- | --- |",
        ]
        for method, *errors, share in method_rows(comparison):
            values = " | ".join(f"{value:.3f}" for value in errors)
            lines.append(f"| {method} | {values} | {share:.0f} % |")
    return "\n".join(lines) + "\n"


def coefficients(selection: Selection) -> str:
    """Return table 12 as Markdown, a line a coordinate."""
    lines = ["## Coefficients (thesis table 12) in raw pixels, mm", ""]
    for name, terms in selection.model.raw_coefficients().items():
        text = ", ".join(f"{term}: {value:.6g}" for term, value in terms.items())
        lines.append(f"- {name}: {text}")
    return "\n".join(lines) + "\n"


def validation_rows(selection: Selection) -> list[tuple[str, str, float, float, float, float]]:
    """Return table 13: coordinate, form, RMS, the thesis's, MAD, the thesis's; um.

    The last row is the root sum square over the coordinates.
    """
    rows = []
    for name, score in selection.final.items():
        rms, mad = THESIS_13[name]
        ours = (_UM * score.validation_rms, _UM * score.validation_mad)
        rows.append((name, selection.selected[name], ours[0], rms, ours[1], mad))
    total = selection.isometric
    rms, mad = THESIS_13_TOTAL
    ours = (_UM * total["validation_rms"], _UM * total["validation_mad"])
    return [*rows, ("root sum square", "", ours[0], rms, ours[1], mad)]


def method_rows(comparison: Comparison) -> list[tuple[str, float, float, float, float, float]]:
    """Return each method's RMS in x, y, z and 3-D, um, and its share of answers, per cent."""
    return [
        (
            method,
            _UM * result.rms["x"],
            _UM * result.rms["y"],
            _UM * result.rms["z"],
            _UM * result.rms_3d,
            100.0 * result.measured,
        )
        for method, result in comparison.scores.items()
    ]


def models_figure(selection: Selection) -> Figure:
    """Draw error and selection metrics of every model, as thesis figs. 30-32."""
    figure = Figure(figsize=(13.0, 4.2), dpi=100, layout="constrained")
    for axes, (name, scores) in zip(figure.subplots(1, 3), selection.scores.items(), strict=True):
        forms = list(scores)
        metrics = {
            "training RMS": [s.train_rms for s in scores.values()],
            "validation RMS": [s.validation_rms for s in scores.values()],
            "root residual MS": [s.residual_ms**0.5 for s in scores.values()],
            "CV (" + ("point" if selection.positions is None else "position") + " left out)": [
                s.predictive for s in scores.values()
            ],
        }
        for k, (label, values) in enumerate(metrics.items()):
            places = np.arange(len(forms)) + 0.2 * (k - 1.5)
            axes.bar(places, _UM * np.array(values), 0.2, label=label)
        axes.set_yscale("log")
        axes.set_xticks(np.arange(len(forms)), forms)
        axes.set_ylabel("error / µm")
        axes.set_title(f"{name}: {selection.selected[name]} selected")
        axes.grid(visible=True, axis="y", which="both", alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    return figure


def residuals_figure(data: CalibrationPoints, selection: Selection) -> Figure:
    """Draw residuals of the validation points of `data` over the volume, seen along y."""
    points = data.select(selection.validation)
    residuals = selection.model.predict(points.inputs(selection.model.axes)) - points.world
    figure = Figure(figsize=(13.0, 4.2), dpi=100, layout="constrained")
    field = length_unit(points.world[:, [0, 2]])
    # Wrong points are shown, and do not rule the scale.
    right = ~np.isin(selection.validation, selection.gross_validation)
    right = right if right.any() else ~right
    # One unit for the three: they are compared with each other.
    small = length_unit(np.percentile(np.abs(residuals[right]), 98.0))
    for k, (axes, name) in enumerate(zip(figure.subplots(1, 3), "xyz", strict=True)):
        values = small.per_mm * residuals[:, k]
        limit = max(float(np.percentile(np.abs(values[right]), 98.0)), 1e-6)
        shown = axes.scatter(
            field.per_mm * points.world[:, 0],
            field.per_mm * points.world[:, 2],
            c=values,
            s=14,
            cmap="RdBu_r",
            vmin=-limit,
            vmax=limit,
        )
        axes.set_xlabel(f"x / {field.name}")
        axes.set_ylabel(f"z / {field.name}")
        axes.set_title(f"validation residual of {name}")
        figure.colorbar(shown, ax=axes, label=small.name)
    return figure
