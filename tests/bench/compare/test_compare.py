"""Pattern sets compared: brute force, theory, and statistics whose truth is known."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small, transport_of, truth_of
from scipy.stats import binom, chi2, quantile_test
from stages import capture

from slbench.bench.compare.compare import compare
from slbench.bench.compare.sets import pattern_sets
from slbench.bench.compare.tiles import (
    Pair,
    TiledMedian,
    bootstrap_medians,
    compared,
    holm,
    p_value,
    shaken,
    spread_draws,
    tile_numbers,
    tile_side,
)
from slbench.bench.statistics import percentile_interval
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.core.io import read_exr, read_json
from slbench.core.show.document import Cloud
from slbench.patterns import Fringes, relative_phase
from slbench.report.pages.compare import comparison_page, draw, write_comparison
from slbench.score.points import score

THREE = ("1,10,50", "1,2,4", "gray")


@functools.cache
def small_comparison(
    sets=THREE, name="step-block", repeats=6, seed=0, equal=None, **changed_exposure
):
    """A comparison on a scene of 160 x 120 px, made once a session."""
    scene = small(name)
    scene = replace(scene, exposure=replace(scene.exposure, **changed_exposure))
    return compare(
        scene,
        sets,
        repeats=repeats,
        seed=seed,
        equal=equal,
        transports=(transport_of(name),),
        truth=truth_of(name),
    )


def values_of(comparison):
    """All that is written: times are not."""
    return comparison.to_dict()


#: Four scans of a noisy scene; one step from 1 to 20 fringes gets many orders wrong.
NOISY, REPEATS = ("1,20", "gray+16@4"), 4


@pytest.fixture(scope="module")
def noisy():
    return small_comparison(NOISY, "step-block-grainy", REPEATS)


@pytest.fixture(scope="module")
def scans():
    """The same scans by the main stream's parts: (phase, cloud) of every repeat."""
    scene, transport = small("step-block-grainy"), transport_of("step-block-grainy")
    found = {}
    for one in pattern_sets(NOISY, scene):
        found[one.name] = []
        for r in range(REPEATS):
            shots = capture(one.of(scene), transport, seed=one.seed(0, r))
            phase = shots.decode()
            found[one.name].append((phase, triangulate(scene.rig, phase)))
    return found


class TestAgainstBruteForce:
    def test_order_errors_and_completeness(self, scans, noisy):
        truth = truth_of("step-block-grainy")
        smooth = truth.smooth()
        for name, half in (("1,20", 640 / 40), ("gray+16@4", 640 / 32)):
            wrong = near = measured = lit = 0
            for phase, _ in scans[name]:
                for v, u in np.argwhere(phase.mask):
                    lit += bool(truth.lit[v, u])
                    if smooth[v, u]:
                        measured += 1
                        off = abs(phase.coordinate["u"][v, u] - truth.panel[v, u, 0])
                        wrong += off > half
                        near += off <= 2.0
            one = noisy[name]
            assert one.order_error_rate == wrong / measured
            assert one.right == near / (REPEATS * np.count_nonzero(smooth))
            assert one.completeness == lit / (REPEATS * np.count_nonzero(truth.lit))
        assert noisy["1,20"].order_error_rate > 0.05
        assert noisy["gray+16@4"].order_error_rate < 0.001

    def test_maps_and_what_is_taken_from_them(self, scans, noisy):
        truth = truth_of("step-block-grainy")
        points = {
            name: np.array([cloud.image(cloud.points) for _, cloud in made])
            for name, made in scans.items()
        }
        # 3 of 4 repeats are the two thirds that every set has to have measured.
        enough = [np.isfinite(p[..., 0]).sum(axis=0) >= 3 for p in points.values()]
        common = truth.smooth() & np.logical_and(*enough)
        assert noisy.pixels == np.count_nonzero(common)
        for name, measured in points.items():
            one = noisy[name]
            at = measured[:, common]
            deviations = np.nanstd(at, axis=0, ddof=1)
            std = np.sqrt(np.sum(deviations**2, axis=-1))
            # Running sums agree with NumPy's two passes to rounding.
            np.testing.assert_allclose(one.std_mm[common], std, rtol=1e-9)
            np.testing.assert_allclose(one.std_z_mm[common], deviations[:, 2], rtol=1e-9)
            assert np.isnan(one.std_mm[~common]).all()
            error = at - truth.point[common]
            mean_z = np.nanmean(error[..., 2], axis=0)
            np.testing.assert_allclose(one.error_mm[common], mean_z, rtol=1e-9, atol=1e-12)
            square = np.sum(error**2, axis=-1)
            expected = {
                "std_median_mm": np.median(std),
                "std_z_median_mm": np.median(deviations[:, 2]),
                "error_median_mm": np.median(np.sqrt(np.nanmean(square, axis=0))),
                "bias_mm": mean_z.mean(),
                "rms_mm": np.sqrt(np.nanmean(square)),
            }
            for quantity, value in expected.items():
                assert getattr(one, quantity) == pytest.approx(value, rel=1e-9), quantity

    def test_steps_are_those_of_the_scores(self, scans, noisy):
        scene, truth = small("step-block-grainy"), truth_of("step-block-grainy")
        made = scans["gray+16@4"]
        heights = np.array(
            [
                [s.measured_mm for s in score(c, truth, p, scene.objects, scene.rig).steps]
                for p, c in made
            ]
        )
        steps = noisy["gray+16@4"].steps
        assert [step.nominal_mm for step in steps] == [1.0, 2.5, 5.0]
        np.testing.assert_allclose([s.measured_mm for s in steps], heights.mean(axis=0))
        np.testing.assert_allclose([s.std_mm for s in steps], heights.std(axis=0, ddof=1))


class TestDraws:
    def test_the_order_of_the_sets_does_not_matter(self):
        there = small_comparison(THREE)
        back = small_comparison(THREE[::-1])
        assert [one.name for one in back.sets] == list(THREE[::-1])
        values, reversed_values = values_of(there), values_of(back)
        reversed_values["sets"] = reversed_values["sets"][::-1]
        assert values == reversed_values
        for one in there.sets:
            for name in ("std_mm", "std_z_mm", "error_mm"):
                np.testing.assert_array_equal(getattr(one, name), getattr(back[one.name], name))

    def test_what_a_set_measures_does_not_depend_on_the_others(self):
        alone, among = small_comparison(("1,2,4",)), small_comparison(THREE)
        for name in ("order_error_rate", "right", "completeness", "steps"):
            assert getattr(alone["1,2,4"], name) == getattr(among["1,2,4"], name)
        both = np.isfinite(among["1,2,4"].std_mm)
        np.testing.assert_array_equal(alone["1,2,4"].std_mm[both], among["1,2,4"].std_mm[both])
        assert alone.pairs == ()
        assert alone.ranking == ("1,2,4",)

    def test_the_seed_decides(self):
        first = values_of(small_comparison(THREE))
        again = compare(
            small("step-block"),
            THREE,
            repeats=6,
            transports=(transport_of("step-block"),),
            truth=truth_of("step-block"),
        )
        assert values_of(again) == first
        other = small_comparison(THREE, seed=1)
        assert other["1,2,4"].std_median_mm != first["sets"][1]["std_median_mm"]
        assert not np.array_equal(other["1,2,4"].error_mm, again["1,2,4"].error_mm)


class TestTheory:
    def test_deviations_are_those_predicted_from_the_detector(self):
        # 11,000 pixels of 5 degrees of freedom: the RMS ratio is known to 0.3 %.  The rest of
        # the tolerance is for rounding, which the noise model takes as uniform noise.
        comparison = small_comparison(THREE)
        for name in ("1,10,50", "1,2,4"):
            assert comparison[name].std_over_predicted == pytest.approx(1.0, abs=0.015)

    def test_the_median_reads_low_by_what_few_repeats_cost(self):
        # The deviation of six values is sqrt(chi2_5 / 5) of the true one; its median is 0.933.
        # The predicted deviations of the pixels differ by some 20 % (the third harmonic of shot
        # noise, lighting), which takes the median of the product down a little further.
        one = small_comparison(THREE)["1,10,50"]
        factor = math.sqrt(chi2.median(5) / 5)
        assert 0.94 * factor < one.std_median_mm / one.predicted_mm < 1.01 * factor

    def test_noise_goes_with_one_over_the_fringes(self):
        # {1,10,50} over {1,2,4}: 4 / 50 = 0.08 with equal modulation.  Defocus and the footprint
        # of these large pixels take some from 50 fringes and nothing from 4; how much, the same
        # sets tell without noise.  Medians of 11,000 deviations compare to 1 %.
        scene, transport = small("step-block"), transport_of("step-block")
        modulation = {}
        for count in (4, 50):
            frames = transport.relight(
                [Fringes(count).profile(k, scene.rig.projector.width) for k in range(3)]
            )
            modulation[count] = relative_phase(frames)[1][truth_of("step-block").smooth()]
        loss = float(np.median(modulation[4] / modulation[50]))
        assert 1.0 < loss < 1.35
        ratio = small_comparison(THREE).pair("1,10,50", "1,2,4").ratio
        assert ratio == pytest.approx(4 / 50 * loss, rel=0.03)

    def test_noise_goes_with_one_over_the_root_of_the_shifts(self):
        # Medians of 11,000 deviations: 0.4 % each; 3 shifts have a third harmonic of shot noise
        # that spreads the pixels' deviations, which moves the median by 1 or 2 %.
        pair = small_comparison(("1,8@12", "1,8")).pair("1,8@12", "1,8")
        assert pair.ratio == pytest.approx(0.5, rel=0.05)
        assert pair.significant


class TestRanking:
    def test_the_poor_set_is_last_and_significantly(self):
        comparison = small_comparison(("1,2,4", "1,10", "1,10,50"))
        assert comparison.ranking == comparison.error_ranking == ("1,10,50", "1,10", "1,2,4")
        for pairs in (comparison.pairs, comparison.error_pairs):
            assert [(p.a, p.b) for p in pairs] == [
                ("1,10,50", "1,10"),
                ("1,10,50", "1,2,4"),
                ("1,10", "1,2,4"),
            ]
            for pair in pairs:
                assert pair.significant
                assert pair.ratio_ci95[0] < pair.ratio < pair.ratio_ci95[1] < 1.0
        assert not comparison.rankings_differ

    def test_a_set_that_repeats_a_wrong_value_does_not_win_both(self):
        # Most pixels read the same column of a Gray code in every scan: no deviation at all,
        # and up to half a column from the truth.
        comparison = small_comparison(THREE)
        assert comparison["gray"].std_median_mm == 0.0
        assert comparison.ranking[0] == "gray"
        assert comparison.error_ranking[0] == "1,10,50"
        assert comparison.pair("gray", "1,10,50", "error").significant
        assert comparison.rankings_differ
        assert comparison.pair("1,10,50", "gray").ratio == math.inf

    def test_the_same_set_twice_is_not_told_apart(self):
        # Written differently, the same patterns draw other noise.  One seed in twenty would fail
        # by chance, either way of ranking; this one is fixed.
        comparison = small_comparison(("1,8", "1,8@3"), seed=1)
        first, second = comparison.sets
        assert first.sequence == second.sequence
        assert not np.array_equal(first.std_mm, second.std_mm, equal_nan=True)
        for pairs in (comparison.pairs, comparison.error_pairs):
            assert not pairs[0].significant
            assert pairs[0].ratio_ci95[0] < 1.0 < pairs[0].ratio_ci95[1]

    def test_pairs_are_read_either_way(self):
        comparison = small_comparison(THREE)
        there, back = comparison.pair("1,10,50", "1,2,4"), comparison.pair("1, 2, 4", "1,10,50")
        assert back.ratio == pytest.approx(1.0 / there.ratio)
        assert back.ratio_ci95 == pytest.approx(tuple(1.0 / x for x in there.ratio_ci95[::-1]))
        with pytest.raises(InputError, match="expected one of 1,10,50, 1,2,4, gray, got 1,3"):
            comparison["1,3"]
        with pytest.raises(InputError, match="two sets"):
            comparison.pair("gray", "gray")
        with pytest.raises(InputError, match="std or error"):
            comparison.pair("gray", "1,2,4", "rms")


class TestVibration:
    """All pixels of a frame move together: the repeats, not the pixels, are what is sampled."""

    TWICE = ("1,10,50", "1,10,50@3")

    def test_the_same_set_twice_is_not_told_apart(self):
        # By tiles of pixels alone this seed is a false alarm in both rankings, as 11 of 12 are.
        found = small_comparison(self.TWICE, repeats=15, seed=1, vibration_px=0.2)
        for pairs in (found.pairs, found.error_pairs):
            assert not pairs[0].significant
            assert pairs[0].ratio_ci95[0] < 1.0 < pairs[0].ratio_ci95[1]
        # sqrt(14 / chi^2) is 0.73 to 1.58 where vibration is nearly all there is.
        for one in found.sets:
            for median, ends in (
                (one.std_median_mm, one.std_ci95_mm),
                (one.std_z_median_mm, one.std_z_ci95_mm),
            ):
                assert ends[0] / median == pytest.approx(0.73, abs=0.03)
                assert ends[1] / median == pytest.approx(1.58, abs=0.06)
            assert one.error_ci95_mm[1] > 1.3 * one.error_median_mm

    def test_little_vibration_widens_little(self):
        # A hundredth of the variance at most: 0.8 % either way, beside 2 % of the tiles.
        still, moved = (
            small_comparison(("1,8",), repeats=15, vibration_px=v)["1,8"] for v in (0.0, 1e-3)
        )
        for one in (still, moved):
            low, high = one.std_ci95_mm
            assert high - low < 0.06 * one.std_median_mm
        gray = small_comparison(("gray",), repeats=3, vibration_px=0.1)["gray"]
        assert gray.std_ci95_mm == (0.0, 0.0)  # nothing to widen

    def test_the_other_sets_change_no_draw(self):
        there = small_comparison(self.TWICE, repeats=3, vibration_px=0.1)
        back = small_comparison(self.TWICE[::-1], repeats=3, vibration_px=0.1)
        assert there.pairs == back.pairs
        assert there["1,10,50"].std_ci95_mm == back["1,10,50"].std_ci95_mm

    @pytest.mark.statistics
    def test_false_alarms_and_coverage(self):
        # Equal sets whose pixels scatter together and by themselves, in equal parts, seen in six
        # repeats.  Of 100 tests at 5 %, 13 or more alarm with a probability of 0.15 %; of 100
        # intervals of 95 %, 88 or fewer cover with one of 0.4 %.
        rng = np.random.default_rng(3)
        tiles, repeats, share = np.repeat(np.arange(80), 25), 6, 0.5
        alarms, covered = {False: 0, True: 0}, {False: 0, True: 0}
        for trial in range(100):
            std, draws, wide = {}, {}, {}
            for k, name in enumerate("ab"):
                common = rng.normal(size=(repeats, 1))
                own = rng.normal(size=(repeats, tiles.size))
                both = math.sqrt(share) * common + math.sqrt(1.0 - share) * own
                std[name] = both.std(axis=0, ddof=1)
                draws |= bootstrap_medians({name: std[name]}, tiles, trial, 500)
                spread = spread_draws(repeats, 2 * trial + k, 500)
                wide[name] = shaken(draws[name], draws[name], share, spread)
            medians = {name: float(np.median(values)) for name, values in std.items()}
            # Over many scans: the median of sqrt(chi^2_5 / 5) of the own part, some 4 % low.
            for widened, drawn in ((False, draws), (True, wide)):
                alarms[widened] += compared(medians, drawn)[0].significant
                low, high = percentile_interval(drawn["a"])
                covered[widened] += low <= 0.96 <= high
        assert alarms[True] < 13 < 50 < alarms[False]
        assert covered[True] > 88 > 50 > covered[False]


class TestEqual:
    def test_frames(self):
        scene = small("step-block")
        sets = pattern_sets(["1,10,50", "1,2,4,8,16", "gray", "gray+16"], scene, equal="frames")
        assert [one.frames for one in sets] == [23, 23, 20, 23]
        # All further shifts go to the last set, which decides the noise.
        names = [one.sequence.name for one in sets]
        assert names == ["1,10@3,50@17", "1,2,4,8@3,16@11", "gray", "gray+16"]
        assert sets[0].note == "50 fringes with 17 shifts"
        assert "keeps its 20 frames" in sets[2].note
        assert {one.exposure_share for one in sets} == {1.0}

    def test_frames_of_two_axes_are_shared(self):
        scene = small("step-block", axes="uv")
        one, _ = pattern_sets(["1,10", "1,10@4"], replace(scene), equal="frames")
        assert one.frames == 16
        shifts = [part.shifts for part in one.sequence.parts]
        assert shifts == [3, 5, 3, 5]
        one, _ = pattern_sets(["1,10", "white+1,10"], scene, equal="frames")
        assert [part.shifts for part in one.sequence.parts] == [3, 4, 3, 3]

    def test_frames_lower_the_noise_as_the_root_of_the_shifts(self):
        # {1,10} gets 6 + 9 frames: 12 shifts instead of 3.  Tolerance as for the shifts above.
        plain = small_comparison(("1,10", "1,2,4,8,16"))
        equal = small_comparison(("1,10", "1,2,4,8,16"), equal="frames")
        assert equal["1,10"].frames == equal["1,2,4,8,16"].frames == 15
        ratio = equal["1,10"].std_median_mm / plain["1,10"].std_median_mm
        assert ratio == pytest.approx(0.5, rel=0.05)
        assert equal["1,2,4,8,16"].std_median_mm == plain["1,2,4,8,16"].std_median_mm

    @pytest.mark.parametrize("time_s", [None, 8e-5])
    def test_photons(self, time_s):
        scene = small("step-block")
        scene = replace(scene, exposure=replace(scene.exposure, time_s=time_s))
        sets = pattern_sets(["1,8", "1,8,32", "gray"], scene, equal="photons")
        transport = transport_of("step-block")
        shots = [capture(one.of(scene), transport) for one in sets]
        total = [one.frames * shot.exposure_s for one, shot in zip(sets, shots, strict=True)]
        np.testing.assert_allclose(total, total[0], rtol=1e-6)  # radiance is single precision
        full = capture(scene, transport).exposure_s
        assert shots[0].exposure_s == pytest.approx(full, rel=1e-6)
        # Light above black, summed over the mean frames of a scan: fringes and Gray codes are
        # both half lit.  The dim stage has a few DN above black, of which rounding takes 1 or 2 %.
        black = scene.detector.black_dn
        quiet = [capture(one.of(scene), transport, noise=False).frames for one in sets]
        lit = truth_of("step-block").smooth()
        light = [(frames[:, lit].astype(float) - black).sum(axis=0).mean() for frames in quiet]
        np.testing.assert_allclose(light, light[0], rtol=0.02)

    def test_photons_cost_what_read_noise_and_rounding_cost(self):
        # Four times the frames for a quarter of the light each: with shot noise alone the
        # coordinate's noise would stay.  What read noise and rounding add, the prediction knows;
        # medians of 11,000 deviations compare to 1 %.
        comparison = small_comparison(("1,8@6", "1,8@24"), equal="photons")
        few, many = comparison.sets
        assert few.exposure_s / many.exposure_s == pytest.approx(4.0)
        for one in comparison.sets:
            assert one.std_over_predicted == pytest.approx(1.0, abs=0.015)
        predicted = many.predicted_mm / few.predicted_mm
        assert 1.1 < predicted < 1.4
        assert many.std_median_mm / few.std_median_mm == pytest.approx(predicted, rel=0.03)
        assert comparison.ranking == ("1,8@6", "1,8@24")


class TestBadInput:
    @pytest.mark.parametrize(
        ("sets", "options", "words"),
        [
            ([], {}, "one or more pattern sets"),
            ("1,10,50", {}, "one or more pattern sets"),
            (["1,10", "1, 10"], {}, "every set once, got 1,10 twice"),
            (["1,10", "ten"], {}, "'ten'"),
            (["1,10", ""], {}, "text such as"),
            (["1,10", 7], {}, "expected a PatternSequence, a Code, a list of them"),
            (["1,10,400"], {}, "at most 213 fringes on 640 panel pixels, got 400"),
            (["10,50"], {}, "set 10,50: decode: .* one fringe or a Gray code first"),
            (["white"], {}, "set white: decode: sequence: expected fringes or a Gray code"),
            (["1,10"], {"equal": "light"}, "frames or photons, got 'light'"),
            (["1,10"], {"repeats": 1}, "repeats: expected a whole number from 2 to 10000, got 1"),
            (["1,10"], {"repeats": 2.5}, "to 10000, got 2.5"),
            (["1,10"], {"seed": -1}, "seed"),
            (["1,10"], {"weights": "none"}, "lit or modulation"),
            (["1,10"], {"weights": "modulation"}, "focus settings in scene step-block.*, got none"),
            (["1,10@1000", "1,10,50@1000"], {"equal": "frames"}, "from 3 to 1000"),
        ],
    )
    def test_is_refused_before_any_light_is_traced(self, sets, options, words, monkeypatch):
        monkeypatch.setattr(
            "slbench.bench.compare.compare.traced", lambda *_, **__: pytest.fail("traced")
        )
        with pytest.raises(InputError, match=words):
            compare(small("step-block"), sets, **options)

    def test_no_pixel_that_all_sets_measure(self):
        # A hundredth of the light leaves no set 3 DN of modulation.
        with pytest.raises(InputError, match=r"pixels that all of them measure in 2 of 2 repeats"):
            small_comparison(("1,10", "1,2,4"), repeats=2, white_level=0.01)


#: Simulated analyses of a test of coverage or false alarms.
TRIALS = [25, pytest.param(100, marks=pytest.mark.statistics)]


class TestStatistics:
    def test_weighted_median_is_that_of_repeated_values(self):
        rng = np.random.default_rng(0)
        for size in (1, 2, 7, 500):
            values, tiles = rng.normal(size=size), rng.integers(5, size=size)
            tiles = np.unique(tiles, return_inverse=True)[1]
            median = TiledMedian(values, tiles)
            for _ in range(20):
                weights = rng.integers(1, 4, size=tiles.max() + 1).astype(float)
                many = np.sort(np.repeat(values, weights[tiles].astype(int)))
                assert median(weights) == many[(len(many) - 1) // 2]

    def test_tiles_cover_the_image(self):
        shape = (120, 160)
        side = tile_side(shape)
        assert side == 8
        assert tile_side((2048, 2048)) == 103  # about 400 of them
        number = tile_numbers(shape, np.arange(120 * 160)).reshape(shape)
        assert number.max() + 1 == 15 * 20
        for v, u in ((0, 0), (64, 88)):
            assert np.unique(number[v : v + side, u : u + side]).size == 1
        few = tile_numbers(shape, np.array([0, 1, 120 * 160 - 1]))
        assert few.tolist() == [0, 0, 1]

    def test_holm(self):
        # By hand: 0.01 x 4 and 0.013 x 3 are below 0.05, 0.03 x 2 is not and stops the rest.
        assert holm([0.03, 0.01, 0.04, 0.013]) == [False, True, False, True]
        assert holm([]) == []
        # What is not a number proves nothing, and is one of the family all the same.
        assert holm([float("nan")]) == [False]
        assert holm([0.02, float("nan"), 0.001]) == [True, False, True]
        assert holm([0.026, float("nan")]) == [False, False]

    def test_p_values(self):
        assert p_value(np.ones(1999)) == pytest.approx(2.0 / 2000.0)
        assert p_value(np.zeros(1999)) == 1.0
        assert p_value(np.r_[np.ones(950), -np.ones(49)]) == pytest.approx(0.1)
        assert p_value(np.full(1999, np.nan)) == 1.0

    def test_two_zeros_are_equal(self):
        draws = {"a": np.zeros(100), "b": np.zeros(100)}
        (pair,) = compared({"a": 0.0, "b": 0.0}, draws)
        assert pair == Pair("a", "b", 1.0, (1.0, 1.0), 1.0, False)

    def test_a_single_tile_is_refused(self):
        with pytest.raises(InputError, match="at least two tiles"):
            bootstrap_medians({"a": np.ones(3)}, np.zeros(3, np.intp), 0, 10)

    @pytest.mark.parametrize("trials", TRIALS)
    def test_intervals_cover_the_true_median_of_tiled_pixels(self, trials):
        # Tiles share a factor exp(0.2 z): pixels of a tile go together.  The true median is 1.
        # Of 100 intervals of 95 %, 88 or fewer cover with a probability of 0.4 %, of 25 20 or
        # fewer with 0.7 %.
        rng = np.random.default_rng(1)
        tiles = np.repeat(np.arange(80), 25)
        covered = independent = 0
        for trial in range(trials):
            shared = 0.2 * rng.normal(size=80)[tiles]
            values = np.exp(shared + 0.2 * rng.normal(size=tiles.size))
            draws = bootstrap_medians({"a": values}, tiles, trial, 500)["a"]
            low, high = percentile_interval(draws)
            covered += low <= 1.0 <= high
            naive = quantile_test(values).confidence_interval()
            independent += naive.low <= 1.0 <= naive.high
        assert covered > binom.ppf(0.004, trials, 0.95)
        assert independent < 0.6 * trials  # what taking pixels for independent would give

    @pytest.mark.parametrize("trials", TRIALS)
    def test_false_alarms_are_as_rare_as_stated(self, trials):
        # Two equal sets of 15 repeats over pixels of different noise.  Of 100 tests at 5 %, 13
        # or more alarm with a probability of 0.15 %, of 25 six or more with 0.12 %.
        rng = np.random.default_rng(2)
        tiles = np.repeat(np.arange(80), 25)
        alarms = 0
        for trial in range(trials):
            noise = np.exp(0.3 * rng.normal(size=80)[tiles])
            std = {name: noise * np.sqrt(rng.chisquare(14, tiles.size) / 14) for name in "ab"}
            draws = bootstrap_medians(std, tiles, trial, 500)
            medians = {name: float(np.median(values)) for name, values in std.items()}
            alarms += compared(medians, draws)[0].significant
        assert alarms <= binom.isf(0.0016, trials, 0.05)


class TestResults:
    def test_files(self, tmp_path):
        comparison = small_comparison(THREE)
        folder = tmp_path / "out"
        written = write_comparison(comparison, folder)
        names = {"comparison.json", "comparison.md", "comparison.png", "maps", "provenance.json"}
        assert {path.name for path in written} == names == {p.name for p in folder.iterdir()}
        stored = read_json(folder / "comparison.json")
        keys = {"name", "frames", "std_median_mm", "std_ci95_mm", "rms_mm"}
        keys |= {"order_error_rate", "right", "completeness"}
        assert [one["name"] for one in stored["sets"]] == list(THREE)
        assert all(keys <= set(one) for one in stored["sets"])
        maps = read_exr(folder / "maps" / "1_10_50.exr")
        one = comparison["1,10,50"]
        np.testing.assert_array_equal(maps["std"], one.std_mm.astype(np.float32))
        np.testing.assert_array_equal(maps["error.z"], one.error_mm.astype(np.float32))
        text = (folder / "comparison.md").read_text()
        assert "| 1,10,50 | 9 |" in text
        assert "{1,10,50} < {gray} < {1,2,4}" in text
        parameters = read_json(folder / "provenance.json")["parameters"]
        assert parameters["samples"] == 16
        assert parameters["sets"]["gray"]["parts"][0]["kind"] == "gray"

    def test_the_bound_stands_beside_what_was_measured(self):
        comparison = small_comparison(THREE)
        for counts in ((1, 10, 50), (1, 2, 4)):
            one = comparison[",".join(map(str, counts))]
            # Sequential unwrapping takes the place from the last set alone; the bound takes it from
            # all of them, as if all had its modulation, and frames weighted by their own noise.
            share = counts[-1] / np.sqrt(np.sum(np.square(counts)))
            # The weights gain up to a tenth where the sets are of like fineness.
            assert 0.9 * share < one.bound_mm / one.predicted_mm < 1.01 * share
            # Noise is all there is, so that the share of the prediction is that of what was
            # measured; a median over the deviations of few repeats would be a tenth too large.
            assert one.bound_share == pytest.approx(one.bound_mm / one.predicted_mm, rel=0.03)
            assert one.bound_share < 1.02
        assert np.isnan(comparison["gray"].bound_share)
        assert comparison["gray"].to_dict()["bound_mm"] is None

    def test_page_has_the_cloud_of_the_best_set(self):
        comparison = small_comparison(("1,2,4", "1,10", "1,10,50"))
        page = comparison_page(comparison)
        (cloud,) = (part for part in page.parts if isinstance(part, Cloud))
        assert "{1,10,50}" in cloud.title
        assert len(cloud.points) == comparison.pixels
        error = np.linalg.norm(cloud.points - cloud.truth, axis=1)
        assert np.median(error) < comparison["1,10,50"].error_median_mm

    def test_one_colour_scale_for_all_maps(self):
        three = small_comparison(THREE)
        figure = draw(replace(three, sets=three.sets + three.sets[:2]))  # two rows of maps
        images = [axes.images[0] for half in figure.subfigs for axes in half.axes if axes.images]
        assert len(images) == 5
        assert {image.get_clim() for image in images} == {images[0].get_clim()}


@pytest.mark.slow
def test_a_focus_stack_is_fused_in_every_repeat():
    # Out of 5 settings, weights by modulation: 16 fringes have a quarter of the noise of 4.
    from slbench.scene.file import load_scene

    scene = load_scene("ch8-stack", preview=True)
    comparison = compare(scene, ["1,4", "1,4,16"], repeats=3, weights="modulation")
    assert comparison.ranking == ("1,4,16", "1,4")
    assert 0.2 < comparison.pair("1,4,16", "1,4").ratio < 0.5
    assert all(one.completeness > 0.5 for one in comparison.sets)
