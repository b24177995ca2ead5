"""Adaptive fringes on a panel that a camera sees pixel by pixel: by closed forms and many draws."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes_small import run_cli
from scipy.optimize import least_squares

from slbench import objects
from slbench.bench.compare.compare import compare
from slbench.bench.compare.frames_needed import FramesNeeded, _crossing, frames_needed
from slbench.bench.compare.sets import AdaptiveSet, pattern_sets
from slbench.core.errors import InputError
from slbench.core.io import read_json
from slbench.design.adaptive.adapt import adapt
from slbench.design.adaptive.choose import best, forecasts, known, levels, mask_for
from slbench.design.adaptive.estimate import added_up, estimated
from slbench.design.adaptive.scan import scan_adaptively
from slbench.design.adaptive.shots import SHIFTS, DimmedFringes, Instrument, Shot
from slbench.detector import Detector
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.scene.file import load_scene
from slbench.scene.frame_errors import Drift
from slbench.scene.model import Scene, SceneObject
from slbench.simulate.transport import LightTransport

SIZE = (160, 10)
RIG = Rig(
    Camera(
        *SIZE,
        (0.1, 0.1),
        Lens(40.0),
        pose=Pose.looking_at((-80.0, 0.0, 400.0), (0, 0, 0), (0, -1, 0)),
    ),
    Projector(
        *SIZE,
        (0.1, 0.1),
        Lens(40.0),
        pose=Pose.looking_at((80.0, 0.0, 400.0), (0, 0, 0), (0, -1, 0)),
    ),
)
DETECTOR = Detector(bit_depth=12, prnu=0.0, dsnu_e=0.0)
TRUE = np.tile(np.arange(SIZE[0]), SIZE[1])
#: Columns from here on are nearly black.
DARK = 80


def transport(dark=0.05):
    pixels = np.arange(SIZE[0] * SIZE[1])
    light = np.where(TRUE >= DARK, dark, 1.0)
    return LightTransport.from_entries(
        pixels, pixels, light, SIZE[::-1], SIZE, np.zeros(SIZE[::-1])
    )


@cache
def scene():
    plate = SceneObject(objects.build_artefact("plane", {"size_mm": (160.0, 20.0)}))
    sequence = PatternSequence.parse("1,8", SIZE)
    return Scene("flat", RIG, (plate,), sequence, detector=DETECTOR)


@cache
def adapted(seed=0, dark=0.05, **options):
    return adapt(scene(), transport(dark), seed=seed, keep_trail=True, **options)


def tool(dark=0.05, seed=0, noise=True):
    return Instrument(scene(), transport(dark), seed=seed, noise=noise)


# -- what all sets say together ------------------------------------------------------------------


def test_all_frames_take_part_with_the_weight_of_their_information():
    """Against a fit of all frames at once, weighted by their variance, from the truth."""
    instrument, shots = tool(), [Shot(1), Shot(8), Shot(8, 2.0), Shot(30)]
    taken = [instrument.take(shot) for shot in shots]
    found = estimated(taken, SIZE[0])
    information = np.zeros(TRUE.size)
    for one in taken:
        turn = 2.0 * np.pi * one.shot.count / SIZE[0]
        information += np.where(one.usable, (turn * np.abs(one.wave)) ** 2 / one.variance, 0.0)
    good = found.finest == 30
    assert good.mean() > 0.4
    # Frames of a count weigh by what all of them have of modulation: equal to a per cent or two.
    np.testing.assert_allclose(found.sigma[good], information[good] ** -0.5, rtol=0.03)
    # The same by least squares of the waves at one pixel, on coordinate and modulations.
    for p in np.flatnonzero(good)[:: good.sum() // 5]:
        waves = [(w.count, w.wave[p], w.variance[p] ** 0.5) for w in found.waves]

        def rest(x, waves=waves):
            out = []
            for k, (count, wave, deviation) in enumerate(waves):
                model = x[k + 1] * np.exp(2j * np.pi * count * (x[0] + 0.5) / SIZE[0])
                out += [(wave - model).real / deviation, (wave - model).imag / deviation]
            return np.array(out)

        start = [TRUE[p], *(abs(wave) for _, wave, _ in waves)]
        fit = least_squares(rest, start, x_scale=np.maximum(np.abs(start), 1e-3))
        # Second order in the noise apart: a twentieth of a deviation.
        assert fit.x[0] == pytest.approx(found.coordinate[p], abs=0.1 * found.sigma[p])
        variance = np.linalg.inv(fit.jac.T @ fit.jac)[0, 0]
        assert found.sigma[p] == pytest.approx(variance**0.5, rel=0.03)


def test_an_order_that_is_not_safe_is_not_believed():
    """30 fringes after one alone: no pixel takes them; after 8 the bright ones do."""
    instrument = tool()
    taken = [instrument.take(Shot(1)), instrument.take(Shot(30))]
    assert (estimated(taken, SIZE[0]).finest[TRUE >= DARK] <= 1).all()
    more = [*taken, instrument.take(Shot(8))]
    assert (estimated(more, SIZE[0]).finest[(TRUE < DARK) & (TRUE > 2)] == 30).mean() > 0.99


def test_stated_deviations_are_right_over_many_draws():
    scores, held = [], []
    for seed in range(5):
        phase = adapted(seed, max_frames=18).phase
        error = phase.coordinate["u"].ravel() - TRUE
        own = phase.mask.ravel()
        scores.append((error / phase.sigma["u"].ravel())[own])
        held.append(own.mean())
    z = np.concatenate(scores)
    # 7,000 numbers: an RMS to 0.9 %.  What a dimmed panel rounds is stated for a pixel of one
    # column and any phase, which makes deviations of repeated sets up to a twentieth too large.
    assert 0.92 < np.sqrt(np.mean(z**2)) < 1.03
    # That rounding is the same in every scan: half a deviation, of 80 dimmed columns, is 0.06 of
    # the mean; three times as much.
    assert np.mean(z) == pytest.approx(0.0, abs=0.18)
    # A Gaussian has six of 100,000 beyond four; wrong orders would be far more.
    assert np.mean(np.abs(z) > 4.5) < 5e-4
    assert np.mean(held) > 0.95


def test_repeated_sets_have_shifts_between_those_before():
    instrument = tool(noise=False)
    first, second = instrument.take(Shot(8)), instrument.take(Shot(8))
    np.testing.assert_allclose(np.angle(first.wave[:DARK] / second.wave[:DARK]), 0.0, atol=0.01)
    whole = added_up([first, second])[0].variance
    expected = 1.0 / (1.0 / first.variance + 1.0 / second.variance)
    np.testing.assert_allclose(whole[:DARK], expected[:DARK])


# -- masks and exposures -------------------------------------------------------------------------


def test_a_mask_dims_what_would_saturate_and_nothing_else():
    instrument = tool()
    taken = [instrument.take(Shot(count)) for count in (1, 8)]
    estimate = estimated(taken, SIZE[0])
    before = known(taken, estimate, instrument)
    assert mask_for(0.5, before, estimate, instrument, 3) is None
    mask = mask_for(8.0, before, estimate, instrument, 3)
    assert mask[: DARK - 10].max() < 1.0 / 6.0  # 0.8 of the range times 8 is 6.4
    assert (mask[DARK + 10 :] == 1.0).all()
    steps = np.log2(mask[mask < 1.0])
    np.testing.assert_allclose(2.0 * steps, np.rint(2.0 * steps), atol=1e-9)
    level = levels(mask, estimate, SIZE[0], 3)
    (step,) = np.flatnonzero(np.diff(mask))
    assert DARK - 2 <= step < DARK + 10
    assert np.isnan(level[np.abs(TRUE - step) < 3]).all()
    shot = Shot(8, 8.0, mask)
    dimmed = instrument.take(shot, level)
    used = dimmed.usable
    assert not dimmed.saturated[TRUE < DARK - 10].any()
    # Phases under the mask are those without; the dark half has eight times the light.
    error = np.angle(dimmed.wave * np.exp(-2j * np.pi * 8 * (TRUE + 0.5) / SIZE[0]))
    assert np.abs(error[used]).max() < 6.0 * np.sqrt(
        (dimmed.variance[used] / np.abs(dimmed.wave[used]) ** 2).max()
    )
    assert used[TRUE >= DARK + 10].mean() > 0.99


def test_a_mask_moves_no_phase_without_noise():
    columns = 0.5 + 0.5 * (np.arange(SIZE[0]) >= 60)
    code = DimmedFringes(8, mask=tuple(columns.tolist()))
    plain = DimmedFringes(8)
    for k in range(3):
        np.testing.assert_allclose(code.profile(k, SIZE[0]), columns * plain.profile(k, SIZE[0]))


def test_the_dark_half_gets_the_light():
    """Fixed sets of as many frames leave it: by what both reach at the 95th percentile."""
    found = adapted(max_frames=24)
    assert max(one.exposure for one in found.choices) >= 4.0
    assert any(one.dimmed for one in found.choices) or min(
        one.exposure for one in found.choices
    ) < max(one.exposure for one in found.choices)
    assert found.reached_um < found.choices[2].reached_um / 3.0
    assert found.frames <= 24
    even = adapted(dark=1.0, max_frames=24)
    assert max(one.exposure for one in even.choices) < 2.0
    assert not any(one.dimmed for one in even.choices)


def test_what_saturates_is_found_with_less_light():
    bright = replace(scene(), exposure=replace(scene().exposure, bracket=(4.0,)))
    found = adapt(bright, transport(0.02), max_frames=30, seed=1)
    assert min(one.exposure for one in found.choices) < 0.5
    own = found.phase.mask[:, : DARK - 5]
    assert own.mean() > 0.95
    assert found.choices[-1].saturated < 0.01 < found.choices[0].saturated


# -- the course of a scan ------------------------------------------------------------------------


def test_predictions_come_true():
    found = adapted(max_frames=30)
    for one in found.choices[4:]:
        assert one.reached_um == pytest.approx(one.predicted_um, rel=0.25)


def test_the_best_forecast_gains_most():
    instrument = tool()
    taken = [instrument.take(Shot(count)) for count in (1, 8)]
    estimate = estimated(taken, SIZE[0])
    every = list(
        forecasts(known(taken, estimate, instrument), estimate, instrument, np.ones(TRUE.size))
    )
    chosen = best(every)
    assert chosen.gain >= 0.98 * max(one.gain for one in every)
    assert best([]) is None


def test_it_stops_when_it_is_enough():
    reached = [one.reached_um for one in adapted(max_frames=30).choices]
    wanted = 1.01 * reached[5]
    found = adapted(want_um=wanted, max_frames=30)
    assert found.reached_um <= wanted
    assert found.frames == next(SHIFTS * (k + 1) for k, one in enumerate(reached) if one <= wanted)
    assert found.end.startswith("enough")
    light = adapted(max_light=9.0, max_frames=30)
    assert light.light <= 9.0
    assert "exposures is used" in light.end
    assert adapted(max_frames=30).end == "the budget of 30 frames is used"


def test_the_log_says_why():
    found = adapted(max_frames=18)
    lines = found.log()
    assert len(lines) == 2 * 6 + 1
    assert lines[0].startswith("  3 frames: 1 fringes, 3 shifts, exposure 1: a first set")
    assert all("deviations of the worst quarter to fall by" in one for one in lines[2:-1:2])
    table = found.to_dict()
    assert [one["frames"] for one in table["choices"]] == [3, 6, 9, 12, 15, 18]
    assert table["choices"][0]["predicted_um"] is None
    assert len(found.table().rows) == 6
    assert repr(found).startswith("<Adapted: 18 frames, fringes 1, ")
    assert len(found.trail) == 6
    assert adapt(scene(), transport(), max_frames=18).log() == lines  # the same seed


def test_who_cannot_be_measured_so():
    plain = scene()
    drifting = replace(plain.exposure, drift=Drift(change=0.1))
    several = replace(plain.exposure, bracket=(1.0, 2.0))
    for change, word in (
        ({"exposure": drifting}, "bit planes, lost triggers or drift"),
        ({"exposure": several}, "of several exposures"),
        ({"rig": RIG.having(projector=replace(RIG.projector, gamma=2.2))}, "not linear"),
    ):
        with pytest.raises(InputError, match=word):
            adapt(replace(plain, **change), transport())
    with pytest.raises(InputError, match="in colour"):
        scan_adaptively(load_scene("colour", preview=True))
    with pytest.raises(InputError, match="max_frames"):
        adapt(plain, transport(), max_frames=3)


# -- sets of a comparison, commands --------------------------------------------------------------


def test_it_is_a_set_of_a_comparison():
    plain = load_scene("plane", preview=True)
    sets = pattern_sets(["adaptive", "1,8@4", "adaptive @ 12"], plain)
    assert [one.name for one in sets] == ["adaptive", "1,8@4", "adaptive@12"]
    assert [one.frames for one in sets] == [30, 8, 12]
    assert all(isinstance(one, AdaptiveSet) for one in (sets[0], sets[2]))
    frames = pattern_sets(["adaptive@12", "1,8,64@8"], plain, equal="frames")
    assert [one.frames for one in frames] == [24, 24]
    photons = pattern_sets(["adaptive", "1,8@4", "1,8,64@4"], plain, equal="photons")
    assert photons[0].most_light == 8.0
    assert photons[2].exposure_share == pytest.approx(8 / 12)
    for text, line in (
        ("adaptive@3", "6 to 1000 frames"),
        ("adaptive | gamma=2.2", "their own decoder"),
    ):
        with pytest.raises(InputError, match=line):
            pattern_sets([text], plain)
    with pytest.raises(InputError, match="in colour"):
        pattern_sets(["adaptive"], load_scene("colour", preview=True))


@pytest.mark.filterwarnings("ignore::slbench.core.errors.InputWarning")
def test_a_comparison_on_a_rendered_scene():
    small = load_scene("dark-and-bright", preview=True).coarser(4, 8)
    found = compare(small, ["adaptive@18", "1,10,50@6"], repeats=2, equal="frames", seed=1)
    adaptive, fixed = found.sets
    assert (adaptive.frames, fixed.frames) == (18, 18)
    assert adaptive.std_median_mm > 0.0
    assert adaptive.std_over_predicted == pytest.approx(1.0, abs=0.15)


@pytest.mark.filterwarnings("ignore::slbench.core.errors.InputWarning")
def test_a_scan_leaves_its_log(tmp_path):
    words = ("scan", "dark-and-bright", "--preview", "--adapt", "--max-frames", 12, "--spp", 2)
    run = run_cli(*words, "--out", tmp_path / "a")
    assert run.status == 0, run.err
    assert " 12 frames: " in run.out
    table = read_json(tmp_path / "a" / "adaptive.json")
    assert table["frames"] == 12
    assert table["completeness"] > 0.5
    log = (tmp_path / "a" / "adaptive.log").read_text()
    assert log.count("predicted") == 4
    assert (tmp_path / "a" / "cloud.ply").exists()
    for more, line in (
        (("--patterns", "gray"), "--patterns: expected none with --adapt"),
        (("--max-frames", 3), "--max-frames"),
        (("--want-um", 0), "--want-um"),
    ):
        bad = run_cli(*words, *more, "--out", tmp_path / "b")
        assert bad.status == 2
        assert line in bad.err
    alone = run_cli("scan", "plane", "--preview", "--want-um", 5)
    assert alone.status == 2
    assert "--want-um: expected --adapt beside it" in alone.err
    assert not (tmp_path / "b").exists()


# -- how many frames it needs --------------------------------------------------------------------


def test_a_crossing_is_between_two_sets_by_logarithms():
    counts, path = np.array([6.0, 9.0, 12.0]), np.array([np.inf, 8.0, 2.0])
    assert _crossing(counts, path, 8.0) == 9.0
    assert _crossing(counts, path, 4.0) == pytest.approx(np.sqrt(9.0 * 12.0))
    assert np.isinf(_crossing(counts, path, 1.0))
    assert np.isnan(_crossing(counts, path, np.inf))


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ((10.0, 8.0, 0.8, (0.7, 0.9)), "adaptive fringes need fewer frames"),
        ((10.0, 12.0, 1.2, (1.1, 1.3)), "adaptive fringes need more frames"),
        ((10.0, 10.0, 1.0, (0.9, 1.1)), "not told apart"),
        ((10.0, 12.0, np.inf, (np.nan, np.nan)), "adaptive fringes do not get there"),
        ((np.inf, 8.0, np.nan, (np.nan, np.nan)), "only adaptive fringes measure 95 %"),
        ((np.inf, np.inf, np.nan, (np.nan, np.nan)), "neither measures 95 %"),
    ],
)
def test_verdicts(values, verdict):
    fixed, own, ratio, interval = values
    found = FramesNeeded(
        scene="s",
        fixed="1,8",
        frames=24,
        fixed_um=fixed,
        adaptive_um=own,
        ratio=ratio,
        ratio_ci95=interval,
        fixed_wrong=0.0,
        adaptive_wrong=0.0,
        light=1.0,
    )
    assert found.verdict.startswith(verdict)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::slbench.core.errors.InputWarning")
def test_fewer_frames_on_dark_and_bright_and_about_as_many_on_a_plate():
    dark = load_scene("dark-and-bright", preview=True).coarser(4, 8)
    assert frames_needed(dark, frames=24, repeats=3).ratio_ci95[1] < 0.9
    plate = load_scene("defocused", preview=True).coarser(4, 8)
    assert frames_needed(plate, frames=24, repeats=3).ratio == pytest.approx(1.0, abs=0.15)
