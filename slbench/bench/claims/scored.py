"""Claims held against clouds that were scored: real ones, or any (``slbench score``).

One cloud tells a number with the uncertainty that its score states: that of a fit, or the interval
by tiles.  Two or more are repeats, and judged as repeated scans are.  The certificate of a declared
dimension is uncertain as well, which no repeats average: its share widens the intervals of
deviations from it, of one cloud (in quadrature) and of many.  A claim's scene is not measured: it
says which features there are.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from slbench.bench.claims.check import Result
from slbench.bench.claims.file import Claim, load_claims
from slbench.bench.claims.pools import Pools
from slbench.bench.claims.quantities import resolve, scored_features, values_of_score
from slbench.bench.claims.verdicts import Status, Verdict, judge_each, judge_mean
from slbench.bench.statistics import Interval
from slbench.core.errors import InputError, located
from slbench.core.io import read_json
from slbench.scene.model import Scene
from slbench.score.clouds.cloudscore import SIGNED
from slbench.score.clouds.tiles import CONFIDENCE, widening
from slbench.score.points import Score
from slbench.score.values import DimensionScore

Array = NDArray[np.float64]

#: Numbers of a feature and what states their standard uncertainty.
_UNCERTAINTY = re.compile(r"(radius_|diameter_|angle_|)(?:measured_|error_|deviation_|)(mm|deg)")


def check_scored(
    path: str | Path, folders: Sequence[str | Path], *, allow_modules: bool = False
) -> list[Result]:
    """Judge claims by scores of clouds.

    Parameters
    ----------
    path : path
        A claims file.
    folders : sequence of path
        That ``slbench score`` wrote (or a scan): ``score.json``.
    allow_modules : bool
        Run the Python modules that the file and its scenes name: code of their authors.

    Returns
    -------
    list of Result
        In the order of the file.

    Raises
    ------
    InputError
        Naming a claim that no score tells, or a folder that is none.
    """
    claims = load_claims(path, allow_modules=allow_modules)
    scores = [_read(folder) for folder in folders]
    pools = Pools(allow_modules=allow_modules)
    found = []
    with located(Path(path).name):
        for claim in claims:
            where = f'claim "{claim.name}"'
            if claim.family != "score" or claim.places is not None:
                expected = "a quantity of a scan at its own place, which a scored cloud tells"
                raise InputError(where, expected, claim.describe())
            pools.check(claim)
            found.append(_judged(claim, pools.scene(claim.settings), scores, where))
    return found


def _read(folder: str | Path) -> dict[str, Any]:
    path = Path(folder)
    stored = read_json(path if path.suffix == ".json" else path / "score.json")
    if not isinstance(stored, dict) or "rms_mm" not in stored:
        raise InputError(path, "a score as slbench score writes it (score.json)", "another file")
    with located(path):
        return stored | {"score": Score.from_dict(stored), "folder": str(folder)}


def _judged(claim: Claim, scene: Scene, scores: Sequence[dict[str, Any]], where: str) -> Result:
    rows = [values_of_score(one["score"], scene) for one in scores]
    owners = {
        f"{feature.kind}[{feature.label}]": feature.owner.partition("#")[0]
        for feature, _ in scored_features(scores[0]["score"], scene)
    }

    def untold(name: str) -> bool:
        """Tell whether no cloud has a number, and none could have by what it was held against."""
        owner = owners.get(name.rpartition(".")[0])
        return not any(np.isfinite(row[name]) for row in rows) and not any(
            _tells(one.get("reference"), owner) for one in scores
        )

    def values(quantity: str) -> Array:
        names = resolve(quantity, scene, where)
        for one, row in zip(scores, rows, strict=True):
            missing = next((name for name in names if name not in row or untold(name)), None)
            if missing is not None:
                expected = f"a number that the scored cloud {one['folder']} has"
                raise InputError(where, expected, missing)
        return np.array([[row[name] for name in names] for row in rows]).max(axis=1)

    own = values(claim.quantity)
    others = [
        np.full(len(own), np.nan) if limit.quantity is None else values(limit.quantity)
        for limit in claim.limits
    ]
    bounds = tuple(limit.of(other) for limit, other in zip(claim.limits, others, strict=True))
    names = resolve(claim.quantity, scene, where)
    certificates = [_certificate(name, scores[0]["score"], scene) for name in names]
    if len(rows) > 1:
        pairs = zip(claim.limits, others, strict=True)
        margins = [limit.margin(own, other) for limit, other in pairs]
        unsure = max(certificates) * float(norm.ppf(0.5 + 0.5 * claim.confidence))
        if claim.each is None:
            verdict = judge_mean(own, margins, claim.confidence, unsure)
        else:
            verdict = judge_each(own, margins, claim.confidence, claim.each, unsure)
    else:
        verdict = _of_one(claim, names, scores[0], rows[0], certificates, where)
    return Result(claim, verdict, own, bounds, 0.0)


def _tells(reference: Any, owner: str | None) -> bool:
    """Tell whether a score against a reference may have a number, of an object's feature or none.

    A scan's own score has no reference, and what is true of a scan tells all.
    """
    if not isinstance(reference, dict) or reference.get("kind") == "truth":
        return True
    return owner is not None and reference.get("name") == owner


def _certificate(name: str, score: Score, scene: Scene) -> float:
    """Return the standard uncertainty of the certified value that a number is a deviation from."""
    head, _, last = name.rpartition(".")
    if last.startswith(("deviation_", "error_")):
        for feature, item in scored_features(score, scene):
            if isinstance(item, DimensionScore) and head == f"{feature.kind}[{feature.label}]":
                return item.certificate_uncertainty
    return 0.0


def _of_one(
    claim: Claim,
    names: Sequence[str],
    stored: dict[str, Any],
    row: dict[str, float],
    certificates: Sequence[float],
    where: str,
) -> Verdict:
    """Judge by the uncertainty that one score states."""
    if claim.each is not None or any(limit.quantity for limit in claim.limits):
        expected = "two scored clouds or more for shares and bounds that are measured"
        raise InputError(where, expected, "one")
    intervals = [
        _interval(name, stored, row, unsure, claim.confidence, where)
        for name, unsure in zip(names, certificates, strict=True)
    ]
    measured = max(intervals, key=lambda one: one.value)
    if np.isnan([one.value for one in intervals]).any():
        none = Interval(float("nan"), float("nan"), float("nan"))
        return Verdict("fails", 1, 1, none, none)
    whole = Interval(measured.value, *(max(one[k] for one in intervals) for k in (1, 2)))
    margins = []
    for limit in claim.limits:
        ends = sorted(limit.sign * (limit.factor - end) for end in whole[1:])
        margins.append(Interval(limit.sign * (limit.factor - whole.value), *ends))
    nearest = min(margins, key=lambda one: one.low)
    status: Status = "undecided"
    if any(one.high < 0.0 for one in margins):
        status = "fails"
    elif nearest.low >= 0.0:
        status = "holds"
    return Verdict(status, 1, 0, whole, nearest)


def _interval(
    name: str,
    stored: dict[str, Any],
    row: dict[str, float],
    certificate: float,
    confidence: float,
    where: str,
) -> Interval:
    value, quantile = row[name], float(norm.ppf(0.5 + 0.5 * confidence))
    known = stored.get("intervals", {}).get(name)
    if known is not None and None not in known:
        # Student's t of the tiles that the interval is by.
        count = float(stored.get("interval_tiles", 1e9))
        wider = widening(count, confidence) / widening(count, CONFIDENCE)
        low, high = (value + wider * (float(end) - value) for end in known)
        return Interval(value, low if name in SIGNED else max(low, 0.0), high)
    head, _, last = name.rpartition(".")
    match = _UNCERTAINTY.fullmatch(last)
    u = row.get(f"{head}.{match[1]}uncertainty_{match[2]}") if match and head else None
    if u is None:
        expected = "two scored clouds or more: one does not tell an interval of it"
        raise InputError(where, expected, f"one, of {name}")
    u = float(np.hypot(u, certificate))
    low = value - quantile * u
    # A magnitude is not negative.
    return Interval(value, max(low, 0.0) if "error" in last else low, value + quantile * u)
