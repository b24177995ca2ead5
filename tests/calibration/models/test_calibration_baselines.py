"""Look-up tables and pinholes: exact where their own model holds, and all on equal terms."""

import numpy as np
import pytest
from calibration_data import grid_points, rig_of

from slbench.calibration.baselines import PhaseHeightTable, compare_methods, plane_labels
from slbench.calibration.models import pinhole
from slbench.calibration.models.pinhole import PinholeModel, resection
from slbench.calibration.models.points import CalibrationPoints
from slbench.core.errors import InputError, InputWarning


def sizes(name):
    rig = rig_of(name)
    return (rig.camera.width, rig.camera.height), (rig.projector.width, rig.projector.height)


def test_plane_labels():
    z = [0.3, 0.0, 0.1001, 0.0999, 0.2, 0.0]
    np.testing.assert_array_equal(plane_labels(z), [3, 0, 1, 1, 2, 0])
    np.testing.assert_array_equal(plane_labels(z, gap_mm=0.15), np.zeros(6))
    np.testing.assert_array_equal(plane_labels([1.0, 1.0]), [0, 0])
    with pytest.raises(InputError):
        plane_labels([])


def parallel_rays(curvature=0.0, heights=6):
    """Points seen along parallel rays; u_p is linear in height, or by the reciprocal law."""
    u, v, z = (
        a.ravel() for a in np.meshgrid(np.arange(8) * 10.0, np.arange(8) * 10.0, range(heights))
    )
    h = z.astype(float)
    # 1 / h = curvature + a / d.
    d = 5.0 * h / (1.0 - curvature * h)
    pixels = np.column_stack((u, v, 100 + 0.5 * u + d, v))
    return CalibrationPoints(pixels, np.column_stack((0.01 * u + 0.1 * h, 0.01 * v, h)))


class TestTables:
    @pytest.mark.parametrize(("kind", "curvature"), [("linear", 0.0), ("reciprocal", 0.05)])
    def test_exact_where_their_law_holds(self, kind, curvature):
        points = parallel_rays(curvature)
        heights = plane_labels(points.world[:, 2])
        held = heights == 2
        table = PhaseHeightTable(kind).fit(points.select(~held), heights[~held])
        found = table.predict(points.inputs()[held])
        # Interpolation of linear functions is exact but for its gradients' iteration (1e-6
        # of a value's change between markings at worst).
        np.testing.assert_allclose(found, points.world[held], atol=1e-6)
        np.testing.assert_array_equal(table.heights_, [0, 1, 3, 4, 5])

    def test_linear_table_is_wrong_where_the_law_is_reciprocal(self):
        points = parallel_rays(0.05)
        table = PhaseHeightTable("linear").fit(points, plane_labels(points.world[:, 2]))
        assert np.abs(table.predict(points.inputs()) - points.world)[:, 2].max() > 0.01

    def test_pixels_that_too_few_heights_saw_have_no_answer(self):
        points = parallel_rays()
        table = PhaseHeightTable("linear").fit(points, plane_labels(points.world[:, 2]))
        found = table.predict([[30.0, 30.0, 120.0], [300.0, 30.0, 120.0]])
        assert np.isfinite(found[0]).all()
        assert np.isnan(found[1]).all()

    def test_refusals(self):
        points = parallel_rays(heights=2)
        with pytest.raises(InputError, match="3 heights"):
            PhaseHeightTable().fit(points, plane_labels(points.world[:, 2]))
        with pytest.raises(InputError, match="linear or reciprocal"):
            PhaseHeightTable("cubic")
        points = parallel_rays()
        line = points.select(points.pixels[:, 1] == 0)
        with pytest.raises(InputError, match="not on a line"):
            PhaseHeightTable().fit(line, plane_labels(line.world[:, 2]))


class TestPinholes:
    @pytest.mark.parametrize("name", ["ch8-grid", "plane"])
    def test_resection_finds_the_device(self, name):
        points, camera = grid_points(name=name), rig_of(name).camera
        matrix, pose = resection(points.world, points.pixels[:, :2])
        # Narrow fields of view lose digits: condition of some 1e8 of the microscope's.
        np.testing.assert_allclose(matrix, camera.matrix, rtol=1e-5, atol=0.1)
        np.testing.assert_allclose(pose.position, camera.pose.position, rtol=1e-5, atol=1e-4)

    @pytest.mark.parametrize("axes", ["u", "uv"])
    @pytest.mark.parametrize("name", ["ch8-grid", "plane"])
    def test_exact_rig_is_recovered(self, name, axes):
        points = grid_points(name=name)
        model = PinholeModel(*sizes(name), axes).fit(points)
        errors = model.predict(points.inputs(axes)) - points.world
        # OpenCV reads single precision: 1e-4 px of 1000, so 1e-7 of the volume, and a margin.
        assert np.abs(errors).max() < 1e-6 * np.ptp(points.world)
        assert max(model.reprojection_rms_px_) < 1e-3

    def test_refusals(self):
        points = grid_points()
        flat = points.select(points.world[:, 2] == points.world[0, 2])
        with pytest.raises(InputError, match="one plane"):
            PinholeModel(*sizes("ch8-grid")).fit(flat)
        with pytest.raises(InputError, match="at least 6"):
            PinholeModel(*sizes("ch8-grid")).fit(points.select(np.arange(5)))


class TestComparison:
    def test_without_noise_the_true_model_wins(self):
        found = compare_methods(grid_points(), *sizes("ch8-grid"))
        error = {name: score.rms_3d for name, score in found.scores.items()}
        assert (
            error["pinholes"]
            < error["polynomial"]
            < error["reciprocal table"]
            < error["linear table"]
        )
        assert error["linear table"] > 50 * error["reciprocal table"]
        assert found.held_out == (1, 3, 5, 7)
        assert found.planes == 9
        assert found.scores["polynomial"].measured == 1.0
        assert found.scores["linear table"].measured < 1.0  # the markings' outermost ring

    def test_with_noise_one_model_of_all_pixels_beats_a_table_per_pixel(self):
        """The thesis's claim (5.4.5): more data a coefficient, less variance."""
        found = compare_methods(grid_points(noise_px=0.1), *sizes("ch8-grid"))
        error = {name: score.rms_3d for name, score in found.scores.items()}
        # Phase noise of the point itself is common to all; a table of five heights adds some
        # 40 % of its variance, which is 18 % of the deviation.
        assert error["reciprocal table"] > 1.08 * error["polynomial"]
        assert error["polynomial"] == pytest.approx(error["pinholes"], rel=0.03)
        assert set(found.to_dict()["methods"]) == set(error)

    def test_wrong_orders_spoil_no_method(self):
        points = grid_points(noise_px=0.05)
        rng = np.random.default_rng(0)
        rows = rng.permutation(len(points))[: len(points) // 10]
        # At the heights that are fitted to: what is scored stays the same.
        planes = plane_labels(points.world[:, 2])
        rows = rows[np.isin(planes[rows], (0, 2, 4, 6, 8))]
        pixels = points.pixels.copy()
        pixels[rows, 2] += 64.0
        clean = compare_methods(points, *sizes("ch8-grid"))
        found = compare_methods(CalibrationPoints(pixels, points.world), *sizes("ch8-grid"))
        for name in ("polynomial", "pinholes"):
            assert found.scores[name].rms_3d < 1.3 * clean.scores[name].rms_3d
        # A table has too few points about a pixel not to feel that some are missing.
        for name in ("linear table", "reciprocal table"):
            assert found.scores[name].mad_3d < 2.0 * clean.scores[name].mad_3d

    def test_scores_are_of_the_heights_held_out_alone(self):
        """What stands at a held-out height changes no method's fit."""
        points = grid_points(noise_px=0.05)
        first = compare_methods(points, *sizes("ch8-grid"), held_out=(4,))
        world = points.world.copy()
        held = plane_labels(world[:, 2]) == 4
        world[held, 0] += 0.01
        moved = CalibrationPoints(points.pixels, world)
        second = compare_methods(moved, *sizes("ch8-grid"), held_out=(4,))
        for name, score in first.scores.items():
            assert second.scores[name].rms["z"] == score.rms["z"]
            assert second.scores[name].rms["x"] == pytest.approx(0.01, rel=1e-2)

    def test_a_method_that_does_not_fit_takes_no_other_with_it(self, monkeypatch):
        def fails(*_):
            raise InputError("calibration of the projector", "points that fit a pinhole", "none")

        monkeypatch.setattr(PinholeModel, "fit", fails)
        with pytest.warns(InputWarning, match="calibration by pinholes: left out"):
            found = compare_methods(grid_points(), *sizes("ch8-grid"))
        assert set(found.scores) == {"polynomial", "linear table", "reciprocal table"}

    def test_the_calibration_may_begin_with_a_principal_point_outside(self, monkeypatch):
        """As that of a volume that is small beside its distance, whose dots are noisy, does."""

        def outside(*given):
            matrix, pose = resection(*given)
            return matrix - np.array([[0, 0, 1e4], [0, 0, 0], [0, 0, 0]]), pose

        monkeypatch.setattr(pinhole, "resection", outside)
        model = PinholeModel(*sizes("ch8-grid")).fit(grid_points(noise_px=0.05))
        assert max(model.reprojection_rms_px_) < 0.1

    def test_pinholes_need_both_axes(self):
        points = grid_points(noise_px=0.05)
        one = CalibrationPoints(points.pixels * [1, 1, 1, np.nan], points.world)
        assert "pinholes" not in compare_methods(one, *sizes("ch8-grid")).scores

    def test_refusals(self):
        points = grid_points(heights=4)
        with pytest.raises(InputError, match="heights"):
            compare_methods(points, *sizes("ch8-grid"), held_out=(1, 2))
        with pytest.raises(InputError, match="label"):
            compare_methods(points, *sizes("ch8-grid"), planes=np.zeros(3))
