"""The names of what can be claimed, and how to read them off a scan.

A quantity of a scan is a number of its score: ``rms_mm``, ``smooth_rms_px.u``,
``step[2.5].error_mm``.  Features are chosen by nominal size (``step[2.5]``), by name
(``plane[reference]``) or by object and either (``sphere[ball-bar/left]``); a second object of
one name is ``name#2``; ``[*]`` is the largest value over all features of a kind.  A quantity of a
comparison names its pattern set: ``set[1,10,50].std_median_mm``.  ``docs/how-to/claims.md``
lists all; further quantities of a scan are rows of :data:`claim_quantities`.

*Errors have a sign only where they are called deviations.*  ``deviation_mm`` is measured minus
nominal; ``error_mm`` is its magnitude, scan by scan, so that an upper bound on it means what it
says: random errors do not cancel in its mean.
"""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from slbench.bench.compare.comparison import SetResult
from slbench.core.errors import InputError
from slbench.core.registry import Registry
from slbench.objects import REFERENCE, SurfaceFeature
from slbench.patterns.sequence import compact
from slbench.scene.model import Scene
from slbench.score.fusion import FusionScore, Sharpness
from slbench.score.points import Score
from slbench.score.values import (
    CircleScore,
    ConeScore,
    CylinderScore,
    FeatureScore,
    PlaneScore,
    SpacingScore,
    SphereScore,
    StepScore,
)
from slbench.simulate.scan import Scan


@dataclass(frozen=True)
class Quantity:
    """A number read off a scan, beside those of its score.

    Parameters
    ----------
    value : callable
        ``value(scan)`` returns the number; NaN where it was not measured.
    unit : str
        Unit that a bound has too; ``""`` for a pure number.
    """

    value: Callable[[Scan], float]
    unit: str = ""


#: Further quantities of a scan by name, e.g. ``"slope_deg"``.  To add one, write a
#: :class:`Quantity` and name it here; outside slbench the entry-point group
#: ``slbench.claim_quantities``, or a module that a claims file names.
claim_quantities: Registry[Quantity] = Registry(
    "claim quantity",
    "slbench.claim_quantities",
    {
        "floor_rms_px": "slbench.bench.claims.quantities:FLOOR",
        "monte_carlo_rms_px": "slbench.bench.claims.quantities:SAMPLING",
    },
    base="slbench.bench.claims.quantities:Quantity",
)
#: The renderer's own error.
FLOOR = Quantity(lambda scan: scan.floor_rms_px, "px")
#: The part of it that more samples would take away.
SAMPLING = Quantity(lambda scan: scan.monte_carlo_rms_px, "px")

#: What :mod:`slbench.bench.claims.speed` measures.
SPEED_FIELDS = ("patterns36_per_render", "pattern_per_render")

_NUMBERS = ("int", "float")
#: What a comparison says of each pattern set, and of each step of the scene.
SET_FIELDS = tuple(f.name for f in fields(SetResult) if f.type in _NUMBERS)
_SET_STEP_FIELDS = ("measured_mm", "deviation_mm", "std_mm")
_SCALARS = tuple(f.name for f in fields(Score) if f.type in _NUMBERS)
_BY_AXIS = ("smooth_bias_px", "smooth_rms_px")
_SIZES = ("nominal_mm", "nominal_radius_mm", "nominal_diameter_mm", "nominal_angle_deg")
_DIMENSION = ("measured", "error", "deviation", "uncertainty")
#: Of each kind of feature: the numbers of its score, and how far it is from nominal.
FEATURE_FIELDS: dict[str, tuple[str, ...]] = {
    kind: (
        *(f.name for f in fields(score) if f.type in _NUMBERS and f.name not in _SIZES),
        *deviations,
    )
    for kind, score, deviations in (
        ("step", StepScore, ("error_mm", "deviation_mm")),
        ("plane", PlaneScore, ()),
        ("sphere", SphereScore, ("radius_error_mm", "radius_deviation_mm")),
        ("spacing", SpacingScore, ("error_mm", "deviation_mm")),
        ("cylinder", CylinderScore, ("diameter_error_mm", "diameter_deviation_mm")),
        ("cone", ConeScore, ("angle_error_deg", "angle_deviation_deg")),
        ("circle", CircleScore, ("diameter_error_mm", "diameter_deviation_mm")),
    )
}
FEATURE_FIELDS["dimension"] = tuple(f"{name}_{u}" for u in ("mm", "deg") for name in _DIMENSION)
#: Kinds that a part's file declares and gives a name that says more than a size.
_NAMED = ("cylinder", "cone", "circle", "dimension")
#: Those of which the largest is the worst: what ``[*]`` may be asked for.
_LARGEST = (
    *("error_mm", "flatness_mm", "form_mm", "std_mm", "uncertainty_mm"),
    *("error_deg", "uncertainty_deg"),
)
_FUSED = tuple(f.name for f in fields(FusionScore) if f.name != "finest")
_SHARPNESS = tuple(f.name for f in fields(Sharpness))

_FEATURE = re.compile(r"(\w+)\[([^\[\]]+)\]\.(\w+)")
_SET = re.compile(r"set\[([^\[\]]+)\]\.(\w+|step\[([^\[\]]+)\]\.(\w+))")
_UNITS = {"mm": "mm", "px": "px", "s": "s", "seconds": "s", "rms": "rad", "deg": "deg"}


@dataclass(frozen=True)
class Feature:
    """A feature that a scene has: its kind, the label of its object, its name and its size, mm."""

    kind: str
    owner: str
    name: str
    nominal_mm: float | None
    #: Unit of a dimension, which is that of all its numbers.
    unit: str = ""

    @property
    def fields(self) -> tuple[str, ...]:
        """The numbers of its score."""
        every = FEATURE_FIELDS[self.kind]
        return tuple(name for name in every if not self.unit or name.endswith(f"_{self.unit}"))

    @property
    def label(self) -> str:
        """Object and name, which no other feature of the kind has together."""
        return f"{self.owner}/{self.name}"

    def matches(self, selector: str) -> bool:
        """Return whether a selector names this feature."""
        owner, slash, last = selector.rpartition("/")
        if selector in ("*", self.label, self.name):
            return True
        if slash and owner != self.owner:
            return False
        try:
            size = float(last)
        except ValueError:
            return bool(slash) and last == self.name
        return self.nominal_mm is not None and abs(size - self.nominal_mm) < 1e-9


def family(text: str) -> str:
    """Return what measures a quantity: ``"score"``, ``"set"`` or ``"speed"``."""
    head = re.split(r"[.\[]", text, maxsplit=1)[0].strip()
    return head if head in ("set", "speed") else "score"


def unit(text: str) -> str:
    """Return the unit that a quantity's name carries, ``""`` for a pure number."""
    if text in claim_quantities:
        return claim_quantities.get(text).unit
    words = text.rpartition("]")[2].split(".")
    last = words[-2] if words[-1] in ("u", "v") and len(words) > 1 else words[-1]
    return "" if last == "intensity_rms" else _UNITS.get(last.rpartition("_")[2], "")


def pattern_set(text: str, where: str) -> tuple[str, str]:
    """Split a quantity of a comparison into the text of its pattern set and its field.

    Raises
    ------
    InputError
        If it is not of the form ``set[1,10,50].rms_mm`` with a field of :data:`SET_FIELDS`.
    """
    match = _SET.fullmatch(text)
    if match is None:
        raise InputError(where, "a quantity such as set[1,10,50].std_median_mm", repr(text))
    patterns, name = compact(match[1]), match[2]
    steps = [f"step[{match[3] or '2.5'}].{field}" for field in _SET_STEP_FIELDS]
    if name not in SET_FIELDS and name not in steps:
        raise unknown(where, text, [f"set[{patterns}].{k}" for k in (*SET_FIELDS, *steps)])
    return patterns, name


def set_value(result: SetResult, name: str) -> float:
    """Return a field of a pattern set, by the name that :func:`pattern_set` gave.

    A step is chosen by its nominal height; NaN unless it was measured.
    """
    if name in SET_FIELDS:
        return float(getattr(result, name))
    height = float(name[len("step[") : name.index("]")])
    steps = [step for step in result.steps if abs(step.nominal_mm - height) < 1e-9]
    if len(steps) != 1:
        return float("nan")
    return float(getattr(steps[0], name.rpartition(".")[2]))


def check_set(text: str, scene: Scene, where: str) -> None:
    """Check that a quantity of a comparison is one of this scene.

    Raises
    ------
    InputError
        For a step that the scene does not have, or not once.
    """
    _, name = pattern_set(text, where)
    if name in SET_FIELDS:
        return
    selector = name[len("step[") : name.index("]")]
    heights = [f.nominal_mm for f in features_of(scene) if f.kind == "step"]
    try:
        height = float(selector)
    except ValueError:
        height = float("nan")
    given = [h for h in heights if h is not None and abs(h - height) < 1e-9]
    if len(given) != 1:
        known = ", ".join(f"{h:.12g}" for h in heights if h is not None) or "none"
        raise InputError(where, f"the height of one step of the scene ({known})", repr(text))


def unknown(where: str, text: str, known: Iterable[str]) -> InputError:
    """Return the error for a name that is not known, with those that are nearest to it."""
    names = list(known)
    near = difflib.get_close_matches(text, names, n=4, cutoff=0.5) or names[:8]
    return InputError(where, f"a quantity that there is, such as {', '.join(near)}", repr(text))


def owners_of(scene: Scene) -> tuple[str, ...]:
    """Return what quantities call the objects of a scene, in their order."""
    seen: dict[str, int] = {}
    found = []
    for item in scene.objects:
        name = item.artefact.name
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name}#{seen[name]}")
    return tuple(found)


def features_of(scene: Scene) -> tuple[Feature, ...]:
    """Return the features that the artefacts of a scene have, measured or not."""
    found: list[Feature] = []
    for item, owner in zip(scene.objects, owners_of(scene), strict=True):
        faces = item.artefact.planes
        found += [Feature("plane", owner, face.name, None) for face in faces]
        if any(face.name == REFERENCE for face in faces):
            found += [
                Feature("step", owner, face.name, face.height_mm)
                for face in faces
                if face.name != REFERENCE
            ]
        balls = item.artefact.spheres
        found += [Feature("sphere", owner, ball.name, ball.radius_mm) for ball in balls]
        for a, b in itertools.combinations(balls, 2):
            distance = float(np.linalg.norm(np.subtract(a.centre_mm, b.centre_mm)))
            found.append(Feature("spacing", owner, f"{a.name} to {b.name}", distance))
        for surface in item.artefact.declared:
            found.append(Feature(surface.kind, owner, surface.name, _size(surface)))
        for dimension in item.artefact.dimensions:
            size = dimension.nominal if dimension.unit == "mm" and not dimension.is_zone else None
            found.append(Feature("dimension", owner, dimension.name, size, dimension.unit))
    return tuple(found)


def _size(surface: SurfaceFeature) -> float | None:
    """Return the size that a declared feature is chosen by: a ball's radius, other diameters."""
    if surface.kind in ("plane", "cone"):
        return None
    # The mesh has it to rounding; people write what it is meant to be.
    radius = round(surface.element.radius, 5)
    return radius if surface.kind == "sphere" else 2.0 * radius


def quantities_of(scene: Scene) -> list[str]:
    """Return every quantity that a scan of the scene has, each by its shortest clear name."""
    names = [*_SCALARS, *claim_quantities]
    names += [f"{name}.{axis}" for name in _BY_AXIS for axis in scene.sequence.axes]
    if scene.focus is not None:
        names += [f"fusion.{part}.{name}" for part in _FUSED for name in _SHARPNESS]
    features = features_of(scene)
    for feature in features:
        alike = [f for f in features if f.kind == feature.kind]
        candidates = [feature.name, feature.label]
        if feature.nominal_mm is not None and feature.kind not in _NAMED:
            candidates.insert(0, f"{feature.nominal_mm:g}")
        selector = next(
            (s for s in candidates if [f for f in alike if f.matches(s)] == [feature]),
            feature.label,
        )
        names += [f"{feature.kind}[{selector}].{name}" for name in feature.fields]
    return names


def resolve(text: str, scene: Scene, where: str) -> tuple[str, ...]:
    """Return the canonical names that a quantity stands for; more than one for ``[*]``.

    Parameters
    ----------
    text : str
        A quantity of a scan.
    scene : Scene
    where : str
        What to call it in an error.

    Raises
    ------
    InputError
        For a quantity that a scan of the scene does not have, with the nearest ones, and for a
        selector that several features answer to.
    """
    known = quantities_of(scene)
    if text in known and "[" not in text:
        return (text,)
    match = _FEATURE.fullmatch(text)
    if match is None or match[1] not in FEATURE_FIELDS:
        raise unknown(where, text, known)
    kind, selector, name = match.groups()
    chosen = [f for f in features_of(scene) if f.kind == kind and f.matches(selector.strip())]
    if selector == "*":  # lengths or angles
        chosen = [f for f in chosen if name in f.fields]
    if not chosen or any(name not in f.fields for f in chosen):
        raise unknown(where, text, known)
    if selector == "*":
        if not name.endswith(_LARGEST):
            raise InputError(where, f"one of {', '.join(_LARGEST)} with [*]", repr(text))
    elif len(chosen) > 1:
        labels = ", ".join(f"{kind}[{f.label}]" for f in chosen)
        raise InputError(where, f"one feature: {labels}, or {kind}[*]", repr(text))
    return tuple(f"{kind}[{f.label}].{name}" for f in chosen)


def score_values(scan: Scan, further: Iterable[str] = ()) -> dict[str, float]:
    """Return the numbers of a scan by canonical name; NaN for what was not measured.

    Parameters
    ----------
    scan : Scan
    further : iterable of str
        Names of :data:`claim_quantities`, beside all numbers of the score.

    Raises
    ------
    InputError
        Naming one of these that fails.
    """
    values = values_of_score(scan.score, scan.scene)
    for name in further:
        try:
            values[name] = float(claim_quantities.get(name).value(scan))
        except Exception as error:  # foreign code may fail in any way
            where = f"claim quantity {name!r} of {claim_quantities.origin(name)}"
            raise InputError(where, "a number", repr(error)) from error
    if scan.fusion is not None:
        for part in _FUSED:
            sharpness = vars(getattr(scan.fusion, part))
            values |= {f"fusion.{part}.{name}": float(v) for name, v in sharpness.items()}
    return values


def values_of_score(score: Score, scene: Scene) -> dict[str, float]:
    """Return the numbers of a score by canonical name; NaN for what was not measured.

    Parameters
    ----------
    score : Score
    scene : Scene
        That says which features there are.
    """
    values = {name: float(getattr(score, name)) for name in _SCALARS}
    for name in _BY_AXIS:
        values |= {f"{name}.{axis}": v for axis, v in getattr(score, name).items()}
    for feature, item in scored_features(score, scene):
        for name in feature.fields:
            key = f"{feature.kind}[{feature.label}].{name}"
            values[key] = float(getattr(item, name, float("nan")))
    return values


def scored_features(score: Score, scene: Scene) -> Iterator[tuple[Feature, FeatureScore | None]]:
    """Yield the features of a scene, each with what a score has of it; None for nothing."""
    features = features_of(scene)
    for feature in features:
        same = [f for f in features if _plain(f) == _plain(feature)]
        scored = getattr(score, f"{feature.kind}s")
        items = [i for i in scored if (i.object, i.name) == _plain(feature)[1:]]
        # Of several objects of one name, a score does not say which one it missed.
        yield feature, items[same.index(feature)] if len(items) == len(same) else None


def _plain(feature: Feature) -> tuple[str, str, str]:
    """Kind, object's name without its number, and name."""
    return feature.kind, feature.owner.partition("#")[0], feature.name
