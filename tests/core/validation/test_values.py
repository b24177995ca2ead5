"""Values and arguments are refused by their types alone: one property a class, derived from it."""

import dataclasses
import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import wrong_values

import slbench
from slbench.bench.accept.standards import Standard, Temperature
from slbench.calibration.target.free import FreeBoard
from slbench.capture.capture import Capture, CaptureTable
from slbench.capture.captures import FolderTable
from slbench.capture.focus import Focus
from slbench.core.errors import InputError
from slbench.core.validation.types import Percentile, Samples
from slbench.core.validation.values import checked
from slbench.datasets.manifest import Manifest
from slbench.datasets.read.recipe import Recipe
from slbench.design.adaptive.shots import DimmedFringes
from slbench.design.rig.hardware import Sweep, load_hardware
from slbench.detector.emva1288 import Detector
from slbench.objects import load_artefact
from slbench.patterns import Fringes, NoiseModel, PatternSequence, pattern_codes
from slbench.patterns.given import PatternsTable
from slbench.patterns.images import Images
from slbench.patterns.sequence import SequenceTable
from slbench.rig import Camera, DesignVariables, Device, Lens, Projector, Rig
from slbench.rig.motion import FrameTiming, Motion
from slbench.rig.optics.response import Response
from slbench.scene.colour import Colour
from slbench.scene.environment import environment_of
from slbench.scene.frame_errors import BitPlanes, Drift, Trigger
from slbench.scene.model import Exposure, Light, Scene, SceneObject
from slbench.scene.new.devices import Lenses
from slbench.scene.new.place import Place

LENS = Lens(16.0, 1.0, 100.0)
CAMERA = Camera(64, 48, (0.01, 0.01), LENS)
PROJECTOR = Projector(64, 48, (0.01, 0.01), LENS)
SEQUENCE = PatternSequence.parse("1", (64, 48))
OBJECT = SceneObject(load_artefact("plane"))
MANIFEST = Manifest(
    name="small",
    description="",
    licence="CC0-1.0",
    seed=0,
    count=1,
    preview=False,
    samples_per_shard=1,
    captures={},
    columns={},
    drawn=(),
    environment={},
    specification={},
)

#: One of each family of codes: that of its first word, or of what needs files.
CODES = [Fringes(1), DimmedFringes(1), Images(np.zeros((3, 48, 64), np.uint8), "u")]
CODES += [
    next(code[0] for word in family.words if (code := family.read_word(word, "u", 4)))
    for family in (pattern_codes.get(kind) for kind in pattern_codes)
    if family not in (Fringes, Images)
]
#: One of each class of values.
VALUES = [
    LENS,
    Device(64, 48, (0.01, 0.01), LENS),
    CAMERA,
    PROJECTOR,
    DesignVariables(100.0, 50.0, 0.0, 5.0, 0.1, 0.0),
    Detector(),
    NoiseModel(),
    Response(2.2),
    FreeBoard(kind="chequerboard", columns=9, rows=7, pitch_mm=20.0),
    *CODES,
    SEQUENCE,
    SequenceTable((64, 48), ({"kind": "gray"},)),
    PatternsTable(sequence="1,10,50"),
    Recipe("1"),
    MANIFEST,
    Focus({"camera": (100.0,), "projector": (200.0,)}),
    CaptureTable(frames=("000.png",), patterns={}),
    Capture(np.zeros((3, 48, 64), np.uint8), SEQUENCE),
    FolderTable(camera="left", projector="main", folder="left-main"),
    load_hardware("hardware/macro-ch6"),
    Sweep((0.1, -0.1)),
    Exposure(),
    Motion(),
    FrameTiming(period_s=0.01),
    BitPlanes(periods=1.5),
    Trigger(),
    Drift(),
    Colour(),
    Light(),
    environment_of("window", irradiance_w_per_mm2=1e-5),
    Temperature(21.0, 0.1),
    Standard("ball_bar", diameter_mm=10.0, spacing_mm=40.0),
    OBJECT,
    Place(300.0, 110.0, 20.0),
    Lenses(
        lens_mm=25.0, f_number=4.0, throw_ratio=1.4, projector_f_number=2.4, offset_percent=100.0
    ),
    Scene("plain", Rig(CAMERA, PROJECTOR), (OBJECT,), SEQUENCE),
]


def test_every_class_of_values_has_an_example():
    bases = {}
    for path in Path(slbench.__file__).parent.rglob("*.py"):
        for name, parents in re.findall(r"^class (\w+)\(([\w, ]+)\):", path.read_text(), re.M):
            bases[name] = set(parents.split(", "))
    found = {"Value"}
    while more := {name for name, parents in bases.items() if parents & found} - found:
        found |= more
    above = {base for code in CODES for base in type(code).__mro__ if inspect.isabstract(base)}
    found -= {"Value"} | {base.__name__ for base in above}
    assert found == {type(value).__name__ for value in VALUES}


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_a_wrong_field_is_named_with_what_was_expected_and_found(value: Any):
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(value).__name__).lower()
    tried = 0
    for name, hint in value.fields_of().items():
        for wrong in wrong_values(hint):
            with pytest.raises(InputError) as caught:
                dataclasses.replace(value, **{name: wrong})
            line = str(caught.value)
            assert re.match(rf"{words}: {name}\b.*: expected .+, got .+", line), line
            assert "\n" not in line
            assert "Input should" not in line
            assert "Value error" not in line
            tried += 1
    assert tried >= len(value.fields_of())


def test_numpy_scalars_and_lists_are_taken_as_pythons():
    lens = Lens(np.float32(16.0), np.int64(1), 100)
    assert (lens.focal_length_mm, lens.aperture_radius_mm) == (16.0, 1.0)
    assert {type(number) for number in (lens.focal_length_mm, lens.aperture_radius_mm)} == {float}
    camera = dataclasses.replace(CAMERA, pitch_mm=[0.01, np.float64(0.02)])
    assert camera.pitch_mm == (0.01, 0.02)


def test_a_wrong_choice_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'telecentric'"):
        Lens(16.0, kind="telecentrik")  # type: ignore[arg-type]


@checked
def _measured(data: list[float], samples: Samples = 64, *, percentile: Percentile | None = None):
    return data, samples, percentile


def test_arguments_are_checked_by_their_types():
    assert _measured([1.0], np.int32(3)) == ([1.0], 3, None)
    with pytest.raises(
        InputError, match=r"^samples: expected a whole number from 1 to 65536, got 0"
    ):
        _measured([], 0)
    with pytest.raises(InputError, match=r"^percentile: expected a number in \(0, 100\], got 0.0$"):
        _measured([], percentile=0.0)
    with pytest.raises(TypeError, match="smaples"):
        _measured([], smaples=1)  # type: ignore[call-arg]
