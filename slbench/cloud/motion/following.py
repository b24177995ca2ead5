"""Where the points that pixels see at time zero are in each picture, and on the panel.

A pixel of time zero sees the point X.  By the motion it is at X(t) when a picture is taken: camera
pixel c(t) sees it there, lit by panel place p(t).  Pixels without a point have the displacements of
the nearest one that has.

*Brightness.*  A point that moves through the projector's light is lit by more or less of it, and
seen through another part of the camera's lens: in relation to time zero by the factor

    E(X(t)) / E(X) times V(c(t)) / V(c),

where E is the irradiance of a matt surface, by distance, the angles at surface and projector, and
its lens; and V the camera's fall-off.  Gloss is not known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from slbench.cloud.normals import image_normals
from slbench.cloud.triangulation import PointCloud
from slbench.rig import Projector, Rig
from slbench.rig.motion import FrameTiming, Moving

Array = NDArray[np.float64]
#: Changes of brightness beyond which something is wrong with a point.
_LEAST_LIGHT, _MOST_LIGHT = 0.2, 5.0


class Following:
    """Points followed through the pictures of a capture.

    Parameters
    ----------
    rig : Rig
    cloud : PointCloud
        Points of time zero, at least one.
    timing : FrameTiming
    middles : (M,) float
        Time of each picture's middle row, s.
    pixels : (P,) int, optional
        Flat indices of the pixels to follow; all by default.
    """

    def __init__(
        self,
        rig: Rig,
        cloud: PointCloud,
        timing: FrameTiming,
        middles: Array,
        pixels: NDArray[np.intp] | None = None,
    ) -> None:
        self._rig, self._timing, self._middles = rig, timing, middles
        image = cloud.image(cloud.points)
        nearest = _nearest(np.isfinite(image[..., 0])).ravel()
        chosen = np.arange(nearest.size) if pixels is None else pixels
        rows, columns = np.divmod(chosen, image.shape[1])
        #: Camera pixel (u, v) of each, (P, 2).
        self.own = np.stack((columns, rows), axis=1).astype(np.float64)
        source, self._index = np.unique(nearest[chosen], return_inverse=True)
        self._points = image.reshape(-1, 3)[source]
        self._pixels = np.stack(np.divmod(source, image.shape[1])[::-1], axis=1).astype(np.float64)
        self._delays = timing.delays(image.shape[0])
        self._panel = rig.projector.project(self._points)
        self._normals = image_normals(image).reshape(-1, 3)[source]
        self._light = self._brightness(self._points, self._normals, self._pixels)

    def at(self, picture: int, moving: Moving) -> tuple[Array, Array, Array]:
        """Return what moves until a picture is taken.

        Parameters
        ----------
        picture : int
        moving : callable
            The motion of the points.

        Returns
        -------
        pixels : (P, 2) float
            Camera pixel (u, v) that sees in the picture what each sees at time zero.
        shift : (P, 2) float
            By how much its panel coordinates have grown, px.
        light : (P,) float
            Its brightness, by that at time zero.
        """
        middle, rolling = self._middles[picture], self._timing.rolling_s
        points = moving(middle).to_world(self._points)
        if rolling:
            # Between its first row and its last, motion is as good as straight.
            first, last = (
                moving(middle + end * rolling).to_world(self._points) for end in (-0.5, 0.5)
            )
            for _ in range(2):  # a point is seen by the row that it is in by then
                row = self._rig.camera.project(points)[:, 1]
                rows = np.arange(len(self._delays))
                delay = np.interp(np.nan_to_num(row), rows, self._delays)
                share = (delay / rolling + 0.5)[:, np.newaxis]
                points = first + share * (last - first)
        with np.errstate(invalid="ignore"):
            seen = self._rig.camera.project(points)
            shift = self._rig.projector.project(points) - self._panel
            normals = self._normals @ moving(middle).rotation.T
            light = self._brightness(points, normals, seen) / self._light
        light = np.clip(np.nan_to_num(light, nan=1.0), _LEAST_LIGHT, _MOST_LIGHT)
        way = seen - self._pixels
        return self.own + way[self._index], shift[self._index], light[self._index]

    def _brightness(self, points: Array, normals: Array, pixels: Array) -> Array:
        """Return the brightness of matt points at camera pixels, on any scale."""
        lit = _irradiance(self._rig.projector, points, normals)
        return np.asarray(lit * self._rig.camera.relative_illumination(pixels))


def _irradiance(projector: Projector, points: Array, normals: Array) -> Array:
    """Return the white panel's irradiance of points (P, 3), on any scale.

    Without normals (NaN) it is that of surfaces that face the projector.
    """
    local = projector.pose.to_local(points)
    distance = np.linalg.norm(local, axis=1)
    towards = projector.pose.position - points
    if projector.lens.kind == "telecentric":
        towards = np.broadcast_to(-projector.pose.rotation[:, 2], points.shape)
        fall_off = np.ones(len(points))
    elif projector.lens.natural_vignetting:
        fall_off = local[:, 2] / distance**3
    else:
        fall_off = distance / local[:, 2] ** 3
    cosine = np.abs(np.sum(normals * towards, axis=1)) / np.linalg.norm(towards, axis=1)
    return np.asarray(fall_off * np.where(np.isnan(cosine), 1.0, cosine))


def _nearest(known: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the flat index of the nearest pixel that is known, (V, U)."""
    rows, columns = ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    return np.asarray(rows * known.shape[1] + columns, dtype=np.intp)
