"""Names of faces that a mesh file keeps, so that features can be declared by them.

OBJ, GLB, glTF and 3MF have named parts; a STEP file's faces are numbered in file order, from 1, as
each becomes a mesh of its own.  STL, PLY and OFF name nothing.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from slbench.objects.artefact import Artefact
from slbench.objects.mesh.reading import FINENESS, STEP

#: Middles of faces agree to this share of the part: rounding of single precision, many times.
_ALIKE = 1e-5


def face_groups(artefact: Artefact) -> dict[str, NDArray[np.int64]]:
    """Return the named faces of an artefact's mesh file, in file order.

    Parameters
    ----------
    artefact : Artefact
        Of kind ``"mesh"``; its file was read before, so it can be.

    Returns
    -------
    dict of str to (k,) ndarray of int
        Faces of the mesh by name; empty where the file names none.
    """
    path = Path(str(artefact.parameters["path"]))
    if path.suffix.lower() not in STEP:
        return dict(artefact.parts) if len(artefact.parts) > 1 else {}
    from scipy.spatial import cKDTree

    scene = trimesh.load_scene(path, process=False, merge_primitives=False, **FINENESS)
    faces = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        corners = trimesh.transformations.transform_points(scene.geometry[name].vertices, matrix)
        faces.append(corners[np.asarray(scene.geometry[name].faces)].mean(axis=1))
    own = artefact.mesh.vertices[artefact.mesh.faces].mean(axis=1)
    everything = np.concatenate(faces)
    # The mesh was scaled and perhaps moved: its middles span the same box.
    low, size = everything.min(axis=0), float(np.ptp(everything, axis=0).max())
    scale = float(np.ptp(own, axis=0).max()) / size
    tree = cKDTree((own - own.min(axis=0)) / scale)
    found = {}
    for number, middles in enumerate(faces, start=1):
        distance, index = tree.query(middles - low)
        found[str(number)] = np.unique(index[distance <= _ALIKE * size])
    return found
