"""Objects of known shape, placed by what was measured of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError, InputWarning
from slbench.objects import load_artefact
from slbench.rig import Pose
from slbench.scene import load_scene
from slbench.scene.model import SceneObject
from slbench.simulate.render.groundtruth import ground_truth
from slbench.twin import TwinObject
from slbench.twin.placing import place


def measured(scene, artefact, pose, *, noise_mm=0.01, wrong=0.0, seed=0):
    """Return the points that a scan of an object would have, without light."""
    truth = ground_truth((SceneObject(artefact, pose),), scene.rig)
    rng = np.random.default_rng(seed)
    v, u = np.nonzero(truth.lit)
    points = truth.point[v, u] + truth.normal[v, u] * rng.normal(0.0, noise_mm, (len(u), 1))
    lost = rng.random(len(u)) < wrong  # by whole fringes: far away
    points[lost] += rng.uniform(-20.0, 20.0, (lost.sum(), 3))
    nothing = np.full((len(u), 1), 0.01)
    return PointCloud(
        points=points,
        pixels=np.stack((u, v), axis=1).astype(np.int32),
        shape=truth.lit.shape,
        axes=("u",),
        sigma_px=nothing,
        sensitivity=np.ones((len(u), 1, 3)),
    )


def turn_between(a: Pose, b: Pose) -> float:
    """Return the angle between two poses, degrees."""
    return float(np.rad2deg(Rotation.from_matrix(a.rotation.T @ b.rotation).magnitude()))


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_a_plane_is_placed_across_itself(wrong) -> None:
    scene = load_scene("plane", preview=True)
    turn = Rotation.from_euler("XYZ", [12.0, -8.0, 30.0], degrees=True).as_matrix()
    pose = Pose(turn, np.array([3.0, -2.0, 4.0]))
    cloud = measured(scene, scene.objects[0].artefact, pose, wrong=wrong)
    # A plate of which no edge is seen.
    found = place(TwinObject(shape="plane").artefact(), cloud, scene.rig)
    normal = turn[:, 2]
    # 10 um over the root of 50,000 points, and a lever of 30 mm: five deviations.
    assert abs(normal @ (found.pose.position - pose.position)) < 1e-3
    assert np.linalg.norm(np.cross(found.pose.rotation[:, 2], normal)) < 2e-5
    assert found.pose.rotation[:, 2] @ normal > 0.0
    # The median of all, of which the wrong ones are the largest.
    usual = 1.4826 * norm.ppf(0.5 + 0.25 / (1.0 - wrong))
    assert found.scale_mm == pytest.approx(0.01 * usual, rel=0.05)
    assert found.agreeing == pytest.approx(1.0 - wrong, abs=0.02)
    assert found.free == ("2 shifts", "1 turn")


@pytest.mark.slow  # turns are tried by the hundred
def test_a_block_is_found_without_a_start_by_faces_and_outlines() -> None:
    scene = load_scene("step-block", preview=True)
    turn = Rotation.from_euler("XYZ", [6.0, -4.0, 100.0], degrees=True).as_matrix()
    pose = Pose(turn, np.array([5.0, -3.0, 2.0]))
    artefact = load_artefact("step-block-5")
    cloud = measured(scene, artefact, pose, wrong=0.05)
    found = place(artefact, cloud, scene.rig)
    offset = found.pose.position - pose.position
    assert abs(turn[:, 2] @ offset) < 2e-3
    # Along the faces outlines tell, which are as sharp as the pixels: 0.42 mm here.
    assert np.linalg.norm(offset) < 0.1
    assert turn_between(found.pose, pose) < 0.5


def test_a_ball_is_placed_whatever_its_turn() -> None:
    scene = load_scene("sphere", preview=True)
    pose = Pose(np.eye(3), np.array([1.0, 2.0, -3.0]))
    artefact = load_artefact("sphere")
    cloud = measured(scene, artefact, pose)
    found = place(artefact, cloud, scene.rig, Pose(np.eye(3), np.array([0.0, 0.0, 0.0])))
    assert found.pose.position == pytest.approx(pose.position, abs=5e-3)
    assert found.free == ("3 turns",)


def test_few_points_and_objects_elsewhere_are_refused() -> None:
    scene = load_scene("plane", preview=True)
    artefact = scene.objects[0].artefact
    cloud = measured(scene, artefact, Pose())
    with pytest.raises(InputError, match="at least 50 points"):
        place(artefact, cloud.chosen(slice(0, 20)), scene.rig)
    ball = load_artefact("sphere")
    vast = replace(ball, mesh=replace(ball.mesh, vertices=1000.0 * ball.mesh.vertices))
    below = Pose(np.eye(3), np.array([0.0, 0.0, -1000.0 * ball.mesh.bounds[1, 2]]))
    with pytest.warns(InputWarning, match="long, the points reach over .*: another unit"):
        place(vast, cloud, scene.rig, below)
    far = Pose(np.eye(3), np.array([0.0, 0.0, 5000.0]))
    with pytest.raises(InputError, match="rays that meet no part of it"):
        place(load_artefact("sphere"), replace(cloud), scene.rig, far)
