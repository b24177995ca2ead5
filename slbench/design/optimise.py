"""The rig optimiser: search, cluster, recommend (thesis 3.2).

Direct MultiSearch minimises the objectives of thesis eq. 20 over the six design variables,
subject to g1..g6:

* ``error``: ``mu sigma``, mean times standard deviation of the expected error, mm^2;
* ``coverage``: ``-eta N_s``, share of the panel used times number of points;
* ``dispersion``: ``-d``, distance between neighbouring points, mm.

The front is clustered by its design variables, and each cluster's member nearest to its
centroid represents it.  **Recommended** is the representative nearest to the ideal point, at
which each objective has its best value (compromise programming, Zeleny 1973).  Objectives are
compared by their ranks over the front, 0 the best and 1 the worst, as their values have long
tails: a single rig with a hopeless error would make all others look alike.  Any other
representative may be picked by its number.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from slbench.design import multisearch
from slbench.design.clustering import Clusters, cluster_front
from slbench.design.constraints import diagnose, margins
from slbench.design.evaluate import Evaluation, evaluate
from slbench.design.front import Front
from slbench.design.hardware import Hardware, Placement
from slbench.errors import InputError

Array = NDArray[np.float64]

OBJECTIVES = ("error", "coverage", "dispersion")


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

    def member(self, cluster: int | None = None) -> int:
        """Return the front's member that represents a cluster (default: the recommended).

        Raises
        ------
        InputError
            If there is no such cluster.
        """
        number = self.recommended if cluster is None else cluster
        if not 0 <= number < len(self.clusters):
            raise InputError("cluster", f"0 to {len(self.clusters) - 1}", number)
        return int(self.clusters.representatives[number])


def optimise(
    hardware: Hardware,
    *,
    objectives: Sequence[str] = OBJECTIVES,
    max_evaluations: int = 20_000,
    seed: int = 0,
    start: Front | ArrayLike | None = None,
    max_footprint_mm: float | None = None,
    min_angle_deg: float | None = None,
    on_progress: Callable[[Front], object] | None = None,
) -> RigDesign:
    """Search for the best rigs that given hardware can form.

    Parameters
    ----------
    hardware : Hardware
    objectives : sequence of {"error", "coverage", "dispersion"}
        Which to minimise.
    max_evaluations : int
        Budget of evaluated configurations.
    seed : int
    start : Front or (n, 6) float, optional
        A front to go on from, or configurations (mm, rad) to begin at.
    max_footprint_mm : float, optional
        Largest horizontal extent, along x and along y, of both bodies and the volume.
    min_angle_deg : float, optional
        Smallest triangulation angle.
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
    """
    names = tuple(objectives)
    unknown = [name for name in names if name not in OBJECTIVES]
    if unknown or not names or len(set(names)) != len(names):
        raise InputError("objectives", f"some of {', '.join(OBJECTIVES)}", ", ".join(names))
    for label, value in (("footprint", max_footprint_mm), ("angle", min_angle_deg)):
        if value is not None and not 0 < value < np.inf:
            raise InputError(f"constraint on {label}", "a positive number", value)
    columns = [OBJECTIVES.index(name) for name in names]

    def values(x: Array) -> Array:
        return evaluate(hardware, x).objectives[:, columns]

    def feasible(x: Array) -> NDArray[np.bool_]:
        holds = np.all(margins(hardware, x) > 0, axis=1)
        placement = hardware.place(x)
        if min_angle_deg is not None:
            holds &= placement.angle >= np.deg2rad(min_angle_deg)
        if max_footprint_mm is not None:
            holds &= footprint_mm(hardware, placement) <= max_footprint_mm
        return holds

    begin = time.perf_counter()
    try:
        front = multisearch.minimize(
            values,
            np.array(hardware.lower),
            np.array(hardware.upper),
            feasible,
            max_evaluations=max_evaluations,
            seed=seed,
            on_progress=on_progress,
            start=start,
        )
    except InputError as error:
        if error.where != "constraints":
            raise
        raise InputError("hardware", "a feasible configuration", diagnose(hardware)) from None
    if not len(front):
        raise InputError("hardware", "a feasible configuration", diagnose(hardware))
    seconds = time.perf_counter() - begin
    clusters = cluster_front(front, seed)
    return RigDesign(
        hardware,
        names,
        front,
        evaluate(hardware, front.x),
        clusters,
        _nearest_to_ideal(front.f, clusters),
        seconds,
    )


def footprint_mm(hardware: Hardware, placement: Placement) -> Array:
    """Return the larger horizontal extent of bodies and volume for each configuration, (n,)."""
    low = np.full((len(placement.valid), 2), -np.array(hardware.volume_mm[:2]) / 2.0)
    high = -low
    for device, rotation, position in (
        (hardware.camera, placement.camera_rotation, placement.camera_position),
        (hardware.projector, placement.projector_rotation, placement.projector_position),
    ):
        corners = device.body_corners @ np.swapaxes(rotation, 1, 2) + position[:, None]
        low = np.fmin(low, corners[..., :2].min(axis=1))
        high = np.fmax(high, corners[..., :2].max(axis=1))
    return np.asarray((high - low).max(axis=1), dtype=np.float64)


def _nearest_to_ideal(f: Array, clusters: Clusters) -> int:
    rank = (rankdata(f, axis=0) - 1.0) / max(len(f) - 1, 1)
    return int(np.argmin(np.linalg.norm(rank[clusters.representatives], axis=1)))
