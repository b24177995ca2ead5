"""The evaluation of a calibration model: all that is asked of a point, in one compiled pass.

A model's polynomials, their derivatives and the variance that its coefficients carry to a point
need the same monomials.  Points are taken in blocks that stay in the cache: their
inputs are standardised, each monomial is the product of one before it and an input
(:class:`~slbench.calibration.models.polynomials.PolynomialForm` has the divisors of a term before
it), and only what was asked for is written.  No array of all points and all terms is made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

#: Points of a block: 35 terms of them fill half of a first-level cache.
_BLOCK = 64

#: What stands for an output that is not asked for.
_NO_VECTORS = np.empty((0, 0))
_NO_DERIVATIVES = np.empty((0, 0, 0))


@dataclass(frozen=True, eq=False)
class Recipe:
    """What the compiled pass is told of a model; m coordinates, p terms, k inputs.

    Parameters
    ----------
    mean, scale : (k,) float
        Standardisation of the inputs.
    steps : (p, 2) int
        Each term as the product of an earlier one and an input; the first is the constant.
    coefficients : (p, m) float
    covariances : (m, p, p) float
        Symmetric; zero for terms that a coordinate does not have.
    residual_variances : (m,) float
    slopes : (k, p, m) float
        Coefficients of the derivatives by the inputs in their own unit.
    """

    mean: Array
    scale: Array
    steps: Whole
    coefficients: Array
    covariances: Array
    residual_variances: Array
    slopes: Array

    def run(
        self,
        inputs: Array,
        points: Array = _NO_VECTORS,
        std: Array = _NO_VECTORS,
        derivatives: Array = _NO_DERIVATIVES,
    ) -> None:
        """Fill what is given of the outputs at inputs (n, k).

        Parameters
        ----------
        inputs : (n, k) float
        points : (n, m) float
        std : (n, m) float
            Standard deviation of a new observation.
        derivatives : (n, j, m) float
            By the last j of the inputs.
        """
        _evaluate(
            np.ascontiguousarray(inputs),
            self.mean,
            self.scale,
            self.steps,
            self.coefficients,
            self.covariances,
            self.residual_variances,
            self.slopes,
            points,
            std,
            derivatives,
            4 * get_num_threads(),
        )


@njit(cache=True, parallel=True, nogil=True, fastmath={"contract"})
def _evaluate(  # type: ignore[no-untyped-def]
    inputs, mean, scale, steps, coefficients, covariances, residual_variances, slopes,
    points, std, derivatives, workers,
):  # fmt: skip
    n, size = inputs.shape
    terms_count, outputs = coefficients.shape
    blocks = (n + _BLOCK - 1) // _BLOCK
    for worker in prange(workers):
        x = np.empty((size, _BLOCK))
        terms = np.ones((terms_count, _BLOCK))
        total = np.empty(_BLOCK)
        inner = np.empty(_BLOCK)
        for block in range(worker * blocks // workers, (worker + 1) * blocks // workers):
            first = block * _BLOCK
            count = min(_BLOCK, n - first)
            _standardise(inputs[first : first + count], mean, scale, x)
            for t in range(1, terms_count):
                before, factor, term = terms[steps[t, 0]], x[steps[t, 1]], terms[t]
                for i in range(_BLOCK):
                    term[i] = before[i] * factor[i]
            if len(points):
                for k in range(outputs):
                    _combine(terms, coefficients, k, total)
                    for i in range(count):
                        points[first + i, k] = total[i]
            if len(derivatives):
                wanted = derivatives.shape[1]
                for j in range(wanted):
                    for k in range(outputs):
                        _combine(terms, slopes[size - wanted + j], k, total)
                        for i in range(count):
                            derivatives[first + i, j, k] = total[i]
            if len(std):
                for k in range(outputs):
                    _quadratic(terms, covariances[k], total, inner)
                    for i in range(count):
                        variance = max(total[i], 0.0) + residual_variances[k]
                        std[first + i, k] = np.sqrt(variance)


@njit(cache=True, nogil=True)
def _standardise(inputs, mean, scale, x):  # type: ignore[no-untyped-def]
    """Standardise a block's inputs (count, k) into x (k, block); the rest is zero."""
    count, size = inputs.shape
    for j in range(size):
        for i in range(count):
            x[j, i] = (inputs[i, j] - mean[j]) / scale[j]
        for i in range(count, _BLOCK):
            x[j, i] = 0.0


@njit(cache=True, nogil=True, fastmath={"contract"})
def _combine(terms, table, k, total):  # type: ignore[no-untyped-def]
    """Sum a block's terms by column k of a table of coefficients, most of them zero perhaps."""
    total[:] = 0.0
    for t in range(len(terms)):
        value = table[t, k]
        if value != 0.0:
            term = terms[t]
            for i in range(_BLOCK):
                total[i] += value * term[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _quadratic(terms, matrix, total, inner):  # type: ignore[no-untyped-def]
    """Sum ``t M t`` of a block's terms and a symmetric matrix, by its upper triangle."""
    total[:] = 0.0
    size = len(terms)
    for r in range(size):
        row, own = matrix[r], terms[r]
        value = row[r]
        for i in range(_BLOCK):
            inner[i] = value * own[i]
        c = r + 1
        # Four at a time: what is summed is loaded and stored once for them.
        while c + 4 <= size:
            a, b, d, e = 2.0 * row[c], 2.0 * row[c + 1], 2.0 * row[c + 2], 2.0 * row[c + 3]
            ta, tb, td, te = terms[c], terms[c + 1], terms[c + 2], terms[c + 3]
            for i in range(_BLOCK):
                inner[i] += a * ta[i] + b * tb[i] + d * td[i] + e * te[i]
            c += 4
        while c < size:
            value, term = 2.0 * row[c], terms[c]
            for i in range(_BLOCK):
                inner[i] += value * term[i]
            c += 1
        for i in range(_BLOCK):
            total[i] += inner[i] * own[i]
