"""Scenes captured at each of their focus settings; without any, one picture: a stack of one.

This is the one way from a scene to its captures: ``capture_stack(scene).fuse().decode()``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from slbench.capture.capture import Capture
from slbench.capture.stack import FocusStack
from slbench.core.colour import BANDS
from slbench.core.errors import InputError
from slbench.core.random import setting_seed
from slbench.patterns import Flat, PatternSequence
from slbench.scene.colour import Colour
from slbench.scene.model import Scene
from slbench.simulate.colour import ColourTransport
from slbench.simulate.expose import Shutter, capture, lighting, shutter_for
from slbench.simulate.frame_errors import frame_errors
from slbench.simulate.moving import MovingLight, check_motion
from slbench.simulate.transport import LightTransport, Marginal


def with_lit_frame(sequence: PatternSequence) -> PatternSequence:
    """Return the patterns with a fully lit picture first, unless they have a lit frame."""
    if sequence.lit_frame is not None:
        return sequence
    return replace(sequence, parts=(*(Flat(1.0),) * sequence.channels, *sequence.parts))


def check_frame_errors(scene: Scene) -> None:
    """Check that a scene's frame errors and its motion can be, before light is traced.

    Raises
    ------
    InputError
        For a lost trigger of a picture that there is not, a lamp with less than no light, and a
        panel's period or motion where the exposure time is not known.
    """
    check_motion(scene)
    exposure, alone = scene.exposure, scene.focus is None
    sequence = scene.sequence if alone else with_lit_frame(scene.sequence)
    pictures = -(-sequence.n_frames // sequence.channels)
    planes = exposure.bit_planes
    timed = planes is not None and planes.period_s is not None
    for rig in map(scene.rig.pair, scene.rig.pairs):
        if timed and not np.isfinite(rig.camera.lens.f_number):
            expected = "periods instead, with a pinhole, whose exposure time is not known"
            raise InputError("exposure.bit_planes.period_ms", expected, "a period")
        # A second stands for the exposure, which is not yet known.
        frame_errors(exposure, rig.projector, pictures, 1.0, seed=0, noise=False)


def traced(
    scene: Scene,
    axes: tuple[Marginal, ...] | None = None,
    *,
    seed: int = 0,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[LightTransport, ...]:
    """Trace a scene at each of its focus settings; once where it has none.

    Parameters
    ----------
    scene : Scene
    axes : tuple of {"u", "v", "uv"}, optional
        Marginals to keep, by default what the scene's patterns vary along.
    seed : int
    on_progress : callable, optional
        Called with the finished fraction.
    """
    kept = scene.sequence.variations if axes is None else axes
    count = 1 if scene.focus is None else len(scene.focus)
    found: list[LightTransport] = []
    for k in range(count):

        def progress(part: float, done: int = k) -> None:
            if on_progress:
                on_progress((done + part) / count)

        found.append(_traced(scene, k, kept, seed, progress))
    return tuple(found)


def _traced(
    scene: Scene,
    setting: int,
    axes: tuple[Marginal, ...],
    seed: int,
    on_progress: Callable[[float], None] | None = None,
) -> LightTransport:
    """Trace a scene at one of its focus settings, each band where it is in colour."""
    from slbench.simulate.render.trace import trace

    if scene.colour is not None:
        return _coloured(scene, scene.colour, setting, axes, seed, on_progress)
    return trace(
        *(scene.objects, scene.rigs[setting], scene.light, axes),
        samples=scene.samples,
        seed=seed,
        on_progress=on_progress,
    )


def _coloured(
    scene: Scene,
    colour: Colour,
    setting: int,
    axes: tuple[Marginal, ...],
    seed: int,
    on_progress: Callable[[float], None] | None,
) -> ColourTransport:
    """Trace the bands of a scene: along the same rays where these serve all."""
    from slbench.simulate.render.bands import together
    from slbench.simulate.render.trace import trace_bands

    scenes = [scene.in_band(band) for band in BANDS]
    # What tells bands apart beside their objects.
    apart: list[Any] = list(zip(colour.camera_scale, colour.projector_scale, strict=True))
    if scene.light.has_surroundings:
        apart = list(zip(apart, colour.ambient, strict=True))
    looks = list(dict.fromkeys(one.objects for one in scenes))
    if len(set(apart)) == 1 < len(looks) and together(scene.objects, scene.light):
        found = trace_bands(
            *(tuple(looks), scenes[0].rigs[setting], scene.light, axes),
            samples=scene.samples,
            seed=seed,
            on_progress=on_progress,
        )
        return ColourTransport.of([found[looks.index(one.objects)] for one in scenes], colour)
    keys = [(where, one.objects) for where, one in zip(apart, scenes, strict=True)]
    distinct = list(dict.fromkeys(keys))
    light = []
    for k, key in enumerate(distinct):

        def progress(part: float, done: int = k) -> None:
            if on_progress:
                on_progress((done + part) / len(distinct))

        light.append(_traced(scenes[keys.index(key)], setting, axes, seed, progress))
    return ColourTransport.of([light[distinct.index(key)] for key in keys], colour)


def moving_light(scene: Scene, seed: int = 0) -> MovingLight | None:
    """Return the light of a scene that moves, by samples of a seed; None of one that does not."""
    if not scene.moves:
        return None
    return MovingLight(scene, lambda still, axes: _traced(still, 0, axes, seed))


def capture_stack(
    scene: Scene,
    transports: Sequence[LightTransport] | None = None,
    *,
    seed: int = 0,
    noise: bool = True,
    moving: MovingLight | None = None,
    shutter: Shutter | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> FocusStack:
    """Capture a scene at each of its focus settings; once where it has none.

    A stack has a fully lit frame with its patterns and one exposure, that of the middle setting.

    Parameters
    ----------
    scene : Scene
    transports : sequence of LightTransport, optional
        As :func:`traced` gives them, where they are at hand; traced otherwise, one at a time.
    seed : int
        Of the Monte Carlo samples, the detector's temporal noise and vibration.
    noise : bool
        False leaves out the detector's noise and vibration; rounding stays.
    moving : MovingLight, optional
        Of a scene that moves, for captures that share it (:func:`moving_light`); of the seed by
        default.
    shutter : Shutter, optional
        Where something else than the middle setting sets it: what other projectors light.
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    FocusStack
    """
    moving = moving or moving_light(scene, seed)
    alone = scene.focus is None
    sequence = scene.sequence if alone else with_lit_frame(scene.sequence)
    rigs, detector, exposure = scene.rigs, scene.detector, scene.exposure
    captures: dict[int, Capture] = {}
    # The middle first: the others take its exposure.
    for k in sorted(range(len(rigs)), key=lambda k: k != len(rigs) // 2):
        if transports is None:
            transport = _traced(scene, k, sequence.variations, seed)
        else:
            transport = transports[k]
        if shutter is None:
            with lighting(scene):
                shutter = shutter_for(transport, rigs[k].camera, detector, exposure)

        def progress(part: float, done: int = len(captures)) -> None:
            if on_progress:
                on_progress((done + part) / len(rigs))

        captures[k] = capture(
            *(transport, sequence, rigs[k], detector, exposure),
            seed=setting_seed(seed, None if alone else k),
            noise=noise,
            shutter=shutter,
            moving=moving,
            on_progress=progress,
        )
    return FocusStack([captures[k] for k in range(len(rigs))], scene.focus)
