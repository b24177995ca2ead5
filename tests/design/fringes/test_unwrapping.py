"""Noise of one unwrapping step: closed form, simulation, and a brute-force sum of the test's own.

The reference of this file goes another way than the module: it holds the noise of the relative
phase fixed, asks with which probability the reference's noise then leads to each order k, and
sums (2 pi (k - delta) + e_phi)^m over orders, over pixels and over a fine lattice of e_phi.
The trapezoidal rule on that lattice is exact to rounding, as the integrand is smooth on the
scale of the lesser noise and the lattice is twice as fine.
"""

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import poisson

from slbench.core.errors import InputError
from slbench.design.fringes.unwrapping import absolute_sigma, ideal_phases, sampled_sigma
from slbench.patterns import order_error_probability

TURN = 2.0 * np.pi
#: What is beyond has a probability of 1e-21.
REACH = 9.5


def offsets_of(model, fringes, width):
    """n Phi_ref - phi_n of every pixel in turns, less whole turns (thesis eq. 27 and 28)."""
    if model == "exact":
        return np.zeros(1), np.ones(1)
    period = width // fringes
    j = np.arange(1, width + 1)
    turns = fringes * (j - 1) / (width - 1) - (j % period - 1) / (period - 1)
    turns, counts = np.unique(np.round(turns - np.rint(turns), 13), return_counts=True)
    return turns, counts / width


def reference_moments(fringes, sigma_reference, sigma_phase, offsets=((0.0,), (1.0,))):
    """Variance, fourth central moment (rad of n fringes) and probability of a wrong order."""
    turns, pixels = (np.asarray(part) for part in offsets)
    spread = fringes * sigma_reference
    step = 0.5 * min(1.0, spread / sigma_phase)
    x = step * np.arange(-np.ceil(REACH / step), np.ceil(REACH / step) + 1)
    weight = np.exp(-0.5 * x * x)
    weight /= weight.sum()
    most = np.ceil(REACH * np.hypot(spread, sigma_phase) / TURN + 1.0)
    error = sigma_phase * x
    order = np.arange(-most, most + 1)[:, np.newaxis]
    moments = np.zeros(5)
    wrong = 0.0
    for delta, share in zip(turns, pixels, strict=True):
        low, high = ((TURN * (order + side - delta) + error) / spread for side in (-0.5, 0.5))
        # The difference of the smaller tails, so that rare orders keep their digits.
        flip = low > 0.0
        chance = ndtr(np.where(flip, -low, high)) - ndtr(np.where(flip, -high, low))
        chance *= share * weight
        deviation = TURN * (order - delta) + error
        moments += [np.sum(chance * deviation**m) for m in range(5)]
        wrong += chance[order[:, 0] != 0].sum()
    assert moments[0] == pytest.approx(1.0, abs=1e-12)  # all orders that can occur are there
    _, mean, second, third, fourth = moments
    variance = second - mean**2
    return variance, fourth - 4 * mean * third + 6 * mean**2 * second - 3 * mean**4, wrong


def log_uniform(rng, low, high, size):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


# -- the closed form ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "width", "fringes"),
    [
        ("exact", None, 1),
        ("exact", None, 10),
        ("thesis", 80, 1),
        ("thesis", 80, 4),
        ("thesis", 80, 16),  # 5 px a fringe: offsets of up to 0.25 turns
        ("thesis", 96, 32),  # 3 px a fringe: of 0.5
    ],
)
def test_closed_form_is_the_sum_over_all_orders(model, width, fringes):
    rng = np.random.default_rng(1)
    spread = np.append(log_uniform(rng, 0.02, 0.2, 15), log_uniform(rng, 0.1, 8.0, 25))
    sigma_phase = np.append(log_uniform(rng, 0.02, 0.2, 15), log_uniform(rng, 0.1, 3.0, 25))
    s = np.hypot(spread, sigma_phase)
    assert np.sum(s < 0.25) > 10  # both ways of summing have to answer
    assert np.sum(s > 0.25) > 20
    offsets = offsets_of(model, fringes, width)
    found = absolute_sigma(fringes, spread / fringes, sigma_phase, width_px=width, model=model)
    expected = [
        np.sqrt(reference_moments(fringes, one / fringes, other, offsets)[0]) / fringes
        for one, other in zip(spread, sigma_phase, strict=True)
    ]
    # 1e-16 of the largest variance here, 80 rad^2, beside the smallest, 4e-4 rad^2: 2e-11.
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("model", ["exact", "thesis"])
def test_many_orders(model):
    # s = 20 rad: the order is off by up to thirty.
    offsets = offsets_of(model, 10, 400)
    found = absolute_sigma(10, 1.9, 6.0, width_px=400, model=model)
    expected = np.sqrt(reference_moments(10, 1.9, 6.0, offsets)[0]) / 10
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("model", "fringes"), [("exact", 10), ("thesis", 10), ("thesis", 80)])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_no_step_where_the_way_of_summing_changes(model, fringes, share):
    s = 0.25 * np.array([1.0 - 1e-11, 1.0 + 1e-11])
    sigma_phase = s * share
    sigma_reference = s * np.sqrt(1.0 - share**2) / fringes
    below, above = absolute_sigma(fringes, sigma_reference, sigma_phase, width_px=400, model=model)
    # The function itself changes by 2e-11 at most; rounding of terms of s^2 = 0.06 beside a
    # variance of (0.05 * 0.25)^2 is 1e-13.
    assert above == pytest.approx(below, rel=1e-10)


def test_without_order_errors_only_the_relative_phase_is_left():
    # s <= 0.25: half a turn is twelve deviations away.
    # A phase far better than its reference is no rounding error of s^2 either.
    sigma_reference, sigma_phase = np.meshgrid([0.0, 0.001, 0.01, 0.02], [1e-9, 0.005, 0.14])
    found = absolute_sigma(10, sigma_reference, sigma_phase)
    np.testing.assert_allclose(found, sigma_phase / 10, rtol=1e-12)


def test_of_much_noise_the_order_says_nothing():
    # Then the saw tooth r is uniform and independent of the reference: variance + (2 pi)^2 / 12.
    found = absolute_sigma(10, [0.0, 2.0, 50.0], [30.0, 7.0, 0.0])
    expected = np.sqrt(np.array([0.0, 2.0, 50.0]) ** 2 + np.pi**2 / 3.0 / 100.0)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_one_noise_alone():
    # No noise of the relative phase: whole orders, the rounded reference.
    rounded = np.arange(-60, 61)
    for sigma in (0.1, 0.3, 2.0):
        edges = TURN * np.array([rounded - 0.5, rounded + 0.5]) / (10 * sigma)
        chance = np.diff(ndtr(-np.abs(edges)), axis=0)[0]
        chance = np.where(rounded < 0, chance, -chance)
        chance[60] = 0.0  # the order that is right
        expected = TURN * np.sqrt(chance @ rounded**2) / 10
        assert absolute_sigma(10, sigma, 0.0) == pytest.approx(expected, rel=1e-9)
    # No noise of the reference: the phase of the position plus its own noise, wrapped.
    sigma = np.array([0.01, 0.2, 0.5, 1.0, 2.0])
    error = np.linspace(-20.0, 20.0, 4_000_001)
    wrapped = np.mod(error + np.pi, TURN) - np.pi
    density = np.exp(-0.5 * (error / sigma[:, np.newaxis]) ** 2)
    expected = np.sqrt(density @ wrapped**2 / density.sum(axis=1)) / 10
    # Jumps of the integrand on a lattice of 1e-5 rad.
    np.testing.assert_allclose(absolute_sigma(10, 0.0, sigma), expected, rtol=1e-5)


def test_without_noise_only_the_offsets_are_left():
    assert absolute_sigma(10, 0.0, 0.0) == 0.0
    turns, share = offsets_of("thesis", 10, 400)
    spread = np.sqrt(share @ turns**2 - (share @ turns) ** 2)
    found = absolute_sigma(10, [0.0, 1e-9], [0.0, 1e-9], width_px=400, model="thesis")
    np.testing.assert_allclose(found, TURN * spread / 10, rtol=1e-9)


def test_shapes_broadcast():
    rows, columns = np.array([[0.01], [0.05]]), np.array([0.02, 0.2, 0.9])
    found = absolute_sigma(10, rows, columns)
    assert found.shape == (2, 3)
    assert absolute_sigma(10, 0.01, 0.02).shape == ()
    single = [[absolute_sigma(10, a, b).item() for b in columns] for a in rows[:, 0]]
    np.testing.assert_array_equal(found, single)
    assert sampled_sigma(10, rows, columns, width_px=40).shape == (2, 3)
    assert sampled_sigma(10, 0.01, 0.02, width_px=40).shape == ()


# -- the ideal phases -----------------------------------------------------------------------------


def test_phases_of_one_position_agree_and_the_theses_do_not():
    relative, reference = ideal_phases(10, 400, "exact")
    np.testing.assert_allclose(reference, TURN * (np.arange(400) + 0.5) / 400, rtol=1e-15)
    turns = (10 * reference - relative) / TURN
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-12)
    # Thesis eq. 27 and 28 for pixels 1, 39, 40 and 41 of 400, 40 px a fringe.
    relative, reference = ideal_phases(10, 400, "thesis")
    chosen = [0, 38, 39, 40]
    np.testing.assert_allclose(relative[chosen], TURN * np.array([0, 38, -1, 0]) / 39, atol=1e-15)
    np.testing.assert_allclose(reference[chosen], TURN * np.array([0, 38, 39, 40]) / 399)


# -- the simulation -------------------------------------------------------------------------------

N_SIGMA = 5.0
TAIL = 3e-7  # of each side of 5 standard errors; 1.5e-4 for all 2 x 256 decisions below


@pytest.mark.parametrize(
    ("model", "width", "fringes", "largest"),
    [
        ("exact", 400, 10, 0.072),  # the thesis's grid, s <= 0.72: order errors are rare
        ("thesis", 400, 10, 0.072),
        ("exact", 400, 10, 0.4),  # s up to 4: most orders are wrong
        ("thesis", 80, 16, 0.25),
    ],
)
def test_closed_form_and_simulation_agree(model, width, fringes, largest):
    """Within 2 %, and where wrong orders are too rare for that, within what their number allows.

    The relative standard error of a sampled deviation is sqrt((kurtosis - 1) / 4 N), from the
    exact fourth moment.  Where it is below 0.4 %, 2 % are five of them.  Where it is not, a few
    wrong orders, of 2 pi each, make the variance: their number is a Poisson variable, the rest
    of the variance Gaussian.  (Offsets, which are not drawn, only make both safer.)
    """
    levels = np.linspace(largest / 8, largest, 8)
    rows, columns = levels[:, np.newaxis], levels * (1.0 if largest < 0.1 else 2.0)
    repeats = 160_000 // width
    samples = repeats * width
    offsets = offsets_of(model, fringes, width)
    closed = absolute_sigma(fringes, rows, columns, width_px=width, model=model)
    sampled = sampled_sigma(
        fringes, rows, columns, width_px=width, model=model, repeats=repeats, seed=3
    )
    turns, share = offsets
    fixed = TURN**2 * (share @ turns**2 - (share @ turns) ** 2)
    ratio = sampled / closed
    settled = 0
    for i, j in np.ndindex(closed.shape):
        variance, fourth, wrong = reference_moments(fringes, levels[i], columns[j], offsets)
        error = np.sqrt((fourth / variance**2 - 1.0) / (4.0 * samples))
        if N_SIGMA * error < 0.02:
            settled += 1
            assert abs(ratio[i, j] - 1.0) < N_SIGMA * error
            continue
        smooth = columns[j] ** 2 + fixed
        rare = (variance - smooth) / (samples * wrong)  # of one wrong order
        least, most = poisson.ppf([TAIL, 1.0 - TAIL], samples * wrong)
        slack = N_SIGMA * np.sqrt(2.0 / samples)
        found = (fringes * sampled[i, j]) ** 2
        assert smooth * (1.0 - slack) + rare * least <= found
        assert found <= smooth * (1.0 + slack) + rare * most
    assert settled >= 40  # of 64
    if largest > 0.1:
        # The region where wrong orders dominate is among the settled ones.
        dominated = closed > 3.0 * np.broadcast_to(columns / fringes, closed.shape)
        assert np.sum(dominated) >= 10


def test_simulation_is_reproducible_and_shares_its_noise_between_levels():
    one = sampled_sigma(10, [0.01, 0.01001], 0.05, width_px=400, repeats=2, seed=1)
    np.testing.assert_array_equal(
        one, sampled_sigma(10, [0.01, 0.01001], 0.05, width_px=400, repeats=2, seed=1)
    )
    # The reference does not matter here, so that only other random numbers would differ.
    assert one[0] == pytest.approx(one[1], rel=1e-12)
    assert one[0] != sampled_sigma(10, 0.01, 0.05, width_px=400, repeats=2, seed=2)


# -- probability of a wrong order -----------------------------------------------------------------


def test_order_error_probability_broadcasts_and_is_the_sums():
    rows, columns = np.array([[0.02], [0.1], [0.4]]), np.array([0.05, 0.5])
    found = order_error_probability(rows, columns, 2, 20, "gaussian")
    assert found.shape == (3, 2)
    for i, j in np.ndindex(3, 2):
        _, _, wrong = reference_moments(10, rows[i, 0], columns[j])
        assert found[i, j] == pytest.approx(wrong, rel=1e-9, abs=1e-30)
        single = order_error_probability(float(rows[i, 0]), float(columns[j]), 2, 20, "gaussian")
        assert isinstance(single, float)
        assert single == found[i, j]
    np.testing.assert_array_equal(order_error_probability([0.0, np.inf], 0.0, 1, 2), [0.0, 1.0])
    with pytest.raises(InputError, match="sigma: expected a number >= 0"):
        order_error_probability([0.1, 0.1], [0.1, np.nan], 1, 2)


# -- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((10, -0.1, 0.1), {}, r"^sigma_reference: expected finite numbers >= 0 rad, got"),
        ((10, 0.1, [0.1, np.nan]), {}, r"^sigma_phase: expected finite"),
        ((10, np.inf, 0.1), {}, r"^sigma_reference: expected finite"),
        ((10, 0.1, 0.1), {"model": "thesis"}, r"^width_px: expected the coded width"),
        ((7, 0.1, 0.1), {"model": "thesis", "width_px": 400}, r"^fringes: expected a divisor of"),
        ((400, 0.1, 0.1), {"model": "thesis", "width_px": 400}, r"^fringes: expected at least 2"),
        ((0, 0.1, 0.1), {}, r"^fringes: expected a whole number from 1 .*, got 0$"),
        ((np.nan, 0.1, 0.1), {}, r"^fringes: expected a whole number from 1 .*, got nan$"),
        ((10, 0.1, 0.1), {"model": "ideal"}, r"^model: expected exact or thesis, got"),
        ((10, 0.1, 0.1), {"model": "ideal", "width_px": 400}, r"^model: expected exact or thesis"),
    ],
)
def test_closed_form_refuses_in_one_line(arguments, options, message):
    with pytest.raises(InputError, match=message) as error:
        absolute_sigma(*arguments, **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"repeats": 0}, r"^repeats: expected a whole number from 1 .*, got 0$"),
        ({"width_px": 401}, r"^fringes: expected a divisor of the width, 401 px, got 10$"),
        ({"model": "ideal"}, r"^model: expected exact or thesis, got 'ideal'"),
        ({"sigma_phase": -1.0}, r"^sigma_phase: expected finite numbers >= 0 rad"),
    ],
)
def test_simulation_refuses_in_one_line(options, message):
    arguments = {"sigma_reference": 0.1, "sigma_phase": 0.1, "width_px": 400} | options
    with pytest.raises(InputError, match=message):
        sampled_sigma(10, **arguments)
