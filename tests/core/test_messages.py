"""One line a message: what is said at once, what is kept, what a refusal drops."""

import os
import subprocess
import sys
import threading
import warnings

import pytest

from slbench.core.errors import InputWarning, warn_user
from slbench.core.messages import one_line_messages


def native(text: str) -> None:
    """Print as a library of C does: to the descriptor, behind Python's back."""
    os.write(2, text.encode())


def test_doubts_are_said_at_once_and_once(capfd):
    with one_line_messages():
        for _ in range(3):
            warn_user("a.toml: pitch_um", "0.003\n is a pitch in mm")
        assert capfd.readouterr().err == "warning: a.toml: pitch_um: 0.003 is a pitch in mm\n"
    assert capfd.readouterr().err == ""


def test_libraries_are_heard_at_the_end_without_their_source(capfd):
    with one_line_messages():
        warnings.warn("overflow encountered in multiply", RuntimeWarning, stacklevel=1)
        native("libpng warning: iCCP\nlibpng warning: iCCP\n\n")
        print("bar", file=sys.stderr)
        assert capfd.readouterr().err == "bar\n"
    assert capfd.readouterr().err.splitlines() == [
        "warning: overflow encountered in multiply (RuntimeWarning)",
        "warning: libpng warning: iCCP",
    ]


def test_a_refusal_drops_what_libraries_said(capfd):
    with one_line_messages() as messages:
        warn_user("a.toml", "odd")
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        native("(EXR_ERR_CORRUPT_CHUNK) corrupt\n")
        messages.refused = True
        print("error: a.toml: wrong", file=sys.stderr)
    assert capfd.readouterr().err == "warning: a.toml: odd\nerror: a.toml: wrong\n"


def test_who_looks_for_a_fault_hears_everything(capfd):
    with one_line_messages(raw=True):
        native("libpng error: x\n")
        assert capfd.readouterr().err == "libpng error: x\n"
        with pytest.warns(RuntimeWarning, match="overflow"):
            warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        warn_user("a.toml", "odd")
    assert capfd.readouterr().err == "warning: a.toml: odd\n"


def test_threads_write_past_each_other(capfd):
    """Chatter of one thread never takes a line of Python from another."""
    start = threading.Barrier(8)

    def work(k: int) -> None:
        start.wait()
        for i in range(50):
            native(f"libpng warning: {k}\n")
            sys.stderr.write(f"line {k} {i}\n")

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    with one_line_messages():
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    lines = capfd.readouterr().err.splitlines()
    assert sorted(lines[:400]) == sorted(f"line {k} {i}" for k in range(8) for i in range(50))
    assert sorted(lines[400:]) == [f"warning: libpng warning: {k}" for k in range(8)]


def test_a_flood_is_cut(capfd):
    with one_line_messages():
        native("".join(f"libtiff: {i} {'x' * 2000}\n" for i in range(1000)))
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) < 30
    assert max(map(len, lines)) < 600
    assert "--debug" in lines[-1]


def test_everything_is_as_before_afterwards(capfd):
    stream, show = sys.stderr, warnings.showwarning
    with pytest.raises(KeyError), one_line_messages():
        raise KeyError
    assert (sys.stderr, warnings.showwarning) == (stream, show)
    native("outside\n")
    assert capfd.readouterr().err == "outside\n"


def test_a_program_may_turn_doubts_into_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        with pytest.raises(InputWarning, match="a: b"):
            warn_user("a", "b")


@pytest.mark.parametrize("closed", [False, True])
def test_in_a_process_of_its_own(closed, tmp_path):
    """Also where descriptor 2 is closed: the next file opened must not get the chatter."""
    code = (
        "import os, sys\n"
        "from slbench.core.messages import one_line_messages\n"
        "with one_line_messages():\n"
        "    file = open('precious', 'w')\n"
        "    os.write(2, b'chatter\\n')\n"
        "    file.close()\n"
    )
    command = [sys.executable, "-c", code]
    if closed:
        command = ["sh", "-c", 'exec "$0" "$@" 2>&-', *command]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr == ("" if closed else "warning: chatter\n")
    assert (tmp_path / "precious").read_text() == ""
