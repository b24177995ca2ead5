"""The findings on calibrated rigs and the criteria that they are judged by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.bench.statistics import bootstrap_interval
from slbench.thesis.calibrated.results import SteadyErrors
from slbench.thesis.outcome import Finding
from slbench.thesis.rules import SIZE_TOLERANCE, judged

Array = NDArray[np.float64]


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def steady_finding(found: SteadyErrors, seed: int) -> Finding:
    """Judge whether a calibration by boards explains the steady errors that the thesis measured."""
    steady = found.steady_um
    ours, theirs, exact = rms(steady), rms(found.thesis_um), rms(found.exact_um)
    low, high = bootstrap_interval(lambda k: rms(steady[k]), len(steady), seed)
    table = {"ch6": "table 6", "ch7": "table 7"}[found.chapter]
    return judged(
        f"calibrated-{found.chapter}",
        f"Steady errors of step heights ({table}) are those of a rig that boards calibrate",
        "RMS of the mean errors over calibrations and steps within a factor "
        f"{SIZE_TOLERANCE:g} of the thesis's, with its whole 95 % interval (over calibrations); "
        "in part if the estimate alone is",
        "sized",
        {"value": ours, "low": low, "high": high, "thesis": theirs},
        f"{len(steady)} calibrations, {found.calibrated_mm.shape[1]} scans each. With the rig that "
        f"is rendered the same scans have {exact:.2f} µm.",
        thesis=theirs,
        ours=ours,
        interval=(low, high),
        unit="µm",
        why="Boards are exact here, flat and rigid, and so are the lens models: what is left is "
        "noise, corners put off by sampling and by blur. A real board is flat to some tens of "
        "µm.",
    )
