"""From placed devices to the matrices that the evaluator's kernels work with.

Everything here is done for all configurations at once, as stacks of small matrices; the
kernels then see pixels only.  What the hardware alone determines is computed once: a search
evaluates thousands of batches of a dozen configurations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.design.rig.hardware import Hardware, Placement
from slbench.design.rig.kernels import loops
from slbench.design.rig.kernels.rows import EDGES
from slbench.rig import Device, Pose
from slbench.rig.optics.distortion import fold_radius

Array = NDArray[np.float64]

#: More pixels than this on all planes: the threads share a configuration, not the batch.
_LARGE = 200_000
#: Points on the volume's faces are inside: a million times the rounding of a coordinate.
_WITHIN = 1.0 + 1e-9
#: Safety of the sampled bound on how close distorted rays can be.
_DISTORTED_STEP = 0.9


class Maps:
    """The maps of one hardware at given planes and strides, for patterns along `axes`.

    The kernels know one coded axis, the panel's first.  Where rows are coded, the maps to the
    panel have u and v exchanged; correspondences are the same.

    A telecentric lens keeps its magnification when it is focused elsewhere, so the principal
    and focus distances of the hardware serve for all configurations.
    """

    def __init__(
        self,
        hardware: Hardware,
        planes: Array,
        strides: tuple[int, int],
        axes: str,
        edges: bool = False,
    ) -> None:
        self.hardware, self.planes, self.strides = hardware, planes, strides
        self.coded_axes = EDGES if edges else len(axes)
        self._order = [1, 0] if axes == "v" else [0, 1]
        camera, projector = hardware.camera, hardware.projector
        self.rows = -(-camera.height // strides[1])
        self.columns = -(-camera.width // strides[0])
        self.distorted = any(camera.distortion) or any(projector.distortion)
        self.telecentric = _telecentric(projector)
        self.flat_camera = replace(camera, pose=Pose())
        self.flat_projector = replace(projector, pose=Pose())
        self.corners = hardware.volume_corners
        self.projector_pixels = _pixels(projector)
        self.camera_rays = np.linalg.inv(_pixels(camera))
        self.projector_rays = np.ascontiguousarray(np.linalg.inv(self.projector_pixels))
        self.half = _WITHIN * 0.5 * np.array(hardware.volume_mm)
        self.size = np.array([projector.width, projector.height], dtype=np.float64)[self._order]
        self.step = self._least_step()
        self.tables = (*self._tables(), *self._lens()) if self.distorted else ()

    def metrics(self, place: Placement) -> Array:
        """Return mu, sigma, the number of points and the dispersion, (n, 4)."""
        n = len(place.valid)
        out = np.empty((n, 4))
        windows = self._windows(place)
        matrix = self._projector_matrix(place)[:, [*self._order, 2]]
        axis, depth = self._axis_and_depth(place)
        ground = self._rays_to_plane(place)
        common = (
            self.planes,
            self.half,
            self.size,
            self.coded_axes,
            *map(
                np.ascontiguousarray,
                (
                    place.camera_position,
                    axis,
                    matrix,
                    place.projector_position,
                    place.projector_rotation,
                ),
            ),
            self.projector_rays,
            self.telecentric,
        )
        first: tuple[Any, ...]
        if self.distorted:
            fill = loops.distorted_rows
            first = (*self.tables, np.ascontiguousarray(ground))
        else:
            fill = loops.ideal_rows
            ground = ground @ self.camera_rays
            first = (np.array(self.strides), ground, self._panel(matrix, ground))
        if not self.distorted and self.planes.size * self.rows * self.columns <= _LARGE:
            loops.ideal_batch(*first, *common, depth, self.step, windows, out)
            return out
        for c in range(n):
            shape = (self.planes.size, windows[c, 1], windows[c, 3])
            error, xs, ys = np.empty(shape), np.empty(shape), np.empty(shape)
            fill(c, windows, *first, *common, error, xs, ys)
            loops.spread_rows(self.planes, error, xs, ys, depth[c], self.step, out[c])
        return out

    def silhouette(self, place: Placement) -> Array:
        """Return the volume's corners on the panel, (n, 8, 2) pixels."""
        return self.flat_projector.project(
            (self.corners - place.projector_position[:, np.newaxis]) @ place.projector_rotation
        )

    def slopes(self, place: Placement) -> Array:
        """Return how fast u and v of the panel change along the camera's rays, (n, 2, 9), px/mm.

        At the middle and the corners of the volume, without distortion; absolute values.
        """
        points = np.vstack((np.zeros(3), self.corners))
        axis, _ = self._axis_and_depth(place)
        rays = points - place.camera_position[:, np.newaxis]
        rays = rays / np.linalg.norm(rays, axis=2, keepdims=True)
        rays = np.where(np.any(axis, axis=1)[:, np.newaxis, np.newaxis], axis[:, np.newaxis], rays)
        matrix = self._projector_matrix(place)
        pixel = np.einsum("nij,kj->nik", matrix, np.column_stack((points, np.ones(len(points)))))
        change = np.einsum("nij,nkj->nik", matrix[:, :, :3], rays)
        scale = pixel[:, 2:]
        return np.abs(change[:, :2] - pixel[:, :2] / scale * change[:, 2:]) / np.abs(scale)

    def _projector_matrix(self, place: Placement) -> Array:
        """World point to panel pixel without distortion, (n, 3, 4) (thesis eq. 9)."""
        inverse = place.projector_rotation.transpose(0, 2, 1)
        world = np.concatenate((inverse, -inverse @ place.projector_position[..., None]), axis=2)
        if self.telecentric:
            world[:, :2] /= self.telecentric
            world[:, 2] = [0.0, 0.0, 0.0, 1.0]
        return self.projector_pixels @ world

    def _rays_to_plane(self, place: Placement) -> Array:
        """Undistorted camera coordinates (x, y, 1) to (X, Y, 1) on each plane, (n, p, 3, 3).

        NaN where camera or projector are not in front of the plane.
        """
        focus = _telecentric(self.hardware.camera)
        r = place.camera_rotation[:, np.newaxis]
        c = place.camera_position[:, np.newaxis]
        height = c[..., 2] - self.planes
        in_front = (height > 0) & (place.projector_position[:, 2, np.newaxis] > self.planes)
        height = np.where(in_front, height, np.nan)[..., np.newaxis]
        if not focus:
            # T = C + height / (-r3 . q) R q, times -r3 . q, which is positive for a hit.
            rows = [height * r[:, :, i] - c[..., i, np.newaxis] * r[:, :, 2] for i in (0, 1)]
            return np.stack((*rows, -r[:, :, 2] + 0.0 * height), axis=2)
        # From C + s (x, y, 0) along the camera's axis, which must point at the plane.
        down = np.where(r[:, :, 2, 2] < 0, -r[:, :, 2, 2], np.nan)
        out = np.zeros((*height.shape[:2], 3, 3))
        for i in (0, 1):
            slope = r[:, :, i, 2] / down
            out[..., i, :2] = focus * (r[:, :, i, :2] + r[:, :, 2, :2] * slope[..., np.newaxis])
            out[..., i, 2] = c[..., i] + height[..., 0] * slope
        out[..., 2, 2] = 1.0
        return out

    def _panel(self, matrix: Array, ground: Array) -> Array:
        """Camera pixel to panel pixel by way of each plane, (n, p, 3, 3)."""
        point = np.stack(
            (
                ground[:, :, 0],
                ground[:, :, 1],
                ground[:, :, 2] * self.planes[:, np.newaxis],
                ground[:, :, 2],
            ),
            axis=2,
        )
        return matrix[:, np.newaxis] @ point

    def _least_step(self) -> float:
        """Return the least distance of neighbouring rays, over that of the steepest ray.

        With the depth of a point it bounds the distance of points from below; see the kernels'
        module.
        """
        camera = self.hardware.camera
        if any(camera.distortion) or any(camera.tilt_rad):
            rays = camera.normalise(_sampled(camera, self.strides))
            step = _DISTORTED_STEP * _least_step(rays)
        else:
            corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
            rays = camera.normalise(corners * (camera.width - 1, camera.height - 1))
            pitches = np.array(camera.pitch_mm) * self.strides
            step = float(pitches.min()) / camera.lens.focal_length_mm
        furthest = float(np.sqrt(1.0 + np.max(np.sum(rays**2, axis=-1))))
        return step if _telecentric(camera) else step / furthest

    def _axis_and_depth(self, place: Placement) -> tuple[Array, Array]:
        """Return a telecentric camera's axes, (n, 3), zeros of another, and depths, (n, 4)."""
        depth = np.zeros((len(place.valid), 4))
        axis = place.camera_rotation[:, :, 2]
        telecentric = _telecentric(self.hardware.camera)
        if telecentric:
            depth[:, 3] = telecentric
            return axis, depth
        depth[:, :3] = axis
        depth[:, 3] = -np.sum(axis * place.camera_position, axis=1)
        return np.zeros_like(place.camera_position), depth

    def _windows(self, place: Placement) -> NDArray[np.int64]:
        """Top, rows, left, columns of the sampled pixels that can see the volume, (n, 4).

        The bounding box of its corners' images; all pixels where lenses distort (which bends
        the volume's edges) or a corner is behind the camera.
        """
        n = len(place.valid)
        sizes = np.array([self.columns, self.rows])
        first, last = np.zeros((n, 2)), np.tile(sizes - 1.0, (n, 1))
        if not self.distorted:
            corners = self.flat_camera.project(
                (self.corners - place.camera_position[:, np.newaxis]) @ place.camera_rotation
            )
            # One pixel more, so that rounding cannot cost a point on the volume's boundary.
            low = np.floor((corners.min(axis=1) - 1.0) / self.strides)
            high = np.ceil((corners.max(axis=1) + 1.0) / self.strides)
            seen = np.all(np.isfinite(low), axis=1, keepdims=True)
            first = np.where(seen, np.clip(low, 0, sizes), first)
            last = np.where(seen, np.clip(high, first - 1, sizes - 1), last)
        counts = last - first + 1
        window = np.stack((first[:, 1], counts[:, 1], first[:, 0], counts[:, 0]), axis=1)
        return window.astype(np.int64)

    def _tables(self) -> tuple[Array, Array]:
        """Undistorted coordinates of the camera's 3 x 3 rays, and of the panel's pixels."""
        camera, projector = self.hardware.camera, self.hardware.projector
        quarter = (-0.25, 0.0, 0.25)
        offsets = np.array([[i, j] for j in quarter for i in quarter])
        rays = camera.normalise(_sampled(camera, self.strides)[:, :, np.newaxis] + offsets)
        if self.coded_axes != 2:
            return rays, np.empty((0, 0, 2))
        return rays, projector.normalise(projector.pixel_grid())

    def _lens(self) -> tuple[tuple[Array, float], Array, Array]:
        """Return the projector's distortion, tilt and pixels for the kernel that distorts."""
        projector = self.hardware.projector
        focal = np.array([projector.matrix[0, 0], projector.matrix[1, 1]])
        tilt = np.asarray(projector.tilt_homography, dtype=np.float64)
        return (
            (np.array(projector.distortion), fold_radius(projector.distortion) ** 2),
            np.ascontiguousarray(tilt[[*self._order, 2]]),
            np.concatenate((focal[self._order], np.array(projector.centre)[self._order])),
        )


def _telecentric(device: Device) -> float:
    """Return the focus distance of a telecentric lens, 0 of any other."""
    return device.lens.focus_distance_mm if device.lens.kind == "telecentric" else 0.0


def _pixels(device: Device) -> Array:
    """Undistorted coordinates to pixels, (3, 3), homogeneous: tilt and camera matrix."""
    return device.matrix @ device.tilt_homography


def _sampled(camera: Device, strides: tuple[int, int]) -> Array:
    """Return the sampled pixels, (rows, columns, 2)."""
    u, v = np.arange(0, camera.width, strides[0]), np.arange(0, camera.height, strides[1])
    return np.stack(np.meshgrid(u, v), axis=-1).astype(np.float64)


def _least_step(rays: Array) -> float:
    """Return the least height of the cells between rays (rows, columns, 2); inf without one."""
    du, dv = np.diff(rays, axis=1), np.diff(rays, axis=0)
    if not du.size or not dv.size:
        lengths = np.linalg.norm(np.concatenate((du.reshape(-1, 2), dv.reshape(-1, 2))), axis=1)
        return float(lengths.min(initial=np.inf))
    a, b = du[:-1], dv[:, :-1]
    area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    longest = np.maximum(np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1))
    return float(np.min(area / longest))
