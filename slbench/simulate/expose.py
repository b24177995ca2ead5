"""Frames exposed from light transport: ``transport x patterns x detector -> frames``.

Every frame is a sparse product and a noise draw.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.random import Word, generator
from slbench.detector import DetectorModel
from slbench.patterns import NoiseModel, PatternSequence, panel_response
from slbench.patterns.base import Variation
from slbench.patterns.crosstalk import mixed
from slbench.rig import Camera, Projector, Rig
from slbench.scene.doubts import unlit
from slbench.scene.model import Exposure, Scene
from slbench.simulate.transport import LightTransport

#: Exposure time that the dark signal is computed with where the light's power is unknown (a
#: pinhole camera, automatic exposure).
NOMINAL_EXPOSURE_S = 0.01


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
        False: the expected frames, rounded once, without vibration.
    shutter : Shutter, optional
        Where another transport of the scene sets it (:func:`shutter_for`).
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    Capture
    """
    factor, exposure_s = shutter or shutter_for(transport, rig.camera, detector, exposure)
    shape = (sequence.n_frames, *transport.shape)
    dtype = np.uint8 if detector.bit_depth == 8 else np.uint16
    frames = np.empty(shape, dtype)
    rng = generator(seed, Word.NOISE)
    moves = None
    if noise and exposure.vibration_px > 0:  # channels of a picture move together
        moves = generator(seed, Word.VIBRATION).normal(
            0.0, exposure.vibration_px, (-(-len(frames) // sequence.channels), 2)
        )
    done = 0
    for indices, radiance in radiance_batches(transport, sequence, rig.projector):
        if moves is not None:
            move_pictures(radiance, moves[indices // sequence.channels])
        frames[indices] = detector.expose(radiance, exposure_s, rng, noise, factor)
        done += len(indices)
        if on_progress:
            on_progress(done / len(frames))
    return Capture(
        frames,
        sequence,
        detector.bit_depth,
        detector.noise_model() if noise else NoiseModel(offset_dn=detector.black_dn),
        rig,
        exposure_s,
        detector.saturation_dn,
        pair=rig.only,
    )


def radiance_batches(
    transport: LightTransport, sequence: PatternSequence, projector: Projector
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.float32]]]:
    """Yield frame indices and their radiance images, a bounded number at a time."""
    for along in sequence.variations:
        indices = sequence.frames_along(along)
        for part in transport.batches(len(indices), along=along):
            panel = _emitted(sequence, indices[part], along, projector)
            yield indices[part], transport.relight(panel, along)


def _emitted(
    sequence: PatternSequence, indices: NDArray[np.intp], along: Variation, projector: Projector
) -> NDArray[np.float64]:
    """Return what the panel emits in frames, as their channels of the camera see it."""
    panel = projector.bit_depth, projector.gamma, projector.curve
    if sequence.crosstalk is None:
        return panel_response(sequence.shown(indices, along), *panel)
    firsts = np.unique(indices - indices % sequence.channels)
    whole = (firsts[:, np.newaxis] + np.arange(sequence.channels)).ravel()
    shown = panel_response(sequence.shown(whole, along), *panel)
    return mixed(shown, sequence.crosstalk)[np.searchsorted(whole, indices)]


def shutter_for(
    transport: LightTransport, camera: Camera, detector: DetectorModel, exposure: Exposure
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
    time, per_second = exposure.time_s, None
    if time is not None or np.isfinite(camera.lens.f_number):
        # Photons per second and unit scene radiance; a pinhole has none, and says so.
        area = camera.pitch_mm[0] * camera.pitch_mm[1] * camera.fill_factor  # photosensitive
        irradiance = camera.etendue_mm2_sr / area
        photons = detector.photons(irradiance, 1.0, area)
        per_second = float(photons)
        if time is not None:
            return Shutter(per_second * time, time)
    white = transport.white().astype(np.float64)
    lit = white > transport.ambient
    if not np.any(lit):
        raise NothingLit("scene", "an object that the projector lights", "none")
    factor = detector.exposure_scale(white[lit], exposure.white_level)
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
