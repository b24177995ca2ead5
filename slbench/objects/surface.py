"""What a mesh brings beside its triangles: how parts look, in one band of light or in three.

A part has one number, a picture, or values at the corners of its faces.  All are *albedos*: the
linear luminance of the file's base colour (:mod:`slbench.core.colour`), and beside it the colour.
What a scene makes of them, and what it states instead, is the scene's business.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.colour import decode_srgb, unit_range
from slbench.core.errors import InputError


@dataclasses.dataclass(frozen=True, eq=False)
class Coloured:
    """The colours of a picture, as its file has them: a band's values are made when asked for.

    Parameters
    ----------
    encoded : (H, W, 3 or more) uint8, uint16 or float
        Red, green, blue; the first row on top.
    srgb : bool
        Whether they are encoded as sRGB; linear otherwise.
    factor : (float, float, float)
        On the linear values.
    """

    encoded: NDArray[Any]
    srgb: bool = True
    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def band(self, k: int) -> NDArray[np.float32]:
        """Return the linear values of red (0), green (1) or blue (2), (H, W) in [0, 1]."""
        values = unit_range(self.encoded[..., k])
        linear = decode_srgb(values) if self.srgb else values
        return np.clip(self.factor[k] * linear, 0.0, 1.0).astype(np.float32)


class Pixels:
    """Values in [0, 1] of a texture's tile, read-only, equal where they are the same.

    Parameters
    ----------
    values : (H, W) or (H, W, 3) array_like of float
        The first row on top.
    colours : Coloured, optional
        Of which `values` are the luminance.
    """

    def __init__(self, values: ArrayLike, colours: Coloured | None = None) -> None:
        self.colours = colours
        self.values: NDArray[np.float32] = np.array(values, dtype=np.float32)
        self.values.setflags(write=False)
        shape = repr(self.values.shape).encode()
        self.sha256 = hashlib.sha256(shape + self.values.tobytes()).hexdigest()

    def __repr__(self) -> str:
        height, width = self.values.shape[:2]
        return f"<Pixels, {width} x {height}, SHA-256 {self.sha256[:16]}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pixels) and self.sha256 == other.sha256

    def __hash__(self) -> int:
        return hash(self.sha256)

    def band(self, k: int) -> Pixels:
        """Return the values in a band of light, of red (0), green (1) or blue (2)."""
        return self if self.colours is None else Pixels(self.colours.band(k))


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """The base colour that a file states for a part.

    Parameters
    ----------
    albedo : float
        In [0, 1]; the only one, or a factor that `picture` and corners hold already.
    picture : Pixels, optional
        Albedo of a texture's texels, the first row on top (texture coordinate v = 1).
    corners : bool
        Whether the albedo stands at the corners of the mesh's faces
        (:attr:`slbench.objects.artefact.Mesh.albedo`).
    metallic, roughness : float or Pixels, optional
        As glTF's, in [0, 1], where the file states them.
    normals : Pixels, optional
        A map of normals in tangent space, (H, W, 3).
    colour : (float, float, float), optional
        Of which `albedo` is the luminance, where it stands alone.
    """

    albedo: float = 1.0
    picture: Pixels | None = None
    corners: bool = False
    metallic: float | Pixels | None = None
    roughness: float | Pixels | None = None
    normals: Pixels | None = None
    colour: tuple[float, float, float] | None = None

    def __repr__(self) -> str:
        if self.picture is not None:
            height, width = self.picture.values.shape
            return f"<Surface, albedo of {width} x {height} px>"
        return "<Surface, albedo at corners>" if self.corners else f"<Surface of {self.albedo:.3g}>"


def corner_values(values: Any, count: int, width: int, what: str) -> NDArray[np.float64] | None:
    """Return values at the corners of faces as a read-only array, or None.

    Raises
    ------
    InputError
        If they are not (count, 3, width); (count, 3) for a width of 0.
    """
    if values is None:
        return None
    array = np.array(values, dtype=np.float64)
    shape = (count, 3, width) if width else (count, 3)
    if array.shape != shape:
        raise InputError(f"mesh: {what}", f"an array of shape {shape}", array.shape)
    array.setflags(write=False)
    return array
