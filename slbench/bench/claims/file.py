"""Parse claims files: bounds on measured quantities, written in TOML.

::

    [[claim]]
    name = "2.5 mm step to 50 um"
    scene = "scenes/step-block.toml"     # beside the claims file, or a shipped scene
    quantity = "step[2.5].error_mm"
    max = 0.05                           # or min, or within = [low, high]
    confidence = 0.95
    repeats = 15

A bound is a number, or another quantity with a factor before it, ``"0.5 * set[1,2,4].rms_mm"``:
that form and no other is read, by a pattern; nothing is evaluated.  A key that is unknown, a
bound in another unit than the quantity or that is the quantity itself, fewer repeats than could
ever show what is claimed: all are refused before anything is measured, in one line that names the
file and the claim.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slbench.bench.claims.places import Over, Places, read_places
from slbench.bench.claims.quantities import SPEED_FIELDS, family, pattern_set, unit, unknown
from slbench.bench.claims.settings import (
    Settings,
    SettingsTable,
    find_scene,
    read_settings,
)
from slbench.bench.claims.verdicts import least_repeats
from slbench.core.errors import InputError, located
from slbench.core.io import read_toml
from slbench.core.modules import load_modules
from slbench.core.show.display import brief
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import LARGEST, Confidence, Word
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.scene.changes import Change, Changes, read_changes

Array = NDArray[np.float64]

#: Share of single measurements that ``each = true`` claims.
EACH = 0.95
#: Repeats where a claim states none: scans, and comparisons of ``scans`` scans each.
REPEATS = 15
COMPARISONS = 5
#: Keys of claims on scans alone.
_OF_SCANS = ("places", "over_places", "redraw")
#: More are a slip.
_MOST = 10_000

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TIMES = re.compile(rf"\s*(?:({_NUMBER})\s*\*)?\s*([a-z].*?)\s*", re.DOTALL)


class _Claim(SettingsTable):
    name: Word
    scene: Word
    quantity: Word
    # Numbers or text: read by _limit.
    max: Any = None
    min: Any = None
    within: tuple[Any, Any] | None = None
    versus: dict[str, Any] | None = None
    confidence: Confidence = 0.95
    repeats: Annotated[int, Field(ge=2, le=_MOST)] | None = None
    each: Any = False
    places: Any = None
    over_places: Over | None = None
    scans: Annotated[int, Field(ge=2, le=_MOST)] | None = None
    equal: Literal["frames", "photons"] | None = None
    slow: bool = False
    readme: Annotated[str, Field(min_length=1)] | None = None


class _File(Parameters):
    modules: tuple[Any, ...] = ()
    claim: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]


@dataclass(frozen=True)
class Limit:
    """A bound: `factor`, or `factor` times another quantity.

    ``sign`` is +1 for an upper bound and -1 for a lower one.
    """

    sign: int
    factor: float
    quantity: str | None = None

    def margin(self, values: Array, others: Array) -> Array:
        """Return how far inside the bound (n,) values are; `others` are its quantity's."""
        return self.sign * (self.of(others) - values)

    def of(self, others: Array) -> Array:
        """Return the bound itself, repeat by repeat."""
        return (
            np.full(np.shape(others), self.factor)
            if self.quantity is None
            else self.factor * others
        )

    def __str__(self) -> str:
        word = "at most" if self.sign > 0 else "at least"
        times = "" if self.quantity is None else f" × {self.quantity}"
        return f"{word} {self.factor:g}{times}"


@dataclass(frozen=True)
class Claim:
    """One claim, ready to be measured.

    Parameters
    ----------
    name : str
        No other of the file has it.
    quantity : str
    settings : Settings
    limits : tuple of Limit
        One or two.
    versus : Settings
        Those of the limits' quantities; `settings` unless the claim says otherwise.
    confidence : float
    repeats : int
        Scans, comparisons or runs.
    each : float or None
        Share of single measurements within the limits; None for a claim on the mean.
    places : tuple of Displacement, int, "random" or None
        Where the objects are (:mod:`slbench.bench.claims.places`); None for where the scene has
        them.
    over_places : {"worst", "mean", "p95"}
        What is taken of all places of a repeat.
    scans : int
        Scans of each set in one comparison.
    equal : {"frames", "photons"} or None
        Of comparisons.
    slow : bool
        For the pytest marker of that name.
    readme : str or None
        Words of a document that the claim stands for.
    """

    name: str
    quantity: str
    settings: Settings
    limits: tuple[Limit, ...]
    versus: Settings
    confidence: float
    repeats: int
    each: float | None
    places: Places | None
    over_places: Over
    scans: int
    equal: Literal["frames", "photons"] | None
    slow: bool
    readme: str | None

    __repr__ = brief

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantity and those of the limits."""
        return (self.quantity, *(limit.quantity for limit in self.limits if limit.quantity))

    @property
    def several(self) -> bool:
        """Whether every repeat measures at all of several places."""
        return self.places is not None and self.places != "random"

    @property
    def family(self) -> str:
        """What measures it: ``"score"``, ``"set"`` or ``"speed"``."""
        return family(self.quantity)

    @property
    def sets(self) -> tuple[str, ...]:
        """The pattern sets that are compared, sorted."""
        return tuple(sorted({pattern_set(q, self.name)[0] for q in self.quantities}))

    def describe(self) -> str:
        """Return the claim in words: quantity and limits."""
        share = "" if self.each is None else f" in {100 * self.each:g} % of measurements"
        return f"{self.quantity} {' and '.join(map(str, self.limits))}{share}{self.where()}"

    def where(self) -> str:
        """Return the places in words, empty where there is but the scene's own."""
        if self.places is None:
            return ""
        if self.places == "random":
            return " at random places"
        count = self.places if isinstance(self.places, int) else len(self.places)
        what = {"worst": "at the worst", "mean": "on the mean", "p95": "at 95 %"}
        return f" {what[self.over_places]} of {count} places"

    def identity(self) -> dict[str, Any]:
        """Return what is measured, without the bounds: what a baseline has to agree with."""
        relative = [limit.quantity and [limit.factor, limit.quantity] for limit in self.limits]
        values = {
            "quantity": self.quantity,
            "relative_to": [r for r in relative if r] or None,
            "settings": self.settings.identity(),
            "versus": self.versus.identity(),
            "scans": self.scans if self.family == "set" else None,
            "equal": self.equal,
            "places": self.places,
            "over_places": self.over_places if self.several else None,
        }
        return {key: value for key, value in values.items() if value is not None}


def load_claims(
    path: str | Path,
    *,
    preview: bool = False,
    allow_modules: bool = False,
    changes: Changes = (),
    measured_with: str | Path | None = None,
    align: bool = False,
) -> tuple[Claim, ...]:
    """Read a claims file.

    Parameters
    ----------
    path : path
        TOML with one ``[[claim]]`` or more.
    preview : bool
        Measure all scenes with few pixels and samples, whatever the claims say.
    allow_modules : bool
        Run the Python modules that the file names (``modules = ["my_quantities.py"]`` at its
        top): code of its author.
    changes : sequence of str, or mapping
        Of every scene, after a claim's own ``set`` (:mod:`slbench.scene.changes`).
    measured_with : path, optional
        A rig or calibration model that every scene is measured with.
    align : bool
        Whether points are moved to the truth before they are scored, in every claim.

    Returns
    -------
    tuple of Claim
        In the order of the file.

    Raises
    ------
    InputError
        Naming file, claim and key.  Quantities of scans are checked against their scene later
        (:meth:`slbench.bench.claims.pools.Pools.check`).
    """
    path, made = Path(path), read_changes(changes)
    values = read_toml(path)
    if "held" in values and "claim" not in values:
        # What an acceptance holds an instrument to: its tests are measured by another command.
        own = values.get("name", "SCENE|FOLDER")
        got = f"what accept wrote: slbench accept {own} --against {path}"
        raise InputError(path.name, "[[claim]] tables", got)
    file = validated(_File, values, path.name, separator=": ")
    load_modules(file.modules, path.parent, allow_modules, f"{path.name}: modules")
    tables = file.claim
    claims: list[Claim] = []
    for k, table in enumerate(tables):
        given = table.get("name")
        where = (
            f'{path.name}: claim "{given}"'
            if isinstance(given, str)
            else f"{path.name}: claim[{k}]"
        )
        with located(where):
            claim = _claim(validated(_Claim, table, where, separator=": "), where, path.parent)
        if any(claim.name == other.name for other in claims):
            raise InputError(f"{where}: name", "a name that no other claim has", repr(claim.name))
        claims.append(_for_all(claim, preview, made, measured_with, align))
    return tuple(claims)


def _for_all(
    claim: Claim,
    preview: bool,
    changes: tuple[Change, ...],
    measured_with: str | Path | None,
    align: bool,
) -> Claim:
    """Return a claim with what the user says of all of them."""

    def changed(settings: Settings) -> Settings:
        if preview:
            settings = replace(settings, preview=True, samples=None)
        if measured_with is not None:
            settings = replace(settings, measured_with=Path(measured_with))
        own = (*settings.changes, *changes)
        return replace(settings, changes=own, align=settings.align or align)

    return replace(claim, settings=changed(claim.settings), versus=changed(claim.versus))


def _claim(table: _Claim, where: str, folder: Path) -> Claim:
    settings = read_settings(
        table, Settings(find_scene(table.scene, f"{where}: scene", folder)), folder
    )
    limits = _limits(table, where)
    measure = family(table.quantity)
    for quantity in (table.quantity, *(limit.quantity for limit in limits if limit.quantity)):
        key = "quantity" if quantity == table.quantity else "bound"
        _check_name(quantity, f"{where}: {key}")
        if family(quantity) != measure or unit(quantity) != unit(table.quantity):
            kind = {"score": "of a scan", "set": "of a comparison", "speed": "of speed"}[measure]
            inner = unit(table.quantity)
            expected = f"a quantity {kind} {f'in {inner}' if inner else 'without a unit'}"
            raise InputError(f"{where}: {key}", f"{expected}, as {table.quantity}", quantity)
    versus = settings
    if table.versus is not None:
        if measure != "score" or not any(limit.quantity for limit in limits):
            expected = "a bound that is a quantity of a scan, to measure with other settings"
            raise InputError(f"{where}: versus", expected, table.quantity)
        other = validated(SettingsTable, table.versus, f"{where}: versus")
        versus = read_settings(other, settings, folder, f"{where}: versus")
    if versus == settings:
        _check_others(table.quantity, limits, where)
    _check_keys(table, measure, where)
    if measure == "set":
        settings = versus = replace(settings, folder=folder)
    if not table.name.isprintable():
        raise InputError(f"{where}: name", "one line of text", shown(table.name))
    each = _each(table.each, f"{where}: each")
    least = 2 if each is None else least_repeats(each, table.confidence)
    if least > _MOST:
        raise InputError(f"{where}: each", f"a share that {_MOST} repeats can show", each)
    usual = COMPARISONS if measure != "score" else REPEATS
    repeats = max(usual, least) if table.repeats is None else table.repeats
    if repeats < least:
        expected = f"at least {least}: fewer cannot show a share of {each:g}"
        raise InputError(f"{where}: repeats", expected, repeats)
    return Claim(
        table.name,
        table.quantity,
        settings,
        limits,
        versus,
        table.confidence,
        repeats,
        each,
        *_places(table, where),
        table.scans or REPEATS,
        table.equal,
        table.slow,
        table.readme,
    )


def _each(value: Any, where: str) -> float | None:
    if isinstance(value, bool):
        return EACH if value else None
    if isinstance(value, float) and 0.0 < value < 1.0:
        return value
    raise InputError(where, "true, or a share between 0 and 1", shown(value))


def _places(table: _Claim, where: str) -> tuple[Places | None, Over]:
    places = None if table.places is None else read_places(table.places, f"{where}: places")
    if table.over_places is not None and places in (None, "random"):
        expected = "places beside it: how many, or a list"
        raise InputError(f"{where}: over_places", expected, shown(table.places))
    return places, table.over_places or "worst"


def _check_keys(table: _Claim, measure: str, where: str) -> None:
    """Refuse keys that would change nothing."""
    unused = {
        "score": ("scans", "equal"),
        "set": ("patterns", "axes", "noise", *_OF_SCANS),
        "speed": ("scans", "equal", "patterns", "shifts", "axes", "noise", *_OF_SCANS),
    }[measure]
    for key in unused:
        if getattr(table, key) is not None:
            quantity = f"with {table.quantity}, which it does not change"
            raise InputError(f"{where}: {key}", f"no such key {quantity}", getattr(table, key))


def _check_name(quantity: str, where: str) -> None:
    measure = family(quantity)
    if measure == "set":
        pattern_set(quantity, where)
    elif measure == "speed" and quantity.removeprefix("speed.") not in SPEED_FIELDS:
        raise unknown(where, quantity, [f"speed.{name}" for name in SPEED_FIELDS])


def _check_others(quantity: str, limits: tuple[Limit, ...], where: str) -> None:
    """Refuse a bound that is the quantity itself, which no measurement decides."""
    if "".join(quantity.split()) in ["".join((limit.quantity or "").split()) for limit in limits]:
        expected = "another quantity, or the same with other settings (versus)"
        raise InputError(f"{where}: bound", expected, quantity)


def _limits(table: _Claim, where: str) -> tuple[Limit, ...]:
    given = {key: getattr(table, key) for key in ("max", "min", "within")}
    used = [key for key, value in given.items() if value is not None]
    if len(used) != 1:
        got = " and ".join(used) or "none of them"
        raise InputError(where, "one of max, min and within = [low, high]", got)
    if table.within is not None:
        low, high = table.within
        limits = (_limit(low, -1, f"{where}: within"), _limit(high, 1, f"{where}: within"))
        numbers = [limit.factor for limit in limits if limit.quantity is None]
        if len(numbers) == 2 and numbers[0] > numbers[1]:
            raise InputError(f"{where}: within", "[low, high]", shown(list(table.within)))
        return limits
    return (_limit(given[used[0]], 1 if used == ["max"] else -1, f"{where}: {used[0]}"),)


def _limit(value: Any, sign: int, where: str) -> Limit:
    """Read a bound: a number, ``"quantity"`` or ``"factor * quantity"``."""
    number = _number(value)
    if number is not None:
        return Limit(sign, number)
    match = _TIMES.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        expected = 'a number, or text such as "0.5 * step[2.5].error_mm"'
        raise InputError(where, expected, shown(value))
    factor = float(match[1] or 1.0)  # of text: infinite where it is too large
    if not abs(factor) <= LARGEST:
        raise InputError(where, f"a factor up to {LARGEST:g}", shown(value))
    return Limit(sign, factor, match[2])


def _number(value: Any) -> float | None:
    """Return a number that means something; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # TOML's integers have no end
        return None
    return number if abs(number) <= LARGEST else None
