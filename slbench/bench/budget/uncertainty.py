"""The uncertainty budget of measurands of a scene, in the sense of the GUM (JCGM 100, JCGM 101).

Inputs with distributions are propagated by draws through stored light
(:mod:`slbench.bench.budget.measurement`, :mod:`slbench.bench.budget.draws`): each alone for its
contribution, all at once for the combined standard uncertainty and the coverage interval.

*What is propagated.*  The GUM draws the inputs of a measurement *model* at the values that were
measured.  Here the measuring rig, temperature, certificate and corrections are propagated so:
``how`` is ``model``.  Noise, vibration, fixed pattern and the projector's response are *simulated*
instead, at the scene's true part, and analysed: the scatter of the results stands for what the
model would give at the measured frames.  G. Wübbeler et al., "GUM-compliant uncertainty evaluation
using virtual experiments", Metrology 2(1), 114-127, 2022, show that a virtual experiment and a
Monte Carlo method are in line with supplement 1 under assumptions on the model's structure and the
variance of the data, and that in general they are not.  For small errors, of which the measurand is
a linear function and the variance does not depend on the part, both agree.

*Steady errors* are not drawn: the bias of a measurand (square panel pixels, footprints, a bent
response) is stated beside the uncertainty and corrected by nobody.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.budget import inputs as names
from slbench.bench.budget.draws import alone, coverage_interval, propagate, sensitivity
from slbench.bench.budget.inputs import (
    Input,
    Stated,
    check_apart,
    of_calibration,
    of_stream,
    of_table,
    stated,
)
from slbench.bench.budget.measurement import CALIBRATION, NOISE, PATTERN, VIBRATION, Measurement
from slbench.core.errors import InputError, warn_user
from slbench.core.show.display import block, length
from slbench.core.show.drawing import figure
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.detector.emva1288 import Detector
from slbench.rig.parameters import ParameterCovariance
from slbench.scene.model import Scene
from slbench.simulate.lights import Lights

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Draws of one input alone: its contribution is then known to 1 / sqrt(2 (n - 1)), 3.5 %.
ALONE = 400
#: A bias or a sampling error of more than this share of the standard uncertainty is told.
_SEEN = 1.0 / 3.0
#: Share of draws that may miss a measurand.
_MISSED = 0.01
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

    def _of_size(self, number: float) -> str:
        return length(number) if self.unit == "mm" else f"{number:.3g} {self.unit}".strip()

    def notes(self) -> list[str]:
        """Return what must be known beside the numbers, a sentence each."""
        n = len(self.draws)
        places = _places(self.u)
        found = [
            f"bias {self._of_size(self.bias)} (true value {self.true:.{places}f}), "
            "not corrected and not in u",
            f"sum of squares {100.0 * self.closure:.1f} % of all at once "
            f"(standard error {100.0 * self.closure_error:.1f} %)",
            f"{n} draws"
            + (
                ""
                if self.stable
                else f", not stable to the digits wanted: numbers "
                f"scatter by {self.scatter:.2g} {self.unit}, wanted {self.tolerance:.2g}"
            ),
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


def inputs_of(
    scene: Scene, given: Stated, covariance: ParameterCovariance | None = None
) -> tuple[Input, ...]:
    """Return the inputs of a scene's measurement: its own, and those stated.

    Parameters
    ----------
    scene : Scene
        Its detector's noise and fixed pattern, vibration, and what is known of the calibration.
    given : Stated
    covariance : ParameterCovariance, optional
        Of the measuring rig, instead of the scene's own.

    Raises
    ------
    InputError
        For an input that the covariance has too, and a gamma where the response is a curve.
    """
    known = covariance
    if known is None and scene.calibration is not None:
        known = scene.calibration.covariance or scene.calibration.beside
    found = [of_stream(NOISE, f"{type(scene.detector).__name__}, each pixel", "A")]
    detector = scene.detector
    if isinstance(detector, Detector) and (detector.prnu or detector.dsnu_e):
        found.append(of_stream(PATTERN, "normal, each pixel", "B"))
    shaken = scene.exposure.vibration_px
    if shaken > 0.0:
        found.append(of_stream(VIBRATION, f"normal, {shaken:g} px, each picture", "A"))
    if known is not None:
        found.append(of_calibration(known))
    usual = names.USUAL | {names.GAMMA: scene.rig.projector.gamma}
    further = [of_table(one, usual.get(one.name, 0.0)) for one in given.inputs]
    if scene.rig.projector.curve is not None and any(one.name == names.GAMMA for one in further):
        raise InputError(f"budget: {names.GAMMA}", "a projector with a gamma", "a measured curve")
    for one in further:
        if one.name in (NOISE, PATTERN, VIBRATION, CALIBRATION):
            raise InputError("budget: inputs", "a name that the scene's inputs have not", one.name)
    check_apart(further, known)
    return (*found, *further)


@checked
def uncertainty_budget(
    scene: Scene,
    measurands: Sequence[str],
    *,
    given: Stated | None = None,
    covariance: ParameterCovariance | None = None,
    draws: types.Draws = 5000,
    digits: types.Digits = 1,
    seed: types.Seed = 0,
    lights: Lights | None = None,
    on_progress: Progress | None = None,
) -> UncertaintyBudget:
    """Propagate the uncertainty of a measurement's inputs to measurands, by draws.

    Parameters
    ----------
    scene : Scene
        What is measured, and with what.
    measurands : sequence of str
        Numbers of features, as claims name them: ``"step[5].measured_mm"``.
    given : Stated, optional
        Further inputs (:func:`slbench.bench.budget.inputs.read_budget`); the scene's ``[budget]``
        by default.
    covariance : ParameterCovariance, optional
        Of the measuring rig; that of the scene's calibration by default, or what stands beside the
        rig that it measures with.
    draws : int
        Most draws of all inputs at once.
    digits : int
        Significant digits of the standard uncertainty that shall stand (JCGM 101:2008, 7.9).
    seed : int
    lights : Lights, optional
        With light that is at hand.
    on_progress : callable, optional

    Returns
    -------
    UncertaintyBudget

    Raises
    ------
    InputError
        For a measurand that is none of the scene or that it does not give, inputs that are stated
        twice, a focus stack and a calibration model.

    Warns
    -----
    InputWarning
        If a bias or the renderer's samples are of the size of the uncertainty.
    """
    if not measurands:
        raise InputError("measurands", "at least one", "none")
    if given is None:
        given = stated(scene.specification.get("budget", {}), f"scene {scene.name}: budget")
    inputs = inputs_of(scene, given, covariance)
    report = on_progress or (lambda stage, fraction: None)
    light = lights or Lights(seed, kept=1)
    model = Measurement(scene, measurands, inputs, light, lambda part: report("trace", part))
    estimate, true, half = model({}), model.true(), model.half()
    for one, value in zip(model.measurands, estimate, strict=True):
        if not np.isfinite(value):
            raise InputError(f"measurand {one.text}", "a feature that the scan measures", "none")
    count = min(ALONE, draws)
    lone, slopes = [], []
    for k, each in enumerate(inputs):
        report("each input", k / len(inputs))
        lone.append(alone(model, inputs, k, count, seed))
        slopes.append(sensitivity(model, each))
    together = propagate(
        model,
        inputs,
        seed=seed,
        digits=digits,
        most=draws,
        coverage=given.coverage,
        kind=given.interval,
        on_progress=lambda part: report("all inputs", part),
    )
    found = []
    for m, one in enumerate(model.measurands):
        column = together.values[:, m]
        made = MeasurandBudget(
            name=one.text,
            unit=one.unit,
            true=float(true[m]),
            estimate=float(estimate[m]),
            contributions=tuple(
                Contribution(
                    input=each,
                    sensitivity=float(slope[m]),
                    u=float(np.nanstd(rows[:, m], ddof=1)),
                    shift=float(np.nanmean(rows[:, m]) - estimate[m]),
                    draws=count,
                )
                for each, rows, slope in zip(inputs, lone, slopes, strict=True)
            ),
            draws=column,
            interval=coverage_interval(column, given.coverage, given.interval),
            coverage=given.coverage,
            stable=bool(together.stable[m]),
            tolerance=float(together.tolerance[m]),
            scatter=float(together.scatter[m]),
            sampling=float("nan") if half is None else abs(float(half[m] - estimate[m])),
        )
        _question(scene, made)
        found.append(made)
    return UncertaintyBudget(
        scene=scene.name,
        patterns=scene.sequence.name,
        measurands=tuple(found),
        interval=given.interval,
        pixels=len(model),
        seed=seed,
        parameters={
            "scene": scene.specification,
            "patterns": scene.sequence.to_dict(),
            "measurands": list(measurands),
            "draws": draws,
            "digits": digits,
            "inputs": [one.model_dump(exclude_none=True) for one in given.inputs],
        },
    )


def _question(scene: Scene, made: MeasurandBudget) -> None:
    """Warn of what makes a budget say less than it seems to."""
    where = f"scene {scene.name}: {made.name}"
    if abs(made.bias) > max(_SEEN * made.u, 3.0 * made.bias_error):
        ratio = abs(made.bias) / made.u if made.u > 0.0 else math.inf
        warn_user(
            where,
            f"bias {length(made.bias)}, {ratio:.2g} times the standard uncertainty: "
            "correct the result, or state what holds it",
        )
    if made.sampling > _SEEN * made.u:
        warn_user(
            where,
            f"the light's samples move it by {length(made.sampling)}, "
            f"u is {length(made.u)}: more of them (render.samples)",
        )
    if made.missed > _MISSED * len(made.draws):
        share = 100.0 * made.missed / len(made.draws)
        warn_user(where, f"not measured in {share:.3g} % of the draws")
