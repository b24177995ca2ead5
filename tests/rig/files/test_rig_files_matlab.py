"""MATLAB: Bouguet's toolbox, 0-based, and stereoParameters, transposed and 1-based."""

import struct

import numpy as np
import pytest
from calibrations import (
    DIST_CAMERA,
    DIST_PROJECTOR,
    K_CAMERA,
    K_PROJECTOR,
    POINTS,
    SIZE_CAMERA,
    SIZE_PROJECTOR,
    TURN,
    R,
    T,
    assert_projects,
)
from scipy.io import savemat

from slbench.core.errors import InputError
from slbench.rig.files.entries import Stated, rig_entries
from slbench.rig.opencv import read_rig

ORDER = Stated(order="camera-projector", sizes_px={"projector": SIZE_PROJECTOR})


def bouguet():
    values = {"om": TURN[:, None], "T": T[:, None], "nx": 1280.0, "ny": 1024.0}
    for name, k, dist in (("left", K_CAMERA, DIST_CAMERA), ("right", K_PROJECTOR, DIST_PROJECTOR)):
        values |= {
            f"fc_{name}": np.diag(k)[:2, None],
            f"cc_{name}": k[:2, 2][:, None],
            f"kc_{name}": dist[:, None],
            f"alpha_c_{name}": 0.0,
        }
    return values


def toolbox_pixels(points, turn, offset, fc, cc, kc):
    """The toolbox's project_points2, from its documentation: pixels counted from 0."""
    angle = np.linalg.norm(turn)
    axis = turn / angle if angle else turn
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    x, y, z = rotation @ points.T + offset[:, None]
    x, y = x / z, y / z
    r2 = x**2 + y**2
    radial = 1 + kc[0] * r2 + kc[1] * r2**2 + kc[4] * r2**3
    dx = 2 * kc[2] * x * y + kc[3] * (r2 + 2 * x**2)
    dy = kc[2] * (r2 + 2 * y**2) + 2 * kc[3] * x * y
    return np.stack((fc[0] * (x * radial + dx) + cc[0], fc[1] * (y * radial + dy) + cc[1]), -1)


def as_program(values):
    """The numbers as MATLAB prints them in a program."""
    lines = ["% Intrinsic and extrinsic parameters of a stereo rig"]
    for name, value in values.items():
        rows = " ; ".join(
            " ".join(f"{x:.15g}" for x in np.atleast_1d(row)) for row in np.atleast_2d(value)
        )
        lines.append(f"{name} = [ {rows} ];  % of {name}")
    return "\n".join([*lines, "disp('done');", ""])


@pytest.mark.parametrize("kind", ["mat", "m"])
@pytest.mark.parametrize("turn", ["om", "R"])
def test_bouguet_s_toolbox(kind, turn, tmp_path):
    values = bouguet()
    if turn == "R":
        values["R"] = R
        del values["om"]
    path = tmp_path / f"Calib_Results_stereo.{kind}"
    if kind == "mat":
        savemat(path, values)
    else:
        path.write_text(as_program(values))
    expected = tuple(
        toolbox_pixels(
            *(POINTS, *motion),
            *(values[f"{what}_{name}"].ravel() for what in ("fc", "cc", "kc")),
        )
        for name, motion in (("left", (np.zeros(3), np.zeros(3))), ("right", (TURN, T)))
    )
    rig = read_rig(path, stated=ORDER)
    assert_projects(rig, expected)
    assert_projects(rig)
    assert rig_entries(path, ORDER).format == "bouguet"


def test_skew_is_refused_and_a_missing_variable_named(tmp_path):
    path = tmp_path / "c.mat"
    savemat(path, bouguet() | {"alpha_c_left": 0.01})
    with pytest.raises(InputError, match=r"c\.mat: alpha_c_left: expected fx 0 cx, .* no skew"):
        read_rig(path, stated=ORDER)
    for key, what in (("kc_right", "kc_right"), ("om", "om"), ("T", "T")):
        savemat(path, {name: value for name, value in bouguet().items() if name != key})
        with pytest.raises(InputError, match=rf"c\.mat: {what}: expected"):
            read_rig(path, stated=ORDER)


def structure(new=False, radial=3):
    """``toStruct(stereoParams)``: matrices are transposed, points are rows, pixels count from 1."""

    def one(k, dist, size):
        shifted = k.copy()
        shifted[:2, 2] += 1.0
        name = "K" if new else "IntrinsicMatrix"
        return {
            "RadialDistortion": dist[[0, 1, 4]][None, :radial],
            "TangentialDistortion": dist[None, 2:4],
            "ImageSize": np.array([size[::-1]], dtype=np.float64),
            name: shifted if new else shifted.T,
            "WorldUnits": "millimeters",
        }

    return {
        "CameraParameters1": one(K_CAMERA, DIST_CAMERA, SIZE_CAMERA),
        "CameraParameters2": one(K_PROJECTOR, DIST_PROJECTOR, SIZE_PROJECTOR),
        "RotationOfCamera2": R.T,
        "TranslationOfCamera2": T[None],
    }


def matlab_pixels(points, parameters, new):
    """Where MATLAB has points (rows) in the device's frame, from its documentation: from 1."""
    x, y = (points[:, :2] / points[:, 2:]).T
    r2 = x**2 + y**2
    k1, k2, k3 = parameters["RadialDistortion"][0]
    p1, p2 = parameters["TangentialDistortion"][0]
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    yd = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    matrix = parameters["K"].T if new else parameters["IntrinsicMatrix"]
    return (np.stack((xd, yd, np.ones_like(x)), -1) @ matrix)[:, :2]


@pytest.mark.parametrize("new", [False, True], ids=["IntrinsicMatrix", "K"])
@pytest.mark.parametrize("nested", [False, True], ids=["variables", "structure"])
def test_stereo_parameters(new, nested, tmp_path):
    values = structure(new)
    path = tmp_path / "stereo.mat"
    savemat(path, {"s": values} if nested else values)
    rows = POINTS @ values["RotationOfCamera2"] + values["TranslationOfCamera2"]
    expected = (
        matlab_pixels(POINTS, values["CameraParameters1"], new) - 1.0,
        matlab_pixels(rows, values["CameraParameters2"], new) - 1.0,
    )
    rig = read_rig(path, stated=Stated(order="camera-projector"))
    assert_projects(rig, expected)
    assert_projects(rig)


def test_the_pose_of_the_second_camera(tmp_path):
    values = structure(new=True)
    values["PoseCamera2"] = {"R": R.T, "Translation": (-R.T @ T)[None], "Dimensionality": 3}
    del values["RotationOfCamera2"], values["TranslationOfCamera2"]
    savemat(tmp_path / "stereo.mat", values)
    assert_projects(read_rig(tmp_path / "stereo.mat", stated=Stated(order="camera-projector")))


def test_units_two_radial_coefficients_and_the_first_pixel(tmp_path):
    values = structure(radial=2)
    values["CameraParameters1"]["WorldUnits"] = "meters"
    values["TranslationOfCamera2"] = T[None] / 1e3
    savemat(tmp_path / "stereo.mat", values)
    stated = Stated(order="camera-projector", first_pixel=0)
    rig = read_rig(tmp_path / "stereo.mat", stated=stated)
    np.testing.assert_allclose(rig.projector.pose.to_local(np.zeros(3)), T, rtol=1e-12)
    np.testing.assert_allclose(rig.camera.distortion, [*DIST_CAMERA[:4], 0.0])
    # Whoever states that pixels count from 0 has the principal point as it stands.
    np.testing.assert_allclose(rig.camera.centre, K_CAMERA[:2, 2] + 1.0)
    values["CameraParameters1"]["WorldUnits"] = "parsecs"
    savemat(tmp_path / "stereo.mat", values)
    with pytest.raises(InputError, match="WorldUnits: expected um or mm"):
        read_rig(tmp_path / "stereo.mat", stated=stated)


def test_files_of_matlab_that_cannot_be_read(tmp_path):
    path = tmp_path / "stereo.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    with pytest.raises(InputError, match="up to version 7: save"):
        read_rig(path)
    savemat(path, structure())
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(InputError, match=r"stereo\.mat: expected "):
        read_rig(path, stated=Stated(order="camera-projector"))
    values = structure()
    del values["CameraParameters2"]["IntrinsicMatrix"]
    savemat(path, values)
    with pytest.raises(InputError, match=r"CameraParameters2\.IntrinsicMatrix: expected this"):
        read_rig(path, stated=Stated(order="camera-projector"))


def test_no_rotation_is_quoted_as_it_stands_in_the_file(tmp_path):
    values = structure()
    values["RotationOfCamera2"] = R.T + 0.01 * np.eye(3)[0]
    savemat(tmp_path / "stereo.mat", values)
    with pytest.raises(InputError) as caught:
        read_rig(tmp_path / "stereo.mat", stated=Stated(order="camera-projector"))
    own = values["RotationOfCamera2"].tolist()
    assert f"RotationOfCamera2: expected a rotation, to 0.001, got {own}" in str(caught.value)


def test_an_object_is_refused_with_what_to_do(tmp_path):
    """As ``save('stereo.mat', 'stereoParams')`` writes it: class 17, which nobody documents."""

    def element(kind, content):
        return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)

    content = element(6, struct.pack("<II", 17, 0)) + element(1, b"stereoParams")
    content += element(1, b"MCOS") + element(1, b"stereoParameters")
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    (tmp_path / "stereo.mat").write_bytes(head + element(14, content))
    with pytest.raises(InputError, match=r"s = toStruct\(stereoParams\).* only MATLAB can read"):
        read_rig(tmp_path / "stereo.mat")
