"""The captures of a calibration experiment on disk, as a laboratory has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.target.stage import POSITIONS
from slbench.capture.stack import FocusStack
from slbench.core.errors import InputError
from slbench.core.io import OutputFolder, write_table
from slbench.scene.model import Scene

_FOLDER = OutputFolder("calibration captures", ("positions.csv", "stage*"))
#: Rotations that a plate without a turn may be off by rounding.
_ROUNDING = 1e-12


@contextmanager
def kept(
    folder: Path | None, scene: Scene, positions_mm: NDArray[np.float64], seed: int
) -> Iterator[Callable[[int, FocusStack], None] | None]:
    """Give what writes the captures of stage positions; the folder appears when the block succeeds.

    Parameters
    ----------
    folder : Path or None
        Gets ``stage000``, ... and ``positions.csv``, the plate's nominal place at each; None
        keeps nothing.
    scene : Scene
        Its first object is the plate.
    positions_mm : (m, 3) float
    seed : int

    Raises
    ------
    InputError
        If the plate is turned against the stage, which the files have no word for.
    """
    if folder is None:
        yield None
        return
    pose = scene.objects[0].pose
    if np.abs(pose.rotation - np.eye(3)).max() > _ROUNDING:
        expected = "a plate that is not turned, to keep its captures"
        raise InputError(f"scene {scene.name}: objects[0]", expected, "a turned one")
    with _FOLDER.writing(folder, {"scene": scene.specification}, seed) as temporary:
        write_table(temporary / "positions.csv", POSITIONS, positions_mm + pose.position)

        def keep(position: int, stack: FocusStack) -> None:
            place = temporary / f"stage{position:03d}"
            single = stack.focus is None and len(stack) == 1
            (stack.captures[0] if single else stack).write_into(place)

        yield keep
