"""Pattern sets on scenes on which codes are known to differ: the field's benchmark.

Every set is scanned on every scene by itself (:func:`slbench.bench.compare.compare.compare` of one
set), in the same light: sets that fail on a scene take no pixels from the others.  What a set is
worth there are two numbers: the share of the smooth lit surface that it measures *rightly*, that
is to within two panel pixels, and the distance from the truth of what it measures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from slbench.bench.compare.compare import NothingToCompare, compare, own_shifts
from slbench.bench.compare.comparison import SetResult
from slbench.bench.compare.sets import Equal, PatternSet, pattern_sets
from slbench.core.show.display import brief
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.patterns import PatternSource
from slbench.scene.changes import Changes, read_changes
from slbench.scene.file import load_scene
from slbench.simulate.stack import traced

Progress = Callable[[str, float], None]

#: Shipped scenes, from what every code can to what tells codes apart.
SCENES = ("plane", "v-groove", "bowl", "defocused", "gamma", "dark-and-bright", "ambient")
#: A set of every family, of as many frames as is usual for it.
SETS = (
    *("1,16@4", "1,10,50@4", "13,16@4", "15,16@4+heterodyne"),
    *("gray", "xor4", "gray+16@3", "gray+16@4", "gray+16@5"),
    *("micro", "orders16@4+16@4", "hamiltonian4", "embedded64x3@3", "trapezoid1"),
    *("gray+two-plus-one16", "white+black+gray+two-step16", "gray+dithered16@4"),
    *("gray+modulated16@3", "gray+fourier64", "gray+composite16", "white+black+de-bruijn8px"),
    *("speckle10", "optimised4", "optimised6", "m-array10px"),
)


@dataclass(frozen=True)
class Outcome:
    """One set on one scene.

    Parameters
    ----------
    scene : str
    name : str
        The set, as it was given.
    result : SetResult or None
        None where it measured too little to be judged.
    why : str
        Why there is none.
    """

    scene: str
    name: str
    result: SetResult | None
    why: str = ""

    __repr__ = brief

    @property
    def right(self) -> float:
        """Share of the smooth lit pixels that were measured to within two panel pixels."""
        return 0.0 if self.result is None else self.result.right

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        found = None if self.result is None else self.result.to_dict()
        return {"scene": self.scene, "set": self.name, "right": self.right, "why": self.why} | {
            "result": found
        }


@dataclass(frozen=True)
class Claim:
    """What the literature states of two sets on a scene.

    Parameters
    ----------
    text : str
    source : str
        Paper.
    scene, better, worse : str
    by : {"right", "error"}
        Share of the surface that is measured rightly, or distance from the truth.
    """

    text: str
    source: str
    scene: str
    better: str
    worse: str
    by: Literal["right", "error"]


_GUPTA_2012 = "Gupta and Nayar, CVPR 2012"
_GUPTA_2011 = "Gupta et al., CVPR 2011"
_ZUO = "Zuo et al., Opt. Lasers Eng. 85, 2016"
_LIU = "Liu et al., J. Opt. Soc. Am. A 27, 2010"
_MICRO = "Micro phase shifting is nearer the truth than plain fringes under interreflection"
_XOR = "XOR codes measure more rightly than a Gray code under interreflection"
_HIERARCHY = "In noise, a set of one fringe tells more orders rightly than number theory does"
_NUMBERS = "In noise, number theory tells more orders rightly than a beat does"
_GAMMA_3 = "Of a gamma of 2.2, four shifts leave less error than three (0.0075 and 0.205 rad)"
_GAMMA_4 = "Of a gamma of 2.2, five shifts leave less error than four (0.0009 and 0.0075 rad)"
#: Of sets that :data:`SETS` has.
CLAIMS: tuple[Claim, ...] = (
    Claim(_MICRO, _GUPTA_2012, "v-groove", "micro", "1,16@4", "error"),
    Claim(_MICRO, _GUPTA_2012, "bowl", "micro", "1,16@4", "error"),
    Claim(_XOR, _GUPTA_2011, "v-groove", "xor4", "gray", "right"),
    Claim(_XOR, _GUPTA_2011, "bowl", "xor4", "gray", "right"),
    Claim(_HIERARCHY, _ZUO, "dark-and-bright", "1,16@4", "13,16@4", "right"),
    Claim(_NUMBERS, _ZUO, "dark-and-bright", "13,16@4", "15,16@4+heterodyne", "right"),
    Claim(_GAMMA_3, _LIU, "gamma", "gray+16@4", "gray+16@3", "error"),
    Claim(_GAMMA_4, _LIU, "gamma", "gray+16@5", "gray+16@4", "error"),
)


@dataclass(frozen=True)
class Finding:
    """A claim, judged.

    Parameters
    ----------
    claim : Claim
    better, worse : float
        What was measured of either, a share or mm.
    reproduced : bool
    """

    claim: Claim
    better: float
    worse: float
    reproduced: bool

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        one = self.claim
        names = {"text": one.text, "source": one.source, "scene": one.scene, "by": one.by}
        sets = {"better": [one.better, self.better], "worse": [one.worse, self.worse]}
        return names | sets | {"reproduced": self.reproduced}


@dataclass(frozen=True, eq=False)
class Suite:
    """All sets on all scenes.

    Parameters
    ----------
    outcomes : tuple of Outcome
        Scene by scene, in the order of the sets.
    findings : tuple of Finding
    repeats, seed : int
    equal : {"frames", "photons"} or None
    parameters : mapping
        For the provenance.
    """

    outcomes: tuple[Outcome, ...]
    findings: tuple[Finding, ...]
    repeats: int
    seed: int
    equal: Equal | None
    parameters: Mapping[str, Any]

    __repr__ = brief

    @property
    def scenes(self) -> tuple[str, ...]:
        """The scenes, in order."""
        return tuple(dict.fromkeys(one.scene for one in self.outcomes))

    @property
    def sets(self) -> tuple[str, ...]:
        """The sets, in order."""
        return tuple(dict.fromkeys(one.name for one in self.outcomes))

    def __getitem__(self, key: tuple[str, str]) -> Outcome:
        """Return the outcome of (scene, set)."""
        return next(one for one in self.outcomes if (one.scene, one.name) == key)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "repeats": self.repeats,
            "seed": self.seed,
            "equal": self.equal,
            "outcomes": [one.to_dict() for one in self.outcomes],
            "findings": [one.to_dict() for one in self.findings],
        }


@checked
def compare_suite(
    sets: Sequence[PatternSource | PatternSet] = SETS,
    scenes: Sequence[str] = SCENES,
    *,
    repeats: types.Repeats = 5,
    equal: Equal | None = None,
    seed: types.Seed = 0,
    preview: bool = False,
    allow_modules: bool = False,
    changes: Changes = (),
    on_progress: Progress | None = None,
) -> Suite:
    """Scan every scene with every set.

    Parameters
    ----------
    sets : sequence of str, PatternSet and whatever else is a pattern set
        As for :func:`~slbench.bench.compare.compare.compare`.
    scenes : sequence of str
        Names or files of scenes.
    repeats : int
        Scans a set and scene, at least 2.
    equal : {"frames", "photons"} or None
        What all sets are given the same of.
    seed : int
    preview : bool
        Few pixels and samples.
    allow_modules : bool
        Run the Python modules that sets name: code of their authors.
    changes : sequence of str, or mapping
        Of every scene (:mod:`slbench.scene.changes`).
    on_progress : callable, optional
        Called with the name of the scene and its finished fraction.

    Returns
    -------
    Suite

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        For a scene or set that cannot be read, before any light is traced.
    """
    from slbench.simulate.render.groundtruth import ground_truth

    report = on_progress or (lambda stage, fraction: None)
    made = read_changes(changes)
    loaded = [load_scene(name, preview=preview, changes=made) for name in scenes]
    chosen = [
        pattern_sets(sets, one, shifts=own_shifts(one), equal=equal, allow_modules=allow_modules)
        for one in loaded
    ]
    outcomes: list[Outcome] = []
    for scene, given in zip(loaded, chosen, strict=True):
        report(scene.name, 0.0)
        along = dict.fromkeys(axis for one in given for axis in one.sequence.variations)
        transports = traced(scene, tuple(along), seed=seed)
        truth = ground_truth(scene.objects, scene.rig)
        for k, one in enumerate(given):
            result, why = None, ""
            try:
                result = compare(
                    scene,
                    [one],
                    repeats=repeats,
                    seed=seed,
                    transports=transports,
                    truth=truth,
                ).sets[0]
            except NothingToCompare as error:
                why = str(error.got)
            outcomes.append(Outcome(scene.name, one.name, result, why))
            report(scene.name, (k + 1) / len(given))
    found = {(one.scene, one.name): one for one in outcomes}
    findings = [
        judged(claim, found[claim.scene, claim.better], found[claim.scene, claim.worse])
        for claim in CLAIMS
        if {(claim.scene, claim.better), (claim.scene, claim.worse)} <= set(found)
    ]
    parameters = {
        "scenes": {one.name: one.specification for one in loaded},
        "sets": {one.name: one.sequence.to_dict() for one in chosen[0]},
        "repeats": repeats,
        "equal": equal,
    }
    return Suite(tuple(outcomes), tuple(findings), repeats, seed, equal, parameters)


def judged(claim: Claim, better: Outcome, worse: Outcome) -> Finding:
    """Judge a claim by what was measured of its two sets.

    A distance is better where its 95 % interval lies below the other's; a share where it is larger
    by more than one in a hundred pixels.
    """
    if claim.by == "right":
        return Finding(claim, better.right, worse.right, better.right > worse.right + 0.01)
    one, two = better.result, worse.result
    if one is None or two is None:
        nan = float("nan")
        values = [nan if r is None else r.error_median_mm for r in (one, two)]
        return Finding(claim, values[0], values[1], two is None and one is not None)
    apart = one.error_ci95_mm[1] < two.error_ci95_mm[0]
    return Finding(claim, one.error_median_mm, two.error_median_mm, apart)
