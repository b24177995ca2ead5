"""Damaged files of every format: read, or refused as input."""

import contextlib
import json
import tracemalloc
import warnings
from dataclasses import replace

import numpy as np
import pytest
from calibrations import K_CAMERA, K_PROJECTOR, SIZE_CAMERA, SIZE_PROJECTOR, R, T, storage
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from test_rig_files_matlab import as_program, bouguet, structure
from test_rig_files_ros_mrcal import info, models

from slbench.core.errors import InputError
from slbench.rig.files.entries import Stated
from slbench.rig.opencv import read_rig

ALL = Stated(unit="mm", sizes_px={"camera": SIZE_CAMERA, "projector": SIZE_PROJECTOR})


KINDS = (*("opencv", "xml", "numpy", "json", "bouguet", "program", "matlab", "ros", "mrcal"),)


def made(folder):
    """Return the files of each format, the first of which is to be damaged."""
    savemat(folder / "b.mat", bouguet())
    savemat(folder / "s.mat", structure())
    (folder / "b.m").write_text(as_program(bouguet()))
    np.savez(folder / "a.npz", K1=K_CAMERA, K2=K_PROJECTOR, R=R, T=T)
    lists = {"K1": K_CAMERA.tolist(), "K2": K_PROJECTOR.tolist(), "R": R.tolist(), "T": T.tolist()}
    (folder / "a.json").write_text(json.dumps(lists))
    opencv = {"M1": K_CAMERA, "M2": K_PROJECTOR, "R": R, "T": T}
    infos = [
        info(folder / f"{name}.yaml", name, k, [0.1, 0.0, 0.0, 0.0, 0.0], size)
        for name, k, size in (
            ("cam", K_CAMERA, SIZE_CAMERA),
            ("proj", K_PROJECTOR, SIZE_PROJECTOR),
        )
    ]
    return {
        "opencv": [storage(folder / "o.yml", **opencv)],
        "xml": [storage(folder / "o.xml", **opencv)],
        "numpy": [folder / "a.npz"],
        "json": [folder / "a.json"],
        "bouguet": [folder / "b.mat"],
        "program": [folder / "b.m"],
        "matlab": [folder / "s.mat"],
        "ros": [*infos, storage(folder / "motion.yml", R=R, T=T)],
        "mrcal": models(folder),
    }


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_no_fault_of_ours(kind, tmp_path):
    files = made(tmp_path)[kind]
    whole = files[0].read_bytes()

    @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
    @given(
        cut=st.integers(0, len(whole)),
        at=st.integers(0, len(whole) - 1),
        byte=st.integers(0, 255),
        way=st.sampled_from(("cut", "change", "insert")),
    )
    def damaged(cut, at, byte, way):
        content = {
            "cut": whole[:cut],
            "change": whole[:at] + bytes([byte]) + whole[at + 1 :],
            "insert": whole[:at] + bytes([byte]) * 3 + whole[at:],
        }[way]
        files[0].write_bytes(content)
        for order in ("camera-projector", None):
            with warnings.catch_warnings(), contextlib.suppress(InputError):
                warnings.simplefilter("ignore")
                read_rig(files, stated=replace(ALL, order=order))

    damaged()


def test_a_few_lines_that_stand_for_many_numbers(tmp_path):
    lines = ["a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    (tmp_path / "bomb.yaml").write_text("\n".join([*lines, "camera_matrix: *a11", ""]))
    tracemalloc.start()
    with pytest.raises(InputError, match=r"bomb\.yaml: expected a rig"):
        read_rig(tmp_path / "bomb.yaml")
    assert tracemalloc.get_traced_memory()[1] < 2**25
    tracemalloc.stop()
