"""Points that were measured, whoever measured them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import block
from slbench.rig import Pose
from slbench.rig.pose import product

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MeasuredCloud:
    """Measured points and what is known of each, in any order.

    Parameters
    ----------
    points : (N, 3) float
        Finite, mm.
    normals : (N, 3) float, optional
        Unit vectors; NaN where a normal is not known.
    grey : (N,) float, optional
        Grey value of each point, in the file's own numbers.
    scalars : mapping of str to (N,) float
        Further values a point; of these ``sigma`` (standard deviation by noise), ``u`` (standard
        uncertainty) and ``error`` are lengths, mm.
    pixels : (N, 2) int, optional
        Camera pixel (u, v) of each point, where the cloud was a map.
    shape : (int, int), optional
        Of that map (V, U).
    dropped : int
        Points that were left out as they were not finite.
    unit : str
        Of the lengths in the file.
    source : str
        Where it was read.
    """

    points: Array
    normals: Array | None = None
    grey: Array | None = None
    scalars: Mapping[str, Array] = field(default_factory=dict)
    pixels: NDArray[np.int32] | None = None
    shape: tuple[int, int] | None = None
    dropped: int = 0
    unit: str = "mm"
    source: str = "cloud"

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        known = [name for name in ("normals", "grey", "pixels") if getattr(self, name) is not None]
        head = f"MeasuredCloud of {len(self)} points, {self.dropped} left out"
        if not len(self):
            return block(head)
        limits = zip("xyz", self.points.min(axis=0), self.points.max(axis=0), strict=True)
        return block(
            head,
            ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in limits) + " mm",
            f"with {', '.join([*known, *self.scalars])}" if known or self.scalars else "",
        )

    @property
    def size_mm(self) -> float:
        """Diagonal of the box about the middle 98 % of the points along each axis, mm."""
        step = max(1, len(self) // 100_000)
        low, high = np.percentile(self.points[::step], (1.0, 99.0), axis=0)
        return float(np.linalg.norm(high - low))

    def chosen(self, kept: NDArray[np.bool_] | NDArray[np.integer] | slice) -> MeasuredCloud:
        """Return the cloud of some of its points."""
        return replace(
            self,
            points=self.points[kept],
            normals=None if self.normals is None else self.normals[kept],
            grey=None if self.grey is None else self.grey[kept],
            scalars={name: values[kept] for name, values in self.scalars.items()},
            pixels=None if self.pixels is None else self.pixels[kept],
        )

    def moved(self, motion: Pose) -> MeasuredCloud:
        """Return the cloud as ``motion.to_world`` moves it."""
        normals = None if self.normals is None else product(self.normals, motion.rotation.T)
        return replace(self, points=motion.to_world(self.points), normals=normals)
