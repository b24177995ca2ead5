"""The inner loop of the largest box in focus of a sweep (:mod:`slbench.design.rig.volume`)."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def scales(slopes, rooms, wedges, usable, ratios, best_only, out):  # type: ignore[no-untyped-def]
    """Write how often boxes of half sizes `ratios` (n, c, 3) fit, (n, c).

    A box keeps clear of all planes, `slopes` (n, 3, p) and `rooms` (n, p): sizes of the normals and
    distances; and of wedges, where it keeps to one of the half-spaces of each, `wedges` (n, w, 5,
    4): normals and values at the origin.  If `best_only`, boxes that are no larger than one before
    them have no scale.
    """
    for i in range(len(out)):
        if not usable[i]:
            out[i] = 1.0
            continue
        largest = 0.0
        for c in range(out.shape[1]):
            x, y, z = ratios[i, c, 0], ratios[i, c, 1], ratios[i, c, 2]
            load = 1e-300
            for p in range(rooms.shape[1]):
                own = slopes[i, 0, p] * x + slopes[i, 1, p] * y + slopes[i, 2, p] * z
                load = max(load, own / rooms[i, p])
            w = 0
            while w < wedges.shape[1]:
                if best_only and x * y * z <= largest * load**3:
                    break
                least = np.inf
                for t in range(5):
                    if wedges[i, w, t, 3] > 0.0:
                        own = abs(wedges[i, w, t, 0]) * x
                        own += abs(wedges[i, w, t, 1]) * y
                        own += abs(wedges[i, w, t, 2]) * z
                        least = min(least, own / wedges[i, w, t, 3])
                        if least <= load:
                            break
                load = max(load, least)
                w += 1
            out[i, c] = 1.0 / load if w == wedges.shape[1] else 0.0
            largest = max(largest, x * y * z * out[i, c] ** 3)
