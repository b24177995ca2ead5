"""Samples of a part's surface, even by area: what coverage is counted on.

They follow from the mesh and their number alone, so that what a plan predicts and what a scan
measures are of the same places.  Faces are taken along a space-filling curve and sampled at equal
steps of their summed area; within its face a sample is a point of the R2 sequence (M. Roberts,
"The unreasonable effectiveness of quasirandom sequences", 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.objects import Mesh
from slbench.score.clouds.surface import morton_order

Array = NDArray[np.float64]

#: The plastic number's powers, by which the R2 sequence steps.
_PLASTIC = 1.32471795724474602596
_STEPS = np.array([1.0 / _PLASTIC, 1.0 / _PLASTIC**2])


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Places on a surface, each of which stands for the same area.

    Parameters
    ----------
    points : (N, 3) float
        In the mesh's frame, mm.
    normals : (N, 3) float
        Outward unit normals of their faces.
    faces : (N,) int
        Of the mesh.
    area_mm2 : float
        That one sample stands for.
    """

    points: Array
    normals: Array
    faces: NDArray[np.int64]
    area_mm2: float

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.points)


def sample_surface(mesh: Mesh, count: int) -> SurfaceSamples:
    """Sample a mesh.

    Parameters
    ----------
    mesh : Mesh
    count : int
        Of samples, at least 1.

    Raises
    ------
    InputError
        If no face has an area.
    """
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    solid = np.flatnonzero(doubled > 0.0)
    if not len(solid):
        raise InputError("mesh", "a face with an area", "none")
    along = solid[morton_order(corners[solid].mean(axis=1))]
    summed = np.cumsum(0.5 * doubled[along])
    steps = (np.arange(count) + 0.5) / count * summed[-1]
    faces = along[np.minimum(np.searchsorted(summed, steps, side="right"), len(along) - 1)]
    u, v = ((0.5 + np.arange(1, count + 1)[:, np.newaxis] * _STEPS) % 1.0).T
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    a, b, c = np.moveaxis(corners[faces], 1, 0)
    points = a + u[:, np.newaxis] * (b - a) + v[:, np.newaxis] * (c - a)
    normals = cross[faces] / doubled[faces, np.newaxis]
    return SurfaceSamples(points, normals, faces, float(summed[-1]) / count)


def patches_of(samples: SurfaceSamples, most: int) -> NDArray[np.int64]:
    """Group samples into patches: those of one side of the part that are near each other.

    Parameters
    ----------
    samples : SurfaceSamples
    most : int
        Patches, at most.

    Returns
    -------
    (N,) int
        Number of each sample's patch, from 0.
    """
    axis = np.argmax(np.abs(samples.normals), axis=1)
    facing = 2 * axis + (np.take_along_axis(samples.normals, axis[:, None], 1)[:, 0] > 0.0)
    low = samples.points.min(axis=0)
    size = float(np.ptp(samples.points, axis=0).max())
    # Cells grow until there are few enough: their number goes with the inverse square of the side.
    cells = int(np.sqrt(most)) + 1
    while True:
        index = np.minimum((samples.points - low) / max(size, 1e-12) * cells, cells - 1)
        key = np.column_stack((index.astype(np.int64), facing))
        found = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
        if cells == 1 or int(found.max()) < most:
            return found.astype(np.int64)
        cells = max(1, min(cells - 1, int(cells * 0.9)))
