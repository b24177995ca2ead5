"""Selective all-in-focus fusion once more, plainly: whole stacks in NumPy and SciPy, float64.

Nothing is shared with the kernels.  Border pixels are repeated, as there.
"""

import numpy as np
from scipy import ndimage


def measure(image, window=9, name="variance"):
    image = np.asarray(image, dtype=np.float64)
    size = (window, window)
    if name == "variance":
        local = (image - ndimage.uniform_filter(image, size, mode="nearest")) ** 2
    elif name == "gradient":
        kernel = [-0.5, 0, 0.5]
        local = sum(ndimage.correlate1d(image, kernel, a, mode="nearest") ** 2 for a in (0, 1))
    else:
        kernel = [-1, 2, -1]
        local = sum(abs(ndimage.correlate1d(image, kernel, a, mode="nearest")) for a in (0, 1))
    return ndimage.uniform_filter(local, size, mode="nearest")


def selective(stack, positions=None, window=9, alpha=0.2, threshold_db=13.0, name="variance"):
    """Return weights (P, V, U), fused-to-be; focus and selectivity (V, U), of P >= 5 frames."""
    focus = np.array([measure(image, window, name) for image in stack])
    count = len(focus)
    x = np.arange(float(count)) if positions is None else np.asarray(positions, dtype=np.float64)
    peak = focus.max(axis=0)
    top = focus.argmax(axis=0)
    left, middle, right = np.maximum(top - 2, 0), top, np.minimum(top + 2, count - 1)
    at_end = (top == 0) | (top == count - 1)
    middle = np.where(at_end, np.clip(top, 2, count - 3), middle)
    left, right = np.where(at_end, middle - 2, left), np.where(at_end, middle + 2, right)

    with np.errstate(all="ignore"):
        y = np.log(np.maximum(focus / peak, 1e-12))
        y0, y1, y2 = (np.take_along_axis(y, k[None], axis=0)[0] for k in (left, middle, right))
        x0, x1, x2 = x[left], x[middle], x[right]
        # Lagrange's parabola a + b x + c x^2 through the three points.
        d0, d1, d2 = (x0 - x1) * (x0 - x2), (x1 - x0) * (x1 - x2), (x2 - x0) * (x2 - x1)
        c = y0 / d0 + y1 / d1 + y2 / d2
        b = -(y0 * (x1 + x2) / d0 + y1 * (x0 + x2) / d1 + y2 * (x0 + x1) / d2)
        a = y0 * x1 * x2 / d0 + y1 * x0 * x2 / d1 + y2 * x0 * x1 / d2
        fitted = np.exp(a + x[:, None, None] * (b + x[:, None, None] * c))
        fitted = np.where(c < 0, fitted, 0.0)
        place = np.where(c < 0, -b / (2 * c), np.nan)
        ratio = np.where(peak > 0, focus / peak, 1.0)
    place = np.where((place >= x[0]) & (place <= x[-1]), place, np.nan)
    error = np.abs(ratio - fitted).mean(axis=0)
    error = ndimage.uniform_filter(error, (window, window), mode="nearest")
    selectivity = 20 * np.log10(1 / np.maximum(error, 1e-6))
    phi = (1 + np.tanh(alpha * (selectivity - threshold_db))) / (2 * alpha)
    phi = ndimage.median_filter(phi, size=(3, 3), mode="nearest")
    return 0.5 + 0.5 * np.tanh(phi * (ratio - 1)), place, selectivity


def fuse(weights, stack):
    return (weights * stack).sum(axis=0) / weights.sum(axis=0)
