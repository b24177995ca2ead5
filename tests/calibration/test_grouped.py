"""Positions of the stage: split, errors of positions left out, covariance, choice."""

import numpy as np
import pytest
from calibration_data import grid_points, rig_of
from scipy.stats import chi2

from slbench.calibration.candidates import Candidates, Problem
from slbench.calibration.grouped import (
    LEAST_POSITIONS,
    Blocks,
    smallest_form,
    split_positions,
)
from slbench.calibration.models.model import CalibrationModel
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import FORMS, Standardisation, polynomial_form
from slbench.calibration.robust import irls
from slbench.calibration.scores import rms
from slbench.calibration.selection import select_models
from slbench.calibration.summary import position_note
from slbench.core.errors import InputError

#: Of the stage, each axis, mm (thesis 8.3).
STAGE_MM = 0.0015


def staged(heights=11, shifts=6, side=4, noise_px=0.01, name="ch8-grid"):
    """Return exact world coordinates and pixels of a grid at heights and shifts, by position."""
    parts, position = [], []
    for shift in range(shifts):
        points = grid_points(heights, side, 0.0, name)
        world = points.world.copy()
        world[:, 1] += 0.02 * (shift - 0.5 * (shifts - 1))
        _, label = np.unique(np.round(world[:, 2], 9), return_inverse=True)
        parts.append(world)
        position.append(label + heights * shift)
    rig, world = rig_of(name), np.concatenate(parts)
    pixels = np.column_stack((rig.camera.project(world), rig.projector.project(world)))
    pixels = pixels + noise_px * np.random.default_rng(5).normal(size=pixels.shape)
    return CalibrationPoints(pixels, world, np.concatenate(position))


def disturbed(points, rng, sigma=STAGE_MM):
    """Return the points with the nominal coordinates of a stage that is off."""
    error = rng.normal(0.0, sigma, (points.position.max() + 1, 3))
    return CalibrationPoints(points.pixels, points.world - error[points.position], points.position)


def test_positions_are_held_whole():
    position = np.random.default_rng(0).integers(0, 20, 300)
    train, held = split_positions(position, 0.2, 3)
    np.testing.assert_array_equal(np.sort(np.concatenate((train, held))), np.arange(300))
    assert not set(position[train]) & set(position[held])
    assert len(set(position[held])) == 4
    np.testing.assert_array_equal(split_positions(position, 0.2, 3)[1], held)
    with pytest.raises(InputError, match="positions enough"):
        split_positions(np.array([0, 0, 1, 1]), 0.2, 0)


class TestErrors:
    """Against refits without each position."""

    def refitted(self, loss):
        points = disturbed(staged(6, 3), np.random.default_rng(0))
        form = polynomial_form("M3")
        x = Standardisation.of(points.inputs(), form.variables).apply(points.inputs())
        design, y, position = form.design(x), points.world[:, 2], points.position
        q = np.linalg.qr(design)[0]
        fit = irls(q, y, loss=loss)
        slope = float(np.mean(2 * fit.weights**2 - fit.weights))
        found = Blocks(q, position).left_out_errors(fit.residuals, fit.weights, slope)
        expected = np.empty(len(y))
        for g in np.unique(position):
            out = position == g
            part, r = np.linalg.qr(design[~out])
            coefficients = np.linalg.solve(r, irls(part, y[~out], loss=loss).coefficients)
            expected[out] = y[out] - design[out] @ coefficients
        return found, expected, fit.residuals

    def test_exact_for_least_squares(self):
        found, expected, _ = self.refitted("least-squares")
        # Errors of 1e-3 mm of coordinates of 1 mm.
        np.testing.assert_allclose(found, expected, atol=1e-12)

    def test_near_for_the_robust_fit(self):
        found, expected, residuals = self.refitted("cauchy")
        # One Newton step: the sum to some per cent, where residuals are far below.
        assert rms(found) == pytest.approx(rms(expected), rel=0.05)
        assert rms(residuals) < 0.9 * rms(expected)

    def test_a_position_that_alone_determines_a_term_is_not_predicted(self):
        q = np.linalg.qr(np.column_stack((np.ones(40), np.arange(40) < 5)))[0]
        position = np.arange(40) // 5
        found = Blocks(q, position).left_out_errors(np.ones(40), np.ones(40), 1.0)
        assert np.isinf(found[:5]).all()
        assert np.isfinite(found[5:]).all()


def test_the_smaller_of_two_alike_is_chosen():
    rng = np.random.default_rng(0)
    position = np.repeat(np.arange(50), 10)
    error = rng.normal(size=500)
    assert smallest_form([3 * error, error, 0.9999 * error], position) == 2  # all a bit better
    assert smallest_form([3 * error, error, rng.permutation(error)], position) == 1
    assert smallest_form([np.full(500, np.inf), error], position) == 1


@pytest.mark.parametrize("repeats", [40, pytest.param(200, marks=pytest.mark.statistics)])
@pytest.mark.parametrize("loss", ["cauchy", "least-squares"])
def test_covariance_is_that_of_repeated_stages(loss, repeats):
    """Predictions of repeats scatter as predicted, and far more than independent points would.

    The mean over the volume of variance found over predicted: 0.7 to 1.5 (from 40 repeats of ten
    coefficients it is known to 10 %; a sandwich of 66 positions lacks some of the variance).  Were
    all points independent, it would be some five times too small.
    """
    points = staged()
    form = polynomial_form("M3")
    x = Standardisation.of(points.inputs(), form.variables).apply(points.inputs())
    predictions, clustered, independent = [], [], []
    for repeat in range(repeats):
        data = disturbed(points, np.random.default_rng([1, repeat]))
        for position, variances in ((data.position, clustered), (None, independent)):
            problem = Problem(
                inputs=x,
                world=data.world,
                held_inputs=x[:1],
                held_world=data.world[:1],
                position=position,
                options={"loss": loss},
            )
            (fit,) = Candidates(problem, [form], np.ones(len(x), dtype=bool)).separate([(form, 2)])
            design = form.design(x)
            variances.append(np.einsum("ni,ij,nj->n", design, fit.model.covariance, design))
        predictions.append(design @ fit.model.coefficients)
    found = np.var(predictions, axis=0, ddof=1)
    assert 0.7 < np.mean(found) / np.mean(clustered) < 1.5
    assert np.mean(found) > 3 * np.mean(independent)


def test_joint_covariance_is_that_of_the_separate_fit_where_weights_are_one():
    data = disturbed(staged(6, 3), np.random.default_rng(2))
    options = {"loss": "least-squares", "forms": ("M3",)}
    alone = select_models(data, **options).model
    joint = select_models(data, multivariate=True, **options).model
    assert alone.positions == joint.positions == 14
    for a, b in zip(alone.coordinates, joint.coordinates, strict=True):
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-6, atol=1e-20)


def right_choices(draws, grouped):
    """Return the share of draws in which the truly best form is chosen, by coordinate."""
    points = staged()
    right = []
    for draw in range(draws):
        data = disturbed(points, np.random.default_rng([2, draw]))
        if not grouped:
            data = CalibrationPoints(data.pixels, data.world)
        found = select_models(data, seed=draw)
        errors = []
        for form in FORMS:
            one = select_models(data, forms=(form,), seed=draw).model
            errors.append(np.sqrt(np.mean((one.predict(points.inputs()) - points.world) ** 2, 0)))
        best = np.argmin(errors, axis=0)
        right.append([found.selected[c] == FORMS[k] for c, k in zip("xyz", best, strict=True)])
    return np.mean(right, axis=0)


def test_positions_choose_better_than_dots():
    grouped, single = right_choices(8, True), right_choices(8, False)
    # 24 choices each: 0.9 and 0.5 are four standard errors apart.
    assert grouped.mean() >= 0.75
    assert grouped.mean() > single.mean() + 0.1


@pytest.mark.statistics
def test_the_truly_best_form_is_chosen_in_80_per_cent():
    assert np.all(right_choices(100, True) >= 0.8)


class TestPoints:
    points = staged(5, 2)

    def test_file(self, tmp_path):
        self.points.write(tmp_path / "points.csv")
        back = CalibrationPoints.read(tmp_path / "points.csv")
        np.testing.assert_array_equal(back.position, self.points.position)
        CalibrationPoints(self.points.pixels, self.points.world).write(tmp_path / "bare.csv")
        assert CalibrationPoints.read(tmp_path / "bare.csv").position is None

    def test_a_position_is_a_whole_number(self, tmp_path):
        path = tmp_path / "points.csv"
        path.write_text(
            "u_c,v_c,u_p,v_p,x_mm,y_mm,z_mm,position\n1,2,3,4,5,6,7,8\n1,2,3,4,5,6,7,8.5\n"
        )
        with pytest.raises(InputError, match=r"row 2 below the header: position.*got 8\.5"):
            CalibrationPoints.read(path)
        with pytest.raises(InputError, match="position"):
            CalibrationPoints(self.points.pixels, self.points.world, np.zeros(3, dtype=int))
        with pytest.raises(InputError, match="position"):
            CalibrationPoints(
                self.points.pixels, self.points.world, 0.5 * np.ones(len(self.points))
            )

    def test_a_misspelt_column_is_named(self, tmp_path):
        path = tmp_path / "points.csv"
        path.write_text("u_c,v_c,u_p,v_p,x_mm,y_mm,z_mm,positon\n1,2,3,4,5,6,7,8\n")
        with pytest.raises(InputError, match=r"perhaps position.*positon"):
            CalibrationPoints.read(path)

    def test_rows_keep_their_position(self):
        some = self.points.select(np.array([5, 1]))
        np.testing.assert_array_equal(some.position, self.points.position[[5, 1]])


class TestNotes:
    def test_whole_positions(self):
        data = disturbed(staged(6, 3), np.random.default_rng(0))
        found = select_models(data)
        assert found.positions == 14
        assert position_note(data, found).startswith("Whole positions are left out: 14 train, 4")
        assert found.to_dict()["n"]["positions"] == 14
        for scores in found.scores.values():
            for score in scores.values():
                assert score.predictive == score.cv_grouped > score.cv_robust

    def test_without_positions(self):
        points = staged(6, 3)
        data = CalibrationPoints(points.pixels, points.world)
        found = select_models(data)
        assert found.positions is None
        assert "No positions are known" in position_note(data, found)

    def test_with_too_few(self):
        data = staged(LEAST_POSITIONS - 1, 1, side=8)
        found = select_models(data)
        assert found.positions is None
        assert "9 positions are too few" in position_note(data, found)
        assert select_models(staged(LEAST_POSITIONS, 1, side=8)).positions == 8


def test_the_model_keeps_its_positions(tmp_path):
    data = disturbed(staged(6, 3), np.random.default_rng(0))
    found = select_models(data, seed=1)
    found.model.save(tmp_path / "model.json")
    assert CalibrationModel.load(tmp_path / "model.json").positions == 14
    bare = select_models(CalibrationPoints(data.pixels, data.world), seed=1).model
    bare.save(tmp_path / "bare.json")
    assert "positions" not in (tmp_path / "bare.json").read_text()
    assert CalibrationModel.load(tmp_path / "bare.json").positions is None
    # A stage's error of each position: deviations of the model are larger than of single points.
    ratio = [
        np.trace(a.covariance) / np.trace(b.covariance)
        for a, b in zip(
            select_models(data, forms=("M3",)).model.coordinates,
            select_models(
                CalibrationPoints(data.pixels, data.world), forms=("M3",)
            ).model.coordinates,
            strict=True,
        )
    ]
    assert min(ratio) > chi2(10).ppf(0.5) / 10 * 2


@pytest.mark.parametrize("draws", [10, pytest.param(80, marks=pytest.mark.statistics)])
def test_points_at_new_positions_are_within_predicted_deviations(draws):
    """The held-out truth: whole new positions, of which each has an error of the stage."""
    base, new = staged(), staged(heights=7, shifts=3)
    within = []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        model = select_models(disturbed(base, rng)).model
        fresh = disturbed(new, rng)
        inputs = fresh.inputs()
        normed = np.abs(model.predict(inputs) - fresh.world) / model.predict_std(inputs)
        within.append([np.mean(normed < k, axis=0) for k in (1.0, 2.0, 3.0)])
    one, two, three = np.mean(within, axis=0)
    # 21 positions a draw share an error each: three deviations of the share over ten draws, 80.
    # Over 80, 0.72 are within one deviation: deviations are some 8 % larger than errors.
    slack = 0.1 if draws == 10 else 0.05
    np.testing.assert_allclose(one, 0.683, rtol=0, atol=slack)
    np.testing.assert_allclose(two, 0.954, rtol=0, atol=0.5 * slack)
    assert np.all(three > 0.985)
