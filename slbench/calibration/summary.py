"""What a selection of calibration models found, in tables and sentences."""

from __future__ import annotations

from slbench.calibration.scales import GROSS
from slbench.calibration.selection import Selection
from slbench.core.show.document import Cell, Table

_UM = 1e3


def score_rows(
    selection: Selection,
) -> list[tuple[str, str, bool, float, float, float, float, float]]:
    """Return every model's errors (thesis figs. 30-32), um.

    Coordinate, form, whether it is selected, training RMS, validation RMS and MAD, root of the
    residual mean square, leave-one-out error without gross points.
    """
    return [
        (
            name,
            form,
            selection.selected[name] == form,
            _UM * score.train_rms,
            _UM * score.validation_rms,
            _UM * score.validation_mad,
            _UM * score.residual_ms**0.5,
            _UM * score.cv_robust,
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
    return Table("errors / µm; * selected by the least CV", columns, tuple(rows))


def gross_note(selection: Selection) -> str:
    """Return a sentence on how many points were left out of the choice, and why."""
    share = f"{len(selection.gross)} of {len(selection.train)} training points"
    return f"{share}, off by more than {GROSS:g} deviations, left out of choice and domain"


def not_converged(selection: Selection) -> list[str]:
    """Return a sentence for each model whose robust fit did not converge."""
    return [
        f"{name}, {form}: not converged in {score.iterations} iterations"
        for name, forms in selection.scores.items()
        for form, score in forms.items()
        if not score.converged
    ]
