"""MAT-files: what SciPy writes is read as SciPy reads it; damage is refused, not run into."""

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.io import loadmat, savemat

from slbench.core.errors import InputError
from slbench.core.io.matfile import OtherArray, read_mat

TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")


@settings(max_examples=60, deadline=None)
@given(st.data(), st.booleans())
def test_arrays_are_those_of_scipy(tmp_path_factory, data, packed):
    kind = np.dtype(data.draw(st.sampled_from(TYPES)))
    shape = data.draw(arrays.array_shapes(min_dims=1, max_dims=3, max_side=9))
    value = data.draw(arrays.arrays(kind, shape))
    path = tmp_path_factory.mktemp("mat") / "a.mat"
    savemat(path, {"value": value, "beside": 3.0}, do_compression=packed, oned_as="column")
    found = read_mat(path)
    np.testing.assert_array_equal(found["value"], loadmat(path)["value"].astype(np.float64))
    assert found["beside"] == 3.0


@pytest.mark.parametrize("packed", [False, True])
def test_structures_texts_and_what_is_not_read(packed, tmp_path):
    large = np.arange(70_000.0).reshape(7, 10_000)  # more than 65536 bytes
    values = {
        "s": {"inner": {"K": np.eye(3), "unit": "millimeters"}, "empty": np.empty((0, 0))},
        "text": "µm",
        "large": large,
        "cells": np.array([1, "two"], dtype=object),
        "complex": 1j * np.eye(2),
        "many": np.zeros(2, dtype=[("a", "f8")]),
    }
    savemat(tmp_path / "a.mat", values, do_compression=packed)
    found = read_mat(tmp_path / "a.mat")
    np.testing.assert_array_equal(found["s"]["inner"]["K"], np.eye(3))
    assert found["s"]["inner"]["unit"] == "millimeters"
    assert found["s"]["empty"].size == 0
    assert found["text"] == "µm"
    np.testing.assert_array_equal(found["large"], large)
    assert all(isinstance(found[name], OtherArray) for name in ("cells", "complex", "many"))


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


def test_an_object_of_matlab_s_classes_is_named(tmp_path):
    """As MATLAB writes ``save('stereo.mat', 'stereoParams')``: class 17, without sides."""
    content = element(6, struct.pack("<II", 17, 0)) + element(1, b"stereoParams")
    content += element(1, b"MCOS") + element(1, b"stereoParameters")
    (tmp_path / "a.mat").write_bytes(HEADER + element(14, content))
    assert repr(read_mat(tmp_path / "a.mat")["stereoParams"]).startswith("an object that only")


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    size = 2**30
    packer = zlib.compressobj(9)
    packed = packer.compress(struct.pack("<II", 14, size))
    packed += b"".join(packer.compress(bytes(2**20)) for _ in range(200)) + packer.flush()
    path = tmp_path / "a.mat"
    path.write_bytes(HEADER + struct.pack("<II", 15, len(packed)) + packed)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"a\.mat: expected at most"):
        read_mat(path)
    assert tracemalloc.get_traced_memory()[1] < 2**25
    tracemalloc.stop()


@settings(max_examples=300, deadline=None)
@given(at=st.integers(0, 2000), byte=st.integers(0, 255), packed=st.booleans())
def test_a_damaged_file_is_read_or_refused(tmp_path_factory, at, byte, packed):
    """SciPy's own reader ends the process for some of these."""
    path = tmp_path_factory.mktemp("mat") / "a.mat"
    values = {"s": {"K": np.eye(3), "unit": "mm"}, "T": np.arange(3.0)}
    savemat(path, values, do_compression=packed)
    content = bytearray(path.read_bytes())
    content[at % len(content)] = byte
    path.write_bytes(content)
    try:
        found = read_mat(path)
    except InputError:
        return
    assert all(isinstance(v, np.ndarray | str | dict | OtherArray) for v in found.values())
