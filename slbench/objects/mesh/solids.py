"""The one solid that prismatic artefacts are made of: a profile drawn out along y."""

import manifold3d
import numpy as np
from numpy.typing import ArrayLike

from slbench.objects.artefact import Mesh


def prism(profile_xz_mm: ArrayLike, width_mm: float) -> Mesh:
    """Draw a profile out along y, symmetric about y = 0.

    The profile's own coordinates become the mesh's, bit for bit; only its two ends are
    triangulated (manifold3d).  Equal input gives equal vertices and faces in equal order.

    Parameters
    ----------
    profile_xz_mm : (n, 2) array_like
        A simple polygon in (x, z), counter-clockwise with x to the right and z up.
    width_mm : float
        Extent along y.

    Returns
    -------
    Mesh
        A watertight solid of 2 n vertices and 4 n - 4 faces that look outwards.
    """
    profile = np.asarray(profile_xz_mm, dtype=np.float64)
    count = len(profile)
    front = np.column_stack([profile[:, 0], np.full(count, -width_mm / 2), profile[:, 1]])
    back = front * [1.0, -1.0, 1.0]
    # Seen from -y, x is to the right and z up: the profile's winding looks outwards there.
    front_end = np.asarray(manifold3d.triangulate([profile]), dtype=np.int64)
    back_end = front_end[:, ::-1] + count
    i = np.arange(count)
    j = (i + 1) % count
    walls = np.stack([j, i, i + count, j, i + count, j + count], axis=1).reshape(-1, 3)
    return Mesh(np.concatenate([front, back]), np.concatenate([front_end, back_end, walls]))
