"""Chapter 8: phase noise through the volume (fig. 25) and the sequence it leads to (8.2).

The thesis's system has 0.25 rad of noise, ours less than a tenth of it.  What the designer makes
of *our* table is reported as it is; beside it stands what it makes of the same table raised to
the thesis's level, where fringes whose noise fills the circle count as not measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.design.fringes.design import candidates, thesis_sequence, usable
from slbench.design.fringes.noise import PhaseNoise
from slbench.thesis.ch8.results import Growth

Array = NDArray[np.float64]

#: Thesis 8.2.3: noise, safety factor, step of the grid, and the sequence that came out.
THESIS_NOISE_RAD, SAFETY, NOISE_STEP = 0.25, 1.5, 0.009
THESIS_SEQUENCE = (1, 2, 4, 8, 16)
#: The middle of the volume where the thesis finds both devices in focus, mm from its centre.
MIDDLE_MM = 0.15
#: Noise of a phase that is anywhere on the circle, rad; beyond 3/4 of it nothing is measured.
_CIRCLE = np.pi / np.sqrt(3.0)


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
