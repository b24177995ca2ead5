"""Clouds as scanners write them: millions of points, rotated, with outliers, in another unit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import slbench as sl
from slbench.cloud import MeasuredCloud, write_cloud
from slbench.objects import load_artefact
from slbench.rig import Pose
from slbench.score.clouds.surface import Surface

NOISE = 0.01
POSE = Pose(Rotation.from_rotvec([0.5, 1.5, -2.0]).as_matrix(), np.array([80.0, 30.0, 500.0]))


def write_large(path, count, unit_mm):
    """Write points of one side of a step block; a fifth of them is wrong."""
    rng = np.random.default_rng(4)
    points, normals = Surface(load_artefact("step-block-20").mesh).sample(2 * count, 4)
    points = points[normals @ [0.4, 0.4, 0.82] > 0.2][:count]
    points += rng.normal(0.0, NOISE, points.shape)
    low, high = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
    points[: len(points) // 5] = rng.uniform(low, high, (len(points) // 5, 3))
    grey = rng.uniform(0.0, 255.0, len(points))
    write_cloud(path, MeasuredCloud(POSE.to_world(points) / unit_mm, grey=grey))
    return points


@pytest.mark.parametrize(
    ("suffix", "count"),
    [
        ("ply", 40_000),
        ("e57", 40_000),
        pytest.param("ply", 5_000_000, marks=pytest.mark.slow),
        pytest.param("e57", 5_000_000, marks=pytest.mark.slow),
    ],
)
def test_a_scanners_cloud_is_read_placed_and_scored(tmp_path, suffix, count):
    if suffix == "e57":
        pytest.importorskip("pye57", reason="the extra e57 is not installed")
    path = tmp_path / f"cloud.{suffix}"
    # PLY in metres: the user says so.  E57 is in metres by its standard: nobody needs to.
    points = write_large(path, count, 1.0 if suffix == "e57" else 1000.0)
    result = sl.score_cloud(path, artefact="step-block-20", unit="m" if suffix == "ply" else None)
    assert result.score.points == len(points)
    moved = result.motion.to_world(POSE.to_world(points))
    # Single precision at 500 mm adds 30 nm; the place is told to a fraction of the noise.
    assert np.abs(moved - points).max() < NOISE
    # Of Gaussian noise; a fifth of the points, farther off, shifts the median by 0.32 deviations.
    assert 0.6745 * NOISE < result.score.median_abs_mm < 1.05 * NOISE
    for step in result.score.steps:
        assert abs(step.deviation_mm) < 5.0 * max(step.uncertainty_mm, 1e-4)
