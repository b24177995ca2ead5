"""Errors against maximum permissible errors, by the decision rule of ISO 14253-1.

The limit is reduced (to prove conformity) or raised (to prove nonconformity) by a guard band, as
ISO 14253-1:2017 has it by default: what is proven is proven with a probability of 95 %.  Of a
range, which has one limit, the guard band is 1.645 standard uncertainties of the test.  A signed
error must be within both of its limits, ``Phi((MPE - e) / u) - Phi((-MPE - e) / u) >= 0.95``, which
asks for more where the uncertainty is no longer small beside the limit (at 0 for ``u <= MPE /
1.96``).  It fails where it is beyond one limit with 95 %.  Between them nothing is proven:
*undecided*.

A test in fewer places than VDI/VDE 2634-2 asks for may fail; it is not passed: *undecided*.

A maximum permissible error may depend on the tested length: ``A + L / K`` micrometres, L in mm.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from scipy.special import ndtr

from slbench.bench.accept.definitions import LEAST_PLACES, TESTS, ErrorKind
from slbench.bench.accept.evaluate import PlaceError
from slbench.core.errors import InputError
from slbench.core.registry import quoted

Outcome = Literal["pass", "fail", "undecided", "no limit"]

#: Quantile of the normal distribution, one side, 95 %.
GUARD = 1.644854
#: What is proven, is proven with this probability.
SURE = 0.95
#: Outcomes, first what decides.
_DECIDING: tuple[Outcome, ...] = ("fail", "undecided", "pass", "no limit")

_NUMBER = r"(\d+\.?\d*|\.\d+)"
_LIMIT = re.compile(rf"\s*{_NUMBER}\s*(?:\+\s*L\s*/\s*{_NUMBER}\s*)?", re.ASCII)


@dataclass(frozen=True)
class Limit:
    """A maximum permissible error: ``constant_um + L / per``, um, L in mm.

    Parameters
    ----------
    constant_um : float
    per : float or None
        None for one that does not depend on the length.
    """

    constant_um: float
    per: float | None = None

    @classmethod
    def read(cls, text: str | float, where: str) -> Limit:
        """Read ``20`` or ``"15 + L/50"``.

        Raises
        ------
        InputError
            For anything else, and a limit of nothing.
        """
        match = _LIMIT.fullmatch(str(text)) if not isinstance(text, bool) else None
        if match is None or (match[2] and not float(match[2]) > 0.0) or not float(match[1]) > 0.0:
            raise InputError(where, 'micrometres, such as 20 or "15 + L/50" (L in mm)', repr(text))
        return cls(float(match[1]), float(match[2]) if match[2] else None)

    def mm(self, length_mm: float) -> float:
        """Return the limit of a length, mm."""
        return 1e-3 * (self.constant_um + (length_mm / self.per if self.per else 0.0))

    @property
    def plain(self) -> float | str:
        """The limit as a file states it."""
        return str(self) if self.per else self.constant_um

    def __str__(self) -> str:
        return f"{self.constant_um:g}" + (f" + L/{self.per:g}" if self.per else "")


@dataclass(frozen=True)
class Judged:
    """A value beside its limit.

    Parameters
    ----------
    value : PlaceError
    limit_mm : float or None
    outcome : {"pass", "fail", "undecided", "no limit"}
    """

    value: PlaceError
    limit_mm: float | None
    outcome: Outcome

    @property
    def used(self) -> float:
        """Magnitude of the error over its limit; NaN without one."""
        return abs(self.value.error_mm) / self.limit_mm if self.limit_mm else float("nan")


@dataclass(frozen=True)
class Tested:
    """One test over all places.

    Parameters
    ----------
    test : ErrorKind
    limit : Limit or None
    judged : tuple of Judged
        One a place.
    """

    test: ErrorKind
    limit: Limit | None
    judged: tuple[Judged, ...]

    @property
    def worst(self) -> Judged:
        """The place that decides, of several the nearest to its limit; without one, the largest."""
        if self.limit is None:
            return max(self.judged, key=lambda one: abs(one.value.error_mm))
        return max(self.judged, key=lambda one: (-_DECIDING.index(one.outcome), one.used))

    @property
    def places(self) -> str:
        """How many places, and of how many where they are too few: ``2 of 7``."""
        count = str(len(self.judged))
        return f"{count} of {LEAST_PLACES[self.test.standard]}" if self.too_few else count

    @property
    def too_few(self) -> bool:
        """Whether these are fewer places than VDI/VDE 2634-2 asks for."""
        return len(self.judged) < LEAST_PLACES[self.test.standard]

    @property
    def outcome(self) -> Outcome:
        """Fail if one place fails, else undecided if one is or there are too few, else pass."""
        found = overall([one.outcome for one in self.judged])
        return "undecided" if found == "pass" and self.too_few else found


@dataclass(frozen=True)
class Worse:
    """A test that is worse than it was.

    Parameters
    ----------
    test : str
    then_mm, now_mm : float
        Worst errors.
    """

    test: str
    then_mm: float
    now_mm: float

    def text(self) -> str:
        """Return the test and both errors in words."""
        return (
            f"{self.test}: {1e3 * self.now_mm:+.3g} µm, worse than the "
            f"{1e3 * self.then_mm:+.3g} µm that it is held to"
        )


def judge(value: PlaceError, limit: Limit | None) -> Judged:
    """Judge a value by its limit."""
    if limit is None:
        return Judged(value, None, "no limit")
    signed = TESTS[value.test].signed
    bound = limit.mm(value.certified_mm if signed else 0.0)
    u, size = value.u_test_mm, abs(value.error_mm)
    outcome: Outcome = "undecided"
    if size - GUARD * u > bound:
        outcome = "fail"
    elif size + GUARD * u <= bound and (not signed or u == 0.0 or _within(size, u, bound) >= SURE):
        outcome = "pass"
    return Judged(value, bound, outcome)


def _within(error: float, u: float, bound: float) -> float:
    """Return the probability that an error is within both of its limits."""
    return float(ndtr((bound - error) / u) - ndtr((-bound - error) / u))


def judged_tests(values: Sequence[PlaceError], limits: Mapping[str, Limit]) -> tuple[Tested, ...]:
    """Judge the values of all places, test by test."""
    found = []
    for name, test in TESTS.items():
        own = [value for value in values if value.test == name]
        if own:
            limit = limits.get(name)
            found.append(Tested(test, limit, tuple(judge(value, limit) for value in own)))
    return tuple(found)


def overall(outcomes: Sequence[Outcome]) -> Outcome:
    """Return fail if one failed, else undecided if one is, else pass if one passed."""
    return min(outcomes, key=_DECIDING.index, default="no limit")


def read_limits(given: Mapping[str, str | float], where: str) -> dict[str, Limit]:
    """Read limits by name of the test.

    Raises
    ------
    InputError
        For a test that there is not, with the nearest, a limit that cannot be read, and one of a
        form that grows with a length.
    """
    found = {}
    for key, text in given.items():
        name = key.removesuffix("_um")
        if name not in TESTS:
            raise InputError(where, f"one of {', '.join(TESTS)}", quoted(name, list(TESTS)))
        found[name] = limit = Limit.read(text, f"{where}: {key}")
        if limit.per is not None and not TESTS[name].signed:
            raise InputError(f"{where}: {key}", "micrometres of a form, which has no length", limit)
    return found
