"""Frames of fringes and Gray codes at exact panel coordinates, by their defining equations."""

import numpy as np

from slbench.patterns import Fringes, GrayCode


def fringe_phase(code, k, u, size):
    """The argument of the cosine that frame `k` of a set shows at panel coordinate `u`, rad."""
    period = code.period_px or size / code.count
    start = -0.5 if code.origin == "edge" else 0.0
    shifts = code.shifts_deg or [360.0 * j / code.shifts for j in range(code.shifts)]
    phase = 2 * np.pi * (u - start) / period + np.radians(code.phase_deg)
    return phase - code.direction * np.radians(shifts[k])


def photograph(sequence, coordinates, a=120.0, b=100.0):
    """Frames (N, V, U) of a + b cos(...) at real-valued panel coordinates {axis: (V, U)}."""
    rows = []
    for frame in sequence.frames():
        if isinstance(frame.part, Fringes):
            size = sequence.size(frame.along)
            phase = fringe_phase(frame.part, frame.index, coordinates[frame.along], size)
            rows.append(a + b * np.cos(phase))
        elif isinstance(frame.part, GrayCode):
            profile = frame.part.profile(frame.index, sequence.size(frame.along))
            rows.append(a + b * (2 * profile[np.rint(coordinates[frame.along]).astype(int)] - 1))
        else:
            lit = np.full_like(next(iter(coordinates.values())), 2 * frame.part.level - 1)
            rows.append(a + b * lit)
    return np.array(rows)
