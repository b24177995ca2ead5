"""Pattern sets compared on one scene: same light, same pixels, their own noise.

Light is traced once and serves all sets and repeats, so that what differs between two results is
what the patterns and the detector do.  Every repeat of a set draws its noise from (seed, text of
the set, repeat): a result does not depend on which other sets are compared or in what order.

*Pixels.*  Deviations and distances are taken over the pixels of smooth lit surface
(:meth:`slbench.scene.truth.GroundTruth.smooth`) that *every* set measured in at least two thirds of
its repeats: the same pixels for all, so that a set gains nothing from giving up the hard ones.
What it gives up is told by its completeness, over all lit pixels, and by its order errors, over
all that it measured of the smooth surface; neither depends on the other sets.  Measurements in
a wrong order are counted there alone: a single one would be the deviation of its neighbourhood.

*Two rankings.*  By repeatability, the standard deviation over the repeats (thesis 7.2.2), and
by distance from the truth.  The first alone would praise a code that repeats the same wrong value.
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
from slbench.bench.compare.significance import (
    compared,
    middle_half,
    motion_freedom,
    ranked,
    resamples_for,
    spread_draws,
)
from slbench.bench.statistics import percentile_interval
from slbench.capture.stack import WeightSource
from slbench.core.errors import InputError, warn_user
from slbench.core.random import generator, tagged_seed
from slbench.core.show.display import length
from slbench.core.show.document import Cloud
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.patterns import PatternSource
from slbench.scene.doubts import unlit
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.floors import more_samples, rms
from slbench.simulate.stack import traced
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Share of the repeats in which every set must have measured a pixel that is compared.
MEASURED = 2.0 / 3.0
#: Tags of the random streams of draws and of vibration; those of the sets have five.
_DRAWS, _VIBRATION = 1, 2


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
        ``"1,10,50 | mine.py:decode"``, or ``PatternSet("mine", sequence, decoder=decode)``; with
        the projector's response taken out ``"1,10,50 | gamma=2.2"``.
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
        resamples = resamples_for(math.comb(len(chosen), 2))
        values: dict[tuple[str, str], float] = {}
        draws: dict[tuple[str, str], Array] = {}
        for one in chosen:
            alike = [other for other in chosen if other.sequence == one.sequence]
            typical = _typical(alike, found, common)
            known, drawn = _pooled(one, found[one.name], common, *typical, repeats, seed, resamples)
            values |= {(one.name, quantity): value for quantity, value in known.items()}
            draws |= {(one.name, quantity): array for quantity, array in drawn.items()}
        results = tuple(
            _result(one, found[one.name], values, draws, true, pixels, common) for one in chosen
        )
        std, error = (
            {name: values[name, quantity] for name in found} for quantity in ("std", "error")
        )
        std_draws, error_draws = (
            {name: draws[name, quantity] for name in found} for quantity in ("std", "error")
        )
        ranking = ranked(std)
    if question and (doubt := _samples_doubt(results, values, transports[0].samples)):
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


def _samples_doubt(
    results: Sequence[SetResult], values: Mapping[tuple[str, str], float], samples: int
) -> str | None:
    """Question a number of samples whose Monte Carlo error is seen in the distance from truth.

    Both are pooled over the same pixels.
    """
    counts = [
        more_samples(samples, one.error_median_mm, values[one.name, "sampling"]) or 0
        for one in results
    ]
    more = max(counts)
    if not more:
        return None
    worst = results[counts.index(more)]
    return (
        f"sampling makes {length(values[worst.name, 'sampling'])} of the "
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


def _typical(
    alike: Sequence[PatternSet], found: dict[str, Repeats], common: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return of which pixels the deviations and the distances of sets are.

    Sets of the same patterns have the same ones, whatever their decoders predict: they would else
    be told apart by their pixels.
    """
    predicted = [found[one.name].predicted_mm for one in alike]
    floors = [_floor(one, found[one.name]) for one in alike]
    expected = [np.hypot(*pair) for pair in zip(floors, predicted, strict=True)]
    return middle_half(predicted, common), middle_half(expected, common)


def _floor(one: PatternSet, found: Repeats) -> Array:
    """Return distances without noise; none of codes of steps, which decide otherwise with it."""
    return np.nan_to_num(found.floor_mm) * _fringes(one)


def _pooled(
    one: PatternSet,
    found: Repeats,
    common: NDArray[np.bool_],
    steady: NDArray[np.bool_],
    near: NDArray[np.bool_],
    repeats: int,
    seed: int,
    resamples: int,
) -> tuple[dict[str, float], dict[str, Array]]:
    """Return pooled deviations and distances by name, and draws of what they may be."""
    floor = _floor(one, found)
    pooled = {
        "std": found.sums["std"].pooled(steady),
        "std_z": found.sums["std_z"].pooled(steady),
        "error": found.sums["error"].pooled(near),
    }
    if not all(np.isfinite(one.mean) for one in pooled.values()):
        expected = "pixels that it measures twice in the right order"
        raise NothingToCompare(f"set {one.name}", expected, "none")
    predicted = float(np.sqrt(np.mean(found.predicted_mm[steady] ** 2)))
    rng = generator(one.seed(tagged_seed(seed, _DRAWS), 0))
    squares = {name: square.draws(rng, resamples) for name, square in pooled.items()}
    if found.together is not None:
        share = _shared(one, found, common)
        freedom = motion_freedom(repeats, share, found.together)
        moved = {name: square.mean for name, square in pooled.items()}
        # Of the distance what is not steady: beyond the floor, and no less than the scatter about
        # the mean, to which the mean itself adds a further degree of freedom.
        scatter = found.sums["std"].pooled(near).mean * (repeats - 1) / repeats
        moved["error"] = max(moved["error"] - float(np.mean(floor[near] ** 2)), scatter)
        own = generator(one.seed(tagged_seed(seed, _VIBRATION), 0))
        for name, square in moved.items():
            more = repeats / (repeats - 1) if name == "error" else 1.0
            spread = spread_draws(more * freedom, own, resamples)
            squares[name] = np.maximum(squares[name] + share * square * (spread - 1.0), 0.0)
    roots = {name: square.root for name, square in pooled.items()}
    roots["sampling"] = rms([found.sampling_mm[near]])
    return roots | {"predicted": predicted}, {k: np.sqrt(v) for k, v in squares.items()}


def _median(values: Array) -> float:
    """Return the median of what is finite; NaN of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _fringes(one: PatternSet) -> bool:
    """Return whether fringes decide the set's coordinates along every axis."""
    return all(one.sequence.fringe_counts(axis) for axis in one.sequence.axes)


def _shared(one: PatternSet, found: Repeats, common: NDArray[np.bool_]) -> float:
    """Return the share of a vibrating set's variance that moves all pixels alike.

    What the detector is not predicted to cause; all of it for a Gray code alone, whose
    prediction is its step and not its noise.
    """
    if not _fringes(one):
        return 1.0
    ratio = _std_over_predicted(found, common)
    return 1.0 - 1.0 / max(ratio, 1.0) ** 2


def _std_over_predicted(found: Repeats, common: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.nanmean((found.std_mm[common] / found.predicted_mm[common]) ** 2)))


def _bound_share(found: Repeats, common: NDArray[np.bool_]) -> float:
    """Return the bound over the deviation, by RMS: medians of few repeats' are too small."""
    own = common & (found.bound_mm > 0.0) & (found.kept > 1)
    ratio = float(np.mean((found.std_mm[own] / found.bound_mm[own]) ** 2)) if own.any() else 0.0
    return ratio**-0.5 if ratio > 0.0 else float("nan")


def _result(
    one: PatternSet,
    found: Repeats,
    values: dict[tuple[str, str], float],
    draws: dict[tuple[str, str], Array],
    truth: GroundTruth,
    pixels: NDArray[np.intp],
    common: NDArray[np.bool_],
) -> SetResult:
    interval = {
        quantity: percentile_interval(draws[one.name, quantity])
        for quantity in ("std", "std_z", "error")
    }

    def image(array: Array) -> Array:
        picture = np.full((truth.lit.size, *array.shape[1:]), np.nan)
        picture[pixels] = array[common]
        return picture.reshape(*truth.lit.shape, *array.shape[1:])

    return SetResult(
        name=one.name,
        sequence=one.sequence,
        frames=one.frames,
        exposure_s=found.exposure_s,
        std_median_mm=values[one.name, "std"],
        std_ci95_mm=interval["std"],
        std_z_median_mm=values[one.name, "std_z"],
        std_z_ci95_mm=interval["std_z"],
        predicted_mm=values[one.name, "predicted"],
        std_over_predicted=_std_over_predicted(found, common),
        bound_mm=_median(found.bound_mm[common]),
        bound_share=_bound_share(found, common),
        error_median_mm=values[one.name, "error"],
        error_ci95_mm=interval["error"],
        floor_median_mm=_median(found.floor_mm[common]),
        monte_carlo_median_mm=_median(found.sampling_mm[common]),
        bias_mm=float(np.nanmean(found.error_mm[common, 2])),
        rms_mm=float(np.sqrt(found.square_mm2[common].sum() / found.scans[common].sum())),
        order_error_rate=found.order_error_rate,
        right=found.right,
        completeness=found.completeness,
        seconds=found.seconds,
        steps=found.steps,
        std_mm=image(found.std_mm),
        std_z_mm=image(found.std_z_mm),
        error_mm=image(found.error_mm[:, 2]),
        shift_mm=image(found.error_mm),
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
