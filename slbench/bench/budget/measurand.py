"""Measurands: one number of one feature of a scene, by the name that claims have for it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from slbench.bench.claims.quantities import (
    FEATURE_FIELDS,
    Feature,
    features_of,
    owners_of,
    resolve,
    unit,
    unknown,
)
from slbench.core.errors import InputError
from slbench.scene.model import Scene

#: Names of how far something is off: error_mm, radius_deviation_mm, angle_error_deg.
_OFF = re.compile(r"(.*?)(?:error|deviation)_(mm|deg)")


@dataclass(frozen=True)
class Measurand:
    """A number of a feature.

    Parameters
    ----------
    text : str
        As it was asked for.
    feature : Feature
    item : int
        Index of the object that has it.
    field : str
        Of the feature's score.
    """

    text: str
    feature: Feature
    item: int
    field: str

    @property
    def unit(self) -> str:
        """Unit of the number, ``""`` for a pure one."""
        return unit(self.field)

    @property
    def magnitude(self) -> bool:
        """Whether it is the magnitude of a deviation."""
        return self.of_nominal and "error" in self.field

    @property
    def of_nominal(self) -> bool:
        """Whether the certified size is taken from it."""
        return self._named("deviation") in FEATURE_FIELDS[self.feature.kind]

    def _named(self, word: str) -> str:
        """Return the field with another word for how far it is off; empty for no such field."""
        match = _OFF.fullmatch(self.field)
        return "" if match is None else f"{match[1]}{word}_{match[2]}"

    def signed(self, scores: Iterable[Any]) -> tuple[float, float]:
        """Return it by the scores of its object's features, and the nominal size taken from it.

        Of a magnitude, that is the deviation; where none is taken from it, zero.
        """
        for one in scores:
            kind = type(one).__name__.removesuffix("Score").lower()
            if (kind, one.name) != (self.feature.kind, self.feature.name):
                continue
            if not self.of_nominal:
                return float(getattr(one, self.field)), 0.0
            deviation = float(getattr(one, self._named("deviation")))
            # step: measured_mm; sphere: radius_mm; cone: angle_deg
            size = self._named("measured")
            if not hasattr(one, size):
                size = self._named("").replace("__", "_")
            return deviation, float(getattr(one, size)) - deviation
        return float("nan"), 0.0


def measurand_of(text: str, scene: Scene, where: str = "measurand") -> Measurand:
    """Return the measurand that a quantity of a scene is.

    Raises
    ------
    InputError
        For what is no number of one feature, with the nearest names.
    """
    names = resolve(text, scene, where)
    if len(names) > 1:
        raise InputError(where, f"one feature, such as {names[0]}", repr(text))
    for feature in features_of(scene):
        label, dot, field = names[0].partition("].")
        if dot and label == f"{feature.kind}[{feature.label}":
            return Measurand(text, feature, owners_of(scene).index(feature.owner), field)
    known = [f"{f.kind}[{f.label}].{n}" for f in features_of(scene) for n in f.fields]
    raise unknown(where, text, known)
