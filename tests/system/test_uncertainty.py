"""Does the noise that is predicted cover the noise that comes?  Repeats of one transport.

Coverage is about noise, so its centre is what the scan gives without noise, which differs from
the truth by the renderer's floor (the projector's square pixels: some 0.06 px).
"""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small, transport_of, truth_of
from stages import capture, floor_rms_px, noise_free_coordinates

from slbench.cloud.triangulation import triangulate
from slbench.detector.emva1288 import Detector

REPEATS = 24
CASES = [("plane", "u", 3), ("plane", "v", 5), ("plane", "uv", 3), ("step-block", "u", 4)]
#: 95 % of a Gaussian lies within this many standard deviations.
QUANTILE = 1.959964
# Some 13,000 pixels x 24 repeats: the share within has a standard error of 0.0004.  Six of
# those, false alarms below 1e-8 a check; an error of sigma by 2.5 % would already show.
TOLERANCE = 0.0025


@functools.cache
def repeats(name, axes, shifts):
    """Decode repeats; return scene, phase maps, common mask and noise-free coordinates."""
    scene, transport = small(name, axes=axes, shifts=shifts), transport_of(name, axes)
    phases = [capture(scene, transport, seed=100 + k).decode() for k in range(REPEATS)]
    centre = noise_free_coordinates(scene, transport)
    mask = np.logical_and.reduce([phase.mask for phase in phases])
    mask &= np.logical_and.reduce([np.isfinite(values) for values in centre.values()])
    return scene, phases, mask, centre


def deviations(name, axes, shifts, axis):
    """Return (x - centre) / sigma of every repeat and pixel, and sigma, (R, P) each."""
    _, phases, mask, centre = repeats(name, axes, shifts)
    error = np.array([phase.coordinate[axis][mask] - centre[axis][mask] for phase in phases])
    sigma = np.array([phase.sigma[axis][mask] for phase in phases])
    return error / sigma, sigma


@pytest.mark.parametrize(("name", "axes", "shifts"), CASES)
def test_phase_coverage(name, axes, shifts):
    for axis in axes:
        z, sigma = deviations(name, axes, shifts, axis)
        assert z.shape[1] > 12_000
        assert np.mean(np.abs(z) <= QUANTILE) == pytest.approx(0.95, abs=TOLERANCE)
        # Bright and dim pixels alike, not only on average.
        edges = np.quantile(sigma.mean(axis=0), [0.0, 0.25, 0.5, 0.75, 1.0])
        quarter = np.clip(np.searchsorted(edges, sigma.mean(axis=0)) - 1, 0, 3)
        for k in range(4):
            inside = np.mean(np.abs(z[:, quarter == k]) <= QUANTILE)
            assert inside == pytest.approx(0.95, abs=2 * TOLERANCE)  # a quarter of the pixels


@pytest.mark.parametrize(("name", "axes", "shifts"), CASES)
def test_phase_coverage_about_the_mean_of_the_repeats(name, axes, shifts):
    # The same without any model of the noise-free value: the scatter about a mean of R is
    # smaller by sqrt(1 - 1/R).
    _, phases, mask, _ = repeats(name, axes, shifts)
    for axis in axes:
        x = np.array([phase.coordinate[axis][mask] for phase in phases])
        sigma = np.array([phase.sigma[axis][mask] for phase in phases])
        z = (x - x.mean(axis=0)) / (sigma * np.sqrt(1 - 1 / REPEATS))
        assert np.mean(np.abs(z) <= QUANTILE) == pytest.approx(0.95, abs=TOLERANCE)


@pytest.mark.parametrize(("name", "axes", "shifts"), CASES)
def test_xyz_coverage(name, axes, shifts):
    scene, phases, mask, centre = repeats(name, axes, shifts)
    exact = triangulate(scene.rig, replace(phases[0], coordinate=centre, mask=mask))
    expected = exact.image(exact.points)
    z = []
    for phase in phases:
        cloud = triangulate(scene.rig, phase)
        z.append((cloud.image(cloud.points) - expected) / cloud.image(cloud.sigma_mm))
    z = np.array(z)[:, np.isfinite(z).all(axis=(0, 3))]
    assert z.shape[1] > 12_000
    for k in range(3):
        assert np.mean(np.abs(z[..., k]) <= QUANTILE) == pytest.approx(0.95, abs=TOLERANCE)


def test_two_axes_have_an_error_ellipse():
    # The squared distance in units of sigma is chi-squared with two degrees of freedom if u
    # and v, which come from different frames, are independent.
    _, phases, mask, centre = repeats("plane", "uv", 3)
    inside = []
    for phase in phases:
        d = [(phase.coordinate[a][mask] - centre[a][mask]) / phase.sigma[a][mask] for a in "uv"]
        inside.append(d[0] ** 2 + d[1] ** 2 <= -2 * np.log(0.05))
    assert np.mean(inside) == pytest.approx(0.95, abs=TOLERANCE)


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_phase_noise_is_the_closed_form(bit_depth):
    """sigma_phi = sqrt(2 / N) sigma_I / b, from the data sheet alone."""
    shifts, fringes = 4, 50
    detector = Detector(bit_depth=bit_depth)
    scene = replace(small("plane", shifts=shifts), detector=detector)
    transport = transport_of("plane")
    clean = capture(scene, transport, noise=False).decode()
    gain = (2**bit_depth - 1 - detector.black_dn) / detector.full_well_e  # DN per electron
    # Variances in DN^2: read noise, shot noise of the mean signal, rounding.
    variance = (
        (detector.read_noise_e * gain) ** 2 + (clean.mean - detector.black_dn) * gain + 1.0 / 12.0
    )
    predicted = np.sqrt(2.0 / shifts * variance) / clean.modulation
    phases = [capture(scene, transport, seed=k).decode() for k in range(REPEATS)]
    mask = np.logical_and.reduce([phase.mask for phase in phases]) & clean.mask
    per_px = 2.0 * np.pi * fringes / 640
    absolute = per_px * np.array([phase.coordinate["u"][mask] + 0.5 for phase in phases])
    measured = absolute.var(axis=0, ddof=1)
    ratio = np.sqrt(measured.mean() / np.mean(predicted[mask] ** 2))
    # 3 % as required; the statistics (13,000 pixels x 23) leave 0.1 %.
    assert ratio == pytest.approx(1.0, abs=0.03)
    print(f"{bit_depth} bit: phase noise over closed form {ratio:.4f}")


@pytest.mark.parametrize("name", ["plane", "step-block"])
def test_the_centre_is_near_the_truth(name):
    # What coverage leaves out: the noise-free coordinate is unbiased, and its own error is the
    # floor that a scan reports.
    scene, _, _, centre = repeats(*next(case for case in CASES if case[0] == name))
    truth = truth_of(name)
    error = (centre["u"] - truth.panel[..., 0])[truth.smooth()]
    # The floor of 0.07 px over 10,000 pixels leaves 0.0007 px; along columns it goes together,
    # hence the required 0.01 px.
    assert abs(np.nanmean(error)) < 0.01
    floor = floor_rms_px(scene, transport_of(name), truth)
    assert floor == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=1e-9)
    assert 0.001 < floor < 0.1
