"""Wrong manifests and rigs: where a capture holds a trace of them, and where it is blind.

A camera sees a tilted plane through exact rays, so that frames follow from formulas.  What was
shown and what is stated differ in one thing.  The table is that of docs/explanation/evidence.md.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from slbench.capture.capture import Capture
from slbench.cloud.decoded import decode_capture
from slbench.core.errors import InputWarning
from slbench.patterns import Flat, Fringes, GrayCode, NoiseModel, PatternSequence, Rule
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.doubts import baseline_doubt

PANEL = (128, 96)
SHIFTS = 4
NOISE = NoiseModel(read_dn=1.0)
DOWN = (0.0, -1.0, 0.0)


def right_rig():
    """A camera of 72 x 54 px and a panel of 128 x 96 px, some 100 mm apart, fields alike."""
    camera = Pose.looking_at((-60.0, 10.0, 500.0), (0.0, 0.0, 0.0), DOWN)
    projector = Pose.looking_at((45.0, -5.0, 520.0), (0.0, 0.0, 0.0), DOWN)
    return Rig(
        Camera(72, 54, (0.1, 0.1), Lens(40.0), pose=camera),
        Projector(*PANEL, (0.05, 0.05), Lens(28.0), pose=projector),
    )


def seen_places(rig):
    """Panel coordinates that every camera pixel sees on the plane z = 0.1 x + 0.05 y."""
    camera = rig.camera
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    origins, directions = camera.unproject(pixels)
    normal = np.array([-0.1, -0.05, 1.0])
    distance = -(origins @ normal) / (directions @ normal)
    return rig.projector.project(origins + distance[..., np.newaxis] * directions)


PLACES = seen_places(right_rig())


def sequence(sets, axes):
    counts = (1,) if sets == "one" else (1, 8)
    parts = [Fringes(count, SHIFTS, axis) for axis in axes for count in counts]
    return PatternSequence(PANEL, tuple(parts))


def light(shown, noise=NOISE.read_dn, seed=0):
    """What the camera sees of a sequence of fringes."""
    rng = np.random.default_rng(seed)
    frames = []
    for placed in shown.placed():
        code = placed.code
        place = PLACES[..., 0 if code.axis == "u" else 1]
        phase = 2.0 * np.pi * code.count * (place + 0.5) / shown.size(code.axis)
        for k in range(len(placed.frames)):
            step = code.direction * 2.0 * np.pi * k / code.shifts
            frames.append(120.0 + 90.0 * np.cos(phase - step))
    frames = np.array(frames)
    return np.clip(np.rint(frames + rng.normal(0.0, noise, frames.shape)), 0, 255).astype(np.uint8)


@dataclass
class Case:
    shown: PatternSequence
    stated: PatternSequence
    order: list
    rig: Rig


def changed(sequence, **values):
    """The sequence with the finest set along u changed."""
    last = sequence.finest("u").index
    parts = list(sequence.parts)
    parts[last] = replace(parts[last], **values)
    return PatternSequence(PANEL, tuple(parts))


def from_camera(rig):
    """R and T from camera to projector."""
    camera, projector = rig.camera.pose, rig.projector.pose
    rotation = projector.rotation.T @ camera.rotation
    return rotation, projector.rotation.T @ (camera.position - projector.position)


def with_pose(rig, rotation, shift):
    """The rig whose R and T from camera to projector are these."""
    camera = rig.camera.pose
    turned = camera.rotation @ rotation.T
    pose = Pose(turned, camera.position - turned @ shift)
    return Rig(rig.camera, replace(rig.projector, pose=pose))


def case(kind, sets, axes):
    """What was shown and what is stated, wrong in one thing."""
    right, rig = sequence(sets, axes), right_rig()
    shown = stated = right
    order = list(range(right.n_frames))
    first = right.finest("u").frames.start
    rotation, shift = from_camera(rig)
    if kind == "count":
        stated = changed(right, count=12 if sets == "several" else 0.7)
    elif kind == "direction":
        stated = changed(right, direction=-1)
    elif kind == "order":
        order[first + 1], order[first + 2] = first + 2, first + 1
    elif kind == "late":
        order = [*order[1:], order[-1]]
    elif kind == "doubled":
        order = [*order[: first + 2], *order[first + 1 : -1]]
    elif kind == "inverted":
        rig = with_pose(rig, rotation.T, -rotation.T @ shift)
    elif kind == "negated":
        rig = with_pose(rig, rotation, -shift)
    elif kind == "swapped":
        camera, projector = rig.camera, rig.projector
        lenses = {"lens": projector.lens, "pitch_mm": projector.pitch_mm}
        back = {"lens": camera.lens, "pitch_mm": camera.pitch_mm}
        rig = Rig(replace(camera, **lenses), replace(projector, **back))
    elif kind == "metres":
        rig = with_pose(rig, rotation, shift / 1000.0)
    return Case(shown, stated, order, rig)


def told(kind, sets, axes, with_rig, seed=0):
    one = case(kind, sets, axes)
    frames = light(one.shown, seed=seed)[one.order]
    capture = Capture(frames, one.stated, noise=NOISE, rig=one.rig if with_rig else None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return decode_capture(capture).warnings


MANIFESTS = ("count", "direction", "order", "late", "doubled")
RIGS = ("inverted", "negated", "swapped")
EVERY = [(sets, axes) for sets in ("one", "several") for axes in ("u", "uv")]


def seen(kind, sets, axes, with_rig):
    """The table: whether the capture holds a trace of what is wrong."""
    if kind in ("count", "direction"):
        return sets == "several" or (axes == "uv" and with_rig)
    return kind in ("order", "late", "doubled", "negated") or axes == "uv"


@pytest.mark.parametrize("with_rig", [False, True])
@pytest.mark.parametrize(("sets", "axes"), EVERY)
def test_right_captures_are_not_questioned(sets, axes, with_rig):
    for seed in range(5):
        assert told("right", sets, axes, with_rig, seed) == ()


@pytest.mark.parametrize("with_rig", [False, True])
@pytest.mark.parametrize(("sets", "axes"), EVERY)
@pytest.mark.parametrize("kind", MANIFESTS)
def test_wrong_manifests(kind, sets, axes, with_rig):
    assert bool(told(kind, sets, axes, with_rig)) == seen(kind, sets, axes, with_rig)


@pytest.mark.parametrize(("sets", "axes"), EVERY)
@pytest.mark.parametrize("kind", RIGS)
def test_wrong_rigs(kind, sets, axes):
    assert bool(told(kind, sets, axes, True)) == seen(kind, sets, axes, True)


def test_metres_are_seen_in_the_rig_alone():
    """All lengths shrink alike: rays meet as before, but no devices stand 0.1 mm apart."""
    rig = case("metres", "several", "uv").rig
    assert told("metres", "several", "uv", True) == ()
    assert "in metres it would be" in baseline_doubt(rig)
    assert baseline_doubt(right_rig()) is None


def test_three_frames_always_fit_a_sinusoid():
    """Frames of one set of three in another order are a scan of another place: blind."""
    sequence = PatternSequence(PANEL, (Fringes(1, 3, "u"),))
    frames = light(sequence)[[0, 2, 1]]
    assert decode_capture(Capture(frames, sequence, noise=NOISE)).warnings == ()


def one_to_one(shown, noise, level=90.0, seed=0):
    """Frames of a camera that sees the panel one to one, uint8."""
    rng = np.random.default_rng(seed)
    frames = 40.0 + level * shown.images()
    return np.clip(np.rint(frames + rng.normal(0.0, noise, frames.shape)), 0, 255).astype(np.uint8)


def decoded(frames, sequence, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return decode_capture(Capture(frames, sequence, **options))


def test_noise_that_makes_orders_wrong_is_no_wrong_manifest():
    """1.6 % of the orders wrong by noise: no warning, and nine in ten of them masked."""
    sequence = PatternSequence((480, 40), (Fringes(1, 3), Fringes(16, 3)))
    frames = one_to_one(sequence, 2.0, level=40.0)
    noise = NoiseModel(read_dn=2.0)
    every = decode_capture(Capture(frames, sequence, noise=noise), max_order_residual=0.5)
    found = decode_capture(Capture(frames, sequence, noise=noise))
    assert every.warnings == found.warnings == ()

    def wrong(one):
        return np.count_nonzero(np.abs(one.phase.coordinate["u"] - np.arange(480)) > 15.0)

    assert 0.005 < wrong(every) / 19200 < 0.03
    assert wrong(found) < 0.1 * wrong(every)
    assert found.dropped["order"] > 0


def test_a_fine_set_shown_the_other_way_is_told():
    """The camera sees the panel one to one; without noise, and with none stated."""
    shown = PatternSequence((96, 8), (Fringes(1, 4), Fringes(8, 4, direction=-1)))
    stated = PatternSequence((96, 8), (Fringes(1, 4), Fringes(8, 4)))
    assert decoded(one_to_one(shown, 0.0), shown).warnings == ()
    (sentence,) = decoded(one_to_one(shown, 0.0), stated).warnings
    assert "fringe orders of parts[1] are no whole numbers" in sentence


def test_a_missed_bit_is_told():
    sequence = PatternSequence((96, 40), (GrayCode("u"),))
    frames = one_to_one(sequence, 1.0)
    assert decoded(frames, sequence).warnings == ()
    frames[3] = frames[2]
    (sentence,) = decoded(frames, sequence).warnings
    assert "bit 1 of parts[0] (frame 2) equals its inverse" in sentence


@pytest.mark.parametrize("cell", [1.0, 16.0])
def test_a_coarse_code_spreads_orders_rightly(cell):
    """Cells as wide as a fringe leave a uniform residual that is no fault."""
    sequence = PatternSequence((96, 40), (GrayCode("u", cell_px=cell), Fringes(6, 4)))
    assert decoded(one_to_one(sequence, 0.5), sequence).warnings == ()


def test_flicker_is_scatter_beyond_the_stated_noise():
    sequence = PatternSequence((96, 40), (Fringes(1, 8), Fringes(6, 8)))
    frames = one_to_one(sequence, 1.0).astype(float)
    frames *= 1.0 + 0.035 * np.array([1, -1] * 8)[:, None, None]
    sentences = decoded(frames.astype(np.uint8), sequence, noise=NOISE).warnings
    assert sentences
    assert all("times the stated noise" in one for one in sentences)


@pytest.mark.parametrize("sigma", [0.6, 2.0, 4.0])
def test_noise_is_measured_where_it_is_not_stated(sigma):
    """The fit's residuals of 3,840 pixels tell the deviation to a few per cent."""
    sequence = PatternSequence((96, 40), (Fringes(1, 8), Fringes(4, 8)))
    found = decoded(one_to_one(sequence, sigma), sequence)
    assert found.noise_kind == "measured"
    # Rounding adds its own twelfth.
    at = np.sqrt(found.noise.variance(85.0))
    assert at == pytest.approx(np.hypot(sigma, 12**-0.5), rel=0.08)


def test_a_response_of_the_projector_masks_nothing():
    """Its harmonics are left over by the fit, half of the modulation: no noise, and said so."""
    sequence = PatternSequence((96, 40), (Fringes(1, 4), Fringes(4, 4)))
    linear = (one_to_one(sequence, 0.0).astype(float) - 40.0) / 90.0
    bent = np.rint(40.0 + 90.0 * np.clip(linear, 0.0, 1.0) ** 3).astype(np.uint8)
    found = decoded(bent, sequence)
    assert found.noise_kind == "measured"
    assert any("the projector's response" in one for one in found.warnings)
    # But for the panel's ends, which such deviations do not tell from one another.
    assert found.phase.mask[:, 8:-8].all()


def test_what_blur_leaves_of_stripes_is_no_noise():
    sequence = PatternSequence.parse("xor2", (96, 40))
    shown = np.array([sequence.image(k) for k in range(sequence.n_frames)])
    frames = 30.0 + 110.0 * gaussian_filter1d(shown, 1.0, axis=2)
    assert decoded(np.rint(frames).astype(np.uint8), sequence).noise_kind == "lower bound"


def test_repeats_measure_noise_and_three_frames_do_not():
    sets = (Fringes(1, 3), Fringes(4, 3))
    once = PatternSequence((96, 40), sets)
    found = decoded(one_to_one(once, 2.0), once)
    assert found.noise_kind == "lower bound"
    twice = PatternSequence((96, 40), (*sets, Flat(0.5), Flat(0.5)))
    found = decoded(one_to_one(twice, 2.0), twice)
    assert found.noise_kind == "measured"
    assert np.sqrt(found.noise.variance(85.0)) == pytest.approx(2.0, rel=0.08)
    stated = decoded(one_to_one(once, 2.0), once, noise=NOISE)
    assert stated.noise_kind == "stated"


def test_gaps_are_noise_in_a_right_rig():
    """Median |gap| over its deviation is 0.6745 for Gaussian noise; 5 % for 3,888 points."""
    one = case("right", "several", "uv")
    found = decode_capture(Capture(light(one.shown), one.stated, noise=NOISE, rig=one.rig))
    stated = np.hypot(1.0, 12**-0.5)
    expected = 0.6745 * stated / np.sqrt(NOISE.variance(120.0))
    assert np.median(np.abs(found.gap.deviations)) == pytest.approx(expected, rel=0.05)
    assert found.lost == {"behind": 0, "no_meeting": 0}
    assert found.to_dict()["ray_gap"]["mm"]["p95"] < 0.05


def test_noise_of_floats_is_measured_as_that_of_whole_numbers():
    """Floats are not rounded: without a statement their noise is unknown, and not zero."""
    sequence = PatternSequence((96, 40), (Fringes(1, 4), Fringes(4, 4)))
    clean = one_to_one(sequence, 0.0).astype(np.float32)
    noisy = clean + np.random.default_rng(4).normal(0.0, 1.0, clean.shape).astype(np.float32)
    found = decoded(noisy, sequence)
    assert found.noise_kind == "measured"
    assert found.warnings == ()
    assert np.sqrt(found.noise.variance(85.0)) == pytest.approx(1.0, rel=0.08)
    assert np.nanmedian(found.phase.sigma["u"]) > 0.0
    three = PatternSequence((96, 40), (Fringes(1, 3), Fringes(4, 3)))
    assert decoded(one_to_one(three, 0.0).astype(np.float32), three).noise_kind == "lower bound"


@pytest.mark.parametrize("wrong", ["binary", "reversed"])
def test_bits_that_lie_beyond_the_panel_are_questioned(wrong):
    """A Gray code alone: 640 columns of 1024 that ten bits count."""
    shown = PatternSequence((640, 40), (GrayCode("u"),))
    frames = one_to_one(shown, 0.0)
    assert decoded(frames, shown).warnings == ()
    stated = shown
    if wrong == "binary":
        stated = PatternSequence((640, 40), (GrayCode("u", code="binary"),))
    else:
        frames = frames.reshape(-1, 2, *frames.shape[1:])[::-1].reshape(frames.shape).copy()
    found = decoded(frames, stated)
    assert any("beyond the panel" in one for one in found.warnings)


def test_ends_that_noise_blurs_are_not_questioned():
    """One set of one fringe: a fifth of the panel is within three deviations of its ends."""
    sequence = PatternSequence((96, 40), (Fringes(1, 3),))
    found = decoded(one_to_one(sequence, 22.0), sequence, noise=NoiseModel(read_dn=22.0))
    dropped = found.phase.dropped
    assert np.mean(dropped == Rule.END) > 0.15 * np.mean(np.isin(dropped, (Rule.END, Rule.KEPT)))
    assert not any("beyond the panel" in one for one in found.warnings)
