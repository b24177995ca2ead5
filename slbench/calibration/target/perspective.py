"""How far the centre of a projected circle lies from the projection of its centre.

A circle in perspective is an ellipse, but its centre is not where the circle's centre is seen:
it is displaced towards the nearer side, by about ``c (r / z)^2 sin(tilt) / pitch`` pixels for
a circle of radius r at distance z.  The ellipse is exact by duality (R. Hartley, A. Zisserman,
"Multiple View Geometry", 2.2.3; J. Heikkila, IEEE PAMI 22, 2000): with H the homography from
the circle's plane, its centre as origin, to the image, the dual conic of the image is

    C* = H diag(r^2, r^2, -1) H^T ,

and the ellipse's centre is the pole of the line at infinity, ``(C*_13, C*_23) / C*_33``.

A detected centre is corrected by *subtracting* what the functions here return.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.rig import Camera, Pose, Projector

Array = NDArray[np.float64]


def circle_centre_bias(
    device: Camera | Projector, pose: Pose, centres_mm: ArrayLike, radius_mm: float
) -> Array:
    """Return the bias of ellipse centres for a target whose pose is known.

    Parameters
    ----------
    device : Camera or Projector
        What sees it.  Distortion is followed exactly for the ellipse's centre; that it bends
        the ellipse itself is left out (third order in the radius).
    pose : Pose
        Of the target; its dots lie in planes z = const of its frame.
    centres_mm : (n, 3) float
        Centres in the target's frame, as an artefact's ``targets``.
    radius_mm : float

    Returns
    -------
    (n, 2) float
        Centre of the ellipse less the projection of the centre, px; zero for a telecentric
        lens.

    Raises
    ------
    InputError
        For centres that are not (n, 3), a radius that is not positive, or a circle that is
        not wholly in front of the device.
    """
    centres = np.asarray(centres_mm, dtype=np.float64)
    if centres.ndim != 2 or centres.shape[1] != 3 or not np.all(np.isfinite(centres)):
        raise InputError("circle_centre_bias: centres_mm", "finite points (n, 3)", centres.shape)
    _check_radius("circle_centre_bias: radius_mm", radius_mm)
    world = pose.to_world(centres)
    if device.lens.kind == "telecentric":
        return np.zeros((len(world), 2))
    local = device.pose.to_local(world)
    across = device.pose.rotation.T @ pose.rotation[:, :2]  # the plane's axes, device frame
    reach = radius_mm * float(np.linalg.norm(across[2]))
    if not np.all(local[:, 2] > reach):
        raise InputError("circle_centre_bias: pose", "dots in front of the device", "others")
    plane = np.concatenate((np.broadcast_to(across, (len(local), 3, 2)), local[:, :, None]), axis=2)
    middle = np.ones((len(local), 3))
    middle[:, :2] = _ellipse_centres(plane, radius_mm)
    # Any point on the ray of the ellipse's centre: distortion and tilt are then the device's.
    return device.project(device.pose.to_world(middle * local[:, 2:])) - device.project(world)


def homography_centre_bias(homography: ArrayLike, indices: ArrayLike, radius: float) -> Array:
    """Return the bias of ellipse centres for a grid seen by an unknown rig.

    Parameters
    ----------
    homography : (3, 3) float
        From the grid's cells to pixels, as :func:`slbench.calibration.target.indexing.index_grid`
        estimates it.
    indices : (n, 2) float
        Where the dots are, in cells.
    radius : float
        Of the dots, in cells, e.g. 0.25 where the pitch is twice the diameter.  Cells are
        taken to be square.

    Returns
    -------
    (n, 2) float
        Centre of the ellipse less the image of the centre, px.  As the homography was itself
        fitted to ellipse centres, an error of second order remains.

    Raises
    ------
    InputError
        For arrays of other shapes, or a radius that is not positive.
    """
    matrix = np.asarray(homography, dtype=np.float64)
    places = np.asarray(indices, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        raise InputError("homography_centre_bias: homography", "a (3, 3) matrix", matrix.shape)
    if places.ndim != 2 or places.shape[1] != 2:
        raise InputError("homography_centre_bias: indices", "points (n, 2)", places.shape)
    _check_radius("homography_centre_bias: radius", radius)
    to_circle = np.broadcast_to(np.eye(3), (len(places), 3, 3)).copy()
    to_circle[:, :2, 2] = places
    plane = matrix @ to_circle
    return _ellipse_centres(plane, radius) - plane[:, :2, 2] / plane[:, 2:, 2]


def _check_radius(where: str, radius: float) -> None:
    if not 0.0 < radius < np.inf:
        raise InputError(where, "a positive radius", radius)


def _ellipse_centres(plane: Array, radius: float) -> Array:
    """Centres (n, 2) of circles about the origin, mapped by homographies (n, 3, 3)."""
    circle = np.diag([radius**2, radius**2, -1.0])
    dual = plane @ circle @ plane.transpose(0, 2, 1)
    return dual[:, :2, 2] / dual[:, 2:, 2]
