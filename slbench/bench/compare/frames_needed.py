"""How many frames adaptive fringes need for what the best fixed set reaches.

The fixed set is that of ``slbench design patterns``: of all sets of so many frames the one of least
noise under a bound on wrong orders (:mod:`slbench.design.fringes.bounded`), by the phase noise of
a plate of the scene's own material.  Of the sets for several factors of safety that one counts
which does best on the scene itself, in a scan of its own.  Both are judged alike: by the 95th
percentile of the deviation of points over all smooth lit pixels, those that are not measured
counted as infinite.  Deviations are what either predicts; how often it is far from the truth stands
beside them.

Both draw the noise of the detector anew in each repeat.  The ratio of frames is that of an adaptive
scan to the fixed set of the same repeat, between two sets by a straight line of the logarithms; its
interval is a bootstrap's over the repeats.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.statistics import percentile_interval
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.core.io import OutputFolder, write_json
from slbench.core.io.atomic import write_bytes
from slbench.core.random import generator, tagged_seed
from slbench.core.show.display import brief
from slbench.core.show.document import Cell, Table
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.design.adaptive.adapt import adapt
from slbench.design.adaptive.choose import PERCENTILE, percentile
from slbench.design.adaptive.shots import SHIFTS, check_adaptable
from slbench.design.fringes.bounded import bounded_sequence
from slbench.design.fringes.design import SequenceDesign, candidates, usable
from slbench.design.fringes.trial import noise_of_scene
from slbench.patterns import PhaseMap
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.lights import Lights
from slbench.simulate.stack import capture_stack

Array = NDArray[np.float64]

FRAMES_FOLDER = OutputFolder("frames of adaptive fringes", ("adaptive.json", "adaptive.md"))
#: Repeats of the plate by which the fixed set is designed.
_PLATES = 6
#: How many times the frames of the fixed set an adaptive scan may take.
_LONGER = 1.5
#: Resamples of a bootstrap.
_RESAMPLES = 2000
#: A coordinate further from the truth is wrong, panel px.
_WRONG_PX = 2.0
#: Tags of the random streams.
_FIXED, _ADAPTIVE, _BOOTSTRAP, _TRIED = 1, 2, 3, 4
#: Times the noise of the plate with which orders are to be safe: dim parts have more, and a
#: decoder masks what is merely in doubt.
_SAFETY = (1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True, kw_only=True)
class FramesNeeded:
    """Adaptive fringes beside the best fixed set on one scene.

    Parameters
    ----------
    scene, fixed : str
        Name, and the fixed set.
    frames : int
        Of the fixed set.
    fixed_um, adaptive_um : float
        95th percentile of the deviation at as many frames, median over the repeats; infinite where
        more than a twentieth is not measured.
    ratio : float
        Frames of the adaptive scan over those of the fixed set at the fixed set's percentile, mean
        over the repeats; infinite where it is not reached with half as many again, NaN where the
        fixed set has none.
    ratio_ci95 : (float, float)
    fixed_wrong, adaptive_wrong : float
        Shares of measured pixels beyond two panel pixels from the truth.
    light : float
        Exposure of the adaptive scan over that of the fixed set, at as many frames.
    """

    scene: str
    fixed: str
    frames: int
    fixed_um: float
    adaptive_um: float
    ratio: float
    ratio_ci95: tuple[float, float]
    fixed_wrong: float
    adaptive_wrong: float
    light: float

    __repr__ = brief

    @property
    def verdict(self) -> str:
        """Say which needs fewer frames, where the repeats tell it."""
        if math.isinf(self.fixed_um):
            if math.isinf(self.adaptive_um):
                return "neither measures 95 % of the pixels"
            return "only adaptive fringes measure 95 % of the pixels"
        if math.isinf(self.ratio):
            return "adaptive fringes do not get there"
        low, high = self.ratio_ci95
        if high < 1.0:
            return "adaptive fringes need fewer frames"
        return "adaptive fringes need more frames" if low > 1.0 else "not told apart"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, None for what is no finite number."""

        def finite(value: float) -> float | None:
            return value if math.isfinite(value) else None

        return {
            "scene": self.scene,
            "fixed": self.fixed,
            "frames": self.frames,
            "fixed_um": finite(self.fixed_um),
            "adaptive_um": finite(self.adaptive_um),
            "ratio": finite(self.ratio),
            "ratio_ci95": [finite(one) for one in self.ratio_ci95],
            "fixed_wrong": self.fixed_wrong,
            "adaptive_wrong": self.adaptive_wrong,
            "light": self.light,
            "verdict": self.verdict,
        }


@checked
def frames_needed(
    scene: Scene,
    *,
    frames: types.Count = 24,
    repeats: types.Repeats = 5,
    seed: types.Seed = 0,
    on_progress: Callable[[float], None] | None = None,
) -> FramesNeeded:
    """Measure a scene with the best fixed set and adaptively, repeatedly.

    Parameters
    ----------
    scene : Scene
        Its columns are coded.
    frames : int
        Of the fixed set, at most.
    repeats, seed : int
    on_progress : callable, optional
        Called with the finished fraction.

    Raises
    ------
    InputError
        For a scene that cannot be measured adaptively, or in which no fixed set serves.
    """
    check_adaptable(scene)
    if frames < 3 * SHIFTS:
        raise InputError("frames", f"at least {3 * SHIFTS}, three sets", frames)
    lights = Lights(seed, kept=1)
    (transport,) = lights.traced(scene.with_patterns("1"))
    truth = lights.truth(scene)
    smooth = truth.smooth().ravel()
    per_px = _per_px(scene, truth)
    true = truth.panel[..., 0].ravel()

    def scanned(patterned: Scene, own: int) -> tuple[PhaseMap, float]:
        shots = capture_stack(patterned, (transport,), seed=own).captures[0]
        phase = shots.decode()
        found = np.where(phase.mask, phase.sigma["u"], np.inf).ravel()
        return phase, 1e3 * percentile(found * per_px, smooth)

    tried = []
    for design in _fixed_sets(scene, frames, seed):
        patterned = replace(scene, sequence=design.sequence(scene.sequence.panel))
        tried.append((scanned(patterned, tagged_seed(seed, _TRIED))[1], design.frames, patterned))
    _, used, fixed = min(tried, key=lambda one: one[:2])
    ratios, reached, there = [], [], []
    wrong = np.zeros((2, repeats))
    light = []
    for r in range(repeats):
        phase, own_um = scanned(fixed, tagged_seed(seed, _FIXED, r))
        reached.append(own_um)
        wrong[0, r] = _wrong(phase, true, smooth)
        most = int(_LONGER * frames) // SHIFTS * SHIFTS
        adapted = adapt(
            *(fixed, transport),
            max_frames=most,
            seed=tagged_seed(seed, _ADAPTIVE, r),
            keep_trail=True,
        )
        path = np.array([1e3 * percentile(one.ravel() * per_px, smooth) for one in adapted.trail])
        counts = np.array([one.frames for one in adapted.choices], float)
        same = np.flatnonzero(counts <= used)[-1]
        there.append(float(path[same]))
        light.append(sum(SHIFTS * one.exposure for one in adapted.choices[: same + 1]))
        wrong[1, r] = _wrong(adapted.phase, true, smooth)
        ratios.append(_crossing(counts, path, reached[-1]) / used)
        if on_progress:
            on_progress((r + 1) / repeats)
    rng = generator(tagged_seed(seed, _BOOTSTRAP))
    drawn = np.array(ratios)[rng.integers(0, repeats, (_RESAMPLES, repeats))].mean(axis=1)
    whole = np.isfinite(drawn).all()
    return FramesNeeded(
        scene=scene.name,
        fixed=fixed.sequence.name,
        frames=used,
        fixed_um=float(np.median(reached)),
        adaptive_um=float(np.median(there)),
        ratio=float(np.mean(ratios)),
        ratio_ci95=percentile_interval(drawn) if whole else (math.nan, math.nan),
        fixed_wrong=float(wrong[0].mean()),
        adaptive_wrong=float(wrong[1].mean()),
        light=float(np.mean(light)) / used,
    )


def _fixed_sets(scene: Scene, frames: int, seed: int) -> list[SequenceDesign]:
    """Return the best sets of so many frames by the noise of a plate, each with another safety."""
    width = scene.sequence.panel[0]
    counts = candidates(width)
    noise = noise_of_scene(scene, counts, repeats=_PLATES, seed=seed)
    kept = usable(counts, noise)
    return [bounded_sequence(width, noise, kept, safety=s, frames=frames) for s in _SAFETY]


def _per_px(scene: Scene, truth: GroundTruth) -> Array:
    """Return the millimetres that a panel pixel makes at each lit pixel, by the true geometry."""
    ones = np.where(truth.lit, 1.0, np.nan)
    blank = np.zeros(truth.lit.shape, np.float32)
    phase = PhaseMap(
        coordinate={"u": np.where(truth.lit, truth.panel[..., 0], np.nan)},
        sigma={"u": ones},
        modulation=blank,
        mean=blank,
        mask=truth.lit,
    )
    cloud = triangulate(scene.rig, phase)
    image = cloud.image(cloud.sigma_total_mm).ravel()
    return np.where(np.isfinite(image), image, np.nanmedian(image))


def _wrong(phase: PhaseMap, true: Array, smooth: NDArray[np.bool_]) -> float:
    """Return the share of measured smooth pixels that are far from the truth."""
    own = smooth & phase.mask.ravel()
    far = np.abs(phase.coordinate["u"].ravel()[own] - true[own]) > _WRONG_PX
    return float(far.mean()) if own.any() else math.nan


def _crossing(counts: Array, path: Array, wanted: float) -> float:
    """Return at how many frames a path reaches what is wanted; infinite where it does not."""
    if not math.isfinite(wanted):
        return math.nan
    best = np.minimum.accumulate(path)
    if best[-1] > wanted:
        return math.inf
    k = int(np.argmax(best <= wanted))
    if k == 0 or not math.isfinite(best[k - 1]) or best[k] == best[k - 1]:
        return float(counts[k])
    share = math.log(best[k - 1] / wanted) / math.log(best[k - 1] / best[k])
    return float(math.exp(np.log(counts[k - 1]) + share * np.log(counts[k] / counts[k - 1])))


def table(found: Sequence[FramesNeeded], refused: Sequence[tuple[str, str]] = ()) -> Table:
    """Lay results out, a row each, and below them which scenes were not measured, and why."""
    columns = (
        "scene",
        "fixed set",
        "frames",
        f"{PERCENTILE:.0f}th percentile, fixed / µm",
        "adaptive / µm",
        "adaptive frames over fixed",
        "wrong, fixed / %",
        "wrong, adaptive / %",
        "light over fixed",
        "verdict",
    )
    rows: list[tuple[Cell, ...]] = []
    for one in found:
        low, high = one.ratio_ci95
        ratio = f"{one.ratio:.2f} [{low:.2f}, {high:.2f}]" if math.isfinite(one.ratio) else "-"
        rows.append(
            (
                one.scene,
                one.fixed,
                one.frames,
                one.fixed_um if math.isfinite(one.fixed_um) else None,
                one.adaptive_um if math.isfinite(one.adaptive_um) else None,
                ratio,
                100.0 * one.fixed_wrong,
                100.0 * one.adaptive_wrong,
                one.light,
                one.verdict,
            )
        )
    note = "; ".join(f"{name} is not measured: {why}" for name, why in refused)
    return Table("Frames at equal 95th percentile", columns, tuple(rows), note)


def write_frames_needed(
    found: Sequence[FramesNeeded],
    refused: Sequence[tuple[str, str]],
    folder: str | Path,
    settings: Mapping[str, Any],
    seed: int,
) -> None:
    """Write ``adaptive.json``, ``adaptive.md`` and the provenance; all or nothing."""
    with FRAMES_FOLDER.writing(folder, settings, seed) as temporary:
        values = {"scenes": [one.to_dict() for one in found], "refused": dict(refused)}
        write_json(temporary / "adaptive.json", values | {"settings": dict(settings)})
        text = table(found, refused).markdown() + "\n"
        write_bytes(temporary / "adaptive.md", text.encode())
