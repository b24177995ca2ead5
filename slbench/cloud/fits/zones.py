"""Minimum zones: the narrowest zone between two equidistant surfaces that holds all points.

Form errors in the sense of ISO 1101: flatness, roundness, cylindricity.  The flatness zone is
exact: its planes touch the points' convex hull at a facet and a vertex, or at two edges (Houle and
Toussaint, "Computing the width of a set", IEEE Trans. Pattern Anal. 10, 1988).  For the others a
linear programme finds the parameters that make the largest distance smallest, about the element as
it stands, until that is the element itself; form errors are so small against the size that a few
rounds do.  The programme sees few points: the extreme ones, and those a solution leaves outside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.cloud.fits.geometry import Circle, Element, Plane, frame
from slbench.cloud.fits.squares import fit_element
from slbench.core.errors import InputError
from slbench.rig.pose import product

Array = NDArray[np.float64]

#: Rounds of linear programmes, and points that the first of them sees at either side.
_ROUNDS, _EXTREMES = 60, 60
#: Pairs of edges that are looked at together.
_PAIRS = 1 << 20


def minimum_zone(element: Element, points: ArrayLike) -> tuple[Element, float]:
    """Return the element in the middle of the narrowest zone that holds points, and its width.

    Parameters
    ----------
    element : Element
        Near the points: their least-squares element.  Of a circle the zone is a ring in its
        plane, whatever the points' heights above it.
    points : (N, 3) array_like
        mm.  Every point counts: gross errors must have been taken out.

    Returns
    -------
    element : Element
    width : float
        mm; the flatness of a plane, the roundness of a circle, the cylindricity of a cylinder.

    Raises
    ------
    InputError
        For fewer points than parameters.

    Examples
    --------
    >>> from slbench.cloud.fits import Plane, minimum_zone
    >>> corners = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [10, 10, 0.4]]
    >>> print(f"{minimum_zone(Plane([0, 0, 0], [0, 0, 1]), corners)[1]:.4f}")
    0.1999
    """
    array = np.asarray(points, dtype=np.float64)
    if len(array) <= element.least:
        expected = f"more than {element.least} points"
        raise InputError(f"minimum zone of a {element.kind}", expected, len(array))
    if isinstance(element, Plane):
        return _slab(element, array)
    return _shell(element, array)


# -- flatness, exactly -------------------------------------------------------------------------


def _slab(plane: Plane, points: Array) -> tuple[Plane, float]:
    from scipy.spatial import ConvexHull, QhullError

    middle = points.mean(axis=0)
    axes = frame(plane.direction)
    q = product(points - middle, axes)
    scale = max(float(np.ptp(q[:, :2], axis=0).max()), 1e-300)
    # Drawn out along the normal: Qhull joins what a thin slab's thickness does not tell apart.
    thickness = float(np.ptp(q[:, 2]))
    if thickness < 1e-13 * scale:
        return _between(plane, points, plane.direction)
    stretch = np.array([1.0, 1.0, scale / thickness])
    try:
        hull = ConvexHull(q * stretch)
    except QhullError:  # all in one plane, or on a line
        fit = fit_element("plane", points, start=plane).element
        return _between(plane, points, fit.direction)
    # Planes stay planes: facets and edges of the drawn hull are those of the hull.
    corners = q[hull.vertices]
    normals = hull.equations[:, :3] * stretch
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    edges, left, right = _edges(hull.simplices, hull.neighbors)
    # A direction of less width than this one's is no further from it than the slab is steep.
    bound = float(np.ptp(corners[:, 2]))
    candidates = np.vstack((normals, _antipodal(q[edges], normals[left], normals[right])))
    best, width = plane.direction, bound
    for first in range(0, len(candidates), 4096):
        part = candidates[first : first + 4096]
        widths = np.ptp(corners @ part.T, axis=0)
        k = int(np.argmin(widths))
        if widths[k] < width:
            best, width = axes @ part[k], float(widths[k])
    return _between(plane, points, best)


def _between(plane: Plane, points: Array, direction: Array) -> tuple[Plane, float]:
    """Return the plane half way between the extremes along a direction, and their distance."""
    direction = direction if direction @ plane.direction >= 0.0 else -direction
    heights = product(points - plane.point, direction)
    centre = plane.point + 0.5 * (heights.max() + heights.min()) * direction
    return Plane(centre, direction).at(plane.point), float(np.ptp(heights))


def _edges(
    simplices: NDArray[np.integer], neighbours: NDArray[np.integer]
) -> tuple[NDArray[np.integer], NDArray[np.integer], NDArray[np.integer]]:
    """Return the edges (e, 2) of a hull and the facets on either side of each."""
    facet = np.repeat(np.arange(len(simplices)), 3)
    other = neighbours.ravel()
    opposite = np.tile([[1, 2], [0, 2], [0, 1]], (len(simplices), 1))
    ends = np.take_along_axis(np.repeat(simplices, 3, axis=0), opposite, axis=1)
    once = facet < other
    return ends[once], facet[once], other[once]


def _antipodal(edges: Array, left: Array, right: Array) -> Array:
    """Return the common normals (m, 3) of edges (e, 2, 3) that two parallel planes can touch.

    The normals of the planes that touch an edge form an arc, from the normal of the facet on its
    left to that on its right.  Two edges are antipodal where the arc of one crosses the mirrored
    arc of the other.
    """
    # The edges of a slab whose planes can lie below it, and above it.
    low = np.minimum(left[:, 2], right[:, 2]) < 0.0
    high = np.maximum(left[:, 2], right[:, 2]) > 0.0
    along = edges[:, 1] - edges[:, 0]
    a, b, across = left[high], right[high], along[high]
    found = [np.empty((0, 3))]
    rows = max(1, _PAIRS // max(len(a), 1))
    lower = np.flatnonzero(low)
    for first in range(0, len(lower), rows):
        part = lower[first : first + rows]
        c, d, other = -left[part], -right[part], along[part]
        # Each great circle's pole is the edge's own direction; an arc crosses the other's circle
        # where its ends lie on either side of it.
        ends = (other @ a.T) * (other @ b.T) <= 0.0
        ends &= (c @ across.T) * (d @ across.T) <= 0.0
        i, j = np.nonzero(ends)
        normal = np.cross(other[i], across[j])
        length = np.linalg.norm(normal, axis=1)
        i, j, normal = i[length > 0.0], j[length > 0.0], normal[length > 0.0]
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        # The crossing, not its antipode, on both arcs.
        same = np.sign(np.sum(normal * (a[j] + b[j]), axis=1))
        alike = same == np.sign(np.sum(normal * (c[i] + d[i]), axis=1))
        found.append(normal[alike])
    return np.concatenate(found)


# -- others, by linear programmes ----------------------------------------------------------------


def _shell(element: Element, points: Array) -> tuple[Element, float]:
    middle = points.mean(axis=0)
    local = points - middle
    element = replace(element, point=element.point - middle)
    residual, jacobian = _rows(element, local)
    width = float(np.ptp(residual))
    for _ in range(_ROUNDS):
        step = _programme(residual, jacobian)
        size = 1.0
        while size > 1e-4:  # shorter where the surfaces bend too much
            trial = element.moved(_full(element, size * step))
            now, slope = _rows(trial, local)
            if float(np.ptp(now)) < width:
                break
            size /= 4.0
        else:
            break
        gained = width - float(np.ptp(now))
        element, residual, jacobian, width = trial, now, slope, float(np.ptp(now))
        if gained < 1e-12 * max(width, 1e-6):
            break
    if element.sized:  # a cone has its size in its place
        shift = 0.5 * float(residual.max() + residual.min())
        element = replace(element, radius=element.radius + shift / np.cos(element.half_angle))
    return replace(element, point=element.point + middle), width


def _rows(element: Element, points: Array) -> tuple[Array, Array]:
    """Return residuals and derivatives; of a circle by its centre in the plane and radius."""
    residual, jacobian = element.linearised(points)
    if isinstance(element, Circle):
        return residual[:, 0], jacobian[:, 0][:, [0, 1, 5]]
    return residual, jacobian


def _full(element: Element, step: Array) -> Array:
    if not isinstance(element, Circle):
        return step
    out = np.zeros(element.parameters())
    out[[0, 1, 5]] = step
    return out


def _programme(residual: Array, jacobian: Array) -> Array:
    """Return the step that makes the largest |residual + jacobian step| smallest."""
    from scipy.optimize import linprog

    order = np.argsort(residual)
    seen = np.zeros(len(residual), bool)
    seen[order[:_EXTREMES]] = seen[order[-_EXTREMES:]] = True
    seen[:: max(1, len(residual) // _EXTREMES)] = True
    scale = np.sqrt(np.mean(jacobian**2, axis=0))
    scale[scale == 0.0] = 1.0
    unit = max(float(np.abs(residual).max()), 1e-300)
    for _ in range(_ROUNDS):
        rows = jacobian[seen] / scale
        one = np.ones((len(rows), 1))
        # In units of the form error: HiGHS keeps constraints to 1e-7.
        solved = linprog(
            np.append(np.zeros(rows.shape[1]), 1.0),
            np.block([[rows, -one], [-rows, -one]]),
            np.concatenate((-residual[seen], residual[seen])) / unit,
            bounds=(None, None),
            method="highs",
        )
        if solved.status != 0:
            return np.zeros(jacobian.shape[1])
        step = solved.x[:-1] * unit / scale
        off = np.abs(residual + jacobian @ step)
        outside = off > solved.x[-1] * unit * (1.0 + 1e-7)
        outside &= ~seen
        if not outside.any():
            return step
        worst = np.argsort(np.where(outside, off, 0.0))[-_EXTREMES:]
        seen[worst[outside[worst]]] = True
    return step
