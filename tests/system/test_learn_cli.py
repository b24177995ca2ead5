"""``design patterns --learn``, and the example that learns patterns."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from scenes_small import check_refused, run_cli, write_scene

from slbench.patterns import read_patterns

DOCS = Path(__file__).parents[2] / "docs"
LEARN = ("design", "patterns", "--learn")


def test_without_pytorch_it_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    outcome = run_cli(*LEARN, "--scene", "plane", "--out", tmp_path / "out")
    check_refused(outcome, "package torch", "pip install 'slbench[torch]'")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--learn", "--scene", "plane", "--criterion", "bounded"], "--criterion"),
        (["--learn", "--scene", "plane", "--width-px", "400"], "--width-px"),
        (["--noise-rad", "0.1", "--steps", "50"], "--steps: expected only with --learn"),
        (["--noise-rad", "0.1", "--held-out", "plane"], "--held-out"),
        (["--noise-rad", "0.1", "--binary"], "--binary: expected only with --learn"),
        (["--noise-rad", "0.1", "--seeds", "2"], "--seeds: expected only with --learn"),
    ],
)
def test_options_that_would_be_ignored_are_refused(options, said):
    check_refused(run_cli("design", "patterns", *options), said)


class TestLearning:
    @pytest.fixture(autouse=True)
    def torch(self):
        return pytest.importorskip("torch", reason="PyTorch (the extra `torch`) is not installed")

    def test_needs_one_source_of_light(self):
        check_refused(run_cli(*LEARN), "either --scene or --data", "neither")
        both = run_cli(*LEARN, "--scene", "plane", "--data", "data")
        check_refused(both, "either --scene or --data", "both")
        check_refused(run_cli(*LEARN, "--data", "nowhere", "--preview"), "--preview")

    @pytest.mark.slow
    def test_a_scene_is_learned_on_and_the_set_compared(self, tmp_path):
        scene, out = write_scene(tmp_path), tmp_path / "set"
        options = ("--steps", 60, "--scans", 2, "--max-fringes", 24, "--out", out)
        made = run_cli(*LEARN, "--scene", scene, *options)
        assert made.status == 0, made.err
        assert "judged on the scene that it was learned on" in made.out
        assert "The learned set" in made.out
        stated = json.loads((out / "learned.json").read_text())
        assert stated["frames"] == 6
        assert stated["verdict"]["best"] in made.out
        compared = run_cli(
            *("compare", scene, "--set", out, "--set", "1,8@3", "--repeats", 2),
            *("--out", tmp_path / "compared"),
        )
        assert compared.status == 0, compared.err
        panel = (640, 480)
        written = run_cli(
            *("patterns", "write", out, "--panel", f"{panel[0]}x{panel[1]}"),
            *("--out", tmp_path / "session"),
        )
        assert written.status == 0, written.err
        assert len(list((tmp_path / "session" / "patterns").glob("*.png"))) == 6

    @pytest.mark.slow
    def test_binary_codes_of_several_seeds_are_judged_together(self, tmp_path):
        scene, out = write_scene(tmp_path), tmp_path / "sets"
        options = ("--steps", 60, "--scans", 2, "--max-fringes", 24, "--seed", 3, "--seeds", 2)
        made = run_cli(*LEARN, "--scene", scene, "--binary", *options, "--out", out)
        assert made.status == 0, made.err
        assert "over 2 seeds" in made.out
        whole = json.loads((out / "learned.json").read_text())
        assert whole["seeds"] == [3, 4]
        assert whole["ratio_ci95"][0] <= whole["ratio"] <= whole["ratio_ci95"][1]
        for k, verdict in zip(whole["seeds"], whole["verdicts"], strict=True):
            own = json.loads((out / f"seed-{k}" / "learned.json").read_text())
            assert own["verdict"] == verdict
            assert own["binary"]
            assert own["blur_px"] > 0.75
            read = read_patterns(out / f"seed-{k}", (640, 480)).sequence
            assert set(np.unique(read.images())) == {0.0, 1.0}
            assert read.parts[0].blur_px == own["blur_px"]
        again = run_cli(*LEARN, "--scene", scene, "--binary", *options, "--out", out)
        assert again.status == 0, again.err  # its own folder is replaced

    @pytest.mark.slow
    def test_the_example_learns_patterns_that_hold_on_unseen_scenes(self, tmp_path):
        out = tmp_path / "data"
        spec = DOCS / "examples" / "patterns.toml"
        made = run_cli("dataset", "make", spec, "--out", out, "--count", 8, "--workers", 0)
        assert made.status == 0, made.err
        path = DOCS / "examples" / "learn_patterns.py"
        loading = importlib.util.spec_from_file_location("learn_patterns", path)
        example = importlib.util.module_from_spec(loading)
        loading.loader.exec_module(example)
        pairs = example.main(out, steps=500, out=tmp_path / "set")
        # A fifth of its steps, on a quarter of its scenes: no far cry from fringes, which it passes
        # in full (the page says by how much).
        assert len(pairs) == 2
        assert all(pair.ratio < 1.5 for pair in pairs)
        assert (tmp_path / "set" / "patterns.toml").is_file()
