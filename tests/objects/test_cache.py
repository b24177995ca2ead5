"""The cache of built artefacts: the same artefact as building, whatever happens to its files."""

import dataclasses
import multiprocessing
import os
from pathlib import Path

import numpy as np
import pytest

from slbench import objects
from slbench.objects import cache
from slbench.objects.shapes import stepblock

PARAMETERS = {"heights_mm": [1.0, 2.5], "step_length_mm": 10.0, "width_mm": 20.0}


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def equal(a: objects.Artefact, b: objects.Artefact) -> bool:
    return (
        a.mesh.vertices.tobytes() == b.mesh.vertices.tobytes()
        and a.mesh.faces.tobytes() == b.mesh.faces.tobytes()
        and (a.name, a.kind, a.parameters) == (b.name, b.kind, b.parameters)
        and (a.certified, a.features, a.source) == (b.certified, b.features, b.source)
        and all(np.array_equal(a.parts[name], b.parts[name]) for name in a.parts)
        and list(a.parts) == list(b.parts)
    )


def test_the_cached_artefact_is_the_built_one(folder, monkeypatch):
    first = objects.build_artefact("step_block", PARAMETERS, name="block")
    entries = list(folder.glob("*.npz"))
    assert len(entries) == 1
    monkeypatch.setitem(objects.artefacts._found, "step_block", _unbuildable())
    assert equal(objects.build_artefact("step_block", PARAMETERS, name="block"), first)
    assert objects.build_artefact("step_block", PARAMETERS, name="other").name == "other"


def _unbuildable() -> objects.ArtefactKind:
    def refuse(*arguments: object) -> objects.Artefact:
        raise AssertionError("built although it is cached")

    return dataclasses.replace(stepblock.KIND, build=refuse)


def test_other_parameters_are_another_entry(folder):
    objects.build_artefact("step_block", PARAMETERS)
    objects.build_artefact("step_block", PARAMETERS | {"width_mm": 20.5})
    assert len(list(folder.glob("*.npz"))) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not an archive", None])
def test_a_damaged_entry_is_built_again(folder, damage):
    first = objects.build_artefact("step_block", PARAMETERS)
    (entry,) = folder.glob("*.npz")
    content = entry.read_bytes()
    entry.write_bytes(content[: len(content) // 2] if damage is None else damage)
    assert equal(objects.build_artefact("step_block", PARAMETERS), first)
    assert entry.read_bytes() == content


def test_without_a_cache(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, "off")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    objects.build_artefact("step_block", PARAMETERS)
    assert list(tmp_path.rglob("*.npz")) == []


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path, monkeypatch):
    blocker = tmp_path / "file"
    blocker.write_text("not a folder")
    monkeypatch.setenv(cache.VARIABLE, str(blocker))
    assert objects.build_artefact("step_block", PARAMETERS).mesh.is_watertight


def test_the_oldest_entries_go(folder, monkeypatch):
    monkeypatch.setattr(cache, "_ENTRIES", 3)
    for k in range(5):
        objects.build_artefact("step_block", PARAMETERS | {"width_mm": 20.0 + k})
        for entry in folder.glob("*.npz"):  # clocks of file systems are coarse
            if entry.stat().st_mtime > 1e9:
                os.utime(entry, (k + 1.0, k + 1.0))
    assert len(list(folder.glob("*.npz"))) == 3


def _build_in_child(folder: str) -> bytes:
    os.environ[cache.VARIABLE] = folder
    return objects.build_artefact("step_block", PARAMETERS).mesh.vertices.tobytes()


def test_many_processes_share_one_folder(folder):
    # Spawned, as Numba's and Mitsuba's threads do not survive a fork.
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        results = pool.map(_build_in_child, [str(folder)] * 6)
    assert set(results) == {
        objects.build_artefact("step_block", PARAMETERS).mesh.vertices.tobytes()
    }
    assert [path.suffix for path in folder.iterdir()] == [".npz"]
