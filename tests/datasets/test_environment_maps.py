"""Environment maps go with a data set: names and files are drawn, samples have what they name."""

import numpy as np
import pytest
from dataset_specs import TINY, write_spec

from slbench.core.errors import InputError
from slbench.core.io import write_exr
from slbench.datasets.spec.sampling import draw, place_scene
from slbench.datasets.spec.specification import load


def with_environment(folder, table):
    return write_spec(folder, scene=TINY["scene"] | {"environment": table})


def test_maps_are_drawn(tmp_path):
    names = ["overcast", "window"]
    table = {
        "map": {"choice": names},
        "rotation_deg": {"uniform": [0.0, 360.0]},
        "irradiance_w_per_m2": {"log_uniform": [1.0, 100.0]},
    }
    specification, files = load(with_environment(tmp_path, table))
    assert not files
    assert {"map", "rotation_deg", "irradiance_w_per_m2"} <= set(specification.drawn_columns())
    found = set()
    for sample in range(6):
        drawn = draw(specification, 1, sample)
        folder = tmp_path / f"{sample}"
        folder.mkdir()
        light = place_scene(drawn, files, folder, True).light
        stated = drawn.values["irradiance_w_per_m2"] * 1e-6
        assert light.environment.irradiance_w_per_mm2 == pytest.approx(stated, rel=1e-6)
        found.add(drawn.values["map"])
    assert found == set(names)


def test_files_are_taken_in(tmp_path):
    for k, name in enumerate(("a", "b")):
        write_exr(tmp_path / f"{name}.exr", {"Y": np.full((4, 8), 1.0 + k, np.float32)})
    table = {"file": {"choice": ["a.exr", "b.exr"]}}
    specification, files = load(with_environment(tmp_path, table))
    assert specification.files() == set(files) == {"map.a.exr", "map.b.exr"}
    levels = set()
    for sample in range(6):
        folder = tmp_path / f"{sample}"
        folder.mkdir()
        light = place_scene(draw(specification, 1, sample), files, folder, True).light
        levels.add(float(light.environment.radiance.values.max()))
    assert levels == {float(np.float32(1e-6)), float(np.float32(2e-6))}


def test_a_map_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"tiny\.toml: scene\.environment\.file"):
        load(with_environment(tmp_path, {"file": "none.exr"}))
