"""Lens distortion (Brown-Conrady and beyond) and sensor tilt (Scheimpflug), as OpenCV has them.

Both act on *normalised image coordinates* ``(x, y)``: for a perspective lens ``x = X / Z``.

* Distortion has OpenCV's coefficients and formula (:mod:`~slbench.rig.coefficients`).
* Tilt is OpenCV's ``tauX, tauY``: the sensor plane turned about its own axes at the
  principal point (Louhichi et al., Meas. Sci. Technol. 18, 2007).

**Where a lens is defined.**  A polynomial turns back somewhere: beyond its *fold* points outside
the field come back as if they were inside.  A rational function has poles beside: where its
denominator vanishes, the image is infinitely far away.  :func:`fold_radius` says where the first of
them is, and everything that projects, whoever does it, stops there (:func:`distort` gives NaN).

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
    """Return the radius of undistorted coordinates within which distortion can be inverted.

    The determinant of the Jacobian and the denominator are positive within it.  With tangential
    terms the fold is not quite a circle, and its smallest radius counts.

    Parameters
    ----------
    coefficients : (5,), (8,) or (12,) float

    Returns
    -------
    float
        Infinite where the model does not fold.
    """
    return _fold_radius(tuple(np.asarray(coefficients, dtype=np.float64).tolist()))


@lru_cache(maxsize=64)
def _fold_radius(k: tuple[float, ...]) -> float:
    from slbench.rig.kernels import first_lost

    round_about = any((*k[2:4], *k[8:]))
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS if round_about else 1) / _DIRECTIONS
    radii, around = np.linspace(0.0, _FARTHEST, _STEPS), (np.cos(angle), np.sin(angle))
    coefficients = np.array(k)
    beyond = first_lost(radii, *around, coefficients)
    if beyond == len(radii):
        return float("inf")
    low, high = radii[beyond - 1], radii[beyond]
    for _ in range(60):
        middle = 0.5 * (low + high)
        if first_lost(np.array([middle]), *around, coefficients) == 0:
            high = middle
        else:
            low = middle
    return float(low)


def distort(xy: Array, coefficients: ArrayLike) -> tuple[Array, Array]:
    """Apply distortion.

    Parameters
    ----------
    xy : (..., 2) float
        Undistorted normalised coordinates.
    coefficients : (5,), (8,) or (12,) float

    Returns
    -------
    distorted : (..., 2) float
        NaN beyond the fold.
    jacobian : (..., 2, 2) float
        Derivative of the distorted by the undistorted coordinates.
    """
    from slbench.rig.kernels import distort_all

    points = np.asarray(xy, dtype=np.float64)
    out, jacobian = np.empty(points.shape), np.empty((*points.shape, 2))
    rows = np.ascontiguousarray(points).reshape(-1, 2)
    k, fold2 = np.asarray(coefficients, dtype=np.float64), fold_radius(coefficients) ** 2
    distort_all(rows, k, fold2, out.reshape(-1, 2), jacobian.reshape(-1, 4))
    return out, jacobian


def undistort(xy: Array, coefficients: ArrayLike) -> Array:
    """Invert :func:`distort` by Newton's method.

    Parameters
    ----------
    xy : (..., 2) float
        Distorted normalised coordinates.
    coefficients : (5,), (8,) or (12,) float

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
    k, fold2 = np.asarray(coefficients, dtype=np.float64), fold_radius(coefficients) ** 2
    undistort_all(rows, k, fold2, result.reshape(-1, 2))
    return result


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
