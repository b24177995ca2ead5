"""Phase noise: the estimators on phases of known noise, captures, and the table as a file.

Sampled deviations have a relative standard error of 1 / sqrt(2 degrees of freedom); 4.5 of
them are exceeded by chance in 7 of a million comparisons, of which there are about thirty.
"""

import numpy as np
import pytest

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.design.fringes.noise import PhaseNoise, estimate_noise, noise_of_captures
from slbench.patterns import PatternSequence

TURN = 2.0 * np.pi
N_SIGMA = 4.5


def noisy(phase_map, sigma, repeats, seed):
    """Relative phases in [0, 2 pi), as the decoder gives them."""
    noise = np.random.default_rng(seed).normal(0.0, sigma, (repeats, *phase_map.shape))
    return np.mod(phase_map + noise, TURN)


def slack(estimate):
    return N_SIGMA * estimate.standard_error_rad


# -- estimators -----------------------------------------------------------------------------------


@pytest.mark.parametrize("repeats", [2, 20])
@pytest.mark.parametrize("sigma", [0.005, 0.3])
def test_deviations_from_each_pixels_mean_do_not_see_the_ramp(repeats, sigma):
    ramp = np.linspace(0.0, 5.0 * TURN, 30_000).reshape(100, 300)  # five wraps
    estimate = estimate_noise(noisy(ramp, sigma, repeats, seed=1), "per-pixel")
    assert (estimate.repeats, estimate.pixels) == (repeats, 30_000)
    freedom = 30_000 * (repeats - 1)
    assert estimate.standard_error_rad == pytest.approx(estimate.sigma_rad / np.sqrt(2 * freedom))
    # Two repeats have half the variance in their mean: a biased estimator would be off by 29 %.
    assert abs(estimate.sigma_rad - sigma) < slack(estimate)


def test_the_stated_standard_error_is_that_of_repeated_estimates():
    rng = np.random.default_rng(2)
    estimates = [estimate_noise(rng.normal(3.0, 0.1, (3, 50))) for _ in range(1000)]
    found = np.std([estimate.sigma_rad for estimate in estimates], ddof=1)
    # A deviation of 1000 values: standard error 1 / sqrt(2000).
    expected = 0.1 / np.sqrt(2 * 50 * 2)
    assert found == pytest.approx(expected, rel=N_SIGMA / np.sqrt(2000))
    assert np.mean([e.standard_error_rad for e in estimates]) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("level", [1.0, np.pi, 0.0, TURN - 1e-3])
def test_on_a_constant_map_the_pooled_estimate_is_the_same(level):
    # About 0 the phases jump by 2 pi between pixels and between repeats.
    phases = noisy(np.full((60, 80), level), 0.036, 20, seed=3)
    pooled, own = estimate_noise(phases, "pooled"), estimate_noise(phases, "per-pixel")
    assert abs(pooled.sigma_rad - 0.036) < slack(pooled)
    assert abs(own.sigma_rad - 0.036) < slack(own)


def test_on_a_ramp_the_pooled_estimate_is_the_ramps_spread():
    ramp = np.linspace(-1.0, 1.0, 4800).reshape(60, 80)  # crosses the jump of 2 pi
    phases = noisy(ramp, 0.036, 20, seed=4)
    pooled = estimate_noise(phases, "pooled")
    # Eq. 25 as printed: sixteen times the noise.  The spread is not drawn, so that the error
    # is that of the noise's share of the variance alone, 4e-3, and of its cross term with the
    # ramp, 2 * 0.036 * 0.58 / sqrt(96000).
    spread = np.hypot(ramp.std(), 0.036)
    assert pooled.sigma_rad == pytest.approx(spread, abs=N_SIGMA * 0.036 / np.sqrt(96_000))
    own = estimate_noise(phases)
    assert abs(own.sigma_rad - 0.036) < slack(own)


def test_both_are_eq_25_by_hand():
    phases = np.array([[0.10, 1.00], [0.16, 1.02], [0.10, 1.04]])
    own = estimate_noise(phases)
    # Deviations (-2, 4, -2) and (-2, 0, 2) hundredths: 32e-4 over 2 pixels of 2 degrees.
    assert own.sigma_rad == pytest.approx(np.sqrt(32e-4 / 4), rel=1e-12)
    pooled = estimate_noise(phases, "pooled")
    assert pooled.sigma_rad == pytest.approx(np.std(phases, ddof=1), rel=1e-12)


@pytest.mark.parametrize("estimator", ["per-pixel", "pooled"])
def test_pixels_that_a_repeat_lacks_are_left_out(estimator):
    phases = noisy(np.full((20, 30), 2.0), 0.05, 5, seed=5)
    holes = np.random.default_rng(6).random((20, 30)) < 0.3
    broken = phases.copy()
    broken[2, holes] = np.nan  # in one repeat only
    estimate = estimate_noise(broken, estimator)
    assert estimate == estimate_noise(phases[:, ~holes], estimator)
    assert estimate.pixels == np.sum(~holes)


@pytest.mark.parametrize(
    ("phases", "estimator", "message"),
    [
        (np.zeros((1, 4)), "per-pixel", r"phases: expected shape \(R >= 2, ...\), got \(1, 4\)"),
        (np.zeros(4), "per-pixel", r"phases: expected shape \(R >= 2, ...\), got \(4,\)"),
        (np.zeros((2, 0)), "pooled", "phases: expected a pixel that all repeats have, got none"),
        (
            [[np.nan, 0.0], [0.0, np.nan]],
            "per-pixel",
            "phases: expected a pixel that all repeats have, got none",
        ),
        (np.zeros((2, 4)), "median", "estimator: expected per-pixel or pooled, got 'median'"),
    ],
)
def test_estimator_refuses_in_one_line(phases, estimator, message):
    with pytest.raises(InputError, match=f"^(estimate_noise: )?{message}$"):
        estimate_noise(phases, estimator)


# -- captures -------------------------------------------------------------------------------------


def shots(text, sigma_dn, repeats=8, *, axes="u", contrast=3000.0, shifts=3, seed=7):
    """Captures of a plane that shows the panel as it is: 12 bit, known noise and modulation."""
    sequence = PatternSequence.parse(text, (120, 80), shifts=shifts, axes=axes)
    rng = np.random.default_rng(seed)
    ideal = 500.0 + contrast * sequence.images()
    return [
        Capture(
            np.rint(ideal + rng.normal(0.0, sigma_dn, ideal.shape)).astype(np.uint16),
            sequence,
            bit_depth=12,
        )
        for _ in range(repeats)
    ]


@pytest.mark.parametrize(("text", "shifts"), [("1,4,12", 3), ("1,12@5", 5)])
def test_noise_of_captures_is_that_of_the_phase_formula(text, shifts):
    noise = noise_of_captures(shots(text, 40.0))
    assert noise.shifts == shifts
    np.testing.assert_array_equal(noise.z_mm, [0.0])
    # sigma_phi = sqrt(2 / N) sigma_I / b with half the contrast for b; rounding to whole
    # numbers adds 1/12 DN^2.  Its next order is sigma_phi^2 = 5e-4 of it at most, the
    # statistical error 1 / sqrt(2 * 9600 * 7) = 2.7e-3.
    expected = np.sqrt(2.0 / shifts * (40.0**2 + 1.0 / 12.0)) / 1500.0
    assert noise.fringes[0] == 1
    assert len(noise.fringes) == len(text.split("@")[0].split(","))
    relative = N_SIGMA / np.sqrt(2 * 9600 * 7) + expected**2
    np.testing.assert_allclose(noise.sigma_rad[:, 0], expected, rtol=relative)


def test_noise_of_captures_takes_the_axis_and_the_estimator_that_is_asked_for():
    captures = shots("4,1", 40.0, axes="uv")
    along_v = noise_of_captures(captures, "v")
    np.testing.assert_array_equal(along_v.fringes, [1, 4])  # ascending, whatever was shown first
    # By the frames alone: 12 of them, those along v second, four fringes first.
    only_v = [
        Capture(c.frames[6:], PatternSequence((120, 80), c.sequence.parts[2:]), bit_depth=12)
        for c in captures
    ]
    np.testing.assert_array_equal(along_v.sigma_rad, noise_of_captures(only_v, "v").sigma_rad)
    # One fringe over the panel: pooled it is the spread of a uniform phase, 2 pi / sqrt(12).
    pooled = noise_of_captures(captures, "v", estimator="pooled")
    np.testing.assert_allclose(pooled.sigma_rad, TURN / np.sqrt(12), rtol=0.01)


def test_saturated_and_dark_pixels_do_not_count():
    captures = shots("1,4", 40.0)
    inner = [
        Capture(shot.frames[:, 10:-10].copy(), shot.sequence, bit_depth=12) for shot in captures
    ]
    captures[3].frames[[0, 4], :10] = 4095  # one repeat, one frame of each set
    for shot in captures:
        shot.frames[:, -10:] = 500  # no fringes at all
    found = noise_of_captures(captures).sigma_rad
    np.testing.assert_allclose(found, noise_of_captures(inner).sigma_rad, rtol=1e-12)
    # With a level of saturation of its own no pixel is left: the brightest of three shifts has
    # 500 + 3000 * 3/4 at least.
    limited = [Capture(s.frames, s.sequence, bit_depth=12, saturation_dn=2500) for s in inner]
    with pytest.raises(InputError, match=r"^captures: 1 fringes: expected a pixel with modulation"):
        noise_of_captures(limited)


def test_captures_are_refused_in_one_line():
    captures = shots("1,4", 40.0, repeats=2)
    frames, sequence = captures[0].frames, captures[0].sequence

    def refused(given, message, *options):
        with pytest.raises(InputError, match=message) as error:
            noise_of_captures(given, *options)
        assert "\n" not in str(error.value)

    refused(captures[:1], "^captures: expected at least 2 repeats, got 1$")
    refused([], "^captures: expected at least 2 repeats, got 0$")
    others = shots("1,5", 40.0, repeats=1)
    message = r"^captures\[1\]: expected the patterns of the first, 1,4, got 1,5$"
    refused([captures[0], *others], message)
    smaller = Capture(frames[:, :-1].copy(), sequence, bit_depth=12)
    message = r"^captures\[2\]: expected the size of the first, \(6, 80, 120\), got \(6, 79, 120\)$"
    refused([*captures, smaller], message)
    refused(captures, "^captures: expected fringes along v, got 1,4$", "v")
    mixed = shots("1@3,4@4", 40.0, repeats=2)
    refused(mixed, r"^captures: expected one number of shifts for all fringes, got \[3, 4\]$")
    full = [Capture(np.full_like(frames, 4095), sequence, bit_depth=12) for _ in range(2)]
    full[1].frames[:, 0, 0] = 1000  # no copy of the other
    refused(full, "^captures: 1 fringes: expected a pixel with modulation >= 3.0 DN, got none$")
    dark = shots("1,4", 0.3, repeats=2, contrast=2.0)
    refused(dark, "^captures: 1 fringes: expected a pixel with modulation")
    # No repeats at all, or one frame that was copied.
    message = r"^captures\[1\]: frame 0: expected noise of its own, got that of captures\[0\]$"
    refused([captures[0]] * 2, message)
    copied = Capture(captures[1].frames.copy(), sequence, bit_depth=12)
    copied.frames[4] = frames[4]
    message = "^run b: frame 4: expected noise of its own, got that of run a$"
    with pytest.raises(InputError, match=message):
        noise_of_captures([captures[0], copied], names=["run a", "run b"])


def test_a_set_that_is_washed_out_is_infinite_and_the_rest_goes_on():
    captures = shots("1,4,12", 40.0)
    whole = noise_of_captures(captures).sigma_rad
    for shot in captures:
        shot.frames[6:] = 500 + shot.frames[6:] % 3  # no fringes of the finest set
    found = noise_of_captures(captures)
    np.testing.assert_array_equal(found.sigma_rad[:2], whole[:2])
    assert found.sigma_rad[2, 0] == np.inf
    assert found.measurable() == [1, 4]


@pytest.mark.parametrize("repeats", [2, 8])
def test_noise_is_not_taken_for_fringes(repeats):
    # The modulation of noise of 40 DN alone is 41 DN on average, in however many captures; products
    # of two captures are zero on average, and more than the least modulation of 3 DN squared on
    # less than half of the pixels.
    captures = shots("1,4,12", 40.0, repeats=repeats)
    rng = np.random.default_rng(3)
    for shot in captures:
        shot.frames[6:] = np.rint(500.0 + rng.normal(0.0, 40.0, (3, 80, 120)))
    assert noise_of_captures(captures).measurable() == [1, 4]


@pytest.mark.parametrize(("rows", "lost"), [(30, False), (50, True)])
def test_all_sets_are_estimated_on_the_pixels_that_all_measured_sets_have(rows, lost):
    """Of 80 rows, the first have no fine fringes, and twice the noise in all sets."""
    captures = shots("1,12", 40.0)
    part = noise_of_captures(
        [Capture(s.frames[:, rows:].copy(), s.sequence, bit_depth=12) for s in captures]
    )
    rng = np.random.default_rng(1)
    for shot in captures:
        extra = rng.normal(0.0, 70.0, (3, rows, 120))
        shot.frames[:3, :rows] = np.rint(shot.frames[:3, :rows] + extra).clip(0, 4000)
        shot.frames[3:, :rows] = 500
    found = noise_of_captures(captures)
    if lost:  # on most of them: then the coarse set is measured on all
        assert found.sigma_rad[1, 0] == np.inf
        assert found.sigma_rad[0, 0] > 1.3 * part.sigma_rad[0, 0]
    else:
        np.testing.assert_array_equal(found.sigma_rad, part.sigma_rad)


# -- the table ------------------------------------------------------------------------------------


def table():
    sigma = np.array([[0.03, 0.02, 0.031], [0.05, 0.025, 0.123456789], [np.inf, 0.04, np.inf]])
    return PhaseNoise(np.array([1, 8, 40]), sigma, np.array([-1.5, 0.0, 2.25]), shifts=4)


def test_file_and_back(tmp_path):
    path = tmp_path / "noise.csv"
    table().write(path)
    assert path.read_text().splitlines()[:3] == [
        "fringes,z_mm,sigma_rad",
        "1,-1.5,0.03",
        "1,0,0.02",
    ]
    found = PhaseNoise.read(path, shifts=4)
    np.testing.assert_array_equal(found.fringes, [1, 8, 40])
    np.testing.assert_array_equal(found.z_mm, [-1.5, 0.0, 2.25])
    np.testing.assert_array_equal(found.sigma_rad, table().sigma_rad)
    assert found.shifts == 4
    # Neither the order of the rows nor that of the columns matters.
    rows = [line.split(",") for line in path.read_text().splitlines()]
    swapped = [rows[0], *rows[:0:-1]]
    path.write_text("\n".join(",".join((c, a, b)) for a, b, c in swapped))
    np.testing.assert_array_equal(PhaseNoise.read(path).sigma_rad, table().sigma_rad)


def test_values_by_count_and_number_of_shifts():
    noise = table()
    np.testing.assert_array_equal(noise.of(8), [0.05, 0.025, 0.123456789])
    # Four times the frames, half the noise.
    np.testing.assert_allclose(noise.of(8, 16), 0.5 * noise.of(8), rtol=1e-15)
    np.testing.assert_allclose(noise.of(8, 3), np.sqrt(4 / 3) * noise.of(8), rtol=1e-15)
    assert noise.measurable() == [1, 8]
    assert noise.typical_rad == pytest.approx(np.sqrt((0.03**2 + 0.02**2 + 0.031**2) / 3))
    for count in (2, 41, 0):
        with pytest.raises(
            InputError, match=f"^phase noise: expected one of 1, 8, 40 fringes, got {count}$"
        ):
            noise.of(count)


def test_constant_noise():
    noise = PhaseNoise.constant(0.036, [50, 1, 10, 10], shifts=5)
    np.testing.assert_array_equal(noise.fringes, [1, 10, 50])
    np.testing.assert_array_equal(noise.sigma_rad, np.full((3, 1), 0.036))
    assert noise.typical_rad == pytest.approx(0.036)
    assert noise.shifts == 5
    for bad in (0.0, -1.0, 3.15, np.nan, np.inf):
        with pytest.raises(InputError, match=r"^noise: expected a positive number"):
            PhaseNoise.constant(bad, [1, 10])


@pytest.mark.parametrize(
    ("fringes", "sigma", "heights", "message"),
    [
        ([], np.zeros((0, 1)), [0.0], "fringes: expected ascending counts"),
        ([10, 1], np.ones((2, 1)), [0.0], "fringes: expected ascending counts"),
        ([1, 1], np.ones((2, 1)), [0.0], "fringes: expected ascending counts"),
        ([0, 1], np.ones((2, 1)), [0.0], "fringes: expected counts of at least 1"),
        ([1, 2], np.ones((1, 2)), [0.0], r"sigma_rad: expected shape \(2, 1\), got \(1, 2\)"),
        ([1, 2], np.ones((2, 0)), [], r"sigma_rad: expected shape \(2, 0\)"),
        ([1, 2], np.array([[0.1], [0.0]]), [0.0], "sigma_rad: expected positive numbers"),
        ([1, 2], np.array([[0.1], [3.15]]), [0.0], "sigma_rad: expected positive numbers"),
        ([1, 2], np.array([[0.1], [np.nan]]), [0.0], "sigma_rad: expected positive numbers"),
    ],
)
def test_arrays_that_are_no_table(fringes, sigma, heights, message):
    with pytest.raises(InputError, match=f"^phase noise: {message}"):
        PhaseNoise(np.array(fringes, np.int64), sigma, np.array(heights))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("1,0,0.1\n1,1,0.1\n5,0,0.1", "expected each of 2 counts once at each of 2 heights"),
        ("1,0,0.1\n5,0,0.1\n5,0,0.2", "expected each of 2 counts once at each of 1 heights"),
        ("1,0,0.1\n1,0,0.1\n5,0,0.1\n5,1,0.2", "expected each of 2 counts once at each of 2"),
        ("1,0,-0.1", r"sigma_rad: expected positive numbers \(rad\), at most pi, or inf"),
        ("1,0,3.2", r"sigma_rad: expected positive numbers \(rad\), at most pi, or inf"),
        ("1,0,0", "sigma_rad: expected positive numbers"),
        ("1,0,nan", "sigma_rad: expected positive numbers"),
        ("1.5,0,0.1", "fringes: expected whole numbers >= 1"),
        ("0,0,0.1", "fringes: expected whole numbers >= 1"),
        ("-2,0,0.1", "fringes: expected whole numbers >= 1"),
        ("nan,0,0.1", "expected finite fringes and heights"),
        ("inf,0,0.1", "expected finite fringes and heights"),
        ("1,nan,0.1", "expected finite fringes and heights"),
        ("1,0", "line 2: expected 3 numbers, got 1,0"),
        ("1,0,x", "line 2: expected 3 numbers, got 1,0,x"),
        ("", "expected at least one row below the header, got none"),
    ],
)
def test_files_that_are_no_table(tmp_path, rows, message):
    path = tmp_path / "noise.csv"
    path.write_text(f"fringes,z_mm,sigma_rad\n{rows}\n")
    with pytest.raises(InputError, match=message) as error:
        PhaseNoise.read(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_files_without_a_column(tmp_path):
    path = tmp_path / "noise.csv"
    path.write_text("fringes,sigma_rad\n1,0.1\n")
    expected = "line 1: expected the header fringes,z_mm,sigma_rad, got fringes,sigma_rad"
    with pytest.raises(InputError, match=expected):
        PhaseNoise.read(path)
