"""Circular edges from points: where the points of a flat face end.

No point lies on an edge: pixels do not stop there.  But the face's points end at it, and a sector
of the band along the edge holds as many as its free area is large.  With the density of the band's
outer half the area tells the radius at which the face ends, whatever the pattern of the points,
regular or not; counting, unlike the outermost point, is not late by half a spacing.

Which of the pixels that the edge crosses were measured depends on thresholds and on what lies
beyond: the edge may be off by up to half a spacing to either side, everywhere alike or on one side.
That stands in the uncertainty of radius and centre, spacing / sqrt(12) as of a uniform one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.geometry import frame
from slbench.objects import SurfaceFeature
from slbench.rig.pose import product
from slbench.score.residuals import MIN_POINTS

Array = NDArray[np.float64]

#: Sectors hold so many points of a full band, and are so many, at least and at most.
_POINTS, _FEWEST, _MOST = 25.0, 12, 90
#: A sector tells an edge where it and its neighbours hold this share of the median density.
_FULL = 0.5
#: Rounds in which the band follows the centre.
_ROUNDS = 3


def edge_points(surface: SurfaceFeature, points: Array) -> tuple[Array, float] | None:
    """Return places on a circular edge, one a sector, and the spacing of the face's points.

    Parameters
    ----------
    surface : SurfaceFeature
        A circle.
    points : (N, 3) float
        Of its flat face beside the edge, object frame.

    Returns
    -------
    (M, 3) float, float
        Or None where too little of the edge is covered by points.
    """
    circle = surface.element
    q = circle.local(points)
    on = np.abs(q[:, 2] - np.median(q[:, 2])) <= max(
        6.0 * 1.4826 * float(np.median(np.abs(q[:, 2] - np.median(q[:, 2])))), 1e-6
    )
    q = q[on]
    if len(q) < 4 * MIN_POINTS:
        return None
    level = _level(q)
    width = 0.8 * surface.margin_mm
    centre, radius = np.zeros(2), circle.radius
    found: tuple[Array, Array, float] | None = None
    for _ in range(_ROUNDS):
        found = _sectors(q[:, :2] - centre, radius, width, surface.sign)
        if found is None:
            return None
        radii, angle, _ = found
        ring = radii[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
        design = np.column_stack((np.cos(angle), np.sin(angle), np.ones(len(angle))))
        step = np.linalg.lstsq(design, radii - radius, rcond=None)[0]
        if np.linalg.norm(step) > 0.5 * width:
            return None  # not this edge
        flat = ring + centre
        centre, radius = centre + step[:2], radius + float(step[2])
    assert found is not None
    heights = level[0] + product(flat, level[1:])
    edge = product(np.column_stack((flat, heights)), frame(circle.direction).T)
    return edge + circle.point, found[2]


def _level(q: Array) -> Array:
    """Return height and slopes (3,) of the face's least-squares plane."""
    design = np.column_stack((np.ones(len(q)), q[:, :2]))
    return np.asarray(np.linalg.lstsq(design, q[:, 2], rcond=None)[0])


def _sectors(
    flat: Array, radius: float, width: float, sign: float
) -> tuple[Array, Array, float] | None:
    """Return the radius at which points end in each sector, its angle, and the spacing."""
    radial, angle = np.linalg.norm(flat, axis=1), np.arctan2(flat[:, 1], flat[:, 0])
    # The face is outside a bore's edge and inside a pin's: `sign` tells.
    far = radius - sign * width
    half = radius - sign * 0.5 * width
    low, high = min(far, half), max(far, half)
    outer = (radial >= low) & (radial <= high)
    area = np.pi * (high**2 - low**2)
    total = np.count_nonzero(outer)
    band = np.pi * abs(far**2 - radius**2)
    sectors = int(np.clip(total / area * band / _POINTS, _FEWEST, _MOST))
    index = np.minimum(((angle + np.pi) / (2.0 * np.pi) * sectors).astype(int), sectors - 1)
    count = np.bincount(index[outer], minlength=sectors).astype(float)
    # Few points a sector come and go by chance: to choose the fuller ones would bias the density.
    around = (np.roll(count, 1) + count + np.roll(count, -1)) / 3.0
    full = around >= _FULL * np.median(around)
    if total == 0 or np.count_nonzero(full) < max(_FEWEST // 2, sectors // 4):
        return None
    # Density over the sectors: a mean and what perspective and tilt change around the circle.
    turn = 2.0 * np.pi / sectors
    middle = -np.pi + turn * (np.arange(sectors) + 0.5)
    design = np.column_stack((np.ones(sectors), np.cos(middle), np.sin(middle)))[full]
    smooth = np.linalg.lstsq(design, count[full], rcond=None)[0]
    density = (design @ smooth) / (0.5 * turn * (high**2 - low**2))
    if not (density > 0.0).all():
        return None
    reached = (radial - far) * sign >= 0.0
    held = np.bincount(index[reached], minlength=sectors)[full]
    squared = far**2 + sign * 2.0 * held / (density * turn)
    if not (squared > 0.0).all():
        return None
    return np.sqrt(squared), middle[full], float(1.0 / np.sqrt(np.median(density)))
