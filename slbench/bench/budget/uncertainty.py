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
from collections.abc import Callable, Sequence

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
from slbench.bench.budget.result import Contribution, MeasurandBudget, UncertaintyBudget
from slbench.core.errors import InputError, warn_user
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

    Warns
    -----
    InputWarning
        For frame errors that are new in every scan, which are not drawn.
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
    if undrawn := _random_frame_errors(scene):
        advice = "new in every scan, and in no draw: the uncertainty is without what it leaves"
        warn_user(f"budget: {' and '.join(undrawn)}", advice)
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


def _random_frame_errors(scene: Scene) -> list[str]:
    """Return the frame errors of a scene that are new in every scan, by their keys."""
    planes, trigger = scene.exposure.bit_planes, scene.exposure.trigger
    found = []
    if trigger is not None and trigger.rate > 0.0:
        found.append("exposure.trigger.rate")
    if planes is not None and planes.free_running:
        found.append("exposure.bit_planes.free_running")
    return found


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
            f"bias {made.of_size(made.bias)}, {ratio:.2g} times the standard uncertainty: "
            "correct the result, or state what holds it",
        )
    if made.sampling > _SEEN * made.u:
        warn_user(
            where,
            f"the light's samples move it by {made.of_size(made.sampling)}, "
            f"u is {made.of_size(made.u)}: more of them (render.samples)",
        )
    if made.missed > _MISSED * len(made.draws):
        share = 100.0 * made.missed / len(made.draws)
        warn_user(where, f"not measured in {share:.3g} % of the draws")
