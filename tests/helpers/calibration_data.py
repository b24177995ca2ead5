"""Calibration points of known origin, for the calibration's tests."""

import functools

import numpy as np

from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import polynomial_form
from slbench.rig import Rig
from slbench.scene.file import load_scene


@functools.cache
def rig_of(name: str) -> Rig:
    """Return a shipped scene's rig."""
    return load_scene(name).rig


def rig_points(n: int, noise_px: float = 0.0, seed: int = 0, name: str = "ch8-grid"):
    """Return random points of a rig's volume as both devices see them."""
    rig, rng = rig_of(name), np.random.default_rng(seed)
    world = (rng.random((n, 3)) - 0.5) * np.array(rig.volume_mm)
    pixels = np.column_stack((rig.camera.project(world), rig.projector.project(world)))
    return CalibrationPoints(pixels + noise_px * rng.normal(size=pixels.shape), world)


def grid_points(heights: int = 9, side: int = 8, noise_px: float = 0.0, name: str = "ch8-grid"):
    """Return markings on a square grid at even heights through a rig's volume."""
    rig, rng = rig_of(name), np.random.default_rng(3)
    w, h, d = (0.5 * size for size in rig.volume_mm)
    x, y, z = np.meshgrid(
        np.linspace(-w, w, side), np.linspace(-h, h, side), np.linspace(-d, d, heights)
    )
    world = np.column_stack((x.ravel(), y.ravel(), z.ravel()))
    pixels = np.column_stack((rig.camera.project(world), rig.projector.project(world)))
    return CalibrationPoints(pixels + noise_px * rng.normal(size=pixels.shape), world)


def polynomial_data(form: str, n: int, sigma: float, rng, axes: str = "u"):
    """Return inputs (n, k) in pixels, noise-free response (n,) and noisy response (n,).

    The polynomial has coefficients of one for inputs in [-1, 1].
    """
    terms = polynomial_form(form, axes)
    unit = rng.uniform(-1.0, 1.0, (n, len(terms.variables)))
    truth = terms.design(unit) @ np.ones(len(terms))
    return 1000.0 + 700.0 * unit, truth, truth + sigma * rng.normal(size=n)
