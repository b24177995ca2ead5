r"""Scenes in colour: three bands of light, what the projector emits and the camera sees of each.

The bands are red, green and blue; light of one does not become light of another.  Of the panel's
three pictures ``p_j`` (after its response) band ``k`` gets ``sum_j P_kj p_j`` with the *primaries*
P.  It is scattered by the albedo of that band, along the light transport ``T_k``, with ambient
light ``A_k``.  Camera channel ``i`` sees ``sum_k R_ik (T_k sum_j P_kj p_j + A_k)``, R being the
camera's *response*.  The cross-talk of a white surface is ``R P`` (D. Caspi, N. Kiryati, J. Shamir,
"Range imaging with adaptive color structured light", IEEE Trans. Pattern Anal. Mach. Intell. 20(5),
1998, whose model this is).

A lens has *lateral colour*: the picture of a band is larger by a scale about the principal point.
The scene's rig is that of a scale of 1, and so is what is true.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from slbench.core.colour import BANDS, Band
from slbench.core.errors import InputError
from slbench.core.validation.types import FINITE, Interval, NotNegative, Words
from slbench.core.validation.values import Value
from slbench.patterns.crosstalk import Crosstalk
from slbench.rig import Device, Rig

_Share = Annotated[float, FINITE, Interval(ge=0.0, le=3.0)]
_Row = tuple[_Share, _Share, _Share]
_ROWS = Words(
    "three rows of three shares of about one, of red, green and blue (0.84, and not 84 %)"
)
#: Row by row.
Matrix = Annotated[tuple[_Row, _Row, _Row], _ROWS]
#: Of a lens that makes pictures; microscopes' worst are 1.01.
_Scale = Annotated[float, FINITE, Interval(ge=0.9, le=1.1)]
Scales = Annotated[
    tuple[_Scale, _Scale, _Scale],
    Words("three scales in [0.9, 1.1], of red, green and blue: 1.0005 for half a per mille"),
]
Levels = Annotated[
    tuple[NotNegative, NotNegative, NotNegative],
    Words("three numbers >= 0, of red, green and blue"),
]
Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
Demosaic = Literal["bilinear", "edge-aware"]

IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
#: Scales beyond which one is questioned: half a per cent is 3 px in the corner of 1 megapixel.
_USUAL_SCALE = 0.005
_Device = TypeVar("_Device", bound=Device)
#: How far sums are from one that are taken for it.
_ONE = 0.01


@dataclass(frozen=True)
class Colour(Value):
    """Three bands of light (``[colour]``).

    Parameters
    ----------
    primaries : ((float, float, float), ...) of three
        Row k: what band k has of the projector's red, green and blue, in units of its flux.
    response : ((float, float, float), ...) of three
        Row i: what camera channel i sees of red, green and blue light, in units of the detector's
        quantum efficiency at its wavelength.
    camera_scale, projector_scale : (float, float, float)
        Lateral colour: the size of each band's picture on the sensor and off the panel, about the
        principal point.
    ambient : (float, float, float)
        Factors on the scene's ambient light.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Colours of the first two pixels of the first two rows, of a camera with one sensor under a
        mosaic of filters.  Without, a camera has three sensors.
    demosaic : {"bilinear", "edge-aware"}
        What fills the gaps of the mosaic, by OpenCV.
    channel : {"red", "green", "blue"}
        Camera channel by which grey patterns are decoded.
    unmix : bool
        Whether colour patterns that state no cross-talk of their own are taken apart by that of the
        scene.

    Raises
    ------
    InputError
        For values outside their range.
    """

    primaries: Matrix = IDENTITY
    response: Matrix = IDENTITY
    camera_scale: Scales = (1.0, 1.0, 1.0)
    projector_scale: Scales = (1.0, 1.0, 1.0)
    ambient: Levels = (1.0, 1.0, 1.0)
    bayer: Mosaic | None = None
    demosaic: Demosaic = "bilinear"
    channel: Band = "green"
    unmix: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for row, band in zip(self.crosstalk, BANDS, strict=True):
            if not any(row):
                expected = f"light of the projector that the {band} channel sees"
                raise InputError("colour: response", expected, "none")

    def __repr__(self) -> str:
        rows = "; ".join(" ".join(f"{share:.3g}" for share in row) for row in self.crosstalk)
        camera = "three sensors" if self.bayer is None else f"{self.bayer} mosaic, {self.demosaic}"
        return f"<Colour, cross-talk [{rows}], {camera}, {self.channel} decoded>"

    @property
    def crosstalk(self) -> Crosstalk:
        """What camera channel i sees of the projector's primary j on a white surface, ``R P``."""
        found = np.array(self.response) @ np.array(self.primaries)
        return tuple(tuple(row) for row in found.tolist())

    @property
    def decoded(self) -> int:
        """Index of the channel by which grey patterns are decoded."""
        return BANDS.index(self.channel)

    def rig(self, rig: Rig, k: int) -> Rig:
        """Return the rig as a band sees it: each lens with the scale of its picture."""
        camera = _scaled(rig.cameras, self.camera_scale[k])
        projector = _scaled(rig.projectors, 1.0 / self.projector_scale[k])
        return rig.having(**camera, **projector) if camera or projector else rig

    def sites(self, shape: tuple[int, int]) -> NDArray[np.intp]:
        """Return the channel that each pixel of the mosaic sees, (V, U) int."""
        assert self.bayer is not None
        cell = np.array(["RGB".index(letter) for letter in self.bayer]).reshape(2, 2)
        rows, columns = shape
        return np.tile(cell, (-(-rows // 2), -(-columns // 2)))[:rows, :columns]

    def doubts(self) -> list[tuple[str, str]]:
        """Return what is odd: (key, sentence)."""
        found = []
        for key in ("primaries", "response"):
            matrix = np.array(getattr(self, key))
            # A channel is normalised by white light, a primary by its flux.
            axis = 1 if key == "response" else 0
            usual, other = matrix.sum(axis=axis), matrix.sum(axis=1 - axis)
            if np.abs(other - 1.0).max() < _ONE < np.abs(usual - 1.0).max():
                sums = ", ".join(f"{value:.3g}" for value in usual)
                names = ("columns", "rows") if axis else ("rows", "columns")
                found.append((key, f"{names[0]} sum to 1 and {names[1]} to {sums}: transposed?"))
            if swapped := _swapped(matrix):
                found.append((key, swapped))
        for key in ("camera_scale", "projector_scale"):
            largest = max(getattr(self, key), key=lambda scale: abs(scale - 1.0))
            if abs(largest - 1.0) > _USUAL_SCALE:
                size = 100.0 * abs(largest - 1.0)
                found.append(
                    (key, f"{largest:g} is {size:.2g} %, and lenses have 0.1 %: per mille?")
                )
        return found


def _swapped(matrix: NDArray[np.float64]) -> str | None:
    """Question a matrix whose red and blue are the other way round, as in pictures of OpenCV."""
    if np.trace(matrix) < np.trace(matrix[::-1]):
        return "red and blue change places: rows in the order blue, green, red?"
    return None


def _scaled(devices: Mapping[str, _Device], factor: float) -> dict[str, _Device]:
    """Return devices whose pictures are larger by a factor: of pixels that are smaller."""
    if factor == 1.0:
        return {}
    return {
        name: replace(one, pitch_mm=(one.pitch_mm[0] / factor, one.pitch_mm[1] / factor))
        for name, one in devices.items()
    }
