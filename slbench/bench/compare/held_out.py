"""A pattern set held to the fixed sets of as many frames, on scenes that it was not made for.

Every fixed set is scanned on every scene by itself.  The best of them is chosen on these same
scenes, which favours it: of those that measure as much of the surface rightly as any, but for one
per cent, the one with the least distance from the truth (geometric mean over the scenes).  Then
both are scanned together (:func:`slbench.bench.compare.compare.compare`), with as many photons.

The set *beats* the best fixed one where the geometric mean of the ratios of their distances is
below one with its 95 % interval, and it measures as much rightly, but for one per cent.  The
interval is that over the scenes (Student's t, of the logarithms); with one, that over the repeats.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from slbench.bench.compare.compare import NothingToCompare, compare
from slbench.bench.compare.comparison import SetResult
from slbench.bench.compare.sets import PatternSet
from slbench.bench.compare.suite import SETS
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.patterns import Panel, PatternSequence
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.transport import LightTransport

#: Counts of the finest fringes that are tried.
_COUNTS = (8, 16, 24, 32, 40, 48, 64, 80, 96, 128)
#: Least panel pixels a fringe.
_LEAST_PX = 5.0
#: Share of the surface that makes no difference.
_SHARE = 0.01


class HeldOut(NamedTuple):
    """A scene with its light: one transport a focus setting."""

    name: str
    scene: Scene
    transports: tuple[LightTransport, ...]
    truth: GroundTruth


@dataclass(frozen=True)
class Ranked:
    """A fixed set over the scenes.

    Parameters
    ----------
    name : str
    error_mm : float
        Geometric mean of its distances from the truth.
    right : float
        Mean share of the smooth lit surface that it measures to within two panel pixels.
    """

    name: str
    error_mm: float
    right: float


@dataclass(frozen=True)
class OnScene:
    """Both sets on one scene: results, and the learned one's error over the other's."""

    scene: str
    learned: SetResult
    fixed: SetResult
    ratio: float
    ratio_ci95: tuple[float, float]


@dataclass(frozen=True)
class Verdict:
    """What came of it.

    Parameters
    ----------
    best : str
        The best fixed set.
    ranked : tuple of Ranked
        All that could be scanned, best first; those that lose surface last.
    scenes : tuple of OnScene
    ratio : float
        Geometric mean of the error over the best fixed set's.
    ratio_ci95 : (float, float)
    right, fixed_right : float
        Mean shares measured rightly.
    """

    best: str
    ranked: tuple[Ranked, ...]
    scenes: tuple[OnScene, ...]
    ratio: float
    ratio_ci95: tuple[float, float]
    right: float
    fixed_right: float

    __repr__ = brief

    @property
    def beats(self) -> bool:
        """Whether the learned set is better, beyond chance, and loses no surface."""
        return self.ratio_ci95[1] < 1.0 and self.keeps

    @property
    def keeps(self) -> bool:
        """Whether it measures as much surface rightly as the fixed set, but for one per cent."""
        return self.right >= self.fixed_right - _SHARE

    def text(self) -> str:
        """Return the verdict in words."""
        low, high = self.ratio_ci95
        count = len(self.scenes)
        found = (
            f"{self.ratio:.3f} of its error [{low:.3f}, {high:.3f}], on {count} "
            f"scene{'s' * (count > 1)}; measured rightly {self.right:.2%} to {self.fixed_right:.2%}"
        )
        if self.beats:
            return f"The learned set beats {{{self.best}}}, the best fixed one: {found}"
        return f"The learned set does not beat {{{self.best}}}, the best fixed one: {found}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "best": self.best,
            "beats": self.beats,
            "ratio": self.ratio,
            "ratio_ci95": list(self.ratio_ci95),
            "right": self.right,
            "fixed_right": self.fixed_right,
            "ranked": [vars(one) for one in self.ranked],
            "scenes": [
                {
                    "scene": one.scene,
                    "ratio": one.ratio,
                    "ratio_ci95": list(one.ratio_ci95),
                    "error_mm": one.learned.error_median_mm,
                    "fixed_error_mm": one.fixed.error_median_mm,
                    "right": one.learned.right,
                    "fixed_right": one.fixed.right,
                }
                for one in self.scenes
            ],
        }


def fixed_sets(frames: int, panel: Panel) -> list[str]:
    """Return the fixed sets of a number of frames along u: fringes, and those of the suite.

    Fringes have three shifts in each set but the finest, which has the rest.
    """
    found: dict[str, None] = {}
    counts = [n for n in _COUNTS if n <= panel[0] / _LEAST_PX]
    if frames >= 6:
        found |= dict.fromkeys(f"1@3,{n}@{frames - 3}" for n in counts)
    if frames >= 9:
        chains = (f"1@3,{round(math.sqrt(n))}@3,{n}@{frames - 6}" for n in counts if n > 8)
        found |= dict.fromkeys(chains)
    given = (f"optimised{frames}", f"optimised{frames}x32", f"hamiltonian{frames}", *SETS)
    for text in given:
        try:
            if PatternSequence.parse(text, panel).n_frames == frames:
                found[text] = None
        except InputError:  # not for so many frames, or this panel
            continue
    return list(found)


def hold(
    learned: PatternSet,
    places: Sequence[HeldOut],
    *,
    fixed: Sequence[str] | None = None,
    repeats: int = 5,
    seed: int = 0,
    on_progress: Callable[[float], None] | None = None,
) -> Verdict:
    """Hold a set to the best fixed set of as many frames.

    Parameters
    ----------
    learned : PatternSet
        Along u.
    places : sequence of HeldOut
        Scenes that it was not made for.
    fixed : sequence of str, optional
        Those to hold it to; by default :func:`fixed_sets`.
    repeats, seed : int
    on_progress : callable, optional

    Raises
    ------
    InputError
        For no scenes, no fixed set of so many frames, or scenes on which nothing can be measured.
    """
    if not places:
        raise InputError("held-out scenes", "one or more", "none")
    panel = learned.sequence.panel
    names = fixed_sets(learned.frames, panel) if fixed is None else list(fixed)
    total, done = (len(names) + 2) * len(places), 0

    def scanned(sets: Sequence[Any], place: HeldOut) -> Any:
        nonlocal done
        try:
            return compare(
                place.scene,
                sets,
                repeats=repeats,
                seed=seed,
                equal="photons",
                shifts=3,
                transports=place.transports,
                truth=place.truth,
                question=False,
            )
        except NothingToCompare:
            return None
        finally:
            done += len(sets)
            if on_progress:
                on_progress(min(done / total, 1.0))

    ranked = []
    for name in names:
        every = [scanned([name], place) for place in places]
        results = [one.sets[0] for one in every if one is not None]
        if len(results) == len(places):
            error = math.exp(float(np.mean([math.log(one.error_median_mm) for one in results])))
            ranked.append(Ranked(name, error, float(np.mean([one.right for one in results]))))
    if not ranked:
        expected = f"a fixed set of {learned.frames} frames that measures all scenes"
        raise InputError("held-out scenes", expected, "none")
    whole = max(one.right for one in ranked) - _SHARE
    ranked.sort(key=lambda one: (one.right < whole, one.error_mm))
    best = ranked[0].name
    scenes = []
    for place in places:
        both = scanned([learned, best], place)
        if both is None:
            expected = f"pixels that the learned set and {best} both measure"
            raise InputError(f"scene {place.name}", expected, "none")
        by_name = {one.name: one for one in both.sets}
        (pair,) = both.error_pairs
        pair = pair if pair.a == learned.name else pair.reversed()
        own = by_name.pop(learned.name)
        (other,) = by_name.values()
        scenes.append(OnScene(place.name, own, other, pair.ratio, pair.ratio_ci95))
    right, fixed_right = (
        float(np.mean([one.right for one in many]))
        for many in ([s.learned for s in scenes], [s.fixed for s in scenes])
    )
    ratio, interval = _over_scenes(scenes)
    return Verdict(best, tuple(ranked), tuple(scenes), ratio, interval, right, fixed_right)


def over_seeds(verdicts: Sequence[Verdict]) -> tuple[float, tuple[float, float]]:
    """Return the geometric mean of several codes' ratios and its 95 % interval (Student's t).

    Parameters
    ----------
    verdicts : sequence of Verdict
        Two or more, of codes that were learned from other starts, on other scenes.
    """
    return _mean_ratio([one.ratio for one in verdicts])


def _over_scenes(scenes: Sequence[OnScene]) -> tuple[float, tuple[float, float]]:
    """Return the geometric mean of the ratios and its 95 % interval."""
    if len(scenes) == 1:
        return scenes[0].ratio, scenes[0].ratio_ci95
    return _mean_ratio([one.ratio for one in scenes])


def _mean_ratio(ratios: Sequence[float]) -> tuple[float, tuple[float, float]]:
    from scipy.stats import t

    logs = np.log(ratios)
    half = float(t.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / math.sqrt(len(logs)))
    mean = float(logs.mean())
    return math.exp(mean), (math.exp(mean - half), math.exp(mean + half))
