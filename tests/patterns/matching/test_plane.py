"""Matching over the whole panel against all products of a small one."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from slbench.core.errors import InputWarning
from slbench.patterns import NoiseModel
from slbench.patterns.matching import plane
from slbench.patterns.matching.match import AMBIGUOUS
from slbench.patterns.matching.plane import match_plane

WIDTH, HEIGHT, FRAMES = 96, 64, 12


def shown(kind):
    rng = np.random.default_rng(1)
    if kind == "dots":
        return rng.integers(0, 2, (FRAMES + 12, HEIGHT, WIDTH)).astype(float)
    waves = np.array([gaussian_filter(rng.normal(size=(HEIGHT, WIDTH)), 3) for _ in range(FRAMES)])
    pictures = np.clip(0.5 + 0.2 * waves / waves.std(), 0.0, 1.0)
    if kind == "repeated":  # twice beside itself, the second half a little darker in one picture
        pictures[:, :, WIDTH // 2 :] = pictures[:, :, : WIDTH // 2]
        pictures[0, :, WIDTH // 2 :] *= 0.9
    return pictures


def captured(pictures, deviation, seed):
    """Frames of 1500 pixels of contrasts from nothing to 150 DN, and their places."""
    rng = np.random.default_rng(seed)
    u, v = rng.integers(0, WIDTH, 1500), rng.integers(0, HEIGHT, 1500)
    contrast = rng.choice([0.0, 10.0, 40.0, 150.0], 1500)
    frames = 30.0 + contrast * pictures[:, v, u]
    return u, v, contrast, frames + rng.normal(0.0, deviation, frames.shape)


@pytest.mark.parametrize("kind", ["waves", "dots", "repeated"])
@pytest.mark.parametrize("deviation", [0.5, 3.0, 12.0])
def test_best_place_and_doubt_are_those_of_all_products(kind, deviation):
    pictures = shown(kind)
    u, v, contrast, frames = captured(pictures, deviation, 2)
    noise = NoiseModel(read_dn=deviation, step_dn=0.0)
    found = match_plane(frames, pictures, noise)
    about = pictures.reshape(len(pictures), -1)
    about = about - about.mean(axis=0)
    unit = about / np.maximum(np.linalg.norm(about, axis=0), 1e-12)
    own = frames - frames.mean(axis=0)
    power = np.sum(own**2, axis=0)
    scores = (own / np.sqrt(power)).T @ unit
    best, top = scores.argmax(axis=1), scores.max(axis=1)
    rows, columns = np.divmod(np.arange(unit.shape[1]), WIDTH)
    seen = np.isfinite(found.coordinate[0])
    # Products of float32 vectors are right to 1e-6.
    np.testing.assert_allclose(found.correlation[seen], top[seen], atol=3e-6)
    for p in range(len(u)):
        elsewhere = 0.0
        if seen[p]:
            away = np.clip(4.0 * found.sigma[:, p], 2.0, 8.0)
            far = (abs(columns - columns[best[p]]) > away[0]) | (
                abs(rows - rows[best[p]]) > away[1]
            )
            doubt = np.fmax(deviation**2, found.residual_dn[p] ** 2)
        else:  # the noise alone, and the farthest that a neighbour may be
            far = (abs(columns - columns[best[p]]) > 8) | (abs(rows - rows[best[p]]) > 8)
            doubt = deviation**2
        elsewhere = scores[p, far].max(initial=0.0)
        margin = power[p] * (top[p] ** 2 - max(elsewhere, 0.0) ** 2) - AMBIGUOUS * doubt
        if abs(margin) > 1e-4 * power[p]:
            # What was not found is too unlike all places, or in doubt.
            assert found.sure[p] == (margin > 0.0) if seen[p] else margin < 0 or top[p] < 0.83
    bright = contrast == 150.0
    if deviation == 0.5 and kind != "repeated":
        assert found.sure[bright].mean() > 0.99
        # Dots are whole pixels; waves of ten pixels and 30 DN are known to a twentieth.
        assert np.abs(found.coordinate[0] - u)[bright & found.sure].max() < 0.5
        assert np.abs(found.coordinate[1] - v)[bright & found.sure].max() < 0.5
    if kind == "repeated" and deviation == 12.0:
        assert not found.sure.any()
    assert not found.sure[contrast == 0.0].any()


def test_too_dark_pixels_are_not_looked_for():
    pictures = shown("waves")
    _, _, contrast, frames = captured(pictures, 0.1, 3)
    noise = NoiseModel(read_dn=0.1, step_dn=0.0)
    # The dullest place has less contrast than the others by some factor.
    found = match_plane(frames, pictures, noise, 150.0)
    assert np.isnan(found.coordinate[:, contrast <= 10.0]).all()
    assert np.isfinite(found.coordinate[:, contrast == 150.0]).mean() > 0.95


def test_a_long_search_says_so_before_it_begins(monkeypatch):
    pictures = shown("waves")
    _, _, _, frames = captured(pictures, 0.5, 4)
    monkeypatch.setattr(plane, "_LONG_S", 0.0)
    with pytest.warns(InputWarning, match="decode: matching: 1500 pixels among 6144 of the panel"):
        match_plane(frames, pictures, NoiseModel(read_dn=0.5))
