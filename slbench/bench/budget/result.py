"""Uncertainty budgets as values: contributions, draws, and what is said of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.budget import inputs as names
from slbench.bench.budget.inputs import (
    Input,
)
from slbench.core.show.display import block, length
from slbench.core.show.drawing import figure

Array = NDArray[np.float64]

#: How inputs are propagated, for people.
METHOD = (
    "Inputs of the model are propagated at the measured value (JCGM 101); simulated ones by the "
    "scatter of virtual measurements of the scene's true part, which agrees with it for small "
    "errors (Wübbeler et al., Metrology 2, 2022)"
)


@dataclass(frozen=True, kw_only=True)
class Contribution:
    """What one input alone does to one measurand.

    Parameters
    ----------
    input : Input
    sensitivity : float
        Derivative of the measurand by the input; NaN for what is no single number.
    u : float
        Standard deviation of the measurand by draws of this input alone.
    shift : float
        Mean of these draws minus the measurand at all estimates.
    draws : int
    """

    input: Input
    sensitivity: float
    u: float
    shift: float
    draws: int

    @property
    def u_error(self) -> float:
        """Standard error of `u`, of normal draws."""
        return self.u / math.sqrt(2.0 * (self.draws - 1))


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasurandBudget:
    """The budget of one measurand.

    Parameters
    ----------
    name, unit : str
    true : float
        Of the scene's part.
    estimate : float
        All inputs at their estimates, without noise.
    contributions : tuple of Contribution
    draws : (n,) float
        All inputs at once; NaN where it was not measured.
    interval : (float, float)
    coverage : float
    stable : bool
        Whether the numbers stand to the wanted digits.
    tolerance, scatter : float
        Half of the last wanted digit of the standard uncertainty, and what blocks of draws scatter.
    sampling : float
        What the renderer's samples leave, one standard deviation; NaN where it is not known.
    """

    name: str
    unit: str
    true: float
    estimate: float
    contributions: tuple[Contribution, ...]
    draws: Array = field(repr=False)
    interval: tuple[float, float]
    coverage: float
    stable: bool
    tolerance: float
    scatter: float
    sampling: float

    @property
    def value(self) -> float:
        """Mean of the draws of all inputs at once."""
        return float(np.nanmean(self.draws))

    @property
    def u(self) -> float:
        """Combined standard uncertainty: the standard deviation of these draws."""
        return float(np.nanstd(self.draws, ddof=1))

    @property
    def missed(self) -> int:
        """Draws in which it was not measured."""
        return int(np.count_nonzero(~np.isfinite(self.draws)))

    @property
    def bias(self) -> float:
        """Mean of the draws minus the true value; not corrected."""
        return self.value - self.true

    @property
    def bias_error(self) -> float:
        """Standard error of the bias, by the number of draws."""
        return self.u / math.sqrt(max(len(self.draws) - self.missed, 1))

    @property
    def sum_of_squares(self) -> float:
        """Root of the sum of the contributions' squares."""
        return math.sqrt(sum(one.u**2 for one in self.contributions))

    @property
    def closure(self) -> float:
        """The sum of squares over what all at once give, as a ratio of lengths."""
        return self.sum_of_squares / self.u if self.u > 0.0 else float("nan")

    @property
    def closure_error(self) -> float:
        """Standard error of the closure, by the numbers of draws."""
        if not self.u > 0.0:
            return float("nan")
        parts = sum((one.u * one.u_error) ** 2 for one in self.contributions)
        relative = math.sqrt(parts) / self.sum_of_squares**2 if self.sum_of_squares else 0.0
        return self.closure * math.hypot(relative, 1.0 / math.sqrt(2.0 * (len(self.draws) - 1)))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom (Welch and Satterthwaite; JCGM 100:2008, G.4)."""
        rows = [
            (one.u * one.input.u / one.input.std, one.input.freedom)
            if one.input.distribution == "t"
            else (one.u, one.input.freedom)
            for one in self.contributions
        ]
        below = sum(u**4 / freedom for u, freedom in rows if math.isfinite(freedom))
        whole = sum(u**2 for u, _ in rows) ** 2
        return whole / below if below > 0.0 else math.inf

    @property
    def factor(self) -> float:
        """Half the interval's length over the standard uncertainty."""
        return 0.5 * (self.interval[1] - self.interval[0]) / self.u if self.u > 0.0 else math.nan

    def share(self, one: Contribution) -> float:
        """Return the part of a contribution in the sum of squares."""
        return (one.u / self.sum_of_squares) ** 2 if self.sum_of_squares > 0.0 else float("nan")

    def stated(self) -> str:
        """Return value, standard uncertainty and interval, with two digits of uncertainty."""
        unit = f" {self.unit}" if self.unit else ""
        places = _places(self.u)
        low, high = (f"{end:.{places}f}" for end in self.interval)
        return (
            f"{self.name} = {self.value:.{places}f}{unit}, u = {self.u:.{places}f}{unit}, "
            f"{100.0 * self.coverage:g} % interval [{low}, {high}]{unit}"
        )

    def of_size(self, number: float) -> str:
        """Return a difference in the measurand's unit, as it is shown."""
        return length(number) if self.unit == "mm" else f"{number:.3g} {self.unit}".strip()

    def notes(self) -> list[str]:
        """Return what must be known beside the numbers, a sentence each."""
        n = len(self.draws)
        places = _places(self.u)
        doubt = ""
        if not self.stable:
            doubt = ", too few to tell to which digits the numbers stand"
            if math.isfinite(self.scatter):
                doubt = f", not stable to the digits wanted: numbers scatter by {self.scatter:.2g} "
                doubt += f"{self.unit}, wanted {self.tolerance:.2g}"
        found = [
            f"bias {self.of_size(self.bias)} (true value {self.true:.{places}f}), "
            "not corrected and not in u",
            f"sum of squares {100.0 * self.closure:.1f} % of all at once "
            f"(standard error {100.0 * self.closure_error:.1f} %)",
            f"{n} draws{doubt}",
        ]
        if self.missed:
            found.append(f"not measured in {self.missed} draws, which count for nothing")
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; the draws are not among them."""
        rows = []
        for one in self.contributions:
            given = one.input
            rows.append(
                {
                    "input": given.name,
                    "distribution": given.distribution,
                    "estimate": given.value,
                    "standard_uncertainty": given.std,
                    "unit": given.unit,
                    "degrees_of_freedom": given.freedom if math.isfinite(given.freedom) else None,
                    "type": given.type,
                    "how": given.how,
                    "sensitivity": one.sensitivity,
                    "u": one.u,
                    "u_error": one.u_error,
                    "shift": one.shift,
                    "share": self.share(one),
                    "draws": one.draws,
                }
            )
        return {
            "measurand": self.name,
            "unit": self.unit,
            "value": self.value,
            "standard_uncertainty": self.u,
            "interval": list(self.interval),
            "coverage": self.coverage,
            "coverage_factor": self.factor,
            "effective_degrees_of_freedom": self.freedom if math.isfinite(self.freedom) else None,
            "true": self.true,
            "estimate": self.estimate,
            "bias": self.bias,
            "bias_error": self.bias_error,
            "sampling": self.sampling,
            "sum_of_squares": self.sum_of_squares,
            "closure": self.closure,
            "closure_error": self.closure_error,
            "draws": len(self.draws),
            "missed": self.missed,
            "stable": self.stable,
            "tolerance": self.tolerance,
            "scatter": self.scatter,
            "inputs": rows,
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class UncertaintyBudget:
    """Uncertainty budgets of measurands of a scene.

    Parameters
    ----------
    scene, patterns : str
    measurands : tuple of MeasurandBudget
    interval : {"symmetric", "shortest"}
    pixels : int
        That a draw measures.
    seed : int
    parameters : mapping
        For the provenance.
    """

    scene: str
    patterns: str
    measurands: tuple[MeasurandBudget, ...]
    interval: names.IntervalKind
    pixels: int
    seed: int
    parameters: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __getitem__(self, name: str) -> MeasurandBudget:
        """Return the budget of a measurand by its name."""
        return next(one for one in self.measurands if one.name == name)

    def __repr__(self) -> str:
        return block(
            f"UncertaintyBudget of {self.scene}, {{{self.patterns}}}",
            *(one.stated() for one in self.measurands[:5]),
        )

    def plot(self) -> Any:
        """Return a matplotlib figure: contributions as bars, and the draws with their interval."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "scene": self.scene,
            "patterns": self.patterns,
            "interval": self.interval,
            "method": METHOD,
            "pixels": self.pixels,
            "seed": self.seed,
            "measurands": [one.to_dict() for one in self.measurands],
        }


def _places(u: float) -> int:
    """Return the decimals that show two digits of an uncertainty."""
    if not (u > 0.0 and math.isfinite(u)):
        return 6
    return max(0, 1 - int(f"{u:.1e}".partition("e")[2]))
