"""Bevelled edges: outlines moved inwards by the width of a flank, and the mitres between.

The top of a bevelled relief is its foot moved inwards (shapely's buffer with mitred joins,
which keeps straight edges parallel exactly and follows curves to 1 % of the distance).  Two
flanks meet in a mitre, a straight line from a corner of the foot to one of the top; points on
it make it an edge of the triangulation, so that no triangle spans two flanks.
"""

import dataclasses

import numpy as np
import scipy.spatial
import shapely
from numpy.typing import NDArray

from slbench.objects.parts.glyphs import Ring

#: Least turn at a point of an outline for a mitre: along curves flanks change gradually.
_LEAST_TURN = np.radians(15.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Bevel:
    """Top of a bevelled relief, and its mitres.

    Parameters
    ----------
    tops : list of shapely geometry
        Area of the top of each piece of relief, in the order given.
    rings_mm : list of (k, 2) ndarray of float
        Their outlines, without the last point repeated.
    mitres_mm : (n, 2) ndarray of float
        Points on the mitres, ends left out.
    shares : (n,) ndarray of float
        How far up from foot (0) to top (1) each of them lies.
    """

    tops: list[shapely.Geometry]
    rings_mm: list[Ring]
    mitres_mm: NDArray[np.float64]
    shares: NDArray[np.float64]


def bevelled(
    areas: list[shapely.Geometry], feet_mm: list[Ring], flank_mm: float, spacing_mm: float
) -> Bevel:
    """Bevel pieces of relief.

    Parameters
    ----------
    areas : list of shapely geometry
        Foot of each piece.
    feet_mm : list of (k, 2) ndarray of float
        All their outlines, the area to the left.
    flank_mm : float
        Width of the flanks, seen from above.
    spacing_mm : float
        Largest distance of neighbouring points of the top's outlines.

    Returns
    -------
    Bevel
        The top; empty where a piece is narrower than two flanks.
    """
    tops = [shapely.buffer(area, -flank_mm, join_style="mitre") for area in areas]
    rings: list[Ring] = []
    for polygon in shapely.get_parts(tops):
        for ring in (polygon.exterior, *polygon.interiors):
            rings.append(np.array(shapely.segmentize(ring, spacing_mm).coords)[:-1])
    points, shares = [np.empty((0, 2))], [np.empty(0)]
    if rings:
        edge = np.concatenate(rings)
        steps = np.concatenate([_shorter_side(ring) for ring in rings])
        finder = scipy.spatial.cKDTree(edge)
        for foot in feet_mm:
            places, parts = _mitres(foot, flank_mm, finder, steps)
            points.append(places)
            shares.append(parts)
    return Bevel(tops, rings, np.concatenate(points), np.concatenate(shares))


def _shorter_side(ring: Ring) -> NDArray[np.float64]:
    """Length of the shorter side at each point of a ring."""
    sides = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
    return np.minimum(sides, np.roll(sides, 1))


def _mitres(
    foot: Ring, flank: float, finder: scipy.spatial.cKDTree, top_steps: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points on the mitres of one outline, and how far up they lie."""
    after = np.roll(foot, -1, axis=0) - foot
    after /= np.linalg.norm(after, axis=1)[:, None]
    before = np.roll(after, 1, axis=0)
    turn = np.arctan2(
        before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1)
    )
    inwards = np.stack([-before[:, 1] - after[:, 1], before[:, 0] + after[:, 0]], axis=1)
    ends = foot + flank * inwards / (1.0 + (before * after).sum(axis=1))[:, None]
    distance, at = finder.query(ends)
    points, shares = [np.empty((0, 2))], [np.empty(0)]
    for i in np.flatnonzero((np.abs(turn) > _LEAST_TURN) & (distance < 1e-6 * flank)):
        length = np.linalg.norm(ends[i] - foot[i])
        # As far apart as the outline's points at the end where the angle is acute: then none
        # lies inside a circle on a side of the other (Gabriel's condition).
        convex = turn[i] > 0.0
        step = _shorter_side(foot)[i] if convex else top_steps[at[i]]
        share = step / length * np.arange(1, int(length / step - 0.5) + 1)
        shares.append(share if convex else 1.0 - share)
        points.append(foot[i] + shares[-1][:, None] * (ends[i] - foot[i]))
    return np.concatenate(points), np.concatenate(shares)
