"""ROS's camera_info, a file a device, and mrcal's camera models."""

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
    POINTS,
    SIZE_CAMERA,
    SIZE_PROJECTOR,
    R,
    T,
    assert_projects,
    pixels,
    storage,
)
from scipy.spatial.transform import Rotation

from slbench.core.errors import InputError
from slbench.rig.files.entries import Stated, rig_entries
from slbench.rig.opencv import read_rig

ORDER = Stated(order="camera-projector", unit="mm")


def info(path, name, k, dist, size, turn=None, shift=0.0, model="plumb_bob"):
    def matrix(value):
        rows, columns = np.atleast_2d(value).shape
        return {"rows": rows, "cols": columns, "data": np.ravel(value).tolist()}

    projection = np.hstack((k, [[k[0, 0] * shift], [0.0], [0.0]]))
    values = {
        "image_width": size[0],
        "image_height": size[1],
        "camera_name": name,
        "camera_matrix": matrix(k),
        "distortion_model": model,
        "distortion_coefficients": matrix(dist),
        "rectification_matrix": matrix(np.eye(3) if turn is None else turn),
        "projection_matrix": matrix(projection),
    }
    path.write_text(yaml.safe_dump(values))
    return path


@pytest.fixture
def infos(tmp_path):
    return [
        info(tmp_path / "left.yaml", "camera", K_CAMERA, DIST_CAMERA, SIZE_CAMERA),
        info(tmp_path / "right.yaml", "projector", K_PROJECTOR, DIST_PROJECTOR, SIZE_PROJECTOR),
    ]


def test_a_rational_polynomial(infos, tmp_path):
    motion = storage(tmp_path / "motion.yml", R=R, T=T / 1e3)
    dists, names = (FULL_CAMERA[:8], FULL_PROJECTOR[:8]), ("camera", "projector")
    for path, name, k, dist, size in zip(
        infos, names, (K_CAMERA, K_PROJECTOR), dists, (SIZE_CAMERA, SIZE_PROJECTOR), strict=True
    ):
        info(path, name, k, dist, size, model="rational_polynomial")
    assert_projects(read_rig([*infos, motion]), pixels(*dists))


def test_a_third_file_states_the_motion_in_metres(infos, tmp_path):
    motion = storage(tmp_path / "motion.yml", R=R, T=T / 1e3)
    assert_projects(read_rig([*infos, motion]))
    assert rig_entries([*infos, motion]).format == "ros"
    plain = {"R": R.ravel().tolist(), "T": (T / 1e3).tolist()}
    (tmp_path / "motion.yaml").write_text(yaml.safe_dump(plain))
    assert_projects(read_rig([*infos, tmp_path / "motion.yaml"]))


@pytest.mark.parametrize("child", ["projector_optical_frame", "camera_optical_frame", None])
def test_a_transform_of_ros(child, infos, tmp_path):
    pose, position = R.T, -R.T @ T / 1e3  # the projector's, in the camera's frame
    header = {"frame_id": "camera_optical_frame"}
    if child == "camera_optical_frame":
        pose, position, header = R, T / 1e3, {"frame_id": "projector_optical_frame"}
    quaternion = Rotation.from_matrix(pose).as_quat()
    values = {
        "header": header if child else {},
        "transform": {
            "translation": dict(zip("xyz", position.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", quaternion.tolist(), strict=True)),
        },
    } | ({"child_frame_id": child} if child else {})
    (tmp_path / "tf.yaml").write_text(yaml.safe_dump(values))
    assert_projects(read_rig([*infos, tmp_path / "tf.yaml"]))


def test_a_rectified_pair_needs_no_third_file(tmp_path):
    # Rows of a common frame: x along the baseline.
    along = -R.T @ T / np.linalg.norm(T)
    down = np.cross([0.0, 0.0, 1.0], along)
    common = np.stack((along, down / np.linalg.norm(down), np.cross(along, down)))
    common[2] /= np.linalg.norm(common[2])
    first, second = common, common @ R.T
    baseline = -np.linalg.norm(T) / 1e3
    files = [
        info(tmp_path / "c.yaml", "cam", K_CAMERA, DIST_CAMERA, SIZE_CAMERA, first),
        info(
            *(tmp_path / "p.yaml", "proj", K_PROJECTOR, DIST_PROJECTOR, SIZE_PROJECTOR),
            *(second, baseline),
        ),
    ]
    # The definition: both rectified frames differ by a shift along x.
    there = POINTS @ R.T + T
    np.testing.assert_allclose(
        POINTS @ first.T + [1e3 * baseline, 0.0, 0.0], there @ second.T, atol=1e-9
    )
    assert_projects(read_rig(files))


def test_bad_camera_info(infos, tmp_path):
    with pytest.raises(InputError, match="or a third file with R and T"):
        read_rig(infos)
    with pytest.raises(InputError, match="expected two camera_info, one a device"):
        read_rig(infos[0])
    info(infos[0], "camera", K_CAMERA, DIST_CAMERA[:4], SIZE_CAMERA, model="equidistant")
    with pytest.raises(
        InputError, match=r"distortion_model: expected plumb_bob or .*'equidistant'"
    ):
        read_rig(infos)


def camera_model(path, model, numbers, size, turn, offset):
    def listed(values):
        return ", ".join(f"{value:.17g}" for value in values)

    path.write_text(
        "# generated on a day with a program\n{\n"
        f"    'lensmodel':  '{model}',\n    # intrinsics are fx,fy,cx,cy,k...\n"
        f"    'intrinsics': [ {listed(numbers)},],\n"
        f"    'extrinsics': [ {listed([*turn, *offset])},],\n"
        f"    'imagersize': [ {size[0]}, {size[1]} ]\n}}\n"
    )
    return path


#: From the reference frame to the camera, of neither device.
REFERENCE = (np.array([0.2, -0.1, 0.4]), np.array([30.0, -20.0, 500.0]))


def models(folder, n=5):
    cases = ((K_CAMERA, FULL_CAMERA, SIZE_CAMERA), (K_PROJECTOR, FULL_PROJECTOR, SIZE_PROJECTOR))
    turn, offset = REFERENCE
    first = cv2.Rodrigues(turn)[0]
    poses = ((turn, offset), (cv2.Rodrigues(R @ first)[0].ravel(), R @ offset + T))
    name = f"LENSMODEL_OPENCV{n}" if n else "LENSMODEL_PINHOLE"
    files = []
    for index, ((k, dist, size), pose) in enumerate(zip(cases, poses, strict=True)):
        numbers = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *dist[:n]]
        files.append(
            camera_model(folder / f"camera-{index}.cameramodel", name, numbers, size, *pose)
        )
    return files


@pytest.mark.parametrize("n", [0, 4, 5, 8, 12])
def test_mrcal(n, tmp_path):
    expected = pixels(FULL_CAMERA[:n] if n else None, FULL_PROJECTOR[:n] if n else None)
    files = models(tmp_path, n)
    assert_projects(read_rig(files, stated=ORDER), expected)
    assert rig_entries(files, ORDER).format == "mrcal"


def test_mrcal_in_metres_and_the_other_way_round(tmp_path):
    files = models(tmp_path)
    with pytest.raises(InputError, match=r"--unit .*--order .*'camera-0' and 'camera-1'"):
        read_rig(files)
    # The file named first is the projector's then.
    rig = read_rig(files[::-1], stated=Stated(unit="mm", order="projector-camera"))
    assert_projects(rig)


@pytest.mark.parametrize(
    "model", ["LENSMODEL_CAHVOR", "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3", "LENSMODEL_OPENCV6"]
)
def test_other_lenses_of_mrcal_are_refused_by_name(model, tmp_path):
    files = models(tmp_path)
    files[1].write_text(files[1].read_text().replace("LENSMODEL_OPENCV5", model))
    with pytest.raises(InputError, match=rf"camera-1.cameramodel: lensmodel: .* got '{model}'"):
        read_rig(files, stated=ORDER)
    with pytest.raises(InputError, match="two camera models"):
        read_rig(files[0], stated=ORDER)
