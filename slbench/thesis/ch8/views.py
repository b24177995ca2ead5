"""Chapter 8: objects larger than the field of view, measured in several views (8.4.2).

The stage moves the object; each view is a focus stack, fused, decoded, and turned into points
by the calibration model, in the scanner's frame.  The views are registered from the stage's
*nominal* positions (:mod:`slbench.cloud.registration`) and scored against the exact surface: the
signed error is that along the true normal at the pixel, to which errors within the surface do
not count.

Where the whole object is in the world no view can tell: the stage's mean error is left out of
the error of the *shape*, and given beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.model import CalibrationModel
from slbench.capture.stack import WeightSource
from slbench.cloud.registration import Registration, register_views
from slbench.core.errors import InputError
from slbench.core.random import generator, tagged_seed
from slbench.patterns import PhaseMap
from slbench.rig import Pose
from slbench.scene.model import Scene
from slbench.simulate.stack import capture_stack
from slbench.thesis.ch8.results import Merged, View

Array = NDArray[np.float64]
Progress = Callable[[float], None]

#: A surface within this angle of level counts as level, cosine of 3 deg.
_LEVEL = 0.9986


def measure_view(
    scene: Scene,
    stage_mm: Array,
    model: CalibrationModel,
    to_model: Callable[[Array], Array],
    *,
    weights: WeightSource = "modulation",
    seed: int = 0,
) -> View:
    """Measure the scene's objects, all moved by the stage.

    Parameters
    ----------
    scene : Scene
        With focus settings.
    stage_mm : (3,) float
        True displacement.
    model : CalibrationModel
    to_model : callable
        Maps camera pixels (n, 2) of the scene to those that the model is for.
    weights : {"lit", "modulation"}
    seed : int

    Raises
    ------
    InputError
        If no pixel lies in the model's domain.
    """
    from slbench.simulate.render.groundtruth import ground_truth

    moved = tuple(
        replace(item, pose=Pose(item.pose.rotation, item.pose.position + stage_mm))
        for item in scene.objects
    )
    placed = replace(scene, objects=moved)
    phase = capture_stack(placed, seed=seed).fuse(weights).decode()
    points, (v, u), extrapolated = _calibrated(model, phase, to_model, scene.rig.volume_mm)
    if not len(points):
        raise InputError(f"scene {scene.name}: view", "points in the measurement volume", "none")
    truth = ground_truth(placed.objects, placed.rig)
    error = np.where(truth.lit[v, u, None], points - truth.point[v, u], np.nan)
    return View(
        points.astype(np.float32),
        error.astype(np.float32),
        truth.normal[v, u].astype(np.float32),
        truth.smooth()[v, u],
        extrapolated,
    )


def _calibrated(
    model: CalibrationModel,
    phase: PhaseMap,
    to_model: Callable[[Array], Array],
    volume_mm: Sequence[float],
) -> tuple[Array, tuple[NDArray[np.intp], NDArray[np.intp]], NDArray[np.bool_]]:
    """Return points in the volume, (N, 3), their pixels (v, u), and where the model extrapolates.

    The dots' hull is smaller than the volume by a pitch or so on each side.
    """
    v, u = np.nonzero(phase.mask)
    pixels = np.column_stack((u, v)).astype(np.float64)
    inputs = np.column_stack((to_model(pixels), phase.coordinate["u"][v, u]))
    points = model.predict(inputs)
    kept = np.all(np.abs(points) <= 0.5 * np.asarray(volume_mm), axis=1)
    return points[kept], (v[kept], u[kept]), ~model.inside(inputs[kept])


def measure_object(
    name: str,
    scene: Scene,
    positions_mm: Array,
    model: CalibrationModel,
    to_model: Callable[[Array], Array],
    *,
    stage_sigma_mm: float,
    weights: WeightSource = "modulation",
    seed: int = 0,
    on_progress: Progress | None = None,
) -> Merged:
    """Measure an object in several views, register and score them.

    Parameters
    ----------
    name : str
    scene : Scene
    positions_mm : (K, 3) float
        Nominal positions of the stage.
    model, to_model, weights
        As for :func:`measure_view`.
    stage_sigma_mm : float
        By which the stage is off, each axis, drawn by `seed`; registration is told the same.
    seed : int
    on_progress : callable, optional
    """
    rng = generator(tagged_seed(seed, 0))
    error = rng.normal(0.0, stage_sigma_mm, positions_mm.shape)
    views = []
    for k, stage in enumerate(positions_mm + error):
        own = tagged_seed(seed, 1, k)
        views.append(measure_view(scene, stage, model, to_model, weights=weights, seed=own))
        if on_progress:
            on_progress((k + 1) / (len(positions_mm) + 1))
    registration = register_views(
        [view.points for view in views], positions_mm, stage_sigma_mm=stage_sigma_mm
    )
    if on_progress:
        on_progress(1.0)
    return merged(name, views, registration, positions_mm + error)


def merged(
    name: str, views: Sequence[View], registration: Registration, true_stage_mm: Array
) -> Merged:
    """Merge registered views and score them against the truth.

    Parameters
    ----------
    name : str
    views : sequence of View
    registration : Registration
    true_stage_mm : (K, 3) float
        Where the stage truly was.
    """
    before = true_stage_mm - registration.positions_mm
    after = before + registration.shifts_mm
    common = after.mean(axis=0)
    points, errors, heights, level, smooth = [], [], [], [], []
    for view, pose, stage in zip(views, registration.poses, true_stage_mm, strict=True):
        measured = pose.to_world(view.points)
        true = view.points.astype(np.float64) - view.error - stage
        errors.append(np.sum((measured - true - common) * view.normal, axis=1).astype(np.float32))
        points.append(measured.astype(np.float32))
        heights.append(true[:, 2].astype(np.float32))
        level.append(view.smooth & (view.normal[:, 2] > _LEVEL))
        smooth.append(view.smooth)
    return Merged(
        name,
        registration,
        np.concatenate(points),
        np.concatenate(errors),
        np.concatenate(heights),
        np.concatenate(level),
        np.concatenate(smooth),
        common,
        before - before.mean(axis=0),
        after - common,
        float(np.mean(np.concatenate([view.extrapolated for view in views]))),
    )
