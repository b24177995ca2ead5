"""Files that people write: what their models refuse is one line naming file, key, both sides.

One property a model, derived from its schema: a misspelt key, a missing one, a value of another
kind and a number out of range.  What keys mean together is tested where the model stands.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args, get_origin

import pytest
from refusals import required, tables

import slbench
from slbench.bench.accept import specification
from slbench.bench.budget.inputs import BudgetTable
from slbench.bench.claims import baseline, file
from slbench.calibration.models import model as calibration
from slbench.capture.capture import CaptureTable
from slbench.capture.captures import FolderTable
from slbench.capture.stack import _stack_table
from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import read_toml
from slbench.core.validation.tables import Parameters
from slbench.core.validation.values import validated
from slbench.core.validation.wording import base_of, table_fields
from slbench.datasets.spec.distributions import Distribution
from slbench.datasets.spec.specification import Specification
from slbench.design.rig import hardware
from slbench.detector.emva1288 import Detector
from slbench.objects import artefacts, loading
from slbench.scene.devices.detector import SheetKeys
from slbench.scene.file import read_merged
from slbench.scene.surfaces.bsdfs import bsdfs
from slbench.scene.surfaces.textures import textures
from slbench.scene.tables import SceneOfFile, SceneTables
from slbench.simulate.viewpoints import views

OBJECTS = {name: read_toml(resources.find("objects", name)) for name in resources.names("objects")}
SCENE = read_merged(resources.find("scenes", "step-block"))
COORDINATE = {
    "form": "M1",
    "terms": ["1"],
    "coefficients_mm": [0.5],
    "covariance_mm2": [[0.1]],
    "residual_std_mm": 0.01,
}

#: A model of each kind of file, and a file that it takes.
FILES: list[tuple[type, Mapping[str, Any]]] = [
    (
        SceneTables,
        SCENE
        | {
            "focus": {"settings": 3},
            "materials": {"white": {}},
            "detector": {"seed": 1},
            "exposure": {"bracket": [0.25, 1.0]},
        },
    ),
    (
        SceneTables,
        {k: v for k, v in SCENE.items() if k != "rig"}
        | {"rig": {d: {"position_mm": [0.0, 10.0, 500.0]} for d in ("camera", "projector")}},
    ),
    (
        SceneOfFile,
        {k: v for k, v in SCENE.items() if k not in ("rig", "camera", "projector")}
        | {
            "rig": {"file": "rig.yaml", "volume_mm": [60.0, 70.0, 30.0]},
            "camera": {"f_number": 8.0, "pitch_um": 5.0},
            "projector": {"aperture_radius_mm": 3.0, "focus_distance_mm": 400.0},
        },
    ),
    (
        CaptureTable,
        {
            "frames": ["000.png"],
            "patterns": {"panel": [64, 48]},
            "noise": {"read_dn": 0.2},
            "exposures_ms": [2.0, 8.0],
        },
    ),
    (FolderTable, {"camera": "left", "projector": "main", "folder": "left-main"}),
    (_stack_table(()), {"captures": ["focus000", "focus001"], "camera_mm": [100.0, 200.0]}),
    (Detector, {"full_well_e": 9000.0}),
    (SheetKeys, {"snr_max_db": 40.3, "dynamic_range_db": 71.2}),
    (Specification, read_toml(resources.find("scenes", "datasets/mixed"))),
    (Distribution, {"uniform": [0.5, 0.9], "name": "level"}),
    (hardware._HardwareFile, read_merged(resources.find("scenes", "hardware/macro-ch6"))),
    (hardware._Volume, {"volume_mm": [60.0, 70.0, 30.0]}),
    (
        BudgetTable,
        {
            "coverage": 0.9,
            "inputs": [
                {"name": "certificate", "distribution": "normal", "standard_uncertainty": 1e-3}
            ],
        },
    ),
    (
        specification._File,
        {
            "name": "mine",
            "mpe": {"length_um": 10},
            "standards": {"sphere": {"diameter_mm": 10.0}},
            "rig": "rig.yaml",
            "unit": "mm",
            "place": [{"standard": "sphere", "clouds": ["a.ply"]}],
            "held": [{"test": "length", "worst_um": 3.0, "u_um": 1.0}],
        },
    ),
    (
        specification._Standard,
        {"object": "ball-bar", "spacing_U_um": 0.5, "temperature": {"celsius": 21.0}, "places": 7},
    ),
    (
        specification._Place,
        {"standard": "ball_bar", "clouds": ["a.ply", "b.ply"], "registered_by": "spheres"},
    ),
    (specification._Held, {"test": "length", "worst_um": 3.0, "u_um": 1.0}),
    (
        views._ViewsFile,
        {
            "scene": "plane",
            "part": "brick",
            "object": 1,
            "max_std_um": 20.0,
            "predicted_coverage": 0.5,
            "views": [{"name": "view-01", "position_mm": [0.0, 0.0, 5.0]}],
        },
    ),
    (views._View, {"name": "view-01", "position_mm": [0.0, 0.0, 5.0]}),
    (file._File, {"claim": [{"name": "flat"}]}),
    (file._Claim, {"name": "flat", "scene": "plane", "quantity": "plane.rms_mm", "max": 0.1}),
    (
        baseline._File,
        {
            "format": 2,
            "slbench": "0.1",
            "seed": 0,
            "claims": {"flat": {"identity": {}, "scenes": ["a"], "values": [0.1, 0.2]}},
        },
    ),
    (
        calibration._File,
        {
            "kind": "calibration",
            "version": 1,
            "axes": "u",
            "mean_px": [0.0],
            "scale_px": [1.0],
            "coordinates": dict.fromkeys("xyz", COORDINATE),
            "half_spaces": [[1.0]],
        },
    ),
    (loading.ArtefactFile, OBJECTS["sphere"]),
    *((bsdfs.get(name), {}) for name in bsdfs),
    *((textures.get(n), {"path": "a.png"} if n == "picture" else {}) for n in textures),
    *((artefacts.get(t["kind"]).parameters, t["parameters"]) for t in OBJECTS.values()),
]
#: Models of which no file stands alone: parts of the above, or looked into by a parent.
PARTS = {"MeshParameters", "ToothedParameters", "OfVertices", "Tint"}


def _reached(model: Any) -> Iterator[str]:
    if isinstance(model, type) and issubclass(model, Parameters):
        yield model.__name__
        for base in model.__mro__[1:]:
            if issubclass(base, Parameters):
                yield base.__name__
        for hint in table_fields(model).values():
            yield from _reached(base_of(hint))
    elif get_origin(model) is not None:
        for argument in get_args(model):
            yield from _reached(base_of(argument))


def test_every_model_of_a_file_is_tried():
    bases: dict[str, set[str]] = {}
    for path in Path(slbench.__file__).parent.rglob("*.py"):
        for name, parents in re.findall(r"^class (\w+)\(([\w, ]+)\):", path.read_text(), re.M):
            bases[name] = set(parents.split(", "))
    found = {"Parameters"}
    while more := {name for name, parents in bases.items() if parents & found} - found:
        found |= more
    tried = {name for model, _ in FILES for name in _reached(model)}
    assert found - tried - {"Parameters"} <= PARTS


@pytest.mark.parametrize(("model", "good"), FILES, ids=lambda value: getattr(value, "__name__", ""))
def test_a_wrong_key_or_value_is_one_line_that_names_it(model, good):
    validated(model, good, "file.toml", ": ")
    cases = [
        *tables(model, good),
        *((k, {x: good[x] for x in good if x != k}) for k in required(model)),
    ]
    for key, table in cases:
        with pytest.raises(InputError) as caught:
            validated(model, table, "file.toml", ": ")
        line = str(caught.value)
        assert re.fullmatch(rf"file\.toml: .*\b{key}\b.*", line), line
        assert re.fullmatch(r"file\.toml(: [^:]+)?: expected .+, got .+", line), line
        assert not re.search("Input should|Value error|Extra inputs|Field required", line), line
        if key.endswith("x") and f"got '{key}'" in line:
            assert f"did you mean '{key[:-1]}'" in line or len(key) < 4, line
