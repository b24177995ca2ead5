"""Velocities estimated from frames, against those that moved."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.cloud.motion import estimated_motion
from slbench.core.errors import InputError
from slbench.objects import build_artefact
from slbench.rig.motion import FrameTiming, Motion
from slbench.scene.file import load_scene
from slbench.simulate.stack import capture_stack, moving_light, traced

KEYS = {
    "exposure.pulse_ms": 1e-3,
    "exposure.frame_period_ms": 5.0,
    "patterns.sequence": "1,16@4",
}


def scene_of(name, velocity, divisor=3, **changes):
    scene = load_scene(name, preview=True, changes=KEYS | changes).coarser(divisor, 8)
    motion = Motion(velocity_mm_per_s=velocity)
    items = [replace(item, motion=motion) for item in scene.objects]
    if name == "sphere":  # of larger facets, to be traced sooner
        coarse = build_artefact("sphere", {"radius_mm": 12.5, "max_form_error_um": 10.0})
        items[0] = replace(items[0], artefact=coarse)
    return replace(scene, objects=tuple(items))


def captures(scene, draws):
    light, moving = traced(scene, seed=1), moving_light(scene, 1)
    for seed in range(draws):
        yield capture_stack(scene, light, seed=seed, moving=moving).captures[0]


def test_velocity_across_a_plane_is_found_and_that_along_it_unseen():
    tilted = {"objects[0].rotation_deg": [12.0, -8.0, 0.0]}
    velocity = (5.0, -10.0, 30.0)
    scene = scene_of("plane", velocity, **tilted)
    normal = scene.objects[0].pose.rotation[:, 2]
    (shots,) = captures(scene, 1)
    found = estimated_motion(shots)
    off = normal @ (np.array(found.motion.velocity_mm_per_s) - velocity)
    deviation = np.sqrt(normal @ found.covariance @ normal)
    assert deviation < 0.3
    assert abs(off) < 4.0 * deviation + 0.01 * 30.0
    assert "mm/s" in str(found)
    assert "EstimatedMotion" in repr(found)


@pytest.mark.slow
@pytest.mark.statistics
@pytest.mark.parametrize(
    "velocity", [(0.0, 0.0, 0.0), (0.0, 0.0, 20.0), (30.0, 20.0, 40.0), (-40.0, 10.0, 0.0)], ids=str
)
def test_velocity_of_a_ball_is_found_over_draws_of_noise(velocity):
    # On its stage: all three directions are seen.
    found = [estimated_motion(shots) for shots in captures(scene_of("sphere", velocity, 2), 12)]
    velocities = np.array([one.motion.velocity_mm_per_s for one in found])
    predicted = np.sqrt(np.mean([np.diag(one.covariance) for one in found], axis=0))
    spread, mean = velocities.std(axis=0, ddof=1), velocities.mean(axis=0)
    assert all(len(one.unseen) == 0 for one in found)
    # Twelve draws tell a deviation to 21 %: a factor of two either way is four deviations off.
    assert np.all(spread < 2.0 * predicted)
    assert np.all(spread > 0.4 * predicted)
    # The mean by its own deviation, and 1.5 % of the speed for what is not modelled.
    allowed = 4.0 * predicted / np.sqrt(12) + 0.015 * np.linalg.norm(velocity)
    assert np.all(np.abs(mean - velocity) < allowed)


def test_fewer_shifts_than_tell_motion_are_refused():
    scene = scene_of("plane", (0.0, 0.0, 0.0), **{"patterns.sequence": "1,16@3"})
    (shots,) = captures(scene, 1)
    timed = replace(shots, timing=FrameTiming(period_s=1e-3))
    with pytest.raises(InputError, match="motion: expected a fringe set of four shifts or more"):
        estimated_motion(timed)
