"""Pattern sequences put to the test: phase noise and repeated scans of a simulated scene.

:func:`noise_of_scene` does what thesis 4.2.2 and 5.3 do in the laboratory: a plane is captured
many times, at several heights, with every fringe set.  :func:`scan_repeatedly` measures the
scene itself again and again with any sequence and compares the spread and the fringe-order
errors with what was predicted.

*Which pixels?*  A design knows the noise of a plate.  Surfaces that are lit less have more: the
vertical walls of a step block, which the projector meets at a grazing angle, a fifth of the
modulation and five times the noise.  The pixels of a scene are therefore counted in two groups,
the same for all sequences: ``plate_like``, whose noise in the one-fringe set is at most
``SAFETY`` times the plate's, the factor that both criteria design for, and all ``other``.

*What is expected.*  Beside the design's prediction, which is for the plate, there is one for the
pixels that were counted: the frames' mean over all scans says how bright and how strongly modulated
each fringe set is at each pixel, the detector's noise model what phase noise follows (the formula
of :mod:`slbench.patterns.phase`), and the chain of unwrapping steps what becomes of it.  Neither
the plate's measurement nor the decoder's deviations enter.  The model knows temporal noise of
the detector alone, no vibration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.stack import FusedCapture, WeightSource
from slbench.core.errors import InputError, located, warn_user
from slbench.core.random import generator, tagged_seed
from slbench.core.validation.types import Repeats
from slbench.core.validation.values import checked
from slbench.design.fringes.chain import any_error, unwrapping_chain
from slbench.design.fringes.design import SequenceDesign
from slbench.design.fringes.noise import PhaseNoise, estimate_noise
from slbench.patterns import NoiseModel
from slbench.patterns.phase import squared_modulation_bias
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.floors import ordinary_rms, rms
from slbench.simulate.repeats import check_repeats, noise_free_waves, plate_scene, repeated_phases
from slbench.simulate.stack import capture_stack, check_frame_errors, moving_light, traced

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Pixels with at most this many times the plate's noise count as lit like it.
SAFETY = 2.0
#: Heights of the plate as shares of the volume's half depth.
HEIGHTS = (-0.8, 0.0, 0.8)
#: Fringes weaker than this are not seen, as in :func:`slbench.patterns.decode`, DN.
_MIN_MODULATION = 3.0
#: A noise that more samples would change by more is questioned.
_CHANGE = 0.05
#: Most times the samples that is advised.
_MOST_SAMPLES = 1e4
#: Pixels that are followed over the repeats: sigma to 0.1 % with 20 repeats.
_PIXELS = 50_000


#: Noise over modulation of a phase that is anywhere on the circle.
_NO_PHASE = 20.0
#: Tags of the random streams.
_LIGHT, _NOISE, _SCANS = range(3)


@dataclass(frozen=True)
class Spread:
    """What repeated scans say of a group of pixels.

    ``std_px`` is the standard deviation of the panel coordinate over the repeats, root mean
    square over the pixels (fringe-order errors included), ``std_median_px`` its median;
    ``rms_px`` the deviation from truth.  ``order_error_rate`` counts deviations of more than
    half a finest fringe, a pixel and scan.  ``expected_...`` is what the modulation of each pixel
    leads to (see the module).  ``pixels`` are those of the group, ``measured`` the share of their
    scans that the decoder gave a coordinate, which all else is for: it masks what is too weak.
    Deviations are NaN where no pixel was measured twice.
    """

    pixels: int
    measured: float
    std_px: float
    std_median_px: float
    rms_px: float
    order_error_rate: float
    expected_px: float
    expected_order_error_rate: float


@dataclass(frozen=True)
class Trial:
    """Repeated scans with one sequence beside its prediction.

    ``predicted_...`` is what the design says, for the plate that its noise was measured on.
    ``plate_like`` holds for pixels that are lit like it, ``other`` for the rest, if there are any.
    """

    fringes: tuple[int, ...]
    shifts: tuple[int, ...]
    frames: int
    repeats: int
    predicted_px: float
    predicted_order_error_probability: float
    plate_like: Spread
    other: Spread | None

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return asdict(self)

    def text(self) -> str:
        """Return the result in lines for people: predicted, and measured by group of pixels."""
        lines = [
            f"{{{', '.join(map(str, self.fringes))}}} scanned {self.repeats} times; predicted "
            f"{self.predicted_px:.4g} px, order errors "
            f"{self.predicted_order_error_probability:.2g}"
        ]
        for name, group in (("lit like the plate", self.plate_like), ("others", self.other)):
            if group is not None:
                lines.append(
                    f"  {group.pixels} px {name}, measured {100 * group.measured:.3g} %: "
                    f"{group.std_px:.4g} px (expected {group.expected_px:.4g}), order errors "
                    f"{group.order_error_rate:.2g} (expected {group.expected_order_error_rate:.2g})"
                )
        return "\n".join(lines)


@checked
def noise_of_scene(
    scene: Scene,
    fringes: Sequence[int],
    *,
    z_mm: Sequence[float] | None = None,
    repeats: Repeats = 20,
    shifts: int = 3,
    seed: int = 0,
    weights: WeightSource = "lit",
    texture_mm: float | None = None,
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
    weights : {"lit", "modulation"}
        Of the fusion, where the scene has focus settings.
    texture_mm : float, optional
        Squares of a chequerboard, instead of an even plate: something to focus on.
    on_progress : callable, optional

    Returns
    -------
    PhaseNoise
        Infinite where defocus has washed the fringes out (less modulation than the decoder
        accepts, on average) or has reversed their contrast, so that they mislead.

    Raises
    ------
    InputError
        For frame errors that the patterns cannot have, and any with focus settings;
        if the plate is not seen and lit at a height, saturates, or shows no fringes at all.

    Warns
    -----
    InputWarning
        If more samples would change the noise.
    """
    from slbench.simulate.render.groundtruth import ground_truth

    check_repeats(scene, fringes, shifts)
    samples = 0  # as many as were traced

    heights = np.array(
        [share * scene.rig.volume_mm[2] / 2 for share in HEIGHTS] if z_mm is None else z_mm, float
    )
    sigma = np.full((len(fringes), len(heights)), np.inf)
    floor, sampling, change = (np.full(sigma.shape, np.nan) for _ in range(3))
    for j, height in enumerate(heights):
        plate = plate_scene(scene, height, texture_mm)
        transports = traced(plate, ("u",), seed=tagged_seed(seed, _LIGHT, j + 1))
        samples = transports[0].samples
        truth = ground_truth(plate.objects, plate.rig)
        pixels = _chosen(truth, seed)
        turns = (truth.panel[..., 0].ravel()[pixels] + 0.5) / scene.rig.projector.width
        if len(pixels) == 0:
            raise InputError("plate", f"lit and in view at z = {height:g} mm", "nothing")

        def progress(done: float, j: int = j) -> None:
            if on_progress:
                on_progress("noise", (j + done) / len(heights))

        phases, modulation = repeated_phases(
            plate,
            transports,
            fringes,
            pixels,
            repeats=repeats,
            shifts=shifts,
            seed=tagged_seed(seed, _NOISE, j),
            weights=weights,
            on_progress=progress,
        )
        if np.isnan(phases).any(axis=(0, 1)).all():
            raise InputError("plate", f"not saturated at z = {height:g} mm", "saturated")
        for k, n in enumerate(fringes):
            # In step with the true phase: noise has no such modulation, and beyond a zero of the
            # lens's transfer function it is negative, as the fringes are half a period off.
            in_step = modulation[:, k] * np.cos(phases[:, k] - 2.0 * np.pi * n * turns)
            if np.nanmean(in_step) >= _MIN_MODULATION:
                sigma[k, j] = estimate_noise(phases[:, k]).sigma_rad
        seen = np.isfinite(sigma[:, j])
        own = tagged_seed(seed, _NOISE, j)
        counts = np.array(fringes)[seen]
        whole, half = noise_free_waves(
            *(plate, transports, counts.tolist(), pixels), shifts=shifts, seed=own, weights=weights
        )
        off = np.angle(whole * np.exp(-2j * np.pi * np.outer(counts, turns)))
        floor[seen, j] = [rms([row]) for row in off]
        if half is not None:
            sampling[seen, j] = [ordinary_rms([row]) for row in np.angle(half * np.conj(whole))]
            change[seen, j] = [_change(*pair) for pair in zip(whole, half, strict=True)]
    if np.any(change > _CHANGE):
        k, j = divmod(int(np.nanargmax(change)), len(heights))
        # The bias of a noise falls as the variance of the contrast does.
        more = samples * ceil(min(change[k, j] / _CHANGE, _MOST_SAMPLES))
        doubt = (
            f"sampling makes {100.0 * change[k, j]:.0f} % of the noise of {fringes[k]} fringes at "
            f"z = {heights[j]:g} mm: {more} samples a pixel instead of {samples} would change it "
            "(render.samples)"
        )
        warn_user(f"scene {scene.name}", doubt)
    if not np.isfinite(sigma).any():
        told = "fringes that are told from noise, at some height"
        raise InputError("plate", told, "none: too dark, or washed out")
    counts = np.array(fringes, np.int64)
    return PhaseNoise(counts, sigma, heights, shifts, floor, sampling)


def _change(whole: NDArray[np.complex128], half: NDArray[np.complex128]) -> float:
    """Return the share of a noise that an uncertain contrast makes, of waves (P,).

    Noise is 1 / b.  An error of variance e^2 of b adds e^2 to the mean of 1 / b^2, and half of the
    samples have twice the variance: what they add to all is what all add to the truth.
    """
    all_of_them, fewer = (ordinary_rms([1.0 / np.abs(wave)]) for wave in (whole, half))
    return fewer / all_of_them - 1.0


@checked
def scan_repeatedly(
    scene: Scene,
    designs: Sequence[SequenceDesign],
    *,
    repeats: Repeats = 15,
    seed: int = 0,
    weights: WeightSource = "lit",
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
    weights : {"lit", "modulation"}
        Of the fusion, where the scene has focus settings.
    on_progress : callable, optional

    Returns
    -------
    list of Trial
        In the order of the designs.  The pixels that count lie on smooth lit surface, of the
        first object or one of the same material.

    Raises
    ------
    InputError
        For frame errors that a sequence cannot have; if no pixel is lit like the plate, or all of
        them saturate.
    """
    from slbench.simulate.render.groundtruth import ground_truth

    panel = (scene.rig.projector.width, scene.rig.projector.height)
    with located(f"scene {scene.name}"):
        for design in designs:
            check_frame_errors(replace(scene, sequence=design.sequence(panel)))
    transports = traced(scene, ("u",), seed=tagged_seed(seed, _LIGHT, 0))
    truth = ground_truth(scene.objects, scene.rig)
    alike = [i for i, o in enumerate(scene.objects) if o.material == scene.objects[0].material]
    pixels = np.flatnonzero(truth.smooth() & np.isin(truth.object_id, alike))
    true = truth.panel[..., 0].ravel()[pixels]
    trials: list[Trial] = []
    like_plate = np.ones(len(pixels), bool)
    for k, design in enumerate(designs):
        patterned = replace(scene, sequence=design.sequence(panel))
        error = np.empty((repeats, len(pixels)))
        model = _ModelNoise(pixels)
        moving = moving_light(patterned, tagged_seed(seed, _LIGHT, 0))
        for r in range(repeats):
            own = tagged_seed(seed, _SCANS, k, r)
            fused = capture_stack(patterned, transports, seed=own, moving=moving).fuse(weights)
            model.add(fused)
            # Wrong orders are what is counted: none is masked for its residual.
            phase = fused.decode(max_order_residual=0.5)
            error[r] = phase.coordinate["u"].ravel()[pixels] - true
            if on_progress:
                on_progress("scans", (k + (r + 1) / repeats) / len(designs))
        sigma = model.sigma()
        if k == 0:
            like_plate = sigma[0] <= SAFETY * design.reference.noise_rad
            if not like_plate.any():
                expected = f"a pixel with at most {SAFETY:g} times the noise of the design"
                raise InputError("scans", expected, "none")
        groups = [
            _spread(design, error[:, group], sigma[:, group]) if group.any() else None
            for group in (like_plate, ~like_plate)
        ]
        if groups[0] is None or not groups[0].measured > 0.0:
            where = f"scans with {', '.join(map(str, design.fringes))} fringes"
            raise InputError(where, "a pixel that is measured", "none")
        trials.append(
            Trial(
                design.fringes,
                design.shifts,
                design.frames,
                repeats,
                design.sigma_px,
                design.order_error_probability,
                groups[0],
                groups[1],
            )
        )
    return trials


class _ModelNoise:
    """Phase noise of every fringe set by the noise model, from the mean of all captures."""

    def __init__(self, pixels: NDArray[np.intp]) -> None:
        self._pixels = pixels
        self._sum: Array = np.zeros((0, len(pixels)))
        self._gain: Any = 0.0
        self._captures = 0

    def add(self, fused: FusedCapture) -> None:
        """Take a scan's capture."""
        shots = fused.capture
        if not self._captures:
            self._sum = np.zeros((len(shots.frames), len(self._pixels)))
            self._noise, self._sets = shots.noise or NoiseModel(), shots.sequence.fringe_sets()
            self._panel = shots.sequence.panel
        self._sum += shots.frames.reshape(len(shots.frames), -1)[:, self._pixels]
        gain = np.broadcast_to(fused.noise_gain, shots.frames.shape[1:])
        self._gain = self._gain + gain.ravel()[self._pixels]
        self._captures += 1

    def sigma(self) -> Array:
        """Return the noise over modulation of K sets, (K, P) (:mod:`slbench.patterns.phase`)."""
        rows = []
        for placed in self._sets:
            own = placed.frames
            mean_frames = self._sum[own, np.newaxis] / self._captures
            found = placed.code.relative_phase(mean_frames, self._panel)
            phase, measured, mean = (part[0] for part in found)
            variance = self._noise.variance(mean)
            left = variance * (self._gain / self._captures) ** 2 / self._captures  # by the mean
            square = measured**2 - squared_modulation_bias(left, len(own))
            modulation = np.sqrt(np.maximum(square, 1e-18))
            if len(own) == 3:  # the third harmonic of shot noise
                third = self._noise.gain_dn_per_e * modulation * np.cos(3.0 * phase)
                variance = variance - 0.5 * third
            rows.append(np.sqrt(2.0 / len(own) * variance) / modulation)
        return np.minimum(np.array(rows) * self._gain / self._captures, _NO_PHASE)


def _spread(design: SequenceDesign, error: Array, sigma: Array) -> Spread:
    """Sum up the errors (repeats, P), px, of pixels with the noise (K, P), rad."""
    seen = np.isfinite(error)
    scans = seen.sum(axis=0)
    some, many = scans >= 1, scans >= 2
    turn_px = design.width_px / (2.0 * np.pi)
    std = median = rms = rate = expected = expected_rate = float("nan")
    if some.any():
        variance, wrong = unwrapping_chain(design.fringes, sigma[:, some])
        rms = float(np.sqrt(np.mean(error[seen] ** 2)))
        rate = float(np.mean(np.abs(error[seen]) > 0.5 * design.width_px / design.fringes[-1]))
        expected_rate = float(np.average(any_error(wrong), weights=scans[some]))
    if many.any():
        # A pixel that is rarely measured counts as little in the expectation as in the measurement.
        freedom = scans[many] - 1.0
        deviation = np.nanstd(error[:, many], axis=0, ddof=1)
        std = float(np.sqrt(np.average(deviation**2, weights=freedom)))
        median = float(np.median(deviation))
        own = variance[-1][many[some]]
        expected = float(np.sqrt(np.average(own, weights=freedom))) * turn_px
    share = float(seen.mean())
    return Spread(len(scans), share, std, median, rms, rate, expected, expected_rate)


def _chosen(truth: GroundTruth, seed: int) -> NDArray[np.intp]:
    """Return at most `_PIXELS` pixels of smooth lit surface, drawn at random, in order."""
    pixels = np.flatnonzero(truth.smooth())
    if len(pixels) > _PIXELS:
        pixels = np.sort(generator(seed).choice(pixels, _PIXELS, replace=False))
    return pixels
