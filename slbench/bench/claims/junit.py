"""Results of claims as JUnit XML, the dialect that CI servers read.

One ``testsuite`` a claims file, one ``testcase`` a claim.  A claim that fails, has regressed or is
undecided is a ``failure`` of that type: a server has no word for undecided, and it is not a pass.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from slbench.bench.claims.check import Result
from slbench.core.io import atomic_path

#: What XML 1.0 cannot hold, even escaped.
_ILLEGAL = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Case:
    """One case of a suite.

    Parameters
    ----------
    name : str
    outcome : str
        ``"holds"`` and ``"pass"`` are passes; anything else is a failure of that type.
    line : str
        Verdict and evidence.
    detail : str
        What a failure says besides.
    seconds : float
    """

    name: str
    outcome: str
    line: str
    detail: str = ""
    seconds: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether a server counts it as passed."""
        return self.outcome in ("holds", "pass")


def write_junit(path: str | Path, claims_file: str | Path, results: Sequence[Result]) -> None:
    """Write results as JUnit XML.

    Parameters
    ----------
    path : path
    claims_file : path
        Its name is the suite's.
    results : sequence of Result
    """
    cases = [
        Case(
            result.claim.name,
            result.outcome,
            result.line(),
            f"values: {', '.join(f'{x:.6g}' for x in result.values)}",
            result.seconds,
        )
        for result in results
    ]
    write_cases(path, Path(claims_file).name, cases)


def write_cases(path: str | Path, name: str, cases: Sequence[Case]) -> None:
    """Write a suite of cases as JUnit XML."""
    totals = {
        "name": name,
        "tests": str(len(cases)),
        "failures": str(sum(not case.passed for case in cases)),
        "errors": "0",
        "skipped": "0",
        "time": f"{sum(case.seconds for case in cases):.3f}",
    }
    counts = {k: v for k, v in totals.items() if k != "skipped"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", totals)
    for case in cases:
        element = ElementTree.SubElement(
            suite,
            "testcase",
            {
                "classname": _legal(name.removesuffix(".toml")),
                "name": _legal(case.name),
                "time": f"{case.seconds:.3f}",
            },
        )
        if case.passed:
            ElementTree.SubElement(element, "system-out").text = _legal(case.line)
            continue
        failure = {"type": case.outcome, "message": _legal(case.line)}
        text = f"{case.line}\n{case.detail}" if case.detail else case.line
        ElementTree.SubElement(element, "failure", failure).text = _legal(text)
    ElementTree.indent(root)
    with atomic_path(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _legal(text: str) -> str:
    return _ILLEGAL.sub("\N{REPLACEMENT CHARACTER}", text)
