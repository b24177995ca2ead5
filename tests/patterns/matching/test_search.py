"""The search of all places against a plain loop, in whole numbers: ties included."""

import numpy as np
import pytest

from slbench.patterns.kernels.matching import NEAR, padded, search


def plain(pixels, basis, first, last):
    """Best place, its score and that of the best place beyond its peak, pixel by pixel."""
    found = []
    about = pixels - pixels.mean(axis=0)
    parts = np.einsum("xjn,np->jxp", basis.astype(float), about)
    scores = np.sum(np.maximum(parts, 0.0) ** 2, axis=0)
    for p in range(pixels.shape[1]):
        here = scores[first[p] : last[p] + 1, p]
        best = left = right = int(here.argmax())
        while left > 0 and here[left - 1] <= here[left]:
            left -= 1
        while right < len(here) - 1 and here[right + 1] <= here[right]:
            right += 1
        before = here[: max(min(left, best - NEAR), 0)]
        after = here[max(right, best + NEAR) + 1 :]
        found.append(
            (first[p] + best, here[best], max(before.max(initial=0.0), after.max(initial=0.0)))
        )
    return [np.array(column) for column in zip(*found, strict=True)]


def whole(rng, places, vectors, frames, count):
    """A basis and zero-mean frames of small whole numbers, whose scores are exact in float32."""
    # A walk over places is smooth in part, and has equal neighbours.
    basis = rng.integers(-1, 2, (places, vectors, frames)).cumsum(axis=0) % 7 - 3
    pixels = rng.integers(-9, 10, (frames, count)) * frames
    return basis.astype(np.float32), (pixels - pixels.sum(axis=0) // frames).astype(np.float32)


def searched(pixels, basis, first, last):
    count = pixels.shape[1]
    found = np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.float32)
    ends = [ends.astype(np.int32) for ends in (first, last)]
    search(pixels, padded(basis), NEAR, *ends, *found, 0, count)
    return found


@pytest.mark.parametrize("places", [2, 5, 8, 203, 256])
@pytest.mark.parametrize(("vectors", "frames"), [(1, 3), (1, 4), (2, 9), (3, 10)])
@pytest.mark.parametrize("limits", ["none", "some", "narrow"])
def test_search_is_that_of_a_plain_loop(places, vectors, frames, limits):
    rng = np.random.default_rng(places * frames)
    count = 150  # two blocks and a part of one
    basis, pixels = whole(rng, places, vectors, frames, count)
    basis[rng.random(places) < 0.1] = 0.0  # places that show the same in all frames
    pixels[:, ::50] = 4.0  # and pixels that see the same
    first, last = np.zeros(count, int), np.full(count, places - 1)
    if limits != "none":
        ends = rng.integers(0, places, (2, count))
        limited = slice(None) if limits == "narrow" else rng.random(count) < 0.3
        first[limited], last[limited] = ends.min(axis=0)[limited], ends.max(axis=0)[limited]
    for mine, expected in zip(
        searched(pixels, basis, first, last), plain(pixels, basis, first, last), strict=True
    ):
        np.testing.assert_array_equal(mine, expected)


def test_pixels_without_a_number_find_nothing():
    rng = np.random.default_rng(1)
    basis, pixels = whole(rng, 64, 1, 4, 70)
    pixels[2, 10] = np.nan
    ends = np.zeros(70, int), np.full(70, 63)
    best, energy, rival = searched(pixels, basis, *ends)
    assert not energy[10] > rival[10]
    others = np.arange(70) != 10
    expected = plain(pixels[:, others], basis, *(one[others] for one in ends))
    np.testing.assert_array_equal(best[others], expected[0])
    np.testing.assert_array_equal(rival[others], expected[2])
