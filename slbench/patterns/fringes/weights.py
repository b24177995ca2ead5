"""How the frames of a fringe set are weighed: least squares for any list of shifts.

The frames I_k = a + b cos(phi - e_k) are linear in (a, b cos phi, b sin phi).  Least squares gives
each of the three as a weighted sum of the frames; for N equal steps the weights are 1, 2 cos e_k
and 2 sin e_k over N, and the sums those of :mod:`slbench.patterns.phase`.

Noise.  The phase error is sum dI_k f_k / b with f_k = s_k cos phi - c_k sin phi, where c_k and s_k
are the weights of b cos phi and b sin phi.  For independent noise of variance alpha + beta I,

    var phi = [(alpha + beta a) sum f_k^2 + beta b sum f_k^2 cos(phi - e_k)] / b^2,

a quadratic and a cubic form in cos phi and sin phi.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slbench.patterns.base import FloatArray
from slbench.patterns.phase import frame_weights


def set_weights(steps: Sequence[FloatArray]) -> FloatArray:
    """Return the weights of b cos phi and b sin phi of S sets, (S, K, 2), times N / 2.

    K is the largest number of frames rounded up to a multiple of four; rows beyond a set's own are
    zero.
    """
    weights = np.zeros((len(steps), -4 * (-max(len(one) for one in steps) // 4), 2))
    for rows, one in zip(weights, steps, strict=True):
        rows[: len(one)] = frame_weights(one)[:, :2]
    return weights


def tilts(steps: Sequence[FloatArray]) -> FloatArray:
    """Return what of both components, as weighed, the plain sum of a set's frames has, (S, 2).

    Zero for steps of a whole turn; the rest of the sum is N times the mean.
    """
    sums = np.array([(np.cos(one).sum(), np.sin(one).sum()) for one in steps])
    counts = np.array([len(one) for one in steps], dtype=np.float64)[:, np.newaxis]
    return np.where(np.abs(sums) < 1e-9 * counts, 0.0, 2.0 / counts * sums)


def fit_weights(steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights of b cos phi, b sin phi and the mean, (N, 3), and what the fit shows.

    The latter, (N, 2), is what frames have of the first two: cos e_k and sin e_k.
    """
    design = fit_design(steps)
    return np.ascontiguousarray(np.linalg.pinv(design).T), np.ascontiguousarray(design[:, :2])


def fit_design(steps: FloatArray) -> FloatArray:
    """Return what frames have of b cos phi, b sin phi and the mean, (N, 3)."""
    return np.stack([np.cos(steps), np.sin(steps), np.ones(len(steps))], axis=1)


def noise_forms(steps: FloatArray) -> FloatArray:
    """Return the coefficients of the phase's variance, times N / 2: quadratic, then cubic.

    Returns
    -------
    (7,) float64
        Of cos^2, cos sin, sin^2; cos^3, cos^2 sin, cos sin^2, sin^3.  (1, 0, 1, 0, 0, 0, 0) for
        equal steps of more than three.
    """
    count = len(steps)
    c, s, _ = frame_weights(steps).T * (2.0 / count)
    p, q = s, -c  # f = p cos phi + q sin phi
    squares = np.array([p * p, 2.0 * p * q, q * q])
    ce, se = np.cos(steps), np.sin(steps)
    cubic = np.zeros((4, count))
    cubic[:3] += squares * ce
    cubic[1:] += squares * se
    return 0.5 * count * np.concatenate([squares.sum(axis=1), cubic.sum(axis=1)])
