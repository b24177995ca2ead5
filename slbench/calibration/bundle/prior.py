"""What is known of devices before an adjustment: parameters and their covariance, as a measurement.

Of q parameters with values m and a covariance C, ``W (x - m)`` with ``W^T W = C^-1`` are residuals
of deviation one, beside those of the points.  So an adjustment weighs both, and its covariance has
the devices' own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import brief
from slbench.rig import Rig
from slbench.rig.parameters import OPTICS, ROLES, ParameterCovariance, optics_of

Array = NDArray[np.float64]

#: Least variance of a direction, as a share of the largest one's, each parameter over its own
#: deviation: below it is rounding of the file's.
_ROUNDING = 1e-12


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

    def off(self, rig: Rig) -> Array:
        """Return the values before less a rig's, (q,)."""
        return self._values(self.rig) - self._values(rig)

    def residuals(self, rig: Rig) -> Array:
        """Return :meth:`off` in independent deviations, (q,)."""
        return np.asarray(self._whitening @ self.off(rig))

    def derivatives(self, names: Sequence[str]) -> Array:
        """Return derivatives of :meth:`residuals` by parameters, (q, len(names))."""
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
