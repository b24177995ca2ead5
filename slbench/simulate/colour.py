"""Light transport in colour: what the three channels of a camera see of three primaries.

A :class:`ColourTransport` has the light transport of each band (:mod:`slbench.scene.colour`).  By
itself it is that of grey patterns to the channel by which they are decoded, so that all that asks
light transport for radiance works; what asks for its matrix gets one band's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.colour import BANDS
from slbench.core.errors import InputError
from slbench.core.io import read_npz, write_npz
from slbench.core.random import tagged_seed
from slbench.detector import DetectorModel
from slbench.patterns import NoiseModel
from slbench.scene.colour import Colour
from slbench.simulate.transport import COLOUR, ENTRIES, LightTransport, Marginal

#: Photons of the flat field by which a demosaic's noise is found, and its sides.
_FLAT, _SIDE = 20_000.0, 256


@dataclass(frozen=True)
class ColourTransport(LightTransport):
    """Light transport in three bands.

    Parameters
    ----------
    marginals, ambient, panel, samples
        As of a :class:`LightTransport`; the first are those of the decoded channel's band, and
        ``ambient`` is what that channel sees.
    bands : (LightTransport, LightTransport, LightTransport)
        Of red, green and blue light; the same one where nothing tells them apart.
    colour : Colour
    """

    bands: tuple[LightTransport, LightTransport, LightTransport]
    colour: Colour

    @classmethod
    def of(cls, bands: Sequence[LightTransport], colour: Colour) -> Self:
        """Return the light transport of three bands."""
        red, green, blue = bands
        own = bands[colour.decoded]
        ambient = _ambient(bands, colour)[colour.decoded]
        return cls(own.marginals, ambient, own.panel, own.samples, (red, green, blue), colour)

    def __repr__(self) -> str:
        return f"ColourTransport of three bands; {LightTransport.__repr__(self.bands[1])}"

    def _each(self, change: Callable[[LightTransport], LightTransport]) -> Self:
        """Return it with its bands changed; what is the same for several stays so."""
        made: dict[int, LightTransport] = {}
        for band in self.bands:
            if id(band) not in made:
                made[id(band)] = change(band)
        return self.of([made[id(band)] for band in self.bands], self.colour)

    def seen(
        self, panels: ArrayLike, along: Marginal = "u", channels: Sequence[int] = (0, 1, 2)
    ) -> NDArray[np.float32]:
        """Return what channels of the camera see of pictures in colour.

        Parameters
        ----------
        panels : (3, n, W), (3, n, H) or (3, n, H, W) float
            Of the panel's red, green and blue primaries, in [0, 1].
        along : {"u", "v", "uv"}
        channels : sequence of int
            Of red (0), green (1) and blue (2).

        Returns
        -------
        (channels, n, V, U) float32
            W / (mm^2 sr), in units of the green detector's response.
        """
        values = np.asarray(panels, dtype=np.float64)
        emitted = np.einsum("kj,j...->k...", np.array(self.colour.primaries), values)
        out = np.zeros((len(channels), values.shape[1], *self.shape), np.float32)
        for i, channel in enumerate(channels):
            for band, light in self._summed(emitted, self.colour.response[channel]):
                dark = replace(band, ambient=np.zeros_like(band.ambient))
                # A matrix of the whole camera at a time: a band of one frame is the largest.
                out[i] += dark.relight(light, along)
            out[i] += self.ambients[channel]
        return out

    def _summed(
        self, emitted: NDArray[np.float64], response: Sequence[float]
    ) -> list[tuple[LightTransport, NDArray[np.float64]]]:
        """Return what to look up in which band, summed over bands that are the same."""
        sums: dict[int, NDArray[np.float64]] = {}
        for band, light, share in zip(self.bands, emitted, response, strict=True):
            if share:
                sums[id(band)] = sums.get(id(band), 0.0) + share * light
        return [(band, sums.pop(id(band))) for band in self.bands if id(band) in sums]

    @property
    def ambients(self) -> tuple[NDArray[np.float32], ...]:
        """What each channel sees with the panel dark, (V, U) each."""
        return _ambient(self.bands, self.colour)

    def relight(self, panels: ArrayLike, along: Marginal = "u") -> NDArray[np.float32]:
        """Return what the decoded channel sees of grey patterns, (n, V, U)."""
        values = np.asarray(panels, dtype=np.float64)
        return self.seen(np.stack([values] * 3), along, (self.colour.decoded,))[0]

    def relight_images(self, images: ArrayLike) -> NDArray[np.float32]:
        """Return what the decoded channel sees of grey panel images (n, H, W); needs "uv"."""
        return self.relight(images, "uv")

    def whites(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Return what each channel sees of the fully lit and the dark panel, (V, U) each."""
        marginal: Marginal = next(iter(self.marginals))
        seen = self.seen(np.ones((3, 1, self._size(marginal))), marginal)[:, 0]
        return list(zip(seen, self.ambients, strict=True))

    def white(self) -> NDArray[np.float32]:
        """Return what the decoded channel sees of the fully lit panel, (V, U)."""
        return self.whites()[self.colour.decoded][0]

    def half(self) -> Self | None:
        """Return the transport by one half of the samples; None where that was not kept."""
        halves = {id(band): band.half() for band in self.bands}
        found = [one for band in self.bands if (one := halves[id(band)]) is not None]
        return self.of(found, self.colour) if len(found) == len(self.bands) else None

    def band(self, rows: slice) -> Self:
        """Return the transport to the image rows `rows` (without step)."""
        return self._each(lambda one: one.band(rows))

    def chosen(self, pixels: NDArray[np.intp]) -> Self:
        """Return the transport to some pixels (P,), flat indices, as an image of one row."""
        return self._each(lambda one: one.chosen(pixels))

    def save(self, path: str | Path) -> None:
        """Write all bands as one ``.npz`` without pickles; those that are the same once."""
        ids = [id(band) for band in self.bands]
        first = [ids.index(one) for one in ids]
        matrices = np.array([self.colour.primaries, self.colour.response])
        arrays = {
            "format": np.array(COLOUR),
            "same_as": np.array(first),
            "matrices": matrices,
            "decoded": np.array(self.colour.decoded),
        }
        for k in sorted(set(first)):
            own = self.bands[k].arrays()
            arrays |= {f"{BANDS[k]}_{name}": array for name, array in own.items()}
        write_npz(path, **arrays)

    @classmethod
    def load(cls, path: str | Path, content: bytes | None = None) -> Self:
        """Read what :meth:`save` wrote.

        Its colour is what light needs of it: primaries, response and the decoded channel.

        Parameters
        ----------
        path : str or Path
        content : bytes, optional
            Of the file, where it is at hand.

        Raises
        ------
        InputError
            If the file is missing, corrupt, or inconsistent.
        """
        beside = ("format", "same_as", "matrices", "decoded")
        names = (*beside, *(f"{band}_{name}" for band in BANDS for name in ENTRIES))
        arrays = read_npz(path, names, content)
        where = f"{path}: format"
        if int(arrays.get("format", np.array(0)).ravel()[0]) != COLOUR:
            raise InputError(where, f"{COLOUR}, of light transport in colour", "another")
        try:
            same = [int(k) for k in arrays["same_as"]]
            primaries, response = arrays["matrices"].tolist()
            colour = Colour(primaries, response, channel=BANDS[int(arrays["decoded"])])
            if any(not 0 <= k <= i or same[k] != k for i, k in enumerate(same)) or len(same) != 3:
                raise ValueError
        except (KeyError, ValueError, TypeError, IndexError):
            raise InputError(path, "three consistent bands of light", "damaged ones") from None
        bands: list[LightTransport] = []
        for i, k in enumerate(same):
            prefix = f"{BANDS[k]}_"
            own = {n[len(prefix) :]: a for n, a in arrays.items() if n.startswith(prefix)}
            bands.append(bands[k] if k < i else LightTransport.of_arrays(own, path))
        if len({(band.shape, band.panel, tuple(band.marginals)) for band in bands}) > 1:
            raise InputError(path, "three bands of one picture and panel", "others")
        return cls.of(bands, colour)

    def _one_band(self) -> NoReturn:
        raise InputError("light transport", "that of one band (bands[1] is green)", "one in colour")

    def view_from_projector(self, camera_image: ArrayLike) -> NDArray[np.float64]:
        """Refuse: a band has it."""
        self._one_band()

    def to_scipy(self, along: Marginal = "u") -> NoReturn:
        """Refuse: a band has it."""
        self._one_band()

    def factors(self, along: Marginal = "u") -> NoReturn:
        """Refuse: a band has it."""
        self._one_band()

    def torch(self, along: Marginal = "u", **options: Any) -> NoReturn:
        """Refuse: a band has it."""
        self._one_band()


def _ambient(bands: Sequence[LightTransport], colour: Colour) -> tuple[NDArray[np.float32], ...]:
    """Return what each channel sees with the panel dark, (V, U) each."""
    dark = np.stack([band.ambient for band in bands]).astype(np.float64)
    return tuple(np.einsum("ik,kvu->ivu", colour.response, dark).astype(np.float32))


def chips(detector: DetectorModel) -> tuple[DetectorModel, ...]:
    """Return the detectors of a camera of three: each with a fixed pattern of its own.

    The green one is the scene's.
    """
    seed = getattr(detector, "seed", None)
    if not isinstance(seed, int):
        return (detector,) * len(BANDS)
    other: Any = detector
    red, blue = (replace(other, seed=tagged_seed(seed, k)) for k in (0, 2))
    return red, detector, blue


def exposed(
    radiance: NDArray[np.float32],
    colour: Colour,
    detector: DetectorModel,
    exposure_s: float,
    streams: Sequence[np.random.Generator],
    *,
    noise: bool,
    scale: float,
) -> NDArray[Any]:
    """Expose pictures in colour.

    Parameters
    ----------
    radiance : (3, n, V, U) float32
        Of the channels.
    colour : Colour
    detector : DetectorModel
    exposure_s : float
    streams : three numpy.random.Generator
        Of the temporal noise of each channel; the first is that of a mosaic.
    noise : bool
    scale : float
        Photons a unit of radiance.

    Returns
    -------
    (n, V, U, 3) uint8 or uint16
        Red, green, blue.
    """
    if colour.bayer is None:
        sensors = zip(chips(detector), radiance, streams, strict=True)
        each = [one.expose(own, exposure_s, rng, noise, scale) for one, own, rng in sensors]
        return np.stack(each, axis=-1)
    sites = colour.sites(radiance.shape[2:])
    mosaic = np.take_along_axis(radiance, sites[np.newaxis, np.newaxis], axis=0)[0]
    frames = detector.expose(mosaic, exposure_s, streams[0], noise, scale)
    return np.stack([demosaiced(frame, colour) for frame in frames])


def demosaiced(frame: NDArray[Any], colour: Colour) -> NDArray[Any]:
    """Return the picture (V, U, 3) of a mosaic (V, U), red first, by OpenCV."""
    code = {"bilinear": "", "edge-aware": "_EA"}[colour.demosaic]
    # Edge-aware leaves the border of a picture black: it is that of the pixels beside it.
    wide = cv2.copyMakeBorder(frame, 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
    found = cv2.cvtColor(wide, getattr(cv2, f"COLOR_Bayer{colour.bayer}2RGB{code}"))
    return np.ascontiguousarray(found[2:-2, 2:-2])


def noise_of(colour: Colour, detector: DetectorModel, channels: Sequence[int]) -> NoiseModel:
    """Return the temporal noise of the frames of channels, for the decoder.

    Pixels between those of a mosaic are means of several and have less of it: the variance is the
    mean over all pixels, as a flat field has it.
    """
    noise = detector.noise_model()
    if colour.bayer is None:
        return noise
    flat = np.random.default_rng(0).normal(_FLAT, 0.01 * _FLAT, (_SIDE, _SIDE))
    found = demosaiced(np.rint(flat).astype(np.uint16), colour).astype(np.float64)
    share = float(np.mean(found.var(axis=(0, 1))[list(channels)]) / flat.var())
    return replace(
        noise, read_dn=noise.read_dn * share**0.5, gain_dn_per_e=noise.gain_dn_per_e * share
    )
