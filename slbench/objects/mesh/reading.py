"""Mesh files to parts: triangles, and what a file says of how its parts look.

trimesh reads the files.  A file's nodes (GLB, glTF, STEP, 3MF) or objects and materials (OBJ) are
parts.  Of their looks the base colour is kept, as an albedo: factor, texture and vertex colours.
Whatever else a file brings is named, so that it can be said.

Factors are linear (glTF 2.0, section 3.9.2; a ``Kd`` is a reflectance), pictures are encoded as
sRGB.  Vertex colours are linear in glTF, and sRGB in PLY and OBJ, whose makers copy them from
pictures.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from slbench.core import resources
from slbench.core.colour import decode_srgb, luminance, unit_range
from slbench.core.errors import InputError
from slbench.core.io.arrays import check_ply
from slbench.core.io.bounds import check_size, check_unpacked
from slbench.objects.artefact import BODY
from slbench.objects.surface import Coloured, Pixels, Surface

#: Of files that are read; other archives are not, whatever is in them.
SUFFIXES = (".stl", ".ply", ".obj", ".off", ".glb", ".gltf", ".step", ".stp", ".3mf")
STEP = (".step", ".stp")
#: How finely the curved faces of STEP files become triangles: sag in mm, and turn in rad.
FINENESS = {"tol_linear": 1e-3, "tol_angular": 0.1}
#: Bytes of a file.
_LARGEST = 2**31
#: Characters of a part's name.
_LONGEST = 60
#: Whose vertex colours and factors are linear.
_LINEAR = (".glb", ".gltf", ".step", ".stp")
#: Keys of materials that say nothing of how they scatter light, or that are used.
_SILENT = {"name", "doubleSided", "alphaMode", "alphaCutoff", "extras", "extensions", "kd", "ka"}
_SILENT |= {"illum", "ni", "diffuse", "ambient", "specular", "glossiness", "image"}
_SILENT |= {"baseColorFactor", "baseColorTexture", "pbrMetallicRoughness"}
_SILENT |= {"metallicFactor", "roughnessFactor", "metallicRoughnessTexture", "normalTexture"}
#: Suffixes of pictures that a material names.
_PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".tga", ".webp", ".gif"}
#: Extensions of glTF that change no look.
_KNOWN_EXTENSIONS = {"KHR_draco_mesh_compression", "EXT_texture_webp", "KHR_mesh_quantization"}


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a file, in the file's own unit; values at the corners of its faces."""

    name: str
    vertices: NDArray[np.float64]  #: (n, 3)
    faces: NDArray[np.int64]  #: (m, 3)
    uv: NDArray[np.float64] | None = None  #: (m, 3, 2)
    albedo: NDArray[np.float64] | None = None  #: (m, 3)
    normals: NDArray[np.float64] | None = None  #: (m, 3, 3)
    colours: NDArray[np.float64] | None = None  #: (m, 3, 3)
    surface: Surface | None = None


@dataclass
class Content:
    """What a file holds: its parts, and names of what is not used."""

    parts: list[Part] = field(default_factory=list)
    unused: dict[str, None] = field(default_factory=dict)
    textured: bool = False  #: whether a glTF names a texture
    pictures: dict[Any, Pixels] = field(default_factory=dict)  #: that parts share

    def leave(self, *names: str) -> None:
        """Remember what is not used."""
        self.unused.update(dict.fromkeys(names))


def read_content(path: Path) -> Content:
    """Read a mesh file.

    Raises
    ------
    InputError
        If the file is corrupt, of another kind, or names files that are not beside it; of a STEP
        file without the extra ``step``.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(path, f"a mesh file ({', '.join(SUFFIXES)})", path.suffix or "no suffix")
    if path.suffix.lower() in STEP and find_spec("cascadio") is None:
        extra = "cascadio, which the extra step installs (pip install 'slbench[step]')"
        raise InputError(path, extra, "not installed")
    check_size(path, _LARGEST, "a mesh file")
    if path.suffix.lower() == ".ply":
        check_ply(path)
    content = Content()
    try:
        _fill(content, path, _loaded(path, content))
    # Each of trimesh's dozen readers fails in its own way on a corrupt file.
    except Exception as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "a mesh file", f"one that cannot be read ({error})") from error
    return content


class _Beside(trimesh.resolvers.Resolver):  # type: ignore[misc]
    """Gives a reader the files beside a mesh, and no others."""

    def __init__(self, path: Path, content: Content) -> None:
        self._path, self._content = path, content

    def get(self, key: str) -> bytes:
        """Return a file's bytes; the reader does without one that is not there."""
        try:
            found = resources.inside(self._path.parent, str(key).strip())
            data = found.read_bytes()
        except (InputError, OSError):
            self._content.leave(f"{key} (no such file beside it)")
            raise
        if found.suffix.lower() in _PICTURES:
            try:
                Image.open(io.BytesIO(data)).close()
            except Exception:
                self._content.leave(f"{key} (no picture that can be read)")
                raise
        return data

    def write(self, name: str, data: Any) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> Any:
        raise NotImplementedError

    def keys(self) -> Iterable[str]:
        return ()


def _loaded(path: Path, content: Content) -> Any:
    """Return trimesh's scene of a file."""
    kind = path.suffix.lower()[1:]
    more: dict[str, Any] = {"split_objects": True} if kind == "obj" else {}
    if f".{kind}" in STEP:
        more = FINENESS
    beside = _Beside(path, content)
    with path.open("rb") as stream:
        if kind == "gltf":  # its buffers may be files beside it
            _check_gltf(path, stream.read(), content)
        elif kind == "glb":  # magic, version and length, then length and kind of the JSON
            start = stream.read(20)
            _check_gltf(path, stream.read(int.from_bytes(start[12:16], "little")), content)
        elif kind == "3mf":
            _check_archive(path)
        stream.seek(0)
        return trimesh.load_scene(stream, file_type=kind, resolver=beside, process=False, **more)


def _check_gltf(path: Path, text: bytes, content: Content) -> None:
    """Refuse what promises more numbers than the file can hold, or names files elsewhere.

    The reader makes room first, and follows any path.
    """
    tables = json.loads(text)
    for part in [*tables.get("buffers", []), *tables.get("images", [])]:
        name = part.get("uri", "data:")
        if not name.startswith("data:"):
            for written in {name.strip(), unquote(name).strip()}:
                resources.inside(path.parent, written)
    content.textured = any(
        "baseColorTexture" in material.get("pbrMetallicRoughness", {})
        for material in tables.get("materials", ())
    )
    counts = [int(accessor["count"]) for accessor in tables.get("accessors", [])]
    matrix = 16 * 4  # the largest item, of numbers of four bytes
    check_unpacked(path, matrix * sum(map(abs, counts)), path.stat().st_size)
    content.leave(*sorted(set(tables.get("extensionsUsed", ())) - _KNOWN_EXTENSIONS))
    content.leave(*(name for name in ("animations", "skins") if tables.get(name)))


def _check_archive(path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(path) as archive:
        check_unpacked(path, sum(i.file_size for i in archive.infolist()), path.stat().st_size)


def _fill(content: Content, path: Path, scene: Any) -> None:
    """Add the parts of a scene, each in its place."""
    linear = path.suffix.lower() in _LINEAR
    nodes = [
        (str(node), *scene.graph[node])
        for node in scene.graph.nodes_geometry
        if isinstance(scene.geometry[scene.graph[node][1]], trimesh.Trimesh)
    ]
    if len(nodes) < len(scene.graph.nodes_geometry):
        content.leave("lines and points")
    names: dict[str, None] = {}
    for node, matrix, geometry in nodes:
        name = BODY if len(nodes) == 1 else _unique(node, names)
        names[name] = None
        part = _part(name, scene.geometry[geometry], path, linear, content)
        content.parts.append(_placed(part, np.asarray(matrix, dtype=np.float64)))
    looks = [part.surface for part in content.parts]
    if content.textured and not any(look is not None and look.picture for look in looks):
        content.leave("a texture that cannot be read")


def _unique(node: str, names: Mapping[str, None]) -> str:
    """Return a part's name: printable, not too long, no other's."""
    name = "".join(c if c.isprintable() else " " for c in node).strip()[:_LONGEST] or "part"
    found, k = name, 1
    while found in names:
        k += 1
        found = f"{name}_{k}"
    return found


def _part(name: str, mesh: Any, path: Path, linear: bool, content: Content) -> Part:
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InputError(path, f"faces of {len(vertices)} vertices", "indices beyond them")
    # Normals of the file are what trimesh has at hand before it computes any.
    normals = mesh._cache.cache.get("vertex_normals")
    visual = mesh.visual
    material, uv = getattr(visual, "material", None), getattr(visual, "uv", None)
    look = _of_material(material, path, content)
    colours = _vertex_colours(visual, len(faces), linear)
    if uv is None or len(uv) != len(vertices):
        uv = None
        if look.maps:
            content.leave("pictures without texture coordinates")
        look = look.without_maps()
    picture, factor = look.picture, look.factor
    if picture is not None and colours is not None:
        content.leave("vertex colours beside a texture")
    level, albedo, coloured, colour = 1.0, None, None, None
    if picture is None and colours is not None:
        corners = colours if colours.shape[:2] == (len(faces), 3) else colours[faces]
        coloured = corners * (1.0 if factor is None else factor)
        albedo = np.clip(luminance(coloured), 0.0, 1.0)
        coloured = np.clip(coloured, 0.0, 1.0)
    elif picture is None and factor is not None:
        level = float(np.clip(luminance(factor), 0.0, 1.0))
        colour = tuple(np.clip(factor, 0.0, 1.0).tolist())
    stated = any(one is not None for one in (picture, albedo, factor, *look.maps))
    gloss = (look.metallic, look.roughness, look.normals)
    surface = Surface(level, picture, albedo is not None, *gloss, colour) if stated else None
    return Part(
        name,
        vertices,
        faces,
        None if uv is None else np.asarray(uv, dtype=np.float64)[faces],
        albedo,
        None if normals is None else np.asarray(normals, dtype=np.float64)[faces],
        coloured,
        surface,
    )


@dataclass(frozen=True)
class _Look:
    """What a material states."""

    factor: NDArray[np.float64] | None = None  #: of red, green and blue, linear
    picture: Pixels | None = None
    metallic: float | Pixels | None = None
    roughness: float | Pixels | None = None
    normals: Pixels | None = None

    @property
    def maps(self) -> list[Pixels]:
        """All pictures."""
        values = (self.picture, self.metallic, self.roughness, self.normals)
        return [one for one in values if isinstance(one, Pixels)]

    def without_maps(self) -> _Look:
        """Return the numbers alone."""
        metallic, roughness = (
            None if isinstance(v, Pixels) else v for v in (self.metallic, self.roughness)
        )
        return _Look(self.factor, None, metallic, roughness)


def _of_material(material: Any, path: Path, content: Content) -> _Look:
    """Return what a material states: a Wavefront one its colour, that of a glTF its gloss too."""
    if material is None:
        return _Look()
    if not isinstance(material, trimesh.visual.material.PBRMaterial):
        keys = dict(getattr(material, "kwargs", None) or {})
        stated, image = keys.get("kd"), getattr(material, "image", None)
        factor = None if stated is None else np.resize(np.asarray(stated, np.float64), 3)
        content.leave(*sorted(set(keys) - _SILENT))
        return _Look(factor, _albedo_of(image, factor, path, content))
    stated = material.baseColorFactor
    factor = None if stated is None else unit_range(np.asarray(stated))[:3]
    given = {k for k, v in vars(material)["_data"].items() if v is not None}
    content.leave(*sorted(given - _SILENT))
    if material.alphaMode not in (None, "OPAQUE"):
        content.leave("transparency")
    metallic, roughness = (
        None if value is None else float(value)
        for value in (material.metallicFactor, material.roughnessFactor)
    )
    both, normals = material.metallicRoughnessTexture, material.normalTexture
    return _Look(
        factor,
        _albedo_of(material.baseColorTexture, factor, path, content),
        _values_of(both, 2, metallic, path, content) or metallic,
        _values_of(both, 1, roughness, path, content) or roughness,
        _values_of(normals, None, None, path, content),
    )


def _albedo_of(image: Any, factor: Any, path: Path, content: Content) -> Pixels | None:
    """Return the albedo (H, W) of a picture's pixels times a factor of red, green and blue."""
    if image is None:
        return None
    factors = [1.0] * 3 if factor is None else np.asarray(factor, np.float64).tolist()
    weights = luminance(np.eye(3)) * factors
    key = (id(image), *weights)
    if key not in content.pictures:
        table = decode_srgb(np.arange(256) / 255.0)
        pixels = _pixels(image, path, content)
        found = sum(w * table[pixels[..., k]] for k, w in enumerate(weights))
        colours = None
        if any((pixels[..., k] != pixels[..., 0]).any() for k in (1, 2)) or np.ptp(factors):
            colours = Coloured(pixels, True, (factors[0], factors[1], factors[2]))
        content.pictures[key] = Pixels(np.clip(found, 0.0, 1.0), colours)
    return content.pictures[key]


def _values_of(
    image: Any, channel: int | None, factor: float | None, path: Path, content: Content
) -> Pixels | None:
    """Return linear values of a picture's channel (H, W) times a factor, or all (H, W, 3)."""
    if image is None:
        return None
    scale = 1.0 if factor is None else min(max(factor, 0.0), 1.0)
    key = (id(image), channel, scale)
    if key not in content.pictures:
        values = _pixels(image, path, content)[..., :3] / 255.0
        content.pictures[key] = Pixels(values if channel is None else scale * values[..., channel])
    return content.pictures[key]


def _pixels(image: Any, path: Path, content: Content) -> NDArray[np.uint8]:
    """Return a picture's pixels (H, W, 4), unless it is out of all proportion to the file."""
    width, height = image.size
    check_unpacked(path, 4 * width * height, path.stat().st_size)
    if image.mode.startswith("I;16"):  # grey of 16 bits; of its own PIL would cut it off
        image = Image.fromarray((np.asarray(image).astype(np.uint16) >> 8).astype(np.uint8))
    pixels = np.asarray(image.convert("RGBA"))
    if pixels[..., 3].min() < 255:
        content.leave("transparency")
    return pixels


def _vertex_colours(visual: Any, faces: int, linear: bool) -> NDArray[np.float64] | None:
    """Return linear colours of vertices (n, 3) or of corners (m, 3, 3); None where none are."""
    beside = getattr(visual, "vertex_attributes", None) or {}
    if "color" in beside:
        colours = unit_range(np.asarray(beside["color"]))[:, :3]
    elif getattr(visual, "kind", None) == "vertex":
        colours = unit_range(visual.vertex_colors)[:, :3]
    elif getattr(visual, "kind", None) == "face":
        each = unit_range(visual.face_colors)[:, :3]
        colours = np.broadcast_to(each[:, None], (faces, 3, 3))
    else:
        return None
    return np.asarray(colours if linear else decode_srgb(np.clip(colours, 0.0, 1.0)))


def _placed(part: Part, matrix: NDArray[np.float64]) -> Part:
    """Return a part moved by a node's transform (4, 4)."""
    if np.array_equal(matrix, np.eye(4)):
        return part
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    mirrored = bool(np.linalg.det(linear) < 0)
    order = [2, 1, 0] if mirrored else [0, 1, 2]
    uv, albedo, normals, colours = (
        None if corner is None else corner[:, order]
        for corner in (part.uv, part.albedo, part.normals, part.colours)
    )
    if normals is not None:  # by the transpose of the inverse, as of planes
        normals = normals @ np.linalg.inv(linear)
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-300)
    placed = part.vertices @ linear.T + shift
    corners = (uv, albedo, normals, colours)
    return Part(part.name, placed, part.faces[:, order], *corners, part.surface)
