"""What a selection of calibration models found, in tables and sentences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.grouped import LEAST_POSITIONS
from slbench.calibration.models.model import CalibrationModel
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.scales import GROSS
from slbench.calibration.selection import Selection
from slbench.core.show.document import Cell, Table

Array = NDArray[np.float64]

_UM = 1e3
#: A panel coordinate that is off by less is no wrong fringe order, px.
_ORDER_PX = 3.0
#: Share of a point's error that its panel coordinate has to explain.
_EXPLAINED = 0.95
#: Share of points left out beyond which the fit is not known to be safe.
_WITHSTOOD = 0.2
#: Rows of the table of points left out.
_LISTED = 50


def score_rows(
    selection: Selection,
) -> list[tuple[str, str, bool, float, float, float, float, float]]:
    """Return every model's errors (thesis figs. 30-32), um.

    Coordinate, form, whether it is selected, training RMS, validation RMS without gross points and
    MAD with them, root of the residual mean square, error of points or positions left out.
    """
    return [
        (
            name,
            form,
            selection.selected[name] == form,
            _UM * score.train_rms,
            _UM * score.validation_rms_robust,
            _UM * score.validation_mad,
            _UM * score.residual_ms**0.5,
            _UM * score.predictive,
        )
        for name, forms in selection.scores.items()
        for form, score in forms.items()
    ]


def score_table(selection: Selection) -> Table:
    """Return every model's errors as a table; an asterisk marks the selected ones."""
    rows: list[tuple[Cell, ...]] = []
    for name, form, selected, *errors in score_rows(selection):
        rows.append((f"{name} {form}{' *' if selected else ''}", *errors))
    columns = ("model", "train RMS", "validation RMS", "validation MAD", "√residual MS", "CV")
    name = f"errors / µm; * selected by {criterion(selection)}"
    if len(gross_rows(selection)):
        name += "; without points left out, but MAD"
    return Table(name, columns, tuple(rows))


def criterion(selection: Selection) -> str:
    """Return what the forms were selected by."""
    if selection.positions is None:
        return "the least CV, of single points left out"
    return "the CV of whole positions left out"


def position_note(points: CalibrationPoints, selection: Selection) -> str:
    """Return a sentence on what was left out together, and what that means."""
    if selection.positions is not None:
        held = (
            0 if points.position is None else len(np.unique(points.position[selection.validation]))
        )
        return f"Whole positions are left out: {selection.positions} train, {held} validate"
    if points.position is None:
        cause = (
            "No positions are known (a column 'position', the same number for all points of one)"
        )
    else:
        count = len(np.unique(points.position))
        cause = f"{count} positions are too few to leave out whole ones ({LEAST_POSITIONS} are not)"
    return f"{cause}: single points are left out, as if the stage's error were each point's own"


def panel_errors(
    model: CalibrationModel, points: CalibrationPoints, steps: int = 4
) -> tuple[Array, Array]:
    """Return by how much u_p of points is off, if it alone is, and the share that this explains.

    Newton steps along u_p to the point of the model that is nearest in world coordinates, in
    units of each coordinate's deviation.

    Parameters
    ----------
    model : CalibrationModel
    points : CalibrationPoints
    steps : int

    Returns
    -------
    (n,) float
        px, given less right.
    (n,) float
        1 where the rest of the error is nothing beside what u_p explains.
    """
    inputs = points.inputs(model.axes).copy()
    unit = np.array([max(one.residual_std, 1e-12) for one in model.coordinates])
    before = (points.world - model.predict(inputs)) / unit
    for _ in range(steps):
        error = (points.world - model.predict(inputs)) / unit
        slope = model.gradient(inputs)[:, :, 2] / unit
        steep = np.maximum(np.einsum("nk,nk->n", slope, slope), 1e-300)
        inputs[:, 2] += np.einsum("nk,nk->n", slope, error) / steep
    after = (points.world - model.predict(inputs)) / unit
    size = np.maximum(np.linalg.norm(before, axis=1), 1e-300)
    return points.inputs(model.axes)[:, 2] - inputs[:, 2], 1.0 - np.linalg.norm(
        after, axis=1
    ) / size


def gross_rows(selection: Selection) -> NDArray[np.intp]:
    """Return the rows of the points that were left out, in training or validation, ascending."""
    return np.sort(np.concatenate((selection.gross, selection.gross_validation)))


def gross_note(points: CalibrationPoints, selection: Selection) -> str:
    """Return a sentence on how many points were left out, and what may be wrong with them."""
    rows = gross_rows(selection)
    note = f"{len(rows)} of {len(points)} points left out"
    note += f" ({len(selection.gross)} of {len(selection.train)} that train): off by more than "
    note += f"{GROSS:g} deviations"
    if len(rows) == 0:
        return note
    off, explained = panel_errors(selection.model, points.select(rows))
    wrong = (explained > _EXPLAINED) & (np.abs(off) > _ORDER_PX)
    if 2 * np.count_nonzero(wrong) > len(rows):
        size = float(np.median(np.abs(off[wrong])))
        note += f"; their panel coordinate is {size:.3g} px off (a wrong fringe order?)"
    if len(rows) > _WITHSTOOD * len(points):
        note += (
            f". More than {100 * _WITHSTOOD:g} % are more than the fit is known to withstand: "
            "mend the points (decoding, numbering, another rig?) before the model is used"
        )
    return note


def gross_table(points: CalibrationPoints, selection: Selection) -> Table:
    """Return the points that were left out, the farthest first."""
    rows = gross_rows(selection)
    some = points.select(rows)
    off, explained = panel_errors(selection.model, some)
    error = _UM * (selection.model.predict(some.inputs(selection.model.axes)) - some.world)
    order = np.argsort(-np.linalg.norm(error, axis=1), kind="stable")[:_LISTED]
    train = np.isin(rows, selection.gross)
    cells: list[tuple[Cell, ...]] = [
        (
            int(rows[i]) + 1,
            None if some.position is None else int(some.position[i]),
            "training" if train[i] else "validation",
            *some.pixels[i, :3].tolist(),
            *error[i].tolist(),
            float(off[i]) if explained[i] > _EXPLAINED else None,
        )
        for i in order.tolist()
    ]
    columns = (
        *("row", "position", "set", "u_c / px", "v_c / px", "u_p / px"),
        *("x off / µm", "y off / µm", "z off / µm", "u_p off / px"),
    )
    note = gross_note(points, selection) + "."
    if len(rows) > _LISTED:
        note += f" The farthest {_LISTED} are listed."
    return Table("Points left out", columns, tuple(cells), note)


def not_converged(selection: Selection) -> list[str]:
    """Return a sentence for each model whose robust fit did not converge."""
    return [
        f"{name}, {form}: not converged in {score.iterations} iterations"
        for name, forms in selection.scores.items()
        for form, score in forms.items()
        if not score.converged
    ]
