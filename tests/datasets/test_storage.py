"""Folders of data sets: what is missing is said once, in one line."""

import importlib

import pytest

from slbench.core.errors import InputError
from slbench.datasets.manifest import Manifest
from slbench.datasets.store.storage import Storage


def test_a_missing_package_is_one_error(tmp_path, monkeypatch):
    def absent(name: str):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(InputError) as caught:
        Storage(str(tmp_path)).exists()
    assert str(caught.value) == (
        "package fsspec: expected to be installed (pip install 'slbench[datasets]'), "
        "got No module named 'fsspec.core'"
    )


def test_a_missing_manifest_is_one_error(tmp_path):
    with pytest.raises(InputError) as caught:
        Manifest.load(Storage(str(tmp_path)))
    line = str(caught.value)
    assert line == f"{tmp_path}/dataset.json: expected a file, got nothing of that name"
