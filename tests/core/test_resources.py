"""Shipped files are found by name, and no name or relative path leads out of its folder."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slbench.core import resources
from slbench.core.errors import InputError


def test_shipped_artefacts_are_listed_sorted():
    shipped = resources.names("objects")
    assert shipped == sorted(shipped)
    assert {"plane", "sphere", "step-block-5", "step-block-20"} <= set(shipped)


@pytest.mark.parametrize("name", ["step-block-5", "step-block-5.toml"])
def test_shipped_name_is_found_with_and_without_suffix(name):
    path = resources.find("objects", name)
    assert path.name == "step-block-5.toml"
    assert path.is_file()


def test_existing_path_wins_over_a_shipped_name(tmp_path, monkeypatch):
    (tmp_path / "plane").write_text("mine")
    monkeypatch.chdir(tmp_path)
    assert resources.find("objects", "plane").read_text() == "mine"
    assert resources.find("objects", tmp_path / "plane") == tmp_path / "plane"


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../plane", "../objects/plane", "no-such", "a\0b", "x" * 5000, "/"]
)
def test_names_that_are_none_are_refused(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="step-block-5") as caught:
        resources.find("objects", name)
    assert "\n" not in str(caught.value)


def test_installed_wheel_layout(tmp_path, monkeypatch):
    folder = tmp_path / "site-packages" / "slbench" / "_data" / "objects"
    folder.mkdir(parents=True)
    (folder / "cube.toml").write_text("")
    (tmp_path / "site-packages" / "slbench" / "_data" / "secret.toml").write_text("")
    monkeypatch.setattr(resources, "_PACKAGE", tmp_path / "site-packages" / "slbench")
    monkeypatch.chdir(tmp_path)
    assert resources.names("objects") == ["cube"]
    assert resources.find("objects", "cube") == folder / "cube.toml"
    # The file exists beside the folder, but as a name it leads out of it.
    with pytest.raises(InputError):
        resources.find("objects", "../secret")


def test_unknown_kind_is_refused():
    with pytest.raises(InputError, match="scenes, objects"):
        resources.names("patterns")


def test_inside_accepts_paths_that_stay(tmp_path):
    assert resources.inside(tmp_path, "a/../b.stl") == tmp_path.resolve() / "b.stl"
    (tmp_path / "real.stl").write_text("")
    (tmp_path / "link.stl").symlink_to(tmp_path / "real.stl")
    assert resources.inside(tmp_path, "link.stl") == (tmp_path / "real.stl").resolve()


def test_inside_refuses_paths_that_leave(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "scene-two").mkdir()  # shares a prefix of its name with the folder
    (folder / "out").symlink_to(tmp_path)
    (folder / "loop").symlink_to(folder / "loop")
    absolute = str(folder / "a.stl")
    for path in ["..", "../a.stl", "a/../../a.stl", "../scene-two/a", absolute, "out/a.stl", ""]:
        with pytest.raises(InputError):
            resources.inside(folder, path)
    with pytest.raises(InputError):
        resources.inside(folder, "a\0b")


@given(st.lists(st.sampled_from(["..", ".", "a", "b"]), min_size=1, max_size=8))
def test_inside_agrees_with_lexical_depth(parts):
    # Without symbolic links a path leaves exactly when its normal form begins with "..".
    relative = "/".join(parts)
    leaves = os.path.normpath(relative).split("/")[0] == ".."
    folder = Path("/no-such-folder-of-slbench/x/y/z/w/v/u/t/s")
    if leaves:
        with pytest.raises(InputError):
            resources.inside(folder, relative)
    else:
        assert resources.inside(folder, relative).is_relative_to(folder)
