"""One world coordinate fitted by one form: what `select_models` does for each, by itself."""

from dataclasses import dataclass

import numpy as np

from slbench.calibration.models.polynomials import Basis, Standardisation, polynomial_form
from slbench.calibration.robust import in_terms, irls


@dataclass
class RobustPolynomial:
    """A polynomial of thesis table 1; the attributes that `fit` sets end in an underscore."""

    form: str = "M3"
    loss: str = "cauchy"
    max_iterations: int = 100
    tolerance: float = 1e-6

    def fit(self, x, y):
        self.form_ = polynomial_form(self.form, "u" if x.shape[1] == 3 else "uv")
        self.standardisation_ = Standardisation.of(x, self.form_.variables)
        basis = Basis.of(self.standardisation_.apply(x), self.form_)
        fit = irls(
            basis.q,
            y,
            loss=self.loss,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
        )
        self.coef_, self.covariance_ = in_terms(basis, fit.coefficients, fit.variance)
        self.raw_coef_ = self.standardisation_.raw_coefficients(self.form_, self.coef_)
        self.residual_std_ = fit.residual_std
        self.weights_, self.residuals_, self.leverage_ = fit.weights, fit.residuals, fit.leverage
        self.n_iter_, self.converged_ = fit.iterations, fit.converged
        return self

    def predict(self, x):
        return self._design(x) @ self.coef_

    def predict_std(self, x):
        """Deviation of a new observation: the model's and the noise."""
        design = self._design(x)
        model = np.einsum("ni,ij,nj->n", design, self.covariance_, design, optimize=True)
        return np.sqrt(np.maximum(model, 0.0) + self.residual_std_**2)

    def _design(self, x):
        return self.form_.design(self.standardisation_.apply(x))
