"""Temporary folders: theirs for as long as a process lives, nobody's afterwards."""

import os
import signal
import subprocess
import sys

import pytest

from slbench.core.io.scratch import is_scratch, scratch_folder, temporary_folder

HOLDER = """
import sys, time
from pathlib import Path
from slbench.core.io.scratch import scratch_folder
with scratch_folder(Path(sys.argv[1]), "a") as folder:
    (folder / "half").write_text("x")
    print(folder.name, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """A process that is in the middle of writing."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert is_scratch(child.stdout.readline().strip())
        yield child
        child.kill()


def test_nothing_stays_of_a_block_that_ends(tmp_path):
    with scratch_folder(tmp_path, "a") as folder:
        (folder / "x").write_text("x")
        assert is_scratch(folder.name)
    with pytest.raises(KeyboardInterrupt), scratch_folder(tmp_path, "a"):
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == []


def test_a_folder_of_a_process_that_lives_is_left_alone(tmp_path, holder):
    with scratch_folder(tmp_path, "a"):
        pass
    assert len(os.listdir(tmp_path)) == 1


def test_a_folder_of_a_killed_process_is_removed_by_the_next_of_its_name(tmp_path, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with scratch_folder(tmp_path, "b"):
        assert len(os.listdir(tmp_path)) == 2  # another's business
    with scratch_folder(tmp_path, "a"):
        assert len(os.listdir(tmp_path)) == 1
    assert os.listdir(tmp_path) == []


def test_what_only_looks_alike_stays(tmp_path):
    names = [".a.0123456789ab", "a.0123456789ab.slbench", ".a.notes.slbench", ".a.0123456789ab.txt"]
    for name in names:
        (tmp_path / name).mkdir()
    (tmp_path / ".a.00112233aabb.slbench").write_text("a file")
    with scratch_folder(tmp_path, "a"):
        pass
    assert sorted(os.listdir(tmp_path)) == sorted([*names, ".a.00112233aabb.slbench"])


def test_a_name_as_long_as_can_be_is_no_hindrance(tmp_path):
    with scratch_folder(tmp_path, "n" * 255) as folder:
        (folder / ("n" * 255)).write_text("x")


def test_temporary_folders_are_their_owners_alone():
    with temporary_folder("test") as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
