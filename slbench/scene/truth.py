"""Exact ground truth of one view: what each camera pixel's centre ray meets.

Made by :mod:`slbench.simulate.render` in double precision; this module is the value and its file
(EXR), usable without Mitsuba.
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

Array = NDArray[np.float64]


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
    """

    point: Array
    normal: Array
    depth: Array
    panel: Array
    status: NDArray[np.uint8]
    object_id: NDArray[np.int32]
    camera_coc: Array
    projector_coc: Array

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

    def save(self, path: str | Path) -> None:
        """Write as EXR (float32: 0.01 um at 100 mm, 1e-4 px at 1000 px)."""
        channels: dict[str, NDArray] = {"depth.Z": self.depth.astype(np.float32)}
        for axis, name in enumerate("XYZ"):
            channels[f"point.{name}"] = self.point[..., axis].astype(np.float32)
            channels[f"normal.{name}"] = self.normal[..., axis].astype(np.float32)
        for axis, name in enumerate("uv"):
            channels[f"panel.{name}"] = self.panel[..., axis].astype(np.float32)
        channels["coc.camera"] = self.camera_coc.astype(np.float32)
        channels["coc.projector"] = self.projector_coc.astype(np.float32)
        channels["status"] = self.status.astype(np.uint32)
        # EXR integers are unsigned: 0 is "missed", object k is k + 1.
        channels["object"] = (self.object_id + 1).astype(np.uint32)
        write_exr(path, channels)

    @classmethod
    def load(cls, path: str | Path) -> GroundTruth:
        """Read what :meth:`save` wrote."""
        channels = read_exr(path)

        def stack(group: str, names: str) -> Array:
            return np.stack([channel(f"{group}.{name}") for name in names], axis=-1)

        def channel(name: str) -> Array:
            if name not in channels:
                raise InputError(f"{path}: {name}", "this channel", sorted(channels))
            return np.asarray(channels[name], dtype=np.float64)

        return cls(
            point=stack("point", "XYZ"),
            normal=stack("normal", "XYZ"),
            depth=channel("depth.Z"),
            panel=stack("panel", "uv"),
            status=channel("status").astype(np.uint8),
            object_id=channel("object").astype(np.int32) - 1,
            camera_coc=channel("coc.camera"),
            projector_coc=channel("coc.projector"),
        )
