"""A file of a calibration, opened as whatever it turns out to be, once."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.io import read_npz, read_opencv_yaml
from slbench.core.io.atomic import existing
from slbench.core.io.bounds import check_size
from slbench.core.io.matfile import is_mat, read_mat
from slbench.core.io.text import read_text

#: Bytes of a file: a calibration with all its pictures' points.
_LARGEST = 64_000_000
#: Characters of YAML that is not OpenCV's, whose readers are slow.
_LARGEST_YAML = 1_000_000
#: How OpenCV's files begin: YAML, XML or JSON.
_STORAGE = re.compile(r"\s*(%YAML[ :]|<\?xml|\{\s*\")")
#: How files of MATLAB 7.3 and NumPy's archives begin.
_HDF5, _MATLAB_7_3, _NPZ = b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3 MAT-file", b"PK\x03\x04"
#: An assignment of numbers in a program of MATLAB.
_ASSIGNMENT = re.compile(r"^\s*([A-Za-z]\w*)\s*=\s*(\[[^\]]*\]|[-+.\w]+)\s*;?", re.MULTILINE)


class Source:
    """A file, read when it is asked for.

    Parameters
    ----------
    path : path of an existing file

    Raises
    ------
    InputError
        If it is missing, too large, or not readable.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = existing(path)
        check_size(self.path, _LARGEST, "a calibration")

    @cached_property
    def head(self) -> bytes:
        """The first bytes."""
        with self.path.open("rb") as stream:
            return stream.read(128)

    @cached_property
    def text(self) -> str:
        """The text; empty where the file is none."""
        if is_mat(self.head) or self.head.startswith((_HDF5, _MATLAB_7_3, _NPZ)):
            return ""
        return read_text(self.path, "a calibration", _LARGEST)

    @cached_property
    def storage(self) -> Mapping[str, Any]:
        """The entries of an OpenCV file; none where it is no such file."""
        return read_opencv_yaml(self.path) if _STORAGE.match(self.text) else {}

    @cached_property
    def yaml(self) -> Mapping[str, Any]:
        """The entries of a YAML file that is not OpenCV's; none where it is no such file."""
        if len(self.text) > _LARGEST_YAML or _STORAGE.match(self.text):
            return {}
        import yaml

        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        try:
            # A few lines of aliases stand for more numbers than there is memory.
            if any(isinstance(one, yaml.AliasEvent) for one in yaml.parse(self.text, loader)):
                return {}
            values = yaml.load(self.text, loader)
        except (yaml.YAMLError, ValueError, RecursionError):
            return {}
        return values if isinstance(values, dict) else {}

    @cached_property
    def arrays(self) -> Mapping[str, Any]:
        """The entries of any file that gives names to arrays.

        OpenCV's, NumPy's ``savez``, MATLAB's, and lists of numbers in YAML or JSON.
        """
        if self.head.startswith(_NPZ):
            return read_npz(self.path)
        if self.text.lstrip().startswith("{"):
            return {**self.storage, **_of_lists(_json(self.text))}
        return self.storage or _of_lists(self.yaml) or self.matlab

    @cached_property
    def matlab(self) -> Mapping[str, Any]:
        """The variables of MATLAB's: of a MAT-file, or numbers assigned in a program (``.m``).

        Raises
        ------
        InputError
            For a file of MATLAB 7.3, which is another format, and a damaged one.
        """
        if self.head.startswith((_HDF5, _MATLAB_7_3)):
            expected = "a MAT-file up to version 7: save('stereo.mat', ..., '-v7')"
            raise InputError(self.path, expected, "one of version 7.3 (HDF5)")
        if is_mat(self.head):
            return read_mat(self.path)
        found = {}
        for name, value in _ASSIGNMENT.findall(re.sub(r"%.*", "", self.text)):
            if (numbers := _numbers(value)) is not None:
                found[name] = numbers
        return found

    def place(self, key: str) -> str:
        """Return the file and an entry of it, for messages."""
        return f"{self.path}: {key}"


def _json(text: str) -> Mapping[str, Any]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


def _of_lists(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return lists of numbers as arrays, and texts and numbers as they are."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, list):
            try:
                found[str(name)] = np.array(value, dtype=np.float64)
            except (TypeError, ValueError, OverflowError):  # of texts, of other lengths
                continue
        elif isinstance(value, int | float | str):
            found[str(name)] = value
    return found


def _numbers(text: str) -> np.ndarray | None:
    """Return what MATLAB's ``[1 2; 3 4]`` or ``5`` stands for; None where it is no such thing."""
    rows = re.sub(r"\.\.\.\s*\n", " ", text.strip("[]")).strip().replace("\n", ";")
    try:
        values = [[float(x) for x in row.replace(",", " ").split()] for row in rows.split(";")]
        return np.array([row for row in values if row]).squeeze()
    except ValueError:  # texts, names of variables, rows of different lengths
        return None
