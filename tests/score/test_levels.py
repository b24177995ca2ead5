"""Step heights of parts that were placed by their own points."""

import numpy as np
import pytest

from slbench.objects.loading import load_artefact
from slbench.rig import Pose
from slbench.score.alignment import best_motion
from slbench.score.features import fit_features
from slbench.score.values import StepScore

BLOCK = load_artefact("step-block-20")


def points_of(count, seed=0):
    """Draw points on the faces of the block, in its frame, `count` a face."""
    rng = np.random.default_rng(seed)
    faces = []
    for face in BLOCK.planes:
        xy = rng.uniform(*np.transpose([face.x_mm, face.y_mm]), (count, 2))
        faces.append(np.column_stack((xy, np.full(count, face.z_mm))))
    return np.concatenate(faces)


def heights(points, **given):
    found = fit_features(points, BLOCK, Pose(), **given)
    steps = [one for one in found if isinstance(one, StepScore)]
    return np.array([[s.measured_mm, s.nominal_mm, s.uncertainty_mm] for s in steps]).T


def test_heights_that_are_measured_too_large_stay_so_after_alignment():
    true = points_of(400)
    scaled = true * [1.0, 1.0, 1.002]
    aligned = best_motion(scaled, true).to_world(scaled)
    measured, nominal, _ = heights(aligned, level=True)
    # What is left is rounding.
    assert measured == pytest.approx(1.002 * nominal, abs=1e-9)
    # Along the z of the best placing, the staircase leans and is too low by most of its error.
    assert np.abs(heights(aligned)[0] - 1.002 * nominal).max() > 0.5 * 0.002 * nominal.max()


def test_their_uncertainty_holds_that_of_the_slope():
    true = points_of(60, seed=1)
    rng = np.random.default_rng(2)
    found = []
    for _ in range(400):
        noisy = true + [0.0, 0.0, 1.0] * rng.normal(0.0, 0.01, (len(true), 1))
        aligned = best_motion(noisy, true).to_world(noisy)
        found.append(heights(aligned, level=True))
    measured, nominal, u = np.moveaxis(np.array(found), 1, 0)
    spread = measured.std(axis=0, ddof=1)
    # 400 draws: 3.5 % a standard error of each, 4 of them.
    assert spread == pytest.approx(np.sqrt(np.mean(u**2, axis=0)), rel=0.14)
    assert np.abs(measured.mean(axis=0) - nominal[0]).max() < 4.0 * spread.max() / 20.0
    # The slope is what makes heights far from the reference uncertain.
    assert spread[-1] > 1.5 * spread[0]
