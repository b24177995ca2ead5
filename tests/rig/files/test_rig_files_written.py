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
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat

from slbench.core.errors import InputError, InputWarning
from slbench.rig import Lens, Pose
from slbench.rig.files.base import CalibratedDevice, Calibration
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


NUMBER = st.floats(-1.0, 1.0)
#: Coefficients of distortion that a format has, if not five.
MOST = {"opencv": 14, "ros": 8, "mrcal": 12}


@settings(max_examples=40, deadline=None)
@given(
    turn=st.tuples(NUMBER, NUMBER, NUMBER),
    offset=st.tuples(NUMBER, NUMBER, NUMBER).filter(lambda one: np.linalg.norm(one) > 1e-2),
    centre=st.tuples(NUMBER, NUMBER),
    name=st.sampled_from(written_formats()),
    counts=st.tuples(*[st.sampled_from((0, 4, 5, 8, 12, 14))] * 2),
    data=st.data(),
)
def test_any_calibration_comes_back(tmp_path_factory, turn, offset, centre, name, counts, data):
    """Poses, and as many coefficients as a format has, whatever our devices make of them."""
    rotation = cv2.Rodrigues(2.0 * np.array(turn))[0]
    drawn = [np.array(data.draw(st.lists(NUMBER, min_size=n, max_size=n))) for n in counts]
    devices = [
        CalibratedDevice(
            name=role,
            matrix=np.array(
                [[2000.0, 0, 600 + centre[0]], [0, 2100.0, 500 + centre[1]], [0, 0, 1]]
            ),
            distortion=distortion,
            size=size,
        )
        for role, distortion, size in zip(SIZES, drawn, SIZES.values(), strict=True)
    ]
    calibration = Calibration(
        first=devices[0],
        second=devices[1],
        rotation=rotation,
        translation=300.0 * np.array(offset),
        unit="mm",
    )
    one = rig_formats.get(name)
    path = tmp_path_factory.mktemp("written") / f"out{one.suffixes[0]}"
    used = max(int(np.max(np.nonzero(d)[0], initial=-1)) + 1 for d in drawn)
    if used > MOST.get(name, 5):
        with pytest.raises(InputError, match=f"at most {MOST.get(name, 5)} coefficients"):
            one.contents(calibration, path)
        return
    contents = one.contents(calibration, path)
    for file, content in contents.items():
        file.write_bytes(content)
    stated = Stated(unit="m" if name == "ros" else "mm", sizes_px=SIZES, order="camera-projector")
    values = rig_entries(list(contents), stated).values
    # Through a rotation vector or a quaternion, and in metres.
    np.testing.assert_allclose(values["R"], rotation, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(values["T"].ravel(), calibration.translation, rtol=1e-9, atol=1e-9)
    for device in devices:
        np.testing.assert_allclose(values[f"K_{device.name}"], device.matrix, rtol=1e-14)
        back = values[f"dist_{device.name}"].ravel()
        length = max(back.size, device.distortion.size)
        found, given_ = (np.append(d, np.zeros(length - d.size)) for d in (back, device.distortion))
        np.testing.assert_array_equal(found, given_)
