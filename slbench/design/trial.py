"""Pattern sequences put to the test: phase noise and repeated scans of a simulated scene.

:func:`noise_of_scene` does what thesis 4.2.2 and 5.3 do in the laboratory: a plane is captured
many times, at several heights, with every fringe set.  :func:`scan_repeatedly` measures the
scene itself again and again with any sequence and compares the spread and the fringe-order
errors with what was predicted.  Light is traced once for all repeats and patterns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench import objects
from slbench.capture import capture, exposure, radiance_batches
from slbench.design.fringes import SequenceDesign, any_error, unwrapping_chain
from slbench.design.noise import PhaseNoise, estimate_noise
from slbench.detector import expose
from slbench.errors import InputError
from slbench.patterns import Fringes, PatternSequence, relative_phase
from slbench.rig import Pose
from slbench.scene import Scene, SceneObject
from slbench.transport import LightTransport
from slbench.truth import GroundTruth

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Heights of the plate as shares of the volume's half depth.
HEIGHTS = (-0.8, 0.0, 0.8)
#: Fringes weaker than this are not seen, as in :func:`slbench.patterns.decode`, DN.
_MIN_MODULATION = 3.0
#: Pixels that are followed over the repeats: sigma to 0.1 % with 20 repeats.
_PIXELS = 50_000


@dataclass(frozen=True)
class Trial:
    """Repeated scans with one sequence beside its prediction.

    ``std_px`` is the standard deviation of the panel coordinate over the repeats, root mean
    square over the pixels (fringe-order errors included), ``std_median_px`` its median;
    ``rms_px`` the deviation from truth.  ``order_error_rate`` counts deviations of more than
    half a finest fringe, a pixel and scan.

    ``predicted_...`` is what the design says, for the surface its noise was measured on.
    ``expected_...`` is the same for the surfaces of the scene, which are lit less or more:
    the noise of every pixel is scaled to the one that its modulation leads to.
    """

    fringes: tuple[int, ...]
    shifts: tuple[int, ...]
    frames: int
    std_px: float
    std_median_px: float
    rms_px: float
    order_error_rate: float
    predicted_px: float
    predicted_order_error_probability: float
    expected_px: float
    expected_order_error_rate: float
    pixels: int
    repeats: int

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def plate_scene(scene: Scene, height_mm: float) -> Scene:
    """Return the scene with a level plate of the volume's size instead of its objects.

    The plate has the material of the scene's first object.
    """
    size = scene.rig.volume_mm
    plate = objects.build(
        "plane", {"size_mm": [size[0], size[1]], "thickness_mm": 0.1 * min(size[:2])}
    )
    pose = Pose(np.eye(3), np.array([0.0, 0.0, height_mm]))
    return replace(scene, objects=(SceneObject(plate, pose, scene.objects[0].material),))


def repeated_phases(
    scene: Scene,
    transport: LightTransport,
    fringes: Sequence[int],
    pixels: NDArray[np.intp],
    *,
    repeats: int = 20,
    shifts: int = 3,
    seed: int = 0,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[Array, Array]:
    """Capture fringe sets repeatedly and return their relative phases at some pixels.

    Parameters
    ----------
    scene : Scene
        Its detector and exposure; the patterns are those given here.
    transport : LightTransport
        With the marginal "u".
    fringes : sequence of int
        Counts of the k sets, along u.
    pixels : (P,) int
        Flat indices into the image.
    repeats, shifts, seed : int

    Returns
    -------
    phases : (repeats, k, P) float
        Relative phase, rad; NaN where a frame is saturated.
    modulation : (k, P) float
        Mean modulation, DN.
    """
    parts = tuple(Fringes(n, shifts) for n in fringes)
    patterned = replace(scene, sequence=PatternSequence(transport.panel, parts))
    phases = np.empty((repeats, len(parts), len(pixels)))
    modulation = np.zeros(phases.shape[1:])
    for r, values in enumerate(_frames(patterned, transport, pixels, repeats, seed)):
        saturated = values >= scene.detector.saturation_dn
        for k in range(len(parts)):
            own = slice(k * shifts, (k + 1) * shifts)
            phase, strength, _ = relative_phase(values[own, np.newaxis])
            phases[r, k] = np.where(saturated[own].any(axis=0), np.nan, phase[0])
            modulation[k] += strength[0] / repeats
        if on_progress:
            on_progress((r + 1) / repeats)
    return phases, modulation


def _frames(
    scene: Scene, transport: LightTransport, pixels: NDArray[np.intp], repeats: int, seed: int
) -> Iterator[NDArray[Any]]:
    """Yield the frames of each repeat at the pixels, (N, P)."""
    if scene.exposure.vibration_px > 0.0:  # moves whole images
        for r in range(repeats):
            yield capture(scene, transport, seed=seed + r).frames.reshape(
                -1, transport.ambient.size
            )[:, pixels]
        return
    factor, exposure_s = exposure(scene, transport)
    few = np.empty((scene.sequence.n_frames, 1, len(pixels)), np.float32)
    for indices, radiance in radiance_batches(scene, transport):
        few[indices, 0] = radiance.reshape(len(radiance), -1)[:, pixels]
    few *= np.float32(factor)
    for r in range(repeats):
        rng = np.random.default_rng([seed + r, 1])
        yield expose(scene.detector, few, exposure_s, rng)[:, 0]


def noise_of_scene(
    scene: Scene,
    fringes: Sequence[int],
    *,
    z_mm: Sequence[float] | None = None,
    repeats: int = 20,
    shifts: int = 3,
    seed: int = 0,
    on_progress: Progress | None = None,
) -> PhaseNoise:
    """Estimate sigma_phi(n, z) of a scene's rig from simulated captures of a plate.

    Parameters
    ----------
    scene : Scene
        Its rig, detector, light and exposure; the plate has its first object's material.
    fringes : sequence of int
        Counts to measure, ascending.
    z_mm : sequence of float, optional
        Heights of the plate; three through the volume by default.
    repeats, shifts, seed : int
    on_progress : callable, optional

    Returns
    -------
    PhaseNoise
        Infinite where defocus has washed the fringes out (less modulation than the decoder
        accepts, on average) or has reversed their contrast, so that they mislead.

    Raises
    ------
    InputError
        If the plate is not seen and lit at a height, or saturates.
    """
    from slbench.render.groundtruth import ground_truth
    from slbench.render.trace import trace

    if repeats < 2:
        raise InputError("repeats", "at least 2, to see noise", repeats)
    heights = np.array(
        [share * scene.rig.volume_mm[2] / 2 for share in HEIGHTS] if z_mm is None else z_mm, float
    )
    sigma = np.full((len(fringes), len(heights)), np.inf)
    for j, height in enumerate(heights):
        plate = plate_scene(scene, height)
        transport = trace(plate, ("u",), seed=seed + j)
        truth = ground_truth(plate)
        pixels = _chosen(truth, seed)
        turns = (truth.panel[..., 0].ravel()[pixels] + 0.5) / transport.panel[0]
        if len(pixels) == 0:
            raise InputError("plate", f"lit and in view at z = {height:g} mm", "nothing")

        def progress(done: float, j: int = j) -> None:
            if on_progress:
                on_progress("noise", (j + done) / len(heights))

        phases, modulation = repeated_phases(
            plate,
            transport,
            fringes,
            pixels,
            repeats=repeats,
            shifts=shifts,
            seed=seed + 1000 * (j + 1),
            on_progress=progress,
        )
        if np.isnan(phases).any(axis=(0, 1)).all():
            raise InputError("plate", f"not saturated at z = {height:g} mm", "saturated")
        for k, n in enumerate(fringes):
            # In step with the true phase: noise has no such modulation, and beyond a zero of the
            # lens's transfer function it is negative, as the fringes are half a period off.
            in_step = modulation[k] * np.cos(phases[:, k] - 2.0 * np.pi * n * turns)
            if np.nanmean(in_step) >= _MIN_MODULATION:
                sigma[k, j] = estimate_noise(phases[:, k]).sigma_rad
    return PhaseNoise(np.array(fringes, np.int64), sigma, heights, shifts)


def scan_repeatedly(
    scene: Scene,
    designs: Sequence[SequenceDesign],
    *,
    repeats: int = 15,
    seed: int = 0,
    on_progress: Progress | None = None,
) -> list[Trial]:
    """Measure a scene repeatedly with each sequence: spread and order errors beside predictions.

    Parameters
    ----------
    scene : Scene
        Its patterns are replaced.
    designs : sequence of SequenceDesign
    repeats : int
        Scans a sequence (15 in thesis 7.2).
    seed : int
    on_progress : callable, optional

    Returns
    -------
    list of Trial
        In the order of the designs.  The pixels that count lie on smooth lit surface, of the
        first object or one of the same material, and were measured in every scan.

    Raises
    ------
    InputError
        If no pixel was measured in every scan.
    """
    from slbench.render.groundtruth import ground_truth
    from slbench.render.trace import trace

    if repeats < 2:
        raise InputError("repeats", "at least 2, to see noise", repeats)
    transport = trace(scene, ("u",), seed=seed)
    truth = ground_truth(scene)
    alike = [i for i, o in enumerate(scene.objects) if o.material == scene.objects[0].material]
    pixels = np.flatnonzero(truth.smooth() & np.isin(truth.object_id, alike))
    true = truth.panel[..., 0].ravel()[pixels]
    trials = []
    for k, design in enumerate(designs):
        patterned = replace(scene, sequence=design.sequence(transport.panel))
        error = np.empty((repeats, len(pixels)))
        sigma = np.zeros(len(pixels))
        for r in range(repeats):
            phase = capture(patterned, transport, seed=seed + 1000 * (k + 1) + r).decode()
            error[r] = phase.coordinate["u"].ravel()[pixels] - true
            sigma += phase.sigma["u"].ravel()[pixels] / repeats
            if on_progress:
                on_progress("scans", (k + (r + 1) / repeats) / len(designs))
        measured = np.isfinite(error).all(axis=0)
        if not measured.any():
            where = f"scans with {', '.join(map(str, design.fringes))} fringes"
            raise InputError(where, "a pixel that all scans measure", "none")
        trials.append(_trial(design, error[:, measured], sigma[measured]))
    return trials


def _trial(design: SequenceDesign, error: Array, sigma: Array) -> Trial:
    """Sum up errors (repeats, P) and the decoder's deviations (P,) of the last set, px."""
    deviation = np.std(error, axis=0, ddof=1)
    fringe_px = design.width_px / design.fringes[-1]
    noise = np.array([step.noise_rad for step in (design.reference, *design.steps)])
    brightness = sigma * (2.0 * np.pi / fringe_px) / noise[-1]
    variance, wrong = unwrapping_chain(design.fringes, np.multiply.outer(noise, brightness))
    return Trial(
        design.fringes,
        design.shifts,
        design.frames,
        float(np.sqrt(np.mean(deviation**2))),
        float(np.median(deviation)),
        float(np.sqrt(np.mean(error**2))),
        float(np.mean(np.abs(error) > 0.5 * fringe_px)),
        design.sigma_px,
        design.order_error_probability,
        float(np.sqrt(np.mean(variance[-1]))) * design.width_px / (2.0 * np.pi),
        float(np.mean(any_error(wrong))),
        error.shape[1],
        len(error),
    )


def _chosen(truth: GroundTruth, seed: int) -> NDArray[np.intp]:
    """Return at most `_PIXELS` pixels of smooth lit surface, drawn at random, in order."""
    pixels = np.flatnonzero(truth.smooth())
    if len(pixels) > _PIXELS:
        pixels = np.sort(np.random.default_rng(seed).choice(pixels, _PIXELS, replace=False))
    return pixels
