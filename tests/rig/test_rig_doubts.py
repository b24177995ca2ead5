"""Doubts about rigs: each limit from both sides, and none about sensible rigs."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.doubts import (
    baseline_doubt,
    focal_length_doubt,
    pitch_doubt,
    principal_point_doubt,
    rig_doubts,
)


def camera(pitch_um=7.4, focal_mm=16.0, **changes):
    return Camera(640, 480, (pitch_um * 1e-3,) * 2, Lens(focal_mm), **changes)


def rig(apart_mm, distance_mm=450.0, aim=True):
    """Two devices side by side; their axes meet at the distance, or are parallel."""
    poses = [
        Pose.looking_at((x, 0, 0), (0 if aim else x, 0, distance_mm), (0, 1, 0))
        for x in (-apart_mm / 2, apart_mm / 2)
    ]
    projector = Projector(640, 480, (0.0108, 0.0108), Lens(28.0), pose=poses[1])
    return Rig(camera(pose=poses[0]), projector)


# Sensors from 0.5 um (phones) to 50 um, the same in wrong units, and the edges between them.
@pytest.mark.parametrize("um", [0.0074, 0.0005, 0.0999, 7400.0, 600.0, 100e3])
def test_a_pitch_in_mm_or_nm_is_questioned(um):
    assert "would be" in pitch_doubt(camera(um))


@pytest.mark.parametrize("um", [0.101, 0.5, 7.4, 55.0, 399.0, 0.00039, 100.1e3])
def test_a_pitch_of_a_sensor_is_not(um):
    assert pitch_doubt(camera(um)) is None


def test_a_large_pitch_is_questioned_by_its_field_or_its_lens():
    # 640 px of 0.5 mm are 320 mm: behind 16 mm half the field is 10 distances, the limit.
    assert pitch_doubt(camera(499.0, 16.0)) is None
    assert pitch_doubt(camera(501.0, 16.0))
    assert pitch_doubt(camera(7400.0, 1999.0)) is None
    assert "7400 nm it would be 7.4 µm" in pitch_doubt(camera(7400.0, 2001.0))


@pytest.mark.parametrize("mm", [0.003, 0.1, 0.49, 20.1e3, 4e5])
def test_a_baseline_in_metres_or_micrometres_is_questioned(mm):
    assert "would be" in baseline_doubt(rig(mm, aim=False))


@pytest.mark.parametrize("mm", [0.0, 0.001, 0.51, 17.0, 400.0, 19.9e3])
def test_a_baseline_of_a_rig_is_not(mm):
    assert baseline_doubt(rig(mm, aim=False)) is None


def test_a_small_baseline_is_questioned_where_the_axes_cross_before_the_lenses():
    # T of a rig 0.9 m apart whose axes cross 0.45 m away, in metres.
    assert "0.9 mm apart; in metres it would be 900 mm" in baseline_doubt(rig(0.9, 0.45))
    assert baseline_doubt(rig(0.9, 4.9))  # the limit is 5 mm along the axes
    assert baseline_doubt(rig(0.9, 5.1)) is None
    assert baseline_doubt(rig(1.99, 0.9))
    assert baseline_doubt(rig(2.01, 0.9)) is None


@pytest.mark.parametrize("factor", [1 / 8, 1 / 4, 1 / 3, 1 / 2, 2, 3, 4, 8])
def test_the_centre_of_other_frames_is_questioned(factor):
    centre = tuple(factor * size / 2 - 0.5 for size in (640, 480))
    doubt = principal_point_doubt(camera(principal_point=centre))
    assert f"{max(factor, 1 / factor):g} times {'larger' if factor > 1 else 'smaller'}" in doubt


# Centres, an off-centre lens, a crop, a shift along one axis, the edge of the tolerance (6 %).
@pytest.mark.parametrize(
    "relative",
    [(0.5, 0.5), (0.57, 0.41), (1.0, 0.5), (0.5, 1.0), (1.07, 1.0), (0.25, 0.29), (3, 2)],
)
def test_other_principal_points_are_not(relative):
    centre = tuple(r * size - 0.5 for r, size in zip(relative, (640, 480), strict=True))
    assert principal_point_doubt(camera(principal_point=centre)) is None


def test_a_forgotten_principal_point_is_questioned():
    assert "corner" in principal_point_doubt(camera(principal_point=(0.0, 0.0)))


def test_a_catalogue_focal_length_at_close_range_is_questioned():
    # 16 mm in focus at 150 mm: 16 x 150 / (150 - 16) = 17.91.
    assert "has 17.91 mm" in focal_length_doubt(16.0, 150.0)
    # f / (d - f) is 5 % at d = 21 f; magnification one at d = 2 f.
    assert focal_length_doubt(16.0, 335.9)
    assert focal_length_doubt(25.0, 50.1)
    assert focal_length_doubt(16.0, 336.1) is None
    assert focal_length_doubt(25.0, 49.9) is None
    assert focal_length_doubt(17.91, 150.0) is None
    assert focal_length_doubt(320.0, 20.0) is None
    assert focal_length_doubt(16.0, np.inf) is None


def test_a_rig_s_doubts_name_the_device():
    given = rig(0.2, aim=False)
    given = given.having(
        camera=replace(given.camera, pitch_mm=(7.4e-6, 7.4e-6)),
        projector=replace(given.projector, pitch_mm=(10.8, 10.8)),
    )
    assert [what for what, _ in rig_doubts(given)] == [
        "pitch_um of the camera",
        "pitch_um of the projector",
        "baseline",
    ]
    assert list(rig_doubts(rig(400.0))) == []
