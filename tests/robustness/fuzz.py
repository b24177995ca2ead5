"""Runs the command line on hostile input and judges what it does: see ``rows`` for what is tried.

    python tests/robustness/fuzz.py --count 100 --row "capture.toml"

tries one kind of input by hand and prints what was found.  A case is a row, a seed and a number:
the same three are the same bytes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HANG_S = 60
#: Growth of the process by one input, beyond what good ones need.
MEMORY_MB = 600
STATUSES = {0, 1, 2, 3}


@dataclass(frozen=True)
class Case:
    """One hostile input: files to put into the folder, and what to run there."""

    files: dict[str, bytes]
    arguments: list[str]


@dataclass(frozen=True)
class Row:
    """A kind of input.

    Parameters
    ----------
    name : str
    prepare : callable
        Makes a folder of good input, once; the command takes it as it is.
    make : callable
        Returns the case of a generator, given the folder.
    weight : float
        Share of the cases against others: less where a case costs more.
    call : callable, optional
        What reads the files where no command does: it raises ``InputError`` or nothing.
    """

    name: str
    prepare: Callable[[Path], None]
    make: Callable[[np.random.Generator, Path], Case]
    weight: float = 1.0
    call: Callable[[Path], Any] | None = None


@dataclass(frozen=True)
class Outcome:
    """What a command did, and how long it took."""

    status: int
    err: str
    seconds: float
    grown_mb: float


class Hang(BaseException):
    """The time of a case is over."""


def generator(row: Row, seed: int, number: int) -> np.random.Generator:
    """Return the generator of a case."""
    return np.random.default_rng([seed, zlib.crc32(row.name.encode()), number])


def listing(folder: Path) -> dict[str, tuple[int, int]]:
    """Return the files of a folder, ``out`` left aside, with size and time."""
    found = {}
    for place, folders, files in os.walk(folder):
        if Path(place) == folder and "out" in folders:
            folders.remove("out")
        for name in [*files, *folders]:
            status = os.lstat(os.path.join(place, name))
            size = status.st_size if name in files else 0
            time_ns = status.st_mtime_ns if name in files else 0
            found[os.path.relpath(os.path.join(place, name), folder)] = size, time_ns
    return found


def _in_process(arguments: list[str], call: Callable[[Path], Any] | None) -> tuple[int, str]:
    from slbench.cli import main
    from slbench.core.errors import InputError
    from slbench.core.messages import one_line_messages

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        if call is not None:
            try:
                with one_line_messages() as messages:
                    try:
                        call(Path.cwd())
                    except InputError as error:
                        messages.refused = True
                        print(f"error: {error}", file=sys.stderr)
                        return 2, err.getvalue()
            except Exception as error:
                return 70, f"error: {error!r}"
            return 0, err.getvalue()
        before, sys.argv = sys.argv, ["slbench", *arguments]
        try:
            main()
        except SystemExit as end:
            return int(end.code or 0), err.getvalue()
        finally:
            sys.argv = before
    raise AssertionError("main came back")


@contextlib.contextmanager
def _alarm(seconds: int) -> Iterator[None]:
    def over(*_: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, over)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def run(row: Row, folder: Path, case: Case, *, process: bool = False) -> tuple[Outcome, list[str]]:
    """Run a case in its folder and return what happened and what is wrong with it."""
    kept = {}
    for name, content in case.files.items():
        path = folder / name
        kept[name] = path.read_bytes() if path.exists() else None
        path.write_bytes(content)
    before = listing(folder)
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start, here = time.perf_counter(), os.getcwd()
    os.chdir(folder)
    try:
        if process:
            command = [sys.executable, "-m", "slbench", *case.arguments]
            try:
                done = subprocess.run(command, capture_output=True, timeout=2 * HANG_S, check=False)
                status, err = done.returncode, done.stderr.decode("utf-8", "replace")
            except subprocess.TimeoutExpired:
                status, err = -1, "hang"
        else:
            try:
                with _alarm(HANG_S):
                    status, err = _in_process(case.arguments, row.call)
            except Hang:
                status, err = -1, "hang"
    finally:
        os.chdir(here)
    seconds = time.perf_counter() - start
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - usage) / 1024
    after = listing(folder)
    for name, content in kept.items():
        if content is None:
            (folder / name).unlink(missing_ok=True)
        else:
            (folder / name).write_bytes(content)
    shutil.rmtree(folder / "out", ignore_errors=True)
    for name in set(after) - set(before):
        if (folder / name).is_dir():
            shutil.rmtree(folder / name)
        else:
            (folder / name).unlink(missing_ok=True)
    outcome = Outcome(status, err, seconds, grown)
    return outcome, _faults(outcome, before, after)


def _faults(outcome: Outcome, before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    faults = []
    if outcome.err == "hang":
        return [f"hang beyond {HANG_S} s"]
    if outcome.status not in STATUSES:
        faults.append(f"status {outcome.status}")
    if "Traceback" in outcome.err:
        faults.append("a traceback")
    lines = outcome.err.splitlines()
    if outcome.status == 2:
        errors = [line for line in lines if not line.startswith("warning: ")]
        if len(errors) != 1 or not errors[0].startswith("error: "):
            faults.append(f"a refusal of {len(errors)} lines")
    if before != after:
        changed = {name for name in {*before, *after} if before.get(name) != after.get(name)}
        faults.append(f"foreign files touched: {sorted(changed)[:3]}")
    if outcome.grown_mb > MEMORY_MB:
        faults.append(f"{outcome.grown_mb:.0f} MB")
    return faults


def check_good(row: Row, folder: Path) -> None:
    """Check that a row's good input is good: else all that follows fails for another reason."""
    case = row.make(generator(row, 0, 0), folder)
    outcome, faults = run(row, folder, Case({}, case.arguments))
    assert outcome.status == 0, f"{row.name}: {outcome.err}"
    assert not faults, f"{row.name}: {faults}"


def trial(
    row: Row, folder: Path, numbers: range, *, seed: int = 0, process: bool = False
) -> Iterator[tuple[int, Case, Outcome, list[str]]]:
    """Run cases of a row and yield what happened in each."""
    for number in numbers:
        case = row.make(generator(row, seed, number), folder)
        outcome, faults = run(row, folder, case, process=process)
        yield number, case, outcome, faults


def main() -> None:
    """Try rows by hand."""
    sys.path.append(str(Path(__file__).parents[1] / "helpers"))
    from rows import ROWS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--row", help="those whose names hold this")
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--count", type=int, default=50, help="cases, times the row's weight")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--process", action="store_true", help="each in a process of its own")
    parser.add_argument("--keep", type=Path, help="folder for what was found")
    options = parser.parse_args()
    total, found = 0, 0
    for row in ROWS:
        if options.row and options.row not in row.name:
            continue
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            try:
                row.prepare(folder)
                if row.name != "command line":
                    check_good(row, folder)
            except AssertionError as error:
                print(f"NOT GOOD: {error}")
                continue
            count = max(1, round(options.count * row.weight))
            numbers = range(options.start, options.start + count)
            begin, statuses, faulty = time.perf_counter(), dict[int, int](), 0
            tried = trial(row, folder, numbers, seed=options.seed, process=options.process)
            for number, case, outcome, faults in tried:
                statuses[outcome.status] = statuses.get(outcome.status, 0) + 1
                if faults:
                    faulty += 1
                    print(f"  {row.name} {number}: {'; '.join(faults)}: {outcome.err[:400]}")
                    if options.keep:
                        kept = options.keep / f"{row.name.replace(' ', '-')}-{number}"
                        kept.mkdir(parents=True, exist_ok=True)
                        for file, content in case.files.items():
                            (kept / Path(file).name).write_bytes(content)
                        (kept / "command").write_text(" ".join(case.arguments))
            seconds = time.perf_counter() - begin
            total, found = total + count, found + faulty
            print(
                f"{row.name}: {count} in {seconds:.1f} s, {statuses}, {faulty} faulty", flush=True
            )
    print(f"{total} cases, {found} faulty")


if __name__ == "__main__":
    main()
