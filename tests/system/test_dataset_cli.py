"""``slbench dataset make``, ``verify`` and ``info`` from the command line."""

import json
import shutil
import subprocess
import sys

import pytest
from dataset_specs import hashes, rows_of, write_spec
from scenes_small import check_refused, run_cli

from slbench.datasets import tasks
from slbench.datasets.make import make_sample


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make a data set of three samples in this process."""
    folder = tmp_path_factory.mktemp("cli")
    spec = write_spec(folder)
    out = folder / "set"
    outcome = run_cli(
        "dataset", "make", spec, "--out", out, "--count", 3, "--workers", 0, "--seed", 3, "--json"
    )
    assert outcome.status == 0, outcome.err
    return spec, out, json.loads(outcome.out)


class TestMake:
    def test_it_says_what_it_did(self, made):
        _, out, said = made
        assert said["out"] == str(out)
        assert (said["count"], said["made"], said["kept"], said["failed"]) == (3, 3, 0, 0)
        assert 0.0 <= said["rejection_rate"] < 1.0
        assert said["samples_per_second"] > 0

    def test_the_card_shows_what_is_there(self, made):
        _, out, _ = made
        card = (out / "README.md").read_text()
        for word in ("CC0-1.0", "3 of 3", "height_mm", "uniform from 1 to 5", "p0r1", "extends"):
            assert (word in card) == (word != "extends")
        for name in ("samples", "heights", "drawn"):
            assert f"card/{name}.png" in card
            assert (out / "card" / f"{name}.png").read_bytes()[:4] == b"\x89PNG"

    def test_a_finished_one_is_kept(self, made):
        spec, out, _ = made
        before = hashes(out)
        outcome = run_cli(
            *("dataset", "make", spec, "--out", out, "--count", 3, "--seed", 3, "--workers", 0),
            "--resume",
        )
        assert outcome.status == 0, outcome.err
        assert "0 made, 3 kept" in outcome.out
        assert hashes(out) == before

    @pytest.mark.slow
    def test_worker_processes_make_the_same(self, made, tmp_path):
        spec, out, _ = made
        words = ["make", spec, "--out", tmp_path / "set", "--count", 1, "--workers", 1]
        child = subprocess.run(
            [sys.executable, "-m", "slbench.cli", "dataset", *map(str, words), "--seed", "3"],
            capture_output=True,
            text=True,
        )
        assert child.returncode == 0, child.stderr
        assert "dashboard: http://127.0.0.1:" in child.stderr
        assert "samples 1/1" in child.stderr
        assert hashes(tmp_path / "set") == hashes(out)[:1]

    def test_failed_samples_are_told_by_the_exit_status(self, made, tmp_path, monkeypatch):
        def broken(specification, files, seed, sample, **options):
            if sample == 0:
                raise RuntimeError("no light")
            return make_sample(specification, files, seed, sample, **options)

        monkeypatch.setattr(tasks, "make_sample", broken)
        out = tmp_path / "set"
        outcome = run_cli(
            "dataset", "make", made[0], "--out", out, "--count", 2, "--workers", 0, "--json"
        )
        assert outcome.status == 1
        assert json.loads(outcome.out)["failed"] == 1
        assert "no light" in (out / "README.md").read_text()
        assert rows_of(out)[1]["status"] == "ok"


class TestVerifyAndInfo:
    def test_a_whole_one(self, made):
        outcome = run_cli("dataset", "verify", made[1])
        assert outcome.status == 0
        assert outcome.out.startswith("whole: 3 samples")
        assert json.loads(run_cli("dataset", "verify", made[1], "--json").out)["problems"] == []

    def test_a_damaged_one(self, made, tmp_path):
        shutil.copytree(made[1], tmp_path / "set")
        shard = tmp_path / "set" / "shards" / "000000.tar"
        content = bytearray(shard.read_bytes())
        content[5000] ^= 1
        shard.write_bytes(content)
        outcome = run_cli("dataset", "verify", tmp_path / "set")
        assert outcome.status == 1
        assert "000000.tar: sample 000000" in outcome.out
        found = json.loads(run_cli("dataset", "verify", tmp_path / "set", "--json").out)
        assert len(found["problems"]) == 1

    def test_info(self, made):
        outcome = run_cli("dataset", "info", made[1], "--json")
        found = json.loads(outcome.out)
        assert outcome.status == 0
        assert (found["samples"], found["count"], found["seed"]) == (3, 3, 3)
        assert sum(found["kinds"].values()) == 3
        assert found["bytes_per_sample"] == pytest.approx(found["bytes"] / 3)
        assert "licence" in run_cli("dataset", "info", made[1]).out


class TestRefused:
    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (("make", "nothing", "--out", "x", "--count", 1), ("mixed", "'nothing'")),
            (("make", "mixed", "--out", "x", "--count", 0), ("--count",)),
            (("make", "mixed", "--out", "x"), ("--count",)),
            (
                ("make", "mixed", "--out", "x", "--count", 1, "--scheduler", "a", "--workers", 1),
                ("--workers",),
            ),
            (("make", "mixed", "--out", "no-such-protocol://x", "--count", 1), ("no-such",)),
            (("verify", "no-such-folder"), ("dataset.json",)),
            (("info", "no-such-folder"), ("dataset.json",)),
        ],
    )
    def test_bad_input_is_one_line(self, words, said, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        check_refused(run_cli("dataset", *words), *said)
        assert list(tmp_path.iterdir()) == []

    def test_a_folder_with_something_in_it(self, made):
        spec, out, _ = made
        outcome = run_cli("dataset", "make", spec, "--out", out, "--count", 3, "--workers", 0)
        check_refused(outcome, "--resume")

    def test_a_missing_package_says_how_to_get_it(self, made, monkeypatch):
        for name in ("fsspec", "fsspec.core"):
            monkeypatch.setitem(sys.modules, name, None)
        check_refused(run_cli("dataset", "verify", made[1]), "fsspec", "slbench[datasets]")
