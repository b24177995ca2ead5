"""Commands that are killed: at every visible change of the file system, and at any moment.

What is checked each time: a folder that carries no mark holds the whole earlier result or the whole
new one, with a provenance that fits it; a marked one is refused by readers; a file of somebody
else's is untouched; the command, run again, leaves its result and nothing else.
"""

import hashlib
import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from writers import WRITERS, need

from slbench.core.errors import InputError
from slbench.core.io.atomic import existing
from slbench.core.io.marker import MARKER, read_marker
from slbench.core.io.scratch import is_scratch

HERE = Path(__file__).parent
#: Numbers in them are times.
_VARY = ("provenance.json",)
MINE = "mine.txt"


@pytest.fixture(scope="session")
def inputs(tmp_path_factory):
    return tmp_path_factory.mktemp("inputs")


@pytest.fixture(scope="session")
def results(inputs, tmp_path_factory):
    """Places with the earlier result, and what the new one has, by command; made when needed."""
    made = {}

    def of(name):
        if name not in made:
            writer = WRITERS[name]
            need(inputs, *writer.needs)
            before, after = (tmp_path_factory.mktemp(f"{name}-{w}") for w in ("old", "new"))
            for place in (before, after):
                (place / MINE).write_text("mine")
            if writer.old is not None:
                assert run(name, inputs, before, writer.old).returncode in (0, 1)
            assert run(name, inputs, after, writer.new).returncode in (0, 1)
            made[name] = before, contents(before), contents(after)
            assert made[name][1] != made[name][2]
        return made[name]

    return of


def command(name, inputs, place, words):
    writer = WRITERS[name]
    return [*map(str, writer.words(inputs, place / writer.out)), *words]


def run(name, inputs, place, words, *, dies_at=10**9):
    script = [sys.executable, str(HERE / "dying.py"), str(dies_at)]
    line = [*script, *command(name, inputs, place, words)]
    return subprocess.run(line, capture_output=True, text=True, check=False)


def contents(place):
    """Return digests of what is in a place, but for times and what nobody sees."""
    found = {}
    for path in sorted(place.rglob("*")):
        name = path.relative_to(place).as_posix()
        hidden = any(is_scratch(part) for part in name.split("/"))
        if path.is_file() and not hidden and not name.endswith(_VARY):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def check_state(place, old, new):
    """Check that a place after a kill is old, new, or marked; return which."""
    assert (place / MINE).read_text() == "mine"
    marked = [path.parent for path in place.rglob(MARKER)]
    now = contents(place)
    if not marked:
        assert now in (old, new)
        for path in place.rglob("*provenance.json"):
            check_provenance(path)
        return "old" if now == old else "new"
    (folder,) = marked
    for name in read_marker(folder)["files"]:
        if (folder / name).exists():
            with pytest.raises(InputError, match="cut off"):
                existing(folder / name)
    return "marked"


def check_provenance(path):
    """Check that every file that a provenance lists is as it was written."""
    if any(is_scratch(part) for part in path.parts):
        return
    for name, digest in json.loads(path.read_text())["files"].items():
        assert hashlib.sha256((path.parent / name).read_bytes()).hexdigest() == digest


def check_again(name, inputs, place, new):
    """Check that the command, run again, finishes and tidies up."""
    done = run(name, inputs, place, WRITERS[name].new)
    assert done.returncode in (0, 1), done.stderr
    assert contents(place) == new
    assert not [path for path in place.rglob("*") if is_scratch(path.name)]
    assert not list(place.rglob(MARKER))


def changes_of(name, results, inputs, tmp_path):
    """Return how many visible changes the new run makes over the earlier result."""
    before, _, new = results(name)
    place = tmp_path / "whole"
    shutil.copytree(before, place)
    done = run(name, inputs, place, WRITERS[name].new)
    assert contents(place) == new
    return int(done.stderr.rsplit("changes: ", 1)[1])


def kill_everywhere(name, results, inputs, tmp_path, most=None):
    before, old, new = results(name)
    count = changes_of(name, results, inputs, tmp_path)
    assert count > 0
    points = list(range(count))
    if most is not None and count > most:
        points = sorted(random.Random(1).sample(points, most))
    states = []
    for point in points:
        place = tmp_path / str(point)
        shutil.copytree(before, place)
        assert run(name, inputs, place, WRITERS[name].new, dies_at=point).returncode == 9
        states.append(check_state(place, old, new))
        if point in (points[len(points) // 2], points[-1]):
            check_again(name, inputs, place, new)
        shutil.rmtree(place)
    assert states == sorted(states, key=["old", "marked", "new"].index)
    return states


def test_a_command_killed_at_some_changes(results, inputs, tmp_path):
    states = kill_everywhere("decode", results, inputs, tmp_path, most=2)
    assert "marked" in states


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_every_command_killed_at_every_change(name, results, inputs, tmp_path):
    kill_everywhere(name, results, inputs, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("name", [name for name, writer in WRITERS.items() if not writer.dear])
def test_every_command_ended_at_any_moment(name, number, results, inputs, tmp_path):
    before, old, new = results(name)
    rng = random.Random(f"{name} {number}")
    line = [sys.executable, "-m", "slbench"]
    took = 3.0
    for turn in range(3):
        place = tmp_path / str(turn)
        shutil.copytree(before, place)
        words = command(name, inputs, place, WRITERS[name].new)
        begin = time.monotonic()
        child = subprocess.Popen(
            [*line, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        try:
            _, said = child.communicate(timeout=rng.uniform(0.3, took))
            took = time.monotonic() - begin
        except subprocess.TimeoutExpired:
            child.send_signal(number)
            _, said = child.communicate()
        check_state(place, old, new)
        check_said(child.returncode, said, number)
        if number != signal.SIGKILL:
            assert not [path for path in place.rglob("*") if is_scratch(path.name)]
    check_again(name, inputs, place, new)


def check_said(status, said, number):
    """Check what a command that was ended says: one word, or nothing before it could."""
    lines = [line for line in said.splitlines() if not line.startswith("warning: ")]
    if status in (0, 1):
        assert lines == []
    elif status == 128 + number:
        assert lines == ["interrupted" if number == signal.SIGINT else "terminated"]
    else:
        # Python itself is ended by a signal while it starts, and after an interrupt as it ends.
        assert status == -number
        assert lines in ([], ["interrupted"])


@pytest.mark.slow
def test_a_scan_on_a_disk_that_fills_up(inputs, tmp_path):
    """The limit of a file's size strikes at each of the files of a scan in turn."""
    pytest.importorskip("resource")
    need(inputs, *WRITERS["scan"].needs)
    code = "import resource, sys; limit = int(sys.argv.pop(1));"
    code += "resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit));"
    code += "from slbench.__main__ import main; main()"
    for limit in (100, 2000, 8000, 20_000, 60_000):
        place = tmp_path / str(limit)
        place.mkdir()
        words = ["scan", str(inputs / "small.toml"), "--out", str(place / "out")]
        line = [sys.executable, "-c", code, str(limit), *words]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert done.returncode == 2, done.stderr
        assert done.stderr.startswith(f"error: {place / 'out'}/")
        assert done.stderr.count("\n") == 1
        assert list(place.iterdir()) == []
