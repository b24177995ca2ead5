"""Scenes whose world is the camera's frame, as in a file of ``cv2.stereoCalibrate``."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import run_cli, small

from slbench.core.errors import InputError
from slbench.core.io import read_opencv_yaml, write_opencv_yaml
from slbench.design.fringes.trial import noise_of_scene
from slbench.report.plots.draw import scene_picture
from slbench.rig import Pose
from slbench.rig.opencv import write_rig
from slbench.scene.file import load_scene


@pytest.fixture(scope="module")
def scene():
    return small("plane", divisor=2)


@pytest.fixture(scope="module")
def turned(scene):
    """The same measurement, described in the camera's frame."""
    frame = scene.rig.camera.pose

    def moved(one):
        rotation, position = frame.rotation.T @ one.pose.rotation, frame.to_local(one.pose.position)
        return replace(one, pose=Pose(rotation, position))

    devices = {name: moved(one) for name, one in scene.rig.devices.items()}
    objects = tuple(moved(one) for one in scene.objects)
    return replace(scene, rig=scene.rig.having(**devices), objects=objects)


def test_the_volume_is_about_the_object(scene, turned):
    assert scene.rig.faces_origin
    assert scene.place == Pose()
    assert not turned.rig.faces_origin
    np.testing.assert_allclose(turned.place.position, turned.objects[0].middle)
    # Its z leads to the camera.
    np.testing.assert_allclose(turned.place.rotation[:, 2], -turned.rig.camera.pose.rotation[:, 2])


def test_noise_is_that_of_the_same_scene(scene, turned):
    one, two = (
        noise_of_scene(each, (4, 16), z_mm=[0.0], repeats=20, seed=3).sigma_rad
        for each in (scene, turned)
    )
    # Exposure is automatic, so that light and fringes are as bright: what is left is that the plate
    # is half of the plane's thickness deeper and faces the camera, and 2 % of the estimate.
    np.testing.assert_allclose(two, one, rtol=0.1)


def test_a_picture_is_drawn_and_the_rig_is_said(scene, turned, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        view = np.ones((240, 320), np.float32)
        scene_picture(turned, view, tmp_path / "turned.png")
        assert "triangulation angle" in repr(scene.rig)
        assert "triangulation angle" not in repr(turned.rig)
    assert np.isnan(turned.rig.angle)


def test_the_commands_take_a_rig_s_file_without_a_world(scene, tmp_path):
    write_rig(tmp_path / "rig.yaml", scene.rig)
    stated = read_opencv_yaml(tmp_path / "rig.yaml")
    left = {key: value for key, value in stated.items() if not key.endswith("_world")}
    write_opencv_yaml(tmp_path / "rig.yaml", left)
    depth = scene.rig.camera.pose.origin_depth
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nrig = { file = "rig.yaml" }\npreview = { divisor = 4 }\n[[objects]]\n'
        f'artefact = "plane"\nposition_mm = [0, 0, {depth}]\nrotation_deg = [180, 0, 0]\n'
    )
    mine, out = tmp_path / "mine.toml", tmp_path / "out"
    for command in (
        ("scene", "show", mine, "--out", out / "rig.png"),
        ("design", "noise", mine, "--heights", 1, "--repeats", 2, "--preview", "--out", out / "n"),
    ):
        done = run_cli(*command)
        assert done.status == 0, done.err
    assert (out / "rig.png").is_file()
    assert (out / "n" / "single.csv").is_file()


#: SLStudio's own example calibration, and a plane before it.
SLSTUDIO = {
    "K_camera": np.array([[2195.1204, 0.0, 843.5], [0.0, 2195.1204, 675.5], [0.0, 0.0, 1.0]]),
    "dist_camera": np.array([-0.058035266, 0.0, 0.0, 0.0, 0.0]),
    "size_camera": np.array([1688.0, 1352.0]),
    "K_projector": np.array([[2601.5256, 0.0, 866.5415], [0.0, 2601.5256, 1109.1112], [0, 0, 1.0]]),
    "dist_projector": np.array([-0.0314900056, 0.0, 0.0, 0.0, 0.0]),
    "size_projector": np.array([1824.0, 1140.0]),
    "R": np.array(
        [
            [0.96440231800079346, -0.12034615874290466, 0.23546750843524933],
            [0.15343731641769409, 0.97988283634185791, -0.1276191771030426],
            [-0.21537208557128906, 0.15920573472976685, 0.96346688270568848],
        ]
    ),
    "T": np.array([-145.28256225585938, -36.498340606689453, 67.923164367675781]),
}
BEFORE_IT = """\
name = "slstudio"
preview = { divisor = 8, samples = 4 }
rig = { file = "slstudio.yaml", volume_mm = [200.0, 200.0, 300.0] }
patterns = { sequence = "1" }
[[objects]]
kind = "plane"
parameters = { size_mm = [800.0, 800.0] }
position_mm = [0.0, 0.0, 412.0]
rotation_deg = [180.0, 0.0, 0.0]
"""


@pytest.fixture
def published(tmp_path):
    write_opencv_yaml(tmp_path / "slstudio.yaml", SLSTUDIO)
    (tmp_path / "scene.toml").write_text(BEFORE_IT)
    return tmp_path / "scene.toml"


def test_a_volume_beside_a_rig_s_file_is_that_of_the_scan(published, tmp_path):
    assert run_cli("scene", "show", published, "--out", tmp_path / "rig.png").status == 0
    done = run_cli("scan", published, "--preview", "--out", tmp_path / "out")
    assert done.status == 0, done.err
    volume = read_opencv_yaml(tmp_path / "out" / "rig.yaml")["volume_mm"].ravel()
    np.testing.assert_array_equal(volume, [200.0, 200.0, 300.0])


def test_a_sweep_of_the_focus_is_about_the_object(published):
    published.write_text("focus = { settings = 3 }\n" + BEFORE_IT)
    scene = load_scene(published)
    middle = scene.objects[0].middle
    # Slices of a third of 300 mm, from the far one to the near one, along the camera's axis.
    expected = middle + np.array([[0.0, 0.0, off] for off in (100.0, 0.0, -100.0)])
    np.testing.assert_allclose(
        scene.focus.distances_mm["camera"], [point[2] for point in expected], rtol=1e-12
    )
    depths = [scene.rig.projector.pose.to_local(point)[2] for point in expected]
    np.testing.assert_allclose(scene.focus.distances_mm["projector"], depths, rtol=1e-12)


class TestBesideAFile:
    """What a calibration does not have, in the tables of the devices."""

    def loaded(self, published, text, **tables):
        published.write_text(text + BEFORE_IT)
        return load_scene(published, **tables)

    def test_aperture_and_focus(self, published):
        text = "camera = { f_number = 8.0, pitch_um = 3.45, focus_distance_mm = 410.0 }\n"
        text += (
            "projector = { aperture_radius_mm = 3.0, focus_distance_mm = 400, flux_w = 2.0, "
            "bit_depth = 0, gamma = 2.2, blur_px = 1.0, wavelength_nm = 550.0, "
            "natural_vignetting = false, body_mm = [50, 40, 30] }\n"
        )
        rig = self.loaded(published, text).rig
        lens, other = rig.camera.lens, rig.projector.lens
        assert rig.camera.pitch_mm[0] == pytest.approx(3.45e-3)
        assert lens.focal_length_mm == pytest.approx(2195.1204 * 3.45e-3)
        assert lens.f_number == pytest.approx(8.0)
        assert lens.focus_distance_mm == 410.0
        assert (other.aperture_radius_mm, other.focus_distance_mm) == (3.0, 400.0)
        assert (other.wavelength_nm, other.natural_vignetting) == (550.0, False)
        projector = rig.projector
        assert (projector.flux_w, projector.bit_depth, projector.gamma) == (2.0, None, 2.2)
        assert (projector.blur_px, projector.body_mm) == (1.0, (50.0, 40.0, 30.0))
        # Rays are the file's.
        np.testing.assert_allclose(rig.camera.matrix, SLSTUDIO["K_camera"], rtol=1e-12)
        np.testing.assert_allclose(projector.matrix, SLSTUDIO["K_projector"], rtol=1e-12)

    def test_a_lens_without_a_focus_is_in_focus_at_the_object(self, published):
        tables = "camera = { aperture_radius_mm = 2.0 }\nprojector = { aperture_radius_mm = 3.0 }\n"
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            scene = self.loaded(published, tables)
        place = scene.objects[0].pose.position
        for device in (scene.rig.camera, scene.rig.projector):
            depth = device.pose.to_local(place)[2]
            assert device.lens.focus_distance_mm == pytest.approx(depth, rel=1e-12)
            assert device.circle_of_confusion(place) < 1e-9

    def test_set_reaches_them(self, published):
        changes = ["camera.aperture_radius_mm=2", "camera.focus_distance_mm=412"]
        rig = self.loaded(published, "", changes=changes).rig
        assert (rig.camera.lens.aperture_radius_mm, rig.camera.lens.focus_distance_mm) == (
            2.0,
            412.0,
        )

    @pytest.mark.parametrize(
        ("table", "line"),
        [
            ("camera = { f_number = 8.0 }", "camera.f_number: expected pitch_um beside it"),
            ("camera = { f_number = 8.0, aperture_radius_mm = 1.0 }", "not both"),
            ("camera = { resolution_px = [10, 10] }", "camera: expected one of .*'resolution_px'"),
            ("projector = { fill_factor = 0.5 }", "projector: expected one of .*'fill_factor'"),
            ("camera = { focus_distance_mm = -1.0 }", "camera.focus_distance_mm: expected a"),
        ],
    )
    def test_what_does_not_belong_there(self, table, line, published):
        with pytest.raises(InputError, match=line) as caught:
            self.loaded(published, table + "\n")
        assert str(caught.value).startswith("scene.toml: ")
