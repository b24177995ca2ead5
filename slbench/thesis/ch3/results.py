"""What the experiment of chapter 3 computed, as immutable values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RigTable:
    """Objectives of eq. 20, to minimise: ``(mu sigma, -eta N_s, -d)``.

    Parameters
    ----------
    optimal : (18, 3) float
        Of table 4.
    random : (n, 3) float
        Of feasible rigs drawn at random from table 3's ranges.
    """

    optimal: Array
    random: Array
