"""What is left of an error without the detector, and which part of it is sampling.

The radiance itself is decoded.  What it is off by is physical (square panel pixels, and what a
pixel's footprint averages) or Monte Carlo: the second part is told by half of the samples
(:meth:`slbench.simulate.transport.LightTransport.half`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, inf, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.fusion import FusionWeights
from slbench.patterns import (
    Axis,
    Decoder,
    NoiseModel,
    PatternSequence,
    PhaseMap,
    Response,
    decode,
    decoded_by,
)
from slbench.rig import Projector
from slbench.scene.truth import GroundTruth
from slbench.simulate.expose import radiance_batches
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]

#: Memory for noise-free frames at a time.
_BAND_BYTES = 1 << 27
#: Share of the mean square error by sampling that is worth a word: 5 % of the RMS.
_SEEN = 0.1
#: Share of the pixels that tell the sampling error: beside an edge, a pixel's lens may see another
#: surface in one sample of many, and half of the samples in none or two of fewer.
_ORDINARY = 0.99
#: Most times the root of the samples that is advised.
_MOST = 100.0
#: Side of the tiles in which the sampling error of most pixels is alike, px, and how many draws the
#: tile's is worth beside a pixel's own.
_ALIKE, _NEIGHBOURS = 16, 4.0


@dataclass(frozen=True, eq=False)
class Floor:
    """Error of noise-free panel coordinates.

    Parameters
    ----------
    rms_px : float
        The whole, over smooth lit pixels.
    sampling_rms_px : float
        The Monte Carlo part of it, by what decodes otherwise from half of the samples, for 99 % of
        the pixels; NaN where the halves were not kept.
    sampling_px : dict of axis to (V, U) float
        That part as a deviation of each pixel; without entries where it is not known.
    """

    rms_px: float
    sampling_rms_px: float
    sampling_px: dict[Axis, Array]


def noise_free_coordinates(
    transports: LightTransport | Sequence[LightTransport],
    sequence: PatternSequence,
    projector: Projector,
    weights: FusionWeights | None = None,
    decoder: Decoder | None = None,
    response: Response | None = None,
) -> dict[Axis, Array]:
    """Decode the radiance itself, before the detector: the renderer's own error floor.

    What is left is not noise but geometry and sampling: the projector's square pixels, the
    pixel's footprint, and the Monte Carlo error of the light transport.

    Parameters
    ----------
    transports : LightTransport, or a sequence of them
        One a focus setting.
    sequence : PatternSequence
    projector : Projector
    weights : FusionWeights, optional
        By which the settings are fused, where there are several.
    decoder : callable, optional
        Of the user's own; it gets float32 frames whose full white is 200.
    response : Response, optional
        Of the projector, which decoding takes out.

    Returns
    -------
    dict of axis to (V, U) float
        Panel coordinates, NaN where the modulation is below 1/200 of full white.
    """
    settings = [transports] if isinstance(transports, LightTransport) else list(transports)
    middle = settings[len(settings) // 2]
    scale = np.float32(200.0 / max(float(np.percentile(middle.white(), 99.0)), 1e-30))
    height, width = middle.shape
    rows = max(1, _BAND_BYTES // (4 * width * sequence.n_frames))
    if sequence.spatial or decoder is not None:  # which may look at neighbours
        rows = height
    bands: list[dict[Axis, Array]] = []
    for first in range(0, height, rows):
        own = slice(first, first + rows)
        stack = np.empty((sequence.n_frames, min(rows, height - first), width), np.float32)
        parts = [transport.band(own) for transport in settings]
        weighed = None if weights is None else _band(weights, own)
        for indices, radiance in fused_radiance(parts, sequence, projector, weighed):
            stack[indices] = radiance * scale
        if decoder is not None:
            return decoded_by(decoder, stack, sequence, "decoder, without noise").coordinate
        exact = NoiseModel(step_dn=0.0)
        options: dict[str, Any] = {"noise": exact, "min_modulation": 1.0, "response": response}
        bands.append(decode(stack, sequence, **options).coordinate)
    return {axis: np.concatenate([band[axis] for band in bands]) for axis in bands[0]}


def fused_radiance(
    transports: Sequence[LightTransport],
    sequence: PatternSequence,
    projector: Projector,
    weights: FusionWeights | None,
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.floating]]]:
    """Yield frame indices and their radiance images, the settings' fused where there are weights.

    Parameters are those of :func:`noise_free_coordinates`.
    """
    batches = [radiance_batches(transport, sequence, projector) for transport in transports]
    for settings in zip(*batches, strict=True):
        indices = settings[0][0]
        if weights is None:
            yield settings[0]
            continue
        images = [radiance for _, radiance in settings]
        fused = (weights.fuse([image[k] for image in images]) for k in range(len(indices)))
        yield indices, np.stack(list(fused))


def floor_of(
    transport: LightTransport, sequence: PatternSequence, projector: Projector, truth: GroundTruth
) -> Floor:
    """Return the error of noise-free panel coordinates."""
    smooth = truth.smooth()
    coordinates = noise_free_coordinates(transport, sequence, projector)
    errors = [
        (coordinate - truth.panel[..., "uv".index(axis)])[smooth]
        for axis, coordinate in coordinates.items()
    ]
    half = transport.half()
    if half is None:
        return Floor(rms(errors), float("nan"), {})
    others = noise_free_coordinates(half, sequence, projector)
    draws = {axis: others[axis] - coordinates[axis] for axis in others}
    sampling = ordinary_rms([draw[smooth] for draw in draws.values()])
    return Floor(rms(errors), sampling, {axis: _around(draw) for axis, draw in draws.items()})


def halves(transports: Sequence[LightTransport]) -> list[LightTransport] | None:
    """Return the transports by one half of their samples; None where these were not kept."""
    found = [half for transport in transports if (half := transport.half()) is not None]
    return found if len(found) == len(transports) else None


def phase_map(coordinate: dict[Axis, Array], like: Mapping[Axis, Array] | None = None) -> PhaseMap:
    """Return noise-free coordinates as what a decoder returns: no deviation, no modulation.

    Parameters
    ----------
    coordinate : dict of axis to (V, U) float
        NaN where there is none.
    like : mapping of axis to (V, U) float, optional
        Deviations by which two axes are to be weighed, as those of a capture are; where it has
        none, their median.
    """
    first = next(iter(coordinate.values()))
    mask = np.logical_and.reduce([np.isfinite(values) for values in coordinate.values()])
    nothing = np.zeros(first.shape, np.float32)
    sigma = {}
    for axis in coordinate:
        own = np.zeros(first.shape) if like is None else like[axis]
        known = own[np.isfinite(own)]
        usual = np.median(known) if len(known) else 0.0
        sigma[axis] = np.where(mask, np.where(np.isfinite(own), own, usual), np.nan)
    return PhaseMap(coordinate, sigma, nothing, nothing, mask, {})


def more_samples(samples: int, whole: float, sampling: float) -> int | None:
    """Return how many samples would make sampling 5 % of an error; None where it is less.

    Parameters
    ----------
    samples : int
        That there are.
    whole, sampling : float
        The error and its Monte Carlo part, which falls with the number of samples, at least with
        its root; any unit.
    """
    if not sampling**2 > _SEEN * whole**2:
        return None
    ratio = sampling / whole if whole > 0.0 else inf
    return samples * ceil(min(ratio / sqrt(_SEEN), _MOST)) ** 2


def rms(parts: Sequence[Array], share: float = 1.0) -> float:
    """Return the RMS of what is finite; of a share of it, the smallest."""
    squares = np.sort(np.concatenate([part[np.isfinite(part)] ** 2 for part in parts]))
    squares = squares[: round(share * squares.size)]
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")


def ordinary_rms(parts: Sequence[Array]) -> float:
    """Return the RMS of a draw of the sampling error over 99 % of the pixels."""
    return rms(parts, _ORDINARY)


def _around(draw: Array) -> Array:
    """Return the deviation of a draw at each pixel, by what is usual around it and by its own.

    Beside an edge a pixel may be many times worse than its neighbours, and half of its samples
    tell it; in the middle of a surface one draw tells little.  NaN where there is none.
    """
    rows, columns = (-(-size // _ALIKE) for size in draw.shape)
    tiled = np.full((rows * _ALIKE, columns * _ALIKE), np.nan)
    tiled[: draw.shape[0], : draw.shape[1]] = np.abs(draw)
    tiles = tiled.reshape(rows, _ALIKE, columns, _ALIKE).transpose(0, 2, 1, 3)
    flat = np.sort(tiles.reshape(rows, columns, -1), axis=-1)  # NaN last
    known = np.isfinite(flat).sum(axis=-1, keepdims=True)
    usual = 1.4826 * np.take_along_axis(flat, np.maximum(known - 1, 0) // 2, axis=-1)[..., 0]
    spread = usual.repeat(_ALIKE, axis=0).repeat(_ALIKE, axis=1)
    spread = spread[: draw.shape[0], : draw.shape[1]]
    return np.asarray(np.sqrt((_NEIGHBOURS * spread**2 + draw**2) / (_NEIGHBOURS + 1.0)))


def _band(weights: FusionWeights, rows: slice) -> FusionWeights:
    parts = weights.weights[:, rows], weights.focus[rows], weights.selectivity_db[rows]
    return FusionWeights(*parts)
