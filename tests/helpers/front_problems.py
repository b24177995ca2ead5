"""Problems with known Pareto fronts, on the unit cube: ZDT1-3 and DTLZ2.

ZDT: Zitzler, Deb, Thiele, Evolutionary Computation 8(2), 2000.  DTLZ2: Deb, Thiele, Laumanns,
Zitzler, CEC 2002, here with three objectives.  Each takes points (n, d) and gives (n, m).
"""

import numpy as np

#: f_1 along a true front, so densely that its hypervolume is within 1e-4 of the front's own.
ALONG = np.linspace(0.0, 1.0, 200_001)


def zdt(kind, optimum=0.0):
    """ZDT1-3; `optimum` is where x_2.. of the front lie: 0 is a corner, 0.37 no corner."""

    def objectives(x):
        g = 1.0 + 9.0 * np.abs(x[:, 1:] - optimum).mean(axis=1)
        return np.stack([x[:, 0], g * zdt_shape(kind, x[:, 0], g)], axis=1)

    return objectives


def zdt_shape(kind, f, g=1.0):
    """f_2 / g over f_1 = `f`; with g = 1, the curve on which the true front lies."""
    if kind == 2:
        return 1.0 - (f / g) ** 2
    wave = f / g * np.sin(10.0 * np.pi * f) if kind == 3 else 0.0
    return 1.0 - np.sqrt(f / g) - wave


def dtlz2(x):
    """DTLZ2: the true front is an eighth of the unit sphere, where x_3.. are 1/2."""
    g = ((x[:, 2:] - 0.5) ** 2).sum(axis=1)
    a, b = x[:, 0] * np.pi / 2, x[:, 1] * np.pi / 2
    ball = [np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)]
    return (1.0 + g)[:, np.newaxis] * np.stack(ball, axis=1)
