"""Heights of steps of rendered blocks against the uncertainties that their points' scatter gives.

A sharp projector's staircase goes together along columns and alternates between them; a block that
is turned or tilted sees it at another beat.  Noise is drawn anew, the staircase is steady.
"""

from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small
from scipy.spatial.transform import Rotation
from stages import capture, ground_truth, trace

from slbench import objects
from slbench.cloud.triangulation import triangulate
from slbench.rig import Pose
from slbench.scene.model import Material, SceneObject
from slbench.scene.surfaces.materials import Diffuse
from slbench.score.points import score


def normed_errors(turn_deg, blur_px, repeats):
    """Return errors of step heights over their uncertainties, (R, steps)."""
    scene = small("plane", divisor=1, samples=32)
    sharp = replace(scene.rig.projector, blur_px=blur_px)
    turn = Rotation.from_euler("XYZ", turn_deg, degrees=True).as_matrix()
    block = objects.load_artefact("step-block-5")
    item = SceneObject(block, Pose(turn, np.zeros(3)), Material(Diffuse(albedo=0.8)))
    scene = replace(scene, rig=scene.rig.having(projector=sharp), objects=(item,))
    transport, truth = trace(scene, seed=1), ground_truth(scene)
    found = []
    for seed in range(repeats):
        phase = capture(scene, transport, seed=10 + seed).decode()
        cloud = triangulate(scene.rig, phase)
        steps = score(cloud, truth, phase, scene.objects, scene.rig).steps
        found.append([step.deviation_mm / step.uncertainty_mm for step in steps])
    return np.array(found)


def test_uncertainties_of_steps_are_of_the_size_of_their_errors():
    for turn, blur in (((0, 0, 0), 1.0), ((0, 0, 7), 0.0), ((2, 3, 0), 0.0)):
        size = np.sqrt(np.mean(normed_errors(turn, blur, 4) ** 2))
        # Twelve errors of three steps, whose staircase is one draw each.
        assert 0.3 < size < 1.6, (turn, blur)


@pytest.mark.statistics
@pytest.mark.parametrize("blur_px", [1.0, 0.3, 0.0])
def test_steps_of_turned_and_tilted_blocks_are_covered(blur_px):
    rng = np.random.default_rng(8)
    turns = [(0, 0, 0), (0, 0, 0.5), *rng.uniform((-6, -6, -45), (6, 6, 45), (14, 3))]
    errors = np.concatenate([normed_errors(turn, blur_px, 5) for turn in turns])
    assert errors.shape == (80, 3)
    # 48 placements of a step: three times their standard deviation is 10 %.
    assert np.mean(np.abs(errors) < 1.96) > 0.87
    assert 0.45 < np.sqrt(np.mean(errors**2)) < 1.25
