"""Chapter 8: which models calibrate the microscope (figs. 30-32, table 13).

Light is traced once, with a stage that is exact.  A stage that is off has the same pictures but
other *nominal* positions: true less error.  Each draw of errors is a calibration of its own, and
the verdict is on how often a model is chosen, not on one draw.

Three stages: *exact*; *off in all axes*, 1.5 um each (its repeatability, thesis 8.3); and *off
where it moves*.  In the thesis's experiment the stage never moves in x, once a row of heights in
y, and for every position in z; the dots themselves are placed to 1 um, alike at all positions.
Models are chosen by whole positions left out (:mod:`slbench.calibration.grouped`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.selection import select_models
from slbench.cloud.registration import STAGE_SIGMA_MM
from slbench.core.random import generator
from slbench.thesis.ch8.results import STAGES, Calibrations, Stage
from slbench.twin.experiment import Experiment

Array = NDArray[np.float64]

#: Centre to centre +- 1 um (thesis table 11): of each dot, uniform within half of that, mm.
DOT_SIGMA_MM = 0.001 / np.sqrt(12.0)


def disturbed(
    experiment: Experiment, stage: Stage, rng: np.random.Generator, sigma_mm: float = STAGE_SIGMA_MM
) -> CalibrationPoints:
    """Return the points with the world coordinates of a stage that was off.

    Parameters
    ----------
    experiment : Experiment
        With an exact stage.
    stage : {"exact", "all axes", "moved axes"}
    rng : numpy.random.Generator
    sigma_mm : float
        Of the stage, each axis.
    """
    points, nominal = experiment.points, experiment.positions_mm
    if stage == "exact":
        return points
    if stage == "all axes":
        error = rng.normal(0.0, sigma_mm, nominal.shape)
        world = points.world - error[experiment.position]
        return CalibrationPoints(points.pixels, world, experiment.position)
    _, row = np.unique(np.round(nominal[:, 1], 6), return_inverse=True)
    error = np.zeros(nominal.shape)
    error[:, 1] = rng.normal(0.0, sigma_mm, row.max() + 1)[row]
    error[:, 2] = rng.normal(0.0, sigma_mm, len(nominal))
    own = np.round(points.world[:, :2] - nominal[experiment.position, :2], 6)
    _, dot = np.unique(own, axis=0, return_inverse=True)
    placed = np.zeros((dot.max() + 1, 3))
    placed[:, :2] = rng.normal(0.0, DOT_SIGMA_MM, (len(placed), 2))
    world = points.world - error[experiment.position] - placed[dot]
    return CalibrationPoints(points.pixels, world, experiment.position)


def calibrations(experiment: Experiment, stage: Stage, draws: int, seed: int) -> Calibrations:
    """Calibrate with several draws of a stage's errors (one where it is exact)."""
    truth = experiment.points
    selections, errors = [], []
    for draw in range(1 if stage == "exact" else draws):
        rng = generator(seed, STAGES.index(stage), draw)
        chosen = select_models(disturbed(experiment, stage, rng), seed=seed)
        residual = chosen.model.predict(truth.inputs()) - truth.world
        selections.append(chosen)
        errors.append(np.sqrt(np.mean(residual**2, axis=0)))
    return Calibrations(stage, tuple(selections), np.array(errors))
