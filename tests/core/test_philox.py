"""Counter-based normal numbers: the published words, the normal distribution, independence.

Bounds of statistics are five standard errors (6e-7 a comparison if all is well; seeds are fixed),
those of Kolmogorov and Smirnov's statistic 2.7 / sqrt(n), which is as rare.
"""

import itertools

import numpy as np
import pytest
from scipy import stats

from slbench.core.philox import BLOCK, normal, normal_block, philox, work_space

# Of Random123's kat_vectors: counter, key, words.
KNOWN = [
    ("00000000 " * 4, "00000000 " * 2, "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff " * 4, "ffffffff " * 2, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    (
        "243f6a88 85a308d3 13198a2e 03707344",
        "a4093822 299f31d0",
        "d16cfe09 94fdcceb 5001e420 24126ea1",
    ),
]
MANY = 10_000_000
#: Distances within a block (a lane is 256), and beyond it.
LAGS = (1, 2, 255, 256, 257, 512, 768, BLOCK, BLOCK + 1, 640 * 480)


def numbers(text):
    return np.array([int(word, 16) for word in text.split()], np.uint32)


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_words_are_those_of_random123(counter, key, words):
    one, two, three, four = numbers(counter)
    out = np.empty((4, 1), np.uint32)
    first = np.uint64(int(one) | int(two) << 32)
    philox(numbers(key), first, three, four, out)
    np.testing.assert_array_equal(out[:, 0], numbers(words))


def test_counts_carry_into_the_second_word():
    key, both, alone = np.array([3, 5], np.uint32), np.empty((4, 2), np.uint32), []
    philox(key, np.uint64(0xFFFFFFFF), 7, 9, both)
    for first in (0xFFFFFFFF, 1 << 32):
        alone.append(np.empty((4, 1), np.uint32))
        philox(key, np.uint64(first), 7, 9, alone[-1])
    np.testing.assert_array_equal(both, np.hstack(alone))


def test_transform_is_that_of_box_and_muller():
    """Against double precision."""
    key, size = np.array([11, 12], np.uint32), BLOCK // 4
    words = np.empty((4, size), np.uint32)
    philox(key, np.uint64(3 * size), 0, 0, words)
    out = np.empty(BLOCK, np.float32)
    normal_block(key, 0, 3, work_space(), out)
    wanted = []
    for radius, angle in (words[:2], words[2:]):
        length = np.sqrt(-2.0 * np.log(((radius >> 1) + 0.5) * 2.0**-31))
        turn = angle.astype(float) * (2.0 * np.pi / 2.0**32)
        wanted += [length * np.cos(turn), length * np.sin(turn)]
    # Near a share of 1 single precision keeps 24 bits of it: radii of 0.01 are off by 3e-6.
    np.testing.assert_allclose(out, np.concatenate(wanted), rtol=0, atol=5e-6)


@pytest.mark.parametrize("word", [0, 1, 2, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF])
def test_extreme_words_give_finite_numbers(word):
    from slbench.core.philox import _pairs

    words = np.full(8, word, np.uint32)
    angles = np.arange(8, dtype=np.uint32) << np.uint32(29)
    cosine, sine, work = (np.empty(8, np.float32) for _ in range(3))
    _pairs(words, angles, cosine, sine, work)
    radius = np.sqrt(max(-2.0 * np.log(((word >> 1) + 0.5) * 2.0**-31), 0.0))
    turn = angles.astype(float) * (2.0 * np.pi / 2.0**32)
    # 2^-25 of the share is lost where it rounds to 1, and a radius of 2^-12 with it.
    np.testing.assert_allclose(cosine, radius * np.cos(turn), atol=3e-4 if radius < 0.01 else 2e-6)
    np.testing.assert_allclose(sine, radius * np.sin(turn), atol=3e-4 if radius < 0.01 else 2e-6)


def test_a_number_depends_on_its_place_alone():
    whole = normal([1, 2], 5 * BLOCK)
    np.testing.assert_array_equal(normal([1, 2], 3 * BLOCK + 17), whole[: 3 * BLOCK + 17])
    alone = np.empty(BLOCK, np.float32)
    normal_block(np.array([1, 2], np.uint32), 0, 4, work_space(), alone)
    np.testing.assert_array_equal(alone, whole[4 * BLOCK :])


def hold_to_the_normal_distribution(drawn):
    n = drawn.size
    values = drawn.astype(np.float64)
    for power, moment in ((1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0), (6, 15.0)):
        of_square = float(stats.norm.moment(2 * power))
        assert abs(np.mean(values**power) - moment) < 5.0 * np.sqrt((of_square - moment**2) / n)
    assert stats.kstest(values, "norm").statistic < 2.7 / np.sqrt(n)
    for edge in (3.0, 4.0, 4.5):
        expected = 2.0 * n * stats.norm.sf(edge)
        least, most = stats.poisson.interval(1.0 - 6e-7, expected)
        assert least <= np.count_nonzero(np.abs(values) > edge) <= most


def hold_to_independence(first, second):
    n = first.size
    for power, deviation in ((1, 1.0), (2, np.sqrt(2.0))):
        one, two = (
            (values**power - (power == 2)) / deviation
            for values in (first.astype(np.float64), second.astype(np.float64))
        )
        assert abs(np.mean(one * two)) < 5.0 / np.sqrt(n)


def test_numbers_are_normal():
    hold_to_the_normal_distribution(normal([20, 26], 1 << 19))


@pytest.mark.slow
def test_ten_million_numbers_are_normal():
    hold_to_the_normal_distribution(normal([8, 9], MANY))


def test_numbers_are_independent_of_their_neighbours_streams_and_keys():
    size = 1 << 20
    drawn = normal([4, 0], size)
    for lag in LAGS:
        hold_to_independence(drawn[lag:], drawn[:-lag])
    others = [normal([4, 0], size, 1), normal([5, 0], size), normal([4, 1], size)]
    for one, two in itertools.combinations([drawn, *others], 2):
        hold_to_independence(one, two)


def test_pairs_have_radius_and_angle_of_a_plane():
    lanes = normal([6, 6], 1 << 19).reshape(-1, 4, BLOCK // 4).astype(np.float64)
    cosine, sine = lanes[:, 0::2].ravel(), lanes[:, 1::2].ravel()
    bound = 2.7 / np.sqrt(cosine.size)
    assert stats.kstest((cosine**2 + sine**2) / 2.0, "expon").statistic < bound
    turns = np.arctan2(sine, cosine) / (2.0 * np.pi) + 0.5
    assert stats.kstest(turns, "uniform").statistic < bound
