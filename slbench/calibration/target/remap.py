"""Re-map marker centres from the camera to the projector's panel (thesis 5.4.4, eq. 33-38).

The thesis finds the bilinear polynomial through the phases of the four surrounding camera
pixels by a 4 x 4 system (eq. 33-36).  Its solution in closed form, with the fractions f, g of
the centre between the pixels, is the weighted mean with the weights
``(1-f)(1-g), f(1-g), (1-f)g, fg``; nothing else is needed, and it is not ill-conditioned far
from the image's corner.  Eq. 37-38 scale phase to panel, ``DMD Phi / range + 1``: pixels
counted from 1.  Decoded coordinates are pixels already, in this library's convention (the
centre of the first is 0), so no scaling is left.

A dot is dark, and its phase therefore noisy: with `window` a polynomial is fitted to the
phase around the centre instead, weighted by the predicted deviations and robust; `exclude_px`
leaves out the dot itself, whose rim also biases the phase (a pixel that is half dark sees
the other half's fringes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.patterns import Axis, PhaseMap

Array = NDArray[np.float64]

#: Tukey's tuning constant.
_TUKEY = 4.685
#: Points that a window must have for each coefficient of its polynomial.
_POINTS_PER_TERM = 3


@dataclass(frozen=True)
class PanelPoints:
    """Panel coordinates of n markers along k coded axes.

    Parameters
    ----------
    axes : tuple of {"u", "v"}
        The coded axes, in the order of the columns below.
    coordinates : (n, k) float
        Panel pixels, NaN where the phase is not known.
    sd : (n, k) float
        Predicted standard deviations: of the phase, and of the centre by the gradient.
    gradient : (n, k, 2) float
        Derivatives of the coordinates by camera u and v, panel px per px.
    """

    axes: tuple[Axis, ...]
    coordinates: Array
    sd: Array
    gradient: Array

    __repr__ = brief


def remap(
    centres: ArrayLike,
    phase: PhaseMap,
    *,
    centre_sd: ArrayLike = 0.0,
    window: int | None = None,
    order: int = 2,
    exclude_px: ArrayLike = 0.0,
) -> PanelPoints:
    """Re-map marker centres to the panel.

    Parameters
    ----------
    centres : (n, 2) float
        Camera pixels (u, v).
    phase : PhaseMap
        Decoded panel coordinates; NaN is masked.
    centre_sd : float or (n,) float
        Standard deviation of the centres along either axis, px.
    window : int, optional
        Fit a polynomial to the pixels up to this far from the centre, px.  By default the
        four surrounding pixels are interpolated (thesis eq. 33-36).
    order : {1, 2}
        Order of that polynomial.
    exclude_px : float or (n,) float
        Radius about the centre that the fit leaves out.

    Returns
    -------
    PanelPoints
        NaN where a surrounding pixel is masked or outside the image; for a window, where
        fewer than three pixels a coefficient are left, or they do not determine it.

    Raises
    ------
    InputError
        For centres that are not (n, 2), negative or non-finite deviations and radii, or a
        window that is not a whole number from 1.
    """
    places = np.asarray(centres, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2 or len(places) == 0:
        raise InputError("remap: centres", "points (n, 2)", places.shape)
    if not np.all(np.isfinite(places)):
        raise InputError("remap: centres", "finite numbers", "others")
    deviation = _per_centre("remap: centre_sd", centre_sd, len(places))
    exclude = _per_centre("remap: exclude_px", exclude_px, len(places))
    if order not in (1, 2):
        raise InputError("remap: order", "1 or 2", order)
    if window is None:
        if np.any(exclude > 0):
            raise InputError("remap: exclude_px", "a window to fit in", "none")
    elif isinstance(window, bool) or not isinstance(window, (int, np.integer)) or window < 1:
        raise InputError("remap: window", "a whole number of pixels from 1", window)
    axes = tuple(phase.coordinate)
    coordinates, sd = np.empty((2, len(places), len(axes)))
    slopes = np.empty((len(places), len(axes), 2))
    for k, axis in enumerate(axes):
        panel, sigma = phase.coordinate[axis], phase.sigma[axis]
        if window is None:
            value, own, gradient = _interpolate(places, panel, sigma)
        else:
            fits = [
                _fit_window(place, panel, sigma, int(window), order, float(out))
                for place, out in zip(places, exclude, strict=True)
            ]
            value, own = (np.array([fit[i] for fit in fits]) for i in (0, 1))
            gradient = np.array([fit[2] for fit in fits])
        coordinates[:, k], slopes[:, k] = value, gradient
        sd[:, k] = np.hypot(own, deviation * np.linalg.norm(gradient, axis=1))
    return PanelPoints(axes, coordinates, sd, slopes)


def _per_centre(where: str, value: ArrayLike, count: int) -> Array:
    """Return a value per centre (n,) from one for all or one for each."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (count,)) or not np.all(np.isfinite(array) & (array >= 0)):
        raise InputError(where, f"one number >= 0, or {count}", np.shape(value))
    return np.broadcast_to(array, (count,)).copy()


def _interpolate(places: Array, panel: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Interpolate at places (n, 2): value, its deviation (n,) and the gradient (n, 2)."""
    rows, columns = panel.shape
    u, v = places.T
    inside = (u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1)
    # On the last row or column: the cell before, with a fraction of one.
    column = np.clip(np.floor(u).astype(np.int64), 0, columns - 2)
    row = np.clip(np.floor(v).astype(np.int64), 0, rows - 2)
    f, g = u - column, v - row
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])  # row, column
    at = row + corners[:, :1], column + corners[:, 1:]
    p, s = panel[at], sigma[at]  # (4, n)
    weights = np.stack(((1 - f) * (1 - g), f * (1 - g), (1 - f) * g, f * g))
    along_u = (1 - g) * (p[1] - p[0]) + g * (p[3] - p[2])
    along_v = (1 - f) * (p[2] - p[0]) + f * (p[3] - p[1])
    value = np.where(inside, (weights * p).sum(axis=0), np.nan)
    own = np.where(inside, np.sqrt((weights**2 * s**2).sum(axis=0)), np.nan)
    return value, own, np.column_stack((along_u, along_v))


def _fit_window(
    place: Array, panel: Array, sigma: Array, window: int, order: int, exclude: float
) -> tuple[float, float, Array]:
    """Fit a polynomial about a place (2,): value, its deviation and the gradient (2,)."""
    nothing = (np.nan, np.nan, np.full(2, np.nan))
    rows, columns = panel.shape
    u, v = place
    if not (-0.5 <= u <= columns - 0.5 and -0.5 <= v <= rows - 0.5):
        return nothing
    first = np.maximum(np.ceil(place - window), 0.0).astype(np.int64)
    last = np.minimum(np.floor(place + window), (columns - 1, rows - 1)).astype(np.int64)
    box = np.s_[first[1] : last[1] + 1, first[0] : last[0] + 1]
    y, x = np.mgrid[box]
    x, y = (x - u) / window, (y - v) / window
    r2 = x * x + y * y
    used = np.isfinite(panel[box]) & (sigma[box] > 0) & (r2 <= 1.0)
    used &= r2 >= (exclude / window) ** 2
    x, y, data, deviation = x[used], y[used], panel[box][used], sigma[box][used]
    terms = [np.ones_like(x), x, y] + ([x * x, x * y, y * y] if order == 2 else [])
    if len(data) < _POINTS_PER_TERM * len(terms):
        return nothing
    design = np.stack(terms, axis=1) / deviation[:, None]
    target = (data - data[0]) / deviation
    weights = np.ones(len(data))
    for _ in range(6):
        root = np.sqrt(weights)
        values, _, rank, _ = np.linalg.lstsq(root[:, None] * design, root * target, rcond=1e-8)
        if rank < len(terms):
            return nothing
        residual = target - design @ values
        scale = 1.4826 * float(np.median(np.abs(residual)))
        ratio = residual / max(_TUKEY * scale, 1e-9)
        weights = np.where(np.abs(ratio) < 1.0, (1.0 - ratio**2) ** 2, 0.0)
    # Phases scatter more than predicted where a polynomial is not all there is to them.
    excess = max(1.0, float((weights * residual**2).sum() / max(weights.sum() - len(terms), 1.0)))
    covariance = excess * np.linalg.inv(design.T @ (weights[:, None] * design))
    return float(values[0] + data[0]), float(np.sqrt(covariance[0, 0])), values[1:3] / window
