"""Lens distortion (Brown-Conrady) and sensor tilt (Scheimpflug) in OpenCV's conventions.

Both act on *normalised image coordinates* ``(x, y)``: for a perspective lens ``x = X / Z``.

* Distortion has OpenCV's five coefficients ``k1, k2, p1, p2, k3``
  (D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971).
* Tilt is OpenCV's ``tauX, tauY``: the sensor plane turned about its own axes at the
  principal point (Louhichi et al., Meas. Sci. Technol. 18, 2007).

**Where a lens is defined.**  A polynomial turns back somewhere: beyond its *fold* points outside
the field come back as if they were inside.  :func:`fold_radius` says where that is, and everything
that projects, whoever does it, stops there (:func:`distort` gives NaN).

Every function has its exact Jacobian, because the inverse (Newton) and the covariance of
reconstructed points need it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


#: Directions in which the fold is looked for; without tangential terms it is a circle.
_DIRECTIONS = 64
#: It is looked for up to 84 degrees off the axis, in so many steps.
_FARTHEST, _STEPS = 10.0, 4001


def fold_radius(coefficients: ArrayLike) -> float:
    """Return the radius of undistorted coordinates at which Brown-Conrady distortion folds.

    The determinant of the Jacobian is positive within it.  With tangential terms the fold is not
    quite a circle, and its smallest radius counts.

    Parameters
    ----------
    coefficients : (5,) float
        ``k1, k2, p1, p2, k3``.

    Returns
    -------
    float
        Infinite where the polynomial does not fold.
    """
    return _fold_radius(*(float(k) for k in np.asarray(coefficients, dtype=np.float64)))


@lru_cache(maxsize=64)
def _fold_radius(k1: float, k2: float, p1: float, p2: float, k3: float) -> float:
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS if p1 or p2 else 1)[:, None] / _DIRECTIONS
    c, s = np.cos(angle), np.sin(angle)

    def determinant(r: Array) -> Array:
        r2 = r * r
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * r2 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        a = radial + c * c * slope + r * (2.0 * p1 * s + 6.0 * p2 * c)
        b = c * s * slope + r * (2.0 * p1 * c + 2.0 * p2 * s)
        d = radial + s * s * slope + r * (6.0 * p1 * s + 2.0 * p2 * c)
        product: Array = a * d - b * b
        return product

    radii = np.linspace(0.0, _FARTHEST, _STEPS)
    folded = np.flatnonzero(np.any(determinant(radii) <= 0.0, axis=0))
    if folded.size == 0:
        return float("inf")
    low, high = radii[folded[0] - 1], radii[folded[0]]
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.any(determinant(np.array([middle])) <= 0.0):
            high = middle
        else:
            low = middle
    return float(low)


def distort(xy: Array, coefficients: Array) -> tuple[Array, Array]:
    """Apply Brown-Conrady distortion.

    Parameters
    ----------
    xy : (..., 2) float
        Undistorted normalised coordinates.
    coefficients : (5,) float
        ``k1, k2, p1, p2, k3``.

    Returns
    -------
    distorted : (..., 2) float
        NaN beyond the fold.
    jacobian : (..., 2, 2) float
        Derivative of the distorted by the undistorted coordinates.
    """
    k1, k2, p1, p2, k3 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    fold = fold_radius(coefficients)
    if np.isfinite(fold):
        r2 = np.where(r2 < fold * fold, r2, np.nan)
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    d_radial = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)  # by r^2
    out = np.stack(
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ),
        axis=-1,
    )
    jacobian = np.empty((*x.shape, 2, 2))
    jacobian[..., 0, 0] = radial + 2.0 * x * x * d_radial + 2.0 * p1 * y + 6.0 * p2 * x
    jacobian[..., 0, 1] = 2.0 * x * y * d_radial + 2.0 * p1 * x + 2.0 * p2 * y
    jacobian[..., 1, 0] = jacobian[..., 0, 1]
    jacobian[..., 1, 1] = radial + 2.0 * y * y * d_radial + 6.0 * p1 * y + 2.0 * p2 * x
    return out, jacobian


def undistort(xy: Array, coefficients: Array) -> Array:
    """Invert :func:`distort` by Newton's method.

    Parameters
    ----------
    xy : (..., 2) float
        Distorted normalised coordinates.
    coefficients : (5,) float

    Returns
    -------
    (..., 2) float
        Undistorted coordinates; NaN where the model cannot be inverted (beyond the radius
        at which strong distortion folds the image back).
    """
    target = np.asarray(xy, dtype=np.float64)
    if not np.any(coefficients):
        return target.copy()
    from slbench.rig.kernels import undistort_all

    result = np.empty(target.shape)
    rows = np.ascontiguousarray(target).reshape(-1, 2)
    undistort_all(rows, with_fold(coefficients), result.reshape(-1, 2))
    return result


def with_fold(coefficients: ArrayLike) -> Array:
    """Return coefficients (5,) as compiled loops take them: the fold's squared radius behind."""
    return np.append(np.asarray(coefficients, dtype=np.float64), fold_radius(coefficients) ** 2)


def tilt_rotation(tau_x: float, tau_y: float) -> Array:
    """Return the (3, 3) rotation from lens to sensor axes, OpenCV's ``R(tauX, tauY)``."""
    cx, sx = np.cos(tau_x), np.sin(tau_x)
    cy, sy = np.cos(tau_y), np.sin(tau_y)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
    about_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
    return about_y @ about_x


def tilt_matrix(tau_x: float, tau_y: float, *, parallel: bool = False) -> Array:
    """Return the homography from untilted to tilted normalised image coordinates.

    Parameters
    ----------
    tau_x, tau_y : float
        Sensor tilt in radians.
    parallel : bool
        True for a telecentric lens, whose image-side chief rays are parallel to the axis:
        the map is then affine.

    Returns
    -------
    (3, 3) float
        ``s (x', y', 1) = H (x, y, 1)``.  For a perspective lens this is OpenCV's matrix.
    """
    rotation = tilt_rotation(tau_x, tau_y)
    if parallel:
        # The ray at (x, y) meets the sensor plane at the axial offset that makes its third
        # sensor coordinate vanish.
        offset = -rotation[2, :2] / rotation[2, 2]
        homography = np.eye(3)
        homography[:2, :2] = rotation[:2, :2] + np.outer(rotation[:2, 2], offset)
        return homography
    r13, r23, r33 = rotation[:, 2]
    return np.array([[r33, 0.0, -r13], [0.0, r33, -r23], [0.0, 0.0, 1.0]]) @ rotation


def apply_homography(xy: Array, homography: Array) -> tuple[Array, Array]:
    """Map points through a homography.

    Parameters
    ----------
    xy : (..., 2) float
    homography : (3, 3) float

    Returns
    -------
    mapped : (..., 2) float
    jacobian : (..., 2, 2) float
    """
    h = homography
    x, y = xy[..., 0], xy[..., 1]
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    mapped = np.stack(
        (
            (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w,
            (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w,
        ),
        axis=-1,
    )
    jacobian = (h[:2, :2] - mapped[..., :, None] * h[2, :2]) / w[..., None, None]
    return mapped, jacobian
