"""Wrong fringe orders: what the fit withstands, over rigs, shares, numbers and patterns."""

import functools

import numpy as np
import pytest
from calibration_data import polynomial_data, rig_points

from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import Basis, Standardisation, polynomial_form
from slbench.calibration.selection import select_models
from slbench.calibration.summary import gross_note, gross_table, panel_errors
from slbench.calibration.trimmed import consistent, trimmed_size

RIGS = ("plane", "ch8-grid")  # macro, micro
PERIOD_PX, NOISE_PX = 64.0, 0.05


def wrong_orders(points, share, pattern, rng):
    """Move u_p by one period in a share of the points; return them and which are wrong."""
    n = len(points)
    count = round(share * n)
    order = {
        "signs": rng.permutation(n),
        "one way": rng.permutation(n),
        "corner": np.argsort(-points.pixels[:, 0]),
        "end": np.argsort(-points.world[:, 2]),
    }[pattern]
    rows = order[:count]
    pixels = points.pixels.copy()
    pixels[rows, 2] += PERIOD_PX * (rng.choice([-1, 1], count) if pattern == "signs" else 1.0)
    wrong = np.zeros(n, dtype=bool)
    wrong[rows] = True
    return CalibrationPoints(pixels, points.world, points.position), wrong


@functools.cache
def without_wrong(rig, n, seed, multivariate):
    """Return right points and what is found of them."""
    points = rig_points(n, NOISE_PX, seed=seed, name=rig)
    return points, select_models(points, seed=seed, multivariate=multivariate)


def ratio(rig, n, share, pattern, seed, multivariate=False):
    """Error of the right points with wrong ones among them, over that without any."""
    points, clean = without_wrong(rig, n, seed, multivariate)
    data, wrong = wrong_orders(points, share, pattern, np.random.default_rng([seed, 1]))
    found = select_models(data, seed=seed, multivariate=multivariate)
    right = points.select(~wrong)
    before, after = (
        np.sqrt(np.mean((s.model.predict(right.inputs()) - right.world) ** 2, axis=0))
        for s in (clean, found)
    )
    left_out = np.zeros(n, dtype=bool)
    left_out[found.gross] = left_out[found.gross_validation] = True
    return float(np.max(after / before)), np.array_equal(left_out, wrong)


@pytest.mark.parametrize("multivariate", [False, True])
@pytest.mark.parametrize("rig", RIGS)
def test_wrong_orders_cost_right_points_little(rig, multivariate):
    for seed, (n, share, pattern) in enumerate(
        [(150, 0.2, "one way"), (150, 13 / 150, "signs"), (400, 0.2, "signs"), (400, 0.01, "end")]
    ):
        cost, exactly = ratio(rig, n, share, pattern, seed, multivariate)
        assert cost < 1.3, (n, share, pattern)
        assert exactly, (n, share, pattern)


@pytest.mark.statistics
@pytest.mark.parametrize("pattern", ["signs", "one way", "corner", "end"])
@pytest.mark.parametrize("n", [150, 400, 1000])
@pytest.mark.parametrize("rig", RIGS)
def test_breakdown_over_rigs(rig, n, pattern):
    """Errors of right points <= 1.3 times the clean ones in 95 % of draws, at every share."""
    for share in (0.01, 0.05, 0.10, 0.20):
        costs = [ratio(rig, n, share, pattern, seed)[0] for seed in range(20)]
        assert np.mean(np.array(costs) <= 1.3) >= 0.95, (share, costs)


@pytest.mark.parametrize("rig", RIGS)
def test_without_wrong_points_none_is_left_out(rig):
    """And the result is that of all points: trimming costs right points nothing."""
    for seed, n in enumerate((60, 100, 150, 400)):
        points = rig_points(n, NOISE_PX, seed=seed, name=rig)
        found = select_models(points, seed=seed)
        assert len(found.gross) == len(found.gross_validation) == 0
        for score in found.final.values():
            assert score.cv_robust == score.cv
            assert score.validation_rms_robust == score.validation_rms


@pytest.mark.statistics
@pytest.mark.parametrize("p", [4, 10, 20])
def test_few_right_points_are_hardly_ever_left_out(p):
    """From twice as many points as coefficients on: below 0.5 % of the points of 200 draws."""
    form = {4: "M1", 10: "M3", 20: "M4"}[p]
    for n in (2 * p + 1, 3 * p, 5 * p):
        lost = 0
        for seed in range(200):
            rng = np.random.default_rng([p, n, seed])
            x, truth, _ = polynomial_data(form, n, 0.0, rng)
            y = truth[:, None] * [1.0, -2.0, 0.5] + 0.1 * rng.normal(size=(n, 3))
            standardised = (x - 1000) / 700
            basis = Basis.of(standardised, polynomial_form(form))
            lost += np.count_nonzero(~consistent(basis, standardised, y))
        assert lost <= 0.005 * 200 * n, (n, lost)


def test_wrong_world_coordinates_are_found_too():
    """A slip of the stage or of the numbering: leverage backwards, a plain outlier forwards."""
    points = rig_points(300, NOISE_PX)
    world = points.world.copy()
    rows = np.random.default_rng(1).permutation(300)[:60]
    world[rows, :2] += [0.125, 0.0]
    found = select_models(CalibrationPoints(points.pixels, world))
    left_out = np.union1d(found.gross, found.gross_validation)
    np.testing.assert_array_equal(left_out, np.sort(rows))


@pytest.mark.parametrize("axis", [2, 3])
def test_both_panel_axes(axis):
    """Where u_p is wrong the points are left out; v_p can be left aside by the model."""
    points = rig_points(400, NOISE_PX, name="plane")
    rows = np.random.default_rng(3).permutation(400)[:80]
    pixels = points.pixels.copy()
    pixels[rows, axis] += PERIOD_PX
    right = points.select(np.setdiff1d(np.arange(400), rows))
    errors = [
        np.std(select_models(data, axes="uv").model.predict(right.inputs("uv")) - right.world, 0)
        for data in (points, CalibrationPoints(pixels, points.world))
    ]
    assert np.all(errors[1] < 1.3 * errors[0])


def test_many_points_are_searched_in_part():
    points = rig_points(5000, NOISE_PX)
    data, wrong = wrong_orders(points, 0.2, "one way", np.random.default_rng(0))
    form = polynomial_form("M4")
    standardised = Standardisation.of(data.inputs(), form.variables).apply(data.inputs())
    inside = consistent(Basis.of(standardised, form), standardised, data.world)
    np.testing.assert_array_equal(inside, ~wrong)


def test_exact_points():
    points = rig_points(200)
    data, wrong = wrong_orders(points, 0.1, "signs", np.random.default_rng(0))
    found = select_models(data)
    assert set(np.flatnonzero(wrong)) <= set(found.gross) | set(found.gross_validation)


def test_fewer_points_than_twice_the_coefficients_are_not_trimmed():
    points = rig_points(39, NOISE_PX)
    form = polynomial_form("M4")
    standardised = Standardisation.of(points.inputs(), form.variables).apply(points.inputs())
    pixels = standardised.copy()
    pixels[0, 2] += 1.0
    assert consistent(Basis.of(pixels, form), pixels, points.world).all()
    assert trimmed_size(40, 20) == 31
    assert trimmed_size(24, 20) == 23


def test_more_than_half_wrong_breaks_down():
    """A bound from above: what most points say is taken as right."""
    cost, exactly = ratio("plane", 150, 0.6, "one way", 0)
    assert not exactly
    assert cost > 1.3


class TestWords:
    points = rig_points(150, NOISE_PX, name="plane")

    def found(self, share):
        data, wrong = wrong_orders(self.points, share, "signs", np.random.default_rng(2))
        return data, select_models(data), wrong

    def test_note_counts_and_names_the_cause(self):
        data, found, _ = self.found(13 / 150)
        note = gross_note(data, found)
        assert note.startswith("13 of 150 points left out")
        assert "64 px off (a wrong fringe order?)" in note
        assert "mend the points" not in note
        assert "mend the points" in gross_note(*self.found(0.25)[:2])

    def test_table_lists_them(self):
        data, found, wrong = self.found(13 / 150)
        table = gross_table(data, found)
        assert sorted(row[0] for row in table.rows) == (np.flatnonzero(wrong) + 1).tolist()
        off = np.array([row[-1] for row in table.rows])
        # Points off the volume: the polynomial has to be followed back to it.
        np.testing.assert_allclose(np.abs(off), PERIOD_PX, atol=0.5)

    def test_an_error_in_the_world_is_no_wrong_order(self):
        world = self.points.world.copy()
        world[:8, 1] += 5.0
        data = CalibrationPoints(self.points.pixels, world)
        found = select_models(data)
        assert gross_note(data, found).startswith("8 of 150 points left out")
        assert "fringe order" not in gross_note(data, found)
        assert panel_errors(found.model, data.select(np.arange(8)))[1].max() < 0.5

    def test_rows_are_in_the_json(self):
        _, found, wrong = self.found(13 / 150)
        assert found.to_dict()["gross_rows"] == (np.flatnonzero(wrong) + 1).tolist()
