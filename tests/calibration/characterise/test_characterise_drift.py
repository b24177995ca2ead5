"""Characterisation returns the drift that was put in."""

import json
import os

import numpy as np
import pytest
from characterised import light_of, repeats_of
from scenes_small import run_cli
from scipy.ndimage import gaussian_filter, shift

from slbench.calibration.characterise.drift import Series, fitted
from slbench.calibration.characterise.measure import characterise
from slbench.core.errors import InputError
from slbench.detector import Detector
from slbench.patterns import PatternSequence

DETECTOR = Detector(12, 20_000.0, 10.0)
PATTERNS = "white+black+1,8@4"
HOURS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
#: In a camera pixel lie four panel pixels.
STEP = 4.0


def drifting(px, light, *, texture=0.0, axis=1, seed=0):
    """Return captures whose pictures are moved by px (R,), and of (R,) more light."""
    sequence = PatternSequence.parse(PATTERNS, (640, 480), axes="u")
    still = light_of(sequence)
    if texture:
        rough = gaussian_filter(np.random.default_rng(9).normal(size=still.shape[1:]), 2.0)
        still = still * (0.8 + 0.15 * np.clip(rough / rough.std(), -1.0, 1.0) * texture)
    captures = {}
    for k, (moved, more) in enumerate(zip(px, light, strict=True)):
        place = (moved, 0.0) if axis == 0 else (0.0, moved)
        frames = [shift(frame, place, order=3, mode="nearest") * (1.0 + more) for frame in still]
        own = repeats_of(
            DETECTOR, PATTERNS, count=1, seed=seed + k, level=0.7, light=np.maximum(frames, 0.0)
        )
        captures[f"run{k}"] = own["run0"]
    return captures


def test_a_steady_drift_is_that_put_in():
    hours = np.array(HOURS)
    found = characterise(drifting(0.03 * hours, -0.004 * hours), hours=HOURS)
    # A picture's displacement is known to 0.001 px, 0.0002 px an hour.
    picture = found["drift of the fringes along u"]
    assert picture.value == pytest.approx(0.03, rel=0.03)
    assert picture.unit == "px an hour"
    # Where the picture went to the right, a pixel sees what lay to its left.
    coordinate = found["drift of coordinate u"]
    assert coordinate.value == pytest.approx(-0.03 * STEP, rel=0.03)
    # A million values of 1 % noise; the shaded picture's own motion changes its mean by 1e-4.
    light = found["drift of the light"]
    assert light.value == pytest.approx(-0.004, rel=0.03)
    for one in (picture, coordinate, light):
        assert one.high - one.low < 0.1 * abs(one.value)


def test_a_camera_that_moves_is_told_by_texture():
    hours = np.array(HOURS)
    captures = drifting(0.03 * hours, 0.0 * hours, texture=1.0, axis=0)
    found = characterise(captures, hours=HOURS)
    assert found["drift of the picture along v"].value == pytest.approx(0.03, rel=0.03)
    # The other axis is still: its drift is not told from none.
    one = found["drift of the picture along u"]
    assert abs(one.value) < 0.001


@pytest.mark.parametrize("tau", [0.7, 2.0])
def test_a_warm_up_is_that_put_in(tau):
    grown = 1.0 - np.exp(-np.array(HOURS) / tau)
    found = characterise(drifting(0.5 * grown, 0.05 * grown), hours=HOURS)
    for name, size in (
        ("the fringes along u", 0.5), ("coordinate u", -0.5 * STEP), ("the light", 0.05)
    ):  # fmt: skip
        one, time = found[f"warm-up of {name}"], found[f"warm-up time of {name}"]
        # Brighter fringes are steeper: without that, one in a hundred.
        assert one.value == pytest.approx(size, rel=0.005)
        assert time.value == pytest.approx(tau, rel=0.10)
        assert time.low < time.value < time.high
    assert not any(one.key for one in found.quantities if "warm-up" in one.name)


def test_intervals_hold_a_drift():
    """Of 200 intervals of 95 % more than 22 miss once in 5,000 times."""
    rng = np.random.default_rng(3)
    hours, missed, missed_time, told = np.array(HOURS), 0, 0, 0
    for _ in range(200):
        noise = rng.normal(0.0, 0.02, len(hours))
        (one,) = fitted(Series("it", "px", hours, 0.05 * hours + noise))
        missed += not one.low <= 0.05 <= one.high
        curve = 1.0 - np.exp(-hours / 1.5)
        warm = fitted(Series("it", "px", hours, curve + noise))
        told += len(warm) == 2
        missed_time += len(warm) == 2 and not warm[1].low <= 1.5 <= warm[1].high
    assert missed <= 22
    assert told == 200
    assert missed_time <= 22


def test_a_line_is_no_exponential_by_chance():
    rng = np.random.default_rng(4)
    hours = np.array(HOURS)
    curves = [
        len(fitted(Series("it", "px", hours, 0.05 * hours + rng.normal(0.0, 0.05, len(hours)))))
        for _ in range(200)
    ]
    # One in a hundred, twice so for the best of several time constants: 10 and more once in 400.
    assert curves.count(2) <= 10


@pytest.mark.parametrize(
    ("hours", "said"),
    [
        ((0.0, 1.0), "one a folder"),
        ((0.0, 2.0, 1.0), "times that grow"),
        ((0.0, 1.0, float("inf")), "times that grow"),
    ],
)
def test_times_are_one_a_folder_and_grow(hours, said):
    with pytest.raises(InputError, match=said):
        characterise(drifting(np.zeros(3), np.zeros(3)), hours=hours)


def test_the_command_takes_hours_or_the_times_of_files(tmp_path):
    folders = []
    for k, capture in enumerate(drifting(0.1 * np.arange(3), np.zeros(3)).values()):
        folders.append(tmp_path / f"run{k}")
        capture.save(folders[-1])
        for file in folders[-1].rglob("*.png"):
            os.utime(file, (3600.0 * k, 3600.0 * k))
    values = []
    for hours in ("0,1,2", "files"):
        outcome = run_cli(
            "characterise", *folders, "--hours", hours, "--out", tmp_path / "hardware.toml",
            "--no-picture", "--json",
        )  # fmt: skip
        assert outcome.status == 0, outcome.err
        found = {one["name"]: one["value"] for one in json.loads(outcome.out)["quantities"]}
        values.append(found["drift of coordinate u"])
    assert values[0] == pytest.approx(-0.4, rel=0.05)
    assert values[0] == pytest.approx(values[1])
    assert "# drift of coordinate u: " in (tmp_path / "hardware.toml").read_text()
    refused = run_cli("characterise", *folders, "--hours", "soon", "--out", tmp_path / "h.toml")
    assert refused.status == 2
    assert "0,0.5,1" in refused.err
