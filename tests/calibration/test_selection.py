"""Selection of the model: PRESS, the split, the choice, and the reference it must reach."""

import numpy as np
import pytest
from calibration_data import polynomial_data, rig_points
from robust_polynomial import RobustPolynomial

from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import FORMS, Standardisation, polynomial_form
from slbench.calibration.scores import median_absolute, press, rms
from slbench.calibration.selection import forms_for, select_models, split
from slbench.core.errors import InputError


@pytest.mark.parametrize("loss", ["cauchy", "least-squares"])
@pytest.mark.parametrize("form", FORMS)
def test_press_is_leave_one_out(form, loss):
    """Against refits without each point, the weights held fixed."""
    x, _, y = polynomial_data("M3", 60, 0.1, np.random.default_rng(0))
    y[:3] += 2.0
    fit = RobustPolynomial(form, loss).fit(x, y)
    design = polynomial_form(form).design((x - 1000) / 700)
    root, errors = np.sqrt(fit.weights_), []
    for i in range(len(x)):
        kept = np.arange(len(x)) != i
        weighted = root[kept, None] * design[kept]
        coefficients = np.linalg.lstsq(weighted, root[kept] * y[kept])[0]
        errors.append(design[i] @ coefficients - y[i])
    expected = np.sum(np.square(errors))
    assert press(fit.residuals_, fit.leverage_) == pytest.approx(expected, rel=1e-9)
    # The trace of a projection is its rank.
    assert fit.leverage_.sum() == pytest.approx(len(polynomial_form(form)), rel=1e-12)


def test_metrics():
    errors = np.array([-3.0, 1.0, 2.0, 2.0])
    assert rms(errors) == pytest.approx(np.sqrt(18 / 4))
    assert median_absolute(errors) == 2.0  # about zero, not about the median (thesis eq. 45)
    assert press(np.array([1.0, 2.0]), np.array([0.5, 0.0])) == 8.0
    assert press(np.array([0.0]), np.array([1.0])) == np.inf


def test_split():
    train, held = split(103, 0.2, seed=4)
    assert len(held) == 21
    np.testing.assert_array_equal(np.sort(np.concatenate((train, held))), np.arange(103))
    np.testing.assert_array_equal(split(103, 0.2, seed=4)[1], held)
    assert not np.array_equal(split(103, 0.2, seed=5)[1], held)
    for share in (0.0, 1.0, -0.1, np.nan):
        with pytest.raises(InputError, match=r"^validation: "):
            split(100, share)
    with pytest.raises(InputError, match="enough"):
        split(2, 0.2)


def points_of(form, n, sigma, rng):
    """Points whose coordinates are one polynomial with independent noise."""
    x, truth, _ = polynomial_data(form, n, 0.0, rng)
    world = truth[:, None] * [1.0, -2.0, 0.5] + sigma * rng.normal(size=(n, 3))
    return CalibrationPoints(np.column_stack((x, np.full(n, np.nan))), world)


@pytest.mark.parametrize("form", FORMS)
def test_the_generating_form_is_chosen(form):
    """The generating form mostly, a smaller one never, a larger one now and then.

    A larger form passes when its m further coefficients' chi-squared exceeds 2 m: for M1
    that is P(chi2_3 > 6) = 0.11 and with the others 0.15 in all, less for the others.  Of
    the 60 choices more than 20 go wrong with probability 1e-4, were they independent; of a
    point's three coordinates they are.
    """
    chosen = []
    for seed in range(20):
        points = points_of(form, 300, 0.1, np.random.default_rng(seed))
        chosen += select_models(points, seed=seed).selected.values()
    assert min(chosen) == form
    assert chosen.count(form) >= 40


def test_scores_are_those_of_the_estimator():
    points = rig_points(600, 0.05)
    found = select_models(points, seed=7)
    train, held = split(600, 0.2, seed=7)
    x, y = points.inputs()[train], points.world[train, 2]
    fit = RobustPolynomial("M3").fit(x, y)
    score = found.scores["z"]["M3"]
    residuals = fit.predict(x) - y
    errors = fit.predict(points.inputs()[held]) - points.world[held, 2]
    # The same fit from a basis that has ten columns more: rounding alone.
    assert score.train_rms == pytest.approx(rms(residuals), rel=1e-9)
    assert score.train_mad == pytest.approx(median_absolute(residuals), rel=1e-7)
    assert score.validation_rms == pytest.approx(rms(errors), rel=1e-9)
    assert score.validation_mad == pytest.approx(median_absolute(errors), rel=1e-7)
    assert score.residual_ms == pytest.approx(np.sum(residuals**2) / (len(x) - 10), rel=1e-9)
    assert score.cv == pytest.approx(
        np.sqrt(press(fit.residuals_, fit.leverage_) / len(x)), rel=1e-9
    )
    parts = [found.scores[c][found.selected[c]].validation_rms for c in "xyz"]
    assert found.isometric["validation_rms"] == pytest.approx(np.linalg.norm(parts))


@pytest.mark.parametrize("name", ["ch8-grid", "plane"])
def test_noise_free_rig_is_approximated_as_well_as_can_be(name):
    """Two exact pinholes: the error is that of the best cubic, by NumPy's least squares."""
    points = rig_points(2000, name=name)
    plain = select_models(points, loss="least-squares")
    robust = select_models(points)
    assert set(plain.selected.values()) == set(robust.selected.values()) == {"M4"}
    x = Standardisation.of(points.inputs()[plain.train], ("u_c", "v_c", "u_p")).apply(
        points.inputs()
    )
    design = polynomial_form("M4").design(x)
    for k, coordinate in enumerate("xyz"):
        best = np.linalg.lstsq(design[plain.train], points.world[plain.train, k])[0]
        errors = design @ best - points.world[:, k]
        expected = rms(errors[plain.validation])
        # Errors of 1e-7 of the volume and more, rounding of 1e-15 of it.
        found = plain.scores[coordinate]["M4"]
        assert found.validation_rms == pytest.approx(expected, rel=1e-6)
        assert found.train_rms == pytest.approx(rms(errors[plain.train]), rel=1e-6)
        # The truncation error has heavier tails than noise, which the robust fit discounts.
        other = robust.model.predict(points.inputs())[robust.train, k]
        of_all = rms(other - points.world[robust.train, k])
        assert found.train_rms <= of_all < 1.25 * found.train_rms
    assert plain.isometric["validation_rms"] < 1e-4 * rig_depth(points)


def rig_depth(points):
    return np.ptp(points.world[:, 2])


def test_both_panel_axes_lower_the_error_of_noise():
    """v_p holds the point's y once more: a second look at it."""
    points = rig_points(3000, 0.05)
    one, two = (select_models(points, axes=axes) for axes in ("u", "uv"))
    assert two.final["y"].validation_rms < 0.97 * one.final["y"].validation_rms
    assert two.model.predict(points.inputs("uv")).shape == (3000, 3)


def with_outliers(points, share, step_px, seed):
    """Move u_p of some points by a wrong fringe order; return them and which are right."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(points), max(round(share * len(points)), 1), replace=False)
    pixels = points.pixels.copy()
    pixels[rows, 2] += step_px * rng.choice([-1, 1], len(rows))
    clean = np.setdiff1d(np.arange(len(points)), rows)
    return CalibrationPoints(pixels, points.world), clean


class TestGrossPoints:
    points = rig_points(1000, 0.05)

    @pytest.mark.parametrize("multivariate", [False, True])
    @pytest.mark.parametrize(("share", "step_px"), [(0.001, 192.0), (0.05, 64.0)])
    def test_choose_nothing(self, share, step_px, multivariate):
        differs = []
        for seed in range(3):
            found = select_models(self.points, seed=seed, multivariate=multivariate)
            wrong, clean = with_outliers(self.points, share, step_px, seed)
            right = select_models(wrong, seed=seed, multivariate=multivariate)
            assert right.selected == found.selected
            # All wrong ones that train, by a thousand deviations, and no other one: normal
            # noise has one in 1e15 beyond eight.
            np.testing.assert_array_equal(right.gross, np.setdiff1d(right.train, clean))
            assert len(found.gross) == 0
            good = self.points.select(clean)
            before, after = (
                np.std(one.model.predict(good.inputs()) - good.world, axis=0)
                for one in (found, right)
            )
            # A twentieth of the points less costs little of the 1.2 % that 20 coefficients do.
            np.testing.assert_allclose(after, before, rtol=0.03)
            by_all = {c: min(s, key=lambda f: s[f].cv) for c, s in right.scores.items()}
            differs.append(by_all != found.selected)
            for c, form in right.selected.items():
                assert right.scores[c][form].cv >= right.scores[c][form].cv_robust
        # The sum over all points, eq. 47, would have chosen otherwise with some seed.
        assert any(differs)

    def test_without_them_both_errors_are_one(self):
        for scores in select_models(self.points).scores.values():
            for score in scores.values():
                assert score.cv_robust == score.cv

    def test_do_not_bound_the_domain(self):
        clean = select_models(self.points).model
        wrong, _ = with_outliers(self.points, 0.01, 192.0, 0)
        model = select_models(wrong).model
        low, high = self.points.inputs().min(axis=0), self.points.inputs().max(axis=0)
        margin = 0.3 * (high - low)
        probe = np.random.default_rng(1).uniform(low - margin, high + margin, (20_000, 3))
        inside, expected = model.inside(probe), clean.inside(probe)
        # A hull of fewer of the same points: within, and hardly smaller.
        assert not np.any(inside & ~expected)
        assert inside.sum() > 0.95 * expected.sum()

    def test_are_counted(self):
        wrong, clean = with_outliers(self.points, 0.05, 64.0, 0)
        found = select_models(wrong, seed=3)
        assert found.to_dict()["n"] == {
            "train": 800,
            "validation": 200,
            "gross": len(np.setdiff1d(found.train, clean)),
            "gross_validation": len(np.setdiff1d(found.validation, clean)),
            "positions": None,
        }


def test_forms_that_points_are_enough_for():
    # 80 % train: 4, 5, 8 (more than 7), 11 and 21 of them.
    for n, forms in ((6, ("M1",)), (10, ("M1", "M2")), (14, FORMS[:3]), (26, FORMS)):
        assert forms_for(n) == forms
        assert set(select_models(rig_points(n, 0.05), forms=forms).scores["x"]) == set(forms)
    with pytest.raises(InputError, match=r"at least 5 training points.*got 4 of 5 that train"):
        forms_for(5)


class TestMultivariate:
    points = rig_points(1500, 0.05)

    def test_agrees_with_separate_fits_where_nothing_is_wrong(self):
        alone, joint = (select_models(self.points, multivariate=m) for m in (False, True))
        for name in "xyz":
            ratio = joint.final[name].validation_rms / alone.final[name].validation_rms
            assert ratio == pytest.approx(1.0, abs=0.02)

    def test_least_squares_is_the_same(self):
        options = {"loss": "least-squares", "forms": ("M3",)}
        alone = select_models(self.points, **options)
        joint = select_models(self.points, multivariate=True, **options)
        for name in "xyz":
            for key, value in vars(alone.final[name]).items():
                if key == "cv_grouped":
                    assert value is getattr(joint.final[name], key) is None
                elif key != "iterations":
                    assert getattr(joint.final[name], key) == pytest.approx(value, rel=1e-9)

    def test_forms_that_differ_are_fitted_together(self):
        rng = np.random.default_rng(5)
        x, *_ = polynomial_data("M1", 500, 0.0, rng)
        unit = (x - 1000) / 700
        world = np.column_stack(
            (unit.sum(axis=1), unit.prod(axis=1), np.sum(unit**2, axis=1))
        ) + 0.02 * rng.multivariate_normal(np.zeros(3), np.full((3, 3), 0.9) + 0.1 * np.eye(3), 500)
        points = CalibrationPoints(np.column_stack((x, x[:, 2])), world)
        found = select_models(points, multivariate=True)
        assert found.selected["x"] < "M4" == found.selected["y"]
        names = [one.form.name for one in found.model.coordinates]
        assert names == list(found.selected.values())
        for score in found.final.values():
            assert score.converged
            assert score.validation_rms < 0.025


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"axes": "v"}, "u or uv"),
            ({"forms": ()}, "forms"),
            ({"forms": ("M1", "M1")}, "forms"),
            ({"forms": ("M1", "M7")}, "M7"),
            ({"loss": "huber"}, "loss"),
            ({"validation": 2.0}, "validation"),
            ({"max_iterations": 0}, "max_iterations"),
            ({"tolerance": 0.0}, "tolerance"),
        ],
    )
    def test_options(self, options, words):
        with pytest.raises(InputError, match=words):
            select_models(rig_points(100, 0.1), **options)

    def test_too_few_points(self):
        expected = (
            r"model M4: expected at least 21 different training points "
            r"\(or --models M1,M2,M3\), got 20 of 25 that train$"
        )
        with pytest.raises(InputError, match=expected):
            select_models(rig_points(25, 0.1))
        with pytest.raises(InputError, match=r"\(or --models M1\), got 6 of 8 that train$"):
            select_models(rig_points(8, 0.1))
        with pytest.raises(InputError, match="at least 5 different training points, got 3 of 4"):
            select_models(rig_points(4, 0.1), forms=("M1",))
        # The candidates that they are enough for can be asked for.
        assert select_models(rig_points(25, 0.1), forms=("M1", "M2")).selected["x"] in FORMS[:2]

    @pytest.mark.parametrize("different", [19, 20])
    @pytest.mark.parametrize("multivariate", [False, True])
    def test_repeated_points_are_counted_once(self, different, multivariate):
        some = rig_points(different, 0.1)
        repeated = some.select(np.repeat(np.arange(different), 10))
        expected = f"got {8 * different} of {10 * different} that train, {different} different"
        with pytest.raises(InputError, match=expected):
            select_models(repeated, multivariate=multivariate)

    def test_one_height(self):
        points = rig_points(200, 0.1)
        world = points.world.copy()
        world[:, 2] = 0.25
        with pytest.raises(InputError, match=r"z_mm: expected values that differ.*0\.25"):
            select_models(CalibrationPoints(points.pixels, world))

    def test_a_plane_of_inputs_names_the_smallest_form_that_fails(self):
        points = rig_points(200)
        pixels = points.pixels.copy()
        pixels[:, 2] = 0.5 * pixels[:, 0] + 0.1 * pixels[:, 1]
        with pytest.raises(InputError, match="term u_p of model M1"):
            select_models(CalibrationPoints(pixels, points.world))

    def test_epipolar_geometry_is_noticed(self):
        with pytest.raises(InputError, match=r"model M2.*linear combination"):
            select_models(rig_points(500), axes="uv")


def test_deviations_cover_where_noise_differs_over_the_volume():
    # Dots at the ends of a volume are blurred: noise three times as large for a third of the
    # points.  95 % of held-out points within 1.96 predicted deviations, over 20 splits of 900
    # points: 3600 trials, which know the share to 0.4 %; 2 % are five deviations.
    rng = np.random.default_rng(5)
    inputs = rng.uniform(0.0, 1000.0, (900, 4))
    truth = 1e-3 * np.column_stack((inputs[:, 0], inputs[:, 1], inputs[:, 2] - inputs[:, 0]))
    noise = 1e-4 * np.where(np.abs(truth[:, 2:]) > 0.42, 3.0, 1.0)
    points = CalibrationPoints(inputs, truth + noise * rng.standard_normal((900, 3)))
    covered = []
    for seed in range(20):
        found = select_models(points, forms=("M1",), seed=seed)
        held = points.select(found.validation)
        error = np.abs(found.model.predict(held.inputs("u")) - held.world)
        covered.append(error < 1.96 * found.model.predict_std(held.inputs("u")))
    np.testing.assert_allclose(np.mean(covered, axis=(0, 1)), 0.95, atol=0.02)
