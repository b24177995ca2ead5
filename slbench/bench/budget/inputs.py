"""The inputs of an uncertainty budget: quantities with distributions, as the GUM has them.

A budget file states, in TOML, what a scene does not say of its measurement::

    coverage = 0.95                        # optional; of the interval
    interval = "symmetric"                 # optional; or "shortest"

    [[inputs]]
    name = "part.temperature_C"
    value = 21.0
    distribution = "uniform"
    half_width = 0.5

    [[inputs]]
    name = "certificate"                   # of the nominal size, mm
    distribution = "normal"
    expanded_uncertainty = 0.0006
    coverage_factor = 2.0

Names are those of :data:`KNOWN`, which say themselves what they do, or any name where ``acts`` is
``"offset"`` (mm are added to a measurand in mm) or ``"scale"`` (what is measured is multiplied by
one plus it: of a deviation, the size before the nominal one is taken from it).  The part's
temperature and expansion and the projector's gamma have a ``value``; all others are errors about
what was corrected for, whose estimate is zero.

*Distributions* are those of JCGM 101:2008, 6.4: ``normal`` and ``t`` by a standard uncertainty,
``uniform`` and ``triangular`` by a half-width ``a`` (a / sqrt 3 and a / sqrt 6), or any of them by
its standard uncertainty.  ``t`` is the scaled and shifted distribution of 6.4.9.2 with its degrees
of freedom: its standard deviation is larger than the standard uncertainty of the series that it
stands for, by sqrt(nu / (nu - 2)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from slbench.core.errors import InputError, located
from slbench.core.io import read_toml
from slbench.core.registry import quoted
from slbench.core.units import REFERENCE_C
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Finite, NotNegative, Positive, Proportion
from slbench.core.validation.values import validated
from slbench.rig.parameters import RIG_PARAMETERS, ParameterCovariance

Distribution = Literal["normal", "uniform", "triangular", "t"]
Evaluation = Literal["A", "B"]
#: Whether a draw changes the measurement model or what is simulated.
How = Literal["model", "simulated"]
IntervalKind = Literal["symmetric", "shortest"]

TEMPERATURE, EXPANSION = "part.temperature_C", "part.expansion_per_K"
GAMMA, BASELINE, CERTIFICATE = "projector.gamma", "rig.baseline", "certificate"
#: What an input of a budget file may be called, beside names of one's own with ``acts``.
KNOWN = (TEMPERATURE, EXPANSION, GAMMA, BASELINE, CERTIFICATE, *RIG_PARAMETERS)
#: Those that have an estimate, gamma the scene's where none is stated.  The others are errors about
#: what was corrected for.
USUAL = {TEMPERATURE: REFERENCE_C, EXPANSION: 0.0, GAMMA: 1.0}
#: Standard deviation of a distribution of half-width one.
_OF_HALF_WIDTH = {"uniform": 1.0 / math.sqrt(3.0), "triangular": 1.0 / math.sqrt(6.0)}
#: Fewer degrees of freedom leave a t distribution without a standard deviation.
_LEAST_T = 3.0
_SIZES = ("standard_uncertainty", "half_width", "expanded_uncertainty")


class InputTable(Parameters):
    """``[[inputs]]`` of a budget file."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    distribution: Distribution
    value: Finite | None = None
    standard_uncertainty: NotNegative | None = None
    half_width: NotNegative | None = None
    expanded_uncertainty: NotNegative | None = None
    coverage_factor: Positive | None = None
    degrees_of_freedom: Positive | None = None
    type: Evaluation = "B"
    acts: Literal["offset", "scale"] | None = None

    @model_validator(mode="after")
    def _one_size(self) -> InputTable:
        given = [name for name in _SIZES if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"one of {', '.join(_SIZES)}")
        if (self.expanded_uncertainty is None) != (self.coverage_factor is None):
            raise ValueError("expanded_uncertainty and coverage_factor together")
        if self.half_width is not None and self.distribution not in _OF_HALF_WIDTH:
            raise ValueError("a half_width with uniform or triangular only")
        if self.distribution == "t" and (self.degrees_of_freedom or 0.0) < _LEAST_T:
            raise ValueError(f"degrees_of_freedom of at least {_LEAST_T:g} with t")
        return self

    @property
    def standard(self) -> float:
        """Standard uncertainty, before what a t distribution adds to it."""
        if self.standard_uncertainty is not None:
            return self.standard_uncertainty
        if self.half_width is not None:
            return self.half_width * _OF_HALF_WIDTH[self.distribution]
        assert self.expanded_uncertainty is not None
        assert self.coverage_factor is not None
        return self.expanded_uncertainty / self.coverage_factor


class BudgetTable(Parameters):
    """A budget file, and ``[budget]`` of a scene."""

    coverage: Proportion | None = None
    interval: IntervalKind | None = None
    inputs: tuple[InputTable, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Input:
    """An input quantity of a measurement.

    Parameters
    ----------
    name : str
    distribution : str
        ``"normal"``, ``"uniform"``, ``"triangular"``, ``"t"`` of a number; in words otherwise.
    value, u : float
        Estimate and standard uncertainty as it was stated; NaN for what is no single number.
    unit : str
    freedom : float
        Degrees of freedom; inf where they are not stated.
    type : {"A", "B"}
        A: what repeats of the measurement show.  B: everything else (JCGM 100:2008, 3.3.4).
    how : {"model", "simulated"}
        Whether a draw changes the measurement model, as the GUM has it, or the light and the
        frames that are simulated.
    acts : {"offset", "scale"} or None
        Of an input with a name of its own.
    sample : callable or None
        Draws what is no single number, from a generator.
    """

    name: str
    distribution: str
    value: float = float("nan")
    u: float = float("nan")
    unit: str = ""
    freedom: float = math.inf
    type: Evaluation = "B"
    how: How = "model"
    acts: Literal["offset", "scale"] | None = None
    sample: Callable[[np.random.Generator], Any] | None = None

    @property
    def scalar(self) -> bool:
        """Whether it is a single number."""
        return self.sample is None

    @property
    def std(self) -> float:
        """Standard deviation of the distribution: that of t is larger than `u`."""
        if self.distribution == "t":
            return self.u * math.sqrt(self.freedom / (self.freedom - 2.0))
        return self.u

    def draw(self, rng: np.random.Generator) -> Any:
        """Return a draw from the distribution (JCGM 101:2008, 6.4)."""
        if self.sample is not None:
            return self.sample(rng)
        half = self.u / _OF_HALF_WIDTH.get(self.distribution, 1.0)
        if self.distribution == "uniform":
            return self.value + half * rng.uniform(-1.0, 1.0)
        if self.distribution == "triangular":
            return self.value + half * rng.triangular(-1.0, 0.0, 1.0)
        if self.distribution == "t":
            return self.value + self.u * rng.standard_t(self.freedom)
        return self.value + self.u * rng.standard_normal()


@dataclass(frozen=True, kw_only=True)
class Stated:
    """What a budget file, or a scene's ``[budget]``, states.

    Parameters
    ----------
    inputs : tuple of InputTable
    coverage : float
    interval : {"symmetric", "shortest"}
    """

    inputs: tuple[InputTable, ...] = ()
    coverage: float = 0.95
    interval: IntervalKind = "symmetric"


def read_budget(path: str | Path) -> Stated:
    """Read a budget file.

    Raises
    ------
    InputError
        Naming the file and the key: unknown, missing, stated twice or out of range.
    """
    return stated(read_toml(path), str(path))


def stated(values: object, where: str) -> Stated:
    """Check what a budget file, or a scene's ``[budget]``, states."""
    table = validated(BudgetTable, values, where, ": ")
    seen: set[str] = set()
    for k, one in enumerate(table.inputs):
        at = f"{where}: inputs[{k}].name"
        if one.name in seen:
            raise InputError(at, "each input once", repr(one.name))
        seen.add(one.name)
        if (one.name in KNOWN) == (one.acts is not None):
            if one.acts is None:
                expected = "a known input, or acts = offset or scale with a name of your own"
                raise InputError(at, expected, quoted(one.name, KNOWN))
            raise InputError(f"{where}: inputs[{k}].acts", f"none with {one.name}", one.acts)
        if one.value is not None and one.name not in USUAL:
            expected = f"none: {one.name} is an error about what was corrected for"
            raise InputError(f"{where}: inputs[{k}].value", expected, one.value)
    for name, other in ((TEMPERATURE, EXPANSION), (EXPANSION, TEMPERATURE)):
        if name in seen and other not in seen:
            raise InputError(f"{where}: inputs", f"{other} beside {name}", "none")
    return Stated(
        inputs=table.inputs,
        coverage=0.95 if table.coverage is None else table.coverage,
        interval=table.interval or "symmetric",
    )


def of_table(table: InputTable, estimate: float) -> Input:
    """Return a stated input; `estimate` where the table has no value."""
    how: How = "simulated" if table.name == GAMMA else "model"
    return Input(
        name=table.name,
        distribution=table.distribution,
        value=estimate if table.value is None else table.value,
        u=table.standard,
        unit=_unit(table),
        freedom=table.degrees_of_freedom or math.inf,
        type=table.type,
        how=how,
        acts=table.acts,
    )


def _unit(table: InputTable) -> str:
    if table.name in (TEMPERATURE, EXPANSION):
        return {TEMPERATURE: "°C", EXPANSION: "1/K"}[table.name]
    if table.name == CERTIFICATE or table.acts == "offset":
        return "mm"
    last = table.name.rpartition("_")[2]
    return last if table.acts is None and last in ("px", "rad", "mm") else "1"


def of_calibration(covariance: ParameterCovariance) -> Input:
    """Return the calibration of the measuring rig: all its parameters together."""
    count = len(covariance.names)

    def sample(rng: np.random.Generator) -> dict[str, float]:
        return covariance.draw(int(rng.integers(1 << 62)))

    distribution = f"normal, {count} parameter{'s' * (count > 1)}"
    return Input(name="calibration", distribution=distribution, sample=sample)


def of_stream(name: str, distribution: str, evaluation: Evaluation) -> Input:
    """Return what is drawn pixel by pixel or picture by picture: noise, a pattern, vibration."""
    return Input(
        name=name,
        distribution=distribution,
        type=evaluation,
        how="simulated",
        sample=lambda rng: int(rng.integers(1 << 62)),
    )


def check_apart(inputs: Sequence[Input], covariance: ParameterCovariance | None) -> None:
    """Refuse an input that the calibration's covariance has too."""
    known = () if covariance is None else covariance.names
    for one in inputs:
        if one.scalar and one.name in known:
            with located("budget: inputs"):
                raise InputError(one.name, "what the calibration's covariance has not", "both")
