"""How a measured ratio becomes the verdict on a finding.

A statement "A beats B by a factor f" has two parts: the order, which the whole confidence
interval must confirm, and the factor, which a simulation with assumed hardware is expected to
meet within a stated tolerance.
"""

from __future__ import annotations

from slbench.bench.statistics import Interval
from slbench.thesis.outcome import Verdict

#: A factor counts as met when ours and the thesis's differ by no more than this factor.
FACTOR_TOLERANCE = 1.25


def order_verdict(ratio: Interval, *, less: bool) -> Verdict:
    """Judge an order: a ratio below one (`less`), or above.

    ``reproduced`` where the whole interval says so, ``in part`` where only the estimate does.
    """
    if ratio.high < 1.0 if less else ratio.low > 1.0:
        return "reproduced"
    return "in part" if (ratio.value < 1.0 if less else ratio.value > 1.0) else "not reproduced"


def factor_verdict(ratio: Interval, thesis: float, tolerance: float = FACTOR_TOLERANCE) -> Verdict:
    """Judge a factor: the order with its whole interval, and the size.

    Parameters
    ----------
    ratio : Interval
        Ours.
    thesis : float
        Theirs, on one side of one.
    tolerance : float

    Returns
    -------
    {"reproduced", "in part", "not reproduced"}
        ``in part``: the order holds, the size does not; ``not reproduced``: the order does not.
    """
    if order_verdict(ratio, less=thesis < 1.0) != "reproduced":
        return "not reproduced"
    return "reproduced" if 1.0 / tolerance <= ratio.value / thesis <= tolerance else "in part"
