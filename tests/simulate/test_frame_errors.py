"""Frame errors: bit planes, lost triggers and drift, by their closed forms.

A camera of 64 x 4 pixels sees a panel of as many, pixel by pixel, so that frames are what the panel
shows.
"""

import warnings
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from slbench.bench.budget.budget import error_budget
from slbench.bench.budget.sources import Source, sources_of
from slbench.bench.compare import compare as compare_module
from slbench.cloud.decoded import decode_capture
from slbench.core.errors import InputError, InputWarning
from slbench.design.fringes import trial
from slbench.detector import Detector
from slbench.patterns import Flat, Fringes, PatternSequence, relative_phase
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.scene.colour import Colour
from slbench.scene.file import load_scene
from slbench.scene.frame_errors import BitPlanes, Drift, Trigger
from slbench.scene.model import Exposure
from slbench.simulate import lights
from slbench.simulate.colour import ColourTransport
from slbench.simulate.expose import Shutter, capture, radiance_batches
from slbench.simulate.frame_errors import frame_errors
from slbench.simulate.scan import scan
from slbench.simulate.stack import check_frame_errors
from slbench.simulate.transport import LightTransport

SIZE = (64, 4)
AMBIENT = 0.3
#: 16 bits of a well of which white and ambient light take 0.8.
DETECTOR = Detector(bit_depth=16, full_well_e=1e6, read_noise_e=10.0, prnu=0.0, dsnu_e=0.0)
SHUTTER = Shutter(0.8 * 1e6 / DETECTOR.quantum_efficiency / (1.0 + AMBIENT), 0.01)
STEP = 1.5 * (1.0 + AMBIENT) / 0.8 / 65535.0  # of radiance, that rounding and dark charge leave
FACING = np.diag([1.0, -1.0, -1.0])
RIG = Rig(
    Camera(*SIZE, (0.1, 0.1), Lens(20.0), pose=Pose(FACING, np.array([-20.0, 0.0, 200.0]))),
    Projector(*SIZE, (0.1, 0.1), Lens(20.0), pose=Pose(FACING, np.array([20.0, 0.0, 200.0]))),
)


def identity():
    pixels = np.arange(SIZE[0] * SIZE[1])
    given = np.ones(len(pixels)), SIZE[::-1], SIZE, np.full(SIZE[::-1], AMBIENT)
    return LightTransport.from_entries(pixels, pixels, *given)


TRANSPORT = identity()


def sequence(*parts):
    return PatternSequence(SIZE, parts or (Flat(1.0), Fringes(1, 4, "u"), Fringes(1, 3, "v")))


def shots(exposure=None, shown=None, **options):
    options = {"noise": False, "shutter": SHUTTER} | options
    given = TRANSPORT, shown or sequence(), RIG, DETECTOR, exposure or Exposure()
    return capture(*given, **options)


def radiance(frames):
    """Return what the panel showed, of DN without noise."""
    return (frames - DETECTOR.black_dn) * DETECTOR.e_per_dn / 8e5 * (1.0 + AMBIENT) - AMBIENT


# -- bit planes ---------------------------------------------------------------------------------


@given(
    st.integers(1, 10), st.integers(1, 5), st.floats(0.0, 1.0), st.sampled_from(["most", "least"])
)
def test_whole_periods_show_whole_grey_levels(planes, periods, start, first):
    found = BitPlanes(periods=float(periods), first=first).weights(planes, float(periods), start)
    np.testing.assert_allclose(found, 2.0 ** np.arange(planes) / (2**planes - 1), atol=1e-12)


@given(st.floats(0.05, 4.0), st.floats(0.0, 1.0), st.sampled_from(["most", "least"]))
def test_weights_are_the_time_that_planes_are_lit(periods, start, first):
    """By looking at 4000 moments of the exposure, which is off by one of them at each edge."""
    planes, moments = 5, 4000
    order = np.arange(planes)[:: -1 if first == "most" else 1]
    edges = np.cumsum(2.0**order) / 31.0
    times = (start + periods * (np.arange(moments) + 0.5) / moments) % 1.0
    lit = order[np.minimum(np.searchsorted(edges, times, side="right"), planes - 1)]
    expected = [np.mean(lit == plane) for plane in range(planes)]
    found = BitPlanes(periods=periods, first=first).weights(planes, periods, start)
    # A plane is lit up to five times in four periods: ten edges.
    np.testing.assert_allclose(found, expected, atol=10.0 / moments)


@given(st.floats(0.05, 4.0), st.floats(0.0, 1.0))
def test_errors_are_bounded_by_what_is_beyond_whole_periods(periods, start):
    rest = periods % 1.0
    weights = BitPlanes(periods=periods).weights(8, periods, start)
    bits = (np.arange(256)[:, None] >> np.arange(8)) & 1
    error = bits @ weights - np.arange(256) / 255.0
    assert np.abs(error).max() <= rest * (1.0 - rest) / periods + 1e-12
    assert abs(error[0]) < 1e-12
    assert abs(error[255]) < 1e-12


def test_the_first_half_of_a_period_is_the_highest_bit():
    """128 / 255 of a period, most significant plane first: a fringe becomes a square wave."""
    exposure = Exposure(bit_planes=BitPlanes(periods=128.0 / 255.0))
    shown = sequence(Fringes(1, 4, "u"))
    grey = np.rint(255.0 * radiance(shots(shown=shown).frames))
    found = radiance(shots(exposure, shown).frames)
    np.testing.assert_allclose(found, grey >= 128, atol=STEP)


def test_fringes_of_one_and_a_half_periods_have_the_phase_of_their_levels():
    """(g + 0.5 x 255 x what half a period adds) / 1.5, decoded by the formula of four shifts."""
    exposure = Exposure(bit_planes=BitPlanes(periods=1.5))
    shown = sequence(Fringes(1, 4, "u"))
    grey = np.rint(255.0 * radiance(shots(shown=shown).frames)).astype(int)
    # The rest of half a period ends within the first plane, which is lit for 128 / 255 of it.
    levels = (grey / 255.0 + 0.5 * (grey >> 7 & 1)) / 1.5
    frames = shots(exposure, shown).frames
    np.testing.assert_allclose(radiance(frames), levels, atol=STEP)
    phase, _, _ = relative_phase(frames.astype(float))
    expected, right = (np.arctan2(f[1] - f[3], f[0] - f[2]) for f in (levels, grey / 255.0))
    off = np.angle(np.exp(1j * (phase - expected)))
    assert np.abs(off).max() < 1e-3  # rounding of both, over a modulation of 0.5
    assert np.abs(np.angle(np.exp(1j * (expected - right)))).max() > 0.05  # and it is an error


def test_a_free_running_panel_is_right_on_average():
    exposure = Exposure(bit_planes=BitPlanes(periods=0.6, free_running=True))
    shown = sequence(Fringes(1, 4, "u"))
    clean = shots(shown=shown).frames.astype(float)
    np.testing.assert_array_equal(shots(exposure, shown).frames, clean)  # what is expected
    noisy = [radiance(shots(exposure, shown, noise=True, seed=s).frames) for s in range(300)]
    mean, deviation = np.mean(noisy, axis=0), np.std(noisy, axis=0)
    assert deviation.max() > 0.05  # a rest of 0.6 x 0.4 / 0.6 at most, uniform starts
    # All of a frame start together: 16 levels a frame at most, 64 means. 4.5 deviations each.
    limit = 4.5 * deviation / np.sqrt(300) + STEP
    assert np.all(np.abs(mean - radiance(clean)) < limit)
    one, other = noisy[0], radiance(shots(exposure, shown, noise=True, seed=0).frames)
    np.testing.assert_array_equal(one, other)


def test_a_period_is_compared_with_the_exposure_time():
    planes = BitPlanes(period_s=0.004)
    assert planes.lasting(0.01) == pytest.approx(2.5)
    given = (Exposure(bit_planes=planes), RIG.projector, 3, 0.01)
    errors = frame_errors(*given, seed=0, noise=False)
    expected = BitPlanes(periods=2.5).weights(8, 2.5, 0.0)
    np.testing.assert_allclose(errors.weights, np.tile(expected, (3, 1)))


# -- drift --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drift", "gains"),
    [
        (Drift(change=0.1, pictures=5.0), [1.0, 1.02, 1.04, 1.06]),
        (Drift(kind="exponential", change=-0.5, pictures=2.0), [1.0, 0.5**0.5, 0.5, 0.5**1.5]),
        (
            Drift(kind="warm-up", change=0.2, pictures=3.0),
            1.0 - 0.2 * np.exp(-np.arange(4) / 3.0),
        ),
    ],
)
def test_a_drifting_lamp_dims_the_panel_and_not_the_room(drift, gains):
    shown = sequence(Fringes(1, 4, "u"))
    clean = radiance(shots(shown=shown).frames)  # the room's light taken off
    found = radiance(shots(Exposure(drift=drift), shown).frames)
    np.testing.assert_allclose(found, np.array(gains)[:, None, None] * clean, atol=2.0 * STEP)


@pytest.mark.parametrize("shifts", [3, 4, 7])
def test_linear_drift_shifts_phase_by_its_closed_form(shifts):
    r"""I_k = (a + b cos(phi - d_k)) (1 + e k), decoded by S = sum of I_k exp(i d_k).

    With w = exp(2 pi i / N) and sum of k w^k = N / (w - 1), sum of k = N (N - 1) / 2,
    sum of k w^2k = N / (w^2 - 1):

        S = N b e^(i phi) / 2
            + e (a N / (w - 1) + b/2 e^(i phi) N (N - 1) / 2 + b/2 e^(-i phi) N / (w^2 - 1)) .

    Exact in e; ambient light A adds nothing to the drift.
    """
    e, n = 0.02, shifts
    shown = sequence(Fringes(1, n, "u"))
    found = shots(Exposure(drift=Drift(change=e, pictures=1.0)), shown)
    phase, _, _ = relative_phase(found.frames.astype(float))
    clean, _, _ = relative_phase(shots(shown=shown).frames.astype(float))
    phi = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    assert np.abs(np.angle(np.exp(1j * (clean - phi)))).max() < 0.01  # 8 bits of the panel
    a = b = 0.5
    w = np.exp(2j * np.pi / n)
    turn = np.exp(1j * phi)
    drifted = a * n / (w - 1.0) + 0.25 * b * turn * n * (n - 1.0)
    drifted += 0.5 * b / turn * n / (w * w - 1.0)
    expected = np.angle((0.5 * n * b * turn + e * drifted) / turn)
    error = np.angle(np.exp(1j * (phase - clean)))
    # The panel's 8 bits are off by 1/510 of white, which the drift takes e of: 1e-3 of the error.
    np.testing.assert_allclose(error, np.broadcast_to(expected, error.shape), atol=4e-4)
    assert np.abs(expected).max() > 0.01


# -- lost triggers ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effect", "sees"),
    [
        ("repeat", [0, 1, 1, 3, 4, 4, 6, 7]),
        ("late", [0, 1, 1, 2, 3, 3, 4, 5]),
        ("skip", [0, 1, 3, 4, 5, 7, 7, 7]),
    ],
)
def test_pictures_see_other_patterns(effect, sees):
    """Triggers 2 and 5 of eight pictures are lost; both axes are coded."""
    exposure = Exposure(trigger=Trigger(lost=(2, 5), effect=effect))
    clean, found = shots(), shots(exposure)
    np.testing.assert_array_equal(found.frames, clean.frames[sees])


def test_a_mixed_picture_sees_both():
    exposure = Exposure(trigger=Trigger(lost=(4, 7), effect="mix", share=0.25))
    clean, found = radiance(shots().frames), radiance(shots(exposure).frames)
    expected = clean.copy()
    expected[4] = 0.75 * clean[4] + 0.25 * clean[5]  # of u the last, of v the first; none after 7
    np.testing.assert_allclose(found, expected, atol=2.0 * STEP)


def test_other_pictures_keep_their_noise():
    exposure = Exposure(trigger=Trigger(lost=(3,)))
    clean, found = shots(noise=True, seed=5).frames, shots(exposure, noise=True, seed=5).frames
    others = [0, 1, 2, 4, 5, 6, 7]
    np.testing.assert_array_equal(found[others], clean[others])
    assert np.count_nonzero(found[3] != clean[2]) > 100  # seen again, with noise of its own
    assert abs(radiance(found[3] - 0.0) - radiance(clean[2] - 0.0)).max() < 0.02


def test_rates_are_drawn_and_left_out_without_noise():
    """Binomial test at 1e-4."""
    given = (Exposure(trigger=Trigger(rate=0.1)), RIG.projector, 50, 0.01)
    lost = 0
    for seed in range(40):
        errors = frame_errors(*given, seed=seed, noise=True)
        lost += np.count_nonzero(errors.source != np.arange(50))
        again = frame_errors(*given, seed=seed, noise=True)
        np.testing.assert_array_equal(errors.source, again.source)
    # The first picture has none before it.
    assert stats.binomtest(lost, 40 * 49, 0.1).pvalue > 1e-4
    quiet = frame_errors(*given, seed=0, noise=False)
    assert not any(quiet.is_other(k) for k in range(50))


def warned(exposure, shown, seed=0):
    """Return what decoding says of noisy frames; the rig is not that of light pixel to pixel."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        found = shots(exposure, shown, noise=True, seed=seed)
        return decode_capture(replace(found, rig=None)).warnings


@pytest.mark.parametrize("effect", ["repeat", "late", "skip", "mix"])
def test_decoding_questions_lost_triggers(effect):
    """Any of twelve pictures (docs/explanation/evidence.md), but where nothing changes."""
    shown = sequence(*(Fringes(count, 4, "u") for count in (1, 4, 12)))
    assert warned(None, shown) == ()
    for k in range(12):
        said = warned(Exposure(trigger=Trigger(lost=(k,), effect=effect)), shown, seed=k)
        same = {"repeat": k == 0, "late": False, "skip": k == 11, "mix": k == 11}[effect]
        assert bool(said) != same, (k, said)


def test_a_repeated_picture_is_named():
    shown = sequence(Fringes(1, 4, "u"), Fringes(2, 4, "u"))
    said = warned(Exposure(trigger=Trigger(lost=(5,))), shown)
    assert any("5" in one for one in said), said


# -- together -----------------------------------------------------------------------------------


def test_errors_act_on_pictures_in_colour():
    """Three frames of a colour picture are lit, and lost, together."""
    parts = (Flat(1.0), Flat(0.5), Flat(0.25), Flat(0.75), Flat(0.5), Flat(1.0))
    shown = replace(sequence(*parts), crosstalk=((0.9, 0.1, 0.0), (0.1, 0.8, 0.1), (0.0, 0.1, 0.9)))
    exposure = Exposure(drift=Drift(change=-0.2, pictures=1.0), trigger=Trigger(lost=(1,)))
    clean, found = radiance(shots(shown=shown).frames), radiance(shots(exposure, shown).frames)
    np.testing.assert_allclose(found[:3], clean[:3], atol=2.0 * STEP)
    np.testing.assert_allclose(found[3:], 0.8 * clean[:3], atol=2.0 * STEP)


def test_light_in_three_bands_has_the_same_errors():
    """Grey patterns in colour: each channel sees the pictures that a camera without colour sees."""
    drift, planes = Drift(change=-0.2, pictures=10.0), BitPlanes(periods=1.3)
    exposure = Exposure(drift=drift, bit_planes=planes, trigger=Trigger(lost=(4,), effect="mix"))
    errors = frame_errors(exposure, RIG.projector, 8, 0.01, seed=0, noise=False)
    light = ColourTransport.of([TRANSPORT] * 3, Colour())
    grey, colour = (
        {
            int(k): image
            for indices, images in radiance_batches(t, sequence(), RIG.projector, errors)
            for k, image in zip(indices, images, strict=True)
        }
        for t in (TRANSPORT, light)
    )
    assert set(grey) == set(colour) == set(range(8))
    for k, image in grey.items():
        np.testing.assert_allclose(colour[k], image, rtol=1e-5)  # single precision


def test_each_error_is_a_source_of_the_budget():
    scene = load_scene(
        "plane",
        preview=True,
        changes={
            "exposure.bit_planes.periods": 1.5,
            "exposure.trigger.rate": 0.05,
            "exposure.drift.change": 0.01,
        },
    )
    found = {one.name: one for one in sources_of(scene, 0.01, 4) if isinstance(one, Source)}
    kinds = {name: found[name].kind for name in found if "plane" in name or "drift" in name}
    assert kinds["grey levels by bit planes"] == "steady"
    assert kinds["brightness drift"] == "steady"
    assert found["lost triggers"].kind == "random"
    assert not found["shot noise"].scene.exposure.has_frame_errors
    assert found["brightness drift"].scene.exposure.trigger is None


def test_scenes_have_tables_of_them():
    changes = {
        "exposure.bit_planes.period_ms": 8.33,
        "exposure.bit_planes.first": "least",
        "exposure.trigger.lost": [3],
        "exposure.trigger.effect": "late",
        "exposure.drift.kind": "warm-up",
        "exposure.drift.change": 0.1,
    }
    made = load_scene("plane", changes=changes).exposure
    assert made.bit_planes == BitPlanes(period_s=8.33e-3, first="least")
    assert made.trigger == Trigger(lost=(3,), effect="late")
    assert made.drift == Drift(kind="warm-up", change=0.1)
    assert made.without_frame_errors() == load_scene("plane").exposure


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"exposure.bit_planes.start": 0.5}, ["exposure.bit_planes", "period_ms or periods"]),
        (
            {"exposure.bit_planes.periods": 1.0, "exposure.bit_planes.period_ms": 1.0},
            ["exposure.bit_planes", "one of period_ms or periods"],
        ),
        (
            {
                "exposure.bit_planes.periods": 1.0,
                "exposure.bit_planes.free_running": True,
                "exposure.bit_planes.start": 0.5,
            },
            ["exposure.bit_planes", "free_running"],
        ),
        ({"exposure.trigger.effect": "repaet"}, ["exposure.trigger.effect", "repeat"]),
        ({"exposure.trigger.rate": 1.5}, ["exposure.trigger.rate", "1.5"]),
        ({"exposure.drift.change": -1.0}, ["exposure.drift.change", "-1"]),
        ({"exposure.drift.kind": "linea"}, ["exposure.drift.kind", "linear"]),
    ],
)
def test_tables_refuse_what_cannot_be(changes, words):
    with pytest.raises(InputError) as caught:
        load_scene("plane", changes=changes)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_scan_refuses_them_before_it_traces():
    scene = load_scene("plane", preview=True, changes={"exposure.trigger.lost": [9]})
    stages = []
    with pytest.raises(InputError, match=r"scene plane: exposure\.trigger\.lost: .*0 to 8, got 9"):
        scan(scene, on_progress=lambda stage, done: stages.append(stage))
    assert stages == []


def untraced(monkeypatch):
    """Let all that traces light fail."""
    for module in (lights, compare_module, trial):
        monkeypatch.setattr(module, "traced", lambda *_, **__: pytest.fail("traced"))


@pytest.mark.parametrize(
    "ask",
    [
        lambda scene: compare_module.compare(scene, ["1,10,50@3", "1@3"], repeats=2),
        lambda scene: error_budget(scene.with_patterns("1@3"), repeats=2),
        lambda scene: trial.noise_of_scene(scene, (1,)),
    ],
)
def test_sets_of_fewer_pictures_are_refused_before_light_is_traced(ask, monkeypatch):
    untraced(monkeypatch)
    scene = load_scene("plane", preview=True, changes={"exposure.trigger.lost": [4]})
    with pytest.raises(
        InputError, match=r"(set 1@3|scene plane): .*trigger\.lost: .*0 to 2, got 4"
    ):
        ask(scene)


def test_noise_by_focus_stacks_has_no_frame_errors(monkeypatch):
    """Each fringe set would be a stack of its own, with a drift of its own."""
    untraced(monkeypatch)
    scene = load_scene("ch8-stack", preview=True, changes={"exposure.drift.change": 0.1})
    with pytest.raises(InputError, match=r"exposure: .*no frame errors with focus settings"):
        trial.noise_of_scene(scene, (1, 4))


def test_the_fully_lit_picture_of_a_stack_counts():
    scene = load_scene("ch8-stack", preview=True)
    count = scene.sequence.n_frames
    assert scene.sequence.lit_frame is None
    for lost, fits in ((count, True), (count + 1, False)):
        exposure = replace(scene.exposure, trigger=Trigger(lost=(lost,)))
        with nullcontext() if fits else pytest.raises(InputError, match=f"0 to {count}, got"):
            check_frame_errors(replace(scene, exposure=exposure))


def test_a_period_asks_for_an_exposure_time():
    scene = load_scene("plane", preview=True)
    camera = replace(scene.rig.camera, lens=replace(scene.rig.camera.lens, aperture_radius_mm=0.0))
    for planes, fits in ((BitPlanes(periods=1.5), True), (BitPlanes(period_s=0.01), False)):
        exposure = replace(scene.exposure, bit_planes=planes)
        own = replace(scene, rig=scene.rig.having(camera=camera), exposure=exposure)
        with nullcontext() if fits else pytest.raises(InputError, match=r"period_ms: .*periods"):
            check_frame_errors(own)


def test_pictures_that_there_are_not_are_refused():
    with pytest.raises(InputError, match=r"trigger\.lost.*pictures 0 to 7.*8"):
        shots(Exposure(trigger=Trigger(lost=(8,))))
    with pytest.raises(InputError, match=r"drift\.change.*picture 7"):
        shots(Exposure(drift=Drift(change=-0.9, pictures=6.0)))


def test_stated_losses_are_a_row_of_their_own_beside_those_by_chance():
    """A spread alone would leave out what they shift."""
    trigger = Trigger(lost=(2,), rate=0.02)
    scene = replace(load_scene("plane", preview=True), exposure=Exposure(trigger=trigger))
    found = {one.name: one for one in sources_of(scene, 0.01, 4) if isinstance(one, Source)}
    chance, stated = found["lost triggers"], found["lost triggers that are stated"]
    assert (chance.kind, chance.scene.exposure.trigger) == ("random", Trigger(rate=0.02))
    assert (stated.kind, stated.scene.exposure.trigger) == ("steady", Trigger(lost=(2,)))
