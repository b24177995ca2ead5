"""Rotations that were rounded, and entries that are almost one of ours, in a file of a rig."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_opencv_yaml import plain, written

from slbench.core.errors import InputError, InputWarning
from slbench.rig.opencv import _ENTRIES, read_rig
from slbench.rig.pose import nearest_rotation

#: A published matrix that is no rotation: its second row has the third entry's sign wrong.
NO_ROTATION = np.array(
    [[0.9945, 0.02305, -0.102], [-0.03917, 0.9865, -0.03917], [0.09694, 0.1621, 0.982]]
)


@settings(max_examples=100, deadline=None)
@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.integers(3, 12))
def test_the_nearest_rotation_of_a_rounded_one_is_near(turn, digits):
    true = Rotation.from_rotvec(turn).as_matrix()
    rounded = np.round(true, digits)
    nearest, distance = nearest_rotation(rounded)
    np.testing.assert_allclose(nearest @ nearest.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(nearest) == pytest.approx(1.0)
    # The Frobenius norm of the rounding is at most 3 halves of a unit of the last digit; the true
    # rotation is that near, and the nearest one nearer.
    assert distance <= 1.5 * 10.0**-digits + 1e-12
    np.testing.assert_allclose(nearest, true, rtol=0.0, atol=3.0 * 10.0**-digits + 1e-12)
    # SciPy's nearest one, by the same criterion.
    np.testing.assert_allclose(nearest, Rotation.from_matrix(rounded).as_matrix(), atol=1e-9)


def test_a_reflection_is_far_from_any_rotation():
    assert nearest_rotation(np.diag([1.0, 1.0, -1.0]))[1] > 0.5


@pytest.mark.parametrize("digits", [3, 4, 8, 16])
def test_a_rounded_rotation_is_taken_as_the_nearest_one(digits, tmp_path):
    values = plain()
    true = values["R"]
    path = written(tmp_path / "rig.yml", values | {"R": np.round(true, digits)})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rotation = read_rig(path).projector.pose.rotation.T
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, true, rtol=0.0, atol=3.0 * 10.0**-digits)
    # Rounding to four digits turns rays by what a camera sees, and is said.
    said = [str(one.message) for one in caught if issubclass(one.category, InputWarning)]
    assert len(said) == (digits <= 4)
    assert all("R: " in one and "the nearest one is taken" in one for one in said)


def test_no_rotation_is_quoted_as_it_stands_with_its_distance(tmp_path):
    path = written(tmp_path / "rig.yml", plain() | {"R": NO_ROTATION})
    with pytest.raises(InputError) as caught:
        read_rig(path)
    line = str(caught.value)
    assert f"{path}: R: expected a rotation, to 0.001, got [[0.9945, 0.02305, -0.102]" in line
    distance = np.abs(Rotation.from_matrix(NO_ROTATION).as_matrix() - NO_ROTATION).max()
    assert f"{distance:.2g} off the nearest rotation" in line


@pytest.mark.parametrize(
    ("key", "right"),
    [
        ("aperture_radius_projector", "aperture_radius_mm_projector"),
        ("aperture_mm_camera", "aperture_radius_mm_camera"),
        ("focus_distance_camera", "focus_distance_mm_camera"),
        ("pitch_um_projecter", "pitch_um_projector"),
        ("Blur_Px_camera", "blur_px_camera"),
        ("volume", "volume_mm"),
        ("flux_w_projector", "flux_w"),
        ("aperture_radius_mm", "aperture_radius_mm_camera"),
        ("T_wrld", "T_world"),
        # What other programs write beside a calibration is their own.
        *((name, None) for name in ("R1", "P2", "Q", "E", "rms", "error_camera", "square_size")),
        *((name, None) for name in ("image_size", "calibration_time", "roi_projector", "model")),
    ],
)
def test_a_slip_of_an_entry_is_questioned_and_a_foreign_one_is_not(key, right, tmp_path):
    path = written(tmp_path / "rig.yml", plain() | {key: 3.0})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_rig(path)
    said = [str(one.message) for one in caught]
    if right is None:
        assert said == []
    else:
        assert said == [f"{path}: {key}: not an entry of a rig; did you mean {right!r}?"]


def test_the_page_lists_every_entry():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "rig-files.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    listed = set()
    for name in re.findall(r"`(\w+)`", " ".join(rows)):
        for device in ("camera", "projector") if name.endswith("DEVICE") else ("",):
            listed.add(name.replace("DEVICE", device))
    assert set(_ENTRIES) <= listed
