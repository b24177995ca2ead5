"""OpenCV's matrices by the names that programs give them, in one file or two."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from calibrations import (
    DIST_CAMERA,
    DIST_PROJECTOR,
    FULL_CAMERA,
    FULL_PROJECTOR,
    K_CAMERA,
    K_PROJECTOR,
    SIZE_CAMERA,
    SIZE_PROJECTOR,
    TURN,
    R,
    T,
    assert_projects,
    pixels,
    storage,
)
from scipy.io import savemat
from test_rig_files_matlab import as_program

from slbench.core.errors import InputError
from slbench.rig.files.base import CalibratedDevice
from slbench.rig.files.entries import Stated, rig_entries
from slbench.rig.opencv import read_rig

SIZES = {"camera": SIZE_CAMERA, "projector": SIZE_PROJECTOR}
ALL = Stated(unit="mm", order="camera-projector", sizes_px=SIZES)
#: Names tell the order here, and files some sizes.
UNIT = replace(ALL, order=None)


def test_the_sample_of_opencv_writes_two_files(tmp_path):
    inner = storage(
        tmp_path / "intrinsics.yml", M1=K_CAMERA, D1=DIST_CAMERA, M2=K_PROJECTOR, D2=DIST_PROJECTOR
    )
    # What cv2.stereoRectify adds beside it is of no account.
    outer = storage(
        tmp_path / "extrinsics.yml", R=R, T=T, R1=np.eye(3), R2=R.T, P1=np.eye(3, 4), Q=np.eye(4)
    )
    for files in ((inner, outer), (outer, inner)):
        assert_projects(read_rig(files, stated=ALL))
        assert rig_entries(files, ALL).format == "opencv"
    with pytest.raises(InputError, match=r"R: expected this entry, or a second file with it"):
        read_rig(inner, stated=ALL)


@pytest.mark.parametrize("count", [8, 12, 14])
def test_the_sample_of_opencv_is_rational_by_default(tmp_path, count):
    dists = FULL_CAMERA[:count], FULL_PROJECTOR[:count]
    inner = storage(
        tmp_path / "intrinsics.yml", M1=K_CAMERA, D1=dists[0], M2=K_PROJECTOR, D2=dists[1]
    )
    outer = storage(tmp_path / "extrinsics.yml", R=R, T=T)
    assert_projects(read_rig((inner, outer), stated=ALL), pixels(*dists))


@pytest.mark.parametrize(
    "names",
    [
        ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
        ("K1", "D1", "K2", "D2", "R", "T"),
        ("K_l", "dist_l", "K_r", "dist_r", "R", "T"),
        ("camera_matrix_left", "dist_left", "camera_matrix_right", "dist_right", "R", "T"),
        ("left_mtx", "left_dist", "right_mtx", "right_dist", "rotation_matrix", "translation"),
        ("intrinsic0", "distortion0", "intrinsic1", "distortion1", "rot", "trans"),
        # SLScanner's two cameras: K is upper case, its distortion is not.
        ("K0", "k0", "K1", "k1", "R", "T"),
    ],
)
def test_usual_names_of_two_devices(names, tmp_path):
    values = (K_CAMERA, DIST_CAMERA, K_PROJECTOR, DIST_PROJECTOR, R, T)
    path = storage(tmp_path / "calibration.yml", **dict(zip(names, values, strict=True)))
    assert_projects(read_rig(path, stated=ALL))


@pytest.mark.parametrize(
    "names",
    [
        ("camera_K", "camera_dist", "projector_K", "projector_dist", "R", "T"),
        ("cam_mtx", "cam_dist", "proj_mtx", "proj_dist", "R", "T"),
        ("CameraMatrixProjector", "distProjector", "cameraMatrixCamera", "distCamera", "R", "T"),
    ],
)
def test_names_tell_which_device_is_the_projector(names, tmp_path):
    values = (K_CAMERA, DIST_CAMERA, K_PROJECTOR, DIST_PROJECTOR, R, T)
    if "Projector" in names[0]:
        values = (K_PROJECTOR, DIST_PROJECTOR, K_CAMERA, DIST_CAMERA, R, T)
    path = storage(tmp_path / "calibration.yml", **dict(zip(names, values, strict=True)))
    assert_projects(read_rig(path, stated=UNIT))
    with pytest.raises(InputError, match="order: expected camera-projector, as the first device"):
        read_rig(path, stated=replace(UNIT, order="projector-camera"))


def test_the_projector_may_be_the_first_device(tmp_path):
    back = {"R": R.T, "T": -R.T @ T}
    first = {"M1": K_PROJECTOR, "D1": DIST_PROJECTOR, "M2": K_CAMERA, "D2": DIST_CAMERA}
    path = storage(tmp_path / "stereo.yml", **first, **back)
    assert_projects(read_rig(path, stated=replace(ALL, order="projector-camera")))


@pytest.mark.parametrize(("unit", "mm"), [("m", 1e3), ("cm", 10.0), ("inch", 25.4), ("um", 1e-3)])
def test_the_unit_is_of_the_translation_alone(unit, mm, tmp_path):
    path = storage(tmp_path / "s.yml", M1=K_CAMERA, M2=K_PROJECTOR, R=R, T=T / mm)
    rig = read_rig(path, stated=replace(ALL, unit=unit))
    np.testing.assert_allclose(rig.projector.pose.to_local(np.zeros(3)), T, rtol=1e-12)


def test_metres_taken_for_millimetres_are_noticed(tmp_path):
    path = storage(tmp_path / "s.yml", M1=K_CAMERA, M2=K_PROJECTOR, R=R, T=T / 1e3)
    with pytest.warns(UserWarning, match="in metres it would be 132"):
        read_rig(path, stated=ALL)


def test_a_rotation_may_be_a_vector_and_distortion_missing(tmp_path):
    path = storage(tmp_path / "s.yml", M1=K_CAMERA, M2=K_PROJECTOR, R=TURN, T=T)
    rig = read_rig(path, stated=ALL)
    np.testing.assert_allclose(rig.projector.pose.rotation.T, cv2.Rodrigues(TURN)[0], atol=1e-12)
    assert rig.camera.distortion == (0.0,) * 5


def test_what_a_file_does_not_say_is_asked_for_at_once(tmp_path):
    path = storage(tmp_path / "s.yml", M1=K_CAMERA, M2=K_PROJECTOR, R=R, T=T / 1e3)
    with pytest.raises(InputError) as caught:
        read_rig(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: expected what the file does not say, with slbench rig convert")
    for option in ("--unit um|mm|cm|inch|m (T is 0.1329 long)", "--order camera-projector"):
        assert option in line
    assert "--size-camera WIDTHxHEIGHT, --size-projector WIDTHxHEIGHT" in line
    assert "(the devices are '1' and '2')" in line


def test_a_size_of_all_pictures_is_the_camera_s(tmp_path):
    size = np.array(SIZE_CAMERA, dtype=np.float64)
    path = storage(tmp_path / "s.yml", M1=K_CAMERA, M2=K_PROJECTOR, R=R, T=T, imageSize=size)
    with pytest.raises(InputError, match="--size-projector") as caught:
        read_rig(path, stated=replace(ALL, sizes_px={}))
    assert "--size-camera" not in str(caught.value)


def test_the_pitch_that_a_person_states_is_the_rig_s(tmp_path):
    path = storage(tmp_path / "s.yml", M1=K_CAMERA, M2=K_PROJECTOR, R=R, T=T)
    stated = replace(ALL, pitches_um={"camera": 3.45, "projector": 5.4})
    rig = read_rig(path, stated=stated)
    assert rig.camera.pitch_mm[0] == pytest.approx(3.45e-3)
    assert rig.projector.lens.focal_length_mm == pytest.approx(1820.0 * 5.4e-3)


def test_bad_files_are_one_line(tmp_path):
    good = {"M1": K_CAMERA, "D1": DIST_CAMERA, "M2": K_PROJECTOR, "R": R, "T": T}
    for key, value, where in (
        ("R", R + 0.01, r"s.yml: R: expected a rotation, to 0.001, got \[\[0\.9"),
        ("M1", K_CAMERA + np.eye(3)[1][:, None] * 0.1, "s.yml: M1: expected fx 0 cx"),
        ("T", np.full(3, np.nan), "s.yml: T: expected three finite numbers"),
        ("lens", "fisheye", "s.yml: lens: expected OpenCV's pinhole"),
        ("fisheye_model", 1, "s.yml: fisheye_model: expected OpenCV's pinhole"),
        ("D2", np.zeros(6), "s.yml: D2: expected 4 or 5 "),
        ("distCoeffs2", "none", "s.yml: distCoeffs2: expected coefficients"),
        ("M3", K_CAMERA, "s.yml: M3: expected two devices, a camera and a projector, got 3"),
        ("T", np.zeros(2), "s.yml: T: expected this entry"),
    ):
        path = storage(tmp_path / "s.yml", **(good | {key: value}))
        with pytest.raises(InputError, match=where) as caught:
            read_rig(path, stated=ALL)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=r"unit: expected um or .* got 'ml'; did you mean 'm'"):
        read_rig(storage(tmp_path / "s.yml", **good), stated=replace(ALL, unit="ml"))


def test_a_file_of_no_format_says_what_it_has(tmp_path):
    path = storage(tmp_path / "s.yml", rows=7, columns=9, name="board")
    with pytest.raises(InputError, match=r"expected a rig: ours; .* got entries rows, columns"):
        read_rig(path)
    for content in (b"", b"hello\n", b"\x00\x01", b"{'a': ", b"[1, 2"):
        (tmp_path / "any").write_bytes(content)
        with pytest.raises(InputError, match=r"any: expected a "):
            read_rig(tmp_path / "any")


def test_our_own_files_take_no_options(tmp_path):
    path = storage(tmp_path / "rig.yml", K_camera=K_CAMERA, K_projector=K_PROJECTOR)
    with pytest.raises(InputError, match="no unit, size, pitch, order or first pixel beside"):
        read_rig(path, stated=ALL)


def test_a_file_a_device_and_one_of_the_motion(tmp_path):
    """As OpenCV's sample for one camera writes them, once for each."""
    files = [
        storage(
            tmp_path / f"{name}_calibration.yml",
            **{"camera_matrix": k, "distortion_coefficients": dist},
            **{"image_width": size[0], "image_height": size[1], "avg_reprojection_error": 0.2},
        )
        for name, k, dist, size in (
            ("projector", K_PROJECTOR, DIST_PROJECTOR, SIZE_PROJECTOR),
            ("camera", K_CAMERA, DIST_CAMERA, SIZE_CAMERA),
        )
    ]
    motion = storage(tmp_path / "motion.yml", R=R.T, T=-R.T @ T)
    # Names of files tell which is which; the first one is that of the motion's frame.
    assert_projects(read_rig([*files, motion], stated=Stated(unit="mm")))
    with pytest.raises(InputError, match="R: expected this entry"):
        read_rig(files, stated=Stated(unit="mm"))


def test_what_else_is_written_beside_is_of_no_account(tmp_path):
    """A day in May in a language in which it is called like a lens; rectified matrices."""
    more = {"calibration_time": "11 Mei 2024", "K1": np.eye(3, 4), "fisheye_model": 0, "flags": 7}
    more |= {"R1": np.eye(3), "R2": R.T, "P1": np.eye(3, 4), "F": np.eye(3), "rms": 0.2}
    good = {"M1": K_CAMERA, "D1": DIST_CAMERA, "M2": K_PROJECTOR, "D2": DIST_PROJECTOR}
    path = storage(tmp_path / "s.yml", **good, R=R, T=T, **more)
    assert_projects(read_rig(path, stated=ALL))


@pytest.mark.parametrize(
    ("name", "role"),
    [
        *(("camera", "camera"), ("cam0", "camera"), ("Cam_1", "camera"), ("c", "camera")),
        *(("projector", "projector"), ("my-proj", "projector"), ("P", "projector")),
        *(("left", None), ("1", None), ("c920", None), ("process", None), ("camera_of_proj", None)),
    ],
)
def test_what_a_name_tells(name, role):
    device = CalibratedDevice(name=name, matrix=np.eye(3), distortion=np.empty(0))
    assert device.role == role


STEREO = {"mtx1": K_CAMERA, "dist1": DIST_CAMERA, "mtx2": K_PROJECTOR, "dist2": DIST_PROJECTOR}
STEREO |= {"R": R, "T": T[:, None]}


@pytest.mark.parametrize("kind", ["npz", "json", "yaml", "mat", "m"])
def test_any_file_that_gives_names_to_arrays(kind, tmp_path):
    path = tmp_path / f"stereo.{kind}"
    lists = {name: value.tolist() for name, value in STEREO.items()} | {"note": "by hand"}
    if kind == "npz":
        np.savez(path, **STEREO)
    elif kind == "mat":
        savemat(path, STEREO | {"pictures": np.array(["a.png", 7], dtype=object)})
    elif kind == "m":
        path.write_text(as_program(STEREO))
    else:
        path.write_text(json.dumps(lists) if kind == "json" else yaml.safe_dump(lists))
    assert_projects(read_rig(path, stated=ALL))
    assert rig_entries(path, ALL).format == "opencv"


def test_moreno_and_taubin_s_program_for_matlab(tmp_path):
    names = ("cam_K", "cam_kc", "proj_K", "proj_kc", "R", "T")
    (tmp_path / "calibration.m").write_text(
        as_program(dict(zip(names, STEREO.values(), strict=True)))
    )
    assert_projects(read_rig(tmp_path / "calibration.m", stated=replace(UNIT, unit=None)))


def test_an_archive_that_is_none(tmp_path):
    np.savez(tmp_path / "a.npz", mtx1=K_CAMERA, boards=np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"a\.npz: boards: expected a plain array"):
        read_rig(tmp_path / "a.npz", stated=ALL)
