"""Parameters of a rig by name: what each moves, covariances, draws, and files."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes_small import small

from slbench.core.errors import InputError
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.opencv import read_rig, write_rig
from slbench.rig.parameters import (
    DEVICE_PARAMETERS,
    RIG_PARAMETERS,
    ParameterCovariance,
    moved,
    read_covariance,
)


@pytest.fixture(scope="module")
def rig():
    own = small("plane").rig
    return own.having(
        camera=replace(own.camera, distortion=(0.1, -0.05, 1e-3, -2e-3, 0.01)),
        projector=replace(
            own.projector,
            distortion=(0.3, -0.1, 5e-4, 1e-3, 0.02, 0.4, -0.1, 0.03, 1e-3, 2e-3, -1e-3, 3e-3),
            tilt_rad=(0.03, -0.02),
        ),
    )


POINTS = np.random.default_rng(1).uniform(-80, 80, (50, 3)) * [1.0, 1.0, 0.25]


def by_opencv(device, error):
    """Project points by OpenCV with parameters that are off."""
    values = dict.fromkeys(DEVICE_PARAMETERS, 0.0) | error
    matrix = device.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += [values[k] for k in ("fx_px", "fy_px", "cx_px", "cy_px")]
    dist = np.zeros(14)
    dist[: len(device.distortion)], dist[12:] = device.distortion, device.tilt_rad
    dist += [values[k] for k in (*COEFFICIENTS, "tau_x_rad", "tau_y_rad")]
    turn, _ = cv2.Rodrigues(np.array([values[k] for k in ("rx_rad", "ry_rad", "rz_rad")]))
    shift = np.array([values[k] for k in ("tx_mm", "ty_mm", "tz_mm")])
    rotation = device.pose.rotation @ turn
    position = device.pose.position + device.pose.rotation @ shift
    vector, _ = cv2.Rodrigues(rotation.T)
    return cv2.projectPoints(POINTS, vector, -rotation.T @ position, matrix, dist)[0][:, 0]


@pytest.mark.parametrize("role", ["camera", "projector"])
@pytest.mark.parametrize("name", DEVICE_PARAMETERS)
def test_each_parameter_is_that_of_opencv(rig, role, name):
    size = {"k1": 0.1, "k2": 0.5, "k3": 5.0, "k6": 5.0}.get(name, 0.3)
    size = 1e-3 if name.endswith("_rad") or name[0] in "ps" else size
    off = moved(rig, {f"{role}.{name}": size})
    device = getattr(off, role)
    np.testing.assert_allclose(
        device.project(POINTS), by_opencv(getattr(rig, role), {name: size}), atol=1e-6
    )
    assert np.abs(device.project(POINTS) - getattr(rig, role).project(POINTS)).max() > 1e-6
    other = {"camera": "projector", "projector": "camera"}[role]
    assert getattr(off, other) is getattr(rig, other)


def test_all_at_once_and_none(rig):
    rng = np.random.default_rng(0)
    error = {name: 1e-3 * rng.normal() for name in DEVICE_PARAMETERS}
    off = moved(rig, {f"camera.{name}": value for name, value in error.items()})
    np.testing.assert_allclose(off.camera.project(POINTS), by_opencv(rig.camera, error), atol=1e-6)
    assert moved(rig, {}).camera is rig.camera
    assert moved(rig, dict.fromkeys(RIG_PARAMETERS, 0.0)).projector is rig.projector


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ({"camera.rx": 1.0}, r"'camera\.rx'; did you mean 'camera\.rx_rad'"),
        ({"lens.fx_px": 1.0}, "those of a rig"),
        ({"camera.fx_px": -1e6}, "focal"),
    ],
)
def test_other_errors_are_refused(rig, error, words):
    with pytest.raises(InputError, match=words):
        moved(rig, error)


class TestCovariance:
    def matrix(self):
        root = np.random.default_rng(3).normal(size=(3, 3)) * [[1e-6], [1.0], [1e3]]
        return root @ root.T

    def test_draws_have_it(self):
        names = ("camera.k1", "camera.fx_px", "projector.tz_mm")
        known = ParameterCovariance(names, self.matrix())
        drawn = np.array([list(known.draw(seed).values()) for seed in range(4000)])
        scale = np.sqrt(np.diag(known.matrix))
        found = np.cov((drawn / scale).T)
        # Of 4000 draws a covariance of unit variables is known to sqrt(2 / 4000) = 0.022.
        np.testing.assert_allclose(found, known.matrix / np.outer(scale, scale), atol=0.1)
        np.testing.assert_allclose(drawn.mean(axis=0) / scale, 0.0, atol=0.07)
        assert known.draw(5) == known.draw(5) != known.draw(6)

    def test_parameters_that_are_one(self):
        # Of rank one: both are off by the same.
        known = ParameterCovariance(("camera.fx_px", "camera.fy_px"), np.full((2, 2), 4.0))
        error = known.draw(2)
        assert error["camera.fx_px"] == pytest.approx(error["camera.fy_px"]) != 0.0

    def test_of_deviations(self):
        known = ParameterCovariance.of({"camera.k1": 0.1, "camera.k2": 0.0})
        assert known.std == {"camera.k1": pytest.approx(0.1), "camera.k2": 0.0}
        assert known.draw(1)["camera.k2"] == 0.0

    def test_files(self, rig, tmp_path):
        known = ParameterCovariance(("camera.k1", "camera.fx_px", "projector.tz_mm"), self.matrix())
        known.save(tmp_path / "known.json")
        write_rig(tmp_path / "rig.yaml", rig, known)
        for name in ("known.json", "rig.yaml"):
            again = read_covariance(tmp_path / name)
            assert again.names == known.names
            np.testing.assert_allclose(again.matrix, known.matrix, rtol=1e-12)
        np.testing.assert_allclose(read_rig(tmp_path / "rig.yaml").camera.matrix, rig.camera.matrix)
        write_rig(tmp_path / "plain.yaml", rig)
        with pytest.raises(InputError, match="covariance_names"):
            read_covariance(tmp_path / "plain.yaml")

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"kind": "other"}, "kind"),
            ({"names": "camera.k1"}, "a list of texts"),
            ({"names": ["camera.k1", "camera.kk"]}, "did you mean"),
            ({"names": ["camera.k1"]}, "1 x 1"),
            ({"names": ["camera.k1", "camera.k1"]}, "once"),
            ({"covariance": [[1.0, 0.0], [0.0]]}, "2 x 2"),
            ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "negative eigenvalues"),
            ({"covariance": [[1.0, 0.5], [0.1, 1.0]]}, "symmetric"),
            ({"covariance": [[1.0, None], [None, 1.0]]}, "finite"),
            ({"covariance": "none"}, "2 x 2"),
        ],
    )
    def test_refused(self, tmp_path, changes, words):
        content = {
            "kind": "slbench covariance",
            "names": ["camera.k1", "camera.k2"],
            "covariance": [[1.0, 0.0], [0.0, 1.0]],
        }
        path = tmp_path / "some.json"
        path.write_text(json.dumps(content | changes))
        with pytest.raises(InputError, match=words) as caught:
            read_covariance(path)
        assert str(path) in str(caught.value)
