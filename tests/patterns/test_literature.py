"""What the literature states of fringes, measured on frames whose truth is known."""

import numpy as np
import pytest

from slbench.patterns import PatternSequence, decode
from slbench.patterns.noise import NoiseModel

WIDTH = 912


@pytest.mark.parametrize(("shifts", "stated_rad"), [(3, 0.205), (4, 0.0075), (5, 0.0009)])
def test_harmonics_that_a_gamma_leaves(shifts, stated_rad):
    """Gamma 2.2 (K. Liu et al., J. Opt. Soc. Am. A 27, 2010): rms of the phase."""
    sequence = PatternSequence.parse(f"1@{shifts}", (WIDTH, 1))
    frames = 255.0 * sequence.images() ** 2.2
    found = decode(frames.astype(np.float64), sequence, min_modulation=0.0, min_snr=0.0)
    inside = found.mask[0]
    error = (found.coordinate["u"][0] - np.arange(WIDTH))[inside] * 2 * np.pi / WIDTH
    # Stated to its last digit.
    digits = len(str(stated_rad)) - 2
    assert round(float(np.sqrt(np.mean(error**2))), digits) == stated_rad


def test_ways_to_tell_orders_rank_in_noise():
    """Multi-frequency < number-theoretic < heterodyne (C. Zuo et al., Opt. Lasers Eng. 85, 2016).

    At as many frames and as many fringes of the finest set.  The spread of the order before it is
    rounded is the root of 16^2 + 1, 16^2 + 13^2 and 16^2 + 15^2 times that of a phase.
    """
    rng = np.random.default_rng(7)
    place = rng.uniform(30.0, WIDTH - 30.0, (400, 500))
    sigma, wrong = 0.07, {}
    noise_dn = 50.0 * sigma / np.sqrt(2.0 / 4.0)
    for text in ("1,16@4", "13,16@4", "15,16@4+heterodyne"):
        sequence = PatternSequence.parse(text, (WIDTH, 1))
        frames = []
        for part in sequence.parts:
            phase = 2.0 * np.pi * part.count * (place + 0.5) / WIDTH
            frames += [100.0 + 50.0 * np.cos(phase - k * np.pi / 2.0) for k in range(4)]
        noisy = np.array(frames) + rng.normal(0.0, noise_dn, (8, *place.shape))
        found = decode(
            *(noisy.astype(np.float32), sequence),
            noise=NoiseModel(step_dn=np.sqrt(12.0) * noise_dn),
            **{"max_order_residual": 0.5, "min_modulation": 0.0, "min_snr": 0.0},
        )
        wrong[text] = np.mean(np.abs(found.coordinate["u"] - place) > 0.5 * WIDTH / 16)
    multi, number, beat = wrong.values()
    # 200,000 pixels: shares of 0.6, 3 and 4 % are known to 3, 1.3 and 1.1 % of themselves.
    assert multi < 0.3 * number < 0.3 * 0.9 * beat
    for share, other in zip(wrong.values(), (1, 13, 15), strict=True):
        spread = np.hypot(16, other) * sigma / (2.0 * np.pi)
        # Of the Gaussian order beyond a half; phases of 0.07 rad have tails of a few percent more.
        assert share == pytest.approx(gaussian_beyond_half(spread), rel=0.12)


def gaussian_beyond_half(spread):
    """Probability that a Gaussian number of this deviation rounds to another than zero."""
    from scipy.stats import norm

    return 2.0 * norm.sf(0.5 / spread)
