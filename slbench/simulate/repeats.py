"""Simulated repeats: a scene or a plate in its place, captured again and again at some pixels.

Light is traced once (:func:`slbench.simulate.stack.traced`) for all repeats and patterns; what
differs between repeats is the detector's noise and vibration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench import objects
from slbench.capture.stack import WeightSource
from slbench.core.errors import InputError, located
from slbench.core.random import Word, generator, tagged_seed
from slbench.patterns import Flat, Fringes, PatternSequence, relative_phase
from slbench.rig import Pose
from slbench.scene.model import Scene, SceneObject
from slbench.scene.surfaces.materials import PRESETS
from slbench.simulate.expose import lighting, radiance_batches, shutter_for
from slbench.simulate.floors import fused_radiance, halves
from slbench.simulate.stack import capture_stack, check_frame_errors, moving_light
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]


def plate_scene(scene: Scene, height_mm: float, texture_mm: float | None = None) -> Scene:
    """Return the scene with a level plate of the volume's size instead of its objects.

    Heights are those of the scene's :attr:`~slbench.scene.model.Scene.place`.
    The plate has the material of the scene's first object; with a texture it is a chequerboard of
    squares of `texture_mm`, every other one of which is dark.
    """
    size = scene.rig.volume_mm
    if texture_mm is not None:
        return replace(scene, objects=(_texture(scene, height_mm, texture_mm),))
    plate = objects.build_artefact(
        "plane", {"size_mm": [size[0], size[1]], "thickness_mm": 0.1 * min(size[:2])}
    )
    pose = _level(scene, height_mm)
    return replace(scene, objects=(SceneObject(plate, pose, scene.objects[0].material),))


def _level(scene: Scene, height_mm: float) -> Pose:
    """Return the pose of a plate at a height in the measurement volume."""
    place = scene.place
    return Pose(place.rotation, place.to_world([0.0, 0.0, height_mm]))


def _texture(scene: Scene, height_mm: float, square_mm: float) -> SceneObject:
    rows, columns = (max(4, round(length / square_mm)) for length in scene.rig.volume_mm[1::-1])
    board = objects.build_artefact(
        "chequerboard",
        {
            "rows": rows,
            "columns": columns,
            "square_mm": square_mm,
            "margin_mm": square_mm,
            "thickness_mm": 0.1 * min(scene.rig.volume_mm[:2]),
        },
    )
    dark = next(part for part in board.parts if "dark" in part or "black" in part)
    pose = _level(scene, height_mm)
    materials = {dark: PRESETS["dark-stage"]}
    return SceneObject(board, pose, scene.objects[0].material, materials)


def check_repeats(scene: Scene, fringes: Sequence[int], shifts: int) -> None:
    """Check that a scene's frame errors can be in repeats, before light is traced.

    Parameters are those of :func:`repeated_phases`.

    Raises
    ------
    InputError
        For frame errors that its patterns cannot have, and for any with focus settings, where each
        fringe set is a stack of its own; for several exposures, as modulations are of one.
    """
    with located(f"scene {scene.name}"):
        if len(scene.exposure.bracket) > 1:
            raise InputError("exposure", "one, for repeats of fringes", "several (bracket)")
        if scene.focus is not None and scene.exposure.has_frame_errors:
            expected = "no frame errors with focus settings: each fringe set is captured alone"
            raise InputError("exposure", expected, "bit_planes, trigger or drift")
        check_frame_errors(replace(scene, sequence=_patterns(scene, fringes, shifts)))


def repeated_phases(
    scene: Scene,
    transports: Sequence[LightTransport],
    fringes: Sequence[int],
    pixels: NDArray[np.intp],
    *,
    repeats: int = 20,
    shifts: int = 3,
    seed: int = 0,
    weights: WeightSource = "lit",
    on_progress: Callable[[float], None] | None = None,
) -> tuple[Array, Array]:
    """Capture fringe sets repeatedly and return their relative phases at some pixels.

    Parameters
    ----------
    scene : Scene
        Its detector and exposure; the patterns are those given here.
    transports : sequence of LightTransport
        With the marginal "u"; one a focus setting, and every repeat is fused where there are any.
    fringes : sequence of int
        Counts of the k sets, along u.
    pixels : (P,) int
        Flat indices into the image.
    repeats, shifts, seed : int
    weights : {"lit", "modulation"}
        Of the fusion (:mod:`slbench.capture.stack`).

    Returns
    -------
    phases : (repeats, k, P) float
        Relative phase, rad; NaN where a frame is saturated.
    modulation : (repeats, k, P) float
        DN.
    """
    patterned = replace(scene, sequence=_patterns(scene, fringes, shifts))
    if scene.focus is None:
        captures = _frames(patterned, transports[0], pixels, repeats, seed)
    else:
        captures = _fused_frames(patterned, transports, pixels, repeats, seed, weights)
    phases = np.empty((repeats, len(fringes), len(pixels)))
    modulation = np.empty(phases.shape)
    for r, values in enumerate(captures):
        saturated = values >= scene.detector.saturation_dn
        for k in range(len(fringes)):
            own = slice(k * shifts, (k + 1) * shifts)
            phase, (modulation[r, k],), _ = relative_phase(values[own, np.newaxis])
            phases[r, k] = np.where(saturated[own].any(axis=0), np.nan, phase[0])
        if on_progress:
            on_progress((r + 1) / repeats)
    return phases, modulation


def _patterns(scene: Scene, fringes: Sequence[int], shifts: int) -> PatternSequence:
    panel = (scene.rig.projector.width, scene.rig.projector.height)
    return PatternSequence(panel, tuple(Fringes(n, shifts) for n in fringes))


def noise_free_waves(
    scene: Scene,
    transports: Sequence[LightTransport],
    fringes: Sequence[int],
    pixels: NDArray[np.intp],
    *,
    shifts: int = 3,
    seed: int = 0,
    weights: WeightSource = "lit",
) -> tuple[NDArray[np.complex128], NDArray[np.complex128] | None]:
    """Return what the fringe sets are before the detector, modulation times exp(i phase).

    Parameters are those of :func:`repeated_phases`; a stack is fused by the weights of one noisy
    repeat.

    Returns
    -------
    all_samples : (k, P) complex
        Radiance.
    half : (k, P) complex, or None
        By one half of the samples (:meth:`LightTransport.half`), with the same weights; None where
        it was not kept.
    """
    panel = (scene.rig.projector.width, scene.rig.projector.height)
    half = halves(transports)
    found = np.empty((2, len(fringes), len(pixels)), np.complex128)
    for k, count in enumerate(fringes):
        part = Fringes(count, shifts)
        fused = None
        if scene.focus is not None:
            alone = replace(scene, sequence=PatternSequence(panel, (Flat(1.0), part)))
            fused = capture_stack(alone, transports, seed=seed).weights(weights)
        for wave, light in zip(found[:, k], (transports, half), strict=True):
            if light is None:
                continue
            frames = np.empty((shifts, 1, len(pixels)))
            parts = light, PatternSequence(panel, (part,)), scene.rig.projector, fused
            for indices, radiance in fused_radiance(*parts):
                frames[indices, 0] = radiance.reshape(len(radiance), -1)[:, pixels]
            phase, modulation, _ = relative_phase(frames)
            wave[:] = (modulation * np.exp(1j * phase))[0]
    return found[0], None if half is None else found[1]


def _frames(
    scene: Scene, transport: LightTransport, pixels: NDArray[np.intp], repeats: int, seed: int
) -> Iterator[NDArray[Any]]:
    """Yield the frames of each repeat at the pixels, (N, P)."""
    # What moves whole images, or fills a mosaic from neighbours.
    light = scene.exposure
    moving = moving_light(scene, seed)
    whole = light.vibration_px > 0.0 or light.has_frame_errors or scene.colour is not None
    if whole or moving is not None:
        for r in range(repeats):
            own = tagged_seed(seed, r)
            (shots,) = capture_stack(scene, (transport,), seed=own, moving=moving).captures
            yield shots.frames.reshape(len(shots.frames), -1)[:, pixels]
        return
    with lighting(scene):
        shutter = shutter_for(transport, scene.rig.camera, scene.detector, scene.exposure)
    shutter = shutter.times(*light.bracket)
    few = np.empty((scene.sequence.n_frames, 1, len(pixels)), np.float32)
    for indices, radiance in radiance_batches(transport, scene.sequence, scene.rig.projector):
        few[indices, 0] = radiance.reshape(len(radiance), -1)[:, pixels]
    for r in range(repeats):
        rng = generator(tagged_seed(seed, r), Word.NOISE)
        yield scene.detector.expose(few, shutter.time_s, rng, scale=shutter.photons)[:, 0]


def _fused_frames(
    scene: Scene,
    transports: Sequence[LightTransport],
    pixels: NDArray[np.intp],
    repeats: int,
    seed: int,
    weights: WeightSource,
) -> Iterator[NDArray[Any]]:
    """Yield the fused frames of each repeat at the pixels in the detector's DN, (N, P).

    Every fringe set is a stack of its own, as if it were the finest of its sequence.
    """
    panel = scene.sequence.panel
    for r in range(repeats):
        values = []
        for part in scene.sequence.parts:
            alone = replace(scene, sequence=PatternSequence(panel, (Flat(1.0), part)))
            stack = capture_stack(alone, transports, seed=tagged_seed(seed, r))
            shots = stack.fuse(weights).capture
            scale = 2.0 ** (scene.detector.bit_depth - shots.depth)
            values.append(scale * shots.frames[1:].reshape(len(shots.frames) - 1, -1)[:, pixels])
        yield np.concatenate(values)
