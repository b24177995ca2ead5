"""Patterns of several projectors at the same time: what tells them apart, and what does not."""

from math import gcd

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.patterns import PatternSequence, decode
from slbench.patterns.multiplexing import multiplexed_orders

PANEL = (640, 480)


def totient(n):
    return sum(gcd(f, n) == 1 for f in range(1, n + 1))


@pytest.mark.parametrize("shifts", range(3, 33))
def test_there_are_half_as_many_orders_as_numbers_coprime_to_the_shifts(shifts):
    sequence = PatternSequence.parse(f"1@{shifts}", PANEL)
    orders = multiplexed_orders(sequence, totient(shifts) // 2)
    assert len({tuple(order) for order in orders}) == len(orders)
    for order in orders:
        assert sorted(order) == list(range(shifts))
    with pytest.raises(InputError, match="fringes of equal shifts"):
        multiplexed_orders(sequence, totient(shifts) // 2 + 1)


@pytest.mark.parametrize(("shifts", "count"), [(5, 2), (7, 3), (8, 2), (9, 3), (12, 2), (13, 6)])
def test_each_projector_is_decoded_as_if_it_were_alone(shifts, count):
    """Pixels that see places of their own on each panel, at strengths of their own."""
    sequence = PatternSequence.parse(f"1,8@{shifts}", PANEL)
    rng = np.random.default_rng(3)
    places = rng.uniform(10.0, 630.0, (count, 30, 40))
    strength = rng.uniform(20.0, 60.0, (count, 30, 40))
    orders = multiplexed_orders(sequence, count)
    pictures = np.zeros((sequence.n_frames, 30, 40))
    for place, strong, order in zip(places, strength, orders, strict=True):
        turns = (place + 0.5) / 640 * np.array([1.0, 8.0])[:, None, None]
        shift = np.arange(shifts)[:, None, None] / shifts
        own = [0.5 + 0.5 * np.cos(2.0 * np.pi * (one - shift)) for one in turns]
        pictures[order] += strong * np.concatenate(own)
    for place, strong, order in zip(places, strength, orders, strict=True):
        found = decode(pictures[order], sequence)
        assert found.mask.all()
        np.testing.assert_allclose(found.coordinate["u"], place, atol=1e-8)
        # Each keeps its own modulation; the background is that of all.
        np.testing.assert_allclose(found.modulation, 0.5 * strong, atol=1e-9)
        np.testing.assert_allclose(found.mean, 0.5 * strength.sum(axis=0), atol=1e-9)


def test_the_first_projector_shows_the_sequence_as_it_is():
    sequence = PatternSequence.parse("1,10@7,50@5", PANEL, axes="uv")
    first, second = multiplexed_orders(sequence, 2)
    assert first.tolist() == list(range(sequence.n_frames))
    # Sets stay where they are, the shifts of each change places.
    assert second[:7].tolist() == [0, 4, 1, 5, 2, 6, 3]
    assert sorted(second[14:19]) == [14, 15, 16, 17, 18]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,10@3", "5 or another number that tells 2 projectors"),
        ("1,10@6", "5 or another number"),
        ("gray+16@8", "fringes of equal shifts"),
        ("white+1,10@5", "fringes of equal shifts"),
        ("1,16@0/90/180", "fringes of equal shifts"),
        ("1,16@6+rgb", "colour patterns"),
    ],
)
def test_what_is_not_told_apart_is_refused_with_the_reason(text, words):
    with pytest.raises(InputError) as error:
        multiplexed_orders(PatternSequence.parse(text, PANEL), 2)
    assert words in str(error.value)
