"""Textures: values of a BSDF's parameter that vary over a surface.

Where a material takes a number, it takes a *texture* instead: a picture (``"wood.png"``), the
colours that a mesh brings (``{ texture = "mesh" }``), or one that is drawn
(:mod:`slbench.scene.drawn`).  In one band of light the linear luminance of colours counts
(:mod:`slbench.core.colour`), in a scene of three bands each has its own.

A texture is a tile that repeats.  ``mapping = "uv"`` lays it by the mesh's texture coordinates,
``"box"`` by the object's own coordinates: each face takes the two axes that it is least inclined
to, so that no texture coordinates are needed and a tile has its size in millimetres everywhere.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, InstanceOf

from slbench.core import resources
from slbench.core.colour import decode_srgb, luminance, unit_range
from slbench.core.errors import InputError
from slbench.core.io.images import read_colour
from slbench.core.registry import Registry
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Fraction, Measure, MinLen, Share, Words
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.objects.surface import Coloured, Pixels

#: Of the values at a mesh's vertices, in Mitsuba's words.
VERTEX_ALBEDO = "vertex_albedo"
#: Of a normal's length, as eight bits and lossy files leave it.
_NORMAL_ERROR = 0.1
#: Least roughness of a map: a smoother one is a mirror, in which nobody finds a small lens.
LEAST_ROUGHNESS = 0.01


class Texture(Parameters):
    """Base of the textures.

    Parameters
    ----------
    mapping : {"box", "uv"}
        By what the tile is laid.
    size_mm : float
        Width of the tile, by ``box``.
    repeat : float
        Tiles side by side in the unit square of texture coordinates, by ``uv``.
    scale : float
        Factor on all values, in (0, 1].
    """

    #: Whether it is laid by coordinates.
    laid: ClassVar[bool] = True

    mapping: Literal["box", "uv"] = "box"
    size_mm: Measure = 10.0
    repeat: Measure = 1.0
    scale: Fraction = 1.0

    @abstractmethod
    def tile(self) -> tuple[NDArray[np.float32], tuple[float, float], bool]:
        """Return what repeats: values (H, W) in [0, 1], how often across and down a tile, edges.

        The last is whether values jump from one texel to the next instead of being interpolated.
        """

    def in_band(self, k: int) -> float | Texture:
        """Return what it is in a band of light, of red (0), green (1) or blue (2): itself, grey."""
        return self

    def mitsuba(self) -> dict[str, Any]:
        """Return the texture as a dictionary; arrays in it are the renderer's to take in."""
        values, (across, down), sharp = self.tile()
        if self.mapping == "uv":
            factors = (self.repeat * across, self.repeat * down)
        else:  # texels are square but for what repeats in the tile
            height, width = values.shape[:2]
            aspect = (height * down) / (width * across)
            factors = (across / self.size_mm, down / (self.size_mm * aspect))
        return {
            "type": "bitmap",
            "bitmap": np.atleast_3d(self.scale * values),
            "raw": True,
            "filter_type": "nearest" if sharp else "bilinear",
            "wrap_mode": "repeat",
            "accel": False,
            "to_uv": np.diag([*factors, 1.0]),
        }


class Picture(Texture):
    """A picture, of whose colours the luminance counts.

    Parameters
    ----------
    path : str
        The file; in a scene, relative to its folder.
    encoding : {"srgb", "linear"}
        Of its numbers.
    pixels : Pixels, optional
        Values in the place of a file's.
    """

    mapping: Literal["box", "uv"] = "uv"
    path: Annotated[str, MinLen(1)] = Field(repr=False)  # what it shows counts
    encoding: Literal["srgb", "linear"] = "srgb"
    pixels: InstanceOf[Pixels] | None = None

    def tile(self) -> tuple[NDArray[np.float32], tuple[float, float], bool]:
        """Return the picture's values."""
        pixels = self.pixels or self._read()
        return pixels.values, (1.0, 1.0), False

    def in_band(self, k: int) -> Picture:
        """Return the picture of its red (0), green (1) or blue (2) values."""
        pixels = self.pixels or self._read()
        return (
            self if pixels.colours is None else self.model_copy(update={"pixels": pixels.band(k)})
        )

    def read(self) -> Picture:
        """Return the texture with the file's values in it, which a change of the file leaves.

        Raises
        ------
        InputError
            If the file is no picture, or has transparent pixels.
        """
        return self.model_copy(update={"pixels": self._read()})

    def _read(self) -> Pixels:
        encoded = read_colour(self.path)
        values = unit_range(encoded)
        if not (np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0):
            raise InputError(self.path, "values in [0, 1]", f"{values.min()} to {values.max()}")
        srgb = self.encoding == "srgb"
        linear = decode_srgb(values) if srgb else values
        if linear.ndim == 2:
            return Pixels(linear)
        return Pixels(np.clip(luminance(linear), 0.0, 1.0), Coloured(encoded, srgb))


class NormalMap(Picture):
    """A picture of normals in tangent space: red to the right, green up, blue outwards.

    That is the convention of OpenGL and glTF 2.0; 0.5 stands for 0.
    """

    encoding: Literal["linear"] = "linear"
    scale: Literal[1] = 1

    def _read(self) -> Pixels:
        values = unit_range(read_colour(self.path))
        if values.ndim != 3 or values.max() > 1.0:
            raise InputError(self.path, "a picture of normals in colour", "a grey one or floats")
        length = np.linalg.norm(2.0 * values - 1.0, axis=-1)
        if np.median(np.abs(length - 1.0)) > _NORMAL_ERROR or np.median(values[..., 2]) < 0.5:
            expected = "normals of length 1, blue outwards"
            raise InputError(self.path, expected, f"a median length of {np.median(length):.2f}")
        return Pixels(values)


class OfMesh(Texture):
    """The base colour that a mesh file states for a part: number, picture or vertex colours."""

    mapping: Literal["uv"] = "uv"
    repeat: Literal[1] = 1

    def tile(self) -> tuple[NDArray[np.float32], tuple[float, float], bool]:
        """Refuse: a mesh has it."""
        raise InputError("texture", "an object whose mesh has colours", "none: resolve it first")


class OfVertices(OfMesh):
    """Values at the corners of a mesh's faces.

    Parameters
    ----------
    band : int, optional
        Of red (0), green (1) or blue (2); their luminance by default.
    """

    laid: ClassVar[bool] = False
    band: Literal[0, 1, 2] | None = None

    def in_band(self, k: int) -> OfVertices:
        """Return the red (0), green (1) or blue (2) values."""
        return self.model_copy(update={"band": k})

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``mesh_attribute``."""
        return {"type": "mesh_attribute", "name": VERTEX_ALBEDO, "scale": self.scale}


class Tint(Texture):
    """One colour all over: three numbers in the place of one.

    Parameters
    ----------
    values : (float, float, float)
        Linear, of red, green and blue light, in [0, 1].
    """

    laid: ClassVar[bool] = False
    values: tuple[Share, Share, Share]

    def tile(self) -> tuple[NDArray[np.float32], tuple[float, float], bool]:
        """Return one texel of the colour's luminance."""
        return np.array([[luminance(self.values)]], np.float32), (1.0, 1.0), True

    def in_band(self, k: int) -> float:
        """Return the number of a band."""
        return self.scale * self.values[k]

    def mitsuba(self) -> dict[str, Any]:
        """Return a spectrum of the colour's luminance."""
        return {"type": "uniform", "value": self.scale * float(luminance(self.values))}


#: Textures by name.  To add one, write its class and name it here; outside slbench the entry-point
#: group ``slbench.textures``, or a module that a scene names.
textures: Registry[type[Texture]] = Registry(
    "texture",
    "slbench.textures",
    {
        "picture": "slbench.scene.surfaces.textures:Picture",
        "mesh": "slbench.scene.surfaces.textures:OfMesh",
        "checker": "slbench.scene.drawn:Checker",
        "stripes": "slbench.scene.drawn:Stripes",
        "noise": "slbench.scene.drawn:Noise",
        "speckle": "slbench.scene.drawn:Spots",
        "text": "slbench.scene.drawn:Text",
    },
    base="slbench.scene.surfaces.textures:Texture",
)

_EXPECTED = "a number in [0, 1], a picture's file, or a table with texture"
#: Parameters of a material that may have a colour.
COLOURED = ("albedo",)
#: A share, or a texture of shares.
ShareMap = Annotated[Share | InstanceOf[Texture], Words(_EXPECTED)]
#: A roughness, or a texture of it.
FractionMap = Annotated[Fraction | InstanceOf[Texture], Words(_EXPECTED.replace("[0", "(0"))]
#: A map of normals, or none.
Normals = Annotated[InstanceOf[NormalMap] | None, Words("a picture of normals, or a table of one")]


def spectrum(value: float | Texture, least: float = 0.0) -> dict[str, Any]:
    """Return a number or a texture in Mitsuba's words, the same at all wavelengths.

    A texture's values are `least` at least.
    """
    if not isinstance(value, Texture):
        return {"type": "uniform", "value": float(value)}
    words = value.mitsuba()
    for key in {"bitmap", "value"} & words.keys() if least else ():
        words[key] = np.maximum(words[key], least)
    return words


def read_texture(value: Any, where: str, folder: Path | None, key: str = "albedo") -> Any:
    """Return what a material's key says: a texture of a file's name or a table, else the value.

    Parameters
    ----------
    value : object
        As the file has it.
    where : str
        Its place, for messages.
    folder : Path or None
        Which paths are relative to and stay inside of; None to take them as they are.
    key : str
        Of the material.  A picture is encoded as sRGB where it is an albedo, else linear.

    Raises
    ------
    InputError
        Naming the key at fault.
    """
    normal = key == "normal_map"
    if isinstance(value, str):
        value = {"path": value} if normal else {"texture": "picture", "path": value}
    if isinstance(value, list | tuple) and key in COLOURED:
        expected = "a number, or three of them in [0, 1]: of red, green and blue"
        try:
            return Tint(values=tuple(value))
        except ValueError:
            raise InputError(where, expected, shown(list(value))) from None
    if not isinstance(value, Mapping):
        return value
    if "texture" not in value and not normal:
        raise InputError(f"{where}.texture", f"one of {', '.join(textures)}", shown(dict(value)))
    values = dict(value)
    kind: type[Texture] = NormalMap
    if not normal:
        kind = textures.get(values.pop("texture"), f"{where}.texture")
        if kind is Picture and key != "albedo":
            values.setdefault("encoding", "linear")
    found = validated(kind, values, where)
    if not isinstance(found, Picture):
        return found
    if folder is not None:
        try:
            path = str(resources.inside(folder, found.path))
        except InputError as error:
            raise InputError(where, error.expected, error.got) from None
        found = found.model_copy(update={"path": path})
    try:
        return found.read()
    except InputError as error:
        raise InputError(where, error.expected, f"{Path(found.path).name}: {error.got}") from None
