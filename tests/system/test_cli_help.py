"""The command line's help, and how it ends when something is wrong."""

import os
import subprocess
import sys

import pytest
from scenes_small import run_cli

from slbench import __version__
from slbench.cli import app
from slbench.core.errors import InputError


def walk(group, path=()):
    """Yield (words, command) of a group, of all that are in it, and of theirs."""
    yield path, group
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from walk(command, (*path, name))
        else:
            yield (*path, name), command


GROUPS = [path for path, command in walk(app) if hasattr(command, "commands")]
COMMANDS = [path for path, command in walk(app) if not hasattr(command, "commands")]


def test_the_commands_are_there():
    assert {(), ("design",), ("dataset",), ("calibrate",)} <= set(GROUPS)
    assert {("scan",), ("decode",), ("export",), ("doctor",), ("scene", "list")} <= set(COMMANDS)


def name(path):
    return " ".join(path) or "slbench"


@pytest.mark.parametrize("path", GROUPS, ids=name)
def test_a_group_alone_prints_its_help(path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    status, out, err = run_cli(*path)
    assert (status, err) == (0, "")
    assert out == run_cli(*path, "--help").out
    lines = out.splitlines()
    assert lines[0] == " ".join(["Usage: slbench", *path, "[OPTIONS] COMMAND [ARGS]..."])
    assert max(map(len, lines)) <= 80
    # One whole line for each command.
    group = dict(walk(app))[path]
    for command in group.commands:
        (line,) = [line for line in lines if line.startswith(f"  {command} ")]
        assert not line.endswith("..."), line


@pytest.mark.parametrize("path", COMMANDS, ids=name)
def test_every_help_has_an_example(path):
    status, text, err = run_cli(*path, "--help")
    assert (status, err) == (0, "")
    assert text.startswith(f"Usage: slbench {name(path)} ")
    example = text.partition("Example: ")[2].split()
    assert example[: 1 + len(path)] == ["slbench", *path]


def test_version():
    assert run_cli("--version") == (0, f"{__version__}\n", "")


def test_the_module_runs(tmp_path):
    command = [sys.executable, "-m", "slbench", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, __version__)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["scn", "plane"], "'scan'"),
        (["design", "rigs"], "'rig'"),
        (["scan", "plane", "--sed", "3"], "--seed"),
        (["scan", "plane", "--weights", "modulations"], "did you mean 'modulation'?"),
        (["bench", "ch66"], "chapter: expected ch3 or ch6 or ch7 or ch8 or calibrated or all"),
        (["fuse", "x", "--out", "y.png", "--align", "afine"], "did you mean 'affine'?"),
        (["scan", "plane", "--spp", "0"], "--spp: expected greater than or equal to 1, got '0'"),
    ],
)
def test_what_is_misspelt_is_refused_with_what_was_meant(words, said):
    status, out, err = run_cli(*words)
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert said in err


def ending(error, *options):
    """Run a command whose work ends in an error."""
    with pytest.MonkeyPatch.context() as patch:

        def work():
            raise error

        patch.setattr("slbench.simulate.doctor.diagnose", work)
        return run_cli("doctor", *options)


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InputError("a", "b", "c"), 2),
        (PermissionError(13, "Permission denied", "out"), 2),
        (MemoryError("3 GB"), 2),
        (ZeroDivisionError("by zero"), 70),
        (ValueError("of its own"), 70),
    ],
)
def test_errors_are_one_line_and_a_traceback_on_request(error, status):
    found = ending(error)
    assert (found.status, found.out) == (status, "")
    assert found.err.startswith("error: ")
    assert found.err.count("\n") == 1
    assert ("fault of slbench" in found.err) == (status == 70)
    for options in (["--debug"], ["--json", "--debug"]):
        whole = ending(error, *options)
        assert whole.status == status
        assert "Traceback" in whole.err
        assert whole.err.endswith(found.err)


def test_a_fault_names_its_place():
    assert "test_cli_help.py:" in ending(ZeroDivisionError()).err


def test_an_interrupt_ends_with_its_own_status():
    found = ending(KeyboardInterrupt())
    assert (found.status, found.out, found.err) == (130, "", "interrupted\n")


def test_a_reader_who_leaves_is_no_error():
    assert ending(BrokenPipeError()) == (0, "", "")


@pytest.mark.parametrize("command", [["objects", "list"], ["objects", "list", "--json"]])
def test_a_reader_who_has_gone_before_the_output_comes_is_no_failure(command):
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "slbench", *command]
    done = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")
