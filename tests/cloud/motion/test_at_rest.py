"""Motion between frames: the error of fringes by its closed form, and what compensation leaves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from slbench.capture.capture import Capture
from slbench.capture.exposures import Bracket
from slbench.cloud.decoded import decode_capture
from slbench.cloud.motion import at_rest
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.objects import build_artefact
from slbench.patterns import PatternSequence, relative_phase
from slbench.rig.motion import FrameTiming, Motion
from slbench.rig.optics.response import Response
from slbench.scene.file import load_scene
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan
from slbench.simulate.stack import capture_stack, traced

PERIOD = 5e-3
#: 16 bits: rounding is no part of what is looked at.
KEYS = {
    "detector.bit_depth": 16,
    "exposure.pulse_ms": 1e-3,
    "exposure.frame_period_ms": 1e3 * PERIOD,
}


def scene_of(name="plane", patterns="1,16@4", divisor=3, **changes):
    keys = KEYS | {"patterns.sequence": patterns} | changes
    return load_scene(name, preview=True, changes=keys).coarser(divisor, 8)


def moved(scene, motion):
    return replace(scene, objects=tuple(replace(item, motion=motion) for item in scene.objects))


def shot(scene, light, noise=False, seed=1):
    return capture_stack(scene, light, seed=seed, noise=noise).captures[0]


def drift_error(phase, step, count):
    """Return the phase error of N shifts of 2 pi / N while the phase drifts by `step` a frame.

    Of frames at times t_k = k - (N - 1) / 2, I_k = a + b cos(phi + e t_k - 2 pi k / N), the sum
    sum I_k exp(2 pi i k / N) is in proportion to 1 + r exp(-2 i phi) times exp(i phi), with

        r = exp(-2 pi i / N) sin(e / 2) / sin(e / 2 - 2 pi / N),

    by two geometric series.  For small e it is a ripple of twice the phase with the amplitude
    e / (2 sin(2 pi / N)), and no shift of the mean, as time zero is the middle of the set.
    """
    r = np.exp(-2j * np.pi / count) * np.sin(step / 2) / np.sin(step / 2 - 2.0 * np.pi / count)
    return np.angle(1.0 + r * np.exp(-2j * phase))


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_closed_form_is_that_of_frames_and_has_its_small_amplitude(count):
    phase = np.linspace(0.0, 2.0 * np.pi, 400)
    for step in (-0.3, 0.01, 0.4):
        times = np.arange(count) - 0.5 * (count - 1)
        shifts = 2.0 * np.pi * np.arange(count) / count
        frames = 2.0 + np.cos(phase + (step * times - shifts)[:, np.newaxis])
        found, _, _ = relative_phase(frames[:, np.newaxis])
        error = np.angle(np.exp(1j * (found[0] - phase)))
        np.testing.assert_allclose(error, drift_error(phase, step, count), atol=1e-12)
    small = drift_error(phase, 1e-3, count)
    assert np.abs(small).max() == pytest.approx(1e-3 / (2 * np.sin(2 * np.pi / count)), rel=2e-3)
    assert abs(small[:-1].mean()) < 1e-6


@pytest.mark.parametrize("count", [3, 4, 5])
def test_error_of_uniform_motion_follows_the_closed_form(count):
    # Along the camera's axis, near which a pixel sees points of one ray; the phase drifts evenly
    # there to some 1 % within the set.
    scene = scene_of(patterns=f"1,16@{count}")
    axis, rig = scene.rig.camera.pose.rotation[:, 2], scene.rig
    light, true = traced(scene, seed=1), Lights(1).truth(scene)
    v, u = np.nonzero(true.smooth())
    near = np.hypot(u - rig.camera.centre[0], v - rig.camera.centre[1]) < 15.0
    v, u = v[near], u[near]
    own = slice(-count, None)
    still, _, _ = relative_phase(shot(scene, light).frames[own])
    found = []
    for speed in (10.0, 50.0, 150.0):
        velocity = tuple((speed * axis).tolist())
        frames = shot(moved(scene, Motion(velocity_mm_per_s=velocity)), light).frames[own]
        phase, _, _ = relative_phase(frames)
        error = np.angle(np.exp(1j * (phase - still)))[v, u]
        points = true.point[v, u]
        ends = [points + 0.5 * sign * PERIOD * speed * axis for sign in (-1.0, 1.0)]
        places = [rig.projector.project(end)[:, 0] for end in ends]
        steps = 2.0 * np.pi * 16 / rig.projector.width * (places[1] - places[0])
        expected = drift_error(still[v, u], steps, count)
        found.append((np.std(error), np.std(expected), np.std(error - expected), np.mean(error)))
    for error, expected, off, mean in found:
        assert error == pytest.approx(expected, rel=0.02)
        assert off < 0.05 * expected
        assert abs(mean) < 0.05 * expected


def far_from_edges(mask, distance=4):
    return ndimage.binary_erosion(mask, iterations=distance)


def excess(scene, phase, still, kept):
    """Return how far points are from those of a scan at rest, (rms, share measured), mm."""
    clouds = [triangulate(scene.rig, one) for one in (phase, still)]
    images = [one.image(one.points) for one in clouds]
    off = np.linalg.norm(images[0] - images[1], axis=-1)[kept]
    return np.sqrt(np.nanmean(off**2)), np.mean(np.isfinite(off))


TILTED = {"objects[0].rotation_deg": [12.0, -8.0, 0.0]}


def ball(**changes):
    """Return the shipped scene of a sphere, its facets larger, to be traced sooner."""
    scene = scene_of("sphere", divisor=2, **changes)
    coarse = build_artefact("sphere", {"radius_mm": 12.5, "max_form_error_um": 10.0})
    return replace(scene, objects=(replace(scene.objects[0], artefact=coarse), *scene.objects[1:]))


@pytest.mark.parametrize(
    ("build", "changes", "velocity", "samples"),
    [
        (scene_of, TILTED, (0.0, 0.0, 40.0), 8),
        (scene_of, TILTED, (100.0, 50.0, 0.0), 64),
        (ball, {}, (0.0, 0.0, -40.0), 64),
        (ball, {}, (60.0, 30.0, 20.0), 32),
    ],
    ids=["plane-axial", "plane-lateral", "sphere-axial", "sphere-oblique"],
)
def test_nine_tenths_of_the_error_of_known_motion_are_removed(build, changes, velocity, samples):
    # Pixels that are looked up elsewhere have other Monte Carlo errors, hence more samples.
    scene = replace(build(**changes), samples=samples)
    light, true = traced(scene, seed=1), Lights(1).truth(scene)
    motion = Motion(velocity_mm_per_s=velocity)
    still = shot(scene, light).decode()
    shots = shot(moved(scene, motion), light)
    # Facets of a curved surface are no edges here; what comes over an edge is within 5 px.
    kept = far_from_edges(true.lit & still.mask & (true.object_id == 0), 5)
    before, _ = excess(scene, shots.decode(), still, kept)
    after, measured = excess(scene, at_rest(shots, motion.at).decode(), still, kept)
    assert kept.sum() > 200
    assert before > 0.02
    assert after < 0.1 * before
    assert measured > 0.99


def test_gray_codes_and_rotation_and_rolling_shutters_are_followed():
    keys = TILTED | {"exposure.rolling_shutter_ms": 4.0}
    scene = scene_of(patterns="gray+16@4", **keys)
    light, true = traced(scene, seed=1), Lights(1).truth(scene)
    motion = Motion(velocity_mm_per_s=(10.0, 0.0, 30.0), rotation_deg_per_s=(20.0, 30.0, 0.0))
    middle = tuple(scene.objects[0].middle.tolist())
    known = replace(motion, centre_mm=middle)
    still = shot(scene, light).decode()
    shots = shot(moved(scene, motion), light)
    kept = far_from_edges(true.smooth() & still.mask, 6)
    before, _ = excess(scene, shots.decode(), still, kept)
    after, measured = excess(scene, at_rest(shots, known.at).decode(), still, kept)
    assert after < 0.1 * before
    assert measured > 0.99


def test_frames_of_what_rests_stay_and_their_deviations_are_those_of_noise():
    scene = scene_of()
    shots = replace(
        shot(scene, traced(scene, seed=1), noise=True), timing=FrameTiming(period_s=PERIOD)
    )
    still = at_rest(shots, Motion().at)
    # Least squares and back, in single precision.
    np.testing.assert_allclose(still.capture.frames, shots.frames, atol=0.02)
    phase, plain = still.decode(), shots.decode()
    both = phase.mask & plain.mask
    np.testing.assert_allclose(phase.coordinate["u"][both], plain.coordinate["u"][both], atol=1e-4)
    np.testing.assert_allclose(phase.sigma["u"][both], plain.sigma["u"][both], rtol=1e-3)


def test_frames_of_unknown_noise_keep_their_rounding():
    """Its steps are those of the frames as they were taken, not of what they became."""
    scene = scene_of(patterns="1,16@3", **{"detector.bit_depth": 8})
    shots = shot(scene, traced(scene, seed=1))
    timed = replace(shots, noise=None, timing=FrameTiming(period_s=PERIOD))
    plain, found = decode_capture(timed), decode_capture(timed, motion=Motion())
    assert found.noise == plain.noise
    both = plain.phase.mask & found.phase.mask
    sigma = [one.phase.sigma["u"][both] for one in (plain, found)]
    assert sigma[0].min() > 0.0
    # Modulations are those of frames that were looked up and back, in single precision.
    np.testing.assert_allclose(sigma[1], sigma[0], rtol=1e-2)


def test_what_rests_before_a_rig_that_moves_is_not_looked_at():
    rig = Motion(velocity_mm_per_s=(0.0, 50.0, 0.0))
    two = load_scene("v-groove", preview=True)
    first, second = two.objects
    with_rig = replace(two, rig_motion=rig, objects=(replace(first, motion=rig), second))
    # The second passes the other way, and the first not at all.
    expected = with_rig.path_of(second)(0.5)
    assert expected.position[1] == pytest.approx(-25.0)
    np.testing.assert_allclose(with_rig.common_path(0.5).position, expected.position, atol=1e-12)
    other = replace(first, motion=Motion(velocity_mm_per_s=(0.0, 20.0, 0.0)))
    with pytest.raises(InputError, match="several"):
        _ = replace(with_rig, objects=(other, second)).common_path


def test_saturated_pixels_stay_so():
    scene = scene_of(**{"exposure.white_level": 0.8})
    motion = Motion(velocity_mm_per_s=(0.0, 0.0, 20.0))
    shots = shot(moved(scene, motion), traced(scene, seed=1))
    frames = shots.frames.copy()
    spoilt = (slice(30, 34), slice(40, 44))
    frames[5][spoilt] = 65535
    found = at_rest(replace(shots, frames=frames), motion.at).decode()
    assert not found.mask[31:33, 41:43].any()
    assert at_rest(shots, motion.at).decode().mask[31:33, 41:43].all()


def test_what_cannot_be_followed_is_refused():
    panel = (64, 48)
    sequence = PatternSequence.parse("1@4", panel)
    bare = Capture(np.zeros((4, 48, 64), np.uint8), sequence)
    with pytest.raises(InputError, match="motion: expected a rig"):
        at_rest(bare, Motion().at)
    scene = scene_of()
    shots = shot(scene, traced(scene, seed=1))
    with pytest.raises(InputError, match="frame_period_ms: expected the time from frame to frame"):
        at_rest(shots, Motion().at)
    timed = replace(shots, timing=FrameTiming(period_s=0.1))
    with pytest.raises(InputError, match="response: expected a linear projector"):
        at_rest(replace(timed, response=Response(2.2)), Motion().at)
    several = Bracket.of(np.stack([timed.frames] * 2), (0.01, 0.02), 1e9)
    with pytest.raises(InputError, match="motion: expected a capture of one exposure"):
        at_rest(replace(timed, bracket=several), Motion().at)
    dark = replace(timed, frames=np.zeros_like(timed.frames))
    with pytest.raises(InputError, match="motion: expected points to follow"):
        at_rest(dark, Motion().at)


def test_scenes_ask_for_compensation():
    keys = {"objects[0].velocity_mm_per_s": [0.0, 0.0, 40.0]}
    found = {}
    for how in ("none", "known", "estimated"):
        scene = scene_of(**keys | {"decode.motion": how})
        result = scan(scene, seed=1, noise=False)
        found[how] = result.score.median_abs_mm
    assert found["known"] < 0.2 * found["none"]
    assert found["estimated"] < 0.2 * found["none"]
    two = load_scene("v-groove", preview=True, changes=KEYS | {"decode.motion": "known"})
    motions = [Motion(velocity_mm_per_s=(0.0, 0.0, z)) for z in (1.0, 2.0)]
    items = tuple(replace(i, motion=m) for i, m in zip(two.objects, motions, strict=True))
    with pytest.raises(InputError, match=r"decode\.motion: expected one motion of all objects"):
        scan(replace(two, objects=items))
