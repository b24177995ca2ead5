"""The tasks of the leaderboard: what is given, what is to be predicted, what an error is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slbench.leaderboard.scenes import FRINGES, SHIFTS, TURN, Array, Scene


@dataclass(frozen=True)
class Task:
    """A map (V, U) that is to be predicted of each scene.

    Parameters
    ----------
    name : str
    title : str
    frames : tuple of int
        The frames that may be used.
    unit : str
        Of prediction and error.
    bad : tuple of float
        The x of BAD-x, the share of the pixels whose error is more than x, or that have no
        prediction.
    target : callable
        From a scene to what is right, (V, U); NaN where nothing is asked for.
    cyclic : bool
        Whether errors are those of angles.
    whole : bool
        Whether predictions are whole numbers.
    """

    name: str
    title: str
    frames: tuple[int, ...]
    unit: str
    bad: tuple[float, ...]
    target: Callable[[Scene], Array]
    cyclic: bool = False
    whole: bool = False

    def errors(self, predicted: Array, target: Array) -> Array:
        """Return the absolute errors of predictions, NaN where there is none."""
        difference = np.abs(predicted - target)
        if self.cyclic:
            difference = np.mod(difference, TURN)
            difference = np.minimum(difference, TURN - difference)
        return np.asarray(difference)


def absolute_turns(scene: Scene) -> Array:
    """Return the true phase of the 32 fringes in turns, (V, U); NaN where there is no surface."""
    return np.asarray((scene.truth.panel[..., 0] + 0.5) * (FRINGES / scene.panel_width))


def _depth(scene: Scene) -> Array:
    return np.where(scene.truth.lit, scene.truth.depth, np.nan)


def _orders(scene: Scene) -> Array:
    """Return what the phase of frames 3 to 5 lacks, in turns: the nearest whole number."""
    turns = absolute_turns(scene) - scene.phase / TURN
    return np.where(scene.truth.lit, np.rint(turns), np.nan)


def _phase(scene: Scene) -> Array:
    return np.where(scene.truth.lit, np.mod(absolute_turns(scene), 1.0) * TURN, np.nan)


def _hidden_depth(scene: Scene) -> Array:
    """Return the depth of surfaces that the decoded depth does not cover."""
    return np.where(np.isnan(scene.decoded_depth), scene.truth.depth, np.nan)


_ALL = tuple(range(2 * SHIFTS))
TASKS: dict[str, Task] = {
    task.name: task
    for task in (
        Task("depth-1", "Depth from one picture", (SHIFTS,), "mm", (0.1, 1.0), _depth),
        Task("depth-6", "Depth from six pictures", _ALL, "mm", (0.1, 1.0), _depth),
        Task("orders", "Fringe orders", _ALL, "orders", (0.5,), _orders, whole=True),
        Task("phase", "Denoised phase", _ALL[SHIFTS:], "rad", (0.1, 0.5), _phase, cyclic=True),
        Task("completion", "Completed depth", _ALL, "mm", (0.1, 1.0), _hidden_depth),
    )
}
