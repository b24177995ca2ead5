"""Every command of the tour runs, prints what the tour shows, and writes what it names.

A section of the tour stands alone, so that sections run in any order: its console blocks in one
temporary folder, one after the other.  Shown lines are compared in their order; ``...`` stands
for lines left out.  Words must be equal.  Numbers may differ by 10 % or 0.01, and micrometres by
3: the seed is fixed, so on one machine nothing differs, but another compiler may round another
way, which moves single noise draws and the micrometre or two that a step is off by.
"""

import re
import shlex
from pathlib import Path

import pytest
from scenes_small import run_cli

TOUR = Path(__file__).parents[2] / "docs" / "tutorial" / "tour.md"
TEXT = TOUR.read_text(encoding="utf-8")
SECTIONS = {part.splitlines()[0]: part for part in re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]}
COMMANDED = [name for name, text in SECTIONS.items() if "```console" in text]

NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
#: Paths that the text names as written: in a folder, or with the ending of a file.
FILE = re.compile(r"`((?:[\w-]+/)+[\w.-]+|[\w-]+(?:\.[\w-]+)*\.(?:html|xml|png|toml))`")


def test_the_tour_shows_what_it_promises():
    # Scan, compare, design, check: nobody leaves a section out without noticing.
    assert COMMANDED == [
        "Look around",
        "Scan",
        "Compare",
        "Design the patterns",
        "Design the rig",
        "Check",
    ]


@pytest.mark.parametrize("name", COMMANDED)
def test_section(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")  # the width of the tables shown
    text = SECTIONS[name]
    for file, content in re.findall(r"^```toml\n# (\S+)\n(.*?)^```", text, re.M | re.S):
        Path(file).write_text(content, encoding="utf-8")
    for block in re.findall(r"^```console\n(.*?)^```", text, re.M | re.S):
        run_block(block)
    named = {path for path in FILE.findall(text) if not (TOUR.parents[2] / path).exists()}
    missing = [path for path in named if not Path(path).exists()]
    assert not missing, f"named in the text, and not written: {missing}"


def run_block(block):
    """Run a console block and compare what is shown below each command."""
    status = 0
    for command, shown in re.findall(r"^\$ (.+)\n((?:(?!\$ ).*\n)*)", block, re.M):
        if command == "echo $?":
            assert shown.strip() == str(status)
            status = 0
            continue
        assert status == 0, f"a failure that the tour does not show, before: {command}"
        program, *arguments = shlex.split(command)
        assert program == "slbench"
        outcome = run_cli(*arguments)
        status = outcome.status
        assert status in (0, 1), f"{command}: {outcome.err}"
        compare(command, shown, outcome.out)
    assert status == 0, "a failure that the tour does not show"


def compare(command, shown, printed):
    """Find the shown lines among the printed ones, in their order."""
    lines = iter(printed.splitlines())
    gap = False
    for expected in shown.splitlines():
        if expected.strip() == "...":
            gap = True
            continue
        for line in lines:
            if alike(expected, line):
                break
            if not gap:
                pytest.fail(f"{command}\nshown:   {expected}\nprinted: {line}")
        else:
            pytest.fail(f"{command}\nshown, but not printed: {expected}\n{printed}")
        gap = False


def alike(expected, line):
    """Tell whether two lines have the same words, and numbers that are close."""
    words = [" ".join(NUMBER.sub("#", plain(text)).split()) for text in (expected, line)]
    if words[0] != words[1]:
        return False
    pairs = zip(NUMBER.findall(plain(expected)), NUMBER.findall(plain(line)), strict=True)
    limit = 3.0 if "µm" in expected else 0.01  # the unit of a row, or of a number
    return all(close(float(a), float(b), limit) for a, b in pairs)


def plain(text):
    """Return a line without the frame of a table, whose width its numbers may change."""
    return re.sub("[│┃┡┩┏┓┗┛━┳╇┻─┴┼┬└┘┌┐├┤]", " ", text)


def close(x, y, limit):
    """Compare two numbers: within a tenth, or `limit`."""
    return abs(x - y) <= max(0.1 * max(abs(x), abs(y)), limit)


def test_the_comparison_can_fail():
    assert alike("│ median error │ 27.27 µm │", "│ median error │      28.1 µm │")
    assert not alike("│ median error │ 27.27 µm │", "│ median error │ 33.0 µm │")
    assert not alike("│ median error │ 27.27 µm │", "│ mean error │ 27.27 µm │")
    assert not alike("points: 50761", "points: 40761")
    with pytest.raises(pytest.fail.Exception, match="not printed"):
        compare("x", "...\nb 2\n", "a 1\nb 3\n")
    with pytest.raises(pytest.fail.Exception, match="shown"):
        compare("x", "a 1\nc 3\n", "a 1\nb 2\nc 3\n")
