"""What an acceptance writes, and what holds an instrument to it from then on.

``claims.toml`` has the limits, the certificates, what a virtual scanner rendered of them, the views
and the worst error of each test.  Given to ``accept --against`` it is run again: a test that fails
its limit fails, and so does one that is worse than it was by more than both uncertainties explain
(95 %).  The certificate and the coefficient of expansion are the same both times and explain
nothing.  A test that is held and not measured leaves the acceptance undecided.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slbench.bench.accept.acceptance import UNMEASURED, Acceptance
from slbench.bench.accept.standards import Standard, Temperature
from slbench.bench.accept.verdict import Worse
from slbench.bench.claims.junit import Case, write_cases
from slbench.core.io import OutputFolder, write_json, write_table, write_toml
from slbench.core.show.drawing import write_figure
from slbench.core.units import UM

ACCEPTANCE_FOLDER = OutputFolder(
    "acceptance", ("acceptance.json", "places.csv", "acceptance.png", "claims.toml")
)

#: Differences beyond this many standard uncertainties are no chance, both sides 95 %.
_WORSE = 1.959964


def held_to(result: Acceptance, held: Mapping[str, tuple[float, float]]) -> Acceptance:
    """Return an acceptance with the tests that are worse than they were, and those that it lacks.

    Parameters
    ----------
    result : Acceptance
    held : mapping of str to (float, float)
        Worst error and its own standard uncertainty, mm, by test.
    """
    measured = {one.test.name for one in result.tests}
    lacking = tuple(name for name in held if name not in measured)
    return replace(result, worse=_worse(result, held), unmeasured=lacking)


def _worse(result: Acceptance, held: Mapping[str, tuple[float, float]]) -> tuple[Worse, ...]:
    found = []
    for one in result.tests:
        if one.test.name not in held:
            continue
        then, u_then = held[one.test.name]
        worst = max(one.judged, key=lambda judged: abs(judged.value.error_mm)).value
        slack = _WORSE * math.hypot(u_then, worst.u_repeat_mm)
        if abs(worst.error_mm) > abs(then) + slack:
            found.append(Worse(one.test.name, then, worst.error_mm))
    return tuple(found)


def write_acceptance(result: Acceptance, folder: str | Path) -> None:
    """Write ``acceptance.json``, ``places.csv``, ``acceptance.png`` and ``claims.toml``."""
    with ACCEPTANCE_FOLDER.writing(folder, result.parameters, result.seed) as temporary:
        write_json(temporary / "acceptance.json", result.to_dict())
        columns = ("test", "place", "error_mm", "measured_mm", "certified_mm", "u_mm", "u_calib_mm")
        rows = [
            (
                one.value.test,
                one.value.place,
                one.value.error_mm,
                one.value.measured_mm,
                one.value.certified_mm,
                one.value.u_test_mm,
                one.value.u_calibration_mm,
                "" if one.limit_mm is None else one.limit_mm,
                one.outcome,
            )
            for test in result.tests
            for one in test.judged
        ]
        write_table(temporary / "places.csv", (*columns, "limit_mm", "outcome"), rows)
        write_figure(result, temporary / "acceptance.png")
        write_toml(temporary / "claims.toml", claims_of(result))


def claims_of(result: Acceptance) -> dict[str, Any]:
    """Return what holds an instrument to an acceptance, as a table for TOML."""
    standards = {place.place.standard.kind: place.place.standard for place in result.places}
    counts = [place.place.standard.kind for place in result.places]
    held = []
    for one in result.tests:
        worst = max(one.judged, key=lambda judged: abs(judged.value.error_mm)).value
        own = {"worst_um": UM * worst.error_mm, "u_um": UM * worst.u_repeat_mm}
        held.append({"test": one.test.name} | {k: round(v, 6) for k, v in own.items()})
    limits = {one.test.name: one.limit for one in result.tests if one.limit is not None}
    tables = {
        kind: _plain(standard) | {"places": counts.count(kind)}
        for kind, standard in standards.items()
    }
    return {
        "name": result.name,
        "views": result.views,
        "registered_by": result.parameters.get("register", "poses"),
        "mpe": {f"{name}_um": limit.plain for name, limit in limits.items()},
        "standards": tables,
        "held": held,
    }


def _plain(standard: Standard) -> dict[str, Any]:
    """Return what a certificate states, for TOML."""
    found: dict[str, Any] = {}
    for name, value in vars(standard).items():
        if name == "kind" or value is None or value == getattr(Standard, name, None):
            continue
        if name == "temperature":
            if value != Temperature():
                found[name] = vars(value)
            continue
        found[name] = _toml(value)
    return found


def _toml(value: Any) -> Any:
    """Return a parameter as TOML has it: lists and plain numbers."""
    if isinstance(value, Mapping):
        return {key: _toml(own) for key, own in value.items() if own is not None}
    return np.asarray(value).tolist() if isinstance(value, tuple | np.ndarray) else value


def write_acceptance_junit(result: Acceptance, path: str | Path) -> None:
    """Write the tests as JUnit XML, a case a test; one without a limit passes."""
    cases = []
    for one in result.tests:
        worst = one.worst
        line = (
            f"{one.outcome}: {one.test.words} {UM * worst.value.error_mm:+.4g} µm at "
            f"{worst.value.place}, u {UM * worst.value.u_test_mm:.3g} µm"
        )
        if worst.limit_mm is not None:
            line += f", limit {UM * worst.limit_mm:.4g} µm"
        if one.too_few:
            line += f", {one.places} places"
        outcome = "pass" if one.outcome == "no limit" else one.outcome
        cases.append(Case(one.test.name, outcome, line, result.why()))
    cases += [Case(f"{name}, held", "undecided", UNMEASURED) for name in result.unmeasured]
    cases += [Case(f"{w.test}, held", "worse", w.text()) for w in result.worse]
    write_cases(path, result.name, cases)
