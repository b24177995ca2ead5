"""The rig: configuration 5 of the thesis's table 4, frames, distances, bad design variables."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from slbench.core.errors import InputError
from slbench.rig import Camera, DesignVariables, Lens, Pair, Pose, Projector, Rig, rotation_yx

CAMERA = Camera(640, 480, (0.0074, 0.0074), Lens(16.0))
PROJECTOR = Projector(1024, 768, (0.0108, 0.0108), Lens(28.0))
CONFIGURATION_5 = DesignVariables(
    756.3, -412.5, -100.0, 337.5, np.deg2rad(-18.0), np.deg2rad(10.88)
)
#: The world's axes in the design frame.
DESIGN_TO_WORLD = np.diag([1.0, -1.0, -1.0])


def rig_of(design):
    return Rig.from_design(design, CAMERA, PROJECTOR)


class TestConfiguration5:
    rig = rig_of(CONFIGURATION_5)

    def test_both_axes_meet_at_the_origin_of_the_world(self):
        for device in (self.rig.camera, self.rig.projector):
            axis = device.pose.rotation[:, 2]
            # The distance of the origin from the optical axis.
            assert np.linalg.norm(np.cross(device.pose.position, axis)) < 1e-9
            assert device.pose.position @ axis < 0  # it lies in front
            np.testing.assert_allclose(device.project(np.zeros(3)), device.centre, atol=1e-9)

    def test_distances(self):
        # By hand, from the six numbers; to the digits quoted.
        assert self.rig.camera_distance == pytest.approx(453.87, abs=0.005)
        assert self.rig.projector_distance == pytest.approx(809.78, abs=0.005)

    def test_by_hand(self):
        """Plain trigonometry from thesis 3.1.2: no matrices."""
        alpha, beta, z = np.deg2rad(-18.0), np.deg2rad(10.88), 756.3
        target = np.array([z * np.tan(alpha), -z * np.tan(beta) / np.cos(alpha), z])
        np.testing.assert_allclose(CONFIGURATION_5.target, target, rtol=1e-12)
        offset = np.array([-412.5, -100.0, 337.5]) - target
        distances = np.linalg.norm(offset), np.linalg.norm(target)
        assert (self.rig.camera_distance, self.rig.projector_distance) == pytest.approx(distances)
        angle = np.arccos(offset @ -target / np.prod(distances))
        assert self.rig.angle == pytest.approx(angle, rel=1e-12)

    def test_no_roll(self):
        """The image x axes are horizontal: no y component in D for Ry Rx, z carries the pan."""
        for device in (self.rig.camera, self.rig.projector):
            x_in_design = DESIGN_TO_WORLD.T @ device.pose.rotation[:, 0]
            assert abs(x_in_design[1]) < 1e-15

    def test_orientation_of_the_projector(self):
        in_design = DESIGN_TO_WORLD.T @ self.rig.projector.pose.rotation
        expected = rotation_yx(np.deg2rad(-18.0), np.deg2rad(10.88))
        np.testing.assert_allclose(in_design, expected, atol=1e-15)

    def test_pictures_are_upright(self):
        """World x is right in both pictures, world y up, z towards the devices."""
        for device in (self.rig.camera, self.rig.projector):
            origin, x, y = device.project([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 5.0, 0.0]])
            assert x[0] - origin[0] > abs(x[1] - origin[1])
            assert origin[1] - y[1] > abs(y[0] - origin[0])
            assert device.pose.position[2] > 0

    def test_volume(self):
        corners = self.rig.volume_corners
        assert corners.shape == (8, 3)
        assert len(np.unique(corners, axis=0)) == 8
        np.testing.assert_allclose(np.abs(corners), np.tile([30.0, 35.0, 15.0], (8, 1)))


angles = st.floats(-0.7, 0.7)


@given(
    z=st.floats(100.0, 2000.0),
    position=st.tuples(st.floats(-500, 500), st.floats(-500, 500), st.floats(-300, 600)),
    alpha=angles,
    beta=angles,
)
def test_any_design_aims_both_devices_at_the_origin(z, position, alpha, beta):
    design = DesignVariables(z, *position, alpha, beta)
    assume(np.linalg.norm(design.target - position) > 20.0)
    # Looking straight down D's y axis, zero roll has no meaning.
    assume(np.linalg.norm((design.target - position)[[0, 2]]) > 1.0)
    rig = rig_of(design)
    for device in (rig.camera, rig.projector):
        rotation = device.pose.rotation
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(device.project(np.zeros(3)), device.centre, atol=1e-6)
        assert abs(rotation[1, 0]) < 1e-12  # zero roll
    # The world and D differ by a rigid motion: distances are kept.
    assert rig.projector_distance == pytest.approx(np.linalg.norm(design.target))
    between = np.linalg.norm(rig.camera.pose.position - rig.projector.pose.position)
    assert between == pytest.approx(np.linalg.norm(position))


def test_rotation_is_ry_rx():
    """Columns are the turned axes: z leans right for positive alpha, up for positive beta."""
    alpha, beta = 0.3, 0.2
    matrix = rotation_yx(alpha, beta)
    np.testing.assert_allclose(matrix[:, 0], [np.cos(alpha), 0.0, -np.sin(alpha)], atol=1e-15)
    z = [np.sin(alpha) * np.cos(beta), -np.sin(beta), np.cos(alpha) * np.cos(beta)]
    np.testing.assert_allclose(matrix[:, 2], z, atol=1e-15)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


class TestBadInput:
    @pytest.mark.parametrize("change", [{"alpha_p": 2.0}, {"beta_p": -2.0}])
    def test_a_projector_that_looks_away(self, change):
        with pytest.raises(InputError, match="alpha_p, beta_p: expected a projector axis"):
            replace(CONFIGURATION_5, **change)

    def test_a_camera_in_the_target(self):
        target = CONFIGURATION_5.target
        design = replace(CONFIGURATION_5, w=target[0], h=target[1], l=target[2])
        with pytest.raises(InputError, match="a camera apart from the target"):
            design.poses()

    @pytest.mark.parametrize("size", [(0.0, 1.0, 1.0), (1.0, 1.0), (1.0, np.nan, 1.0)])
    def test_volume(self, size):
        with pytest.raises(InputError, match="rig volume: expected three positive lengths"):
            Rig(CAMERA, PROJECTOR, size)


def two_cameras():
    return Rig({"left": CAMERA, "right": replace(CAMERA, width=320)}, PROJECTOR)


def test_a_rig_of_two_cameras_falls_into_pairs_that_keep_their_names():
    rig = two_cameras()
    assert rig.pairs == (("left", "projector"), ("right", "projector"))
    right = rig.pair(rig.pairs[1])
    assert right.camera.width == 320
    assert right.only == ("right", "projector")
    assert right.projector is rig.projectors["projector"]


def test_one_of_two_cameras_has_to_be_named():
    rig = two_cameras()
    with pytest.raises(InputError, match="left"):
        _ = rig.camera
    with pytest.raises(InputError, match="right-projector"):
        rig.pair(Pair("top", "projector"))
    with pytest.raises(InputError, match="left, right"):
        rig.having(camera=CAMERA)
    with pytest.raises(InputError, match="left, right"):
        rig.focused({"camera": 300.0})


@pytest.mark.parametrize("cameras", [{}, {"projector": CAMERA}])
def test_each_device_has_a_name_of_its_own(cameras):
    with pytest.raises(InputError, match="rig devices"):
        Rig(cameras, PROJECTOR)


def test_a_changed_device_keeps_its_name_and_the_others():
    rig = two_cameras().having(left=replace(CAMERA, width=64))
    assert [camera.width for camera in rig.cameras.values()] == [64, 320]
    assert rig.all_in_focus().cameras["left"].lens.defocusing_radius_mm == 0.0
    assert rig.focused({"right": 300.0}).cameras["right"].lens.focus_distance_mm == 300.0
    assert rig.focused({"right": 300.0}).cameras["left"] == rig.cameras["left"]


def test_a_rig_is_a_value_that_is_compared_copied_and_changed():
    rig = rig_of(CONFIGURATION_5)
    assert pickle.loads(pickle.dumps(rig)) == rig
    assert hash(rig.camera) == hash(copy.deepcopy(rig).camera)
    larger = replace(rig, volume_mm=(90.0, 90.0, 90.0))
    assert (larger.devices, larger.volume_mm[0]) == (rig.devices, 90.0)
    assert larger != rig
    assert rig.having(camera=rig.camera.posed(Pose())) != rig
