"""The rendered plate of features: sizes and dimensions against the uncertainties that are stated.

Light is traced once for each place of the plate; noise is drawn anew in each repeat.  What does not
repeat to zero, the projector's staircase and half pixels at edges, is another in each place.
"""

from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small
from scipy.spatial.transform import Rotation
from stages import capture, ground_truth, trace

from slbench.cloud.triangulation import triangulate
from slbench.rig import Pose
from slbench.scene.file import load_scene
from slbench.score.points import score

#: Sizes that have a value, and the circle's; zones are never negative and have no such error.
DIMENSIONS = (
    *("bore distance", "bore 1", "pin", "pin height"),
    *("cone angle", "ball", "ball to pin"),
)
RIM = "rim-2"


def normed_errors(turn_deg, repeats, samples):
    """Return errors over uncertainties of the dimensions and the rim, (R, 8)."""
    scene = small("feature-plate", divisor=1, samples=samples)
    turn = Rotation.from_euler("XYZ", turn_deg, degrees=True).as_matrix()
    item = replace(scene.objects[0], pose=Pose(turn, np.zeros(3)))
    scene = replace(scene, objects=(item,))
    transport, truth = trace(scene, seed=1), ground_truth(scene)
    found = []
    for seed in range(repeats):
        phase = capture(scene, transport, seed=10 + seed).decode()
        cloud = triangulate(scene.rig, phase)
        result = score(cloud, truth, phase, scene.objects, scene.rig)
        own = {one.name: one for one in result.dimensions}
        row = [own[name].deviation / own[name].uncertainty for name in DIMENSIONS]
        (rim,) = result.circles
        found.append([*row, rim.diameter_deviation_mm / rim.diameter_uncertainty_mm])
    return np.array(found)


def test_the_rendered_plate_is_measured_within_its_uncertainties():
    errors = normed_errors((-40.0, 0.0, 0.0), 2, 8)
    assert errors.shape == (2, 8)
    # Eight features, one place: within three, which one in 370 is not by chance.
    assert np.abs(errors).max() < 3.0
    # Nor are the uncertainties so large that nothing could fail.
    assert np.sqrt(np.mean(errors**2)) > 0.2


def test_the_shipped_scene_shows_every_feature():
    scene = load_scene("feature-plate")
    declared = {surface.name for surface in scene.objects[0].artefact.declared}
    assert declared == {"top", "bore-1", "bore-2", "rim-2", "pin", "pin top", "cone", "ball"}


@pytest.mark.statistics
def test_uncertainties_cover_over_places_and_repeats():
    rng = np.random.default_rng(8)
    turns = rng.uniform((-46, -4, -8), (-34, 4, 8), (14, 3))
    errors = np.concatenate([normed_errors(turn, 4, 16) for turn in turns])
    assert errors.shape == (56, 8)
    # 112 placements of a feature, whose staircase is one draw each: three times their standard
    # deviation about 95 % is 6 %.
    assert np.mean(np.abs(errors) < 1.96) > 0.89
    size = np.sqrt(np.mean(errors**2, axis=0))
    # Of each feature 14 placements: their RMS is good to a fifth.
    assert (size < 1.6).all()
    assert (size > 0.15).all()
