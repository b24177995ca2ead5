"""Errors that are periodic in the coordinate, told by the coordinates themselves."""

from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small
from stages import ground_truth, noise_free_coordinates, trace

from slbench.patterns import PatternSequence, PhaseMap
from slbench.patterns.ripple import ripple_rms_px, ripples

SIGMA = 0.03
SEQUENCE = PatternSequence.parse("1,10,50@4", (640, 480))
PERIOD = 640 / 50


def phase_of(coordinate, axis="u", sigma=SIGMA):
    mask = np.isfinite(coordinate)
    nothing = np.zeros(mask.shape, np.float32)
    return PhaseMap(
        {axis: coordinate}, {axis: np.where(mask, sigma, np.nan)}, nothing, nothing, mask
    )


def surface(shape=(240, 320), slope=0.68, wave_px=2.0, seed=0):
    """Return a coordinate that runs along the lines, over a surface with a gentle wave."""
    rows, columns = np.indices(shape, np.float64)
    place = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 2)
    wave = np.sin(columns / 90.0 + place[0]) + np.cos(rows / 70.0 + place[1])
    return 40.0 + slope * columns + 0.05 * rows + wave_px * wave


def noisy(coordinate, seed=0, sigma=SIGMA):
    return coordinate + np.random.default_rng(seed).normal(0.0, sigma, coordinate.shape)


def told(phase, cause, sequence=SEQUENCE):
    (found,) = (r for r in ripples(phase, sequence) if r.cause == cause)
    return found


@pytest.mark.parametrize("slope", [0.31, 0.45, 0.68, 1.3, -0.68])
@pytest.mark.parametrize("transposed", [False, True])
def test_a_staircase_is_found_with_its_phase(slope, transposed):
    exact = surface(slope=slope) + (400.0 if slope < 0.0 else 0.0)
    off = 0.02 * np.sin(2.0 * np.pi * exact) - 0.01 * np.cos(2.0 * np.pi * exact)
    seen = noisy(exact + off)
    found = told(phase_of(seen.T if transposed else seen), "pixels")
    # Five deviations, and 2 % that the smoothed coordinate's own noise takes from the waves.
    expected = np.array([[0.02, -0.01], [0.0, 0.0]])
    assert np.all(np.abs(found.coefficients - expected) < 5.0 * found.deviation_px + 4e-4)
    assert found.deviation_px.max() < 0.0015
    assert found.rms_px == pytest.approx(np.hypot(0.02, 0.01) / np.sqrt(2.0), rel=0.1)
    # The error that it states is the one that was put in.
    np.testing.assert_allclose(found.error_px(exact), off, rtol=0, atol=0.005)


def test_what_a_response_does_is_found_in_the_harmonic_of_the_shifts():
    exact = surface()
    off = 0.015 * np.cos(4.0 * 2.0 * np.pi * exact / PERIOD)
    found = told(phase_of(noisy(exact + off)), "fringes")
    assert found.harmonics == (1, 2, 3, 4)
    assert found.coefficients[3] == pytest.approx([0.0, 0.015], abs=0.001)
    assert np.abs(found.coefficients[:3]).max() < 0.0015
    assert ripple_rms_px((found,))["u"] == pytest.approx(0.015 / np.sqrt(2.0), rel=0.1)


def test_where_there_is_none_none_is_found():
    """Coefficients over their deviations are those of a Gaussian; the RMS is next to nothing."""
    normed, sizes = [], []
    for seed in range(40):
        found = ripples(phase_of(noisy(surface((96, 320), seed=seed), seed)), SEQUENCE)
        normed += [(r.coefficients / r.deviation_px).ravel() for r in found]
        sizes.append(ripple_rms_px(found)["u"])
    normed = np.concatenate(normed)
    # 480 values, which scatter's own estimate from some 25 tiles widens by a twelfth.
    assert np.sqrt(np.mean(normed**2)) == pytest.approx(1.04, abs=0.15)
    assert np.mean(np.abs(normed) < 3.0) > 0.98
    assert np.median(sizes) < 0.05 * SIGMA


def test_a_rough_surface_is_no_ripple():
    """Roughness of the size of the noise, alike over some pixels, and steps."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(3)
    rough = gaussian_filter(rng.normal(size=(240, 320)), 3.0)
    exact = surface() + SIGMA / rough.std() * rough
    exact[:, 150:] += 7.3
    exact[100:140, 60:90] = np.nan
    found = ripples(phase_of(noisy(exact)), SEQUENCE)
    assert len(found) == 2
    assert ripple_rms_px(found)["u"] < 0.15 * SIGMA
    # A staircase over it is seen all the same.
    seen = exact + 0.03 * np.sin(2.0 * np.pi * exact)
    assert told(phase_of(noisy(seen)), "pixels").rms_px == pytest.approx(0.0212, rel=0.1)


def test_what_the_image_does_not_tell_is_said():
    # One panel pixel a camera pixel: a staircase is the same in all of them.
    rows, columns = np.indices((240, 320), np.float64)
    blind = told(phase_of(noisy(3.2 + columns + 0.0 * rows)), "pixels")
    assert np.isnan(blind.rms_px)
    assert str(blind).startswith("not told")
    assert ripple_rms_px((blind,)) == {"u": 0.0}
    # Fringes longer than half a line.
    wide = PatternSequence.parse("1,2", (640, 480))
    assert [r.cause for r in ripples(phase_of(noisy(surface())), wide)] == ["pixels"]
    # No fringes, coarse coordinates, nothing measured, hardly any picture.
    gray = PatternSequence.parse("gray", (640, 480))
    assert ripples(phase_of(noisy(surface())), gray) == ()
    assert ripples(phase_of(surface(), sigma=0.5), SEQUENCE) == ()
    assert ripples(phase_of(np.full((50, 60), np.nan)), SEQUENCE) == ()
    assert ripples(phase_of(noisy(surface((12, 30)))), SEQUENCE) == ()


@pytest.mark.parametrize("blur_px", [0.0, 0.3])
def test_a_rendered_staircase_is_the_analytic_one(blur_px):
    """A sampled sinusoid of frequency f has images at 1 - f and 1 + f cycles a pixel.

    Square pixels leave f / (1 - f) and f / (1 + f) of them beside the sinusoid, lens and footprint
    the ratios of their contrasts M; together they turn its phase by as much times sin(2 pi x).
    """
    scene = small("plane", divisor=1, samples=128)
    sharp = replace(scene.rig.projector, blur_px=blur_px)
    scene = replace(scene, rig=scene.rig.having(projector=sharp))
    transport, truth = trace(scene, seed=1), ground_truth(scene)
    coordinate = noise_free_coordinates(scene, transport)["u"]
    chosen = truth.smooth() & np.isfinite(coordinate)
    seen = np.where(chosen, coordinate, np.nan)
    found = told(phase_of(noisy(seen, sigma=0.005), sigma=0.005), "pixels", scene.sequence)
    place = truth.panel[..., 0]
    across, down = np.gradient(place, axis=1)[chosen], np.gradient(place, axis=0)[chosen]
    projector, camera = scene.rig.projector, scene.rig.camera
    points = truth.point[chosen]

    def contrast(frequency):
        lens = projector.spread.contrast(frequency, projector.circle_of_confusion(points))
        footprint = np.sinc(frequency * across) * np.sinc(frequency * down)
        own = camera.circle_of_confusion(points)
        return lens * footprint * camera.spread.contrast(frequency * np.hypot(across, down), own)

    f = 1.0 / PERIOD
    images = contrast(1.0 - f) / (1.0 - f) + contrast(1.0 + f) / (1.0 + f)
    expected = -np.mean(images / contrast(f)) / (2.0 * np.pi)
    # The mean over the plate, on which the blur changes; 3 % for tiles that weigh differently.
    assert found.coefficients[0, 0] == pytest.approx(expected, rel=0.03)
    assert abs(found.coefficients[0, 1]) < 0.1 * abs(found.coefficients[0, 0])
