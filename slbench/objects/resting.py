"""How a part rests on a table: the poses in which its centre of mass is above its support.

Their probabilities are those that a fall ends there (``trimesh.poses``, by K. Goldberg et al.,
"Part pose statistics: estimators and experiments", IEEE Trans. Robotics and Automation 15(5),
1999).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slbench.objects.triangles import Mesh

Array = NDArray[np.float64]


@lru_cache(maxsize=64)  # meshes are equal only if they are the same
def stable_poses(mesh: Mesh) -> tuple[Array, Array]:
    """Return the stable poses of a mesh on a table, the most probable one first.

    Parameters
    ----------
    mesh : Mesh
        One that is open has the centre of mass of its convex hull.

    Returns
    -------
    rotations : (n, 3, 3) float
        From the mesh's frame to one whose z is up from the table.
    shares : (n,) float
        Probabilities, above 0.
    """
    import trimesh

    solid = mesh.as_trimesh
    if not solid.is_volume:  # whose centre of mass is that of its hull
        solid = solid.convex_hull
    poses, shares = trimesh.poses.compute_stable_poses(solid)
    kept = np.flatnonzero(shares > 0.0)
    return np.asarray(poses)[kept, :3, :3], np.asarray(shares)[kept]
