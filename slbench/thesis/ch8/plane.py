"""Chapter 8: where a plane is measured against where the stage put it (8.4.1, fig. 33).

A plain plate is measured at 44 positions with the calibration model; a plane is fitted to the
points, and its height at their centroid, the mean of z, compared with the stage.  The pictures
of each position are taken once; stages that are off and models that were calibrated with one
are drawn afterwards, on a sample of the pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.model import CalibrationModel
from slbench.cloud.registration import STAGE_SIGMA_MM
from slbench.core.errors import InputError
from slbench.core.random import generator, tagged_seed
from slbench.patterns import PhaseMap
from slbench.rig import Pose
from slbench.scene.model import Scene
from slbench.simulate.stack import capture_stack
from slbench.thesis.ch8.results import PlaneFit, PlanePosition

Array = NDArray[np.float64]

#: Ways to make one capture of a stack.
WAYS = ("single", "lit", "modulation")
#: Pixels kept a position: the mean of their noise is a nanometre or two.
_PIXELS = 3000


def fit_plane(points: Array) -> PlaneFit:
    """Fit a plane to points (N, 3) by linear regression of z.

    Raises
    ------
    InputError
        For fewer than three points, or points on a line.
    """
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3:
        raise InputError("plane", "three points (N, 3) at least", points.shape)
    middle = points.mean(axis=0)
    away = points - middle
    slope, _, rank, _ = np.linalg.lstsq(away[:, :2], away[:, 2], rcond=1e-12)
    if rank < 2:
        raise InputError("plane", "points that are not on one line", "a line")
    residual = away[:, 2] - away[:, :2] @ slope
    rms = float(np.sqrt(np.mean(residual**2)))
    return PlaneFit(float(middle[2]), (float(slope[0]), float(slope[1])), rms, len(points))


def scan_planes(
    scene: Scene,
    positions_mm: Array,
    *,
    seed: int = 0,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[PlanePosition, ...]:
    """Capture the scene's plate at every position, decoded in every way of :data:`WAYS`."""
    plate, found = scene.objects[0], []
    for k, stage in enumerate(positions_mm):
        moved = replace(plate, pose=Pose(plate.pose.rotation, plate.pose.position + stage))
        placed = replace(scene, objects=(moved, *scene.objects[1:]))
        own = tagged_seed(seed, k)
        stack = capture_stack(placed, seed=own)
        phases = {"single": stack.captures[len(stack) // 2].decode()}
        phases |= {way: stack.fuse(way).decode() for way in ("lit", "modulation")}
        inputs = {way: _inputs(phase, own) for way, phase in phases.items()}
        found.append(PlanePosition(np.asarray(stage, float), inputs))
        if on_progress:
            on_progress((k + 1) / len(positions_mm))
    return tuple(found)


def _inputs(phase: PhaseMap, seed: int) -> Array:
    v, u = np.nonzero(phase.mask)
    inputs = np.column_stack((u, v, phase.coordinate["u"][v, u])).astype(np.float64)
    if len(inputs) <= _PIXELS:
        return inputs
    return inputs[generator(seed).choice(len(inputs), _PIXELS, replace=False)]


def plane_fits(
    positions: Sequence[PlanePosition],
    model: CalibrationModel,
    way: str,
    to_model: Callable[[Array], Array],
) -> list[PlaneFit]:
    """Fit a plane to the points of each position that the model does not extrapolate to.

    Parameters
    ----------
    positions : sequence of PlanePosition
    model : CalibrationModel
    way : {"single", "lit", "modulation"}
    to_model : callable
        Maps camera pixels (n, 2) of these captures to those that the model is for.
    """
    fits = []
    for position in positions:
        inputs = position.inputs[way].copy()
        inputs[:, :2] = to_model(inputs[:, :2])
        fits.append(fit_plane(model.predict(inputs[model.inside(inputs)])))
    return fits


def position_errors(
    positions: Sequence[PlanePosition],
    models: Sequence[CalibrationModel],
    way: str,
    to_model: Callable[[Array], Array],
    *,
    sigma_mm: float = STAGE_SIGMA_MM,
    seed: int = 0,
) -> Array:
    """Return measured less nominal heights, (draws, positions), mm.

    Parameters
    ----------
    positions, way, to_model
        As for :func:`plane_fits`.
    models : sequence of CalibrationModel
        One a draw.
    sigma_mm : float
        By which the nominal heights differ from the true ones; 0 for an exact stage.
    seed : int
    """
    true = np.array([position.stage_mm[2] for position in positions])
    rows = []
    for draw, model in enumerate(models):
        rng = generator(seed, draw)
        nominal = true - rng.normal(0.0, sigma_mm, len(true)) if sigma_mm > 0.0 else true
        fits = plane_fits(positions, model, way, to_model)
        rows.append([fit.height_mm for fit in fits] - nominal)
    return np.array(rows)
