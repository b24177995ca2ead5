"""A mesh from a file, for objects that no parametric artefact describes.

STL, PLY, OBJ, OFF, GLB and glTF, and STEP where cascadio is installed, read by trimesh.  Mesh
files do not say what their numbers mean, so the unit is a parameter without a default.

Object frame: the file's own axes, scaled to millimetres; with ``centre``, moved so that the
middle of the bounding box is at x = y = 0 and its bottom at z = 0.
"""

import json
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import unquote

import numpy as np
import trimesh

from slbench.core import resources
from slbench.core.errors import InputError, warn_user
from slbench.core.io.arrays import check_ply
from slbench.core.io.bounds import check_size, check_unpacked
from slbench.core.units import MILLIMETRES
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import MinLen
from slbench.objects.artefact import Artefact, Mesh
from slbench.objects.registry import ArtefactKind

#: Of files that are read; archives are not, whatever is in them.
SUFFIXES = (".stl", ".ply", ".obj", ".off", ".glb", ".gltf", ".step", ".stp")
#: Bytes of a file.
_LARGEST = 2**31
#: Of a coordinate, mm: beyond, it is a slip.
_FARTHEST = 1e6


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
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(path, f"a mesh file ({', '.join(SUFFIXES)})", path.suffix or "no suffix")
    check_size(path, _LARGEST, "a mesh file")
    if path.suffix.lower() == ".ply":
        check_ply(path)
    try:
        loaded = _loaded(path)
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        faces = np.asarray(loaded.faces, dtype=np.int64)
    # Each of trimesh's dozen readers fails in its own way on a corrupt file.
    except Exception as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "a mesh file", f"one that cannot be read ({error})") from error
    if len(vertices) == 0 or len(faces) == 0:
        raise InputError(path, "a mesh with faces", "none")
    if not np.isfinite(vertices).all():
        raise InputError(path, "finite coordinates", "NaN or infinity")
    if (farthest := float(np.abs(vertices).max()) * scale) > _FARTHEST:
        expected = f"coordinates within {_FARTHEST:g} mm"
        raise InputError(path, expected, f"{farthest:.6g} mm: another unit?")
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


def _loaded(path: Path) -> Any:
    """Load geometry alone: neither materials nor pictures, which are other files."""
    kind = path.suffix.lower()[1:]
    bare = {"skip_materials": True} if kind in ("obj", "glb", "gltf") else {}
    if kind == "gltf":  # its buffers may be files beside it
        _check_gltf(path, path.read_bytes())
        return trimesh.load_mesh(path, process=False, **bare)
    with path.open("rb") as stream:
        if kind == "glb":  # magic, version and length, then length and kind of the JSON
            start = stream.read(20)
            _check_gltf(path, stream.read(int.from_bytes(start[12:16], "little")))
            stream.seek(0)
        return trimesh.load_mesh(stream, file_type=kind, process=False, **bare)


def _check_gltf(path: Path, content: bytes) -> None:
    """Refuse what promises more numbers than the file can hold, or names files elsewhere.

    The reader makes room first, and follows any path.
    """
    parts = json.loads(content)
    for part in [*parts.get("buffers", []), *parts.get("images", [])]:
        name = part.get("uri", "data:")
        if not name.startswith("data:"):
            for written in {name.strip(), unquote(name).strip()}:
                resources.inside(path.parent, written)
    counts = [int(accessor["count"]) for accessor in parts.get("accessors", [])]
    matrix = 16 * 4  # the largest item, of numbers of four bytes
    check_unpacked(path, matrix * sum(map(abs, counts)), path.stat().st_size)


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(MeshParameters, build_mesh_file, files=("path",))
