"""Repeated measurements that claims share.

Every repeat of a scan is a scan of its own: light traced with its own samples, frames with their
own noise, so that repeats are independent and their interval honest.  The detector keeps its
fixed pattern: a claim is about this detector, not about all of its make.  Claims with the same
scene and settings read their quantities off the same scans, however many claims there are, and
repeat i has the same seed in every pool: quantities of different settings are compared pair by
pair (common random numbers), which is valid and sharper than comparing two independent means.

A repeat of a comparison is a whole comparison (:mod:`slbench.bench.compare.compare`) of the sets
that the claim names, ``scans`` scans of each; claims about the same sets share it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.bench.claims.file import Claim
from slbench.bench.claims.places import Displacement, drawn, placed, planned
from slbench.bench.claims.quantities import (
    check_set,
    claim_quantities,
    pattern_set,
    resolve,
    score_values,
    set_value,
)
from slbench.bench.claims.settings import Settings
from slbench.bench.claims.speed import speed_ratios
from slbench.bench.compare.compare import NothingToCompare, compare, own_shifts
from slbench.bench.compare.comparison import SetResult
from slbench.bench.compare.sets import PatternSet, pattern_sets
from slbench.core import resources
from slbench.core.errors import InputError, located
from slbench.core.io import plain
from slbench.core.random import tagged_seed
from slbench.core.show.display import length
from slbench.objects.registry import artefacts
from slbench.patterns import PatternSequence
from slbench.patterns.given import in_words
from slbench.scene.file import load_scene
from slbench.scene.model import USUAL_PATTERNS, Scene, SceneObject
from slbench.simulate.floors import more_samples
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan, score_scan

Array = NDArray[np.float64]
Row = dict[str, Any]

_MESH = ("vertices", "faces")
_FLOORS = ("floor_rms_px", "monte_carlo_rms_px")


@dataclass(frozen=True)
class Floor:
    """What is left of a claim's scans without noise, means over the repeats.

    Parameters
    ----------
    of : str
        Scene and, in a comparison, the pattern set.
    whole : float
        Error without the detector.
    monte_carlo : float
        The part of it that more samples would take away; NaN where it is not known.
    error : float
        With the detector.
    unit : {"px", "mm"}
        Panel pixels, RMS over smooth surface; or mm, the median over the pixels of a comparison.
    """

    of: str
    whole: float
    monte_carlo: float
    error: float
    unit: Literal["px", "mm"]

    def text(self) -> str:
        """Return floor and Monte Carlo part in a line."""
        whole, sampling = self._length(self.whole), self._length(self.monte_carlo)
        return f"{self.of}: floor without noise {whole}, {sampling} by sampling"

    def _length(self, value: float) -> str:
        return length(value) if self.unit == "mm" else f"{value:.4f} px"

    def doubt(self, samples: int) -> str | None:
        """Question a number of samples whose Monte Carlo error is seen in the scans."""
        more = more_samples(samples, self.error, self.monte_carlo)
        if more is None:
            return None
        sampling, error = self._length(self.monte_carlo), self._length(self.error)
        return (
            f"sampling makes {sampling} of the {error} error: {more} samples a pixel instead of "
            f"{samples} would change it (samples in the claim, render.samples in the scene)"
        )


class Pools:
    """Measurements by settings, made when they are asked for.

    Parameters
    ----------
    seed : int
        Of all light and noise.
    on_progress : callable, optional
        Called with the name of the scene and the finished fraction of its repeats.
    allow_modules : bool
        Run the Python modules that scenes name.
    """

    def __init__(
        self,
        seed: int = 0,
        on_progress: Callable[[str, float], None] | None = None,
        allow_modules: bool = False,
    ) -> None:
        self.seed = seed
        self._allow_modules = allow_modules
        self._on_progress = on_progress
        self._scenes: dict[Settings, Scene] = {}
        self._rows: dict[Hashable, list[Row]] = {}
        # Of claim_quantities: what floors are made of, and by the claims that were checked.
        self._further: set[str] = set(_FLOORS)

    def scene(self, settings: Settings) -> Scene:
        """Return the scene with its settings, loaded once."""
        if settings not in self._scenes:
            self._scenes[settings] = _load(settings, self._allow_modules)
        return self._scenes[settings]

    def check(self, claim: Claim) -> None:
        """Check that the claim's scenes can be loaded and have its quantities; nothing is measured.

        Raises
        ------
        InputError
            Naming the claim.
        """
        where = f'claim "{claim.name}"'
        with located(where):
            for settings in {claim.settings, claim.versus}:
                self.scene(settings)
            if claim.family == "set":
                self._sets(claim)
            for settings in {claim.settings, claim.versus} if claim.several else ():
                self.places(claim, self.scene(settings))
        for quantity in claim.quantities if claim.family == "set" else ():
            check_set(quantity, self.scene(claim.settings), f"{where}: quantity")
        if claim.family == "score":
            self._further.update(q for q in claim.quantities if q in claim_quantities)
            resolve(claim.quantity, self.scene(claim.settings), f"{where}: quantity")
            for quantity in claim.quantities[1:]:
                resolve(quantity, self.scene(claim.versus), f"{where}: bound")

    def _sets(self, claim: Claim) -> list[PatternSet]:
        """Return the sets of a claim, called as it calls them."""
        scene, settings = self.scene(claim.settings), claim.settings
        found = pattern_sets(
            claim.sets,
            scene,
            shifts=settings.shifts or own_shifts(scene),
            equal=claim.equal,
            folder=settings.folder,
            allow_modules=self._allow_modules,
        )
        return [replace(one, name=text) for one, text in zip(found, claim.sets, strict=True)]

    def fingerprint(self, settings: Settings) -> str:
        """Return a digest of a scene: of its file and of what that refers to.

        The file is merged into what it extends.  Patterns that are no short text count by what they
        show.  Objects count by kind and parameters wherever
        these are written, and those of mesh files by their vertices and faces.
        """
        scene = self.scene(settings)
        content = {"file": scene.specification, "objects": [_made_of(i) for i in scene.objects]}
        own = scene.specification.get("patterns", {}).get("sequence", USUAL_PATTERNS)
        if not in_words(settings.patterns or own):
            content["patterns"] = _shown(scene.sequence)
        rig = scene.specification.get("rig", {}).get("file")
        if rig is not None:
            content["rig"] = _digest(resources.inside(settings.scene.parent, rig).read_bytes())
        if scene.calibration is not None:
            content["calibration"] = scene.calibration.digest
        return _digest(json.dumps(plain(content, keep_non_finite=True), sort_keys=True).encode())

    def measure(self, claim: Claim) -> tuple[Array, list[Array]]:
        """Measure a claim's quantity and those of its limits.

        Returns
        -------
        values : (repeats,) or (places, repeats) float
            NaN where a scan did not give the quantity.
        others : list of as many float
            One a limit; NaN where the limit is a number.
        """
        values = self._values(claim, claim.quantity, claim.settings)
        others = [
            np.full(values.shape, np.nan)
            if limit.quantity is None
            else self._values(claim, limit.quantity, claim.versus)
            for limit in claim.limits
        ]
        return values, others

    def floor(self, claim: Claim) -> Floor | None:
        """Return what a claim's scans leave without noise; None for speed and where nothing is."""
        scene = self.scene(claim.settings)
        of = scene.name
        if claim.family == "speed":
            return None
        if claim.family == "set":
            name, _ = pattern_set(claim.quantity, claim.name)
            of += f", {{{name}}}"
            found = [row[name] for row in self._comparisons(claim, scene) if row]
            numbers = [
                (s.floor_median_mm, s.monte_carlo_median_mm, s.error_median_mm) for s in found
            ]
        else:
            scans = [row for own in self._scans(claim, claim.settings) for row in own]
            errors = [f"smooth_rms_px.{axis}" for axis in scene.sequence.axes]
            numbers = [
                (
                    *(row[key] for key in _FLOORS),
                    float(np.sqrt(np.mean([row[e] ** 2 for e in errors]))),
                )
                for row in scans
            ]
        if not numbers:
            return None
        whole, sampling, error = np.mean(numbers, axis=0).tolist()
        if np.isnan(whole):
            return None
        return Floor(of, whole, sampling, error, "mm" if claim.family == "set" else "px")

    def _values(self, claim: Claim, quantity: str, settings: Settings) -> Array:
        scene = self.scene(settings)
        if claim.family == "set":
            name, field = pattern_set(quantity, claim.name)
            rows = self._comparisons(claim, scene)
            return np.array([set_value(row[name], field) if row else np.nan for row in rows])
        if claim.family == "speed":
            rows = self._repeats(
                ("speed", settings),
                claim.repeats,
                scene.name,
                lambda seed: speed_ratios(scene, seed),
            )
            return np.array([row[quantity.removeprefix("speed.")] for row in rows])
        names = resolve(quantity, scene, f'claim "{claim.name}"')
        scans = self._scans(claim, settings)
        # The largest of a family of features; NaN if one of them was not measured.
        values = np.array([[[row[name] for name in names] for row in own] for own in scans])
        found = values.max(axis=2)
        return found if claim.several else found[0]

    def _scans(self, claim: Claim, settings: Settings) -> list[list[Row]]:
        """Return the numbers of a claim's scans, by place and repeat.

        Where every repeat measures at all of several places, light is traced once a place.
        """
        scene, further = self.scene(settings), frozenset(self._further)

        def one(where: Scene, seed: int, calibration: int, lights: Lights | None) -> Row:
            # Scored here: of all repeats together it is told where sampling is seen.
            made = scan(
                where,
                seed=seed,
                noise=settings.noise,
                score=False,
                lights=lights,
                calibration_seed=calibration,
            )
            return score_values(score_scan(made), further)

        def at_random(seed: int) -> Row:
            return one(placed(scene, drawn(scene, seed)), seed, seed, None)

        if not claim.several:
            measure = at_random if claim.places == "random" else lambda s: one(scene, s, s, None)
            key = (settings, further, claim.places)
            return [self._repeats(key, claim.repeats, scene.name, measure)]
        rows = []
        for k, place in enumerate(self.places(claim, scene)):
            rows.append(self._at_place(settings, further, claim.repeats, place, k, one))
        return rows

    def _at_place(
        self,
        settings: Settings,
        further: frozenset[str],
        repeats: int,
        place: Displacement,
        number: int,
        one: Callable[[Scene, int, int, Lights | None], Row],
    ) -> list[Row]:
        """Return the numbers of scans at a place, repeat by repeat, all in the same light."""
        scene = self.scene(settings)
        here = placed(scene, place)
        # With focus settings there is the light of a perfect stack beside theirs.
        lights = Lights(tagged_seed(self.seed, number), kept=2)
        return self._repeats(
            (settings, further, place),
            repeats,
            f"{scene.name}, place {number + 1}",
            # One calibration at all places of a repeat, noise of its own at each.
            lambda seed: one(here, tagged_seed(seed, number), seed, lights),
        )

    @staticmethod
    def places(claim: Claim, scene: Scene) -> tuple[Displacement, ...]:
        """Return the places of a claim that has several."""
        assert claim.places is not None
        assert claim.places != "random"
        if isinstance(claim.places, int):
            return planned(scene, claim.places)
        return claim.places

    def _comparisons(self, claim: Claim, scene: Scene) -> list[dict[str, SetResult]]:
        """Return the sets' results, repeat by repeat; none where nothing can be compared."""
        settings, sets = claim.settings, self._sets(claim)

        def one(seed: int) -> dict[str, SetResult]:
            try:
                found = compare(
                    scene,
                    sets,
                    repeats=claim.scans,
                    equal=claim.equal,
                    seed=seed,
                    question=False,
                )
            except NothingToCompare:
                return {}
            # Without the maps, which are large.
            none = np.empty((0, 0))
            return {
                result.name: replace(
                    result, std_mm=none, std_z_mm=none, error_mm=none, shift_mm=none
                )
                for result in found.sets
            }

        key = ("set", settings, claim.sets, claim.scans, claim.equal)
        return self._repeats(key, claim.repeats, scene.name, one)

    def _repeats(
        self, key: Hashable, count: int, name: str, measure: Callable[[int], Row]
    ) -> list[Row]:
        """Return `count` repeats of a pool, those that are missing made now."""
        rows = self._rows.setdefault(key, [])
        while len(rows) < count:
            rows.append(measure(tagged_seed(self.seed, len(rows))))
            if self._on_progress:
                self._on_progress(name, len(rows) / count)
        return rows[:count]


def _made_of(item: SceneObject) -> dict[str, Any]:
    """Return what an artefact is built from; wherever its files stand."""
    artefact = item.artefact
    files = artefacts.get(artefact.kind).files
    values = {key: value for key, value in artefact.parameters.items() if key not in files}
    if files:
        values |= {part: _digest(getattr(artefact.mesh, part).tobytes()) for part in _MESH}
    made = {"kind": artefact.kind, "parameters": values}
    looks = [item.material_of(part).bsdf for part in artefact.parts]
    if any(bsdf.textures for bsdf in looks):  # by what pictures show, wherever they stand
        made["looks"] = [repr(bsdf) for bsdf in looks]
    corners = {part: getattr(artefact.mesh, part) for part in ("uv", "albedo", "normals")}
    return made | {k: _digest(v.tobytes()) for k, v in corners.items() if v is not None}


def _shown(sequence: PatternSequence) -> str:
    """Return a digest of what a sequence's frames show."""
    shown = (sequence.shown(sequence.frames_along(one), one) for one in sequence.variations)
    return _digest(b"".join(one.tobytes() for one in shown))


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _load(settings: Settings, allow_modules: bool) -> Scene:
    """Load a scene and change what the settings change."""
    scene = load_scene(
        settings.scene,
        preview=settings.preview,
        allow_modules=allow_modules,
        changes=settings.changes,
        measured_with=settings.measured_with,
        align=settings.align,
    )
    if any(value is not None for value in (settings.patterns, settings.shifts, settings.axes)):
        scene = scene.with_changed_patterns(
            settings.patterns,
            settings.shifts,
            settings.axes,
            folder=settings.folder,
            allow_modules=allow_modules,
        )
    if settings.redraw:
        made = scene.calibration
        if made is None or made.covariance is None:
            expected = "a calibration with std or covariance, in the scene or in measured_with"
            raise InputError(f"scene {scene.name}: redraw", expected, "none to draw from")
        scene = replace(scene, calibration=replace(made, redraw=True))
    return scene if settings.samples is None else replace(scene, samples=settings.samples)
