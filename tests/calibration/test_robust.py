"""Robust regression: outliers, exact data, covariance against repeats, joint fits."""

import numpy as np
import pytest
from calibration_data import polynomial_data
from robust_polynomial import RobustPolynomial
from scipy.integrate import quad
from scipy.stats import chi, chi2

from slbench.calibration.models.polynomials import Basis, polynomial_form
from slbench.calibration.multivariate import CHI2_MEDIAN_3D, TUNING_3D, joint_irls
from slbench.calibration.robust import (
    CAUCHY_TUNING,
    cauchy_weights,
    checked_response,
    irls,
    robust_scale,
)
from slbench.calibration.scales import gross_points
from slbench.core.errors import InputError


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def efficiency(c, q):
    """Efficiency of the Cauchy estimate of a location in q dimensions, by quadrature."""
    density = chi(q).pdf
    a = quad(lambda d: d**2 / (1 + (d / c) ** 2) ** 2 * density(d), 0, np.inf)[0] / q
    b = quad(
        lambda d: (
            (1 / (1 + (d / c) ** 2) - 2 / q * (d / c) ** 2 / (1 + (d / c) ** 2) ** 2) * density(d)
        ),
        0,
        np.inf,
    )[0]
    return b * b / a


def test_constants():
    assert efficiency(CAUCHY_TUNING, 1) == pytest.approx(0.95, abs=1e-5)  # four digits
    assert efficiency(TUNING_3D, 3) == pytest.approx(0.95, abs=1e-7)
    assert pytest.approx(chi2(3).median(), abs=1e-7) == CHI2_MEDIAN_3D


def test_scale_is_that_of_normal_noise():
    r = 3.0 * np.random.default_rng(0).normal(size=200_000)
    # Standard error of the scale is 1.17 / sqrt(n) = 0.26 %; 1.2 % is 4.5 of it (7e-6).
    assert robust_scale(r, 20) == pytest.approx(3.0, rel=0.012)
    assert robust_scale(np.array([-4.0, 0.0, 1.0, 2.0]), 2) == 2.0 / 0.6745
    assert robust_scale(np.array([-4.0, 1.0, 2.0]), 1) == 2.0 / 0.6745


class TestGrossPoints:
    def test_beyond_eight_deviations_alone(self):
        r = np.random.default_rng(3).normal(size=20_000)  # beyond eight: one in 1e15
        assert not gross_points(r, np.zeros(20_000), r, 1).any()
        # The scale is known to 0.9 % here (1.17 / sqrt(n)): bounds at 5 % on both sides.
        r[:4] = 7.6, -7.6, 8.4, -8.4
        found = gross_points(r, np.zeros(20_000), r, 1)
        np.testing.assert_array_equal(np.flatnonzero(found), [2, 3])

    def test_leverage_shrinks_the_residual_and_not_the_bound(self):
        r = np.random.default_rng(3).normal(size=20_000)
        leverage = np.zeros(20_000)
        leverage[:3] = 0.96, 0.96, 1.0
        # The first two have residuals of 0.2 deviations: 1.4 is seven of them, 2 is ten.
        r[:3] = 1.4, 2.0, 100.0
        found = gross_points(r, leverage, r, 1)
        np.testing.assert_array_equal(np.flatnonzero(found), [1])

    def test_rounding_is_not_gross(self):
        r = np.zeros(100)
        r[0] = 2e-16
        assert not gross_points(r, np.zeros(100), np.ones(100), 1).any()
        r[0] = 1e-12  # 8 times 16 ulps are 2.8e-14
        assert gross_points(r, np.zeros(100), np.ones(100), 1)[0]


def test_a_singular_problem_is_bad_input():
    q = np.linalg.qr(np.random.default_rng(0).normal(size=(50, 4)))[0]
    q[:, 3] = 0.0
    y = np.random.default_rng(1).normal(size=(50, 3))
    with pytest.raises(InputError, match=r"robust fit of 4 coefficients.*got 50 points"):
        irls(q, y[:, 0])
    with pytest.raises(InputError, match=r"robust fit of 4 coefficients.*got 50 points"):
        joint_irls(q, y, (4, 4, 4))


def test_outliers_barely_move_the_robust_fit():
    """5 % outliers of 20 sigma: within 10 % of the clean fit, and least squares is not."""
    sigma, errors = 0.01, []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        x, _, y = polynomial_data("M3", 200, sigma, rng)
        new, _, y_new = polynomial_data("M3", 2000, sigma, rng)
        dirty = y.copy()
        dirty[:10] += 20 * sigma * rng.choice([-1, 1], 10)
        fits = [
            RobustPolynomial("M3", "least-squares").fit(x, y),
            RobustPolynomial("M3").fit(x, dirty),
            RobustPolynomial("M3", "least-squares").fit(x, dirty),
        ]
        assert fits[1].converged_
        errors.append([rms(fit.predict(new) - y_new) for fit in fits])
    clean, robust, plain = np.mean(errors, axis=0)
    assert robust < 1.10 * clean
    assert plain > 1.30 * clean
    assert robust > clean  # 95 % efficiency has its price; were it not so, all would be one fit


def test_outliers_get_small_weights():
    rng = np.random.default_rng(4)
    x, _, y = polynomial_data("M2", 500, 0.01, rng)
    y[:25] += 0.2
    fit = RobustPolynomial("M2").fit(x, y)
    # 20 sigma: 1 / (1 + (20 / 2.385)^2) = 0.014, noise of some sigma about it.
    assert fit.weights_[:25].max() < 0.03
    assert np.median(fit.weights_[25:]) > 0.85
    np.testing.assert_allclose(
        fit.weights_, cauchy_weights(fit.residuals_, fit.residual_std_), rtol=1e-4
    )


def test_least_squares_is_numpys():
    x, _, y = polynomial_data("M4", 300, 0.1, np.random.default_rng(5))
    design = polynomial_form("M4").design((x - 1000) / 700)
    expected = design @ np.linalg.lstsq(design, y)[0]
    fit = RobustPolynomial("M4", "least-squares").fit(x, y)
    np.testing.assert_allclose(fit.predict(x), expected, atol=1e-11)  # values of order 10


def test_robust_solution_is_the_stationary_point():
    """The weighted normal equations hold with the weights of the solution itself."""
    x, _, y = polynomial_data("M3", 400, 0.1, np.random.default_rng(6))
    basis = Basis.of((x - 1000) / 700, polynomial_form("M3"))
    fit = irls(basis.q, y)
    weights = cauchy_weights(fit.residuals, robust_scale(fit.residuals, 10))
    # Converged to 1e-6 of the noise in fitted values: times sqrt(n) in the basis.
    assert np.linalg.norm(basis.q.T @ (weights * fit.residuals)) < 1e-6 * 0.1 * 20


@pytest.mark.parametrize("loss", ["cauchy", "least-squares"])
def test_exact_data(loss):
    x, truth, _ = polynomial_data("M3", 100, 0.0, np.random.default_rng(7))
    fit = RobustPolynomial("M3", loss).fit(x, truth)
    assert fit.converged_
    np.testing.assert_allclose(fit.predict(x), truth, atol=1e-12)  # values of order 10
    assert 0 <= fit.residual_std_ < 1e-13
    assert np.all(np.isfinite(fit.predict_std(x)))


def test_exact_data_with_outliers():
    x, truth, _ = polynomial_data("M3", 100, 0.0, np.random.default_rng(8))
    y = truth.copy()
    y[:8] += np.linspace(1, 5, 8)
    fit = RobustPolynomial("M3").fit(x, y)
    assert fit.converged_
    np.testing.assert_allclose(fit.predict(x), truth, atol=1e-10)


def test_a_fit_cut_short_says_so():
    x, _, y = polynomial_data("M3", 100, 0.1, np.random.default_rng(9))
    fit = RobustPolynomial("M3", max_iterations=1).fit(x, y)
    assert not fit.converged_
    assert fit.n_iter_ == 1
    assert RobustPolynomial("M3").fit(x, y).converged_


@pytest.mark.parametrize("repeats", [40, pytest.param(200, marks=pytest.mark.statistics)])
@pytest.mark.parametrize("loss", ["cauchy", "least-squares"])
def test_covariance_is_that_of_repeats(loss, repeats):
    """Coefficients of many repeats scatter as predicted.

    A variance of n repeats is the true one times chi-squared of n - 1 over n - 1: all ten within
    its quantiles, with a false alarm of 1e-4 in all.
    """
    rng = np.random.default_rng(10)
    x, truth, _ = polynomial_data("M3", 150, 0.0, rng)
    fits = [
        RobustPolynomial("M3", loss).fit(x, truth + 0.1 * rng.normal(size=150))
        for _ in range(repeats)
    ]
    found = np.var([fit.coef_ for fit in fits], axis=0, ddof=1)
    predicted = np.mean([np.diag(fit.covariance_) for fit in fits], axis=0)
    low, high = chi2(repeats - 1).ppf([5e-6, 1.0 - 5e-6]) / (repeats - 1)
    assert np.all((low < found / predicted) & (found / predicted < high))


@pytest.mark.parametrize(
    ("form", "n"),
    [
        ("M4", 20_000),
        pytest.param("M3", 60, marks=pytest.mark.statistics),
        pytest.param("M4", 60, marks=pytest.mark.statistics),
    ],
)
def test_predicted_deviation_covers(form, n):
    """95 % of new observations lie within 1.96 predicted deviations, +/- 2 %.

    5000 or more independent observations: the standard error of the share is 0.3 %, so 2 % is
    6.5 of it.  With 60 points the deviation itself is uncertain by some 15 %, which the many
    repeats average over.
    """
    rng = np.random.default_rng(11)
    inside = []
    for _ in range(1 if n > 1000 else 60):
        x, _, y = polynomial_data(form, n, 0.1, rng)
        new, _, y_new = polynomial_data(form, 5000 if n > 1000 else 100, 0.1, rng)
        fit = RobustPolynomial(form).fit(x, y)
        inside.append(np.mean(np.abs(y_new - fit.predict(new)) < 1.96 * fit.predict_std(new)))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("y", [np.ones(200), np.ones(3), np.full(200, np.nan), "abc"])
def test_bad_responses(y):
    with pytest.raises(InputError, match="z_mm"):
        checked_response(y, 200, "z_mm")


class TestJointFit:
    sizes = (10, 10, 10)

    def data(self, seed, n=200, correlation=0.0, sigma=0.1):
        rng = np.random.default_rng(seed)
        x, truth, _ = polynomial_data("M3", n, 0.0, rng)
        basis = Basis.of((x - 1000) / 700, polynomial_form("M3"))
        covariance = np.full((3, 3), correlation) + (1 - correlation) * np.eye(3)
        noise = sigma * rng.multivariate_normal(np.zeros(3), covariance, n)
        return rng, basis.q, np.stack([truth, 2 * truth, -truth], axis=1), noise

    def test_same_terms_without_outliers_are_separate_fits(self):
        _, q, truth, noise = self.data(0, correlation=0.9)
        joint = joint_irls(q, truth + noise, self.sizes, loss="least-squares")
        for k in range(3):
            alone = irls(q, (truth + noise)[:, k], loss="least-squares")
            # Kruskal's identity: equal but for rounding of values of order 100 in the basis.
            np.testing.assert_allclose(joint.coefficients[k], alone.coefficients, atol=1e-11)
            std = joint.scatter[k, k] ** 0.5
            assert std == pytest.approx(alone.residual_std, rel=1e-9)

    def test_the_general_solution_is_that_of_generalised_least_squares(self):
        """Against the textbook's Kronecker form, with the scatter matrix that was found."""
        _, q, _, y = self.data(1, correlation=0.9)
        sizes = (4, 7, 10)
        joint = joint_irls(q, y, sizes, loss="least-squares", tolerance=1e-10)
        scatter = joint.residuals.T @ joint.residuals / len(q)
        inverse = np.kron(np.linalg.inv(scatter), np.eye(len(q)))
        blocks = np.zeros((3 * len(q), sum(sizes)))
        start = 0
        for k, size in enumerate(sizes):
            blocks[k * len(q) : (k + 1) * len(q), start : start + size] = q[:, :size]
            start += size
        expected = np.linalg.solve(blocks.T @ inverse @ blocks, blocks.T @ inverse @ y.T.ravel())
        np.testing.assert_allclose(np.concatenate(joint.coefficients), expected, atol=1e-9)

    @pytest.mark.statistics
    def test_different_terms_gain_from_correlated_residuals(self):
        """The response with more terms borrows from those with fewer (Zellner)."""
        sizes, alone, together = (4, 4, 10), [], []
        for seed in range(60):
            _, q, _, noise = self.data(seed, n=60, correlation=0.95)
            joint = joint_irls(q, noise, sizes, loss="least-squares")
            alone.append(np.sum((q.T @ noise[:, 2]) ** 2))
            together.append(np.sum(joint.coefficients[2] ** 2))
        # Six of ten coefficients lose 1 - R^2 = 7 % .. of their variance: to 4.4 / 10 and some
        # for the scatter matrix's own noise.  0.7 is far from both.
        assert np.mean(together) < 0.7 * np.mean(alone)

    @pytest.mark.parametrize("seeds", [5, pytest.param(20, marks=pytest.mark.statistics)])
    def test_vector_outliers_stand_out_against_the_correlation(self, seeds):
        alone, together = [], []
        for seed in range(seeds):
            rng, q, truth, noise = self.data(seed, correlation=0.98)
            y = truth + noise
            rows = rng.permutation(len(q))[:30]
            # 2.5 sigma in x against z: common in each, 18 sigma along the smallest axis.
            y[rows] += np.array([0.25, 0.0, -0.25])
            joint = joint_irls(q, y, self.sizes)
            exact = q.T @ truth
            together.append(np.sum((np.stack(joint.coefficients, axis=1) - exact) ** 2))
            separate = np.stack([irls(q, y[:, k]).coefficients for k in range(3)], axis=1)
            alone.append(np.sum((separate - exact) ** 2))
            assert joint.converged
        # Single ratios are 0.63 and scatter by 0.11: the mean of five by 0.05.
        assert np.mean(together) < 0.8 * np.mean(alone)

    def test_clean_fit_agrees_within_its_noise(self):
        _, q, truth, noise = self.data(3)
        joint = joint_irls(q, truth + noise, self.sizes)
        for k in range(3):
            error = joint.coefficients[k] - q.T @ truth[:, k]
            d2 = error @ np.linalg.solve(joint.covariance[k], error)
            assert d2 < chi2(10).ppf(1 - 1e-4)  # false alarm 3e-4 for the three

    def test_exact_data(self):
        _, q, truth, _ = self.data(4)
        joint = joint_irls(q, truth, (10, 10, 10))
        assert joint.converged
        for k in range(3):
            np.testing.assert_allclose(joint.coefficients[k], q.T @ truth[:, k], atol=1e-11)
