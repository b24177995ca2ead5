"""Measurands: one number of one feature of a scene, by the name that claims have for it."""

from __future__ import annotations

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
        return self._deviation in FEATURE_FIELDS[self.feature.kind] and "error" in self.field

    @property
    def of_nominal(self) -> bool:
        """Whether the certified size is taken from it."""
        return self._deviation in FEATURE_FIELDS[self.feature.kind]

    @property
    def nominal_mm(self) -> float:
        """What is taken from a measured size to make it; zero for what is no deviation."""
        return (self.feature.nominal_mm or 0.0) if self.of_nominal else 0.0

    @property
    def _deviation(self) -> str:
        return (
            self.field.replace("error_mm", "deviation_mm")
            if self.field.endswith(("error_mm", "deviation_mm"))
            else ""
        )

    def signed(self, scores: Iterable[Any]) -> float:
        """Return it by the scores of its object's features, a deviation for its magnitude."""
        name = self._deviation if self.magnitude else self.field
        for one in scores:
            kind = type(one).__name__.removesuffix("Score").lower()
            if (kind, one.name) == (self.feature.kind, self.feature.name):
                return float(getattr(one, name))
        return float("nan")


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
