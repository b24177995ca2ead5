"""Dots of one position of the stage share its error: what that asks of split, error, covariance.

1,020 dots at 66 positions are 66 draws of the stage's error, not 1,020.  A dot left out alone is
predicted by its neighbours, which are off by as much: the error of a model that follows the stage
looks small.  So whole positions are left out.

**Errors of positions left out.**  One Newton step from the M-estimate of all positions to that
without g:  ``e_g = r_g + Q_g (I - Q_g' Q_g)^-1 Q_g' psi_g / mean(psi')``, with the weighted
residuals ``psi = w r`` and Q orthonormal.  For least squares that is exact, the block PRESS
``e_g = (I - H_gg)^-1 r_g`` with ``H_gg = Q_g Q_g'``.  (With the *weights* held fixed instead,
positions that are far off, and have small weights for that, seem to be fitted by the others: the
truly best form is chosen less often, see ``tests/calibration/test_grouped.py``.)

**Choice.**  The smallest form whose PRESS exceeds the least by no more than :data:`MARGIN` standard
errors of the difference, positions being what is independent (the rule of Breiman et al.,
*Classification and Regression Trees*, 1984, 3.4.3, whose margin is one).  With 50 positions and a
stage off by 1.5 um in all axes, the truly best form is chosen in 85, 79 and 86 % of draws (x, y, z)
without a margin, in 93, 92 and 89 % with a half, in 97, 97 and 83 % with one.

**Covariance.**  The sandwich ``B^-1 [sum_g s_g s_g'] B^-1`` of an M-estimate whose errors are
independent from position to position and anyhow within: ``s_g = Q_g' (I - H_gg)^(-1/2) psi_g``
(*CR2*: Bell & McCaffrey, *Survey Methodology* 28, 2002; few clusters have no bias where errors are
alike), ``B = mean(psi') Q'Q``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator

Array = NDArray[np.float64]
Labels = NDArray[np.intp]

#: Fewer positions cannot spare whole ones: neither would be told a model from a stage.
LEAST_POSITIONS = 10
#: Standard errors by which a smaller form may be worse.
MARGIN = 0.5
#: Eigenvalues of ``I - H_gg`` below this: nothing but the position itself determines a term.
_NOTHING = 1e-9


def split_positions(position: Labels, validation: float, seed: int) -> tuple[Labels, Labels]:
    """Split rows into training and validation rows by whole positions, in ascending order.

    Parameters
    ----------
    position : (n,) int
    validation : float
        Share of the positions that validate.
    seed : int

    Raises
    ------
    InputError
        If the share leaves either empty.
    """
    labels = np.unique(position)
    count = round(validation * len(labels))
    if not 0 < count < len(labels):
        expected = "positions enough for training and validation"
        raise InputError("calibration points", expected, len(labels))
    held = np.isin(position, generator(seed).permutation(labels)[:count])
    return np.flatnonzero(~held), np.flatnonzero(held)


class Blocks:
    """The blocks of a basis that belong to the positions.

    Parameters
    ----------
    q : (n, p) float
        Orthonormal columns.
    position : (n,) int
    """

    def __init__(self, q: Array, position: Labels) -> None:
        self.q = q
        order = np.argsort(position, kind="stable")
        ends = np.flatnonzero(np.diff(position[order])) + 1
        self.groups = np.split(order, ends)

    def _scaled(self, values: Array, power: float) -> Array:
        """Return ``(I - H_gg)^power values_g`` of every position, (n, m); infinite where singular.

        ``Q_g = U S V'`` gives the eigenvalues ``1 - S^2`` for the vectors U, 1 for the rest.
        """
        result = values.copy()
        for rows in self.groups:
            u, s, _ = np.linalg.svd(self.q[rows], full_matrices=False)
            left = 1.0 - s**2
            if left.min() < _NOTHING:
                result[rows] = np.inf
                continue
            result[rows] += u @ ((left**power - 1.0)[:, None] * (u.T @ values[rows]))
        return result

    def left_out_errors(self, residuals: Array, weights: Array, slope: float) -> Array:
        """Return the errors (n,) of points predicted by a fit without their position.

        Infinite where the other positions do not determine the fit.

        Parameters
        ----------
        residuals, weights : (n,) float
            Of the fit.
        slope : float
            ``mean(psi')``.
        """
        pull = weights * residuals / slope
        moved = self._scaled(pull[:, None], -1.0)[:, 0] - pull
        return residuals + moved

    def covariance(
        self, pulls: Array, sizes: Sequence[int], precision: Array, slope: float
    ) -> list[Array]:
        """Return the cluster-robust covariance of each response's coefficients, (p_k, p_k).

        Parameters
        ----------
        pulls : (n, m) float
            Residuals times their weights.
        sizes : m int
            How many of the columns of q each response has.
        precision : (m, m) float
            Inverse scatter of the residuals (any multiple of it); for one response, 1.
        slope : float
            ``mean(psi')``.
        """
        scaled = self._scaled(pulls, -0.5)
        # A position that alone determines a term: its own error says nothing of the term's.
        scores = np.where(np.isfinite(scaled), scaled, pulls) @ precision
        parts = [
            np.concatenate([self.q[rows, :p].T @ scores[rows, k] for k, p in enumerate(sizes)])
            for rows in self.groups
        ]
        meat = np.array(parts).T @ np.array(parts)
        information = slope * np.block(
            [
                [precision[j, k] * np.eye(sizes[j], sizes[k]) for k in range(len(sizes))]
                for j in range(len(sizes))
            ]
        )
        half = np.linalg.solve(information, meat)
        whole = np.linalg.solve(information, half.T)
        whole = 0.5 * (whole + whole.T)
        ends = np.cumsum(sizes)
        return [whole[e - s : e, e - s : e] for e, s in zip(ends, sizes, strict=True)]


def smallest_form(errors: Sequence[Array], position: Labels) -> int:
    """Return which form to choose; see the module's docstring.

    Parameters
    ----------
    errors : sequence of (n,) float
        Of points predicted without their position, by form, those of fewer coefficients first.
    position : (n,) int
    """
    _, label = np.unique(position, return_inverse=True)
    sums = np.array([np.bincount(label, e * e) for e in errors])
    least = int(np.argmin(sums.sum(axis=1)))
    for k in np.flatnonzero(np.isfinite(sums[:least]).all(axis=1)).tolist():
        more = sums[k] - sums[least]
        if more.sum() <= MARGIN * len(more) ** 0.5 * np.std(more, ddof=1):
            return int(k)
    return least
