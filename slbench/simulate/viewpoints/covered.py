"""What a scan measured of a part's surface, sample by sample, as a plan counts it.

A sample is looked for at the pixel that it is seen by.  It is measured if a point was measured
there that is as near to it as the pixel's own footprint on the surface is wide, and as near to the
plane of its face as the point's deviation and some of a pixel allow: a wall that is seen at a
grazing angle is not measured by the points of what stands before it.  What hides a sample has its
point elsewhere; where that is not so, at an edge, as many samples are taken for measured as are
missed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.triangulation import PointCloud
from slbench.rig import Pose, Rig
from slbench.rig.pose import product
from slbench.simulate.viewpoints.samples import SurfaceSamples
from slbench.simulate.viewpoints.views import MAX_INCIDENCE_DEG, within_incidence

Array = NDArray[np.float64]

#: Half diagonals of a pixel's footprint within which its point is the sample's: on a plane 1 does.
_FOOTPRINTS = 1.5
#: Pixels, seen squarely, by which the point may be off the plane of the sample's face: room for
#: curvature and edges, less where a face is seen at a grazing angle.
_OFF_PLANE = 0.5
#: Standard deviations of the point that are allowed beside it.
_SIGMAS = 4.0


def measured_samples(
    samples: SurfaceSamples,
    pose: Pose,
    rig: Rig,
    cloud: PointCloud,
    points: Array,
    usable: NDArray[np.bool_],
    max_incidence_deg: float = MAX_INCIDENCE_DEG,
) -> Array:
    """Return the deviations with which a view measured the samples, (N,), mm; NaN where not.

    Parameters
    ----------
    samples : SurfaceSamples
        Of the part.
    pose : Pose
        Of the part in the view.
    rig : Rig
    cloud : PointCloud
        Of the view: pixels and deviations.
    points : (M, 3) float
        Its points in the part's frame.
    usable : (M,) bool
        Points that count.
    max_incidence_deg : float
        Of the samples that count.
    """
    world, normals = pose.to_world(samples.points), product(samples.normals, pose.rotation.T)
    camera = rig.camera
    pixel, jacobian = camera.project_with_jacobian(world)
    toward = camera.chief_origin(world) - world
    with np.errstate(invalid="ignore"):
        seen = camera.contains(pixel) & (np.sum(toward * normals, axis=1) > 0.0)
        seen &= within_incidence(rig, world, normals, max_incidence_deg)
    found = np.full(len(samples), np.nan)
    kept = np.flatnonzero(seen)
    row = np.full(cloud.shape, -1, np.int64)
    of_image = np.flatnonzero(usable)
    u, v = cloud.pixels[of_image].T
    row[v, u] = of_image
    at = np.floor(pixel[kept] + 0.5).astype(np.int64)
    point = row[at[:, 1], at[:, 0]]
    kept, point = kept[point >= 0], point[point >= 0]
    sigma = cloud.sigma_total_mm[point]
    across, square = _footprint(jacobian[kept], normals[kept])
    off = points[point] - samples.points[kept]
    away = np.abs(np.sum(off * samples.normals[kept], axis=1))
    facing = np.sum(toward[kept] * normals[kept], axis=1) / np.linalg.norm(toward[kept], axis=1)
    near = np.linalg.norm(off, axis=1) <= _FOOTPRINTS * across + _SIGMAS * sigma
    pixel_size = square * np.sqrt(facing)
    near &= away <= pixel_size * np.minimum(_OFF_PLANE, facing) + _SIGMAS * sigma * facing
    found[kept[near]] = sigma[near]
    return found


def _footprint(jacobian: Array, normals: Array) -> tuple[Array, Array]:
    """Return what a pixel's footprint on the surface measures, mm.

    Parameters
    ----------
    jacobian : (n, 2, 3) float
        Derivative of the pixel by the point.
    normals : (n, 3) float

    Returns
    -------
    across : (n,) float
        Half its longer diagonal.
    square : (n,) float
        The side of a square of the same area.
    """
    # Steps on the tangent plane that move the image by one pixel.
    rows = np.concatenate((jacobian, normals[:, np.newaxis]), axis=1)
    steps = np.linalg.inv(rows)[:, :, :2]
    a, b = steps[..., 0], steps[..., 1]
    across = 0.5 * np.maximum(np.linalg.norm(a + b, axis=1), np.linalg.norm(a - b, axis=1))
    return across, np.sqrt(np.linalg.norm(np.cross(a, b), axis=1))
