"""Triangulation: from panel coordinates to points with their uncertainty.

One coded axis: a camera pixel's ray meets the surface of points that the projector sees in
panel column ``u`` (thesis eq. 9-12; a plane through the nodal point, unless the lens
distorts).  Two coded axes: the point of the camera's ray, which is exact, whose panel coordinates
are nearest to the decoded ones, each by its own standard deviation: an axis that tells little of
the distance has little weight, and two axes are never worse than one.  The thesis takes the point
nearest to both rays in the least-squares sense, whatever is known of them (``"nearest"``).

Each point carries its *sensitivity*, the derivative of the point by the panel coordinate; with
the coordinate's standard deviation it gives the covariance that noise in the phase causes.  Beside
it stands what does not repeat to zero: steady errors of the coordinate, and the calibration's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.cloud.rays import closest, meet_curves
from slbench.core.errors import InputError
from slbench.core.show.display import block, length
from slbench.core.show.drawing import figure
from slbench.core.validation.values import checked
from slbench.patterns import PhaseMap
from slbench.rig import Device, Pose, Rig
from slbench.rig.pose import product

Array = NDArray[np.float64]
Axis = Literal["u", "v"]
#: Where the point of two coded axes is.
Meeting = Literal["ray", "nearest"]

#: Points handled together: bounds the temporaries of a pass to some 200 MB.
_POINTS_PER_PASS = 1 << 18
#: Deviation of a coordinate that has none: two of them weigh the same.
_EXACT_PX = 1e-9


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Measured points, in the order of their pixels (row-major).

    Parameters
    ----------
    points : (N, 3) float
        World coordinates, mm.
    pixels : (N, 2) int
        Camera pixel (u, v) of each point.
    shape : (int, int)
        Camera image (V, U).
    axes : tuple of "u", "v"
        Coded axes, A of them.
    sigma_px : (N, A) float
        Predicted standard deviation of the panel coordinates, px.
    sensitivity : (N, A, 3) float
        Derivative of the point by the panel coordinate, mm/px.
    steady_px : (N, A) float, optional
        Standard deviation of the panel coordinates' errors that no repeat averages out, px; by
        default none is known.
    calibration_mm2 : (N, 3, 3) float, optional
        Covariance that the calibration's own uncertainty gives the points, mm^2.
    """

    points: Array
    pixels: NDArray[np.int32]
    shape: tuple[int, int]
    axes: tuple[Axis, ...]
    sigma_px: Array
    sensitivity: Array
    steady_px: Array | None = None
    calibration_mm2: Array | None = None

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        rows, columns = self.shape
        head = f"PointCloud of {len(self)} points, camera {columns} x {rows} px"
        if not len(self):
            return block(head)
        limits = zip("xyz", self.points.min(axis=0), self.points.max(axis=0), strict=True)
        return block(
            head,
            ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in limits) + " mm",
            f"standard deviation by noise {length(float(np.median(self.sigma_total_mm)))}, "
            f"uncertainty {length(float(np.nanmedian(self.u_total_mm)))} (medians)",
        )

    @property
    def covariance(self) -> Array:
        """Covariance of each point, (N, 3, 3), mm^2: ``sum_a sigma_a^2 s_a s_a^T``."""
        scaled = self.sensitivity * self.sigma_px[..., None]
        return np.einsum("nai,naj->nij", scaled, scaled)

    @property
    def sigma_mm(self) -> Array:
        """Standard deviation that noise causes per world axis, (N, 3), mm."""
        return np.sqrt(np.sum((self.sensitivity * self.sigma_px[..., None]) ** 2, axis=1))

    @property
    def sigma_total_mm(self) -> Array:
        """Standard deviation of the distance to the point without noise, (N,), mm."""
        return np.sqrt(np.sum(self.sigma_mm**2, axis=1))

    @property
    def u_mm(self) -> Array:
        """Standard uncertainty per world axis, (N, 3), mm: noise and all else that is known."""
        of_panel = (
            self.sigma_px if self.steady_px is None else np.hypot(self.sigma_px, self.steady_px)
        )
        variance = np.sum((self.sensitivity * of_panel[..., None]) ** 2, axis=1)
        if self.calibration_mm2 is not None:
            variance += np.diagonal(self.calibration_mm2, axis1=1, axis2=2)
        return np.sqrt(variance)

    @property
    def u_total_mm(self) -> Array:
        """Standard uncertainty of the distance to the true point, (N,), mm."""
        return np.sqrt(np.sum(self.u_mm**2, axis=1))

    def moved(self, motion: Pose) -> PointCloud:
        """Return the cloud after a rigid motion: its ``to_world``."""
        turn, known = motion.rotation, self.calibration_mm2
        return replace(
            self,
            points=motion.to_world(self.points),
            sensitivity=product(self.sensitivity, turn.T),
            calibration_mm2=None if known is None else turn @ known @ turn.T,
        )

    def with_steady(self, steady_px: Mapping[Axis, ArrayLike]) -> PointCloud:
        """Return the cloud with a steady error more.

        Parameters
        ----------
        steady_px : mapping of axis to float or (V, U) float
            Its standard deviation by axis, px; NaN, and an axis that is not named, are none.
        """
        u, v = self.pixels.T
        columns = [
            np.broadcast_to(steady_px.get(axis, 0.0), self.shape)[v, u] for axis in self.axes
        ]
        own = np.nan_to_num(np.stack(columns, axis=1).astype(np.float64))
        known = 0.0 if self.steady_px is None else self.steady_px
        return replace(self, steady_px=np.hypot(known, own))

    def chosen(self, kept: NDArray[np.bool_] | slice) -> PointCloud:
        """Return the cloud of some of its points."""
        of_points = ("points", "pixels", "sigma_px", "sensitivity", "steady_px", "calibration_mm2")
        values = {name: getattr(self, name) for name in of_points}
        parts = {name: own[kept] for name, own in values.items() if own is not None}
        return replace(self, **parts)

    def plot(self) -> Any:
        """Return a matplotlib figure: heights, predicted deviations, the points from above."""
        return figure(self)

    def image(self, values: NDArray) -> Array:
        """Spread values (N,) or (N, k) over the camera image, NaN elsewhere."""
        result = np.full((*self.shape, *values.shape[1:]), np.nan)
        result[self.pixels[:, 1], self.pixels[:, 0]] = values
        return result


@checked
def triangulate(rig: Rig, phase: PhaseMap, meeting: Meeting = "ray") -> PointCloud:
    """Triangulate every decoded pixel.

    Parameters
    ----------
    rig : Rig
    phase : PhaseMap
        Panel coordinates of one or two axes for the rig's camera.
    meeting : {"ray", "nearest"}
        Where the point of two coded axes is: on the camera's ray, both coordinates weighted by
        their deviations, or nearest to both rays (thesis 3.1.4).

    Returns
    -------
    PointCloud
        Points in front of both devices; a pixel whose rays do not meet there is dropped.

    Raises
    ------
    InputError
        If the phase map is not of the camera's size.
    """
    camera = rig.camera
    if phase.mask.shape != (camera.height, camera.width):
        raise InputError(
            "phase map",
            f"the camera's {camera.width} x {camera.height} px",
            f"{phase.mask.shape[1]} x {phase.mask.shape[0]} px",
        )
    axes: tuple[Axis, ...] = tuple(phase.coordinate)
    v, u = np.nonzero(phase.mask)
    pixels = np.column_stack((u, v)).astype(np.int32)
    panel = np.stack([phase.coordinate[axis][v, u] for axis in axes], axis=-1)
    sigma = np.stack([phase.sigma[axis][v, u] for axis in axes], axis=-1)
    points, sensitivity = meet(rig, pixels, axes, panel, sigma, meeting)
    with np.errstate(invalid="ignore"):  # parallel rays meet at infinities of either sign
        good = np.isfinite(points.sum(axis=-1)) & np.isfinite(sensitivity.sum(axis=(1, 2)))
    if not good.all():
        points, pixels = points[good], pixels[good]
        sigma, sensitivity = sigma[good], sensitivity[good]
    return PointCloud(points, pixels, phase.mask.shape, axes, sigma, sensitivity)


def meet(
    rig: Rig,
    pixels: NDArray[Any],
    axes: tuple[Axis, ...],
    panel: Array,
    sigma: Array,
    meeting: Meeting = "ray",
) -> tuple[Array, Array]:
    """Return the points of pixels, whatever of the image they are.

    Parameters
    ----------
    rig : Rig
    pixels : (N, 2) int or float
        Camera pixels (u, v), or places between them.
    axes : tuple of "u", "v"
        Coded axes, A of them.
    panel, sigma : (N, A) float
        Panel coordinates and their standard deviations, px.
    meeting : {"ray", "nearest"}
        As :func:`triangulate` has it.

    Returns
    -------
    points : (N, 3) float
        World coordinates, mm; not finite where rays do not meet in front of both devices.
    sensitivity : (N, A, 3) float
        Derivative of the point by the panel coordinates, mm/px.
    """
    points = np.full((len(pixels), 3), np.nan)
    sensitivity = np.full((len(pixels), len(axes), 3), np.nan)
    for first in range(0, len(pixels), _POINTS_PER_PASS):
        part = slice(first, first + _POINTS_PER_PASS)
        origins, directions = rig.camera.unproject(pixels[part])
        if len(axes) == 1:
            result = intersect_axis(rig.projector, origins, directions, panel[part, 0], axes[0])
            points[part], sensitivity[part, 0] = result
        else:
            order = [axes.index("u"), axes.index("v")]
            target = panel[part][:, order]
            if meeting == "nearest":
                result = nearest_points(rig.projector, origins, directions, target)
            else:
                own = sigma[part][:, order]
                result = weighted_points(rig.projector, origins, directions, target, own)
            points[part], sensitivity[part] = result[0], result[1][:, order]
    return points, sensitivity


def intersect_axis(
    projector: Device, origins: Array, directions: Array, panel: Array, axis: Axis
) -> tuple[Array, Array]:
    """Intersect camera rays with the surfaces of constant panel coordinate.

    Without distortion and tilt the surface is a plane and the answer closed; with them it is
    the start of Newton's method along the ray.

    Parameters
    ----------
    projector : Device
    origins, directions : (N, 3) float
        Camera rays in world coordinates, directions of unit length.
    panel : (N,) float
        Panel coordinate along `axis`, px.
    axis : {"u", "v"}

    Returns
    -------
    points : (N, 3) float
        NaN where a ray does not meet the surface in front of both devices.
    sensitivity : (N, 3) float
        Derivative of the point by the panel coordinate, mm/px.
    """
    k = 0 if axis == "u" else 1
    origin = projector.pose.to_local(origins)
    direction = product(directions, projector.pose.rotation)
    per_unit = projector.lens.focal_length_mm / projector.pitch_mm[k]
    with np.errstate(invalid="ignore", divide="ignore"):
        x = (panel - projector.centre[k]) / per_unit
        distance, slope = _meet_plane(projector, origin, direction, x, k)
        slope = slope / per_unit
        if any(projector.distortion) or any(projector.tilt_rad):
            target = np.ascontiguousarray(panel)
            meet_curves(projector.optics, origins, directions, target, k, distance, slope)
        ahead = (distance > 0) & (origin[:, 2] + distance * direction[:, 2] > 0)
        distance = np.where(ahead, distance, np.nan)
    return origins + distance[:, None] * directions, directions * slope[:, None]


def _meet_plane(
    projector: Device, origin: Array, direction: Array, x: Array, k: int
) -> tuple[Array, Array]:
    """Meet the plane of normalised coordinate `x` along axis `k`, in the projector's frame.

    Returns the distance along each ray and its derivative by `x`.
    """
    if projector.lens.kind == "telecentric":
        focus = projector.lens.focus_distance_mm
        return (x * focus - origin[:, k]) / direction[:, k], focus / direction[:, k]
    # (o + t d)_k = x (o + t d)_z
    across = direction[:, k] - x * direction[:, 2]
    distance = (x * origin[:, 2] - origin[:, k]) / across
    return distance, (origin[:, 2] + distance * direction[:, 2]) / across


def weighted_points(
    projector: Device, origins: Array, directions: Array, panel: Array, sigma: Array
) -> tuple[Array, Array]:
    """Return the points of camera rays whose panel coordinates are the most likely.

    The ray meets the surface of the coordinate that tells the more of the distance; a step of
    Gauss and Newton takes the other one in, by what both are worth.

    Parameters
    ----------
    projector : Device
    origins, directions : (N, 3) float
        Camera rays in world coordinates, directions of unit length.
    panel, sigma : (N, 2) float
        Panel coordinates (u, v) and their standard deviations, px.

    Returns
    -------
    points : (N, 3) float
        NaN where a ray does not meet the surface in front of both devices.
    sensitivity : (N, 2, 3) float
        Derivative of the point by u and v, mm/px.
    """
    points = np.full(origins.shape, np.nan)
    poorest = np.full(len(points), np.inf)
    sigma = np.maximum(sigma, _EXACT_PX)
    axes: tuple[Axis, ...] = ("u", "v")
    for k, axis in enumerate(axes):
        found, slope = intersect_axis(projector, origins, directions, panel[:, k], axis)
        with np.errstate(invalid="ignore"):
            own = np.linalg.norm(slope, axis=1) * sigma[:, k]
            better = (own < poorest) & np.isfinite(found[:, 0])
        points[better], poorest[better] = found[better], own[better]
    pixels, jacobian = projector.project_with_jacobian(points)
    along = np.einsum("nki,ni->nk", jacobian, directions)  # px/mm
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = along / sigma**2
        total = np.sum(weight * along, axis=1)
        distance = np.sum(weight * (panel - pixels), axis=1) / total
        points += distance[:, None] * directions
        sensitivity = (weight / total[:, None])[..., None] * directions[:, None]
    return points, sensitivity


def nearest_points(
    projector: Device, origins: Array, directions: Array, panel: Array
) -> tuple[Array, Array]:
    """Return the least-squares points of camera rays and projector rays.

    The point nearest to two lines is the middle of their common perpendicular.

    Parameters
    ----------
    projector : Device
    origins, directions : (N, 3) float
        Camera rays in world coordinates, directions of unit length.
    panel : (N, 2) float
        Panel coordinates (u, v), px.

    Returns
    -------
    points : (N, 3) float
        NaN where the rays are parallel or come nearest behind a device.
    sensitivity : (N, 2, 3) float
        Derivative of the point by u and v, mm/px.
    """
    points, sensitivity = np.empty((len(panel), 3)), np.empty((len(panel), 2, 3))
    target = np.ascontiguousarray(panel)
    closest(projector.optics, origins, directions, target, points, sensitivity)
    return points, sensitivity
