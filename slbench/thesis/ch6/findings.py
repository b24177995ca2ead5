"""The findings of chapter 6 and the criteria that they are judged by."""

from __future__ import annotations

import numpy as np

from slbench.thesis import published as thesis
from slbench.thesis.ch6.results import ObjectScan, PlaneSweep, StepHeights
from slbench.thesis.factors import FACTOR_TOLERANCE
from slbench.thesis.outcome import Finding
from slbench.thesis.rules import COMPLETE, SIZE_TOLERANCE, judged


def plane_finding(sweep: PlaneSweep, seed: int) -> Finding:
    """Judge fig. 12: the optimal rig's depth errors over the feasible one's."""
    ratio, floor = sweep.ratio(sweep.rms_mm, seed), sweep.ratio(sweep.floor_mm, seed)
    theirs = thesis.PLANE_MM["optimal"][2] / thesis.PLANE_MM["feasible"][2]
    means = sweep.rms_mm.mean(axis=1)
    why = (
        f"Without the detector's noise the ratio is {floor.value:.3f}: steady errors and noise "
        "scale a little differently with the geometry, and the thesis's mixture is not known."
    )
    return judged(
        "ch6-plane-ratio",
        "The optimal rig measures a plane with lower RMS depth error, by about 0.71 (fig. 12)",
        f"95 % interval below 1 and the ratio within a factor {FACTOR_TOLERANCE} of the thesis's",
        "factor",
        {"value": ratio.value, "low": ratio.low, "high": ratio.high, "thesis": theirs},
        f"Mean RMS {means[0]:.4f} mm and {means[1]:.4f} mm over {len(sweep.heights_mm)} positions.",
        thesis=theirs,
        ours=ratio.value,
        interval=(ratio.low, ratio.high),
        unit="ratio",
        why=why,
    )


def steps_finding(steps: StepHeights, seed: int) -> Finding:
    """Judge table 6: whose step heights are closer."""
    ratio = steps.ratio(seed)
    rms = np.sqrt((steps.errors_mm**2).mean(axis=(1, 2)))
    errors = [
        np.subtract(thesis.BLOCK_5_MEASURED_MM[name], thesis.BLOCK_5_MM) for name in thesis.RIGS
    ]
    theirs = np.sqrt(np.mean(np.square(errors), axis=1))
    smaller = theirs / rms
    why = (
        f"The thesis's heights are off by {1e3 * theirs[0]:.0f} and {1e3 * theirs[1]:.0f} µm, "
        f"{smaller[0]:.0f} and {smaller[1]:.0f} times ours, all of the feasible rig's to the same "
        "side: steady errors of a kind that is not modelled here. What is left here is noise and "
        "the grids of pixels: the same order, for another reason."
    )
    return judged(
        "ch6-step-heights",
        "Step heights are closer to the certified ones with the optimal rig (table 6)",
        "ratio of RMS height errors over steps and placements: 95 % interval below 1, and both "
        f"errors within a factor {SIZE_TOLERANCE:g} of the thesis's; in part if only the order is",
        "order-and-sizes",
        {
            "value": ratio.value,
            "low": ratio.low,
            "high": ratio.high,
            "sizes": [float(size) for size in rms / theirs],
        },
        f"RMS height errors {1e3 * rms[0]:.1f} µm and {1e3 * rms[1]:.1f} µm over "
        f"{steps.heights_mm.shape[1]} placements.",
        thesis=float(theirs[0] / theirs[1]),
        ours=ratio.value,
        interval=(ratio.low, ratio.high),
        unit="ratio",
        why=why,
    )


def object_finding(result: ObjectScan) -> Finding:
    """Judge fig. 14 for one object."""
    # The thesis's own plane error is the scale on which it calls an object reconstructed.
    limit = thesis.PLANE_MM["optimal"][2]
    return judged(
        f"ch6-{result.name.removeprefix('ch6-')}",
        f"The {result.name.removeprefix('ch6-')} is reconstructed (fig. 14)",
        f"at least {100 * COMPLETE:g} % of its lit pixels measured, RMS distance to the true "
        f"surface on smooth parts at most {limit} mm, the thesis's RMS error of a plane",
        "complete-and-close",
        {
            "completeness": result.completeness,
            "rms_mm": result.smooth_rms_mm,
            "limit_mm": limit,
        },
        f"{100 * result.completeness:.2f} % measured, RMS {1e3 * result.smooth_rms_mm:.0f} µm.",
        ours=100.0 * result.completeness,
        unit="% of lit pixels",
    )
