"""Bounded design: against all sequences and all ways to share out the frames, one by one.

The brute force of this file knows no dynamic programming: it walks through every ascending choice
of candidates that begins with one fringe, and every number of shifts a set.
"""

from functools import cache
from itertools import combinations, pairwise
from math import log1p, pi, sqrt

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.design.fringes.bounded import bounded_sequence
from slbench.design.fringes.design import candidates, predict
from slbench.design.fringes.noise import PhaseNoise
from slbench.patterns import order_error_probability
from slbench.patterns.fringes.wrong_orders import phase_deviation


def danger_of(noise, fringes, shifts):
    """-log of the probability that every step is safe, at the worst of the heights."""
    sigma = {n: noise.relative(n) for n in fringes}
    sets = list(zip(fringes, shifts, strict=True))
    steps = [
        step_danger(n / before, tuple(sigma[before]), few, tuple(sigma[n]), many, noise.shifts)
        for (before, few), (n, many) in pairwise(sets)
    ]
    return max((sum(heights) for heights in zip(*steps, strict=True)), default=0.0)


@cache
def step_danger(ratio, reference, few, own, many, shifts):
    """At each height."""
    noise = np.array([reference, own]) * np.sqrt([[shifts / few], [shifts / many]])
    wrong = order_error_probability(*noise, 1.0, ratio)
    return (-np.log1p(-wrong)).tolist()


def final_noise(noise, n, shifts):
    sigma = noise.sigma_rad[noise.fringes == n][0] / n
    return sqrt(np.mean(sigma**2) * noise.shifts / shifts)


def all_shares(sets, shifts, frames):
    """Every way to give each of the sets a number of shifts, within the frames."""
    if sets == 0:
        yield ()
        return
    least = min(shifts) * (sets - 1)
    for one in shifts:
        if one + least <= frames:
            for rest in all_shares(sets - 1, shifts, frames - one):
                yield (one, *rest)


def all_sequences(counts, shifts, frames):
    """Every ascending choice from one fringe with every number of shifts, within the frames."""
    for sets in range(1, len(counts) + 1):
        shares = list(all_shares(sets, shifts, frames))
        for rest in combinations(counts[1:], sets - 1):
            for each in shares:
                yield (counts[0], *rest), each


def by_brute_force(noise, counts, max_probability, shifts, frames):
    """The least final noise; of those the fewest frames; of those the least danger."""
    limit = -log1p(-max_probability)
    found = []
    for fringes, each in all_sequences(counts, shifts, frames):
        danger = danger_of(noise, fringes, each)
        if danger <= limit:
            # Digits beyond the twelfth are those of the order of multiplication.
            final = float(f"{final_noise(noise, fringes[-1], each[-1]):.12g}")
            found.append((final, sum(each), danger, fringes, each))
    return min(found)


def check_best(design, best, noise, max_probability):
    final, frames, danger, fringes, each = best
    assert design.frames == frames
    assert final_noise(noise, design.fringes[-1], design.shifts[-1]) == pytest.approx(final, 1e-11)
    # Others may be equally safe up to rounding, such as 1, 8, 80 and 1, 10, 80.
    own = danger_of(noise, design.fringes, design.shifts)
    assert own == pytest.approx(danger, rel=1e-9, abs=1e-300)
    if own != pytest.approx(danger, rel=1e-13):
        assert (design.fringes, design.shifts) == (fringes, each)
    assert design.order_error_probability <= max_probability * (1.0 + 1e-12)


COUNTS = [1, 2, 4, 5, 10, 20]


@pytest.mark.parametrize("max_probability", [1e-9, 1e-6, 1e-2])
@pytest.mark.parametrize("sigma", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("frames", [3, 5, 6, 9, 13])
def test_constant_noise(sigma, max_probability, frames):
    noise = PhaseNoise.constant(sigma, COUNTS)
    design = bounded_sequence(100, noise, COUNTS, max_probability=max_probability, frames=frames)
    best = by_brute_force(noise, COUNTS, max_probability, range(3, frames + 1), frames)
    check_best(design, best, noise, max_probability)
    assert design.frames <= frames
    # Without a budget: three shifts each, as many sets as serve and no more.
    design = bounded_sequence(100, noise, COUNTS, max_probability=max_probability)
    best = by_brute_force(noise, COUNTS, max_probability, [3], 3 * len(COUNTS))
    check_best(design, best, noise, max_probability)


@pytest.mark.parametrize("seed", range(12))
def test_noise_by_fringes_and_height(seed):
    rng = np.random.default_rng(seed)
    sigma = rng.uniform(0.02, 0.6, (len(COUNTS), 3))
    sigma[rng.integers(1, len(COUNTS)), 0] = np.inf  # one that cannot be measured
    noise = PhaseNoise(np.array(COUNTS), sigma, np.array([-1.0, 0.0, 1.0]), shifts=4)
    known = [n for n, row in zip(COUNTS, sigma, strict=True) if np.isfinite(row).all()]
    for frames, bound in ((7, 1e-2), (12, 1e-4), (14, 1e-6)):
        design = bounded_sequence(100, noise, COUNTS, max_probability=bound, frames=frames)
        best = by_brute_force(noise, known, bound, range(3, frames + 1), frames)
        check_best(design, best, noise, bound)
    # Without a budget: the shifts of the noise, as many sets as serve.
    design = bounded_sequence(100, noise, COUNTS, max_probability=1e-3)
    best = by_brute_force(noise, known, 1e-3, [4], 4 * len(known))
    check_best(design, best, noise, 1e-3)
    assert set(design.shifts) == {4}


def test_steps_at_risk_at_different_heights():
    """Each at its worst height they would make twice what any height has."""
    sigma = np.array([[0.14, 0.02], [0.02, 0.14], [0.02, 0.02]])
    noise = PhaseNoise(np.array([1, 4, 16]), sigma, np.array([0.0, 1.0]))
    own = predict(80, noise, (1, 4, 16)).order_error_probability
    assert own == pytest.approx(3.4e-7, rel=0.01)  # 2.1e-8 of Gaussian errors
    design = bounded_sequence(80, noise, [1, 4, 16], max_probability=1.2 * own)
    assert design.fringes == (1, 4, 16)
    assert sum(step.order_error_probability for step in design.steps) > 1.9 * own
    # Below what either height has, not.
    assert bounded_sequence(80, noise, [1, 4, 16], max_probability=0.99 * own).fringes != (1, 4, 16)


def test_a_worse_way_at_one_height_may_be_the_better_one():
    """The way that is the safest so far is not always the one to go on from."""
    kept = 0
    for seed in range(8):
        rng = np.random.default_rng(100 + seed)
        sigma = rng.uniform(0.05, 0.35, (len(COUNTS), 2))
        noise = PhaseNoise(np.array(COUNTS), sigma, np.array([0.0, 1.0]))
        design = bounded_sequence(100, noise, COUNTS, max_probability=1e-4, frames=12)
        best = by_brute_force(noise, COUNTS, 1e-4, range(3, 13), 12)
        check_best(design, best, noise, 1e-4)
        kept += len(design.fringes) > 2
    assert kept > 2


def test_the_brute_force_has_something_to_choose_from():
    # One set: 11 numbers of shifts.  Two: 5 choices, C(9, 2) ways to share 13 frames or fewer
    # beyond three each.  Three and four likewise: 10 C(7, 3) and 10 C(5, 4).
    assert len(set(all_sequences(COUNTS, range(3, 14), 13))) == 11 + 180 + 350 + 50
    lengths = {
        len(bounded_sequence(100, PhaseNoise.constant(s, COUNTS), COUNTS, frames=13).fringes)
        for s in (0.01, 0.1, 0.2, 0.3)
    }
    assert len(lengths) > 2


def test_of_equal_noise_the_fewest_frames_and_then_the_safest():
    # 1, 20 has 2e-7: 1, 10, 20 would be safer yet, for three frames more.
    noise = PhaseNoise.constant(0.03, [1, 10, 20])
    assert bounded_sequence(400, noise, [1, 10, 20]).fringes == (1, 20)
    # Twice the noise with twice the fringes: 1, 10 is as good as 1, 20, and safer.
    table = PhaseNoise(np.array([1, 10, 20]), np.array([[0.03], [0.02], [0.04]]), np.zeros(1))
    assert bounded_sequence(400, table, [1, 10, 20]).fringes == (1, 10)


def test_more_frames_are_spent_on_the_last_set_when_noise_is_constant():
    """All before only has to lead there safely, which three shifts each do here."""
    noise = PhaseNoise.constant(0.036, candidates(400))
    for frames in range(9, 25):
        design = bounded_sequence(400, noise, frames=frames)
        assert design.fringes[-1] == 80
        assert design.shifts == (3, 3, frames - 6)
        own = float(phase_deviation(0.036 * sqrt(3 / (frames - 6))))
        assert design.sigma_rad == pytest.approx(own / 80, rel=1e-9)


def test_more_frames_never_harm_and_a_looser_bound_neither():
    """Of what is minimised: the noise of pixels of the right order."""
    noise = PhaseNoise.constant(0.15, candidates(1024))

    def last(**options):
        design = bounded_sequence(1024, noise, **options)
        return final_noise(noise, design.fringes[-1], design.shifts[-1])

    by_frames = [last(frames=frames) for frames in range(3, 31)]
    assert by_frames == sorted(by_frames, reverse=True)
    assert by_frames[-1] < 0.02 * by_frames[0]
    by_bound = [last(frames=12, max_probability=p) for p in (1e-15, 1e-9, 1e-6, 1e-3, 0.1)]
    assert by_bound == sorted(by_bound, reverse=True)
    assert len(set(by_bound)) == 5


def test_the_bound_holds_and_is_used():
    for bound in (1e-12, 1e-6, 1e-3):
        for sigma in (0.05, 0.15, 0.4):
            noise = PhaseNoise.constant(sigma, candidates(400))
            design = bounded_sequence(400, noise, frames=12, max_probability=bound)
            assert design.order_error_probability <= bound
    # On either side of what 1, 2 has at 0.25 rad: 4e-5, where a Gaussian has 1.9e-8.
    noise = PhaseNoise.constant(0.25, [1, 2])
    own = predict(400, noise, (1, 2)).order_error_probability
    assert own == pytest.approx(3.9e-5, rel=0.03)
    for bound, fringes in ((1.01 * own, (1, 2)), (0.99 * own, (1,))):
        assert bounded_sequence(400, noise, [1, 2], max_probability=bound).fringes == fringes
    # Noise that no step survives leaves the first set, with all frames there are.
    noise = PhaseNoise.constant(2.0, [1, 2, 4])
    design = bounded_sequence(400, noise, [1, 2, 4], frames=7)
    assert (design.fringes, design.shifts) == ((1,), (7,))


def share_of_wrong(design, sigma, pixels=400_000, seed=4):
    """Simulated share of pixels with a wrong order in any step; noise over modulation."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((len(design.shifts), 2, pixels))
    error = [
        np.angle(1.0 + sigma * sqrt(3 / many) * (x + 1j * y))
        for many, (x, y) in zip(design.shifts, noise, strict=True)
    ]
    sets = zip(design.fringes, error, strict=True)
    wrong = [
        np.abs(n / before * reference - own) > pi
        for (before, reference), (n, own) in pairwise(sets)
    ]
    return float(np.mean(np.any(wrong, axis=0)))


@pytest.mark.parametrize("frames", [9, 12, 15])
@pytest.mark.parametrize("safety", [1.0, 1.5, 2.0])
def test_the_bound_holds_with_as_much_noise_as_it_was_made_for(safety, frames):
    """Where it binds; 4.5 standard errors, which chance exceeds in 3 of a million cases."""
    noise, told = (PhaseNoise.constant(level, candidates(1024)) for level in (0.4 / safety, 0.4))

    def designed(table, bound, factor):
        return bounded_sequence(1024, table, frames=frames, max_probability=bound, safety=factor)

    # The probability that the best sequence below a bound of 1e-2 has; that is then the bound.
    bound = designed(told, 1e-2, 1.0).order_error_probability * (1.0 + 1e-9)
    assert bound > 5e-4
    design = designed(noise, bound, safety)
    assert len(design.fringes) >= 2
    assert design.fringes[-1] >= designed(noise, bound * (1.0 - 1e-6), safety).fringes[-1]
    slack = 4.5 * sqrt(bound / 400_000)
    found = share_of_wrong(design, 0.4)
    # The product of the steps is a few per cent above.
    assert 0.9 * bound - slack < found < bound + slack
    # What is predicted is for the noise as given.
    assert share_of_wrong(design, 0.4 / safety) <= design.order_error_probability + slack
    if safety > 1.0:
        assert design.order_error_probability < 0.05 * bound
    else:
        assert design.order_error_probability == pytest.approx(bound)


def test_safety_is_more_noise_for_the_bound_alone():
    noise = PhaseNoise.constant(0.036, candidates(400))
    twice = PhaseNoise.constant(0.072, candidates(400))
    design = bounded_sequence(400, noise, safety=2.0)
    assert design.fringes == bounded_sequence(400, twice).fringes == (1, 4, 16, 80)
    assert design.sigma_rad == pytest.approx(float(phase_deviation(0.036)) / 80)
    assert bounded_sequence(400, noise).fringes == (1, 8, 80)


def test_progress_goes_up():
    told = []
    noise = PhaseNoise.constant(0.2, candidates(400))
    bounded_sequence(400, noise, frames=20, on_progress=lambda *stage: told.append(stage))
    shares = [share for _, share in told]
    assert {stage for stage, _ in told} == {"bounded"}
    assert shares == sorted(shares)
    assert 0.0 < shares[0] <= shares[-1] <= 1.0


def test_the_order_of_the_candidates_does_not_matter():
    noise = PhaseNoise.constant(0.036, candidates(400))
    expected = bounded_sequence(400, noise, [1, 10, 50])
    assert expected.fringes == (1, 10, 50)
    assert bounded_sequence(400, noise, [1, 50, 10, 10]).fringes == (1, 10, 50)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_probability": 0.0}, r"^max_probability: expected a number in \(0, 1\), got 0.0$"),
        ({"max_probability": 1.0}, r"^max_probability: expected a number in \(0, 1\), got 1.0$"),
        ({"max_probability": np.nan}, r"^max_probability: expected a number in \(0, 1\)"),
        ({"safety": 0.9}, "^safety: expected a number in .1, 1000., got 0.9$"),
        ({"safety": np.nan}, "^safety: expected a number in .1, 1000., got nan$"),
        ({"safety": np.inf}, "^safety: expected a number in .1, 1000., got inf$"),
        ({"frames": 2}, "^frames: expected a whole number from 3 to 100, got 2$"),
        ({"frames": 101}, "^frames: expected a whole number from 3 to 100, got 101$"),
        ({"frames": -9}, "^frames: expected a whole number from 3 to 100, got -9$"),
        ({"counts": [5, 10]}, "^phase noise: expected finite noise of 1 fringe"),
        ({"counts": []}, "^phase noise: expected finite noise of 1 fringe"),
        (
            {"counts": None, "width_px": 2},
            "^width_px: expected a whole number from 3 .*, got 2$",
        ),
    ],
)
def test_refuses_in_one_line(options, message):
    noise = PhaseNoise.constant(0.036, [1, 5, 10])
    with pytest.raises(InputError, match=message) as error:
        bounded_sequence(**({"width_px": 400, "noise": noise, "counts": [1, 5, 10]} | options))
    assert "\n" not in str(error.value)


def test_refuses_noise_without_one_fringe():
    sigma = np.array([[np.inf], [0.1]])
    noise = PhaseNoise(np.array([1, 2]), sigma, np.zeros(1))
    with pytest.raises(InputError, match=r"^phase noise: expected finite noise of 1 fringe"):
        bounded_sequence(400, noise, [1, 2])
