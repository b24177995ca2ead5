"""Packages of the extras, ``datasets`` and ``torch``, imported where they are needed."""

from __future__ import annotations

import importlib
from typing import Any

from slbench.core.errors import InputError


def extra(module: str, group: str = "datasets") -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
        E.g. ``"pyarrow.parquet"``.
    group : str
        The extra that brings it.

    Returns
    -------
    module

    Raises
    ------
    InputError
        If it is not installed, saying how to get it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.split(".")[0]
        expected = f"to be installed (pip install 'slbench[{group}]')"
        raise InputError(f"package {package}", expected, str(error)) from error
