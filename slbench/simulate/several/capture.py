"""Captures of several cameras and projectors.

*In turns*, each projector shows the whole sequence while the others are dark, and all cameras see
it.  A camera has one exposure for all its frames: an automatic one is that of the projector whose
light is the brightest.

*Multiplexed*, all projectors show it at the same time, each in an order of its own
(:mod:`slbench.patterns.multiplexing`).  A picture is exposed once, to the sum of their light, so
that noise, saturation and ambient light are those of the sum; the frames of a pair are the camera's
pictures in the order of the projector.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.capture.stack import FocusStack
from slbench.core.errors import InputError, located
from slbench.core.random import Word, generator, tagged_seed
from slbench.patterns import NoiseModel
from slbench.patterns.multiplexing import multiplexed_orders
from slbench.rig import Pair, Rig
from slbench.scene.model import Scene
from slbench.simulate.expose import (
    NothingLit,
    Shutter,
    lighting,
    move_pictures,
    radiance_batches,
    shutter_for,
)
from slbench.simulate.stack import capture_stack
from slbench.simulate.transport import LightTransport

#: Tags of the seeds of further pairs' frames, and of further cameras' light and pictures.
_PAIRS, _CAMERAS = 9, 10


def pair_seed(seed: int, rig: Rig, pair: Pair) -> int:
    """Return the seed of the frames of a pair: that of the scan for the first one."""
    k = rig.pairs.index(pair)
    return seed if k == 0 else tagged_seed(seed, _PAIRS, k)


def camera_seed(seed: int, rig: Rig, camera: str) -> int:
    """Return the seed of a camera's samples of light: that of the scan for the first one."""
    k = list(rig.cameras).index(camera)
    return seed if k == 0 else tagged_seed(seed, _CAMERAS, k)


def check_several(scene: Scene) -> None:
    """Check that a scene can be measured by several devices, before light is traced.

    Raises
    ------
    InputError
        For motion; of projectors that light it at the same time for patterns which do not tell them
        apart, and for what is not simulated of them.
    """
    exposure = scene.exposure
    if scene.moves and len(scene.rig.pairs) > 1:
        expected = "a scene at rest before several cameras or projectors"
        raise InputError(f"scene {scene.name}: motion", expected, "one that moves")
    if not exposure.multiplexed:
        return
    for what, stated in (
        ("focus", scene.focus is not None),
        ("colour", scene.colour is not None),
        ("exposure: bit_planes, trigger or drift", exposure.has_frame_errors),
        ("exposure: several exposures", len(exposure.bracket) > 1),
    ):
        if stated:
            expected = "exposure.multiplexed = false: projectors in turn"
            raise InputError(f"scene {scene.name}: {what}", expected, "projectors at once")
    with located(f"scene {scene.name}"):
        multiplexed_orders(scene.sequence, len(scene.rig.projectors))


def capture_pairs(
    scene: Scene,
    parts: Mapping[Pair, Scene],
    transports: Mapping[Pair, LightTransport],
    *,
    seed: int = 0,
    noise: bool = True,
    on_progress: Callable[[float], None] | None = None,
) -> dict[Pair, FocusStack]:
    """Capture the frames of all pairs of a scene's cameras and projectors.

    Parameters
    ----------
    scene : Scene
    parts : mapping of Pair to Scene
        The scene of each pair.
    transports : mapping of Pair to LightTransport
        Of each; through pinholes where the scene has focus settings.
    seed : int
    noise : bool
        False leaves out the detector's noise and vibration; rounding stays.
    on_progress : callable, optional
        Called with the finished fraction.

    Raises
    ------
    NothingLit
        If no projector lights anything that a camera with automatic exposure sees.
    """
    found: dict[Pair, FocusStack] = {}
    for camera in scene.rig.cameras:
        own = [pair for pair in scene.rig.pairs if pair.camera == camera]
        light = [transports[pair] for pair in own]
        if scene.exposure.multiplexed:
            scenes, drawn = [parts[pair] for pair in own], camera_seed(seed, scene.rig, camera)
            captures = _at_once(scenes, light, seed=drawn, noise=noise)
            found |= {pair: FocusStack([one]) for pair, one in zip(own, captures, strict=True)}
            continue
        shutter = None if len(own) == 1 else _common([parts[pair] for pair in own], light)
        for pair, transport in zip(own, light, strict=True):

            def progress(part: float, done: int = len(found)) -> None:
                if on_progress:
                    on_progress((done + part) / len(parts))

            found[pair] = capture_stack(
                parts[pair],
                None if scene.focus is not None else (transport,),
                seed=pair_seed(seed, scene.rig, pair),
                noise=noise,
                shutter=shutter,
                on_progress=progress,
            )
    return found


def _common(scenes: Sequence[Scene], light: Sequence[LightTransport]) -> Shutter:
    """Return the shutter of a camera for all projectors in turn: that of the brightest."""
    shutters, refused = [], []
    for scene, transport in zip(scenes, light, strict=True):
        try:
            with lighting(scene):
                given = scene.rig.camera, scene.detector, scene.exposure
                shutters.append(shutter_for(transport, *given))
        except NothingLit as error:  # by this projector, which another may make up for
            refused.append(error)
    if not shutters:
        raise refused[0]
    return min(shutters)


@dataclass(frozen=True)
class _Sum:
    """The light of several projectors in one camera."""

    light: Sequence[LightTransport]

    def whites(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Return what the camera sees of all panels fully lit, and of all dark."""
        ambient = self.light[0].ambient
        white = ambient + sum(one.white() - one.ambient for one in self.light)
        return [(np.asarray(white, np.float32), ambient)]


def _at_once(
    scenes: Sequence[Scene], light: Sequence[LightTransport], *, seed: int, noise: bool
) -> list[Capture]:
    """Expose a camera to the light of all projectors at once; return its frames by projector."""
    first, ambient = scenes[0], light[0].ambient
    camera, detector, exposure = first.rig.camera, first.detector, first.exposure
    sequence = first.sequence
    orders = multiplexed_orders(sequence, len(scenes))
    radiance = np.broadcast_to(ambient, (sequence.n_frames, *ambient.shape)).copy()
    for scene, transport, order in zip(scenes, light, orders, strict=True):
        # Light from around comes once; each projector's is what it adds.
        for indices, seen in radiance_batches(transport, scene.sequence, scene.rig.projector):
            radiance[order[indices]] += seen - transport.ambient
    with lighting(first):
        base = shutter_for(_Sum(light), camera, detector, exposure)
    factor, exposure_s = base.times(*exposure.bracket)
    if noise and exposure.vibration_px > 0:
        shape = (sequence.n_frames, 2)
        moves = generator(seed, Word.VIBRATION).normal(0.0, exposure.vibration_px, shape)
        move_pictures(radiance, moves)
    rng = generator(seed, Word.NOISE)
    dtype = np.uint8 if detector.bit_depth == 8 else np.uint16
    pictures = np.empty(radiance.shape, dtype)
    for part in light[0].batches(len(pictures)):
        pictures[part] = detector.expose(radiance[part], exposure_s, rng, noise, factor)
    model = detector.noise_model() if noise else NoiseModel(offset_dn=detector.black_dn)
    return [
        Capture(
            pictures[order],
            scene.sequence,
            detector.bit_depth,
            model,
            scene.rig,
            exposure_s,
            detector.saturation_dn,
            pair=scene.rig.only,
        )
        for scene, order in zip(scenes, orders, strict=True)
    ]
