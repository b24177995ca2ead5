"""What is added from outside slbench, by a package or a file, works from the command line."""

import json

import numpy as np
import outside
import pytest
import tomli_w
from calibration_data import rig_points
from scenes_small import SMALL_FILE, check_refused, run_cli

from slbench.core import modules
from slbench.core.io import write_png

NAMES = {
    "slbench.codes": "ramp",
    "slbench.artefacts": "box",
    "slbench.bsdfs": "smooth_plastic",
    "slbench.detectors": "ideal",
    "slbench.focus_measures": "sobel",
    "slbench.calibration_models": "M1w",
    "slbench.claim_quantities": "lit_share",
    "slbench.exporters": "csv",
}
#: Everything of a scene that can be foreign is.
SCENE = SMALL_FILE | {
    "name": "foreign",
    "objects": [{"kind": "box", "parameters": {"size_mm": [40.0, 40.0, 6.0]}, "material": "coat"}],
    "materials": {"coat": {"bsdf": "smooth_plastic", "albedo": 0.6}},
    "detector": {"kind": "ideal", "noise_dn": 0.4},
    "patterns": {"sequence": "ramp"},
    "render": {"samples": 4},
}
CLAIMS = {
    "claim": [
        {
            "name": "the light reaches the box",
            "scene": "scene.toml",
            "quantity": "lit_share",
            "min": 0.1,
            "repeats": 2,
        }
    ]
}
DATA = {
    "name": "boxes",
    "scene": {key: value for key, value in SCENE.items() if key != "name"},
    "patterns": [{"sequence": "ramp"}],
}


def write_all(folder, **head):
    """Write a scene, claims, a specification, photographs and points that use everything."""
    for name, content in (("scene", SCENE), ("some.claims", CLAIMS), ("data", DATA)):
        (folder / f"{name}.toml").write_text(tomli_w.dumps(head | content))
    rng = np.random.default_rng(0)
    (folder / "photographs").mkdir()
    for k in range(3):
        picture = rng.integers(0, 255, (24, 32)).astype(np.uint8)
        write_png(folder / "photographs" / f"{k}.png", picture)
    rig_points(60, 0.1).write(folder / "points.csv")


def commands(folder, *options):
    """Return the commands that use each of the names, and what each must give."""
    scene, data = folder / "scene.toml", folder / "made"
    fuse = ["fuse", folder / "photographs", "--out", folder / "fused.png", "--measure", "sobel"]
    fit = ["calibrate", "fit", folder / "points.csv", "--out", folder / "model.json"]
    make = ["dataset", "make", folder / "data.toml", "--out", data, "--count", 1, "--workers", 0]
    export = ["dataset", "export", data, "--format", "csv", "--out", folder / "depths.csv"]
    return [
        ["scan", scene, "--out", folder / "out", "--json", *options],
        ["decode", folder / "out", "--json", *options],
        ["check", folder / "some.claims.toml", "--json", *options],
        [*make, "--json", *options],
        [*export, "--json", *options],
        [*fuse, "--json"],
        [*fit, "--models", "M1,M1w", "--json"],
        ["objects", "list", "--kinds", "--json"],
        ["patterns", "list", "--json"],
    ]


def check_all(found, folder, origin):
    """Check what the commands gave, from whom `origin` says."""
    for one in found:
        assert one["status"] == 0, one["err"]
    scan, decode, check, make, export, fuse, fit, kinds, codes = (
        json.loads(one["out"].splitlines()[-1]) for one in found
    )
    assert scan["patterns"] == decode["patterns"] == "ramp"
    # A grey ramp of 8 bits over 1024 columns: a step is four of them, and none is lost.
    assert 0.05 < scan["rms_mm"] < 5.0
    assert decode["points"] == scan["points"] > 1000
    assert check["counts"]["holds"] == 1
    assert make["failed"] == 0
    assert export["samples"] == 1
    assert float((folder / "depths.csv").read_text().split(",")[-1]) > 100.0
    assert fuse["measure"] == "sobel"
    assert "M1w" in fit["x"]["models"]
    assert {code["kind"]: code["from"] for code in codes}["ramp"] == origin
    assert kinds["box"] == origin
    assert kinds["sphere"] == "slbench"


@pytest.fixture(scope="module")
def target(tmp_path_factory):
    return outside.install(tmp_path_factory.mktemp("installed"))


def test_a_package_adds_one_of_each(target, tmp_path):
    write_all(tmp_path)
    check_all(outside.run(target, *commands(tmp_path)), tmp_path, "slbench-outside 0.1")
    written = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert written["extensions"]["packages"] == {"slbench-outside": "0.1"}


def test_a_code_of_a_package_is_a_set_wherever_one_is_asked_for(target, tmp_path):
    """By its word, and as an object of the package's module, which is code that is allowed."""
    scene = SMALL_FILE | {"name": "own", "render": {"samples": 4}}
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(scene))
    data = {"name": "ramps", "scene": {key: scene[key] for key in scene if key != "name"}}
    named = "slbench_outside.code:Ramp"
    for name, patterns in (("word", "ramp"), ("object", named)):
        table = data | {"patterns": [{"sequence": patterns}]}
        (tmp_path / f"{name}.toml").write_text(tomli_w.dumps(table))
    compare = ["compare", tmp_path / "scene.toml", "--set", "1,8", "--set", "ramp", "--set", named]
    scan = ["scan", tmp_path / "scene.toml", "--out", tmp_path / "out", "--json", "--patterns"]
    make = ["dataset", "make", "--count", 1, "--workers", 0, "--json", "--out"]
    commands = [
        [*compare, "--repeats", 2, "--out", tmp_path / "compared", "--json"],
        [*scan, "ramp"],
        [*scan, named],
        [*make, tmp_path / "made", tmp_path / "word.toml"],
        [*make, tmp_path / "objects", tmp_path / "object.toml"],
        ["patterns", "show", "ramp", "--json"],
    ]
    allowed = [0, 2, 4]
    found = outside.run(
        target,
        *([*one, "--allow-modules"] if k in allowed else one for k, one in enumerate(commands)),
        *(commands[k] for k in allowed),
    )
    for one in found[:6]:
        assert one["status"] == 0, one["err"]
    for one in found[6:]:
        assert one["status"] == 2
        assert "--allow-modules" in one["err"]
        assert len(one["err"].splitlines()) == 1
    compared, word, object_, *made, shown = (
        json.loads(f["out"].splitlines()[-1]) for f in found[:6]
    )
    assert [one["name"] for one in compared["sets"]] == ["1,8", "ramp", named]
    assert [one["frames"] for one in compared["sets"]] == [6, 3, 3]
    assert compared["sets"][1]["completeness"] > 0.9
    assert word["patterns"] == object_["patterns"] == shown["name"] == "ramp"
    assert word["rms_mm"] == object_["rms_mm"]
    assert [one["failed"] for one in made] == [0, 0]


def test_the_package_has_one_of_each():
    points = outside.PROJECT["entry-points"]
    assert {group: list(names) for group, names in points.items()} == {
        group: [name] for group, name in NAMES.items()
    }


def test_the_page_shows_the_package():
    page = (outside.ROOT / "docs" / "how-to" / "extend.md").read_text()
    for source in (outside.FOLDER / "slbench_outside").glob("[a-z]*.py"):
        assert f"```python\n{source.read_text()}```\n" in page, source.name
    for group in NAMES:
        assert f"`{group}`" in page


BROKEN = {
    "slbench.artefacts": {
        "sphere": "slbench_outside.artefact:BOX",
        "box": "slbench_outside.measure:sobel",
    },
    "slbench.focus_measures": {"sobel": "slbench_outside.nothing:sobel"},
}


def test_a_broken_package_is_named_in_one_line(tmp_path):
    installed = outside.install(tmp_path / "installed", outside.PROJECT | {"entry-points": BROKEN})
    scene = tmp_path / "scene.toml"
    scene.write_text(tomli_w.dumps(SCENE | {"detector": {}, "materials": {}}))
    found = outside.run(
        installed,
        ["objects", "show", "sphere", "--out", tmp_path / "ball.png"],
        ["fuse", tmp_path, "--out", tmp_path / "x" / "fused.png", "--measure", "sobel"],
        ["scan", scene, "--out", tmp_path / "out"],
    )
    wanted = [
        "kind 'sphere': expected a name that one package has, got slbench and slbench-outside 0.1",
        "focus measure 'sobel' of slbench-outside 0.1: expected slbench_outside.nothing:sobel",
        "kind 'box' of slbench-outside 0.1: expected a slbench.objects.registry.ArtefactKind, got",
    ]
    for one, words in zip(found, wanted, strict=True):
        assert one["status"] == 2
        assert len(one["err"].splitlines()) == 1, one["err"]
        assert words in one["err"]


# -- modules that files name --------------------------------------------------------------------


@pytest.mark.slow
def test_a_file_adds_one_of_each(tmp_path):
    """Scene, claims and data set name it; it stays with the capture and the data set."""
    (tmp_path / "parts.py").write_text(outside.as_module())
    write_all(tmp_path, modules=["parts.py"])
    refused = commands(tmp_path)
    found = outside.run(tmp_path / "none", *refused[:1], *commands(tmp_path, "--allow-modules"))
    assert found[0]["status"] == 2
    assert "--allow-modules" in found[0]["err"]
    check_all(found[1:], tmp_path, str(tmp_path / "parts.py"))
    written = json.loads((tmp_path / "out" / "provenance.json").read_text())
    (module,) = written["extensions"]["modules"]
    assert module["path"] == str(tmp_path / "parts.py")
    assert written["parameters"]["scene"]["modules"] == [
        {"path": "parts.py", "sha256": module["sha256"]}
    ]
    # Whoever gets the folder, or the data set, is asked.
    (tmp_path / "depths.csv").unlink()
    export = refused[4]
    alone = outside.run(tmp_path / "none", refused[1], export, [*export, "--allow-modules"])
    assert [one["status"] for one in alone] == [2, 2, 0]
    assert "--allow-modules" in alone[0]["err"]
    assert "got 'csv'" in alone[1]["err"]


@pytest.mark.parametrize(
    ("command", "file"),
    [
        (["scan", "scene.toml"], "scene.toml"),
        (["compare", "scene.toml", "--set", "1,2"], "scene.toml"),
        (["check", "some.claims.toml"], "some.claims.toml"),
        (["dataset", "make", "data.toml", "--out", "made", "--count", "1"], "data.toml"),
        (["calibrate", "run", "scene.toml"], "scene.toml"),
        (["scene", "show", "scene.toml", "--out", "scene.png"], "scene.toml"),
        (["scan", "child.toml"], "scene.toml"),
        (["decode", "capture.toml"], "capture.toml"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value[:2]),
)
def test_no_command_runs_a_stranger_s_module(tmp_path, monkeypatch, command, file):
    monkeypatch.chdir(tmp_path)
    write_all(tmp_path, modules=["bad.py"])
    (tmp_path / "bad.py").write_text("open('ran', 'w')")
    child = {"extends": "scene.toml", "name": "child"}
    (tmp_path / "child.toml").write_text(tomli_w.dumps(child))
    capture = {"frames": ["0.png"], "patterns": {}, "modules": ["bad.py"]}
    (tmp_path / "capture.toml").write_text(tomli_w.dumps(capture))
    check_refused(run_cli(*command), file, "--allow-modules", "bad.py")
    assert not (tmp_path / "ran").exists()


def test_a_scene_that_extends_another_runs_both_modules(tmp_path, monkeypatch):
    monkeypatch.setattr(modules, "_run", {})
    (tmp_path / "base").mkdir()
    for folder, name in ((tmp_path / "base", "first"), (tmp_path, "second")):
        (folder / f"{name}.py").write_text(
            f"open({str(tmp_path / 'order')!r}, 'a').write('{name} ')"
        )
    base = SMALL_FILE | {"modules": ["first.py"]}
    (tmp_path / "base" / "base.toml").write_text(tomli_w.dumps(base))
    child = {"extends": "base/base.toml", "name": "child", "modules": ["second.py"]}
    (tmp_path / "child.toml").write_text(tomli_w.dumps(child))
    from slbench.scene.file import load_scene

    scene = load_scene(tmp_path / "child.toml", allow_modules=True)
    assert (tmp_path / "order").read_text() == "first second "
    assert [module["path"] for module in scene.specification["modules"]] == [
        "first.py",
        "second.py",
    ]


@pytest.mark.slow
def test_workers_run_the_modules_of_a_data_set(tmp_path):
    (tmp_path / "parts.py").write_text(outside.as_module())
    write_all(tmp_path, modules=["parts.py"])
    make = ["dataset", "make", tmp_path / "data.toml", "--out", tmp_path / "made", "--count", 2]
    options = ["--workers", 1, "--json", "--allow-modules"]
    (found,) = outside.run(tmp_path / "none", [*make, *options])
    assert found["status"] == 0, found["err"]
    assert json.loads(found["out"])["failed"] == 0
