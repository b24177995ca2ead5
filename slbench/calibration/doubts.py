"""Doubts about a calibration model: one of frames of another resolution."""

from __future__ import annotations

import numpy as np

from slbench.calibration.models.model import CalibrationModel

#: Ratio of sizes from which on it is no matter of where the target lay.
_FACTOR = 1.8
#: How far the ratios along both axes may be apart.
_ALIKE = 1.25
#: Share of the image by which a domain reaches beyond it that tells.
_BEYOND = 0.1


def resolution_doubt(model: CalibrationModel, shape: tuple[int, int]) -> str | None:
    """Question a model that was fitted to frames of another size than those it is applied to.

    The pixels of a model's domain lie about the middle of its frames, so that the least and the
    greatest add up to their size; a target smaller than the field does not change that.

    Parameters
    ----------
    model : CalibrationModel
    shape : (V, U)
        Of the frames.
    """
    bounds = pixel_bounds(model)
    if bounds is None:
        return None
    sizes = np.array(shape[::-1], dtype=np.float64)
    fitted = bounds.sum(axis=0) + 1.0
    ratio = fitted / sizes
    alike = ratio.min() > 0 and ratio.max() < _ALIKE * ratio.min()
    smaller = ratio.max() * _FACTOR < 1 and np.all(bounds[1] * _FACTOR < sizes)
    larger = ratio.min() > _FACTOR and np.all(bounds[1] > (1 + _BEYOND) * sizes)
    if not alike or not (smaller or larger):
        return None
    u, v = (f"{axis} {a:.0f} to {b:.0f}" for axis, a, b in zip("uv", *bounds, strict=True))
    return (
        f"the model was fitted to pixels {u}, {v}, the frames have {shape[1]} x {shape[0]} px: "
        f"a model of a {'preview' if smaller else 'camera with more pixels'}?"
    )


def pixel_bounds(model: CalibrationModel) -> np.ndarray | None:
    """Return the least and the greatest camera pixel (u, v) of a model's domain, (2, 2)."""
    # Asked only where there is a doubt: it takes a while to load.
    from scipy.optimize import linprog

    faces = model.domain.half_spaces
    bounds = np.empty((2, 2))
    for axis in range(2):
        for row, sign in enumerate((1.0, -1.0)):
            cost = np.zeros(faces.shape[1] - 1)
            cost[axis] = sign
            found = linprog(
                cost, A_ub=faces[:, :-1], b_ub=-faces[:, -1] + 1e-9, bounds=(None, None)
            )
            if not found.success:
                return None
            bounds[row, axis] = sign * found.fun
    mean, scale = (
        np.asarray(x)[:2] for x in (model.standardisation.mean, model.standardisation.scale)
    )
    return np.asarray(mean + scale * bounds)
