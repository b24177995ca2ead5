"""Chapter 8: phase noise through the volume (fig. 25) and the sequence it leads to (8.2).

The thesis's system has 0.25 rad of noise, ours less than a tenth of it.  What the designer makes
of *our* table is reported as it is; beside it stands what it makes of the same table raised to
the thesis's level, where fringes whose noise fills the circle count as not measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.document import Picture, Table
from slbench.design.fringes.design import candidates, thesis_sequence, usable
from slbench.design.fringes.noise import PhaseNoise
from slbench.thesis.outcome import Finding, Verdict
from slbench.thesis.pictures import new_figure, picture

Array = NDArray[np.float64]

#: Thesis 8.2.3: noise, safety factor, step of the grid, and the sequence that came out.
THESIS_NOISE_RAD, SAFETY, NOISE_STEP = 0.25, 1.5, 0.009
THESIS_SEQUENCE = (1, 2, 4, 8, 16)
#: The middle of the volume where the thesis finds both devices in focus, mm from its centre.
MIDDLE_MM = 0.15
#: Noise of a phase that is anywhere on the circle, rad; beyond 3/4 of it nothing is measured.
_CIRCLE = np.pi / np.sqrt(3.0)
#: By what factor noise has to be larger at the ends to count as grown.
GROWN = 1.2


@dataclass(frozen=True)
class Growth:
    """Noise of a number of fringes in the middle of the volume and at its two ends, rad."""

    fringes: int
    middle: float
    low_end: float
    high_end: float

    @property
    def ratio(self) -> float:
        """The lesser end over the middle."""
        return min(self.low_end, self.high_end) / self.middle


def growth(noise: PhaseNoise, fringes: int) -> Growth:
    """Return how the noise of `fringes` differs between the middle and the ends.

    Infinite noise (fringes washed out) counts as that of a phase anywhere on the circle.
    """
    sigma = np.minimum(noise.of(fringes), _CIRCLE)
    z = noise.z_mm
    inside = np.abs(z) <= MIDDLE_MM + 1e-9
    ends = [sigma[~inside & (z < 0)], sigma[~inside & (z > 0)]]
    return Growth(
        fringes,
        float(np.median(sigma[inside])),
        *(float(np.median(part)) if part.size else float("nan") for part in ends),
    )


def raised(noise: PhaseNoise, typical_rad: float) -> PhaseNoise:
    """Return the table scaled to `typical_rad` of one fringe; what fills the circle is lost."""
    sigma = noise.sigma_rad * (typical_rad / noise.typical_rad)
    sigma = np.where(sigma < 0.75 * _CIRCLE, sigma, np.inf)
    return PhaseNoise(noise.fringes, sigma, noise.z_mm, noise.shifts)


def noise_findings(found: Mapping[str, PhaseNoise]) -> tuple[Finding, Finding]:
    """Judge fig. 25: noise grows towards the ends; more so for more fringes; what fusion does."""
    single = found["single"]
    counts = [int(n) for n in single.fringes if n in THESIS_SEQUENCE]
    rows = [growth(single, n) for n in counts]
    finest, coarsest = rows[-1], rows[0]
    ok = finest.ratio >= GROWN and finest.ratio > coarsest.ratio
    ends = Finding(
        "ch8-noise-ends",
        "Phase noise grows towards the ends of the volume (fig. 25)",
        f"{finest.fringes} fringes have at least {GROWN:g} times the noise at either end that "
        f"they have within {MIDDLE_MM:g} mm of the middle, one focus setting; and grow more than "
        f"{coarsest.fringes} fringe",
        "reproduced" if ok else "not reproduced",
        f"{finest.fringes} fringes: {finest.middle:.4f} rad in the middle, {finest.low_end:.4f} "
        f"and {finest.high_end:.4f} at the ends; {coarsest.fringes} fringe {coarsest.ratio:.2f} "
        "times.",
        ours=finest.ratio,
        unit="ratio",
    )
    ratios = {
        name: growth(noise, finest.fringes) for name, noise in found.items() if name != "single"
    }
    best = min(ratios, key=lambda name: ratios[name].ratio)
    lower = all(
        np.max(found[best].of(n)) < np.max(np.minimum(single.of(n), _CIRCLE))
        for n in (coarsest.fringes, finest.fringes)
    )
    texts = ", ".join(f"{name} {g.ratio:.2f} times" for name, g in ratios.items())
    fusion = Finding(
        "ch8-noise-fusion",
        "Focus fusion makes the volume usable beyond the depth of field (5.1, 8.3.2)",
        "one way of fusion has less noise than one picture at its worst height",
        "reproduced" if lower else "not reproduced",
        f"Noise of {finest.fringes} fringes at the ends over the middle: {texts}. "
        f"Worst: {np.max(found[best].of(finest.fringes)):.4f} rad fused ({best}), "
        f"{np.max(single.of(finest.fringes)):.4f} rad in one picture.",
        ours=float(np.max(found[best].of(finest.fringes)) / np.max(single.of(finest.fringes))),
        unit="fused / single",
        why="A smooth plate has no texture to fuse by: fused-lit averages blurred settings too.",
    )
    return ends, fusion


def sequences(single: PhaseNoise, width_px: int) -> dict[str, tuple[int, ...]]:
    """Return what the designer chooses: for the thesis's numbers, our table, ours raised."""
    counts = candidates(width_px)
    bounded = [n for n in counts if n <= THESIS_SEQUENCE[-1]]
    constant = PhaseNoise.constant(THESIS_NOISE_RAD, bounded)
    tables = {"measured": single, "raised": raised(single, THESIS_NOISE_RAD)}
    chosen = {
        name: thesis_sequence(width_px, table, usable(counts, table), safety=SAFETY).fringes
        for name, table in tables.items()
    }
    return {
        "thesis": thesis_sequence(
            width_px,
            constant,
            bounded,
            safety=SAFETY,
            noise_step=NOISE_STEP,
            phase_model="thesis",
        ).fringes
    } | chosen


def sequence_finding(single: PhaseNoise, width_px: int) -> Finding:
    """Judge 8.2.3: four unwrapping steps up to 16 fringes."""
    chosen = sequences(single, width_px)
    if chosen["measured"] == THESIS_SEQUENCE:
        verdict: Verdict = "reproduced"
        why = ""
    elif chosen["raised"] == THESIS_SEQUENCE:
        verdict = "in part"
        why = (
            "Our detector has a fraction of the thesis's noise: fewer steps suffice. At the same "
            "noise the same sequence comes out."
        )
    else:
        verdict = "not reproduced"
        why = "At the thesis's noise, too, the volume of our system asks for another sequence."
    texts = {name: "{" + ", ".join(map(str, s)) + "}" for name, s in chosen.items()}
    return Finding(
        "ch8-sequence",
        "Four unwrapping steps up to 16 fringes, {1, 2, 4, 8, 16} (8.2.3)",
        "the designer chooses it from the measured sigma(n, z); in part if it does so from that "
        f"table raised to the thesis's {THESIS_NOISE_RAD:g} rad",
        verdict,
        f"Measured noise ({single.typical_rad:.4f} rad of one fringe): {texts['measured']}; raised "
        f"to {THESIS_NOISE_RAD:g} rad: {texts['raised']}; the thesis's numbers: {texts['thesis']}.",
        thesis=float(len(THESIS_SEQUENCE) - 1),
        ours=float(len(chosen["measured"]) - 1),
        unit="steps",
        why=why,
    )


def noise_table(found: Mapping[str, PhaseNoise]) -> Table:
    """Return sigma(n, z) of all ways."""
    heights = found["single"].z_mm
    columns = ("way", "fringes", *(f"z {1e3 * z:+.0f} µm" for z in heights))
    rows = []
    for name, noise in found.items():
        at = dict(zip(np.round(noise.z_mm, 6), range(len(noise.z_mm)), strict=True))
        for n, sigma in zip(noise.fringes, noise.sigma_rad, strict=True):
            places = (at.get(z) for z in np.round(heights, 6))
            cells = [None if k is None or not np.isfinite(sigma[k]) else sigma[k] for k in places]
            rows.append((name, int(n), *(None if c is None else float(c) for c in cells)))
    note = "Standard deviation of the relative phase, rad; a dash where fringes are washed out."
    return Table("Phase noise through the volume (fig. 25)", columns, tuple(rows), note)


def noise_picture(found: Mapping[str, PhaseNoise]) -> Picture:
    """Draw fig. 25, a panel a way."""
    figure = new_figure(4.2 * len(found), 4.2)
    panels = figure.subplots(1, len(found), squeeze=False, sharey=True)[0]
    for axes, (name, noise) in zip(panels, found.items(), strict=True):
        for n, sigma in zip(noise.fringes, noise.sigma_rad, strict=True):
            shown = np.where(np.isfinite(sigma), sigma, np.nan)
            axes.semilogy(1e3 * noise.z_mm, shown, ".-", label=f"{n}")
        axes.axvspan(-1e3 * MIDDLE_MM, 1e3 * MIDDLE_MM, color="0.92", zorder=0)
        axes.set_title(name)
        axes.set_xlabel("height z / µm")
        axes.grid(visible=True, which="both", alpha=0.3)
        axes.legend(title="fringes", fontsize=7, ncols=2)
    panels[0].set_ylabel(r"phase noise $\sigma_\phi$ / rad")
    caption = "Noise of the relative phase over the height; the thesis's middle is shaded."
    return picture("Phase noise through the volume (fig. 25)", figure, caption)
