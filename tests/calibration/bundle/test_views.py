"""Captures of boards to views: what is questioned."""

from dataclasses import replace

import numpy as np
from board_views import BOARD, macro_rig, projected_views

from slbench.calibration.bundle.views import size_doubt


def parts(views, columns, rows):
    """Return views that show the first columns and rows alone."""
    column, row = BOARD.nodes.T
    inside = (column < columns) & (row < rows)
    shown = []
    for view in views:
        mask = inside[view.numbers]
        arrays = ("numbers", "pixels", "pixel_sd", "panel", "panel_sd", "gradient")
        shown.append(replace(view, **{name: getattr(view, name)[mask] for name in arrays}))
    return shown


def test_a_size_that_no_folder_shows_is_questioned():
    whole = projected_views(macro_rig(), 4)[1:]
    assert size_doubt(whole) is None
    assert size_doubt([]) is None
    # Parts of the board, each another one.
    assert size_doubt([*parts(whole[:1], 5, 7), *whole[1:]]) is None
    doubt = size_doubt(parts(whole, 8, 6))
    assert doubt is not None
    assert "8 x 6" in doubt


def test_a_point_is_named_by_column_and_row():
    (view, *_) = projected_views(macro_rig(), 3)
    number = int(np.flatnonzero(view.numbers == 23)[0])
    assert view.label(number) == "pose00: point 5, 2"
