"""Polynomial forms: table 1, gradients, standardisation, and what cannot be fitted."""

import numpy as np
import pytest
from calibration_data import polynomial_data
from robust_polynomial import RobustPolynomial

from slbench.calibration.models.polynomials import (
    FORMS,
    Basis,
    Standardisation,
    checked_inputs,
    polynomial_form,
)
from slbench.core.errors import InputError

RNG = np.random.default_rng(1)
UNIT = RNG.uniform(-1, 1, (50, 3))


def test_table_1():
    sizes = [len(polynomial_form(name)) for name in FORMS]
    assert sizes == [4, 7, 10, 20]
    # In the table's own order.
    assert polynomial_form("M4").terms == (
        *("1", "u_c", "v_c", "u_p", "u_c v_c", "v_c u_p", "u_c u_p", "u_c^2", "v_c^2", "u_p^2"),
        *("u_c^2 v_c", "u_c v_c^2", "v_c^2 u_p", "v_c u_p^2", "u_c^2 u_p", "u_c u_p^2"),
        *("u_c v_c u_p", "u_c^3", "v_c^3", "u_p^3"),
    )


def test_both_panel_axes_give_every_monomial_up_to_the_degree():
    # Monomials of degree <= d in four variables: (d + 4 over 4).
    sizes = [len(polynomial_form(name, "uv")) for name in FORMS]
    assert sizes == [5, 5 + 6, 15, 35]
    assert len(set(polynomial_form("M4", "uv").exponents)) == 35


@pytest.mark.parametrize("axes", ["u", "uv"])
def test_forms_are_nested(axes):
    widest = polynomial_form("M4", axes).exponents
    for name in FORMS:
        own = polynomial_form(name, axes).exponents
        assert widest[: len(own)] == own


def test_design_holds_the_monomials():
    form = polynomial_form("M4", "uv")
    x = RNG.uniform(-1, 1, (20, 4))
    expected = np.prod(x[:, None, :] ** np.array(form.exponents), axis=2)
    np.testing.assert_allclose(form.design(x), expected, rtol=1e-14)  # three products


@pytest.mark.parametrize("name", FORMS)
def test_derivatives(name):
    form = polynomial_form(name)
    coefficients = RNG.normal(size=(len(form), 2))
    found = form.derivatives(coefficients)
    step = 1e-5
    for j in range(3):
        shift = step * np.eye(3)[j]
        change = form.design(UNIT + shift) @ coefficients - form.design(UNIT - shift) @ coefficients
        # Third derivatives of order 10 times step^2, and rounding over step: 1e-9.
        np.testing.assert_allclose(form.design(UNIT) @ found[j], change / (2 * step), atol=1e-8)
    np.testing.assert_array_equal(form.derivatives(coefficients[:, 0]), found[..., 0])


@pytest.mark.parametrize("axes", ["u", "uv"])
@pytest.mark.parametrize("name", FORMS)
def test_steps_make_the_terms(name, axes):
    form = polynomial_form(name, axes)
    made = np.zeros((len(form), len(form.variables)), dtype=int)
    for i, (before, factor) in enumerate(form.steps()[1:], 1):
        assert before < i
        made[i] = made[before]
        made[i, factor] += 1
    np.testing.assert_array_equal(made, form.exponents)


@pytest.mark.parametrize("name", FORMS)
def test_standardisation_does_not_change_predictions(name):
    """Any affine change of the inputs' units spans the same polynomials."""
    pixels, _, y = polynomial_data("M4", 200, 0.1, np.random.default_rng(2))
    other = pixels * [0.01, 25.0, -3.0] + [7.0, -900.0, 12.0]
    fits = [RobustPolynomial(name).fit(x, y).predict(x) for x in (pixels, other)]
    # Responses of order 10; two QR solutions of condition some 100.
    np.testing.assert_allclose(fits[0], fits[1], atol=1e-11)
    unscaled, *_ = np.linalg.lstsq(polynomial_form(name).design(pixels), y)
    plain = RobustPolynomial(name, loss="least-squares").fit(pixels, y)
    # Raw monomials up to 1e9: the condition 1e11 leaves five digits of the reference.
    np.testing.assert_allclose(
        plain.predict(pixels), polynomial_form(name).design(pixels) @ unscaled, atol=1e-4
    )


@pytest.mark.parametrize("axes", ["u", "uv"])
@pytest.mark.parametrize("name", FORMS)
def test_coefficients_in_pixels_are_the_same_polynomial(name, axes):
    pixels, _, y = polynomial_data(name, 300, 0.1, np.random.default_rng(3), axes)
    fit = RobustPolynomial(name).fit(pixels, y)
    raw = fit.form_.design(pixels) @ fit.raw_coef_
    # Terms of some 1e4 cancel to order 1: 1e-16 * 1e4, with a margin.
    np.testing.assert_allclose(raw, fit.predict(pixels), atol=1e-9)


def test_basis_is_orthonormal_and_gives_the_design_back():
    form = polynomial_form("M4")
    basis = Basis.of(UNIT, form)
    np.testing.assert_allclose(basis.q.T @ basis.q, np.eye(20), atol=1e-13)
    np.testing.assert_allclose(basis.q @ basis.r, form.design(UNIT), atol=1e-13)
    part = basis.leading(polynomial_form("M2"))
    np.testing.assert_allclose(part.q @ part.r, polynomial_form("M2").design(UNIT), atol=1e-13)


class TestWhatCannotBeFitted:
    def test_points_in_one_plane_name_the_term(self):
        flat = UNIT.copy()
        flat[:, 2] = 0.3 * flat[:, 0] - 0.2 * flat[:, 1] + 0.1
        with pytest.raises(InputError, match=r"term u_p of model M1.*linear combination"):
            Basis.of(flat, polynomial_form("M1"))

    def test_nine_digits_do_not_hide_it(self):
        flat = 1000 + 700 * UNIT
        flat[:, 2] = [float(f"{0.3 * u - 0.2 * v + 50:.9g}") for u, v in flat[:, :2]]
        with pytest.raises(InputError, match="term u_p"):
            RobustPolynomial("M1").fit(flat, UNIT[:, 0])

    def test_two_values_of_an_input_have_no_square(self):
        two = UNIT.copy()
        two[:, 1] = np.sign(two[:, 1])
        with pytest.raises(InputError, match=r"term v_c\^2 of model M3"):
            Basis.of(two, polynomial_form("M3"))

    @pytest.mark.parametrize("name", FORMS)
    def test_too_few_points(self, name):
        form = polynomial_form(name)
        with pytest.raises(
            InputError, match=f"at least {len(form) + 1} different points.*last term"
        ):
            Basis.of(UNIT[: len(form)], form)

    def test_a_constant_column(self):
        same = UNIT.copy()
        same[:, 1] = 4.5
        with pytest.raises(InputError, match=r"v_c.*differ.*4\.5"):
            Standardisation.of(same, ("u_c", "v_c", "u_p"))

    @pytest.mark.parametrize(
        "wrong",
        [
            np.ones(3),
            np.ones((5, 2)),
            np.ones((0, 3)),
            [[1.0, 2.0, np.nan]],
            [[1.0, np.inf, 2.0]],
            "abc",
            [[1, 2], [3]],
        ],
    )
    def test_wrong_inputs(self, wrong):
        with pytest.raises(InputError):
            checked_inputs(wrong)

    def test_unknown_names(self):
        with pytest.raises(InputError, match="M5"):
            polynomial_form("M5")
        with pytest.raises(InputError, match="u or uv"):
            polynomial_form("M1", "v")
