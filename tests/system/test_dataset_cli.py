"""``slbench dataset make``, ``verify`` and ``info`` from the command line."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import types
import warnings

import pytest
from dataset_specs import hashes, rows_of, write_spec
from scenes_small import check_refused, run_cli

from slbench.datasets.make import cluster, engine, tasks
from slbench.datasets.make import sample_maker as make
from slbench.datasets.make.sample_maker import make_sample
from slbench.report.pages.dataset import histograms


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

    def test_the_card_shows_a_logarithmic_jitter_that_crosses_zero(self):
        place = {"log_uniform": [0.5, 10.0], "add": True, "base": -3.0}
        objects = [{"name": "a", "kind": "sphere", "weight": 1, "position_mm": [place, 0.0, 0.0]}]
        specification = {"name": "a", "scene": {"rig": {}}, "objects": objects}
        manifest = types.SimpleNamespace(
            drawn=("x_mm",), columns={"x_mm": "double"}, specification=specification
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            picture = histograms(manifest, [{"x_mm": value} for value in (-2.5, 0.0, 7.0)])
        assert picture.png[:4] == b"\x89PNG"

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

    def test_another_kind_of_processor_is_refused(self, made, monkeypatch):
        # BLAS and NumPy have kernels a processor, whose last bits differ, and so do the samples.
        said = json.loads((made[1] / "dataset.json").read_text())["environment"]["libraries"]
        for name in ("OpenEXR", "matplotlib", "zlib", "BLAS kernels", "NumPy kernels"):
            assert said[name]
        other = [{"user_api": "blas", "architecture": "Abacus"}]
        monkeypatch.setattr(make, "threadpool_info", lambda: other)
        outcome = run_cli(
            *("dataset", "make", made[0], "--out", made[1], "--count", 3, "--seed", 3),
            *("--workers", 0, "--resume"),
        )
        check_refused(outcome, "BLAS kernels", said["BLAS kernels"], "Abacus")

    @pytest.mark.slow
    def test_worker_processes_make_the_same(self, made, tmp_path):
        spec, out, _ = made
        words = ["make", spec, "--out", tmp_path / "set", "--count", 1, "--workers", 1]
        child = subprocess.run(
            [sys.executable, "-m", "slbench", "dataset", *map(str, words), "--seed", "3"],
            capture_output=True,
            text=True,
        )
        assert child.returncode == 0, child.stderr
        assert "dashboard" not in child.stderr  # what others of this machine could read
        assert "samples 1/1" in child.stderr
        assert hashes(tmp_path / "set") == hashes(out)[:1]

    @pytest.mark.slow
    def test_an_interrupt_from_the_terminal_is_one_line(self, made, tmp_path):
        out = tmp_path / "set"
        words = ["make", made[0], "--out", out, "--count", 50, "--workers", 2]
        child = subprocess.Popen(
            [sys.executable, "-m", "slbench", "dataset", *map(str, words)],
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        limit = time.monotonic() + 100.0
        while not list(out.glob("staging/*")) and time.monotonic() < limit:
            time.sleep(0.1)
        os.killpg(child.pid, signal.SIGINT)  # as Ctrl-C: to the workers too
        _, said = child.communicate(timeout=60)
        assert (child.returncode, said) == (130, "interrupted\n")
        check_refused(run_cli("dataset", "info", out), "index.parquet", "--resume")

    def test_an_interrupt_is_one_word(self, made, tmp_path, monkeypatch):
        def interrupted(*arguments, **options):
            raise KeyboardInterrupt

        monkeypatch.setattr(engine, "make_dataset", interrupted)
        words = ("make", made[0], "--out", tmp_path / "set", "--count", 2, "--workers", 0)
        outcome = run_cli("dataset", *words)
        assert (outcome.status, outcome.out) == (130, "")
        assert outcome.err == "interrupted\n"

    def test_workers_are_told_the_whole_path(self, made, tmp_path, monkeypatch):
        told = []

        def noted(specification, files, url, *arguments, **options):
            told.append(url)
            raise KeyboardInterrupt

        monkeypatch.setattr(engine, "make_dataset", noted)
        monkeypatch.chdir(tmp_path)
        for out in ("set", "file://set", "memory://set"):
            run_cli("dataset", "make", made[0], "--out", out, "--count", 2, "--workers", 0)
        assert told == [str(tmp_path / "set"), str(tmp_path / "set"), "memory://set"]

    def test_a_port_that_is_taken_is_no_matter(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # One of the two would find Dask's own port taken.
            with cluster.local_cluster(0), cluster.local_cluster(0) as own:
                assert own.dashboard is None

    def test_a_dashboard_is_told_of_only_where_there_is_one(self, monkeypatch):
        services = {"dashboard": 1}
        client = types.SimpleNamespace(
            dashboard_link="http://x", scheduler_info=lambda n_workers: {"services": services}
        )
        for bokeh, there, link in ((None, True, None), (1, True, "http://x"), (1, False, None)):
            services |= {"dashboard": 1}
            if not there:
                del services["dashboard"]
            monkeypatch.setattr(importlib.util, "find_spec", lambda name, found=bokeh: found)
            assert cluster._dashboard(client) == link

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

    def test_nothing_is_said_of_draws_where_all_samples_failed(self, made, tmp_path, monkeypatch):
        def broken(*arguments, **options):
            raise RuntimeError("no light")

        monkeypatch.setattr(tasks, "make_sample", broken)
        words = ("make", made[0], "--out", tmp_path / "set", "--count", 1, "--workers", 0)
        outcome = run_cli("dataset", *words)
        assert outcome.status == 1
        assert "1 failed; " in outcome.out
        assert "rejected" not in outcome.out


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

    def test_an_unfinished_one_says_how_to_finish_it(self, made, tmp_path):
        shutil.copytree(made[1], tmp_path / "set")
        (tmp_path / "set" / "index.parquet").unlink()
        check_refused(run_cli("dataset", "info", tmp_path / "set"), "index.parquet", "--resume")

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
            (("make", "mixed", "--out", "memory://x", "--count", 1), ("memory://x", "--workers 0")),
            (("verify", "ftp://127.0.0.1:1/x"), ("ftp://127.0.0.1:1/x", "fsspec")),
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
