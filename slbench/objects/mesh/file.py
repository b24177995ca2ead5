"""A mesh from a file, for objects that no parametric artefact describes.

STL, PLY, OBJ, OFF, GLB and glTF, and STEP where the extra ``step`` (cascadio) is installed, read by
trimesh.  Mesh files do not say what their numbers mean, so the unit is a parameter without a
default.

Object frame: the file's own axes, scaled to millimetres; with ``centre``, moved so that the
middle of the bounding box is at x = y = 0 and its bottom at z = 0.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError, warn_user
from slbench.core.units import MILLIMETRES, Unit
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import MinLen
from slbench.objects.artefact import Artefact, Mesh
from slbench.objects.mesh.groups import face_groups
from slbench.objects.mesh.reading import STEP, SUFFIXES, Content, Part, read_content
from slbench.objects.mesh.shading import largest_turn, smooth_normals
from slbench.objects.registry import ArtefactKind

__all__ = ["KIND", "SUFFIXES", "MeshParameters", "build_mesh_file"]

#: Of a coordinate, mm: beyond, it is a slip.
_FARTHEST = 1e6
#: Of the largest coordinate: so far apart are copies of a vertex by rounding at most.  Single
#: precision, three axes and a few operations make 1e-6 of it; six digits of a text as much.
_ROUNDING = 1e-6
#: Degrees between a vertex's normal and a face's from which an edge is meant to be seen.
_ROUND_EDGE = 45.0


class MeshParameters(Parameters):
    """A mesh file and how to read it.

    Parameters
    ----------
    path : str
        The file; in a TOML, relative to the TOML's folder.
    unit : {"um", "mm", "cm", "inch", "m"}
        Unit of the file's coordinates; of STEP files it is their own, whatever is said here.
    centre : bool
        Whether to put the bounding box's middle at x = y = 0 and its bottom at z = 0.
    normals : {"file", "facets", "smooth"}
        What light is shaded by: the file's vertex normals where it has any, the facets, or means
        of facets that meet at less than 30 degrees.  The true surface is that of the facets.
    """

    path: Annotated[str, MinLen(1)]
    unit: Unit
    centre: bool = False
    normals: Literal["file", "facets", "smooth"] = "file"


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
    # A STEP file states its unit, and its reader gives metres.
    unit = "m" if path.suffix.lower() in STEP else parameters.unit
    mesh, parts, content = _built(path, MILLIMETRES[unit])
    if parameters.centre:
        low, high = mesh.bounds
        middle = (low + high) / 2
        mesh = replace(mesh, vertices=mesh.vertices - [middle[0], middle[1], low[2]])
    if parameters.normals != "file":
        smooth = smooth_normals(mesh) if parameters.normals == "smooth" else None
        mesh = replace(mesh, normals=smooth)
    elif (off := largest_turn(mesh)) > _ROUND_EDGE:
        doubt = (
            f"its vertex normals are up to {off:.0f} degrees off the faces, which shades edges as "
            'if they were round; normals = "facets" shades flat faces, "smooth" round ones alone'
        )
        warn_user(path, doubt, stacklevel=3)
    if content.unused:
        warn_user(path, f"not used: {', '.join(content.unused)}", stacklevel=3)
    if not mesh.is_watertight:
        warn_user(path, "the mesh is not watertight", stacklevel=3)
    sizes = mesh.bounds[1] - mesh.bounds[0]
    # Digests of parts that were made before there was a choice stay as they are.
    default = {"normals"} if parameters.normals == "file" else set()
    return Artefact(
        name=name,
        kind="mesh",
        parameters=parameters.model_dump(exclude=default),
        mesh=mesh,
        certified={f"size_{axis}_mm": float(s) for axis, s in zip("xyz", sizes, strict=True)},
        parts=parts,
        surfaces={p.name: p.surface for p in content.parts if p.surface and p.name in parts},
    )


def _built(path: Path, scale: float) -> tuple[Mesh, dict[str, NDArray[np.int64]], Content]:
    """Return a file's mesh in millimetres, the faces of its parts, and what else it holds."""
    content = read_content(path)
    parts = content.parts
    if not parts or not sum(len(part.faces) for part in parts):
        raise InputError(path, "a mesh with faces", "none")
    vertices = np.concatenate([part.vertices for part in parts])
    if not np.isfinite(vertices).all():
        raise InputError(path, "finite coordinates", "NaN or infinity")
    if (farthest := float(np.abs(vertices).max()) * scale) > _FARTHEST:
        expected = f"coordinates within {_FARTHEST:g} mm"
        raise InputError(path, expected, f"{farthest:.6g} mm: another unit?")
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + at for part, at in zip(parts, first, strict=False)])
    owner = np.repeat(np.arange(len(parts)), np.diff(first))
    merged, index, kept = _merged(vertices, faces, owner)
    if not kept.any():
        raise InputError(path, "a mesh with faces", "only faces without area")
    corners = [_corners(parts, name, kept) for name in ("uv", "albedo", "normals", "colours")]
    mesh = Mesh(merged * scale, index[kept], *corners)
    part_of = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])[kept]
    found = {part.name: np.flatnonzero(part_of == k) for k, part in enumerate(parts)}
    return mesh, {name: own for name, own in found.items() if len(own)}, content


def _merged(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], owner: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    """Merge equal vertices: return them, faces of them, and which faces keep three corners.

    STL repeats a vertex in every face.  Equal ones are equal bit for bit as a rule.  Where that
    leaves a surface open, those within rounding are merged too: programs compute a corner once a
    face, and single precision rounds at 6e-8 of the largest coordinate.  Parts that touch share
    no vertices where sharing would have more than two faces meet at an edge.
    """
    exact = _numbered(vertices)
    far = float(np.abs(vertices).max())
    ways: tuple[Callable[[], NDArray[np.int64]], ...] = (
        lambda: exact,
        lambda: _within(exact, owner),
        lambda: _close(vertices, _ROUNDING * far),
        lambda: _within(_close(vertices, _ROUNDING * far), owner),
    )
    first = None
    for way in ways:
        number = way()
        _, at, index = np.unique(number, return_index=True, return_inverse=True)
        found = index[faces]
        kept = (found != np.roll(found, 1, axis=1)).all(axis=1)
        outcome = vertices[at], found, kept
        if first is None:
            first = outcome
        if not kept.any() or Mesh(outcome[0], found[kept]).is_watertight:
            return outcome
    assert first is not None
    return first


def _numbered(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return a number for each vertex, the same for equal ones, in lexicographic order."""
    order = np.lexsort(vertices.T)
    ordered = vertices[order]
    is_new = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])
    number = np.empty(len(vertices), dtype=np.int64)
    number[order] = np.cumsum(is_new) - 1
    return number


def _within(number: NDArray[np.int64], owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers that are the same within one part only."""
    return number * (int(owner.max()) + 1) + owner


def _close(vertices: NDArray[np.float64], distance: float) -> NDArray[np.int64]:
    """Return a number for each vertex, the same for all within a distance of one another."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    number = _numbered(vertices)
    _, at = np.unique(number, return_index=True)
    pairs = cKDTree(vertices[at]).query_pairs(distance, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(at), len(at)))
    joined = connected_components(links, directed=False)[1]
    return np.asarray(joined, dtype=np.int64)[number]


def _corners(parts: list[Part], name: str, kept: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Return values at the corners of all parts' faces; None where no part has any."""
    values = [getattr(part, name) for part in parts]
    known = next((one for one in values if one is not None), None)
    if known is None:
        return None
    blank = [np.full((len(p.faces), *known.shape[1:]), np.nan) for p in parts]
    pairs = zip(values, blank, strict=True)
    return np.concatenate([b if v is None else v for v, b in pairs])[kept]


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(MeshParameters, build_mesh_file, files=("path",), groups=face_groups)
