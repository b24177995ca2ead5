"""Chapter 8 in simulation: its pieces, and a whole preview (slow)."""

from dataclasses import replace

import numpy as np
import pytest
from stage_views import NOISE_MM, stage_views

from slbench.calibration.models.points import CalibrationPoints
from slbench.cloud.registration import register_views
from slbench.core.errors import InputError
from slbench.design.fringes.noise import PhaseNoise
from slbench.scene.file import load_scene
from slbench.thesis.ch8 import experiment as ch8
from slbench.thesis.ch8 import findings, models, noise, plane, report
from slbench.thesis.ch8.results import STAGES, View
from slbench.thesis.ch8.views import merged
from slbench.thesis.outcome import write_outcome
from slbench.twin.experiment import Experiment

FRINGES = np.array([1, 2, 4, 8, 16, 32])
HEIGHTS = np.linspace(-0.25, 0.25, 11)


def table(level, growth):
    """Noise `level` that grows with (z n)^2 as defocus lets it."""
    blur = np.exp(growth * (FRINGES[:, None] * HEIGHTS / 4.0) ** 2)
    return PhaseNoise(FRINGES, np.minimum(level * blur, 3.0), HEIGHTS)


class TestNoise:
    def test_growth_is_the_lesser_end_over_the_middle(self):
        sigma = np.full((1, 11), 0.01)
        sigma[0, :2], sigma[0, -2:] = 0.03, 0.02
        found = noise.growth(PhaseNoise(np.array([16]), sigma, HEIGHTS), 16)
        assert (found.middle, found.low_end, found.high_end) == (0.01, 0.03, 0.02)
        assert found.ratio == pytest.approx(2.0)

    def test_verdicts(self):
        grown, flat = table(0.01, 1.0), table(0.01, 0.0)
        averaged = table(0.01 / np.sqrt(7.0), 1.0)
        fused = {"single": grown, "averaged": averaged, "fused-lit": table(0.005, 0.1)}
        ends, fusion = findings.noise_findings(fused)
        assert (ends.verdict, fusion.verdict) == ("reproduced", "reproduced")
        fused = {"single": flat, "averaged": averaged, "fused-lit": table(0.02, 1.0)}
        ends, fusion = findings.noise_findings(fused)
        assert (ends.verdict, fusion.verdict) == ("not reproduced", "not reproduced")

    def test_averaging_is_no_fusion(self):
        """Frames averaged at one focus have less noise than one picture, and do not pass."""
        single, averaged = table(0.01, 1.0), table(0.01 / np.sqrt(7.0), 1.0)
        assert averaged.of(16).max() < 0.5 * single.of(16).max()
        found = {"single": single, "averaged": averaged, "fused-lit": averaged}
        assert findings.noise_findings(found)[1].verdict == "not reproduced"
        # Nor do they when measured again, with other noise of some per cent.
        again = PhaseNoise(FRINGES, averaged.sigma_rad * 0.96, HEIGHTS)
        assert findings.fusion_finding("x", "again", again, averaged, 16).verdict != "reproduced"

    def test_designer_at_the_thesiss_noise(self):
        # A quiet system needs one step, the same one at 0.25 rad the thesis's four; 32 fringes
        # are lost there.
        quiet = table(0.0138, 0.5)
        chosen = noise.sequences(quiet, 1024)
        assert chosen["thesis"] == chosen["raised"] == (1, 2, 4, 8, 16)
        assert len(chosen["measured"]) == 2
        assert findings.sequence_finding(quiet, 1024).verdict == "in part"
        loud = noise.raised(quiet, 0.25)
        assert findings.sequence_finding(loud, 1024).verdict == "reproduced"

    def test_a_sequence_can_fail_to_come_out(self):
        # As much noise at all heights: raised to 0.25 rad, 32 fringes are not lost.  The
        # thesis's own numbers lead to its sequence whatever is measured, and decide nothing.
        flat = table(1e-6, 0.0)
        chosen = noise.sequences(flat, 1024)
        assert chosen["thesis"] == noise.THESIS_SEQUENCE
        assert noise.THESIS_SEQUENCE not in (chosen["measured"], chosen["raised"])
        finding = findings.sequence_finding(flat, 1024)
        assert finding.verdict == "not reproduced"
        assert "another sequence" in finding.why
        assert "same sequence" in findings.sequence_finding(table(0.0138, 0.5), 1024).why

    def test_pictures_and_tables(self):
        found = {"single": table(0.01, 1.0), "fused-lit": table(0.01, 0.0)}
        assert len(report.noise_table(found).rows) == 12
        assert report.noise_picture(found).png.startswith(b"\x89PNG")


class TestPlane:
    def test_fit(self):
        rng = np.random.default_rng(0)
        x, y = rng.uniform(-0.2, 0.2, (2, 5000))
        z = 0.1 + 0.02 * x - 0.03 * y + rng.normal(0.0, 1e-4, 5000)
        fit = plane.fit_plane(np.column_stack((x, y, z)))
        # Five deviations of the mean and of the slopes (1e-4 / (0.115 sqrt(5000))).
        assert fit.height_mm == pytest.approx(z.mean(), abs=1e-12)
        assert fit.slope == pytest.approx((0.02, -0.03), abs=7e-5)
        assert fit.rms_mm == pytest.approx(1e-4, rel=0.05)

    @pytest.mark.parametrize(
        "points", [np.zeros((2, 3)), np.zeros((5, 2)), np.arange(30.0).reshape(10, 3)]
    )
    def test_bad_points(self, points):
        with pytest.raises(InputError, match="plane"):
            plane.fit_plane(points)

    def test_verdicts(self):
        z = np.repeat(np.linspace(-0.25, 0.25, 11), 4)
        rng = np.random.default_rng(1)
        near = 1e-4 * (1.0 + 50.0 * z**2) * rng.choice([-1.0, 1.0], (1, 44))
        off = near + rng.normal(0.0, 1.5e-3, (40, 44))
        under, ends = findings.plane_findings(z, off, near)
        assert under.verdict == "by assumption"
        assert "1.01 µm" in under.assumes
        # The median of |N(0, 1.5)| is 1.01 um; its own scatter over 24 positions is 0.25 um.
        assert under.ours == pytest.approx(1.01, abs=0.15)
        assert ends.verdict == "in part"
        assert findings.plane_findings(z, 3.0 * off, near)[0].verdict == "not reproduced"
        assert findings.plane_findings(z, near, near)[1].verdict == "reproduced"
        assert "0, 50, 450 and 500" in ends.criterion
        assert report.plane_picture(z, off, near).png.startswith(b"\x89PNG")
        assert len(report.plane_table(z, {"off": off}).rows) == 11

    def test_in_95_percent_of_the_draws_means_that(self):
        # Two draws of 40 above the limit are 5 %: 95 % of the draws are under it.  Three are not.
        z = np.repeat(np.linspace(-0.25, 0.25, 11), 4)
        for above, verdict in ((2, "by assumption"), (3, "not reproduced")):
            off = np.full((40, 44), 1e-3)
            off[:above] = 3e-3
            assert findings.plane_findings(z, off, off[:1])[0].verdict == verdict

    def test_the_ends_are_those_that_the_thesis_names(self):
        # Large errors at 100 um of 500, which is neither end nor middle, decide nothing.
        z = np.repeat(np.linspace(-0.25, 0.25, 11), 4)
        off = np.full((40, 44), 1e-3)
        off[:, np.abs(z) > 0.19] = 2e-3
        expected = findings.plane_findings(z, off, off[:1])
        assert expected[1].verdict == "reproduced"
        assert expected[1].ours == pytest.approx(2.0)
        off[:, np.abs(z + 0.15) < 0.01] = 0.05
        assert findings.plane_findings(z, off, off[:1]) == expected


def quadratic_experiment():
    """Return dots at 66 positions seen by a quadratic camera, to 0.02 um."""
    rng = np.random.default_rng(2)
    scene = load_scene("ch8-grid-stack")
    positions = ch8.stage_positions(scene, 11, 6)
    dots = 0.125 * np.stack(np.meshgrid(*[np.arange(-1.5, 2.0)] * 2), axis=-1).reshape(-1, 2)
    world = np.concatenate([np.column_stack((dots, np.zeros(16))) + p for p in positions])
    x, y, z = (world + rng.normal(0.0, 2e-5, world.shape)).T
    u_c, v_c = 730 * (x + 0.3 * z + 0.01 * x * z) + 255, 730 * (-y + 0.01 * y * z) + 255
    u_p = 1500 * (x - 0.7 * z + 0.02 * z * z) + 511
    pixels = np.column_stack((u_c, v_c, u_p, np.full(len(x), np.nan)))
    return Experiment(
        CalibrationPoints(pixels, world),
        np.repeat(np.arange(66), 16),
        positions,
        np.zeros((len(x), 2)),
    )


@pytest.fixture(scope="module")
def experiment():
    return quadratic_experiment()


@pytest.fixture(scope="module")
def calibrated(experiment):
    return {s: models.calibrations(experiment, s, 4, 0) for s in STAGES}


class TestModels:
    def test_an_exact_stage_leaves_the_points(self, experiment):
        rng = np.random.default_rng(0)
        points = models.disturbed(experiment, "exact", rng)
        assert np.array_equal(points.world, experiment.points.world)

    def test_errors_are_those_of_positions(self, experiment):
        points = models.disturbed(experiment, "all axes", np.random.default_rng(0))
        moved = (experiment.points.world - points.world).reshape(66, 16, 3)
        # All dots of a position together.
        np.testing.assert_allclose(moved, np.broadcast_to(moved[:, :1], moved.shape), atol=1e-12)
        # Chi-square with 66 x 3 draws: within 20 % but for 1 in 10,000 seeds.
        assert np.std(moved[:, 0]) == pytest.approx(1.5e-3, rel=0.2)

    def test_an_axis_that_stands_still_has_no_error_but_the_dots(self, experiment):
        points = models.disturbed(experiment, "moved axes", np.random.default_rng(0))
        moved = (experiment.points.world - points.world).reshape(6, 11, 16, 3)
        # In x the same for a dot at all positions; in y the same for all heights of a row.
        assert np.ptp(moved[..., 0], axis=(0, 1)).max() < 1e-12
        assert np.ptp(moved[..., 1], axis=1).max() < 1e-12
        assert np.std(moved[0, 0, :, 0]) == pytest.approx(models.DOT_SIGMA_MM, rel=0.6)
        assert np.ptp(moved[..., 2], axis=2).max() < 1e-12
        assert np.std(moved[..., 0, 2]) == pytest.approx(1.5e-3, rel=0.35)

    def test_errors_of_the_stage_are_seen_in_validation(self, calibrated):
        exact = calibrated["exact"].validation()
        off = calibrated["all axes"].validation()
        assert np.all(exact < 2e-4)
        # 66 positions of 16 dots that move together.
        np.testing.assert_allclose(np.median(off, axis=0), 1.5e-3, rtol=0.35)
        # A model averages them: its own error is the smaller one.
        assert np.all(np.median(calibrated["all axes"].true_rms, axis=0) < 1e-3)

    def test_z_is_the_worst_where_the_stage_moves_in_z(self, calibrated):
        assert calibrated["moved axes"].z_worst > 0.5
        models, z_worst = findings.model_findings(calibrated)
        assert models.name == "ch8-quadratic"
        # By an exact stage it is not: what is seen is the error that was put into z.
        assert calibrated["exact"].z_worst == 0.0
        assert z_worst.verdict in ("by assumption", "in part")
        assert "in z and not in x" in z_worst.assumes
        assert len(report.model_table(calibrated).rows) == 9
        assert report.model_picture(calibrated).png.startswith(b"\x89PNG")


@pytest.fixture(scope="module")
def known():
    """Known views in place of measured ones."""
    views = stage_views("rough", 2, seed=3)
    registration = register_views(views.clouds, views.positions)
    true = views.positions + views.errors
    measured = []
    for cloud, stage in zip(views.clouds, true, strict=True):
        surface = cloud.copy()
        at = cloud - stage
        surface[:, 2] = views.surface(at[:, 0], at[:, 1]) + stage[2]
        up = np.tile(np.float32([0.0, 0.0, 1.0]), (len(cloud), 1))
        level = np.ones(len(cloud), bool)
        error = (cloud - surface).astype(np.float32)
        measured.append(View(cloud.astype(np.float32), error, up, level, ~level))
    return merged("coin-3", measured, registration, true)


class TestObjects:
    def test_scores(self, known):
        assert known.points.shape == (120_000, 3)
        before, after = known.registration_rms_mm
        assert after < 0.3 * before
        # Noise along z and what is left of the displacements.
        assert known.errors().std() == pytest.approx(NOISE_MM, rel=0.1)
        measured, true = known.roughness_mm
        # Waves of 0.3 um RMS have 0.24 um Ra; some are longer than 80 um and cut off.
        assert 5e-5 < true < 2.4e-4
        # 60 nm of noise in means of five points add a few nanometres.
        assert measured == pytest.approx(true, rel=0.1)

    def test_findings(self, known):
        shape, few = findings.object_findings(known, 1.0)
        assert (shape.verdict, few.verdict) == ("reproduced", "not reproduced")
        assert few.ours == pytest.approx(0.12)
        # A preview's points count as those of the full camera; they follow from the binning.
        many = findings.object_findings(known, 1.0 / 64.0)[1]
        assert many.verdict == "by assumption"
        # As accurate as views that the stage puts together, and as the thesis.
        off = replace(known, before_mm=known.before_mm * 0.05)
        assert findings.object_findings(off, 1.0)[0].verdict == "in part"
        assert findings.registration_finding([known]).verdict == "reproduced"
        # The thesis's gear has 4.5 million points, not the coins' "more than 2".
        gear = replace(known, name="watch-gear")
        for share, verdict in ((1 / 28.0, "not reproduced"), (1 / 38.0, "by assumption")):
            finding = findings.object_findings(gear, share)[1]
            assert (finding.verdict, finding.thesis) == (verdict, 4.5)
            assert "4.5 million points (fig. 37)" in finding.statement
            assert "a choice of this run" in finding.assumes
        # Without registration.
        same = replace(known, name="coin-n", after_mm=known.before_mm)
        assert findings.registration_finding([same]).verdict == "not reproduced"
        assert findings.registration_finding([known, same]).verdict == "in part"

    def test_picture_and_cloud(self, known):
        picture = report.object_picture(known)
        assert picture.png.startswith(b"\x89PNG")
        assert len(picture.png) < 250_000
        assert report.object_cloud(known, 0).points.shape == (30_000, 3)
        assert len(report.objects_table([known]).rows) == 1


def test_binned_pixels_have_the_same_places():
    fine, coarse = (load_scene("ch8-plane").coarser(d, 1).rig.camera for d in (2, 8))
    points = np.array([[0.1, -0.2, 0.05], [0.0, 0.0, 0.0]])
    to_coarse = ch8.rebinned(2, 8)
    np.testing.assert_allclose(to_coarse(fine.project(points)), coarse.project(points), atol=1e-9)


def test_the_views_are_the_thesiss():
    assert {name: len(places) for name, places in ch8.VIEWS.items()} == findings.THESIS_VIEWS
    coin, letter = (np.array(ch8.VIEWS[name]) for name in ("coin-3", "coin-n"))
    assert np.ptp(coin, axis=0)[1] == 0.0
    assert np.all(np.ptp(letter, axis=0) > 0.0)


@pytest.mark.slow
def test_preview(tmp_path):
    stages = set()
    outcome = ch8.run_ch8(preview=True, seed=0, on_progress=lambda s, _: stages.add(s))
    assert stages == {"noise", "calibration", "plane", *ch8.VIEWS}
    verdicts = {finding.name: finding.verdict for finding in outcome.findings}
    # Each criterion is a statistical one of its own; these hold by a wide margin, as in the whole.
    assert verdicts["ch8-noise-ends"] == "reproduced"
    assert verdicts["ch8-sequence"] == "not reproduced"
    values = {finding.name: finding.ours for finding in outcome.findings}
    # The stage's own scatter, 1.01 um, and the calibration's; its spread over the draws.  Of a
    # preview's eight draws the verdict asks for the worst, whose 15 positions may choose badly.
    assert 0.5 < values["ch8-plane-middle"] < 2.0
    # Of the gear's 4.5 million points a quarter of the camera's pixels leaves 3.3.
    points = [verdicts[f"ch8-{name}-points"] for name in ch8.VIEWS]
    assert points == ["by assumption", "by assumption", "not reproduced"]
    assert all(len(picture.png) < 250_000 for picture in outcome.pictures.values())
    write_outcome(outcome, tmp_path)
    assert (tmp_path / "ch8.md").exists()
