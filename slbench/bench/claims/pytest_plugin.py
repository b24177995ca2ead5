"""Claims in a test suite: pytest collects ``*.claims.toml``, one item a claim.

A claim that fails, has regressed against the baseline beside its file or is undecided fails its
item with one line: a suite must not pass on what nobody knows.  ``slow = true`` in a claim is the
marker ``slow``.  Settings are the options ``--claims-seed`` and ``--claims-preview``, or
``claims_seed`` and ``claims_preview`` in the ini file; ``--claims-allow-modules`` (the command
line only) runs the Python modules that claims files and their scenes name.

Every pytest run of everybody who has slbench installed imports this module: all else is imported
when a claims file is met.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from slbench.bench.claims.baseline import Baseline
    from slbench.bench.claims.file import Claim
    from slbench.bench.claims.pools import Pools

_SUFFIX = ".claims.toml"
_pools = pytest.StashKey["Pools"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the settings."""
    group = parser.getgroup("slbench", "claims about simulated scans")
    group.addoption(
        "--claims-seed", type=int, metavar="N", help="seed of the scans that claims are tested on"
    )
    group.addoption(
        "--claims-preview",
        action="store_true",
        default=None,
        help="measure claims with few pixels and samples",
    )
    group.addoption(
        "--claims-allow-modules",
        action="store_true",
        help="run the Python modules that claims files and their scenes name",
    )
    parser.addini("claims_seed", "seed of the scans that claims are tested on", default="0")
    parser.addini("claims_preview", "measure claims at preview size", type="bool", default=False)


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker of slow claims."""
    config.addinivalue_line("markers", "slow: takes long (slbench: a claim with slow = true)")


def pytest_collect_file(parent: pytest.Collector, file_path: Path) -> ClaimsFile | None:
    """Collect claims files."""
    if file_path.name.endswith(_SUFFIX):
        return ClaimsFile.from_parent(parent, path=file_path)
    return None


class ClaimRefused(Exception):
    """A claim that does not hold; its text is the line that the user reads."""


class ClaimsFile(pytest.File):
    """A claims file; its claims share their scans with those of other files."""

    def collect(self) -> Iterator[ClaimItem]:
        """Read the file; nothing is measured yet."""
        from slbench.bench.claims.baseline import default_path, read_baseline
        from slbench.bench.claims.file import load_claims
        from slbench.core.errors import InputError

        preview = self.config.getoption("claims_preview")
        if preview is None:
            preview = self.config.getini("claims_preview")
        kept = default_path(self.path)
        baseline = None
        try:
            allow = self.config.getoption("claims_allow_modules")
            claims = load_claims(self.path, preview=preview, allow_modules=allow)
            if kept.is_file():
                baseline = read_baseline(kept)
        except InputError as error:
            raise self.CollectError(str(error)) from None
        if baseline is not None and preview and not baseline.preview:
            self.warn(pytest.PytestWarning(f"{kept.name} is not of previews: not compared"))
            baseline = None
        for claim in claims:
            item = ClaimItem.from_parent(self, name=claim.name)
            item.claim, item.all_claims, item.baseline = claim, claims, baseline
            if claim.slow:
                item.add_marker("slow")
            yield item


class ClaimItem(pytest.Item):
    """One claim."""

    claim: Claim
    all_claims: tuple[Claim, ...]
    baseline: Baseline | None

    def runtest(self) -> None:
        """Measure the claim; raise :class:`ClaimRefused` unless it holds."""
        from slbench.bench.claims.baseline import check_fit, compare_with
        from slbench.bench.claims.check import check_claim, with_regressions

        pools = self._pools()
        if self.baseline is not None:
            check_fit(self.baseline, self.all_claims, pools)
        results = [check_claim(self.claim, pools)]
        if self.baseline is not None:
            shared = len(self.baseline.entries)
            results = with_regressions(results, compare_with(self.baseline, results, shared))
        if results[0].outcome != "holds":
            raise ClaimRefused(results[0].line())
        self.add_report_section("call", "claim", results[0].line())

    def _pools(self) -> Pools:
        """Return the measurements of this run."""
        from slbench.bench.claims.pools import Pools
        from slbench.core.errors import InputError

        stash = self.session.stash
        if _pools not in stash:
            given = self.config.getoption("claims_seed")
            seed = str(self.config.getini("claims_seed") if given is None else given)
            if not seed.isdecimal():
                raise InputError("claims_seed", "a whole number, zero or more", seed)
            allow = self.config.getoption("claims_allow_modules")
            stash[_pools] = Pools(int(seed), allow_modules=allow)
        return stash[_pools]

    def repr_failure(self, excinfo: Any, style: Any = None) -> Any:
        """Return one line for a claim that does not hold or cannot be measured."""
        from slbench.core.errors import InputError

        if isinstance(excinfo.value, ClaimRefused | InputError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return where the claim stands."""
        return self.path, None, f"claim: {self.name}"
