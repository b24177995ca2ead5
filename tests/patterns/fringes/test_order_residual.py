"""Masking by the residual of the fringe order: wrong orders removed against pixels masked."""

import numpy as np
import pytest
from photographed import photograph
from scipy.optimize import brentq
from scipy.stats import norm

from slbench.patterns import PatternSequence, decode

WIDTH, FRINGES, MODULATION, COLUMN = 480, 16, 20.0, 201.7
SEQUENCE = PatternSequence.parse(f"1,{FRINGES}@3", (WIDTH, 40))


def decoded(sigma_dn, limit, seed=0):
    """Decode a patch of one column whose noise may differ over the picture, (V, U)."""
    clean = photograph(SEQUENCE, {"u": np.full(sigma_dn.shape, COLUMN)}, b=MODULATION)
    frames = clean + np.random.default_rng(seed).standard_normal(clean.shape) * sigma_dn
    options = {"min_modulation": 0.0, "min_snr": 0.0}
    found = decode(frames.astype(np.float32), SEQUENCE, max_order_residual=limit, **options)
    wrong = np.abs(found.coordinate["u"] - COLUMN) > WIDTH / FRINGES / 2
    return found.mask, wrong & found.mask


def spread(sigma_dn):
    """Deviation of the order before it is rounded, turns, to first order."""
    return np.hypot(FRINGES, 1) * np.sqrt(2 / 3) * sigma_dn / MODULATION / (2 * np.pi)


def ideal(limit, s):
    """Share of pixels beyond a limit, and of those the share of wrong orders, in closed form.

    The order is Gaussian about a whole number: right where it rounds to zero.
    """
    k = np.arange(-6, 7)
    beyond = norm.cdf((k + 0.5) / s) - norm.cdf((k + limit) / s)
    beyond += norm.cdf((k - limit) / s) - norm.cdf((k - 0.5) / s)
    return beyond.sum(), beyond[k != 0].sum()


def limit_for(share, s):
    """Limit beyond which there is such a share of the wrong orders."""
    every = ideal(0.0, s)[1]
    return brentq(lambda limit: ideal(limit, s)[1] - share * every, 0.0, 0.5)


# Sigma of a frame such that one order in a hundred is wrong, and one in sixty.
@pytest.mark.parametrize(
    ("sigma_dn", "wrong_share", "cost"), [(1.864, 0.010, 0.062), (1.991, 0.016, 0.095)]
)
def test_the_cost_curve_is_the_ideal_one(sigma_dn, wrong_share, cost):
    s = spread(sigma_dn)
    assert ideal(0.0, s)[1] == pytest.approx(wrong_share, rel=0.01)
    assert ideal(limit_for(0.9, s), s)[0] == pytest.approx(cost, rel=0.02)
    noise = np.full((700, 700), sigma_dn)
    every, wrong = decoded(noise, 0.5)
    assert every.all()
    for share in (0.5, 0.8, 0.9, 0.95):
        limit = limit_for(share, s)
        kept, left = decoded(noise, limit)
        # First order in the noise (0.08 rad) leaves a few percent; 5,000 wrong orders scatter by
        # less than 0.01 of their share.
        assert 1 - kept.mean() == pytest.approx(ideal(limit, s)[0], rel=0.1)
        assert 1 - left.sum() / wrong.sum() == pytest.approx(share, abs=0.03)


def test_the_cost_is_small_where_few_pixels_are_noisy():
    # A dark tenth of the picture has all wrong orders, one in a hundred of all pixels.
    noise = np.full((700, 700), 0.3)
    noise[:70] = 2.88
    _, wrong = decoded(noise, 0.5)
    assert wrong.mean() == pytest.approx(0.01, rel=0.06)
    kept, left = decoded(noise, 0.21)
    assert left.sum() <= 0.1 * wrong.sum()
    assert 1 - kept.mean() < 0.05
    assert kept[70:].all()  # and the bright ones pay nothing


def test_what_the_usual_limit_costs():
    # The figures of the documentation: share of pixels, and of wrong orders, that 0.3 masks.
    s = spread(np.array([1.861]))[0]
    masked, removed = ideal(0.3, s)[0], ideal(0.3, s)[1] / ideal(0.0, s)[1]
    assert (round(masked, 2), round(removed, 2)) == (0.12, 0.97)
    assert ideal(0.3, 0.07)[0] < 2e-5  # a spread of 0.07 turn masks nothing
