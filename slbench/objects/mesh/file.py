"""A mesh from a file, for objects that no parametric artefact describes.

Any format that trimesh reads (STL, PLY, OBJ, OFF, GLB, ...).  Mesh files do not say what
their numbers mean, so the unit is a parameter without a default.

Object frame: the file's own axes, scaled to millimetres; with ``centre``, moved so that the
middle of the bounding box is at x = y = 0 and its bottom at z = 0.
"""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import trimesh

from slbench.core.errors import InputError, warn_user
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import MinLen
from slbench.objects.artefact import Artefact, Mesh
from slbench.objects.registry import ArtefactKind

#: Millimetres in one of each unit.
MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "inch": 25.4, "m": 1000.0}


class MeshParameters(Parameters):
    """A mesh file and how to read it.

    Parameters
    ----------
    path : str
        The file; in a TOML, relative to the TOML's folder.
    unit : {"um", "mm", "cm", "inch", "m"}
        Unit of the file's coordinates.
    centre : bool
        Whether to put the bounding box's middle at x = y = 0 and its bottom at z = 0.
    """

    path: Annotated[str, MinLen(1)]
    unit: Literal["um", "mm", "cm", "inch", "m"]
    centre: bool = False


def build_mesh_file(parameters: MeshParameters, name: str, where: str) -> Artefact:
    """Read a mesh file.

    Parameters
    ----------
    parameters : MeshParameters
        The file and its unit.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        Without features; certified are the sides of its bounding box, so that a TOML can
        state them and catch a wrong unit.

    Raises
    ------
    InputError
        If the file is missing, corrupt, without faces, or has coordinates that are not
        finite.

    Warns
    -----
    InputWarning
        If the mesh is not watertight: it renders, but has no volume.
    """
    path = Path(parameters.path)
    if not path.is_file():
        raise InputError(f"{where}.path", "a mesh file", f"{path}, which is not there")
    mesh = _read(path, MILLIMETRES[parameters.unit])
    if parameters.centre:
        low, high = mesh.bounds
        middle = (low + high) / 2
        mesh = Mesh(mesh.vertices - [middle[0], middle[1], low[2]], mesh.faces)
    if not mesh.is_watertight:
        warn_user(path, "the mesh is not watertight", stacklevel=3)
    sizes = mesh.bounds[1] - mesh.bounds[0]
    return Artefact(
        name=name,
        kind="mesh",
        parameters=parameters.model_dump(),
        mesh=mesh,
        certified={f"size_{axis}_mm": float(s) for axis, s in zip("xyz", sizes, strict=True)},
    )


def _read(path: Path, scale: float) -> Mesh:
    try:
        loaded = trimesh.load_mesh(path, process=False)
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        faces = np.asarray(loaded.faces, dtype=np.int64)
    # Each of trimesh's dozen readers fails in its own way on a corrupt file.
    except Exception as error:
        formats = "a mesh file (STL, PLY, OBJ, ...)"
        raise InputError(path, formats, f"one that cannot be read ({error})") from error
    if len(vertices) == 0 or len(faces) == 0:
        raise InputError(path, "a mesh with faces", "none")
    if not np.isfinite(vertices).all():
        raise InputError(path, "finite coordinates", "NaN or infinity")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(path, f"faces of {len(vertices)} vertices", "indices beyond them")
    # STL repeats a vertex in every face.  Equal ones are equal bit for bit, so no tolerance
    # is needed, which would be wrong for parts of a millimetre given in metres.
    order = np.lexsort(vertices.T)
    ordered = vertices[order]
    is_new = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])
    index = np.empty(len(vertices), dtype=np.int64)
    index[order] = np.cumsum(is_new) - 1
    vertices, faces = ordered[is_new], index[faces]
    distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    if not distinct.any():
        raise InputError(path, "a mesh with faces", "only faces without area")
    return Mesh(vertices * scale, faces[distinct])


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(MeshParameters, build_mesh_file, files=("path",))
