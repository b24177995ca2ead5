"""Starting values of fits: elements through few points, judged by all of them.

Outliers do not pull.  Least median of squares (Rousseeuw, J. Am. Stat. Assoc. 79, 1984): of many
elements, each through as few points as it takes, the one with the smallest residual at a quantile
of the points.  A plane, a sphere and a circle in space follow from three or four points at once.
Cylinders and cones are linear once the axis has a direction: directions are tried over the
half-sphere, then ever closer to the best ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.geometry import Circle, Cone, Cylinder, Element, Plane, Sphere, frame
from slbench.rig.pose import product

Array = NDArray[np.float64]

#: Points that candidates are judged by, and candidates, in all and of each direction.
_POINTS, _TRIALS, _AXIS_TRIALS = 400, 300, 50
#: The share of points whose residual decides: two fifths may be wrong.
_SHARE = 0.6
#: Directions over the half-sphere, 0.2 rad apart; rounds of halving, and how many go on.
_DIRECTIONS, _SPACING, _ROUNDS, _BEST = 150, 0.2, 4, 6


def starts(kind: str, points: Array) -> list[Element]:
    """Return starting values for a fit, the likeliest first.

    Parameters
    ----------
    kind : {"plane", "sphere", "cylinder", "cone", "circle"}
    points : (N, 3) float
        At least as many as the element has parameters.
    """
    rng = np.random.default_rng(len(points))
    chosen = points
    if len(points) > _POINTS:
        chosen = points[rng.choice(len(points), _POINTS, replace=False)]
    middle = np.median(chosen, axis=0)
    local = chosen - middle
    if kind in ("cylinder", "cone"):
        found = _about_axes(kind, local, rng)
    else:
        found = _through_few(kind, local, rng)
    return [_shifted(element, middle) for element in found]


def _shifted(element: Element, by: Array) -> Element:
    return type(element)(element.point + by, element.direction, element.radius, element.half_angle)


def _drawn(rng: np.random.Generator, count: int, sets: int, each: int) -> NDArray[np.intp]:
    """Draw sets of different indices, (sets, each)."""
    return np.argsort(rng.random((sets, count)), axis=1)[:, :each]


def _through_few(kind: str, points: Array, rng: np.random.Generator) -> list[Element]:
    """Return the best planes, spheres or circles through three or four of the points."""
    each = 4 if kind == "sphere" else 3
    corners = points[_drawn(rng, len(points), _TRIALS, each)]
    found: list[Element] = []
    for some in corners:
        a, b, c = some[:3]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length <= 0.0:
            continue
        if kind == "plane":
            found.append(Plane(a, normal))
            continue
        # Equally far from all: 2 (p_i - a) . x = |p_i - a|^2, in the plane of three for a circle.
        sides = some[1:] - a
        right = 0.5 * np.sum(sides**2, axis=1)
        if kind == "circle":
            sides, right = np.vstack((sides, normal / length)), np.append(right, 0.0)
        try:
            centre = np.linalg.solve(sides, right)
        except np.linalg.LinAlgError:
            continue
        radius = float(np.linalg.norm(centre))
        found.append(
            Sphere(a + centre, radius=radius)
            if kind == "sphere"
            else Circle(a + centre, normal, radius)
        )
    scales = [_scale(np.abs(element.distances(points))) for element in found]
    return [found[i] for i in np.argsort(scales, kind="stable")[:_BEST]]


def _scale(distances: Array) -> float:
    """Return the residual that a share of the points keeps; infinite where it is not a number."""
    index = min(int(_SHARE * len(distances)), len(distances) - 1)
    value = float(np.partition(distances, index)[index])
    return value if np.isfinite(value) else np.inf


def _about_axes(kind: str, points: Array, rng: np.random.Generator) -> list[Element]:
    """Return the best cylinders or cones over directions of the axis."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(_DIRECTIONS)
    z = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    around = np.sqrt(1.0 - z**2)
    spread = np.column_stack((around * np.cos(turn), around * np.sin(turn), z))
    # A long part lies along, a short one across, the axes of its points' spread.
    principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    tried = [_about(kind, points, d, rng) for d in (*spread, *principal)]
    best = _best(tried)
    width = _SPACING
    for _ in range(_ROUNDS):
        width /= 2.0
        near = []
        for _, element in best:
            axes = frame(element.direction)
            for angle in np.arange(8) * (np.pi / 4.0):
                across = np.array([np.cos(angle), np.sin(angle), 0.0])
                direction = element.direction + np.tan(width) * (axes @ across)
                near.append(_about(kind, points, direction, rng))
        best = _best([*best, *near])
    return [element for _, element in best]


_Candidate = tuple[float, Element]


def _best(candidates: list[_Candidate | None]) -> list[_Candidate]:
    known = [candidate for candidate in candidates if candidate is not None]
    return sorted(known, key=lambda candidate: candidate[0])[:_BEST]


def _about(
    kind: str, points: Array, direction: Array, rng: np.random.Generator
) -> _Candidate | None:
    """Return the best cylinder or cone about a direction through few points, and its scale."""
    direction = direction / np.linalg.norm(direction)
    axes = frame(direction)
    q = product(points, axes)
    # x^2 + y^2 = 2 a x + 2 b y + c (+ d z + e z^2): linear in the centre and the profile.
    columns = [q[:, 0], q[:, 1], np.ones(len(q))]
    if kind == "cone":
        columns += [q[:, 2], q[:, 2] ** 2]
    design = np.stack(columns, axis=-1)
    drawn = _drawn(rng, len(q), _AXIS_TRIALS, design.shape[1])
    matrix, right = design[drawn], np.sum(q[drawn, :2] ** 2, axis=-1)
    regular = np.abs(np.linalg.det(matrix)) > 1e-12 * np.prod(np.abs(design).max(axis=0))
    if not regular.any():
        return None
    solution = np.linalg.solve(matrix[regular], right[regular][..., None])[..., 0]
    centre = 0.5 * solution[:, :2]
    squared = solution[:, 2] + np.sum(centre**2, axis=1)
    kept = squared > 0.0
    if not kept.any():
        return None
    centre, radius = centre[kept], np.sqrt(squared[kept])
    slope = np.zeros(len(centre))
    if kind == "cone":
        # (r + t z)^2 tells the slope twice: by 2 r t better on frusta, by t^2 near the apex.
        steep = np.sqrt(np.maximum(solution[kept, 4], 0.0)) * np.sign(solution[kept, 3])
        slope = np.concatenate((solution[kept, 3] / (2.0 * radius), steep))
        centre, radius = np.tile(centre, (2, 1)), np.tile(radius, 2)
    away = np.linalg.norm(q[None, :, :2] - centre[:, None], axis=-1)
    profile = radius[:, None] + slope[:, None] * q[None, :, 2]
    off = np.abs(away - profile) / np.sqrt(1.0 + slope[:, None] ** 2)
    index = min(int(_SHARE * len(q)), len(q) - 1)
    scale = np.partition(off, index, axis=1)[:, index]
    k = int(np.argmin(scale))
    point = axes[:, :2] @ centre[k]
    if kind == "cylinder":
        return float(scale[k]), Cylinder(point, direction, radius[k])
    along = direction if slope[k] > 0 else -direction
    return float(scale[k]), Cone(point, along, radius[k], float(np.arctan(abs(slope[k]))))
