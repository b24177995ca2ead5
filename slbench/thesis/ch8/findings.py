"""The findings of chapter 8: criteria and verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.model import COORDINATES
from slbench.calibration.selection import Selection
from slbench.cloud.registration import STAGE_SIGMA_MM
from slbench.design.fringes.noise import PhaseNoise
from slbench.thesis.ch8.noise import (
    _CIRCLE,
    MIDDLE_MM,
    THESIS_NOISE_RAD,
    THESIS_SEQUENCE,
    growth,
    sequences,
)
from slbench.thesis.ch8.results import (
    END_MM,
    PLANE_MIDDLE_MM,
    Calibrations,
    Merged,
    MicroRig,
    Stage,
)
from slbench.thesis.outcome import Finding
from slbench.thesis.rules import (
    GAINED,
    GROWN,
    LEFT,
    MEDIAN_OF_NORMAL,
    OBJECT_LIMIT_UM,
    SHARE,
    judged,
)
from slbench.twin.report import THESIS_13

Array = NDArray[np.float64]

_UM = 1e3
#: Thesis 8.4.1, um.
PLANE_LIMIT_UM = 2.0


#: Of the barrels' width: closer than this they touch.
_TOUCHING = 0.01
#: Edge of the thesis's measurement volume, mm (8).
THESIS_EDGE_MM = 0.5


def rig_finding(best: MicroRig, wider: MicroRig) -> Finding:
    """Judge 8.1.2: the largest volume goes with the least angle that the bodies allow."""
    limit = _TOUCHING * best.width_mm
    box = " x ".join(f"{size:.2f}" for size in best.box_mm)
    return judged(
        "ch8-rig",
        "The largest measurement volume is had with the least angle between the axes that the "
        "bodies allow (8.1.2)",
        f"of the rig with the largest volume, the barrels are at most {limit:g} mm apart, a "
        "hundredth of their width, and no rig with axes 10 deg further apart has as much; in part "
        "if one of them",
        "closed-up",
        {
            "gap_mm": best.gap_mm,
            "limit_mm": limit,
            "volume_mm3": best.volume_mm3,
            "wider_mm3": wider.volume_mm3,
        },
        f"{box} mm at {best.angle_deg:.1f} deg, with {best.gap_mm:.3f} mm between the barrels; "
        f"{wider.volume_mm3 / best.volume_mm3:.2f} of that volume at {wider.angle_deg:.1f} deg.",
        thesis=THESIS_EDGE_MM,
        ours=float(np.cbrt(best.volume_mm3)),
        unit="mm, edge of a cube of the volume",
        assumes="the front of an objective is 21 mm wide at 20 mm from the object: the thesis "
        "states neither it nor the angle",
    )


def model_findings(found: Mapping[Stage, Calibrations]) -> tuple[Finding, Finding]:
    """Judge figs. 30-32 (quadratic models chosen) and table 13 (z the worst coordinate).

    By the stage that is off where it moves, as the thesis's, and by whole positions left out.
    """
    off = found["moved axes"]
    shares = {c: off.share(c) for c in COORDINATES}
    most = [c for c in COORDINATES if shares[c] > 0.5]
    exact = found["exact"].selections[0].selected
    excess = {c: _excess(off.selections, c) for c in COORDINATES}
    draws = len(off.selections)
    forms = list(off.selections[0].scores["x"])
    chosen = "; ".join(
        f"{c} " + ", ".join(f"{form} {100 * off.share(c, form):.0f} %" for form in forms)
        for c in COORDINATES
    )
    models = judged(
        "ch8-quadratic",
        "Quadratic models are chosen for x, y and z (figs. 30-32)",
        f"more than half of {draws} draws of a stage off by {_UM * STAGE_SIGMA_MM:g} µm where it "
        "moves choose M3 by whole positions left out, for each coordinate; in part if for some",
        "mostly",
        {"shares": [shares[c] for c in COORDINATES]},
        f"Chosen: {chosen}; with an exact stage "
        + ", ".join(f"{c} {exact[c]}" for c in COORDINATES)
        + ". Error of positions left out, M4 over M3, median: "
        + ", ".join(f"{c} {excess[c]:.4f}" for c in COORDINATES)
        + ".",
        thesis=3.0,
        ours=float(len(most)),
        unit="coordinates",
        why=""
        if len(most) == 3
        else "Without an error of the stage there is not enough noise to overfit, and cubic "
        "models win by nanometres. Where the stage moves, positions left out choose the form that "
        "is truly best in most draws, and in y that may be a smaller one. In x the stage does not "
        "move: what is off there are the dots of the plate, alike at all positions, which no "
        "position left out can tell from a bent field.",
    )
    medians = {stage: _UM * np.median(c.validation(), axis=0) for stage, c in found.items()}
    worst = {stage: c.z_worst for stage, c in found.items()}
    count = sum(worst[stage] > 0.5 for stage in worst)
    moved = medians["moved axes"]
    z_worst = judged(
        "ch8-z-worst",
        "z is the worst coordinate (table 13)",
        "the validation RMS is largest in z in more than half of the draws, for an exact stage, "
        "for one off in all axes and for one off where it moves; in part if for some of them, by "
        "assumption if for the last alone",
        "worst-axis",
        {name.replace(" ", "_"): share for name, share in worst.items()},
        "; ".join(
            f"{stage}: x {m[0]:.3f}, y {m[1]:.3f}, z {m[2]:.3f} µm, z worst in "
            f"{100 * worst[stage]:.0f} %"
            for stage, m in medians.items()
        )
        + ".",
        thesis=THESIS_13["z"][0],
        ours=float(moved[2]),
        interval=_range(_UM * found["moved axes"].validation()[:, 2]),
        unit="µm",
        assumes=f"the stage is off by {_UM * STAGE_SIGMA_MM:g} µm where it moves, in z and not in "
        "x: z then has that error",
        why=""
        if count == 3
        else "Errors that are alike in all axes hide the difference. The thesis's numbers are "
        "those of a stage that moves in z: its error enters there, and not in x.",
    )
    return models, z_worst


def _excess(selections: Sequence[Selection], coordinate: str) -> float:
    """Return the median of the error of M4 where it was not fitted over that of M3."""
    scores = [s.scores[coordinate] for s in selections]
    return float(np.median([score["M4"].predictive / score["M3"].predictive for score in scores]))


def _range(values: Array) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)


def noise_findings(found: Mapping[str, PhaseNoise]) -> list[Finding]:
    """Judge fig. 25: noise grows towards the ends; more so for more fringes; what fusion does.

    Parameters
    ----------
    found : mapping of str to PhaseNoise
        ``single``, and the ways of fusion beside their controls (:data:`FUSIONS`) where both are.
    """
    single = found["single"]
    counts = [int(n) for n in single.fringes if n in THESIS_SEQUENCE]
    rows = [growth(single, n) for n in counts]
    finest, coarsest = rows[-1], rows[0]
    ends = judged(
        "ch8-noise-ends",
        "Phase noise grows towards the ends of the volume (fig. 25)",
        f"{finest.fringes} fringes have at least {GROWN:g} times the noise at either end that "
        f"they have within {MIDDLE_MM:g} mm of the middle, one focus setting; and grow more than "
        f"{coarsest.fringes} fringe",
        "grown",
        {"ratio": finest.ratio, "coarse_ratio": coarsest.ratio},
        f"{finest.fringes} fringes: {finest.middle:.4f} rad in the middle, {finest.low_end:.4f} "
        f"and {finest.high_end:.4f} at the ends; {coarsest.fringes} fringe {coarsest.ratio:.2f} "
        "times.",
        ours=finest.ratio,
        unit="ratio",
    )
    return [
        ends,
        *(
            fusion_finding(name, what, found[way], found[control], finest.fringes)
            for name, (what, way, control) in FUSIONS.items()
            if way in found and control in found
        ),
    ]


#: Ways of fusion that are judged: what they are, the way, and the control that it must beat.
FUSIONS = {
    "plate": ("selective fusion (5.1) on an even plate", "fused-lit", "averaged"),
    "texture": (
        "selective fusion (5.1) on a texture",
        "textured-fused-lit",
        "textured-averaged",
    ),
    "modulation": ("fusion by modulation, not the thesis's", "fused-modulation", "averaged"),
}


def fusion_finding(
    name: str, what: str, fused: PhaseNoise, control: PhaseNoise, fringes: int
) -> Finding:
    """Judge a way of fusion by its noise at the worst height, beside a control of equal light.

    Averaging lowers noise too, and is no fusion: as many frames, all at one focus, are the control.
    Judged by itself the control is "not reproduced".

    Parameters
    ----------
    name, what : str
    fused, control : PhaseNoise
    fringes : int
        Of the finest set that is judged.
    """
    worst, averaged = (
        float(np.max(np.minimum(noise.of(fringes), _CIRCLE))) for noise in (fused, control)
    )
    return judged(
        f"ch8-noise-fusion-{name}",
        f"Focus fusion makes the volume usable beyond the depth of field (5.1, 8.3.2): {what}",
        f"at its worst height it has less than {GAINED:g} times the noise of as many frames "
        "averaged at one focus, which had as much light",
        "fused",
        {"noise": worst, "averaged": averaged},
        f"{fringes} fringes at the worst height: {worst:.4f} rad fused, {averaged:.4f} rad "
        "averaged at one focus.",
        ours=worst / averaged,
        unit="fused / averaged",
        why=""
        if worst < GAINED * averaged
        else "What differs from setting to setting is too little to choose by.",
    )


def sequence_finding(single: PhaseNoise, width_px: int) -> Finding:
    """Judge 8.2.3: four unwrapping steps up to 16 fringes."""
    chosen = sequences(single, width_px)
    if chosen["measured"] == THESIS_SEQUENCE:
        why = ""
    elif chosen["raised"] == THESIS_SEQUENCE:
        why = (
            "Our detector has a fraction of the thesis's noise: fewer steps suffice. At the same "
            "noise the same sequence comes out."
        )
    else:
        why = "At the thesis's noise, too, the volume of our system asks for another sequence."
    texts = {name: "{" + ", ".join(map(str, s)) + "}" for name, s in chosen.items()}
    return judged(
        "ch8-sequence",
        "Four unwrapping steps up to 16 fringes, {1, 2, 4, 8, 16} (8.2.3)",
        "the designer chooses it from the measured sigma(n, z); in part if it does so from that "
        f"table raised to the thesis's {THESIS_NOISE_RAD:g} rad",
        "sequence",
        {
            "thesis": list(THESIS_SEQUENCE),
            "measured": list(chosen["measured"]),
            "raised": list(chosen["raised"]),
        },
        f"Measured noise ({single.typical_rad:.4f} rad of one fringe): {texts['measured']}; raised "
        f"to {THESIS_NOISE_RAD:g} rad: {texts['raised']}; the thesis's numbers: {texts['thesis']}.",
        thesis=float(len(THESIS_SEQUENCE) - 1),
        ours=float(len(chosen["measured"]) - 1),
        unit="steps",
        why=why,
    )


#: Thesis 8.4.2: points, millions, as it puts them, and views.
THESIS_POINTS = {"coin-3": 2.0, "coin-n": 2.0, "watch-gear": 4.5}


_POINTS = {"coin-3": "more than 2", "coin-n": "more than 2", "watch-gear": "4.5"}


THESIS_VIEWS = {"coin-3": 5, "coin-n": 12, "watch-gear": 7}


_FIGURES = {"coin-3": "fig. 35", "coin-n": "fig. 35", "watch-gear": "fig. 37"}


def object_findings(result: Merged, full_share: float) -> tuple[Finding, Finding]:
    """Judge one object: errors below the stage's; points enough, which follows from binning.

    Parameters
    ----------
    result : Merged
    full_share : float
        Pixels of this run's camera as a share of the full run's: a preview's points are
        counted as so many more.
    """
    millions = len(result.points) / full_share / 1e6
    smooth = _UM * float(np.median(np.abs(result.errors(result.smooth))))
    rms = _UM * result.smooth_rms_mm
    views = len(result.registration.poses)
    least = THESIS_POINTS[result.name]
    measured, true = (_UM * value for value in result.roughness_mm)
    stage = _UM * MEDIAN_OF_NORMAL * result.registration_rms_mm[0]
    scaled = "" if full_share == 1.0 else " (scaled to the full camera)"
    shape = judged(
        f"ch8-{result.name}",
        f"{result.name} is measured from {views} registered views ({_FIGURES[result.name]})",
        f"on smooth surface a median |error| below {OBJECT_LIMIT_UM:g} µm, the thesis's accuracy, "
        f"and below {LEFT:g} of that of views put together by the stage alone, {stage:.2f} µm; in "
        "part if only the former",
        "accurate",
        {"median_um": smooth, "stage_um": _UM * result.registration_rms_mm[0]},
        f"On smooth surface median |error| {smooth:.3f} µm, RMS {rms:.3f} µm without "
        f"{100 * result.outliers:.2g} % of outliers; height between levels "
        f"{_UM * result.step_error_mm:+.3f} µm off; Ra {measured:.3f} µm, true {true:.3f} µm; "
        f"{100 * result.extrapolated:.0f} % of the points lie outside the dots' hull.",
        thesis=OBJECT_LIMIT_UM,
        ours=smooth,
        unit="µm",
    )
    points = judged(
        f"ch8-{result.name}-points",
        f"... with {_POINTS[result.name]} million points ({_FIGURES[result.name]})",
        f"{least:g} million points or more{scaled}",
        "assumed-least",
        {"value": millions, "least": least},
        f"{millions:.2f} million points.",
        thesis=least,
        ours=millions,
        unit="million points",
        why=""
        if millions >= least
        else "The camera's pixels are put together to save time; points are fewer with them.",
        assumes="how many of the camera's pixels are put together, which is a choice of this run",
    )
    return shape, points


def registration_finding(results: Sequence[Merged]) -> Finding:
    """Judge the registration: displacements of the views smaller than the stage left them."""
    pairs = {r.name: r.registration_rms_mm for r in results}
    shares = {name: after / before for name, (before, after) in pairs.items()}
    worst = max(shares, key=lambda name: shares[name])
    return judged(
        "ch8-registration",
        "Views are registered from the stage's positions (8.4.2)",
        "for every object the views' displacements against each other are less than half of what "
        "the stage's errors make them (RMS per axis); in part if for some",
        "registered",
        {"left": list(shares.values())},
        "; ".join(
            f"{name} {_UM * before:.2f} µm by the stage, {_UM * after:.3f} µm registered"
            for name, (before, after) in pairs.items()
        )
        + ".",
        ours=shares[worst],
        unit="after / before, worst object",
    )


def plane_findings(z_mm: Array, off: Array, exact: Array) -> tuple[Finding, Finding]:
    """Judge fig. 33: under 2 um in the middle, more at the ends.

    Heights of 100 um, in neither of the two that the thesis names, are left out of both.

    Parameters
    ----------
    z_mm : (positions,) float
        True heights from the middle of the volume.
    off, exact : (draws, positions) float
        Errors, mm, with stages that are off and with an exact one.
    """
    middle = _middle(z_mm)
    typical = _UM * np.median(np.abs(off[:, middle]), axis=1)
    clean = _UM * float(np.median(np.abs(exact[:, middle])))
    low, high = (float(value) for value in np.percentile(typical, [2.5, 97.5]))
    under = judged(
        "ch8-plane-middle",
        "Median plane position error under 2 µm in the middle of the volume (fig. 33)",
        f"the median of |error| over the middle is under {PLANE_LIMIT_UM:g} µm in "
        f"{100 * SHARE:g} % of the draws of the stage's errors ({_UM * STAGE_SIGMA_MM:g} µm in "
        "calibration and in use)",
        "assumed-share",
        {"share": float(np.mean(typical < PLANE_LIMIT_UM))},
        f"Median {np.median(typical):.2f} µm, of draws {low:.2f} to {high:.2f} µm; with an exact "
        f"stage {clean:.3f} µm.",
        thesis=PLANE_LIMIT_UM,
        ours=float(np.median(typical)),
        interval=(low, high),
        unit="µm",
        assumes=f"the stage is off by {_UM * STAGE_SIGMA_MM:g} µm: the median of such errors alone "
        f"is {_UM * STAGE_SIGMA_MM * MEDIAN_OF_NORMAL:.2f} µm",
    )
    end = np.abs(z_mm) >= END_MM - 1e-9
    at_ends = _UM * np.median(np.abs(off[:, end]), axis=1)
    share = float(np.mean(at_ends > typical))
    clean_ends = _UM * float(np.median(np.abs(exact[:, end])))
    ends = judged(
        "ch8-plane-ends",
        "Plane position errors are larger at the ends of the volume (fig. 33)",
        f"the median of |error| at the ends (0, 50, 450 and 500 of 500 µm) exceeds that in the "
        f"middle (150 to 400 µm) with an exact stage, and in {100 * SHARE:g} % of the draws with "
        "one that is off; in part if with an exact stage alone",
        "ends-larger",
        {"share": share, "ends": clean_ends, "middle": clean},
        f"Exact stage: {clean_ends:.3f} µm at the ends, {clean:.3f} µm in the middle; stage off: "
        f"{np.median(at_ends):.2f} and {np.median(typical):.2f} µm, larger at the ends in "
        f"{100 * share:.0f} % of the draws.",
        ours=clean_ends / clean if clean > 0 else None,
        unit="ratio, exact stage",
        why=""
        if share >= SHARE
        else "A stage's error is the same at all heights and larger than what blur adds: the "
        "mean over a plate's pixels averages phase noise out.",
    )
    return under, ends


def _middle(z_mm: Array) -> NDArray[np.bool_]:
    return (z_mm >= PLANE_MIDDLE_MM[0] - 1e-9) & (z_mm <= PLANE_MIDDLE_MM[1] + 1e-9)
