"""What the uncertainty of a rig's parameters does to points, against rigs that are drawn."""

from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small, truth_of

from slbench.capture.capture import Capture
from slbench.cloud import calibrated
from slbench.cloud.calibrated import with_calibration
from slbench.cloud.decoded import decode_capture
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.patterns import PhaseMap
from slbench.rig.parameters import ParameterCovariance, moved
from slbench.scene.calibration import Calibration
from slbench.simulate.scan import scan

DEVIATIONS = {
    "camera.fx_px": 0.3, "camera.cx_px": 0.4, "camera.ry_rad": 2e-4, "camera.tx_mm": 0.02,
    "projector.fy_px": 0.3, "projector.k1": 1e-3, "projector.rx_rad": 2e-4, "projector.tz_mm": 0.05,
}  # fmt: skip


def exact_phase(axes):
    """Return the true panel coordinates of a plate."""
    truth = truth_of("plane")
    lit = truth.lit
    values = {a: np.where(lit, truth.panel[..., "uv".index(a)], np.nan) for a in axes}
    sigma = {a: np.where(lit, 0.02, np.nan) for a in axes}
    nothing = np.zeros(lit.shape, np.float32)
    return PhaseMap(values, sigma, nothing, nothing, lit)


def correlated():
    """Return a covariance of parameters that go together, one of them without any."""
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(len(DEVIATIONS),) * 2))[0]
    core = turn @ np.diag(np.geomspace(1.0, 0.05, len(DEVIATIONS))) @ turn.T
    deviations = np.array(list(DEVIATIONS.values()))
    scale = deviations / np.sqrt(np.diag(core))
    matrix = np.zeros((len(DEVIATIONS) + 1,) * 2)
    matrix[:-1, :-1] = core * np.outer(scale, scale)
    return ParameterCovariance((*DEVIATIONS, "camera.cy_px"), matrix)


@pytest.mark.parametrize(("axes", "meeting"), [("u", "ray"), ("uv", "ray"), ("uv", "nearest")])
def test_points_scatter_as_predicted_over_rigs_that_are_drawn(axes, meeting):
    rig, phase, covariance = small("plane").rig, exact_phase(axes), correlated()
    cloud = triangulate(rig, phase, meeting)
    found = with_calibration(cloud, rig, phase, covariance, meeting)
    some = slice(None, None, 997)
    u, v = cloud.pixels[some].T
    draws = []
    for seed in range(400):
        other = triangulate(moved(rig, covariance.draw(seed)), phase, meeting)
        draws.append(other.image(other.points)[v, u])
    off = np.array(draws) - cloud.points[some]
    scatter = np.einsum("rni,rnj->nij", off, off) / len(off)
    sizes = np.sqrt(np.trace(scatter, axis1=1, axis2=2))
    # 400 draws of some five directions: a deviation is good to 4 %, and four of them are asked.
    np.testing.assert_allclose(
        np.sqrt(np.trace(found.calibration_mm2[some], axis1=1, axis2=2)), sizes, rtol=0.15
    )
    np.testing.assert_allclose(
        found.calibration_mm2[some], scatter, rtol=0, atol=0.25 * sizes.max() ** 2
    )
    assert np.all(found.u_total_mm > cloud.u_total_mm)
    np.testing.assert_array_equal(found.sigma_mm, cloud.sigma_mm)
    # Twice the same, independent: the squares add up.
    twice = with_calibration(found, rig, phase, covariance, meeting)
    np.testing.assert_allclose(twice.calibration_mm2, 2.0 * found.calibration_mm2)


def test_errors_of_scans_with_drawn_calibrations_are_covered():
    """Coverage of the truth over many draws, by scans that know what their calibration is worth."""
    scene = small("plane")
    covariance = ParameterCovariance.of(DEVIATIONS)
    shares, blind = [], []
    for seed in range(24):
        made = Calibration(covariance=covariance, seed=seed)
        result = scan(replace(scene, calibration=made), seed=1)
        score = result.score
        shares.append((score.coverage_1u, score.coverage_2u, score.coverage_3u))
        assert score.predicted_u_mm > 1.2 * score.predicted_sigma_mm
        off = np.linalg.norm(
            result.cloud.points
            - result.truth.point[result.cloud.pixels[:, 1], result.cloud.pixels[:, 0]],
            axis=1,
        )
        blind.append(np.mean(off[np.isfinite(off)] < result.cloud.sigma_total_mm[np.isfinite(off)]))
    one, two, three = np.mean(shares, axis=0)
    # Points of a scan share an error: 24 draws of some directions leave 6 % to the mean share.
    assert one == pytest.approx(0.683, abs=0.15)
    assert two == pytest.approx(0.954, abs=0.05)
    assert three > 0.98
    assert np.mean(blind) < one - 0.1


def test_a_capture_carries_what_is_known_of_its_rig(tmp_path):
    """Written beside the rig, read back, and in the points of whoever decodes the frames."""
    covariance = ParameterCovariance.of(DEVIATIONS)
    scene = replace(small("plane"), calibration=Calibration(covariance=covariance, seed=3))
    result = scan(scene, seed=1, score=False)
    result.capture.save(tmp_path / "shots")
    read = Capture.load(tmp_path / "shots")
    assert read.rig_covariance.names == covariance.names
    np.testing.assert_allclose(read.rig_covariance.matrix, covariance.matrix, rtol=1e-12)
    found = decode_capture(read).cloud
    np.testing.assert_allclose(found.u_mm, result.cloud.u_mm, rtol=1e-6)
    without = decode_capture(replace(read, rig_covariance=None)).cloud
    assert np.median(found.u_total_mm) > 1.2 * np.median(without.u_total_mm)

    rig = (tmp_path / "shots" / "rig.yaml").read_text()
    (tmp_path / "shots" / "rig.yaml").write_text(rig.replace("covariance_names", "names"))
    with pytest.raises(InputError, match=r"covariance_names \(a text\) and covariance"):
        Capture.load(tmp_path / "shots")


def test_a_point_that_one_error_loses_is_told_by_the_other(monkeypatch):
    rig, phase = small("plane").rig, exact_phase("u")
    covariance = ParameterCovariance.of({"projector.cx_px": 0.5})
    cloud = triangulate(rig, phase)
    whole = with_calibration(cloud, rig, phase, covariance).calibration_mm2
    true = calibrated.triangulate
    calls = []

    def lossy(other, phase, meeting):
        found = true(other, phase, meeting)
        calls.append(other)
        kept = np.ones(len(found), bool)
        kept[:7] = False
        kept[7:9] = len(calls) == 1
        return found.chosen(kept)

    monkeypatch.setattr(calibrated, "triangulate", lossy)
    found = with_calibration(cloud, rig, phase, covariance)
    assert np.isnan(found.calibration_mm2[:7]).all()  # lost by both
    np.testing.assert_allclose(found.calibration_mm2[7:9], whole[7:9], rtol=0.01)
    np.testing.assert_array_equal(found.calibration_mm2[9:], whole[9:])
    assert "nan" not in repr(found)


def test_a_covariance_beyond_all_rigs_is_one_line():
    rig, phase = small("plane").rig, exact_phase("u")
    far = ParameterCovariance.of({"camera.fx_px": 1e5})
    with pytest.raises(InputError, match=r"^covariance of the rig: off by one .*focal_length_mm"):
        with_calibration(triangulate(rig, phase), rig, phase, far)
    with pytest.raises(InputError, match=r"got nan of camera\.fx_px and camera\.fx_px"):
        ParameterCovariance(("camera.fx_px",), np.array([[np.nan]]))
