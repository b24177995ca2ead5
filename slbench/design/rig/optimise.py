"""The rig optimiser: search, cluster, recommend (thesis 3.2, and 5.2 for microscopes).

Direct MultiSearch, or NSGA-II, minimises the objectives of thesis eq. 20 over the design variables,
subject to g1..g6:

* ``error``: ``mu sigma``, mean times standard deviation of the expected error, mm^2;
* ``coverage``: ``-eta N_s``, share of the panel used times number of points;
* ``dispersion``: ``-d``, distance between neighbouring points, mm.

For a microscope (``micro``, thesis 5.2) there is one objective, ``volume``: minus the cube root
of the volume of the largest box, mm, of which each point is in focus for both devices at some
setting of the hardware's sweep.  It takes the place of g3, that the given volume be in focus.

The front is clustered by its design variables, and each cluster's member nearest to its
centroid represents it.  **Recommended** is the representative nearest to the ideal point, at
which each objective has its best value (compromise programming, Zeleny 1973).  Objectives are
compared by their ranks over the front, 0 the best and 1 the worst, as their values have long
tails: a single rig with a hopeless error would make all others look alike.  Any other
representative may be picked by its number.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, get_args

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import differential_evolution
from scipy.stats import rankdata

from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.design.rig.constraints import CONSTRAINTS, Constraints, diagnose
from slbench.design.rig.evaluate import Evaluation, Evaluator
from slbench.design.rig.hardware import Hardware, Placement
from slbench.design.rig.volume import largest_box
from slbench.design.search import multisearch, nsga2
from slbench.design.search.clustering import Clusters, cluster_front
from slbench.design.search.front import Front
from slbench.design.search.positions import row_keys
from slbench.rig import Pose

Array = NDArray[np.float64]

OBJECTIVES = ("error", "coverage", "dispersion")
#: What searches.
Solver = Literal["multisearch", "nsga2"]


@dataclass(frozen=True, eq=False)
class RigDesign:
    """What the optimiser found.

    Parameters
    ----------
    hardware : Hardware
    objectives : tuple of str
        Names of the columns of ``front.f``.
    front : Front
        Design variables in mm and rad.
    evaluation : Evaluation
        Metrics and margins of the front's members.
    clusters : Clusters
    recommended : int
        Number of the recommended cluster.
    seconds : float
        Time that the search took.
    """

    hardware: Hardware
    objectives: tuple[str, ...]
    front: Front
    evaluation: Evaluation
    clusters: Clusters
    recommended: int
    seconds: float

    __repr__ = brief

    def member(self, cluster: int | None = None) -> int:
        """Return the front's member that represents a cluster (default: the recommended).

        Raises
        ------
        InputError
            If there is no such cluster.
        """
        number = self.recommended if cluster is None else cluster
        whole = isinstance(number, (int, np.integer)) and not isinstance(number, bool)
        if not whole or not 0 <= number < len(self.clusters):
            raise InputError("cluster", f"0 to {len(self.clusters) - 1}", number)
        return int(self.clusters.representatives[number])


def optimise(
    hardware: Hardware,
    *,
    objectives: Sequence[str] = OBJECTIVES,
    micro: bool = False,
    max_evaluations: int = 20_000,
    seed: int = 0,
    start: Front | ArrayLike | None = None,
    max_footprint_mm: float | None = None,
    min_angle_deg: float | None = None,
    solver: Solver = "multisearch",
    on_progress: Callable[[Front], object] | None = None,
) -> RigDesign:
    """Search for the best rigs that given hardware can form.

    Parameters
    ----------
    hardware : Hardware
    objectives : sequence of {"error", "coverage", "dispersion"}
        Which to minimise.
    micro : bool
        Maximise the measurement volume instead.
    max_evaluations : int
        Budget of evaluated configurations.
    seed : int
    start : Front or (n, 6 + m) float, optional
        A front to go on from, or configurations (mm, rad) to begin at.  A front found with
        other hardware, objectives or constraints gives its configurations only.
    max_footprint_mm : float, optional
        Largest horizontal extent, along x and along y, of both bodies and the volume.
    min_angle_deg : float, optional
        Smallest triangulation angle.
    solver : {"multisearch", "nsga2"}
        Direct MultiSearch, or NSGA-II (:mod:`slbench.design.search.nsga2`), which draws.
    on_progress : callable, optional
        Called with the front so far after every batch; False ends the search.

    Returns
    -------
    RigDesign
        Of the front so far when interrupted.

    Raises
    ------
    InputError
        If nothing feasible is found, with the constraint that fails, by how much, for the
        least infeasible configuration; or an argument is not as above.
    KeyboardInterrupt
        If interrupted, by Ctrl-C or `on_progress`, ahead of the first rig of the front.

    Warns
    -----
    InputWarning
        If the axis that the hardware codes runs along the recommended rig's epipolar lines.
    """
    names = tuple(objectives)
    unknown = [name for name in names if name not in OBJECTIVES]
    if unknown or not names or len(set(names)) != len(names):
        raise InputError("objectives", f"some of {', '.join(OBJECTIVES)}", ", ".join(names))
    for label, value in (("footprint", max_footprint_mm), ("angle", min_angle_deg)):
        if value is not None and not 0 < value < np.inf:
            raise InputError(f"constraint on {label}", "a positive number", value)
    if solver not in get_args(Solver):
        raise InputError("solver", " or ".join(get_args(Solver)), repr(solver))
    columns = [OBJECTIVES.index(name) for name in names]
    binding = [k for k, name in enumerate(CONSTRAINTS) if not (micro and name == "g3")]

    evaluator, constraints, place = Evaluator(hardware), Constraints(hardware), _Placing(hardware)

    def values(x: Array) -> Array:
        if micro:
            return -np.cbrt(np.prod(largest_box(hardware, x), axis=1))[:, None]
        return evaluator.objectives(place(x))[:, columns]

    def spare(x: Array, *, exact: bool = True) -> Array:
        placement = place(x)
        parts = [constraints.margins(placement, exact=exact)[:, binding]]
        if min_angle_deg is not None:
            parts.append(np.rad2deg(placement.angle)[:, None] - min_angle_deg)
        if max_footprint_mm is not None:
            parts.append(max_footprint_mm - footprint_mm(hardware, placement)[:, None])
        return np.concatenate(parts, axis=1)

    def feasible(x: Array) -> NDArray[np.bool_]:
        return np.all(spare(x, exact=False) > 0, axis=1)

    begin = time.perf_counter()
    if micro and start is None and solver == "multisearch":
        start = _large_volume(hardware, values, spare, seed)
    try:
        with _one_thread():
            if isinstance(start, Front):
                start = _usable(start, values, feasible, len(hardware.variables))
            if solver == "nsga2":
                front = nsga2.minimize(
                    values,
                    *hardware.bounds,
                    lambda x: spare(x, exact=False),
                    max_evaluations=max_evaluations,
                    seed=seed,
                    on_progress=on_progress,
                    n_objectives=1 if micro else len(names),
                    start=start,
                )
            else:
                front = multisearch.minimize(
                    values,
                    *hardware.bounds,
                    feasible,
                    max_evaluations=max_evaluations,
                    seed=seed,
                    on_progress=on_progress,
                    start=start,
                )
    except InputError as error:
        if error.where != "constraints":
            raise
        limits = {"footprint_mm": max_footprint_mm, "angle_deg": min_angle_deg}
        raise _nothing_feasible(hardware, limits) from None
    if not len(front):
        if front.stopped == "interrupted":
            raise KeyboardInterrupt
        raise InputError(
            "evaluations",
            "enough to find a rig that measures",
            f"{max_evaluations}: {front.evaluations} made, and the next batch needs more",
        )
    seconds = time.perf_counter() - begin
    clusters = cluster_front(front, seed)
    recommended = _nearest_to_ideal(front.f, clusters)
    best = hardware.place(front.x[[clusters.representatives[recommended]]])
    evaluator.question(best, evaluator.evaluate(best))
    return RigDesign(
        hardware,
        ("volume",) if micro else names,
        front,
        evaluator.evaluate(hardware.place(front.x)),
        clusters,
        recommended,
        seconds,
    )


class _Placing:
    """Places configurations; those placed last, or some of them, are not placed again.

    A search asks for the objectives of configurations whose constraints it has just asked for.
    """

    def __init__(self, hardware: Hardware) -> None:
        self._place = hardware.place
        self._rows: dict[bytes, int] = {}
        self._last: Placement | None = None

    def __call__(self, x: Array) -> Placement:
        keys = row_keys(x)
        if self._last is None or not all(key in self._rows for key in keys):
            self._last = self._place(x)
            self._rows = {key: row for row, key in enumerate(keys)}
        return self._last.of([self._rows[key] for key in keys])


def _large_volume(
    hardware: Hardware,
    values: Callable[[Array], Array],
    spare: Callable[..., Array],
    seed: int,
) -> Array | None:
    """Return a configuration of large volume to begin at, (1, 6), or None if none is feasible.

    With one objective the multisearch polls around a single point, and narrow working
    distances couple the variables so that steps along one of them lead nowhere.  Differential
    evolution, which moves in all of them, finds the basin; the multisearch then polishes.
    """
    devices = (hardware.camera, hardware.projector)
    barrels = any(device.barrel_mm is not None for device in devices)

    def cost(columns: Array) -> Array:
        x = columns.T
        # The depth to which barrels overlap is not worth its time here.
        margins = spare(x, exact=not barrels)
        violation = np.maximum(-np.nan_to_num(margins, neginf=-1e6), 0.0).sum(axis=1)
        good = np.all(margins > 0, axis=1)
        result = np.asarray(1.0 + violation, dtype=np.float64)
        if good.any():
            result[good] = values(x[good])[:, 0]
        return result

    found = differential_evolution(
        cost,
        np.column_stack(hardware.bounds),
        rng=seed,
        popsize=30,
        maxiter=150,
        tol=1e-6,
        polish=False,
        vectorized=True,
        updating="deferred",
    )
    return np.atleast_2d(found.x) if found.fun < 0 else None


def footprint_mm(hardware: Hardware, placement: Placement) -> Array:
    """Return the larger horizontal extent of bodies and volume for each configuration, (n,)."""
    low = np.full((len(placement.valid), 2), -np.array(hardware.volume_mm[:2]) / 2.0)
    high = -low
    for device, rotation, position in (
        (hardware.camera, placement.camera_rotation, placement.camera_position),
        (hardware.projector, placement.projector_rotation, placement.projector_position),
    ):
        if device.barrel_mm is not None:
            behind, radii = np.transpose(device.barrel_mm)
            middles = position[:, None, :2] - behind[:, None] * rotation[:, None, :2, 2]
            # A disc reaches as far along an axis as that axis is across the barrel's.
            across = np.sqrt(np.clip(1.0 - rotation[:, :2, 2] ** 2, 0.0, None))
            reach = radii[:, None] * across[:, None]
            ends = np.concatenate((middles - reach, middles + reach), axis=1)
        else:
            local = device.posed(Pose()).body_corners
            ends = (local @ np.swapaxes(rotation, 1, 2) + position[:, None])[..., :2]
        low = np.fmin(low, ends.min(axis=1))
        high = np.fmax(high, ends.max(axis=1))
    return np.asarray((high - low).max(axis=1), dtype=np.float64)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Evaluate on one core: a poll is a dozen configurations.

    Two cores save a fifth of the time while they are idle, and cost a multiple of it, waiting
    for each other at the end of every poll, when anything else runs.
    """
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def _usable(
    front: Front,
    values: Callable[[Array], Array],
    feasible: Callable[[Array], NDArray[np.bool_]],
    count: int,
) -> Front | Array:
    """Return a front to go on from; of one that does not fit this search, its configurations."""
    if not len(front) or front.x.shape[1] != count:
        return front
    if np.all(feasible(front.x)):
        f = values(front.x)
        if f.shape == front.f.shape and np.allclose(f, front.f, rtol=1e-6, atol=0.0):
            return front
    return front.x


def _nothing_feasible(hardware: Hardware, limits: dict[str, float | None]) -> InputError:
    diagnosis = diagnose(hardware)
    given = [f"{name} {value:g}" for name, value in limits.items() if value is not None]
    if not diagnosis.feasible or not given:
        return InputError("hardware", "a feasible configuration", diagnosis)
    return InputError(
        "constraints",
        "a feasible configuration",
        f"none found within the limits {', '.join(given)}; without them: {diagnosis}",
    )


def _nearest_to_ideal(f: Array, clusters: Clusters) -> int:
    rank = (rankdata(f, axis=0) - 1.0) / max(len(f) - 1, 1)
    return int(np.argmin(np.linalg.norm(rank[clusters.representatives], axis=1)))
