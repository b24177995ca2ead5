"""Rigs in the files of other programs: read back, they project to the same pixels."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from calibrations import (
    DIST_CAMERA,
    DIST_PROJECTOR,
    K_CAMERA,
    K_PROJECTOR,
    SIZE_CAMERA,
    SIZE_PROJECTOR,
    R,
    T,
    assert_projects,
    storage,
)
from scipy.io import loadmat

from slbench.core.errors import InputError, InputWarning
from slbench.rig import Lens, Pose
from slbench.rig.files.entries import Stated, rig_entries
from slbench.rig.files.registry import rig_formats
from slbench.rig.files.writing import write_calibration, written_formats
from slbench.rig.opencv import read_rig

SIZES = {"camera": SIZE_CAMERA, "projector": SIZE_PROJECTOR}


@pytest.fixture
def rig(tmp_path):
    values = {"K_camera": K_CAMERA, "dist_camera": DIST_CAMERA, "K_projector": K_PROJECTOR}
    values |= {"dist_projector": DIST_PROJECTOR, "R": R, "T": T}
    sizes = {f"size_{name}": np.array(size, dtype=np.float64) for name, size in SIZES.items()}
    return read_rig(storage(tmp_path / "own.yaml", **values, **sizes))


@pytest.mark.parametrize("name", written_formats())
def test_what_is_written_is_read_back(name, rig, tmp_path):
    for suffix in rig_formats.get(name).suffixes:
        files = write_calibration(tmp_path / f"out{suffix}", rig, name)
        # What a format does not say; names of devices tell the order in some.
        stated = Stated(unit="m" if name == "ros" else "mm", sizes_px=SIZES)
        entries = rig_entries(files, replace(stated, order="camera-projector"))
        assert entries.format == name
        back = read_rig(files, stated=replace(stated, order="camera-projector"))
        assert_projects(back, atol=1e-9)


def test_each_format_is_written_but_matlab_s_structure():
    assert set(rig_formats) - set(written_formats()) == {"matlab"}
    with pytest.raises(InputError, match=r"--to: expected one of slstudio, .* got 'matlab'"):
        write_calibration("out.mat", None, "matlab")


def test_other_programs_find_their_names(rig, tmp_path):
    (path,) = write_calibration(tmp_path / "c.xml", rig, "slstudio")
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_allclose(file.getNode("Kp").mat(), K_PROJECTOR, rtol=1e-12)
    assert file.getNode("kc").mat().shape == (5, 1)
    assert file.getNode("screenResX").real() == 1280
    file.release()
    (path,) = write_calibration(tmp_path / "c.mat", rig, "bouguet")
    values = loadmat(path)
    np.testing.assert_allclose(cv2.Rodrigues(values["om"])[0], R, atol=1e-12)
    np.testing.assert_allclose(values["kc_right"].ravel(), DIST_PROJECTOR)


def test_the_world_is_left_out_with_a_word(rig, tmp_path):
    """Poses in another world: what is written is relative, and so the same."""
    frame = Pose(cv2.Rodrigues(np.array([0.3, 0.2, -0.5]))[0], np.array([10.0, 20.0, -400.0]))

    def moved(device):
        pose = device.pose
        return device.posed(Pose(frame.rotation @ pose.rotation, frame.to_world(pose.position)))

    elsewhere = rig.having(camera=moved(rig.camera), projector=moved(rig.projector))
    with pytest.warns(InputWarning, match="points are in the camera's frame"):
        files = write_calibration(tmp_path / "c.xml", elsewhere, "slstudio")
    assert_projects(read_rig(files))


def test_what_a_format_has_no_words_for(rig, tmp_path):
    tilted = rig.having(camera=replace(rig.camera, tilt_rad=(0.02, 0.0)))
    with pytest.raises(InputError, match="the camera: expected at most 12 coefficients"):
        write_calibration(tmp_path / "c.cameramodel", tilted, "mrcal")
    (path,) = write_calibration(tmp_path / "c.yml", tilted, "opencv")
    stated = Stated(unit="mm", order="camera-projector", sizes_px=SIZES)
    assert read_rig(path, stated=stated).camera.tilt_rad == (0.02, 0.0)
    lens = Lens.telecentric(0.1, 0.02, 200.0)
    telecentric = rig.having(projector=replace(rig.projector, lens=lens))
    with pytest.raises(InputError, match="the projector: expected a perspective lens"):
        write_calibration(tmp_path / "d.yml", telecentric, "opencv")
    with pytest.raises(InputError, match=r"ends in \.cameramodel"):
        write_calibration(tmp_path / "d.yml", rig, "mrcal")
    assert not list(tmp_path.glob("d*"))
