"""Libraries that read data sets and exports elsewhere: the extra ``loaders``."""

import importlib
import importlib.metadata
from types import ModuleType

import pytest


def loader(name: str) -> ModuleType:
    """Import a loader, or skip.  A folder of its name must not be taken for it."""
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(f"{name} is not installed (extra loaders)")
    return importlib.import_module(name)
