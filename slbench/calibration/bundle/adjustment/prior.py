"""What is known of devices before an adjustment: parameters and their covariance, as a measurement.

Of q parameters with values m and a covariance C, ``W (x - m)`` with ``W^T W = C^-1`` are residuals
of deviation one, beside those of the points.  So an adjustment weighs both, and its covariance has
the devices' own.

**Denominators.**  Boards tell next to nothing of a rational lens's denominator: the numerator does
nearly the same, and where both vanish together they cancel, just beyond the farthest point, where
an adjustment would walk.  Before anything is known, the logarithm of the denominator is zero
throughout the field with a deviation of 3: positive, and between a twentieth and twenty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import brief
from slbench.rig import Rig
from slbench.rig.coefficients import DENOMINATOR
from slbench.rig.parameters import OPTICS, ROLES, ParameterCovariance, optics_of

Array = NDArray[np.float64]

#: Least variance of a direction, as a share of the largest one's, each parameter over its own
#: deviation: below it is rounding of the file's.
_ROUNDING = 1e-12

#: Deviation of a denominator's logarithm; where it is looked at, in half diagonals of the picture:
#: as far as barrel distortion sees.
_DEVIATION, _PLACES = 3.0, 0.25 * np.arange(1, 7)


@dataclass(frozen=True, eq=False)
class Prior:
    """Parameters of a rig's lenses and panels as they were known before.

    Parameters
    ----------
    rig : Rig
        With their values.
    covariance : ParameterCovariance
        Of parameters without poses; all deviations are above zero.
    """

    rig: Rig
    covariance: ParameterCovariance

    __repr__ = brief

    @cached_property
    def _whitening(self) -> Array:
        size = np.sqrt(np.diag(self.covariance.matrix))
        values, vectors = np.linalg.eigh(self.covariance.matrix / np.outer(size, size))
        values = np.maximum(values, _ROUNDING * values[-1])
        return np.asarray((vectors / np.sqrt(values)).T / size)

    def __len__(self) -> int:
        return len(self.covariance.names)

    def off(self, rig: Rig) -> Array:
        """Return the values before less a rig's, (q,)."""
        return self._values(self.rig) - self._values(rig)

    def residuals(self, rig: Rig) -> Array:
        """Return :meth:`off` in independent deviations, (q,)."""
        return np.asarray(self._whitening @ self.off(rig))

    def derivatives(self, names: Sequence[str], rig: Rig | None = None) -> Array:
        """Return derivatives of :meth:`residuals` by parameters, (q, len(names)): of any rig."""
        total = np.zeros((len(self.covariance.names), len(names)))
        for k, name in enumerate(names):
            if name in self.covariance.names:
                total[:, k] = -self._whitening[:, self.covariance.names.index(name)]
        return total

    def _values(self, rig: Rig) -> Array:
        found = {
            f"{role}.{name}": value
            for role in ROLES
            for name, value in optics_of(getattr(rig, role)).items()
        }
        # A lens has no terms beyond its own: they are zero.
        return np.array([found.get(name, 0.0) for name in self.covariance.names])


@dataclass(frozen=True, eq=False)
class Denominators:
    """That denominators of rational lenses are near one in the field; see the module.

    Parameters
    ----------
    squares : dict of str to (k,) float
        Squared radii where they are looked at, by the device.
    """

    squares: dict[str, Array]

    __repr__ = brief

    def __len__(self) -> int:
        return sum(map(len, self.squares.values()))

    @classmethod
    def of(cls, rig: Rig, free: Sequence[str]) -> Denominators | None:
        """Return those of a rig whose ``k4``, ``k5`` or ``k6`` is free; None where none is.

        Parameters
        ----------
        rig : Rig
            Where the adjustment starts: its focal lengths count.
        free : sequence of str
            Parameters that are fitted, by full names.
        """
        squares = {}
        for role in ROLES:
            if any(f"{role}.{name}" in free for name in DENOMINATOR):
                device = getattr(rig, role)
                edge = np.hypot(device.width, device.height) / (2.0 * device.matrix[0, 0])
                squares[role] = np.square(_PLACES * edge)
        return cls(squares) if squares else None

    def residuals(self, rig: Rig) -> Array:
        """Return logarithms of the denominators over their deviation; NaN where they vanish."""
        values = np.concatenate([self._at(rig, role) for role in self.squares])
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.log(np.where(values > 0.0, values, np.nan)) / _DEVIATION)

    def derivatives(self, names: Sequence[str], rig: Rig) -> Array:
        """Return derivatives of :meth:`residuals` by parameters, (k, len(names))."""
        rows = []
        for role, square in self.squares.items():
            block = np.zeros((len(square), len(names)))
            for power, name in enumerate(DENOMINATOR, 1):
                if f"{role}.{name}" in names:
                    of = names.index(f"{role}.{name}")
                    block[:, of] = square**power / self._at(rig, role) / _DEVIATION
            rows.append(block)
        return np.concatenate(rows)

    def _at(self, rig: Rig, role: str) -> Array:
        own = optics_of(getattr(rig, role))
        q = self.squares[role]
        k4, k5, k6 = (own.get(name, 0.0) for name in DENOMINATOR)
        return np.asarray(1.0 + q * (k4 + q * (k5 + q * k6)))


def marginal(
    covariance: ParameterCovariance, roles: Sequence[str] = ROLES
) -> ParameterCovariance | None:
    """Return what is known of devices' lenses and panels alone, whatever their poses.

    Parameters
    ----------
    covariance : ParameterCovariance
    roles : sequence of str
        Of the devices.

    Returns
    -------
    ParameterCovariance or None
        None where no such parameter has a deviation.
    """
    wanted = [f"{role}.{name}" for role in roles for name in OPTICS]
    which = [
        k for k, (name, std) in enumerate(covariance.std.items()) if name in wanted and std > 0.0
    ]
    if not which:
        return None
    names = tuple(covariance.names[k] for k in which)
    return ParameterCovariance(names, covariance.matrix[np.ix_(which, which)])
