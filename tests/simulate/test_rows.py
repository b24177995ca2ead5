"""Sparse rows of footprints against their integrals, worked out one by one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench.rig.optics.spread import Spread
from slbench.simulate.footprints import Levels
from slbench.simulate.rows import LineRows, PointRows, SampleBlock

SIZE = (240, 160)

SPREADS = {
    "geometric": Spread(),
    "blurred": Spread(0.0, 1.0),
    "diffracted": Spread(3.0, 0.0),
    "all": Spread(1.5, 0.7),
}


def block(pixels=60, samples=8, largest=12.0, seed=0, hidden=0.0, least=0.0, size=SIZE, within=0.2):
    """Return random samples a few panel pixels apart within each camera pixel."""
    rng = np.random.default_rng(seed)
    shape = (pixels, samples)
    axes = {}
    for k, length in enumerate(size):
        places = rng.uniform(0.3 * length, 0.7 * length, (pixels, 1)) + rng.uniform(0, 2, shape)
        circles = rng.uniform(least, max(least, largest), (pixels, 1)) + rng.uniform(
            0.0, within, shape
        )
        if largest == 0.0:
            circles = np.zeros(shape)
        shifts = circles * rng.uniform(-0.8, 0.8, shape)
        axes[k] = tuple(a.astype(np.float32) for a in (places, shifts, circles))
    weights = rng.uniform(0.5, 1.0, shape).astype(np.float32) / samples
    weights[rng.random(shape) < 0.1] = 0.0
    weights[rng.random(shape) < hidden] *= -1.0
    return SampleBlock(weights, axes, 1.0 / np.sqrt(samples / 2), samples)


def expected(given, spread, frequency):
    """Return what pixels see of a sinusoid, complex, by the transfer function itself."""
    places, shifts, circles = (a.astype(float) for a in given.axes[0])
    whole = np.all(given.weights >= 0, axis=1, keepdims=True)
    places = np.where(whole, places, places + shifts)
    circles = np.where(whole, circles, circles * given.share)
    passed = spread.contrast(frequency, 2.0 * circles) * np.sinc(frequency)
    kept = np.maximum(given.weights, 0.0)
    return np.sum(kept * passed * np.exp(2j * np.pi * frequency * places), axis=1), kept.sum(axis=1)


def seen(rows, frequency, size=SIZE[0]):
    """Return what rows see of it."""
    matrix = rows.tocsr()
    wave = np.exp(2j * np.pi * frequency * np.arange(size))
    return matrix @ wave, matrix @ np.ones(size)


@pytest.mark.parametrize("hidden", [0.0, 0.3])
@pytest.mark.parametrize("name", SPREADS)
def test_lines_are_the_transfer_function(name, hidden):
    spread = SPREADS[name]
    # Discs small enough to stay on the panel, and too large for the finest fringes.  Without any
    # other spread smaller ones would leave the panel pixels' steps, which are no sinusoid.
    given = block(hidden=hidden, seed=3, least=3.0 if name == "geometric" else 0.0)
    levels, across = (Levels(spread, size) for size in SIZE)
    rows = LineRows(levels, across, 0)
    rows.add(given)
    result = rows.result()
    for frequency in (1 / 100, 1 / 40, 1 / 16, 1 / 8):
        wave, light = seen(result, frequency)
        wanted, white = expected(given, spread, frequency)
        np.testing.assert_allclose(light, white, rtol=2e-6, atol=2e-6)
        # Levels of 1.5 %, nodes, and where the tail of diffraction is laid: each below 0.5 %.
        np.testing.assert_allclose(wave, wanted, atol=0.01)
        assert np.abs(wave - wanted).mean() < 0.005


def test_pixels_without_any_spread_are_squares():
    given = block(largest=0.0)
    levels, across = (Levels(Spread(), size) for size in SIZE)
    rows = LineRows(levels, across, 0)
    rows.add(given)
    matrix = rows.result().tocsr().toarray()
    columns = np.floor(given.axes[0][0] + 0.5).astype(int)
    wanted = np.zeros((len(columns), SIZE[0]))
    np.add.at(wanted, (np.arange(len(columns))[:, None], columns), given.weights)
    np.testing.assert_allclose(matrix, wanted, atol=1e-7)


def test_points_are_the_transfer_function_in_two_dimensions():
    given = block(pixels=40, samples=16, largest=6.0)
    spread = SPREADS["all"]
    given.axes[1][2][:] = given.axes[0][2]
    rows = PointRows(spread, SIZE, 1.0)
    rows.add(given)
    matrix = rows.result().tocsr()
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    for nu, nv in ((1 / 40, 0.0), (0.0, 1 / 30), (1 / 50, 1 / 40)):
        wave = matrix @ np.exp(2j * np.pi * (nu * u + nv * v)).ravel()
        (places_u, _, circles), (places_v, _, _) = given.axes[0], given.axes[1]
        passed = spread.contrast(np.hypot(nu, nv), 2.0 * circles) * np.sinc(nu) * np.sinc(nv)
        phase = np.exp(2j * np.pi * (nu * places_u + nv * places_v))
        wanted = np.sum(given.weights * passed * phase, axis=1)
        # 16 samples of 32 points each, stratified, and 0.4 % of the light laid elsewhere.
        np.testing.assert_allclose(wave, wanted, atol=0.02)
        assert np.abs(wave - wanted).mean() < 0.01


@settings(max_examples=25, deadline=None)
@given(
    samples=st.sampled_from([2, 4, 6, 16, 40]),
    bounces=st.integers(1, 2),
    name=st.sampled_from(sorted(SPREADS)),
    axis=st.integers(0, 1),
    seed=st.integers(0, 1000),
)
def test_blocks_halves_and_order(samples, bounces, name, axis, seed):
    """Blocks stack; rows are sorted; the halves' difference is that of either half's rows."""
    spread = SPREADS[name]
    # Discs of one size within a pixel: a half on its own is laid on the level of all.
    parts = [
        block(7, samples * bounces, largest, seed + n, within=0.0)
        for n, largest in enumerate((0.5, 9.0))
    ]
    parts = [part._replace(bounce=samples) for part in parts]
    levels = [Levels(spread, size) for size in SIZE]

    def rows_of(blocks):
        rows = LineRows(levels[axis], levels[1 - axis], axis)
        for part in blocks:
            rows.add(part)
        return rows.result()

    whole = rows_of(parts)
    for p in range(14):
        entries = whole.indices[whole.indptr[p] : whole.indptr[p + 1]].astype(int)
        assert np.all(np.diff(entries) > 0)
    assert whole.indices.max(initial=0) < whole.width
    first = np.arange(samples * bounces) % samples < samples // 2
    halves = [
        rows_of([part._replace(weights=np.where(kept, part.weights, 0.0)) for part in parts])
        for kept in (first, ~first)
    ]
    one, two = (rows.tocsr().toarray() for rows in halves)
    np.testing.assert_allclose(whole.tocsr().toarray(), one + two, atol=1e-6)
    odd = replace(whole, data=whole.differences).tocsr().toarray()
    np.testing.assert_allclose(odd, one - two, atol=1e-6)
