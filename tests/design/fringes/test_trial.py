"""Pattern designs against rendered scans: noise, order errors, defocus."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from stages import capture, ground_truth, trace

from slbench.core.errors import InputError
from slbench.design.fringes.bounded import bounded_sequence
from slbench.design.fringes.design import candidates, predict, thesis_sequence
from slbench.design.fringes.noise import PhaseNoise
from slbench.design.fringes.trial import _spread, noise_of_scene, scan_repeatedly
from slbench.patterns import PatternSequence, unwrap
from slbench.patterns.fringes.wrong_orders import phase_deviation, relative_noise
from slbench.scene.file import load_scene
from slbench.simulate.repeats import plate_scene, repeated_phases

REPEATS = 12


def with_projector_lens(scene, **values):
    projector = scene.rig.projector
    lens = replace(projector.lens, **values)
    return replace(scene, rig=scene.rig.having(projector=replace(projector, lens=lens)))


@pytest.fixture(scope="module")
def block():
    return load_scene("step-block", preview=True)


@pytest.fixture(scope="module")
def grainy():
    """The step block with so much noise that careless sequences mistake orders."""
    return load_scene("step-block-grainy", preview=True)


@pytest.fixture(scope="module")
def grainy_noise(grainy):
    width = grainy.rig.projector.width
    return noise_of_scene(grainy, candidates(width), repeats=REPEATS)


# -- the estimate -------------------------------------------------------------------------


def test_noise_of_a_scene_is_that_of_its_detector(block):
    # A plate in the focus of both lenses: sigma = sqrt(2 / N) sigma_I / b with the variance
    # and the modulation of its own frames (patterns/phase.py), which the decoder predicts.
    found = noise_of_scene(block, [1, 4, 16], z_mm=[0.0], repeats=REPEATS, shifts=4)
    plate = plate_scene(block, 0.0)
    panel = (block.rig.projector.width, block.rig.projector.height)
    plate = replace(plate, sequence=PatternSequence.parse("1,4,16@4", panel))
    shots = capture(plate, trace(plate, ("u",)), seed=5)
    smooth = ground_truth(plate).smooth()
    sigma = shots.decode().sigma["u"][smooth] * 2 * np.pi * 16 / panel[0]
    predicted = np.sqrt(np.nanmean(sigma**2))
    # The estimate's own standard error is below 0.2 %; rounding and the spread of fixed
    # pattern over pixels are no part of the prediction.
    np.testing.assert_allclose(found.sigma_rad[2, 0], predicted, rtol=0.02)
    np.testing.assert_allclose(found.sigma_rad[:, 0], predicted, rtol=0.04)
    assert found.shifts == 4


def test_vibration_is_part_of_the_noise(block):
    shaken = replace(block, exposure=replace(block.exposure, vibration_px=0.2))
    still = noise_of_scene(block, [1, 64], z_mm=[0.0], repeats=6).sigma_rad[:, 0]
    moved = noise_of_scene(shaken, [1, 64], z_mm=[0.0], repeats=6).sigma_rad[:, 0]
    # A shift of 0.2 px matters where a fringe is ten camera pixels wide, not where it is 600.
    assert moved[0] < 1.2 * still[0]
    assert moved[1] > 2.0 * still[1]


def test_fringes_that_defocus_washes_out_or_reverses_are_not_measured(block):
    # Focused at half the distance: the contrast of 32 fringes is reversed.
    blurred = with_projector_lens(block, focus_distance_mm=400.0)
    assert noise_of_scene(blurred, [1, 8, 32], z_mm=[0.0], repeats=4).measurable() == [1, 8]
    # At a fifth, through the full aperture, that of 64 is below one part in a hundred.
    gone = with_projector_lens(block, focus_distance_mm=160.0, aperture_radius_mm=14.0)
    assert noise_of_scene(gone, [1, 64], z_mm=[0.0], repeats=4).measurable() == [1]


def test_repeated_phases_are_those_of_whole_frames(block):
    plate = plate_scene(block, 0.0)
    transport = trace(plate, ("u",))
    pixels = np.flatnonzero(ground_truth(plate).smooth())
    phases, modulation = repeated_phases(plate, (transport,), [1, 8], pixels, repeats=2)
    coordinate = (np.mod(phases[:, 0], 2 * np.pi) / (2 * np.pi)) * transport.panel[0] - 0.5
    true = ground_truth(plate).panel[..., 0].ravel()[pixels]
    # The noise of one fringe is 1.2 px here; five deviations of the mean of thousands.
    np.testing.assert_allclose(np.median(coordinate - true), 0.0, atol=0.1)
    assert phases.shape == (2, 2, len(pixels))
    assert modulation.shape == (2, 2, len(pixels))
    assert np.all(modulation > 10.0)


# -- scans against predictions ------------------------------------------------------------


def test_scans_of_the_step_block_keep_what_the_design_predicts(grainy, grainy_noise):
    width = grainy.rig.projector.width
    designed = thesis_sequence(width, grainy_noise)
    others = [predict(width, grainy_noise, counts) for counts in ((1, 2, 4), (1, 2, 4, 8, 16))]
    designs = [designed, *others]
    trials = scan_repeatedly(grainy, designs, repeats=15, seed=3)
    counted = {trial.plate_like.pixels for trial in trials}
    assert len(counted) == 1  # the same pixels for all
    assert counted.pop() > 5000
    for design, trial in zip(designs, trials, strict=True):
        found = trial.plate_like
        assert trial.fringes == design.fringes
        assert trial.repeats == 15
        assert found.measured > 0.999
        # No order errors predicted, and none seen: 15 scans of thousands of pixels.
        assert design.order_error_probability < 1e-6
        assert found.order_error_rate == 0.0
        # Within 10 %: the block is not lit as evenly as the plate that the noise is from.
        assert found.std_px == pytest.approx(trial.predicted_px, rel=0.10)
        # The modulation of each pixel, by the noise model: 0.2 % of statistics; the model knows
        # no fixed pattern and no clipping.
        assert found.std_px == pytest.approx(found.expected_px, rel=0.03)
    ratio = trials[1].plate_like.std_px / trials[0].plate_like.std_px
    assert ratio == pytest.approx(others[0].sigma_px / designed.sigma_px, rel=0.1)


def test_order_errors_come_as_often_as_predicted(grainy, grainy_noise):
    width = grainy.rig.projector.width
    careless = [predict(width, grainy_noise, counts) for counts in ((1, 40), (1, 64), (1, 20, 80))]
    trials = scan_repeatedly(grainy, careless, repeats=6, seed=11)
    for design, trial in zip(careless, trials, strict=True):
        found = trial.plate_like
        assert design.order_error_probability > 0.003
        # Frequent enough to count: a hundred errors at least.  A deviation of 3 % in the
        # noise changes probabilities of this size by 10 to 20 %.
        assert found.order_error_rate * found.pixels * trial.repeats > 100
        assert found.order_error_rate == pytest.approx(found.expected_order_error_rate, rel=0.2)
        assert found.std_px == pytest.approx(found.expected_px, rel=0.1)


def test_surfaces_that_are_lit_less_are_counted_by_themselves(grainy):
    """The flanks of a sphere: more than twice the noise of the plate."""
    ball = replace(load_scene("sphere", preview=True), detector=grainy.detector)
    width = ball.rig.projector.width
    noise = noise_of_scene(ball, [1, 2, 4, 20], z_mm=[0.0], repeats=8)
    designs = [predict(width, noise, counts) for counts in ((1,), (1, 2, 4), (1, 20))]
    trials = scan_repeatedly(ball, designs, repeats=15, seed=5)
    assert len({(trial.plate_like.pixels, trial.other.pixels) for trial in trials}) == 1
    for trial in trials:
        for group, slack in ((trial.plate_like, 0.04), (trial.other, 0.10)):
            assert group.measured == 1.0
            assert group.pixels > 50
            # 14 degrees of freedom a pixel: 2.3 % for 67 pixels, 0.6 % for 900; four of these.
            if not group.order_error_rate:
                assert group.std_px == pytest.approx(group.expected_px, rel=slack)
        assert trial.other.std_px > 1.5 * trial.plate_like.std_px
    # By construction: the first set alone has at most, and at least, twice the noise.
    single = trials[0]
    assert single.plate_like.expected_px < 2.0 * single.predicted_px < single.other.expected_px
    # 370 and 210 order errors, four standard errors.
    careless = trials[2]
    for group, slack in ((careless.plate_like, 0.2), (careless.other, 0.3)):
        count = group.order_error_rate * group.pixels * careless.repeats
        assert count > 150
        assert group.order_error_rate == pytest.approx(group.expected_order_error_rate, rel=slack)
    # The design's own number is for the plate, and does not hold here.
    assert careless.other.order_error_rate > 20 * careless.predicted_order_error_probability


def test_pixels_that_are_not_always_measured_count_by_what_there_is():
    design = predict(640, PhaseNoise.constant(0.1, [1, 20]), (1, 20))
    rng = np.random.default_rng(1)
    error = rng.normal(0.0, 0.5, (10, 400))
    error[:, 300:] = 20.0 * rng.standard_normal((10, 100))  # half a fringe is 16 px
    error[1:, :100] = np.nan  # seen once
    error[:5, 100:200] = np.nan
    error[:, 200] = np.nan
    sigma = np.full((2, 400), 0.1)
    found = _spread(design, error, sigma)
    seen = np.isfinite(error)
    assert found.pixels == 400
    assert found.measured == pytest.approx(seen.mean())
    squares = [np.var(e[np.isfinite(e)], ddof=1) for e in error[:, 201:].T]
    halves = [np.var(e[5:], ddof=1) for e in error[:, 100:200].T]
    mean = (9 * np.sum(squares) + 4 * np.sum(halves)) / (9 * len(squares) + 4 * len(halves))
    assert found.std_px == pytest.approx(np.sqrt(mean))
    assert found.order_error_rate == pytest.approx(np.mean(np.abs(error[seen]) > 16.0))
    assert found.expected_px == pytest.approx(design.sigma_px)
    assert found.expected_order_error_rate == pytest.approx(design.order_error_probability)
    nothing = _spread(design, np.full((10, 3), np.nan), sigma[:, :3])
    assert (nothing.pixels, nothing.measured) == (3, 0.0)
    assert np.isnan([nothing.std_px, nothing.rms_px, nothing.expected_px]).all()


def test_a_bound_on_order_errors_holds_where_the_single_step_breaks_it(grainy, grainy_noise):
    width = grainy.rig.projector.width
    safe = bounded_sequence(width, grainy_noise, max_probability=1e-6)
    assert len(safe.steps) >= 2
    (trial,) = scan_repeatedly(grainy, [safe], repeats=8, seed=2)
    assert trial.plate_like.order_error_rate < 1e-5
    assert trial.plate_like.std_px == pytest.approx(safe.sigma_px, rel=0.10)


# -- defocus ------------------------------------------------------------------------------


def two_step_deviations(scene, noise, repeats, others=()):
    """Measured deviation, px, of every {1, a}, {1, a, b} and other, from phases new to a design."""
    counts = noise.measurable()
    width = scene.rig.projector.width
    sequences = [(1, n) for n in counts[1:]]
    sequences += [(1, a, b) for a, b in combinations(counts[1:], 2)]
    sequences += [sequence for sequence in others if sequence not in sequences]
    squares = {sequence: [] for sequence in sequences}
    for j, height in enumerate(noise.z_mm):
        plate = plate_scene(scene, height)
        transport = trace(plate, ("u",), seed=70 + j)
        truth = ground_truth(plate)
        pixels = np.flatnonzero(truth.smooth())[::5]
        true = truth.panel[..., 0].ravel()[pixels]
        phases, _ = repeated_phases(
            plate, (transport,), counts, pixels, repeats=repeats, seed=5000 + 100 * j
        )
        # Away from the ends of the panel, where one fringe starts again.
        inside = (true > 0.1 * width) & (true < 0.9 * width)
        phases = phases[..., inside & np.isfinite(phases).all(axis=(0, 1))]  # none saturated
        for sequence, values in squares.items():
            absolute = phases[:, 0]
            for before, n in pairwise(sequence):
                absolute = unwrap(phases[:, counts.index(n)], n, absolute, before)
            deviation = absolute / sequence[-1] * width / (2 * np.pi)
            values.append(np.mean(deviation.var(axis=0, ddof=1)))
    return {sequence: float(np.sqrt(np.mean(values))) for sequence, values in squares.items()}


def test_defocus_makes_the_designer_back_off_and_scans_agree(grainy, grainy_noise):
    # The projector focused at half its distance.
    blurred = with_projector_lens(grainy, focus_distance_mm=400.0)
    width = grainy.rig.projector.width
    noise = noise_of_scene(blurred, candidates(width), repeats=REPEATS)
    assert noise.of(16)[0] > 2.0 * noise.of(1)[0]
    sharp = thesis_sequence(width, grainy_noise)
    measured = two_step_deviations(blurred, noise, 10)
    best = min(value for sequence, value in measured.items() if len(sequence) == 3)
    for design in (thesis_sequence(width, noise), bounded_sequence(width, noise)):
        assert design.fringes[-1] < 20 < sharp.fringes[-1]
        # Within 5 % of the best of all two-step sequences.
        assert measured[design.fringes] <= 1.05 * best
    # It was possible to do far worse.
    assert max(measured.values()) > 3.0 * best


def test_with_much_noise_the_set_between_decides_and_the_design_finds_it(grainy):
    """Of all sequences to the same last set most are spoilt by wrong orders."""
    noisy = replace(grainy, detector=replace(grainy.detector, full_well_e=600.0))
    blurred = with_projector_lens(noisy, focus_distance_mm=500.0)
    width = grainy.rig.projector.width
    noise = noise_of_scene(blurred, candidates(width), repeats=REPEATS)
    assert noise.of(1)[0] > 0.08
    designs = [thesis_sequence(width, noise)]
    designs += [bounded_sequence(width, noise, safety=safety) for safety in (1.0, 2.0)]
    measured = two_step_deviations(blurred, noise, 10, [design.fringes for design in designs])
    two_step = {s: value for s, value in measured.items() if len(s) == 3}
    best = min(two_step, key=two_step.__getitem__)
    # To the same last set, other sets between are worse by 2 % to a factor of two and more,
    # where noise leaves ratios of equal sets within a few thousandths of 1.
    alike = [value / two_step[best] for s, value in two_step.items() if s[-1] == best[-1]]
    assert len(alike) >= 5
    assert sum(value > 1.01 for value in alike) >= 3
    assert max(alike) > 2.0
    for design in designs[:2]:
        assert measured[design.fringes] <= 1.05 * two_step[best]
    # With twice the noise that step is not safe: the design is as good as the best that is.
    twice = replace(noise, sigma_rad=phase_deviation(2.0 * relative_noise(noise.sigma_rad)))
    safe = [s for s in measured if predict(width, twice, s).order_error_probability <= 1e-6]
    assert best not in safe
    assert designs[2].fringes in safe
    assert measured[designs[2].fringes] <= 1.05 * min(measured[s] for s in safe)


# -- refusals -----------------------------------------------------------------------------


def test_refusals(block):
    with pytest.raises(InputError, match="repeats: expected a whole number from 2 to 10000"):
        noise_of_scene(block, [1], repeats=1)
    with pytest.raises(InputError, match="z = 5000 mm"):
        noise_of_scene(block, [1], z_mm=[5000.0])
    noise = PhaseNoise.constant(0.1, [1])
    with pytest.raises(InputError, match="repeats: expected a whole number from 2 to 10000"):
        scan_repeatedly(block, [predict(block.rig.projector.width, noise, (1,))], repeats=1)
