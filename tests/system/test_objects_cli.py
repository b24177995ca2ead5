"""``slbench objects`` and ``slbench scene``: lists, meshes and pictures."""

import json
import sys
import time

import cv2
import numpy as np
import pytest
import trimesh
from scenes_small import check_refused, run_cli

from slbench import objects
from slbench.cli import main
from slbench.core import resources
from slbench.report.plots.draw import _round_length


@pytest.fixture
def run(monkeypatch, capsys):
    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["slbench", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_info:
            main()
        output = capsys.readouterr()
        return exit_info.value.code or 0, output.out, output.err

    return call


def test_list(run):
    status, out, _ = run("objects", "list")
    assert status == 0
    for name in resources.names("objects"):
        assert name in out
    # Equal pins are one line, different steps a line each.
    assert "pin_*_*_height_mm" in out
    assert "pin_1_1_height_mm" not in out
    assert "step_2_height_mm = 2.5" in out
    status, out, _ = run("objects", "list", "--json")
    found = {item["name"]: item for item in json.loads(out)}
    assert found["step-block-5"]["certified"]["step_2_height_mm"] == 2.5
    assert found["step-block-5"]["size_mm"] == pytest.approx([56, 30, 10])


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj"])
def test_build(run, tmp_path, suffix):
    path = tmp_path / f"part.{suffix}"
    status, out, _ = run("objects", "build", "step-block-5", "--out", path, "--set", "width_mm=12")
    assert status == 0
    assert str(path) in out
    mesh = trimesh.load(path)
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.extents, [56, 12, 10], atol=1e-4)


def test_set_takes_numbers_lists_and_text(run, tmp_path):
    path = tmp_path / "part.ply"
    changes = ["--set", "heights_mm=[2.0, 4.0]", "--set", "base_mm=3.0"]
    assert run("objects", "build", "step-block-5", "--out", path, *changes)[0] == 0
    np.testing.assert_allclose(trimesh.load(path).extents[2], 7.0, atol=1e-5)
    text = ["--set", "text=7"]
    assert run("objects", "build", "coin-3", "--out", path, "--set", 'text="7"')[0] == 0
    assert run("objects", "build", "coin-3", "--out", path, *text)[0] == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ("build", "no-such-part", "--out", "x.ply"),
        ("build", "step-block-5", "--out", "x.step"),
        ("build", "step-block-5", "--out", "x.ply", "--set", "width_mm"),
        ("build", "step-block-5", "--out", "x.ply", "--set", "width_mm=-1"),
        ("build", "step-block-5", "--out", "x.ply", "--set", "colour=1"),
        ("build", "spur-gear", "--out", "x.ply", "--set", "teeth=-4"),
        ("build", "spur-gear", "--out", "x.ply", "--set", "bore_diameter_mm=900.0"),
        ("build", "coin-3", "--out", "x.ply", "--set", 'text=" "'),
        ("show", "plane", "--out", "x.png", "--material", "velvet"),
        ("show", "../../etc/passwd", "--out", "x.png"),
        ("build", "plane"),
    ],
)
def test_refused_in_one_line(run, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    status, out, err = run("objects", *arguments)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_pictures(run, tmp_path):
    assert run("objects", "show", "spur-gear", "--out", tmp_path / "gear.png")[0] == 0
    picture = cv2.imread(str(tmp_path / "gear.png"), cv2.IMREAD_GRAYSCALE)
    # The scale bar is the only black run of this length: 10 mm at the size of the axes.
    assert (picture < 30).sum(axis=1).max() > 50
    assert run("scene", "show", "plane", "--out", tmp_path / "rig.png")[0] == 0
    assert cv2.imread(str(tmp_path / "rig.png")).std() > 10


def test_scene_list(run):
    status, out, _ = run("scene", "list")
    assert status == 0
    assert [line.split()[0] for line in out.splitlines()] == resources.names("scenes")


@pytest.mark.parametrize(
    ("length", "bar"), [(10.0, 10.0), (9.9, 5.0), (4.9, 2.0), (0.019, 0.01), (0.021, 0.02)]
)
def test_scale_bar(length, bar):
    assert _round_length(length) == pytest.approx(bar)


def test_every_help_has_an_example(run):
    for command in ("list", "build", "show"):
        assert "Example: slbench objects" in run("objects", command, "--help")[1]
    for command in ("list", "show"):
        assert "Example: slbench scene" in run("scene", command, "--help")[1]


@pytest.mark.parametrize("name", resources.names("objects"))
def test_default_resolution_builds_in_time(name, monkeypatch):
    """Two seconds is the issue's bound; a generous multiple, as machines are shared."""
    monkeypatch.setenv("SLBENCH_CACHE", "off")  # built, not read
    start = time.process_time()
    objects.load_artefact(name)
    assert time.process_time() - start < 6.0


@pytest.mark.parametrize("line", ["parameters = 3.0", 'parameters = "a"', "parameters = [1]"])
def test_a_file_whose_parameters_are_no_table_is_refused_with_changes_too(line, tmp_path):
    path = tmp_path / "o.toml"
    path.write_text(f'kind = "plane"\nsource = "x"\n{line}\n')
    for changes in ([], ["--set", "x=1"]):
        outcome = run_cli("objects", "build", path, *changes, "--out", tmp_path / "m.stl")
        check_refused(outcome, "o.toml: parameters")
