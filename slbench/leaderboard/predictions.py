"""A folder of predictions: ``TASK/000123.npy`` or ``TASK/000123.exr``, a file a scene.

A map is (V, U), real; NaN: no prediction.  An EXR has one channel, of any name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slbench.core.errors import InputError
from slbench.core.io import read_exr
from slbench.core.io.arrays import read_npy
from slbench.core.registry import quoted
from slbench.leaderboard.scenes import Array
from slbench.leaderboard.tasks import TASKS

SUFFIXES = (".npy", ".exr")
_NAME = re.compile(r"[0-9]{6,}")


@dataclass(frozen=True)
class Predictions:
    """What somebody predicts.

    Parameters
    ----------
    name : str
        Of the entry.
    files : dict of task to dict of key to Path
    """

    name: str
    files: dict[str, dict[str, Path]]

    def read(self, task: str, key: str, shape: tuple[int, int]) -> Array:
        """Return a scene's map, (V, U) float64.

        Raises
        ------
        InputError
            If the file is damaged, of another shape, or holds what is no real number, or no whole
            one where these are asked for.
        """
        path = self.files[task][key]
        if path.suffix == ".exr":
            channels = read_exr(path, shape)
            if len(channels) != 1:
                raise InputError(path, "one channel", ", ".join(sorted(channels)) or "none")
            array = next(iter(channels.values()))
        else:
            array = read_npy(path)
        if array.shape != shape:
            raise InputError(path, f"shape {shape}, (V, U)", array.shape)
        if array.dtype.kind not in "fiu":
            raise InputError(path, "real numbers", array.dtype)
        values = array.astype(np.float64)
        if np.isinf(values).any():
            raise InputError(path, "finite numbers, or NaN for no prediction", "infinite ones")
        if TASKS[task].whole and np.any(odd := np.isfinite(values) & (values != np.rint(values))):
            # Between two of them a prediction would be half right about both.
            raise InputError(path, "whole numbers, or NaN for no prediction", values[odd][0])
        return values


def read_predictions(folder: str | Path, keys: Sequence[str]) -> Predictions:
    """Find the predictions in a folder; which tasks it has is which it enters.

    Parameters
    ----------
    folder : str or Path
        Its name is the entry's.
    keys : sequence of str
        Of all scenes.

    Raises
    ------
    InputError
        If there is no task, one that is none, or a task that lacks scenes or has others.
    """
    place = Path(folder)
    if not place.is_dir():
        raise InputError(place, "a folder of predictions", "no folder of that name")
    found = sorted(path for path in place.iterdir() if path.is_dir() and path.name[0] != ".")
    known = list(TASKS)
    for path in found:
        if path.name not in TASKS:
            raise InputError(place, f"folders {', '.join(known)}", quoted(path.name, known))
    if not found:
        raise InputError(place, f"a folder of a task: {', '.join(known)}", "none")
    return Predictions(place.resolve().name, {path.name: _files(path, keys) for path in found})


def _files(folder: Path, keys: Sequence[str]) -> dict[str, Path]:
    files: dict[str, Path] = {}
    wanted = set(keys)
    for path in sorted(folder.iterdir()):
        if path.suffix not in SUFFIXES:
            continue
        if path.stem not in wanted:
            near = "" if _NAME.fullmatch(path.stem) else " (the scene's key, six digits)"
            expected = f"{keys[0]} to {keys[-1]}, .npy or .exr{near}"
            raise InputError(folder, expected, path.name)
        if path.stem in files:
            raise InputError(folder, f"one file of {path.stem}", "an .exr and an .npy")
        files[path.stem] = path
    missing = [key for key in keys if key not in files]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(folder, f"a file for each of {len(keys)} scenes", f"no {missing[0]}{more}")
    return files
