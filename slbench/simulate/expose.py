"""Frames exposed from light transport: ``transport x patterns x detector -> frames``.

Every frame is a sparse product and a noise draw.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture, ColourPictures
from slbench.capture.exposures import Bracket
from slbench.core.colour import BANDS
from slbench.core.errors import InputError
from slbench.core.random import Word, generator, tagged_seed
from slbench.detector import DetectorModel
from slbench.patterns import NoiseModel, PatternSequence, panel_response
from slbench.patterns.base import Variation
from slbench.patterns.crosstalk import mixed
from slbench.rig import Camera, Projector, Rig
from slbench.scene.doubts import unlit
from slbench.scene.model import Exposure, Scene
from slbench.simulate.colour import ColourTransport, exposed, noise_of
from slbench.simulate.frame_errors import FrameErrors, frame_errors
from slbench.simulate.moving import Batch, MovingLight
from slbench.simulate.transport import LightTransport

#: Exposure time that the dark signal is computed with where the light's power is unknown (a
#: pinhole camera, automatic exposure).
NOMINAL_EXPOSURE_S = 0.01
#: Memory of a channel's radiance images at a time.
_COLOUR_BYTES = (1 << 28) // 3
#: Tag of the random streams of exposures after the first.
_BRACKET = 5


class NothingLit(InputError):
    """The projector lights nothing that the camera sees."""


@contextmanager
def lighting(scene: Scene) -> Iterator[None]:
    """Say of a scene in which nothing is lit why, where its exposure is looked for."""
    try:
        yield
    except NothingLit as error:
        why = f"none: {unlit(scene)}"
        raise NothingLit(f"scene {scene.name}", error.expected, why) from None


class Shutter(NamedTuple):
    """What a picture is exposed with: photons per unit scene radiance, and seconds."""

    photons: float
    time_s: float

    def times(self, factor: float) -> Shutter:
        """Return the shutter of a longer exposure, or a shorter one."""
        return Shutter(self.photons * factor, self.time_s * factor)


def bracket_seed(seed: int, k: int) -> int:
    """Return the seed of exposure `k` of several; the first has the scan's own."""
    return seed if k == 0 else tagged_seed(seed, _BRACKET, k)


def _part_of(
    report: Callable[[float], None] | None, k: int, count: int
) -> Callable[[float], None] | None:
    """Return what reports the progress of one of several exposures."""
    return report and (lambda done: report((k + done) / count))


def capture(
    transport: LightTransport,
    sequence: PatternSequence,
    rig: Rig,
    detector: DetectorModel,
    exposure: Exposure,
    *,
    seed: int = 0,
    noise: bool = True,
    shutter: Shutter | None = None,
    moving: MovingLight | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Capture:
    """Expose the frames of patterns.

    Parameters
    ----------
    transport : LightTransport
        With the marginals of the axes that the sequence codes.
    sequence : PatternSequence
    rig : Rig
        One camera and one projector.
    detector : DetectorModel
    exposure : Exposure
    seed : int
        Of temporal noise and vibration.  The fixed pattern has the detector's own seed.
    noise : bool
        False: the expected frames, rounded once, without vibration and random frame errors.
    shutter : Shutter, optional
        Where another transport of the scene sets it (:func:`shutter_for`).
    moving : MovingLight, optional
        Of a scene that moves; the transport, of its middle, then sets the exposure alone.
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    Capture
        In colour, with its pictures, where the light is; of several exposures with its bracket.
    """
    if len(exposure.bracket) > 1:
        base = shutter or shutter_for(transport, rig.camera, detector, exposure)
        shots = [
            capture(
                *(transport, sequence, rig, detector, exposure.single()),
                seed=bracket_seed(seed, k),
                noise=noise,
                shutter=base.times(times),
                on_progress=_part_of(on_progress, k, len(exposure.bracket)),
            )
            for k, times in enumerate(exposure.bracket)
        ]
        values = np.stack([one.frames for one in shots])
        every_s = [base.times(times).time_s for times in exposure.bracket]
        bracket = Bracket.of(values, every_s, shots[0].top_dn)
        return replace(shots[0], frames=bracket.frames, exposure_s=max(every_s), bracket=bracket)
    base = shutter or shutter_for(transport, rig.camera, detector, exposure)
    factor, exposure_s = base.times(*exposure.bracket)
    n_pictures = -(-sequence.n_frames // sequence.channels)
    dtype = np.uint8 if detector.bit_depth == 8 else np.uint16
    rng = generator(seed, Word.NOISE)
    errors = frame_errors(exposure, rig.projector, n_pictures, exposure_s, seed=seed, noise=noise)
    moves = None
    if noise and exposure.vibration_px > 0:  # channels of a picture move together
        moves = generator(seed, Word.VIBRATION).normal(0.0, exposure.vibration_px, (n_pictures, 2))
    quiet = NoiseModel(offset_dn=detector.black_dn)
    pictures: ColourPictures | None = None
    done = 0
    if isinstance(transport, ColourTransport):
        colour = transport.colour
        values = np.empty((n_pictures, *transport.shape, len(BANDS)), dtype)
        streams = rng.spawn(len(BANDS))

        def in_colour(light: Any, pictures: Sequence[int] | None = None) -> Any:
            given = light, sequence, rig.projector
            return _picture_batches(*given, errors=errors, pictures=pictures)

        lit = in_colour(transport)
        if moving is not None:
            lit = moving.batches(sequence, exposure_s, errors, in_colour)
        for indices, seen in lit:
            if moves is not None:
                for channel in seen:
                    move_pictures(channel, moves[indices])
            taken = colour, detector, exposure_s, streams
            values[indices] = exposed(seen, *taken, noise=noise, scale=factor)
            done += len(indices)
            if on_progress:
                on_progress(done / n_pictures)
        pictures = ColourPictures(values, colour.channel if sequence.channels == 1 else None)
        frames = pictures.frames
        model = noise_of(colour, detector, pictures.channels) if noise else quiet
    else:
        frames = np.empty((sequence.n_frames, *transport.shape), dtype)

        def relit(light: LightTransport, pictures: Sequence[int] | None = None) -> Iterator[Batch]:
            return radiance_batches(light, sequence, rig.projector, errors, pictures)

        lit = relit(transport)
        if moving is not None:
            lit = moving.batches(sequence, exposure_s, errors, relit)
        for indices, radiance in lit:
            if moves is not None:
                move_pictures(radiance, moves[indices // sequence.channels])
            frames[indices] = detector.expose(radiance, exposure_s, rng, noise, factor)
            done += len(indices)
            if on_progress:
                on_progress(done / len(frames))
        model = detector.noise_model() if noise else quiet
    return Capture(
        frames,
        sequence,
        detector.bit_depth,
        model,
        rig,
        exposure_s,
        detector.saturation_dn,
        pair=rig.only,
        pictures=pictures,
        timing=None if moving is None else moving.timing(exposure_s),
    )


def radiance_batches(
    transport: LightTransport,
    sequence: PatternSequence,
    projector: Projector,
    errors: FrameErrors | None = None,
    pictures: Sequence[int] | None = None,
) -> Iterator[Batch]:
    """Yield frame indices and their radiance images, a bounded number at a time.

    In colour they are what the channels see by which the frames are decoded.  `pictures` are those
    that are wanted; all by default.
    """
    if isinstance(transport, ColourTransport):
        packed = sequence.channels > 1
        wanted = range(len(BANDS)) if packed else (transport.colour.decoded,)
        given = transport, sequence, projector, tuple(wanted), errors, pictures
        for shown, seen in _picture_batches(*given):
            indices = (shown[:, np.newaxis] * len(wanted) + np.arange(len(wanted))).ravel()
            yield indices, seen.swapaxes(0, 1).reshape(-1, *transport.shape)
        return
    for along in sequence.variations:
        indices = sequence.frames_along(along)
        if pictures is not None:
            indices = indices[np.isin(indices // sequence.channels, pictures)]
        for part in transport.batches(len(indices), along=along):
            chosen = indices[part]
            own = chosen // sequence.channels
            panel = _emitted(sequence, chosen, along, projector, errors, own)
            radiance = transport.relight(panel, along)
            for k, (frame, picture) in enumerate(zip(chosen, own, strict=True)):
                if errors is not None and errors.is_other(picture):
                    channel = int(frame % sequence.channels)
                    parts = transport, sequence, projector, errors
                    radiance[k] = _seen_instead(*parts, int(picture), channel)
            yield chosen, radiance


def _seen_instead(
    transport: LightTransport,
    sequence: PatternSequence,
    projector: Projector,
    errors: FrameErrors,
    picture: int,
    channel: int,
) -> NDArray[np.float32]:
    """Return the radiance (V, U) of a picture that sees other patterns than its own."""
    found = np.zeros(transport.shape, np.float32)
    for source, share in errors.seen_in(picture):
        frame = np.array([source * sequence.channels + channel])
        along = _variation(sequence, int(frame[0]))
        panel = _emitted(sequence, frame, along, projector, errors, np.array([picture]))
        found += np.float32(share) * transport.relight(panel, along)[0]
    return found


def _variation(sequence: PatternSequence, frame: int) -> Variation:
    """Return what a frame varies along."""
    return next(a for a in sequence.variations if frame in sequence.frames_along(a))


def _picture_batches(
    transport: ColourTransport,
    sequence: PatternSequence,
    projector: Projector,
    channels: Sequence[int] = (0, 1, 2),
    errors: FrameErrors | None = None,
    pictures: Sequence[int] | None = None,
) -> Iterator[Batch]:
    """Yield indices of pictures in colour (n,) and what channels see of them, (channels, n, V, U).

    A grey pattern is shown by all three primaries.  `pictures` are those that are wanted.
    """
    count = sequence.channels

    def seen(shown: NDArray[np.intp], at: NDArray[np.intp], along: Variation) -> Any:
        frames = (shown[:, np.newaxis] * count + np.arange(count)).ravel()
        panel = _panel(sequence, frames, along, projector, errors, np.repeat(at, count))
        primaries = panel.reshape(-1, count, *panel.shape[1:]).swapaxes(0, 1)
        if count == 1:
            primaries = np.concatenate([primaries] * len(BANDS))
        return transport.seen(primaries, along, channels)

    for along in sequence.variations:
        own = np.unique(sequence.frames_along(along) // count)
        if pictures is not None:
            own = own[np.isin(own, pictures)]
        for part in transport.batches(len(own), _COLOUR_BYTES, along=along):
            chosen = own[part]
            found = seen(chosen, chosen, along)
            for k, picture in enumerate(chosen):
                if errors is not None and errors.is_other(picture):
                    at = chosen[k : k + 1]
                    found[:, k] = sum(
                        share * seen(np.array([one]), at, _variation(sequence, one * count))
                        for one, share in errors.seen_in(picture)
                    )[:, 0]
            yield chosen, found


def _emitted(
    sequence: PatternSequence,
    indices: NDArray[np.intp],
    along: Variation,
    projector: Projector,
    errors: FrameErrors | None,
    pictures: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return what the panel emits in frames, as their channels of the camera see it.

    `pictures` (n,) are those in which the frames are seen: their own, or those of lost triggers.
    """
    if sequence.crosstalk is None:
        return _panel(sequence, indices, along, projector, errors, pictures)
    firsts, first = np.unique(indices - indices % sequence.channels, return_index=True)
    whole = (firsts[:, np.newaxis] + np.arange(sequence.channels)).ravel()
    at = np.repeat(pictures[first], sequence.channels)
    shown = _panel(sequence, whole, along, projector, errors, at)
    return mixed(shown, sequence.crosstalk)[np.searchsorted(whole, indices)]


def _panel(
    sequence: PatternSequence,
    frames: NDArray[np.intp],
    along: Variation,
    projector: Projector,
    errors: FrameErrors | None,
    pictures: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return the panel's own light in frames, as it is seen in pictures."""
    panel = projector.bit_depth, projector.gamma, projector.curve
    shown = panel_response(sequence.shown(frames, along), *panel)
    return shown if errors is None else errors.panel(shown, pictures)


class Lit(Protocol):
    """Light that an exposure is chosen by."""

    def whites(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Return what each channel sees of the fully lit and the dark panel."""


def shutter_for(
    transport: Lit, camera: Camera, detector: DetectorModel, exposure: Exposure
) -> Shutter:
    """Return the shutter that exposes the pictures of a scene.

    An automatic exposure scales the light until the fully lit picture reaches the wanted
    level; where the camera has an aperture this is expressed as an exposure time.

    Raises
    ------
    InputError
        For an absolute exposure through a pinhole, or where the projector lights nothing
        (:class:`NothingLit`).
    """
    lit = (white.astype(np.float64)[white > dark] for white, dark in transport.whites())
    return shutter_of(lit, camera, detector, exposure)


def shutter_of(
    lit: Iterable[NDArray[np.float64]],
    camera: Camera,
    detector: DetectorModel,
    exposure: Exposure,
) -> Shutter:
    """Return the shutter by the radiance of lit pixels under the fully lit panel.

    Parameters
    ----------
    lit : iterable of (n,) float
        W / (mm^2 sr), of each channel; none is to saturate.
    camera, detector, exposure
        As for :func:`shutter_for`, whose errors it raises.
    """
    time, per_second = exposure.time_s, None
    if time is not None or np.isfinite(camera.lens.f_number):
        # Photons per second and unit scene radiance; a pinhole has none, and says so.
        area = camera.pitch_mm[0] * camera.pitch_mm[1] * camera.fill_factor  # photosensitive
        irradiance = camera.etendue_mm2_sr / area
        photons = detector.photons(irradiance, 1.0, area)
        per_second = float(photons)
        if time is not None:
            return Shutter(per_second * time, time)
    factors = [detector.exposure_scale(one, exposure.white_level) for one in lit if len(one)]
    if not factors:
        raise NothingLit("scene", "an object that the projector lights", "none")
    factor = min(factors)
    return Shutter(factor, factor / per_second if per_second else NOMINAL_EXPOSURE_S)


def move_pictures(frames: NDArray[np.float32], moves: NDArray[np.float64]) -> None:
    """Shift each frame (n, V, U) by a sub-pixel amount (n, 2), in place (edges repeat)."""
    for frame, (du, dv) in zip(frames, moves, strict=True):
        shifted = cv2.sepFilter2D(
            frame, -1, _shift_kernel(du), _shift_kernel(dv), borderType=cv2.BORDER_REPLICATE
        )
        # Interpolation overshoots at edges; light is not negative.
        np.maximum(shifted, 0.0, out=frame)


def _shift_kernel(shift: float) -> NDArray[np.float64]:
    """Return the correlation kernel that moves a line of pixels by `shift`.

    Lagrange interpolation through six samples: exact for polynomials of degree five, and good
    to 0.2 % of the shift for fringes of ten pixels.  (OpenCV's own bicubic warp moves even a
    ramp by half as much again where the shift is small.)
    """
    whole = int(np.floor(-shift))
    nodes = np.arange(-2, 4)
    differences = nodes[:, None] - nodes
    np.fill_diagonal(differences, 1)
    steps = np.broadcast_to(-shift - whole - nodes, differences.shape).copy()
    np.fill_diagonal(steps, 1.0)
    reach = abs(whole) + 3
    kernel = np.zeros(2 * reach + 1)
    kernel[nodes + whole + reach] = np.prod(steps / differences, axis=1)
    return kernel
