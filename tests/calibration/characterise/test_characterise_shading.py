"""Characterisation returns the shading that was put in."""

import json

import numpy as np
import pytest
from characterised import repeats_of
from scenes_small import run_cli

from slbench.calibration.characterise.measure import characterise
from slbench.core.errors import InputError
from slbench.detector import Detector
from slbench.rig.optics.shading import shading
from slbench.scene.file import load_scene

DETECTORS = {"8 bit": Detector(8), "12 bit": Detector(12, 20_000.0, 10.0)}
SHAPE = (120, 160)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]]
PIXELS = np.stack([U, V], axis=-1)
#: A lens's mechanical vignetting, off its middle a little.
CAMERA = (0.02, -0.01, -0.12, 0.01, -0.08, 0.0, 0.0, 0.0, 0.0, -0.03, 0.0, -0.02, 0.0, -0.01)
#: A projector's, brighter to one side.
LAMP = (0.15, 0.0, -0.1, 0.0, -0.1)
CORNERS = np.array([[-0.5, -0.5], [159.5, -0.5], [-0.5, 119.5], [159.5, 119.5]])


def of(coefficients, places=PIXELS):
    return shading(coefficients, places, (SHAPE[1], SHAPE[0]))


def captured(detector, light, patterns="white+black", *, count=1, seed=0, name="run", level=0.8):
    shown = np.stack([light * (word == "white") for word in patterns.split("+")])
    found = repeats_of(detector, patterns, light=shown, count=count, seed=seed, level=level)
    return {f"{name}{k}": capture for k, capture in enumerate(found.values())}


@pytest.mark.parametrize("name", DETECTORS)
@pytest.mark.parametrize("level", [0.2, 0.8])
def test_the_cameras_shading_is_that_put_in(name, level):
    detector = DETECTORS[name]
    even = captured(detector, of(CAMERA), "white+black+white", name="even", seed=1, level=level)
    projected = captured(detector, of(CAMERA) * of(LAMP), "white+black+black", seed=2)
    found = characterise(projected, even=even)
    one = found["camera shading"]
    expected = float(of(CAMERA, CORNERS).mean())
    # 38,400 values of 1 to 2 % noise at 0.2, for 15 terms; beside the corners' own share, 0.1 %.
    assert one.value == pytest.approx(expected, abs=0.003)
    assert one.low < expected < one.high
    np.testing.assert_allclose(of(one.written["shading"]), of(CAMERA), atol=0.004)
    # What white lights is the product of both, or the lamp's where the camera's is known.
    lamp = found["white's shading"]
    assert lamp.value == pytest.approx(float(of(LAMP, CORNERS).mean()), abs=0.006)
    assert "camera's is taken out" in lamp.note


def test_white_alone_is_a_product_and_says_so():
    found = characterise(captured(DETECTORS["12 bit"], of(CAMERA) * of(LAMP), seed=3))
    one = found["white's shading"]
    product = of(CAMERA, CORNERS) * of(LAMP, CORNERS)
    # A product of degrees four and two, as a polynomial of degree four: 0.01 at the corners.
    assert one.value == pytest.approx(float(product.mean()), abs=0.01)
    assert "camera" in one.note
    assert not one.key
    (lost,) = (other for other in found.untold if other.name == "camera shading")
    assert "--even" in lost.capture


def test_intervals_hold_the_shading():
    """Of 20 intervals of 95 % more than five miss once in 3,000 times."""
    expected, missed = float(of(CAMERA, CORNERS).mean()), 0
    for seed in range(20):
        even = captured(DETECTORS["12 bit"], of(CAMERA), "white", name="even", seed=seed)
        one = characterise(captured(DETECTORS["12 bit"], of(LAMP)), even=even)["camera shading"]
        missed += not one.low <= expected <= one.high
    assert missed <= 5


def test_a_picture_that_is_not_filled_tells_no_shading():
    light = np.where(U < 80, 1.0, 0.0)
    found = characterise(captured(DETECTORS["12 bit"], light))
    with pytest.raises(InputError, match="50 % of the picture"):
        found["white's shading"]


def test_a_scene_has_the_shading_in_the_place_of_the_lenss(tmp_path):
    detector = DETECTORS["12 bit"]
    for folder in (
        captured(detector, of(CAMERA), "white+white", name="even"),
        captured(detector, of(LAMP), "white+black+black", seed=1),
    ):
        for name, capture in folder.items():
            capture.save(tmp_path / name)
    outcome = run_cli(
        "characterise", tmp_path / "run0", "--even", tmp_path / "even0", "--out",
        tmp_path / "hardware.toml", "--no-picture", "--json",
    )  # fmt: skip
    assert outcome.status == 0, outcome.err
    names = [one["name"] for one in json.loads(outcome.out)["quantities"]]
    assert "camera shading" in names
    (tmp_path / "mine.toml").write_text('extends = ["plane", "hardware.toml"]\nname = "mine"\n')
    camera = load_scene(tmp_path / "mine.toml").coarser(4, 4).rig.camera
    np.testing.assert_allclose(camera.relative_illumination(PIXELS), of(CAMERA), atol=0.004)


def test_an_even_folder_is_of_the_same_camera(tmp_path):
    even = captured(DETECTORS["8 bit"], of(CAMERA), "white", name="even")
    with pytest.raises(InputError, match="one camera"):
        characterise(captured(DETECTORS["12 bit"], of(LAMP)), even=even)
