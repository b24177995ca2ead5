"""Results of claims as JUnit XML, the dialect that CI servers read.

One ``testsuite`` a claims file, one ``testcase`` a claim.  A claim that fails, has regressed or is
undecided is a ``failure`` of that type: a server has no word for undecided, and it is not a pass.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from slbench.bench.claims.check import Result
from slbench.core.io import atomic_path

#: What XML 1.0 cannot hold, even escaped.
_ILLEGAL = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(path: str | Path, claims_file: str | Path, results: Sequence[Result]) -> None:
    """Write results as JUnit XML.

    Parameters
    ----------
    path : path
    claims_file : path
        Its name is the suite's.
    results : sequence of Result
    """
    name = Path(claims_file).name
    bad = [result for result in results if result.outcome != "holds"]
    totals = {
        "name": name,
        "tests": str(len(results)),
        "failures": str(len(bad)),
        "errors": "0",
        "skipped": "0",
        "time": f"{sum(result.seconds for result in results):.3f}",
    }
    counts = {k: v for k, v in totals.items() if k != "skipped"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", totals)
    for result in results:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            {
                "classname": _legal(name.removesuffix(".toml")),
                "name": _legal(result.claim.name),
                "time": f"{result.seconds:.3f}",
            },
        )
        if result.outcome == "holds":
            ElementTree.SubElement(case, "system-out").text = _legal(result.line())
            continue
        failure = {"type": result.outcome, "message": _legal(result.line())}
        ElementTree.SubElement(case, "failure", failure).text = _legal(
            f"{result.line()}\nvalues: {', '.join(f'{x:.6g}' for x in result.values)}"
        )
    ElementTree.indent(root)
    with atomic_path(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _legal(text: str) -> str:
    return _ILLEGAL.sub("\N{REPLACEMENT CHARACTER}", text)
