"""Scores of predictions: per scene, then the mean of scenes with its interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slbench.bench.statistics import bootstrap_interval
from slbench.core.show.document import Table
from slbench.leaderboard.baselines import BASELINES
from slbench.leaderboard.board import Board
from slbench.leaderboard.predictions import Predictions
from slbench.leaderboard.scenes import Array, Scene
from slbench.leaderboard.tasks import TASKS, Task

#: Of the bootstrap's draws: scenes that are drawn are the same for all entries.
_SEED = 0

#: What predicts: name, tasks, and a function from task and scene to a map.
Predictor = tuple[str, Sequence[str], Callable[[str, Scene], Array]]


@dataclass(frozen=True)
class Result:
    """Scores of an entry in a task.

    Parameters
    ----------
    entry, task : str
    scenes : dict of metric to (n,) float
        A number a scene; NaN where there is none.
    """

    entry: str
    task: str
    scenes: dict[str, Array]

    def mean(self, metric: str) -> float:
        """Return the mean over the scenes that have the metric, NaN where none has."""
        return _mean(self.scenes[metric])

    def interval(self, metric: str) -> tuple[float, float]:
        """Return the 95 % percentile interval of the mean, scenes drawn with replacement."""
        values = self.scenes[metric]
        values = values[np.isfinite(values)]
        if len(values) < 2:
            return (float("nan"), float("nan"))
        if np.ptp(values) == 0.0:
            return float(values[0]), float(values[0])
        return bootstrap_interval(lambda drawn: _mean(values[drawn]), len(values), _SEED)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        metrics = {}
        for name in self.scenes:
            low, high = self.interval(name)
            counted = int(np.count_nonzero(np.isfinite(self.scenes[name])))
            metrics[name] = {"mean": self.mean(name), "low": low, "high": high, "scenes": counted}
        return {"entry": self.entry, "task": self.task, "metrics": metrics}


def of_folder(predictions: Predictions) -> Predictor:
    """Return what reads predictions from files."""

    def predict(task: str, scene: Scene) -> Array:
        return predictions.read(task, scene.key, scene.shape)

    return predictions.name, list(predictions.files), predict


def of_baseline(name: str) -> Predictor:
    """Return what makes the predictions of a baseline."""
    baseline = BASELINES[name]
    return name, list(baseline), lambda task, scene: baseline[task](scene)


def score_entries(
    board: Board,
    entries: Sequence[Predictor],
    on_progress: Callable[[float], None] | None = None,
) -> list[Result]:
    """Score entries, all of them scene by scene.

    Parameters
    ----------
    board : Board
    entries : sequence of Predictor
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    list of Result
        By task, then in the order of `entries`.

    Raises
    ------
    InputError
        If a prediction cannot be read.
    """
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    for done, scene in enumerate(board, 1):
        for name, task in TASKS.items():
            target = task.target(scene)
            for entry, tasks, predict in entries:
                if name in tasks:
                    metrics = score_map(task, predict(name, scene), target)
                    found.setdefault((entry, name), []).append(metrics)
        if on_progress:
            on_progress(done / len(board))
    results = []
    for name in TASKS:
        for entry, tasks, _ in entries:
            if name in tasks:
                rows = found[entry, name]
                scenes = {key: np.array([row[key] for row in rows]) for key in rows[0]}
                results.append(Result(entry, name, scenes))
    return results


def score_map(task: Task, predicted: Array, target: Array) -> dict[str, float]:
    """Return the metrics of one scene.

    Parameters
    ----------
    task : Task
    predicted : (V, U) float
        NaN: no prediction.
    target : (V, U) float
        NaN: nothing is asked for.

    Returns
    -------
    dict of str to float
        ``mae`` and ``rmse`` over the pixels that are predicted; ``bad-x``, the share of the pixels
        asked for whose error is more than x or that are not predicted; ``completeness``, the
        share of those that are predicted.  NaN where there are no such pixels.
    """
    asked = np.isfinite(target)
    errors = task.errors(predicted[asked], target[asked])
    made = errors[np.isfinite(errors)]
    total = float(errors.size) or np.nan
    metrics = {
        "mae": float(made.mean()) if made.size else np.nan,
        "rmse": float(np.sqrt(np.mean(made**2))) if made.size else np.nan,
    }
    for bad in task.bad:
        metrics[f"bad-{bad:g}"] = (errors.size - np.count_nonzero(made <= bad)) / total
    return metrics | {"completeness": made.size / total}


def tables(results: Sequence[Result]) -> list[Table]:
    """Return a table a task: entries by BAD of the smallest x, best first."""
    made = []
    for name, task in TASKS.items():
        rows = [result for result in results if result.task == name]
        if not rows:
            continue
        first = f"bad-{task.bad[0]:g}"
        rows.sort(key=lambda result: result.mean(first))
        metrics = list(rows[0].scenes)
        columns = ("entry", *(_heading(metric, task.unit) for metric in metrics))
        cells = tuple(
            (result.entry, *(_cell(result, metric) for metric in metrics)) for result in rows
        )
        frames = f"{len(task.frames)} frame{'s' * (len(task.frames) > 1)}"
        made.append(Table(f"{task.title} ({name}, {frames})", columns, cells))
    return made


def _mean(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


def _heading(metric: str, unit: str) -> str:
    if metric in ("mae", "rmse"):
        return f"{metric.upper()}, {unit}"
    return f"BAD-{metric[4:]} {unit}, %" if metric.startswith("bad") else "complete, %"


def _cell(result: Result, metric: str) -> str:
    factor = 1.0 if metric in ("mae", "rmse") else 100.0
    mean, (low, high) = result.mean(metric), result.interval(metric)
    if not np.isfinite(mean):
        return "–"
    return f"{factor * mean:.3g} [{factor * low:.3g}, {factor * high:.3g}]"
