"""Points that fit together: least trimmed squares of the three world coordinates.

**Why a start of its own.**  A wrong fringe order is an error of an *input*.  Such a point has
leverage: least squares bends towards it, and weights that begin with the residuals of least
squares (:mod:`~slbench.calibration.robust`) never learn of it.  Half of the points chosen well
cannot be bent.

**Criterion.**  Of all subsets of ``h = (n + p + 3) // 2`` points, the one whose least-squares
residuals have the smallest determinant of their 3 x 3 scatter: multivariate least trimmed squares
(Agulló, Croux & Van Aelst, *J. Multivariate Anal.* 99, 2008).  A wrong order spoils X, Y and Z of
its point together, and is judged by all three.  Up to ``n - h`` wrong points, ``(n - p) / 2`` or
so, cannot carry the optimum away.

**Search.**  A *concentration step* fits the subset and takes the h points that are nearest to the
fit, by the Mahalanobis distance of their residuals; no step raises the determinant (Rousseeuw &
Van Driessen, 2006).  Of random subsets of 20 points, 1 % are free of 20 % wrong ones, so starts are
deterministic, by two ways around the leverage:

- *backwards*: pixels as polynomials of the world coordinates.  There a wrong order is an error of
  the response, and the design knows nothing of it;
- *forwards*: world coordinates as polynomials of the pixels, which is the same for points whose
  world coordinates are wrong (a slip of the stage, a dot numbered wrongly).

Both climb from first to third degree with concentration at each: few coefficients cannot bend
to single points, and what a low degree misses is little beside a whole period.  Every start is
concentrated a little forwards at full degree, the best few to the end, and the least determinant
wins.  Of many points a part is searched, and what it finds is concentrated on all.

**What it withstands** (measured, ``tests/calibration/test_breakdown.py``): 20 % wrong orders of one
period, all in one direction too, all in one corner, or all at one end of the heights; 30 % where
they are scattered.  Fewer different points than twice the coefficients are not trimmed: a fit
through half of them tells nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.polynomials import Basis, count_different, cubic
from slbench.calibration.scales import gross_points, rounding
from slbench.core.random import generator

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Concentration steps at a degree on the way up, of every start, and of the best few.
_CLIMB, _SHORT, _FULL = 4, 3, 30
_FEW = 3
#: Points that are searched, of more.
_SEARCHED = 2000
#: Rounds in which rejected points may come back.
_ROUNDS = 30
#: Directions of a subset's design below this share of the largest are not determined by it.
_RANK = 1e-10


def trimmed_size(n: int, coefficients: int) -> int:
    """Return how many of n points the criterion is of, h; see the module's docstring."""
    return min(n, (n + coefficients + 3) // 2)


def consistent(basis: Basis, standardised: Array, world: Array) -> Mask:
    """Return which points fit together.

    The points of the best trimmed fit, and all that are within
    :data:`~slbench.calibration.scales.GROSS` robust deviations of a fit of those that are in, in
    every coordinate.  Without wrong points that is all of them, so that trimming costs right
    points nothing.

    Parameters
    ----------
    basis : Basis
        Of the widest model over all points.
    standardised : (n, k) float
        Inputs.
    world : (n, 3) float

    Returns
    -------
    (n,) bool
    """
    n, p = basis.q.shape
    inside = np.ones(n, dtype=np.bool_)
    if trimmed_size(n, p) >= n or count_different(standardised, 2 * p) < 2 * p:
        return inside
    rows = np.arange(n)
    if n > max(_SEARCHED, 10 * p):
        rows = np.sort(generator(0).permutation(n)[: max(_SEARCHED, 10 * p)])
    q, y = np.ascontiguousarray(basis.q[rows]), world[rows]
    short = [
        _concentrate(q, y, start, _SHORT)
        for start in _starts(basis.form.exponents, q, standardised[rows], y)
    ]
    short.sort(key=lambda found: found[1])
    subset = min((_concentrate(q, y, s, _FULL) for s, _ in short[:_FEW]), key=lambda f: f[1])[0]
    if len(rows) < n:
        inside[:] = False
        inside[rows[subset]] = True
        subset = _concentrate(basis.q, world, inside, _FULL)[0]
    return _grown(basis.q, world, subset)


def _starts(
    powers: Sequence[tuple[int, ...]], q: Array, standardised: Array, world: Array
) -> Iterator[Mask]:
    """Yield subsets to concentrate: backwards and forwards through the degrees."""
    n = len(world)
    degrees = np.array([sum(term) for term in powers])
    forwards = (
        [int(np.sum(degrees <= d)) for d in range(1, degrees[-1] + 1)]
        if np.all(np.diff(degrees) >= 0)
        else [len(degrees)]
    )
    yield from _climb(q, forwards, world)
    middle, spread = world.mean(axis=0), world.std(axis=0)
    place = (world - middle) / np.where(spread > 0, spread, 1.0)
    exponents = np.array(cubic(3))
    design = np.prod(place[:, None, :] ** exponents, axis=2)
    # Points of few heights do not determine all terms: an orthonormal basis of what they do.
    backwards = [k for k in (4, 10, 20) if 2 * k < n]
    terms = _orthonormal(design[:, : backwards[-1]])
    yield from _climb(terms, backwards, standardised)
    yield from _climb(terms, backwards, standardised[:, 2:])


def _climb(q: Array, sizes: Sequence[int], y: Array) -> Iterator[Mask]:
    """Concentrate with more and more columns; yield the subset of every stage."""
    subset = np.ones(len(q), dtype=np.bool_)
    for size in sizes:
        subset, _ = _concentrate(q[:, :size], y, subset, _CLIMB)
        yield subset


def _concentrate(q: Array, y: Array, subset: Mask, steps: int) -> tuple[Mask, float]:
    """Take concentration steps; return the subset and its log determinant."""
    h = trimmed_size(*q.shape)
    size = np.inf
    for _ in range(steps):
        residuals = y - q @ _solution(q, y, subset)
        distance2, size = _distances(residuals, subset, y)
        new = np.zeros(len(q), dtype=np.bool_)
        new[np.argpartition(distance2, h - 1)[:h]] = True
        if np.array_equal(new, subset):
            break
        subset = new
    return subset, size


def _solution(q: Array, y: Array, subset: Mask) -> Array:
    """Return the least-squares coefficients of a subset, the shortest where it leaves a choice."""
    return _inverse(q[subset]) @ (q[subset].T @ y[subset])


def _inverse(q: Array) -> Array:
    """Return the pseudo-inverse of ``q' q``, (p, p)."""
    values, vectors = np.linalg.eigh(q.T @ q)
    good = values > _RANK * values[-1]
    return (vectors[:, good] / values[good]) @ vectors[:, good].T


def _distances(residuals: Array, subset: Mask, y: Array) -> tuple[Array, float]:
    """Return squared Mahalanobis distances (n,) and the log determinant of the scatter."""
    some = residuals[subset]
    scatter = some.T @ some / len(some)
    # Exact data: nothing but rounding, which must not decide.
    floor = np.array([rounding(column) for column in y.T])
    scatter += np.diag(floor**2 + 1e-12 * np.diag(scatter))
    root = np.linalg.cholesky(scatter)
    whitened = np.linalg.solve(root, residuals.T)
    return np.einsum("ij,ij->j", whitened, whitened), float(2.0 * np.sum(np.log(np.diag(root))))


def _grown(q: Array, y: Array, inside: Mask) -> Mask:
    """Take in all points that are predicted, and drop what is no longer.

    The error of a point that is in has the variance ``1 - h`` of the noise, that of one that is
    not ``1 + h``, with its leverage h of the fit.
    """
    p = q.shape[1]
    for _ in range(_ROUNDS):
        inverse = _inverse(q[inside])
        residuals = y - q @ (inverse @ (q[inside].T @ y[inside]))
        leverage = np.einsum("ij,jk,ik->i", q, inverse, q, optimize=True)
        signed = np.where(inside, np.minimum(leverage, 1.0), -leverage)
        new = np.ones(len(q), dtype=np.bool_)
        for k, column in enumerate(y.T):
            new &= ~gross_points(residuals[:, k], signed, column, p)
        if np.array_equal(new, inside):
            break
        inside = new
    return inside


def _orthonormal(design: Array) -> Array:
    """Return the design's columns made orthonormal in turn; zeros for those that depend."""
    q, r = np.linalg.qr(design)
    norms = np.linalg.norm(design, axis=0)
    return np.where(np.abs(np.diag(r)) > 1e-8 * norms, q, 0.0)
