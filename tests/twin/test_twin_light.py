"""Brightness and sharpness fitted to frames."""

import numpy as np
import pytest

from slbench.rig.optics.shading import shading
from slbench.twin.light import fit_blur, fit_light

SIZE = (64, 48)


def frames_of(gain, coefficients, ambient, black, *, albedo=True, seed=0, noise=0.0, wrong=0.0):
    """Return frames that are exactly what the fit takes for granted, and what it is given."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    pixels = np.stack((u.ravel(), v.ravel()), axis=1)
    bright = np.where(pixels[:, 0] > 30, 0.85, 0.3) if albedo else np.full(len(pixels), 0.8)
    phase = 0.2 * pixels[:, 0]
    radiance = np.stack([bright * (1.0 + np.cos(phase - e)) for e in (0.0, 1.0, 2.5, 4.0)])
    field = shading(coefficients, pixels, SIZE)
    frames = gain * field * (radiance + ambient * bright) + black
    frames = frames + rng.normal(0.0, noise, frames.shape)
    lost = rng.random(frames.shape) < wrong
    frames[lost] += rng.uniform(0.0, 80.0, lost.sum())
    return frames, np.ones_like(frames), radiance, bright, pixels, SIZE, 2.0


@pytest.mark.parametrize("wrong", [0.0, 0.1])
def test_gain_shading_ambient_light_and_black_level_are_found(wrong) -> None:
    given = (0.02, -0.01, -0.2, 0.05, -0.1)
    found = fit_light(*frames_of(70.0, given, 0.3, 4.0, noise=0.5, wrong=wrong))
    # 12,000 values of a noise of 0.5 DN.
    assert found.gain == pytest.approx(70.0, rel=2e-3)
    assert found.shading == pytest.approx(given, abs=3e-3)
    assert found.ambient == pytest.approx(0.3, rel=0.02)
    assert found.black_dn == pytest.approx(4.0, abs=0.2)


def test_what_is_not_there_is_not_fitted() -> None:
    found = fit_light(*frames_of(70.0, (), 0.0, 0.0, noise=0.5))
    assert found.shading == ()
    assert found.black_dn == 0.0
    assert found.ambient == pytest.approx(0.0, abs=1e-3)


def test_a_plain_surface_does_not_tell_ambient_light_from_black() -> None:
    found = fit_light(*frames_of(70.0, (), 0.2, 0.0, albedo=False, noise=0.5))
    assert found.black_dn == 0.0
    assert found.ambient == pytest.approx(0.2, rel=0.01)


def test_blur_is_what_contrast_loses() -> None:
    cycles = np.array([0.002, 0.05, 0.1])
    kept = 0.97 * np.exp(-2.0 * (np.pi * 0.8 * cycles) ** 2)
    assert fit_blur(cycles, kept) == pytest.approx(0.8, rel=1e-2)
    assert fit_blur(cycles[2:], kept[2:] / 0.97) == pytest.approx(0.8, rel=1e-6)
    assert fit_blur(cycles, [1.0, 1.0, 1.01]) == 0.0  # the photographs are sharper
    assert fit_blur([], []) == 0.0
