"""Pattern sets compared on one scene: same light, same pixels, their own noise.

Light is traced once and serves all sets and repeats, so that what differs between two results is
what the patterns and the detector do.  Every repeat of a set draws its noise from (seed, text of
the set, repeat): a result does not depend on which other sets are compared or in what order.

*Pixels.*  A deviation is taken over the pixels of smooth lit surface
(:meth:`slbench.scene.truth.GroundTruth.smooth`) that *every* set measured in at least two thirds of
its repeats: the same pixels for all, so that a set gains nothing from giving up the hard ones.
What it gives up is told by its completeness, over all lit pixels, and by its order errors, over
all that it measured of the smooth surface; neither depends on the other sets.

*Two rankings.*  By repeatability, the standard deviation over the repeats (thesis 7.2.2), and
by distance from the truth.  The first alone would praise a code that repeats the same wrong
value, as a Gray code does whose column is a pixel wide.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from slbench.bench.compare.comparison import Comparison, SetResult
from slbench.bench.compare.repeated import Repeats, scan_repeats
from slbench.bench.compare.sets import Equal, PatternSet, pattern_sets
from slbench.bench.compare.tiles import (
    bootstrap_medians,
    compared,
    ranked,
    resamples_for,
    shaken,
    spread_draws,
    tile_numbers,
)
from slbench.bench.statistics import percentile_interval
from slbench.capture.stack import WeightSource
from slbench.core.errors import InputError, warn_user
from slbench.core.random import tagged_seed
from slbench.core.show.display import length
from slbench.core.show.document import Cloud
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.patterns import PatternSource
from slbench.scene.doubts import unlit
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.floors import more_samples
from slbench.simulate.stack import traced
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Share of the repeats in which every set must have measured a pixel that is compared.
MEASURED = 2.0 / 3.0
#: Tags of the random streams of the bootstrap and of vibration; those of the sets have five.
_BOOTSTRAP, _VIBRATION = 1, 2


class NothingToCompare(InputError):
    """Scans of which no pixel can be compared: no lit surface, or none that all sets measure."""


def own_shifts(scene: Scene) -> int:
    """Return the phase shifts of a set that states none: those of the scene's own patterns."""
    return int(scene.specification.get("patterns", {}).get("shifts", 3))


@checked
def compare(
    scene: Scene,
    sets: Sequence[PatternSource | PatternSet],
    *,
    repeats: types.Repeats = 15,
    equal: Equal | None = None,
    seed: types.Seed = 0,
    shifts: int | None = None,
    transports: Sequence[LightTransport] | None = None,
    truth: GroundTruth | None = None,
    weights: WeightSource = "lit",
    question: bool = True,
    allow_modules: bool = False,
    on_progress: Progress | None = None,
) -> Comparison:
    """Scan a scene repeatedly with each pattern set and compare what comes out.

    Parameters
    ----------
    scene : Scene
        Its patterns are replaced; the axes that they code are those of the sets.  With focus
        settings, every repeat is a fused stack.
    sets : sequence of str, PatternSet and whatever else is a pattern set
        Such as ``"1,10,50@4"``, ``"gray"``, ``"mine.toml"``, a folder of pictures,
        ``"mine.py:SET"`` (:func:`slbench.patterns.read_patterns`); with a decoder of one's own
        ``"1,10,50 | mine.py:decode"``, or ``PatternSet("mine", sequence, decoder=decode)``.
    repeats : int
        Scans a set, at least 2 (15 in thesis 7.2).
    equal : {"frames", "photons"} or None
        What all sets are given the same of (:mod:`slbench.bench.compare.sets`).
    seed : int
    shifts : int, optional
        Phase shifts where a set gives none; as the scene's own patterns by default.
    transports : sequence of LightTransport, optional
        Of the scene, one a focus setting, where they are at hand; traced otherwise.
    truth : GroundTruth, optional
        Likewise.
    weights : {"lit", "modulation"}
        Where a focus stack's settings are judged to be sharp.
    question : bool
        Whether to warn of too few samples; False where the caller sums up several comparisons.
    allow_modules : bool
        Run the Python modules that sets name: code of their authors.
    on_progress : callable, optional
        Called with the name of the stage and its finished fraction.

    Returns
    -------
    Comparison

    Raises
    ------
    BackendError
        If light has to be traced and Mitsuba cannot run here.
    InputError
        For sets that cannot be compared (:func:`pattern_sets`), fewer than two repeats, and
        weights by modulation without focus settings to weigh.
    NothingToCompare
        For no pixel that all sets measure.

    Warns
    -----
    InputWarning
        If more samples would change the distance from the truth.
    """
    shifts = own_shifts(scene) if shifts is None else shifts
    chosen = pattern_sets(sets, scene, shifts=shifts, equal=equal, allow_modules=allow_modules)
    if weights != "lit" and scene.focus is None:
        raise InputError("weights", f"focus settings in scene {scene.name}, to weigh", "none")
    report = on_progress or (lambda stage, fraction: None)
    seconds: dict[str, float] = {}
    begin = time.perf_counter()

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        start = time.perf_counter()
        report(name, 0.0)
        yield
        report(name, 1.0)
        seconds[name] = time.perf_counter() - start

    with stage("trace"):
        if transports is None:
            axes = dict.fromkeys(along for one in chosen for along in one.sequence.variations)
            transports = traced(scene, tuple(axes), seed=seed)
    with stage("truth"):
        true = _true(scene) if truth is None else truth
    smooth = np.flatnonzero(true.smooth())
    if not len(smooth):
        expected = "smooth surface that the projector lights"
        why = "none" if true.lit.any() else f"none: {unlit(scene)}"
        raise NothingToCompare(f"scene {scene.name}", expected, why)
    found: dict[str, Repeats] = {}
    for k, one in enumerate(chosen):

        def progress(done: float, k: int = k) -> None:
            report("scans", (k + done) / len(chosen))

        # Products of three numbers a point: threads of the linear algebra would but wait.
        with threadpool_limits(1, user_api="blas"):
            found[one.name] = scan_repeats(
                scene,
                one,
                transports,
                true,
                smooth,
                repeats=repeats,
                seed=seed,
                weights=weights,
                on_progress=progress,
            )
        for name, spent in found[one.name].stages.items():
            seconds[name] = seconds.get(name, 0.0) + spent
    with stage("statistics"):
        common = _common(found, repeats)
        pixels = smooth[common]
        tiles = tile_numbers(true.lit.shape, pixels)
        values = {
            (name, quantity): array[common]
            for name, result in found.items()
            for quantity, array in _quantities(result).items()
        }
        resamples = resamples_for(math.comb(len(chosen), 2))
        draws = bootstrap_medians(values, tiles, tagged_seed(seed, _BOOTSTRAP), resamples)
        if scene.exposure.vibration_px > 0.0:
            for one in chosen:
                share = _shared(one, found[one.name], common)
                own = one.seed(tagged_seed(seed, _VIBRATION), 0)
                spread = spread_draws(repeats, own, resamples)
                draws |= _widened(one.name, draws, share, spread)
        medians = {key: float(np.median(array)) for key, array in values.items()}
        results = tuple(
            _result(one, found[one.name], medians, draws, true, pixels, common) for one in chosen
        )
        std, error = (
            {name: medians[name, quantity] for name in found} for quantity in ("std", "error")
        )
        std_draws, error_draws = (
            {name: draws[name, quantity] for name in found} for quantity in ("std", "error")
        )
        ranking = ranked(std)
    if question and (doubt := _samples_doubt(results, transports[0].samples)):
        warn_user(f"scene {scene.name}", doubt)
    seconds["total"] = time.perf_counter() - begin
    return Comparison(
        scene=scene.name,
        repeats=repeats,
        seed=seed,
        equal=equal,
        sets=results,
        ranking=ranking,
        pairs=compared(std, std_draws),
        error_ranking=ranked(error),
        error_pairs=compared(error, error_draws),
        pixels=len(pixels),
        lit_pixels=int(np.count_nonzero(true.lit)),
        tiles=int(tiles.max()) + 1,
        cloud=_cloud(ranking[0], found[ranking[0]], true, pixels, common),
        seconds=seconds,
        parameters={
            "scene": scene.specification,
            "sets": {one.name: one.sequence.to_dict() for one in chosen},
            "exposure_shares": {one.name: one.exposure_share for one in chosen},
            "samples": transports[0].samples,
            "repeats": repeats,
            "equal": equal,
        },
    )


def _samples_doubt(results: Sequence[SetResult], samples: int) -> str | None:
    """Question a number of samples whose Monte Carlo error is seen in the distance from truth."""
    counts = [
        more_samples(samples, one.error_median_mm, one.monte_carlo_median_mm) or 0
        for one in results
    ]
    more = max(counts)
    if not more:
        return None
    worst = results[counts.index(more)]
    return (
        f"sampling makes {length(worst.monte_carlo_median_mm)} of the "
        f"{length(worst.error_median_mm)} error of {{{worst.name}}}: {more} samples a pixel "
        f"instead of {samples} would change it (render.samples)"
    )


def _true(scene: Scene) -> GroundTruth:
    from slbench.simulate.render.groundtruth import ground_truth

    return ground_truth(scene.objects, scene.rig)


def _common(found: dict[str, Repeats], repeats: int) -> NDArray[np.bool_]:
    """Return a mask of pixels that every set measured often enough to be compared."""
    least = max(2, math.ceil(MEASURED * repeats))
    often = {name: result.scans >= least for name, result in found.items()}
    common = np.logical_and.reduce(list(often.values()))
    if not common.any():
        shares = ", ".join(f"{name} {np.mean(enough):.2g}" for name, enough in often.items())
        expected = f"pixels that all of them measure in {least} of {repeats} repeats"
        got = f"none; their shares of the smooth lit ones: {shares}"
        raise NothingToCompare("sets", expected, got)
    return common


def _quantities(result: Repeats) -> dict[str, Array]:
    """Return what medians are taken of, by name, (P,) each."""
    scans = np.maximum(result.scans, 1)
    error = np.sqrt(result.square_mm2 / scans)
    return {"std": result.std_mm, "std_z": result.std_z_mm, "error": error}


def _median(values: Array) -> float:
    """Return the median of what is finite; NaN of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _shared(one: PatternSet, found: Repeats, common: NDArray[np.bool_]) -> float:
    """Return the share of a vibrating set's variance that moves all pixels alike.

    What the detector is not predicted to cause; all of it for a Gray code alone, whose
    prediction is its step and not its noise.
    """
    if not all(one.sequence.fringe_counts(axis) for axis in one.sequence.axes):
        return 1.0
    ratio = _std_over_predicted(found, common)
    return 1.0 - 1.0 / max(ratio, 1.0) ** 2


def _widened(
    name: str, draws: Mapping[tuple[str, str], Array], share: float, spread: Array
) -> dict[tuple[str, str], Array]:
    """Return the draws of one set's medians with the uncertainty of its vibration."""
    of = {"std": "std", "std_z": "std_z", "error": "std"}
    return {
        (name, quantity): shaken(draws[name, quantity], draws[name, std], share, spread)
        for quantity, std in of.items()
    }


def _std_over_predicted(found: Repeats, common: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean((found.std_mm[common] / found.predicted_mm[common]) ** 2)))


def _bound_share(found: Repeats, common: NDArray[np.bool_]) -> float:
    """Return the bound over the deviation, by RMS: medians of few repeats' are too small."""
    own = common & (found.bound_mm > 0.0)
    ratio = float(np.mean((found.std_mm[own] / found.bound_mm[own]) ** 2)) if own.any() else 0.0
    return ratio**-0.5 if ratio > 0.0 else float("nan")


def _result(
    one: PatternSet,
    found: Repeats,
    medians: dict[tuple[str, str], float],
    draws: dict[tuple[str, str], Array],
    truth: GroundTruth,
    pixels: NDArray[np.intp],
    common: NDArray[np.bool_],
) -> SetResult:
    interval = {
        quantity: percentile_interval(draws[one.name, quantity])
        for quantity in ("std", "std_z", "error")
    }

    def image(values: Array) -> Array:
        picture = np.full(truth.lit.shape, np.nan)
        picture.ravel()[pixels] = values[common]
        return picture

    return SetResult(
        name=one.name,
        sequence=one.sequence,
        frames=one.frames,
        exposure_s=found.exposure_s,
        std_median_mm=medians[one.name, "std"],
        std_ci95_mm=interval["std"],
        std_z_median_mm=medians[one.name, "std_z"],
        std_z_ci95_mm=interval["std_z"],
        predicted_mm=float(np.median(found.predicted_mm[common])),
        std_over_predicted=_std_over_predicted(found, common),
        bound_mm=_median(found.bound_mm[common]),
        bound_share=_bound_share(found, common),
        error_median_mm=medians[one.name, "error"],
        error_ci95_mm=interval["error"],
        floor_median_mm=_median(found.floor_mm[common]),
        monte_carlo_median_mm=_median(found.sampling_mm[common]),
        bias_mm=float(np.mean(found.error_mm[common, 2])),
        rms_mm=float(np.sqrt(found.square_mm2[common].sum() / found.scans[common].sum())),
        order_error_rate=found.order_error_rate,
        right=found.right,
        completeness=found.completeness,
        seconds=found.seconds,
        steps=found.steps,
        std_mm=image(found.std_mm),
        std_z_mm=image(found.std_z_mm),
        error_mm=image(found.error_mm[:, 2]),
        note=one.note,
    )


def _cloud(
    name: str,
    found: Repeats,
    truth: GroundTruth,
    pixels: NDArray[np.intp],
    common: NDArray[np.bool_],
) -> Cloud:
    """Return the mean points of a set, to be coloured by error and deviation."""
    true = truth.point.reshape(-1, 3)[pixels]
    values = {
        "height error / µm": 1e3 * found.error_mm[common, 2],
        "standard deviation / µm": 1e3 * found.std_mm[common],
    }
    caption = "Mean over the repeats, at the pixels of the comparison."
    return Cloud(f"Points of {{{name}}}", true + found.error_mm[common], values, true, caption)
