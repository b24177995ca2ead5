"""The page datasets-use.md: snippets run, its example learns; data sets as `make` writes them."""

import importlib.util
import re
import time
from pathlib import Path

import datasets_small as small
import numpy as np
import pytest
from dataset_specs import write_spec
from scenes_small import run_cli

from slbench import datasets
from slbench.simulate.scan import scan

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "how-to" / "datasets-use.md"


def test_the_snippets_run_one_after_the_other(tmp_path, monkeypatch):
    pytest.importorskip("torch", reason="PyTorch (the extra `torch`) is not installed")
    small.write_dataset(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    # Those of other loaders and layouts are run by the tests of these.
    page = re.sub(
        r"^## (Without slbench|Other layouts)$.*?^(?=## )", "", PAGE.read_text(), flags=re.M | re.S
    )
    snippets = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    assert len(snippets) == 5
    scope = {}
    for code in snippets:
        exec(compile(code, PAGE.name, "exec"), scope)
    assert len(scope["shots"].frames) == 12
    assert len(scope["train"]) + len(scope["test"]) == len(scope["data"])
    assert scope["batch"]["frames"].shape[1:] == (6, 48, 64)


def test_what_make_writes_is_a_fresh_scan(tmp_path):
    spec, out = write_spec(tmp_path), tmp_path / "data"
    made = run_cli("dataset", "make", spec, "--out", out, "--count", 3, "--workers", 0)
    assert made.status == 0, made.err
    data = datasets.open_dataset(out)
    assert len(data) == 3
    for sample in data:
        for name in sample.captures:
            stored = sample.stored(name)
            seed = sample.score["captures"][name]["seed"]
            again = sample.capture(stored.sequence, seed=seed)
            np.testing.assert_array_equal(again.frames, stored.frames)
    sample = data[1]
    fresh = scan(sample.scene.with_patterns("1,10,50@4"), seed=sample.seed).capture
    mine = sample.capture("1,10,50@4", seed=sample.seed)
    np.testing.assert_array_equal(mine.frames, fresh.frames)
    assert mine.exposure_s == fresh.exposure_s


@pytest.mark.slow
def test_the_example_beats_its_baseline(tmp_path):
    pytest.importorskip("torch", reason="PyTorch (the extra `torch`) is not installed")
    out = tmp_path / "learn"
    spec = DOCS / "examples" / "learn.toml"
    made = run_cli("dataset", "make", spec, "--out", out, "--count", 48, "--workers", 0)
    assert made.status == 0, made.err
    path = DOCS / "examples" / "learn_depth.py"
    loading = importlib.util.spec_from_file_location("learn_depth", path)
    example = importlib.util.module_from_spec(loading)
    loading.loader.exec_module(example)
    start = time.process_time()
    baseline, network = example.main(out)
    print(
        f"\nright orders: baseline {baseline:.1%}, network {network:.1%}; "
        f"{time.process_time() - start:.0f} s of processor time"
    )
    # The page says 86.7 % and 97.3 %; the limits leave room for what other builds of PyTorch
    # and Mitsuba round otherwise, and are ten points apart.
    assert abs(baseline - 0.867) < 0.03
    assert network > 0.95 > baseline + 0.05
