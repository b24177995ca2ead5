"""Folders of results: nothing foreign is lost, nothing stale stays, nothing half reads as whole."""

import errno
import json
import os
import subprocess
import sys

import pytest

from slbench.core import io
from slbench.core.errors import InputError
from slbench.core.io import OutputFolder, files_beside
from slbench.core.io.marker import MARKER

SCAN = OutputFolder("scan", ("a.json", "frames", "b*.txt"))
OTHER = OutputFolder("decoded capture", ("c.json",))


def fill(folder, files, output=SCAN, **options):
    with output.writing(folder, {"p": 1}, 3, **options) as temporary:
        for name, text in files.items():
            (temporary / name).parent.mkdir(exist_ok=True)
            (temporary / name).write_text(text)


def tree(folder):
    paths = (path for path in folder.rglob("*") if not path.is_dir())
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in paths
        if path.name != "provenance.json"
    }


def refused(folder, files=None, output=SCAN):
    """Check that a folder is refused, before and at the writing, and that nothing changes."""
    before = tree(folder)
    with pytest.raises(InputError) as caught:
        output.check(folder)
    with pytest.raises(InputError):
        fill(folder, files or {"a.json": "new"}, output)
    assert tree(folder) == before
    return str(caught.value)


class TestProvenance:
    def test_lists_every_file_with_its_digest(self, tmp_path):
        fill(tmp_path / "o", {"a.json": "", "frames/0.png": "x"}, timings={"total": 1.5})
        made = io.read_json(tmp_path / "o" / "provenance.json")
        assert made["kind"] == "scan"
        assert made["timings_s"] == {"total": 1.5}
        assert made["parameters"] == {"p": 1}
        assert made["seed"] == 3
        # SHA-256 of nothing, FIPS 180-4.
        assert made["files"]["a.json"].startswith("e3b0c44298fc1c149afbf4c8996fb924")
        assert sorted(made["files"]) == ["a.json", "frames/0.png"]

    def test_equal_results_are_equal_files(self, tmp_path):
        for name in "xy":
            fill(tmp_path / name, {"a.json": "1"}, timings={"total": ord(name)})
        assert tree(tmp_path / "x") == tree(tmp_path / "y")


class TestForeign:
    @pytest.mark.parametrize("name", ["a.json", "frames/IMG_1.CR2", "frames/deep/x", "b1.txt"])
    def test_files_where_results_go_are_a_refusal(self, tmp_path, name):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("photo")
        assert name in refused(tmp_path)

    def test_files_elsewhere_stay(self, tmp_path):
        (tmp_path / "notes").mkdir()
        (tmp_path / "notes" / "a").write_text("mine")
        (tmp_path / "c.txt").write_text("mine")
        fill(tmp_path, {"a.json": "1"})
        fill(tmp_path, {"frames/0": "2"})
        assert tree(tmp_path) == {"notes/a": "mine", "c.txt": "mine", "frames/0": "2"}

    def test_what_file_managers_leave_stays_and_is_in_nobodys_way(self, tmp_path):
        fill(tmp_path, {"frames/0": "1", "a.json": "1"})
        (tmp_path / "frames" / ".DS_Store").write_text("x")
        (tmp_path / "frames" / "Thumbs.db").write_text("x")
        fill(tmp_path, {"a.json": "2"})
        assert sorted(tree(tmp_path)) == ["a.json", "frames/.DS_Store", "frames/Thumbs.db"]

    def test_a_result_that_somebody_changed_is_theirs(self, tmp_path):
        fill(tmp_path, {"a.json": "1", "frames/0": "1"})
        (tmp_path / "frames" / "0").write_text("2")
        assert "changed" in refused(tmp_path, {"a.json": "3"})

    def test_links_are_not_followed(self, tmp_path):
        (tmp_path / "photos").mkdir()
        (tmp_path / "photos" / "0").write_text("photo")
        (tmp_path / "o").mkdir()
        (tmp_path / "o" / "frames").symlink_to(tmp_path / "photos")
        refused(tmp_path / "o", {"frames/0": "new"})
        (tmp_path / "o" / "frames").unlink()
        (tmp_path / "o" / "a.json").symlink_to(tmp_path / "photos" / "0")
        refused(tmp_path / "o")
        assert (tmp_path / "photos" / "0").read_text() == "photo"

    def test_a_file_or_folder_of_the_other_sort_is_a_refusal(self, tmp_path):
        (tmp_path / "frames").write_text("a file")
        refused(tmp_path, {"frames/0": "new"})
        (tmp_path / "frames").unlink()
        (tmp_path / "a.json").mkdir()
        (tmp_path / "a.json" / "x").write_text("in it")
        refused(tmp_path)

    def test_another_kind_of_result_is_a_refusal(self, tmp_path):
        fill(tmp_path, {"a.json": "1"})
        assert "which holds a scan" in refused(tmp_path, {"c.json": "1"}, OTHER)

    @pytest.mark.parametrize(
        "text", ["", "{}", "[1]", '{"kind": "scan"}', '{"kind": 1, "files": 2}']
    )
    def test_a_provenance_of_others_is_a_refusal(self, tmp_path, text):
        (tmp_path / "provenance.json").write_text(text)
        assert "provenance.json" in refused(tmp_path)

    def test_a_list_that_leads_out_of_the_folder_removes_nothing(self, tmp_path):
        (tmp_path / "mine").write_text("")
        fill(tmp_path / "o", {"a.json": ""})
        made = json.loads((tmp_path / "o" / "provenance.json").read_text())
        made["files"] |= {"../mine": made["files"]["a.json"], str(tmp_path / "mine"): "x"}
        (tmp_path / "o" / "provenance.json").write_text(json.dumps(made))
        fill(tmp_path / "o", {"frames/0": "1"})
        assert (tmp_path / "mine").exists()

    def test_a_name_that_comes_up_in_the_middle_of_the_work_is_a_refusal(self, tmp_path):
        def write():
            with SCAN.writing(tmp_path, {}, None) as temporary:
                (temporary / "not-announced").write_text("new")
                (tmp_path / "not-announced").write_text("mine")

        with pytest.raises(InputError):
            write()
        assert tree(tmp_path) == {"not-announced": "mine"}


class TestStale:
    def test_what_is_not_made_again_is_not_there(self, tmp_path):
        for folder in (tmp_path / "fresh", tmp_path):
            fill(folder, {"a.json": "1", "frames/0": "1", "frames/1": "1", "b.txt": "1"})
            fill(folder, {"a.json": "2", "frames/0": "2"})
            assert {k: v for k, v in tree(folder).items() if "fresh" not in k} == {
                "a.json": "2",
                "frames/0": "2",
            }
        fill(tmp_path, {"a.json": "3"})
        assert not (tmp_path / "frames").exists()

    def test_a_failed_run_leaves_the_earlier_result(self, tmp_path):
        fill(tmp_path / "o", {"a.json": "1"})

        def write():
            with SCAN.writing(tmp_path / "o", {}, None) as temporary:
                (temporary / "a.json").write_text("2")
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            write()
        assert tree(tmp_path / "o") == {"a.json": "1"}
        assert os.listdir(tmp_path) == ["o"]


KILLED = """
import os, sys
from pathlib import Path
count, real = int(sys.argv[2]), {name: getattr(os, name) for name in ("replace", "unlink", "rmdir")}
def dying(name):
    def call(*args, **kwargs):
        global count
        count -= 1
        if count < 0:
            os._exit(9)
        return real[name](*args, **kwargs)
    return call
from slbench.core.io import OutputFolder
for name in real:
    setattr(os, name, dying(name))
output = OutputFolder("scan", ("a.json", "frames", "b*.txt"))
with output.writing(Path(sys.argv[1]), {}, None) as temporary:
    (temporary / "frames").mkdir()
    for name in ("a.json", "frames/0", "frames/2"):
        (temporary / name).write_text("new")
"""
OLD = {"a.json": "old", "frames/0": "old", "frames/1": "old", "b.txt": "old"}
NEW = {"a.json": "new", "frames/0": "new", "frames/2": "new"}


class TestKilled:
    def test_at_every_move_a_folder_is_old_or_new_or_marked(self, tmp_path):
        states = []
        for count in range(60):
            folder = tmp_path / str(count) / "o"
            fill(folder, OLD)
            killed = subprocess.run([sys.executable, "-c", KILLED, str(folder), str(count)])
            marked = (folder / MARKER).exists()
            files = {k: v for k, v in tree(folder).items() if not k.startswith(".")}
            states.append("marked" if marked else "old" if files == OLD else "new")
            if marked:
                for name in files:
                    with pytest.raises(InputError, match="cut off"):
                        io.atomic.existing(folder / name)
            else:
                assert files in (OLD, NEW)
            fill(folder, {"a.json": "again"})
            assert tree(folder) == {"a.json": "again"}
            assert os.listdir(folder.parent) == ["o"]
            if killed.returncode == 0:
                break
        assert killed.returncode == 0
        assert states.count("marked") >= 6  # two removed, three and the provenance moved in
        assert states == sorted(states, key=["old", "marked", "new"].index)

    def test_only_what_the_mark_lists_is_refused(self, tmp_path):
        (tmp_path / MARKER).write_text('{"kind": "scan", "files": {"frames/0": []}}')
        (tmp_path / "frames").mkdir()
        for name in ("frames/0", "frames/1", "mine"):
            (tmp_path / name).write_text("")
        with pytest.raises(InputError, match="cut off"):
            io.atomic.existing(tmp_path / "frames" / "0")
        io.atomic.existing(tmp_path / "frames" / "1")
        io.atomic.existing(tmp_path / "mine")

    @pytest.mark.parametrize("text", ["", "{", "[]", "{}", "\xff"])
    def test_a_mark_that_cannot_be_read_holds_for_all(self, tmp_path, text):
        (tmp_path / MARKER).write_text(text, encoding="latin-1")
        (tmp_path / "a").write_text("")
        with pytest.raises(InputError, match="cut off"):
            io.atomic.existing(tmp_path / "a")
        with pytest.raises(InputError, match="cut off"):
            SCAN.check(tmp_path)


class TestFull:
    """A disk that is full: in the place of one, a limit on a file's size, and a failing write."""

    def test_of_a_file_in_a_folder_names_it_and_leaves_nothing(self, tmp_path, monkeypatch):
        fill(tmp_path / "o", {"a.json": "old"})

        def full(path, content):
            path.open("wb").close()
            raise OSError(errno.ENOSPC, "No space left on device")

        def write():
            with SCAN.writing(tmp_path / "o", {}, None) as temporary:
                io.write_json(temporary / "a.json", 1)

        monkeypatch.setattr("pathlib.Path.write_bytes", full)
        with pytest.raises(InputError) as caught:
            write()
        line = str(caught.value)
        assert str(tmp_path / "o" / "a.json") in line
        assert "No space left on device" in line
        assert tree(tmp_path) == {"o/a.json": "old"}


class TestPaths:
    def test_are_checked_before_the_work(self, tmp_path):
        (tmp_path / "file").write_text("")
        for folder in (tmp_path / "file", tmp_path / "file" / "o", tmp_path / ("n" * 256)):
            with pytest.raises(InputError) as caught:
                SCAN.check(folder, "--out")
            assert str(caught.value).startswith("--out: expected")
        with pytest.raises(InputError):
            SCAN.check("a\0b")
        SCAN.check(tmp_path / ("n" * 255))
        assert os.listdir(tmp_path) == ["file"]

    def test_a_folder_that_may_not_be_written_to_is_a_refusal(self, tmp_path, monkeypatch):
        # Root may write everywhere: the answer of the system is replaced.
        monkeypatch.setattr(os, "access", lambda path, mode: False)
        with pytest.raises(InputError, match="may be written to"):
            SCAN.check(tmp_path / "o")

    def test_the_longest_name_can_be_written(self, tmp_path):
        fill(tmp_path / ("n" * 255), {"a.json": "1"})
        fill(tmp_path / ("n" * 255), {"a.json": "2"})
        io.write_json(tmp_path / ("m" * 250 + ".json"), 1)

    def test_the_folder_that_one_stands_in(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "kept").write_text("x")
        fill(".", {"a.json": "1"})
        assert tree(tmp_path) == {"kept": "x", "a.json": "1"}


class TestFilesBeside:
    def test_have_a_list_of_their_own(self, tmp_path):
        (tmp_path / "provenance.json").write_text("another's")
        (tmp_path / "photo-depth.exr").write_text("mine")
        one, two = (files_beside("fused", tmp_path / name) for name in ("one.png", "photo.png"))
        fill(tmp_path, {"one.png": "1", "one-depth.exr": "1"}, one)
        fill(tmp_path, {"one.png": "2"}, one)
        assert not (tmp_path / "one-depth.exr").exists()
        assert (tmp_path / "one-provenance.json").exists()
        with pytest.raises(InputError):
            two.check(tmp_path)
