"""Scenes that move: pictures at the poses of their time, smeared by their exposure."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.bench.budget.measurement import Measurement
from slbench.bench.budget.sources import ideal, in_motion, sources_of
from slbench.core.errors import InputError
from slbench.rig.motion import Motion
from slbench.scene.file import load_scene
from slbench.simulate.lights import Lights
from slbench.simulate.moving import MOST_POSES, MovingLight, speed_px, still
from slbench.simulate.scan import scan
from slbench.simulate.stack import capture_stack, moving_light, traced

#: A shutter that freezes what moves, of a picture of 80 x 60 px.
TIMES = {"exposure.pulse_ms": 1e-6, "exposure.frame_period_ms": 2.0}


def small(name="plane", divisor=4, **changes):
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    scene = load_scene(name, preview=True, changes={"patterns.sequence": "8@4"} | TIMES | keys)
    return scene.coarser(divisor, 8)


def moving(velocity=(0.0, 0.0, 0.0), turning=(0.0, 0.0, 0.0), rig=None, **changes):
    own = Motion(velocity_mm_per_s=velocity, rotation_deg_per_s=turning)
    scene = small(**changes)
    items = tuple(replace(item, motion=own) for item in scene.objects)
    return replace(scene, objects=items, rig_motion=rig)


def frames(scene, seed=3, noise=False, transports=None, light=None):
    stack = capture_stack(scene, transports, seed=seed, noise=noise, moving=light)
    return stack.captures[0].frames.astype(np.float64)


@pytest.mark.parametrize("patterns", ["8@4", "gray+8@3", "white+1,8@3+rgb"])
@pytest.mark.parametrize("noise", [False, True])
def test_a_scene_that_hardly_moves_has_the_frames_of_one_at_rest(patterns, noise):
    for axes in ("u", "uv") if patterns == "8@4" else ("u",):
        keys = {"patterns.sequence": patterns, "patterns.axes": axes}
        slow = moving(velocity=(0.0, 0.0, 1e-9), **keys)
        at_rest = still(slow)
        assert slow.moves
        assert not at_rest.moves
        expected, found = (frames(one, noise=noise) for one in (at_rest, slow))
        np.testing.assert_array_equal(found, expected)


def test_each_picture_sees_the_pose_of_its_time():
    # Against scenes whose file says where the object is then.
    velocity, period = np.array([30.0, -20.0, 100.0]), 2e-3
    found = frames(moving(velocity=tuple(velocity)))
    for k, time in enumerate(period * (np.arange(4) - 1.5)):
        there = small(**{"objects[0].position_mm": list(velocity * time)})
        whole = frames(there)  # of another exposure, as the exposure is that of the middle
        lit = whole[k] > 0
        factor = np.median(found[k][lit] / whole[k][lit])
        assert factor == pytest.approx(1.0, abs=0.01)  # the exposure, by distance
        # One grey level that rounding takes, and what the exposure is off by.
        assert np.abs(found[k] - factor * whole[k]).max() <= 1.0 + 0.01 * 4


def test_rotation_is_about_the_objects_own_middle():
    turning = moving(turning=(0.0, 40.0, 0.0))
    middle = turning.objects[0].middle
    for time in (-0.5, 0.25):
        item = turning.at(time).objects[0]
        np.testing.assert_allclose(item.middle, middle, atol=1e-12)
        angle = np.rad2deg(np.arccos(item.pose.rotation[0, 0]))
        assert angle == pytest.approx(40.0 * abs(time))


def test_motion_of_the_rig_is_that_of_the_objects_the_other_way():
    # Light differs by the rounding of single precision alone, which may change a grey level.
    velocity = (40.0, 0.0, 150.0)
    objects = frames(moving(velocity=velocity))
    rig = Motion(velocity_mm_per_s=tuple(-v for v in velocity))
    of_rig = frames(replace(small(), rig_motion=rig))
    assert np.abs(objects - of_rig).max() <= 1.0
    assert np.abs(objects - frames(small())).max() > 5.0
    # What moves together does not move.
    scene = moving(velocity=velocity, rig=Motion(velocity_mm_per_s=velocity))
    assert np.abs(frames(scene) - frames(small())).max() <= 1.0
    np.testing.assert_allclose(scene.path_of(scene.objects[0])(0.3).to_world([1, 2, 3]), [1, 2, 3])


def along_axis(scene, speed, **exposure):
    """Return the scene with its object on the way along the camera's axis."""
    velocity = speed * scene.rig.camera.pose.rotation[:, 2]
    own = Motion(velocity_mm_per_s=tuple(velocity.tolist()))
    items = tuple(replace(item, motion=own) for item in scene.objects)
    return replace(scene, objects=items, exposure=replace(scene.exposure, **exposure))


FINE = {"detector.bit_depth": 16, "patterns.sequence": "8@3"}


def test_motion_within_an_exposure_takes_the_contrast_of_a_sinc():
    # Along the camera's axis the panel coordinate of a pixel moves by d px while it is exposed,
    # and fringes of period P are left with sin(pi d / P) / (pi d / P) of their modulation.  The
    # middle one of three pictures is taken at time zero.
    scene, lasting, speed = small(**FINE | {"patterns.sequence": "32@3"}), 4e-3, 600.0
    fast = along_axis(scene, speed, pulse_s=lasting, frame_period_s=lasting)
    light, true = traced(scene, seed=3), Lights(3).truth(scene)
    sharp, smeared = (frames(one, transports=light) for one in (scene, fast))
    steps = 2.0 * np.pi * np.arange(3) / 3
    wave = np.tensordot(np.exp(1j * steps), sharp, axes=1) * 2.0 / 3
    axis = scene.rig.camera.pose.rotation[:, 2]
    # The ray of a pixel near the middle of the picture is the axis, nearly: the surface moves
    # along it.
    v, u = np.nonzero(true.smooth())
    near = np.hypot(u - scene.rig.camera.centre[0], v - scene.rig.camera.centre[1]) < 6.0
    points = true.point[v[near], u[near]]
    ends = [points + 0.5 * sign * lasting * speed * axis for sign in (-1.0, 1.0)]
    moved = np.subtract(*(scene.rig.projector.project(end)[:, 0] for end in ends))
    turns = np.abs(moved) * 32 / scene.rig.projector.width
    assert 0.15 < turns.mean() < 0.5
    shown = np.real(wave[v[near], u[near]] * np.exp(-1j * steps[1]))
    lost = (1.0 - np.sinc(turns)) * shown
    found = sharp[1, v[near], u[near]] - smeared[1, v[near], u[near]]
    # Beside it the mean phase moves a little: the way is not even in panel pixels.
    aside = np.imag(wave[v[near], u[near]] * np.exp(-1j * steps[1]))
    design = np.stack((lost, aside, np.ones(len(lost))), axis=1)
    # Rays off the axis see the surface move by up to 1 % less along them.
    assert np.linalg.lstsq(design, found)[0][0] == pytest.approx(1.0, abs=0.01)


def test_more_poses_do_not_change_a_picture():
    scene = small(**FINE, **{"objects[0].rotation_deg": [10.0, 5.0, 0.0]})
    fast = along_axis(scene, 100.0, pulse_s=4e-3, frame_period_s=1e-2, rolling_shutter_s=5e-3)
    light = traced(scene, seed=3)

    def trace(one, axes):
        return traced(one, axes, seed=3)[0]

    usual, finer = (MovingLight(fast, trace, step) for step in (0.25, 0.08))
    poses = [len(one.poses(4e-3).delays_s) for one in (usual, finer)]
    assert poses[0] > 3
    assert poses[1] > 2 * poses[0]
    found = [frames(fast, transports=light, light=one) for one in (usual, finer)]
    steps = 2.0 * np.pi * np.arange(3) / 3
    amplitude = 2.0 / 3 * np.abs(np.tensordot(np.exp(1j * steps), found[1], axes=1))
    lit = amplitude > 0.2 * amplitude.max()
    off = (found[0] - found[1])[:, lit] / amplitude[lit]
    # 0.1 % for an even division, 0.3 % for linear pieces, and at the rim of the light a pixel more.
    assert np.percentile(np.abs(off), 95) < 5e-3


@pytest.mark.parametrize("opened", [1e-9, 3e-3])
def test_rows_of_a_rolling_shutter_see_their_own_time(opened):
    scene = small(**FINE)
    rolling = 6e-3
    fast = along_axis(scene, 200.0, pulse_s=opened, frame_period_s=2e-2, rolling_shutter_s=rolling)
    light = traced(scene, seed=3)
    found = frames(fast, transports=light)
    rows = scene.rig.camera.height
    for row in (0, rows // 3, rows - 1):
        # A scene whose object has been there for as long, with a shutter for all rows.
        delay = (row / (rows - 1) - 0.5) * rolling
        item = fast.objects[0]
        shifted = replace(item, pose=item.at(delay).pose)
        alone = replace(fast, objects=(shifted,))
        alone = replace(alone, exposure=replace(alone.exposure, rolling_shutter_s=0.0))
        expected = frames(alone, transports=light)
        off = found[:, row] - expected[:, row]
        assert np.percentile(np.abs(off), 95) < 5e-3 * expected.max()
    assert np.abs(found - frames(scene, transports=light)).max() > 0.05 * found.max()


def test_poses_of_a_rolling_shutter_are_weighed_by_exact_integrals():
    scene = small()
    fast = along_axis(scene, 100.0, pulse_s=4e-3, frame_period_s=2e-2, rolling_shutter_s=7e-3)
    light = MovingLight(fast, lambda one, axes: pytest.fail("not to be traced"))
    poses = light.poses(4e-3)
    assert np.all(poses.shares >= -1e-12)
    np.testing.assert_allclose(poses.shares.sum(axis=1), 1.0)
    # What is linear in time has the mean of its middle.
    middles = (np.arange(60) / 59 - 0.5) * 7e-3
    np.testing.assert_allclose(poses.shares @ poses.delays_s, middles, atol=1e-12)
    # And of a piecewise linear function, the mean by many small steps.
    values = np.random.default_rng(0).normal(size=len(poses.delays_s))
    fine = np.linspace(-2e-3, 2e-3, 20001)
    for row in (0, 20, 59):
        mean = np.interp(middles[row] + fine, poses.delays_s, values)
        expected = np.trapezoid(mean, fine) / 4e-3
        assert poses.shares[row] @ values == pytest.approx(expected, abs=1e-6)


def test_speed_is_that_of_points_in_the_picture():
    scene = small()
    camera = scene.rig.camera
    moved = moving(velocity=tuple((10.0 * camera.pose.rotation[:, 0]).tolist()))
    depth = -camera.pose.position @ camera.pose.rotation[:, 2]
    per_mm = camera.lens.focal_length_mm / camera.pitch_mm[0] / depth
    panel = scene.rig.projector
    along = panel.pose.rotation.T @ camera.pose.rotation[:, 0]
    shown = np.hypot(along[0], along[1]) * panel.lens.focal_length_mm / panel.pitch_mm[0]
    shown /= -panel.pose.position @ panel.pose.rotation[:, 2]
    # The plane is not all at one distance.
    assert speed_px(moved, 1e-3) == pytest.approx(10.0 * max(per_mm, shown), rel=0.3)
    assert speed_px(scene, 1e-3) == 0.0


def test_points_are_of_the_middle_of_the_finest_set():
    # 30 mm/s over 8 pictures of 2 ms is 0.5 mm; points are within the ripple of a few um.
    scene = moving(velocity=(0.0, 0.0, 30.0), **{"patterns.sequence": "1@4,8@4"})
    found = scan(scene, seed=1, noise=False)
    pixels = found.cloud.pixels
    smooth = found.truth.smooth()[pixels[:, 1], pixels[:, 0]]
    error = (found.cloud.points - found.truth.point[pixels[:, 1], pixels[:, 0]])[smooth]
    at_rest = scan(still(scene), seed=1, noise=False)
    assert abs(np.median(error[:, 2])) < 0.01
    assert found.capture.timing is not None
    assert at_rest.capture.timing is None
    assert found.score.rms_mm > at_rest.score.rms_mm


def test_repeats_share_the_light_of_a_scene():
    scene = moving(velocity=(0.0, 0.0, 50.0))
    light = traced(scene, seed=3)
    shared = moving_light(scene, 3)
    one, two = (frames(scene, seed, True, light, shared) for seed in (1, 2))
    assert np.abs(one - two).max() > 0.0
    np.testing.assert_array_equal(frames(scene, 1, True, light, shared), one)


def test_budget_has_a_row_of_motion():
    scene = moving(velocity=(0.0, 0.0, 50.0), **{"patterns.sequence": "1,8"})
    (row,) = [one for one in sources_of(scene, 1e-3, 2) if one.name == "motion"]
    assert (row.kind, row.counted) == ("steady", True)
    assert not any(one.scene.moves for one in sources_of(scene, 1e-3, 2) if one.name != "motion")
    assert not any(one.name == "motion" for one in sources_of(small(), 1e-3, 2))
    exposure = row.scene.exposure
    assert (exposure.frame_period_s, exposure.pulse_s) == (2e-3, 1e-9)
    # It is all that the ideal scene has of error beside its floor, and as much as in the scene.
    assert in_motion(ideal(scene, lenses=True), scene, 1e-3).moves
    alone, whole, rest = (
        scan(one, seed=1, noise=False).score.median_abs_mm
        for one in (row.scene, scene, still(scene))
    )
    assert alone == pytest.approx(whole, rel=0.1)
    assert rest < 0.3 * whole


def test_what_cannot_move_is_refused():
    short = replace(small().exposure, rolling_shutter_s=5e-3, frame_period_s=7e-3)
    assert short.timing(1.0).period_s == 7e-3
    with pytest.raises(InputError, match=r"frame_period_ms: expected at least 12 ms, exposure .*7"):
        replace(short, pulse_s=7e-3).timing(1.0)
    wild = moving(velocity=(1e5, 0.0, 0.0), **{"exposure.pulse_ms": 50.0})
    wild = replace(wild, exposure=replace(wild.exposure, frame_period_s=0.05))
    with pytest.raises(InputError, match=f"at most {MOST_POSES // 4} px within a picture"):
        frames(wild)
    scene = moving(velocity=(0.0, 0.0, 1.0), **{"patterns.sequence": "1"})
    lens = replace(scene.rig.camera.lens, aperture_radius_mm=0.0)
    rig = scene.rig.having(camera=replace(scene.rig.camera, lens=lens))
    scene = replace(scene, rig=rig, exposure=replace(scene.exposure, pulse_s=None))
    with pytest.raises(InputError, match=r"exposure.pulse_ms: expected stated with a pinhole"):
        scan(scene)
    with pytest.raises(InputError, match=r"focus: expected none with motion"):
        load_scene(
            "plane", changes={"focus.settings": 3, "objects[0].velocity_mm_per_s": [0, 0, 1.0]}
        )
    with pytest.raises(InputError, match="nothing that moves: draws are of one light"):
        Measurement(moving(velocity=(0.0, 0.0, 1.0)), (), (), Lights())
