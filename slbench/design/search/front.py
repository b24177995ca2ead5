"""Fronts of multi-objective problems: the value a search returns, and how good it is.

All objectives are minimised.  A point *dominates* another when it is at most as large in
every objective and smaller in one; a *front* is a set of points none of which is dominated.
Hypervolume and domination come from the moocore library.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import moocore
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.io import read_npz, write_npz
from slbench.core.show.display import brief
from slbench.core.validation.types import LARGEST

FloatArray = NDArray[np.float64]

#: Why a search ended: every step below the tolerance, no evaluations left, or by request;
#: "running" in the fronts that progress functions see.
STOPS = ("tolerance", "budget", "interrupted", "running")


@dataclass(frozen=True)
class History:
    """How a search went, one row a batch that was evaluated.

    Parameters
    ----------
    evaluations : (b,) ndarray of int
        Evaluations of the objectives so far.
    size : (b,) ndarray of int
        Points of the front.
    step : (b,) ndarray of float
        Largest step of the front's points, fraction of the box; 0 while there is none.
    """

    evaluations: NDArray[np.int64]
    size: NDArray[np.int64]
    step: FloatArray


@dataclass(frozen=True, eq=False)
class Front:
    """Nondominated feasible points, and what a search needs to go on from them.

    The points stand in the order of the search's list, which decides ties when it resumes.
    Arrays are read-only.

    Parameters
    ----------
    x : (k, d) ndarray
        Design variables, in the caller's units.
    f : (k, m) ndarray
        Objectives there, in the caller's units; (0, 0) when no point is known.
    unit : (k, d) ndarray
        `x` scaled to the unit cube: ``x = lower + (upper - lower) unit``.
    step : (k,) ndarray
        Step with which each point is polled next, fraction of the box.
    lower, upper : (d,) ndarray
        Bounds of the design variables.
    evaluations : int
        Points at which the objectives were evaluated.
    history : History
        How the search went.
    stopped : {"tolerance", "budget", "interrupted", "running"}
        Why it ended.
    seen : (s, d) ndarray
        Points of the unit cube that have been tried, feasible or not.
    """

    x: FloatArray
    f: FloatArray
    unit: FloatArray
    step: FloatArray
    lower: FloatArray
    upper: FloatArray
    evaluations: int
    history: History
    stopped: str
    seen: FloatArray = field(repr=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        for array in (self.x, self.f, self.unit, self.step, self.seen):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.x)

    def save(self, path: str | Path) -> None:
        """Write as ``.npz`` without pickles, bit for bit; :func:`load` reads it.

        Parameters
        ----------
        path : str or Path
            The file; its suffix must be ``.npz``.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        history = self.history
        write_npz(
            path,
            **{name: getattr(self, name) for name in (*_ARRAYS, "stopped")},
            evaluations=np.int64(self.evaluations),
            history=np.column_stack((history.evaluations, history.size, history.step)),
        )

    @classmethod
    def load(cls, path: str | Path) -> "Front":
        """Read what :meth:`save` wrote.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Front
            The same front, bit for bit.

        Raises
        ------
        InputError
            If the file is missing or corrupt, or does not hold a front.
        """
        names = (*_ARRAYS, "stopped", "evaluations", "history")
        arrays = read_npz(path, names)
        for name in names:
            if name not in arrays:
                raise InputError(path, f"a front, with the array {name!r}", "none of that name")
        try:
            values = {name: arrays[name].astype(np.float64) for name in (*_ARRAYS, "history")}
            evaluations = int(arrays["evaluations"])
        except (ValueError, TypeError, OverflowError) as error:
            raise InputError(path, "a front, of numbers", error) from error
        stopped = str(arrays["stopped"])
        _check_loaded(path, values, evaluations, stopped)
        log = values.pop("history")
        history = History(log[:, 0].astype(np.int64), log[:, 1].astype(np.int64), log[:, 2])
        return cls(**values, evaluations=evaluations, history=history, stopped=stopped)


_ARRAYS = ("x", "f", "unit", "step", "lower", "upper", "seen")


def _check_loaded(
    path: str | Path, values: dict[str, FloatArray], evaluations: int, stopped: str
) -> None:
    """Refuse a file whose arrays do not fit each other."""
    k, d = values["x"].shape[0] if values["x"].ndim else 0, values["lower"].size
    m = values["f"].shape[-1] if values["f"].ndim else 0
    shapes = {
        "x": (k, d),
        "f": (k, m),
        "unit": (k, d),
        "step": (k,),
        "lower": (d,),
        "upper": (d,),
        "seen": (values["seen"].shape[0] if values["seen"].ndim else 0, d),
        "history": (values["history"].shape[0] if values["history"].ndim else 0, 3),
    }
    for name, shape in shapes.items():
        if values[name].shape != shape:
            raise InputError(f"{path}: {name}", f"shape {shape}", values[name].shape)
        if not (np.abs(values[name]) <= LARGEST).all():
            raise InputError(f"{path}: {name}", f"numbers up to {LARGEST:g}", "others")
    if (values["unit"] < 0).any() or (values["unit"] > 1).any():
        raise InputError(f"{path}: unit", "numbers in [0, 1]", "others")
    if (values["step"] <= 0).any() or (values["step"] > 1).any():
        raise InputError(f"{path}: step", "numbers in (0, 1]", "others")
    if evaluations < 0 or stopped not in STOPS:
        raise InputError(path, f"evaluations >= 0, stopped in {STOPS}", (evaluations, stopped))


def nondominated(f: ArrayLike) -> NDArray[np.bool_]:
    """Return a mask of nondominated points; of equal points, only the first counts.

    Parameters
    ----------
    f : (n, m) array_like
        Objectives, to be minimised; finite.

    Returns
    -------
    (n,) ndarray of bool
        Where a point is nondominated.

    Raises
    ------
    InputError
        If `f` is not a finite (n, m) array, m >= 1.
    """
    values = _objectives("f", f)
    if len(values) == 0:
        return np.zeros(0, dtype=bool)
    if values.shape[1] == 1:  # the library wants two objectives or more
        first = np.zeros(len(values), dtype=bool)
        first[np.argmin(values[:, 0])] = True
        return first
    return np.asarray(moocore.is_nondominated(values), dtype=bool)


def hypervolume(f: ArrayLike, reference: ArrayLike) -> float:
    """Exact volume that a front dominates, up to a reference point.

    Points that do not lie below the reference in every objective add nothing.

    Parameters
    ----------
    f : (n, m) array_like
        Objectives, to be minimised; dominated points make no difference.
    reference : (m,) array_like
        Reference point.

    Returns
    -------
    float
        Hypervolume, in the product of the objectives' units; 0 for an empty front.

    Raises
    ------
    InputError
        If `f` is not a finite (n, m) array or the reference does not fit it.
    """
    corner = np.asarray(reference, dtype=np.float64)
    if corner.ndim != 1 or corner.size == 0 or not np.isfinite(corner).all():
        raise InputError("reference", "one finite number an objective", _shown(corner))
    if np.size(f) == 0:
        return 0.0
    values = _objectives("f", f)
    if values.shape[1] != corner.size:
        raise InputError("reference", f"{values.shape[1]} numbers", corner.size)
    if corner.size == 1:
        return float(max(0.0, corner[0] - values.min()))
    return float(moocore.hypervolume(values, ref=corner))


def _objectives(where: str, f: ArrayLike) -> FloatArray:
    values = np.asarray(f, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] == 0:
        raise InputError(where, "an (n, m) array, m >= 1", _shown(values))
    if not np.isfinite(values).all():
        raise InputError(where, "finite objectives", "NaN or infinity")
    return values


def _shown(values: NDArray[Any]) -> str:
    return str(values) if values.size <= 4 else f"shape {values.shape}"
