"""Line spread: analytic limits, the pupil's own autocorrelation, and the tables."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import j0, j1

from slbench.rig import Camera, Lens
from slbench.rig.optics.spread import RING_SOFTENING, Spread, hopkins

SPREADS = [
    Spread(),
    Spread(0.0, 1.0),
    Spread(0.0, 3.0),
    Spread(0.3, 0.0),
    Spread(1.5, 0.5),
    Spread(10.0, 1.0),
    Spread(25.0, 0.0),
]
CIRCLES = [0.0, 0.5, 2.0, 5.0, 10.0, 24.0, 100.0]
FREQUENCIES = np.array([1 / 300, 1 / 100, 1 / 40, 1 / 20, 1 / 13, 1 / 8, 1 / 5])


def test_in_focus_is_the_aberration_free_lens():
    s = np.linspace(0.0, 2.2, 23)
    inside = np.clip(s / 2.0, 0.0, 1.0)
    expected = 2.0 / np.pi * (np.arccos(inside) - inside * np.sqrt(1.0 - inside**2))
    np.testing.assert_allclose(hopkins(s, 0.0), expected, atol=1e-12)


@pytest.mark.parametrize("waves", [0.1, 0.25, 0.7, 2.0, 5.0])
def test_out_of_focus_is_the_pupils_autocorrelation(waves):
    """By FFT: a pupil of 256 samples across, in an array that leaves room for its shifts."""
    n, radius = 1024, 128
    y, x = np.mgrid[-n // 2 : n // 2, -n // 2 : n // 2] / radius
    rho2 = x * x + y * y
    # Soft by a sample at the rim, which a sharp grid would be off by.
    pupil = np.clip((1.0 - np.sqrt(rho2)) * radius + 0.5, 0.0, 1.0)
    pupil = pupil * np.exp(2j * np.pi * waves * rho2)
    intensity = np.abs(np.fft.fft2(pupil)) ** 2
    transfer = np.fft.fft2(intensity).real
    transfer /= transfer[0, 0]
    shifts = np.arange(0, 250, 10)
    # The sampled rim, and five waves change by a tenth of a period a sample there.
    expected = hopkins(shifts / radius, waves)
    np.testing.assert_allclose(transfer[0, shifts], expected, atol=3e-3)


def test_a_short_wavelength_is_geometric():
    frequency, circle = np.meshgrid(FREQUENCIES, [2.0, 5.0, 12.0])
    x = np.pi * frequency * circle
    np.testing.assert_allclose(Spread().contrast(frequency, circle), 2.0 * j1(x) / x, atol=1e-12)
    # The correction is of the order of the frequency in units of diffraction.
    near = Spread(0.01).contrast(frequency, circle)
    np.testing.assert_allclose(near, 2.0 * j1(x) / x, atol=2e-3)


def test_the_airy_disc():
    """83.8 % of the light lies within 0.61 lambda / NA, half of it within 0.27."""
    spread = Spread(10.0)
    assert spread.radius(0.0, 0.838) == pytest.approx(6.1, rel=0.03)
    # 1 - J0(x)^2 - J1(x)^2 = 1/2 at x = 1.681; over 2 pi.
    assert spread.radius(0.0) == pytest.approx(10.0 * 1.681 / (2 * np.pi), rel=0.01)


@pytest.mark.parametrize("spread", SPREADS, ids=str)
@pytest.mark.parametrize("circle", CIRCLES)
def test_tables_are_the_transfer_function(spread, circle):
    """The tables' own Fourier and Hankel transforms, within 1 %."""
    expected = spread.contrast(FREQUENCIES, circle)
    disc = 0.5 * circle

    lines = spread.lines()
    rows, places = lines.values.shape
    reach = disc + lines.edge
    light = lines.values[round(disc / reach * (rows - 1))].astype(float)
    assert light[0] == pytest.approx(0.0, abs=1e-12)
    assert light[-1] == pytest.approx(0.5, abs=1e-6)
    assert np.all(np.diff(light) >= 0.0)
    step = reach / (places - 1)
    middles = (np.arange(places - 1) + 0.5) * step
    waves = (
        np.cos(2 * np.pi * np.outer(FREQUENCIES, middles)) * np.sinc(FREQUENCIES * step)[:, None]
    )
    np.testing.assert_allclose(waves @ (2.0 * np.diff(light)), expected, atol=0.01)

    rings = spread.rings()
    rows, places = rings.values.shape
    reach = disc + rings.edge
    energy = (np.arange(20000) + 0.5) / 20000
    row = rings.values[round(disc / reach * (rows - 1))]
    scaled = np.interp(np.sqrt(energy) * (places - 1), np.arange(places), row)
    radius = scaled * reach / (1.0 - energy + RING_SOFTENING)
    waves = j0(2 * np.pi * np.outer(FREQUENCIES, radius)).mean(axis=1)
    np.testing.assert_allclose(waves, expected, atol=0.012)
    assert np.median(radius) == pytest.approx(float(spread.radius(circle)), rel=0.03, abs=0.02)


@settings(max_examples=30, deadline=None)
@given(
    na=st.floats(0.02, 0.2),
    blur=st.floats(0.0, 3.0),
    pitch_um=st.floats(0.5, 10.0),
)
def test_depth_of_field(na, blur, pitch_um):
    """Geometric without other spread; never less with it, and continuous."""
    lens = Lens(20.0, 20.0 * np.tan(np.arcsin(na)), 20.0)
    bare = Camera(100, 100, (pitch_um / 1e3, pitch_um / 1e3), lens)
    assert bare.spread.circle(2.0) == 2.0
    near, far = bare.depth_of_field(2.0)
    reach = 2.0 * pitch_um / 1e3 / (2.0 * lens.aperture_radius_mm * 20.0)
    assert near == pytest.approx(1.0 / (1.0 / 20.0 + reach))
    assert far > 20.0 > near
    spread = Spread(0.55 / np.tan(np.arcsin(na)) / pitch_um, blur)
    accepted = spread.circle(2.0)
    assert accepted > 1.5
    grown = float(spread.radius(accepted))
    wanted = np.hypot(2.0 / np.sqrt(8.0), float(spread.radius(0.0)))
    assert grown == pytest.approx(wanted, rel=0.03)
    # The quarter of a wave that Rayleigh allows: a disc of one unit of diffraction in diameter.
    if blur == 0.0 and spread.diffraction_px > 10.0:
        assert accepted < 2.0 * spread.diffraction_px
