"""How good fronts are beside one another: purity and spread.

The metrics of A. L. Custodio, J. F. A. Madeira, A. I. F. Vaz, L. N. Vicente, "Direct multisearch
for multiobjective optimization", SIAM J. Optim. 21(3), 2011, section 4.2.
"""

import numpy as np

from slbench.design.search.front import nondominated


def purity(fronts):
    """Share of each front (n_s, m) that no other dominates; NaN for an empty one."""
    union = np.concatenate([front for front in fronts if len(front)])
    best = {row.tobytes() for row in union[nondominated(union)] + 0.0}  # + 0.0: no -0
    return np.array(
        [
            np.mean([row.tobytes() in best for row in front + 0.0]) if len(front) else np.nan
            for front in fronts
        ]
    )


def spread_gamma(f, reference=None):
    """Largest hole of a front (N, m), up to the ends of a reference: Gamma of the paper."""
    inner, ends = _gaps(f, reference)
    return float(max(inner.max(initial=0.0), ends.max()))


def spread_delta(f, reference=None):
    """How unevenly a front is spread: Delta of the paper; 0 for equal gaps."""
    inner, ends = _gaps(f, reference)
    uneven = np.abs(inner - inner.mean(axis=0)).sum(axis=0) if len(inner) else 0.0
    outside = ends.sum(axis=0)
    total = outside + inner.sum(axis=0)
    varies = total > 0
    return float(np.max((outside + uneven)[varies] / total[varies], initial=0.0))


def _gaps(f, reference):
    """Gaps between a front's points (N - 1, m) and to the reference's ends (2, m)."""
    values = np.sort(f, axis=0)
    best = values if reference is None else np.asarray(reference)
    # A front may reach beyond the reference, where it is dominated: the gap is a distance.
    ends = np.abs([values[0] - best.min(axis=0), best.max(axis=0) - values[-1]])
    return np.diff(values, axis=0), ends
