"""Exact ground truth of one view: what each camera pixel's centre ray meets.

Made by :mod:`slbench.simulate.render` in double precision; this module is the value and its file
(EXR), usable without Mitsuba.  The file holds all, for whoever reads EXR; or, where the rig stands
beside it, what does not follow from the rig.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.io import read_exr, write_exr
from slbench.core.show.display import block, share
from slbench.rig import Camera, Rig
from slbench.rig.opencv import read_rig

Array = NDArray[np.float64]

_AXES = "XYZ"
#: Least cosine between a ray and the world axis of the coordinate that stands for its point: the
#: others are then off by five times that one's rounding at most.
_LEAST_COSINE = 0.2
#: Pixels completed together: bounds the temporaries to some 100 MB.
_PIXELS_PER_PASS = 1 << 19


class Status(IntEnum):
    """What became of a pixel's centre ray."""

    MISSED = 0  #: it met no object
    LIT = 1  #: the point it met sees the projector, inside the panel
    SHADOWED = 2  #: the point faces away from the projector, or something stands between
    OUTSIDE = 3  #: the point sees the projector, but beyond the panel's edge


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth per camera pixel; arrays are NaN (object: -1) where the ray missed.

    Parameters
    ----------
    point : (V, U, 3) float
        World point on the surface, mm.
    normal : (V, U, 3) float
        Unit geometric normal, towards the camera.
    depth : (V, U) float
        Depth along the camera's optical axis, mm.
    panel : (V, U, 2) float
        Projector pixel (u, v) that sees the point through the lens centre; also given where
        the point is shadowed.
    status : (V, U) uint8
        :class:`Status`.
    object_id : (V, U) int32
        Index of the object in the scene.
    camera_coc, projector_coc : (V, U) float
        Circle of confusion of camera and projector, in their own pixels.
    camera_spread, projector_spread : (V, U) float
        Radius that holds half of a point's light, by defocus, diffraction and blur together, in
        their own pixels.  A disc of diameter ``c`` has ``c / sqrt(8)``.
    """

    point: Array
    normal: Array
    depth: Array
    panel: Array
    status: NDArray[np.uint8]
    object_id: NDArray[np.int32]
    camera_coc: Array
    projector_coc: Array
    camera_spread: Array
    projector_spread: Array

    def __repr__(self) -> str:
        rows, columns = self.status.shape
        shares = (f"{share(np.mean(self.status == one))} {one.name.lower()}" for one in Status)
        count = len(np.unique(self.object_id[self.object_id >= 0]))
        return block(
            f"GroundTruth {columns} x {rows} px: {', '.join(shares)}",
            f"{count} {'object' if count == 1 else 'objects'} in view",
        )

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Pixels whose centre ray meets a lit point, (V, U)."""
        return self.status == Status.LIT

    def smooth(self, tolerance_px: float = 0.05) -> NDArray[np.bool_]:
        """Pixels in whose 3 x 3 neighbourhood the panel coordinate is smooth.

        All nine are lit, belong to one object, and the second differences of both panel
        coordinates stay below `tolerance_px`.  There a pixel's footprint is a small
        parallelogram of one surface, and its mean panel coordinate is that of its centre ray;
        on edges no single value is right.

        Returns
        -------
        (V, U) bool
        """
        lit = self.lit
        smooth = np.zeros_like(lit)
        if min(lit.shape) < 3:
            return smooth
        core = np.ones((lit.shape[0] - 2, lit.shape[1] - 2), bool)
        rows, columns = lit.shape
        centre_id = self.object_id[1:-1, 1:-1]
        for dv in range(3):
            for du in range(3):
                window = np.s_[dv : rows - 2 + dv, du : columns - 2 + du]
                core &= lit[window] & (self.object_id[window] == centre_id)
        with np.errstate(invalid="ignore"):
            for axis in range(2):
                p = self.panel[..., axis]
                # One difference at a time: images of a large sensor are large.
                core &= np.abs(p[1:-1, 2:] - 2 * p[1:-1, 1:-1] + p[1:-1, :-2]) < tolerance_px
                core &= np.abs(p[2:, 1:-1] - 2 * p[1:-1, 1:-1] + p[:-2, 1:-1]) < tolerance_px
                twist = p[2:, 2:] - p[2:, :-2] - p[:-2, 2:] + p[:-2, :-2]
                core &= np.abs(twist) < 4.0 * tolerance_px
        smooth[1:-1, 1:-1] = core
        return smooth

    @property
    def instances(self) -> NDArray[np.uint16]:
        """Instance mask (V, U): 0 where no object is, k + 1 for the scene's object k."""
        return (self.object_id + 1).astype(np.uint16)

    def save(self, path: str | Path, rig: Rig | None = None) -> None:
        """Write as EXR (float32: 0.01 um at 100 mm, 1e-4 px at 1000 px).

        Parameters
        ----------
        path : str or Path
        rig : Rig, optional
            Camera and projector of this truth.  Then what follows from them is left out: of the
            point one coordinate is kept, which the pixel's ray completes, and neither depth nor
            panel coordinate nor circles of confusion.  The file is several times smaller.
        """
        channels: dict[str, NDArray] = {}
        axis = None if rig is None else self._kept_axis(rig.camera)
        if axis is None:
            channels = self._derived_channels()
        for k, name in enumerate(_AXES):
            if axis in (None, k):
                channels[f"point.{name}"] = self.point[..., k].astype(np.float32)
            channels[f"normal.{name}"] = self.normal[..., k].astype(np.float32)
        channels["status"] = self.status.astype(np.uint32)
        # EXR integers are unsigned: 0 is "missed", object k is k + 1.
        channels["object"] = (self.object_id + 1).astype(np.uint32)
        write_exr(path, channels)

    def _derived_channels(self) -> dict[str, NDArray]:
        """Return the channels that follow from a point and the devices."""
        channels: dict[str, NDArray] = {"depth.Z": self.depth.astype(np.float32)}
        for k, name in enumerate("uv"):
            channels[f"panel.{name}"] = self.panel[..., k].astype(np.float32)
        channels["coc.camera"] = self.camera_coc.astype(np.float32)
        channels["coc.projector"] = self.projector_coc.astype(np.float32)
        channels["spread.camera"] = self.camera_spread.astype(np.float32)
        channels["spread.projector"] = self.projector_spread.astype(np.float32)
        return channels

    def _kept_axis(self, camera: Camera) -> int | None:
        """Return the world axis along which the camera looks, if all rays do well enough.

        A coordinate along it is constant on what faces the camera squarely, so it deflates well,
        and the ray's other coordinates are off by its rounding times the slope of the ray.
        """
        axis = int(np.argmax(np.abs(camera.pose.rotation[:, 2])))
        point = self.point[self.object_id >= 0]
        ray = point - camera.chief_origin(point)
        steep = np.abs(ray[:, axis]) >= _LEAST_COSINE * np.linalg.norm(ray, axis=1)
        return axis if bool(np.all(steep)) else None

    @classmethod
    def load(cls, path: str | Path, rig: Rig | None = None) -> GroundTruth:
        """Read what :meth:`save` wrote.

        Parameters
        ----------
        path : str or Path
        rig : Rig, optional
            Camera and projector that a file without what follows from them is completed with; by
            default that of the ``rig.yaml`` beside it.

        Raises
        ------
        InputError
            If the file is damaged, lacks a channel, or is of another size than the rig's camera.
        """
        size = None if rig is None else (rig.camera.height, rig.camera.width)
        channels = read_exr(path, size)

        def stack(group: str, names: str) -> Array:
            return np.stack([channel(f"{group}.{name}") for name in names], axis=-1)

        def channel(name: str) -> Array:
            if name not in channels:
                raise InputError(f"{path}: {name}", "this channel", sorted(channels))
            return np.asarray(channels[name], dtype=np.float64)

        kept = [k for k, name in enumerate(_AXES) if f"point.{name}" in channels]
        if len(kept) == 1:
            coordinate = channel(f"point.{_AXES[kept[0]]}")
            rig = read_rig(Path(path).with_name("rig.yaml")) if rig is None else rig
            camera = rig.camera
            if coordinate.shape != (camera.height, camera.width):
                rows, columns = coordinate.shape
                expected = f"the camera's {camera.width} x {camera.height} px"
                raise InputError(path, expected, f"{columns} x {rows} px")
            point, depth, panel, *circles = _completed(rig, kept[0], coordinate)
            spreads = [
                device.spread.radius(circle)
                for device, circle in zip((camera, rig.projector), circles, strict=True)
            ]
        else:
            point, depth = stack("point", _AXES), channel("depth.Z")
            panel = stack("panel", "uv")
            circles = [channel("coc.camera"), channel("coc.projector")]
            # Files from before there was more than defocus are of discs.
            spreads = [circle / np.sqrt(8.0) for circle in circles]
            if "spread.camera" in channels:
                spreads = [channel("spread.camera"), channel("spread.projector")]
        return cls(
            point=point,
            normal=stack("normal", _AXES),
            depth=depth,
            panel=panel,
            status=channel("status").astype(np.uint8),
            object_id=channel("object").astype(np.int32) - 1,
            camera_coc=circles[0],
            projector_coc=circles[1],
            camera_spread=spreads[0],
            projector_spread=spreads[1],
        )


def _completed(rig: Rig, axis: int, coordinate: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return what follows from one world coordinate of every pixel's point (V, U).

    Points, depths, panel coordinates, circles of confusion of camera and projector.
    """
    camera, projector = rig.camera, rig.projector
    shape = coordinate.shape
    points, panel = np.empty((*shape, 3)), np.empty((*shape, 2))
    depth, camera_coc, projector_coc = np.empty(shape), np.empty(shape), np.empty(shape)
    step = max(1, _PIXELS_PER_PASS // shape[1])
    for first in range(0, shape[0], step):
        rows = slice(first, min(first + step, shape[0]))
        v, u = np.mgrid[rows, 0 : shape[1]].astype(np.float64)
        origins, directions = camera.unproject(np.stack((u, v), axis=-1))
        with np.errstate(invalid="ignore", divide="ignore"):
            distance = (coordinate[rows] - origins[..., axis]) / directions[..., axis]
        point = origins + distance[..., None] * directions
        point[..., axis] = coordinate[rows]
        points[rows] = point
        depth[rows] = camera.pose.to_local(point)[..., 2]
        panel[rows] = projector.project(point)
        camera_coc[rows] = camera.circle_of_confusion(point)
        projector_coc[rows] = projector.circle_of_confusion(point)
    return points, depth, panel, camera_coc, projector_coc
