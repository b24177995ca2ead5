"""Covariance of fitted parameters where the errors of points go together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Fewer lines than this do not tell how errors go together.
_MIN_LINES = 5


def along_lines(jacobian: Array, residuals: Array, lines: NDArray[np.integer]) -> Array:
    """Covariance of least-squares coefficients under errors that go together along lines.

    The classical formula takes points as independent.  Sums over whole lines allow for any
    correlation within a line; how the sums go together from line to line is read off their
    cosine transform at the lowest B = 0.4 n^(2/3) frequencies, where errors that persist lie and
    the staircase of the projector's pixels, which alternates and mostly cancels, does not
    (Lazarus, Lewis, Stock and Watson, J. Bus. Econ. Stat. 36, 2018).  Student's t of B degrees of
    freedom widens the result so that 1.96 standard uncertainties cover 95 %.  Each variance is at
    least the classical one.  NaN for fewer than five lines, which cannot tell.
    """
    from scipy.fft import dct
    from scipy.special import stdtrit

    _, line = np.unique(lines, return_inverse=True)
    count, columns = int(line.max()) + 1, jacobian.shape[1]
    bread = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    classical = bread * float(residuals @ residuals) / max(len(residuals) - columns, 1)
    if count == len(residuals):
        return classical
    if count < _MIN_LINES:
        return np.full_like(classical, np.nan)
    scores: Array = np.stack(
        [np.bincount(line, jacobian[:, k] * residuals, count) for k in range(columns)], axis=-1
    )
    told = max(2, round(0.4 * count ** (2.0 / 3.0)))
    slow = dct(scores, axis=0)[1 : told + 1]
    meat = slow.T @ slow / (2.0 * told)
    robust = bread @ meat @ bread * (float(stdtrit(told, 0.975)) / 1.96) ** 2
    raised = np.sqrt(np.maximum(np.diag(classical) / np.maximum(np.diag(robust), 1e-300), 1.0))
    return robust * np.outer(raised, raised)
