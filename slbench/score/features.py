"""Features fitted to measured points: steps, planes, spheres.

A plane or a sphere is fitted to the points of each certified feature, as one does with a real
artefact; no ground truth is needed.

Plane flatness, sphere form and size follow the *definitions* of VDI/VDE 2634-2 and
ISO 10360-13 (distance between the extreme residuals of a least-squares feature after 0.3 % of
the points have been set aside; least-squares diameter).  They are not an accredited procedure:
artefact, positions and number of repeats are the caller's.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.covariance import along_lines
from slbench.cloud.fits.squares import core
from slbench.objects import REFERENCE, Artefact, PlaneFeature, SphereFeature
from slbench.rig import Pose, Rig
from slbench.rig.pose import product
from slbench.score.levels import parallel_heights
from slbench.score.residuals import MIN_POINTS, facing, spread, trimmed_range
from slbench.score.surfaces import Marked, fit_surfaces
from slbench.score.values import FeatureScore, PlaneScore, SpacingScore, SphereScore, StepScore

Array = NDArray[np.float64]

#: Where a sphere turns further than this from a device, its points are not fitted: the pixel's
#: footprint there is long, its light faint, and half of it may see the background.
MAX_INCIDENCE = np.deg2rad(60.0)


def fit_features(
    points: Array,
    artefact: Artefact,
    pose: Pose,
    lines: NDArray[np.integer] | None = None,
    rig: Rig | None = None,
    smooth: NDArray[np.bool_] | None = None,
    level: bool = False,
    stripes: bool = False,
) -> list[FeatureScore]:
    """Fit an artefact's features to measured points; no ground truth needed.

    Parameters
    ----------
    points : (N, 3) float
        World coordinates, mm, of points on the artefact.
    artefact : Artefact
    pose : Pose
        Where the artefact is; good to a fraction of the features' margins.
    lines : (N,) int, optional
        Image line of each point (its column, where columns are coded): errors go together
        along a line and from one line to the next.  Without it, points are independent.
    rig : Rig, optional
        So that round surfaces are fitted where they face both devices.
    smooth : (N,) bool, optional
        Points whose neighbours lie on the same smooth surface.  The others serve edges alone
        (circles), which lie between them; without it all points serve both.
    level : bool
        Whether steps are the distances of parallel planes instead of heights along the object's z:
        for a pose that was found by the points themselves (:mod:`slbench.score.levels`).
    stripes : bool
        Without `lines`: whether errors go together along stripes across each feature
        (:func:`slbench.score.residuals.stripes_of`), as those of real clouds do.

    Returns
    -------
    list of StepScore, PlaneScore, SphereScore, SpacingScore
        And CylinderScore, ConeScore, CircleScore, DimensionScore for what the artefact's file
        declares.  Features with fewer than 20 points are left out.  Points further than six robust
        standard deviations from the rest take no part in a fit; they do count as form.
    """
    edges = Marked(points, pose.to_local(points), lines, stripes)
    inner = edges if smooth is None else edges.of(np.flatnonzero(smooth))
    points, local = inner.points, inner.local
    found: list[FeatureScore] = []
    planes: dict[str, _Plane] = {}
    flat: dict[str, NDArray[np.intp]] = {}
    labels: dict[str, NDArray[np.integer]] = {}
    before = 0
    for face in artefact.planes:
        over = points_over(artefact, face, local)
        if len(over) >= MIN_POINTS:
            own = inner.labels(over)
            plane = planes[face.name] = _Plane.fit(face, local[over], own)
            flat[face.name] = over[plane.inliers]
            # Stripes are each face's own, image lines go on from face to face.
            labels[face.name] = own[plane.inliers] + before
            if inner.lines is None:
                before += int(own.max()) + 1
            found.append(planes[face.name].flatness(artefact.name))
    base = planes.get(REFERENCE)
    if base is not None:
        steps = [plane.step(artefact.name, base) for plane in planes.values()]
        if level:
            faces = [local[over] for over in flat.values()]
            of = list(labels.values()), list(planes).index(REFERENCE)
            heights, variances = parallel_heights(faces, *of)
            steps = [
                replace(step, measured_mm=float(height), uncertainty_mm=float(np.sqrt(variance)))
                for step, height, variance in zip(steps, heights, variances, strict=True)
            ]
        found += [step for step in steps if step.name != REFERENCE]
    balls: list[_Ball] = []
    for sphere in artefact.spheres:
        near = points_near(sphere, local)
        if rig is not None:
            outward = local[near] - np.array(sphere.centre_mm)
            normals = product(outward, pose.rotation.T)
            near = near[facing(rig, points[near], normals, MAX_INCIDENCE)]
        if len(near) >= MIN_POINTS:
            balls.append(_Ball.fit(sphere, local[near], inner.labels(near)))
    found += [ball.score(artefact.name) for ball in balls]
    found += [a.spacing(artefact.name, b) for a, b in itertools.combinations(balls, 2)]
    return found + fit_surfaces(artefact, inner, edges, pose, rig)


def points_over(
    artefact: Artefact, face: PlaneFeature, local: Array, *, everywhere: bool = False
) -> NDArray[np.intp]:
    """Return the indices of points (N, 3), object frame, of a face's interior, or of its level."""
    over = np.arange(len(local)) if everywhere else np.flatnonzero(face.contains(local))
    # Gross errors of the fringe order are far off the face.
    return over[np.abs(local[over, 2] - face.z_mm) < _reach(artefact, face)]


def points_near(sphere: SphereFeature, local: Array) -> NDArray[np.intp]:
    """Return the indices of points (N, 3), object frame, that are near a sphere."""
    radial = np.linalg.norm(local - np.array(sphere.centre_mm), axis=-1) - sphere.radius_mm
    return np.flatnonzero(np.abs(radial) < 0.2 * sphere.radius_mm)


def _reach(artefact: Artefact, feature: PlaneFeature) -> float:
    """Return how far from a face its points may lie: half way to the next level."""
    others = [abs(p.z_mm - feature.z_mm) for p in artefact.planes]
    # Faces at one height (the pins of a brick) do not limit one another.
    return 0.5 * min((gap for gap in others if gap > 1e-9), default=np.inf)


@dataclass(frozen=True)
class _Plane:
    """Least-squares plane through the inliers of one face's points, in the object frame.

    ``height_mm`` is its z over the middle of the face's interior, ``variance_mm2`` the
    variance of that; the residuals are those of all points.
    """

    face: PlaneFeature
    height_mm: float
    variance_mm2: float
    residuals: Array
    inliers: NDArray[np.bool_]

    @classmethod
    def fit(cls, face: PlaneFeature, points: Array, labels: NDArray[np.integer]) -> _Plane:
        kept = core(points[:, 2])
        middle = np.array([np.mean(face.x_mm), np.mean(face.y_mm)])
        design = np.column_stack((np.ones(len(points)), points[:, :2] - middle))
        inner = design if kept.all() else design[kept]
        # Three columns of some millimetres about the middle: well conditioned.
        coefficients = np.linalg.solve(inner.T @ inner, inner.T @ points[kept, 2])
        residuals = points[:, 2] - product(design, coefficients)
        covariance = along_lines(inner, residuals[kept], labels[kept])
        normal = residuals / np.sqrt(1.0 + np.sum(coefficients[1:] ** 2))
        return cls(face, float(coefficients[0]), float(covariance[0, 0]), normal, kept)

    def flatness(self, owner: str) -> PlaneScore:
        return PlaneScore(
            owner,
            self.face.name,
            trimmed_range(self.residuals),
            spread(self.residuals[self.inliers], 3),
            len(self.residuals),
        )

    def step(self, owner: str, base: _Plane) -> StepScore:
        return StepScore(
            owner,
            self.face.name,
            self.face.height_mm,
            self.height_mm - base.height_mm,
            spread(self.residuals[self.inliers], 3),
            float(np.sqrt(self.variance_mm2 + base.variance_mm2)),
            len(self.residuals),
        )


def fit_sphere(points: Array) -> tuple[Array, float, Array, Array]:
    """Fit a sphere by geometric least squares (Gauss-Newton on the radial residuals).

    Parameters
    ----------
    points : (N, 3) float

    Returns
    -------
    centre : (3,) float
    radius : float
    residuals : (N,) float
        Distance from the centre minus the radius.
    jacobian : (N, 4) float
        Derivative of the residuals by centre and radius.
    """
    # Start from the algebraic fit |p|^2 = 2 c.p + (r^2 - |c|^2).
    offset = points.mean(axis=0)
    p = points - offset
    design = np.column_stack((2.0 * p, np.ones(len(p))))
    solution, *_ = np.linalg.lstsq(design, np.sum(p * p, axis=-1), rcond=None)
    centre = solution[:3]
    radius = float(np.sqrt(max(solution[3] + centre @ centre, 0.0)))
    for _ in range(50):
        toward = p - centre
        distance = np.linalg.norm(toward, axis=-1)
        jacobian = np.column_stack((-toward / distance[:, None], -np.ones(len(p))))
        step, *_ = np.linalg.lstsq(jacobian, radius - distance, rcond=None)
        centre = centre + step[:3]
        radius += float(step[3])
        if np.max(np.abs(step)) < 1e-12 * max(radius, 1.0):
            break
    residuals = np.linalg.norm(p - centre, axis=-1) - radius
    return centre + offset, radius, residuals, jacobian


@dataclass(frozen=True)
class _Ball:
    """Least-squares sphere through the inliers of one sphere's points, in the object frame.

    ``covariance`` (4, 4) is that of centre and radius; the residuals are those of all points.
    """

    sphere: SphereFeature
    centre: Array
    radius: float
    covariance: Array
    residuals: Array
    std: float

    @classmethod
    def fit(cls, sphere: SphereFeature, points: Array, labels: NDArray[np.integer]) -> _Ball:
        kept = core(np.linalg.norm(points - np.array(sphere.centre_mm), axis=-1))
        centre, radius, inner, jacobian = fit_sphere(points[kept])
        covariance = along_lines(jacobian, inner, labels[kept])
        residuals = np.linalg.norm(points - centre, axis=-1) - radius
        return cls(sphere, centre, radius, covariance, residuals, spread(inner, 4))

    def score(self, owner: str) -> SphereScore:
        return SphereScore(
            owner,
            self.sphere.name,
            self.sphere.radius_mm,
            self.radius,
            float(np.sqrt(self.covariance[3, 3])),
            float(np.linalg.norm(self.centre - np.array(self.sphere.centre_mm))),
            trimmed_range(self.residuals),
            self.std,
            len(self.residuals),
        )

    def spacing(self, owner: str, other: _Ball) -> SpacingScore:
        nominal = np.array(other.sphere.centre_mm) - np.array(self.sphere.centre_mm)
        between = other.centre - self.centre
        distance = float(np.linalg.norm(between))
        along = between / distance
        variance = along @ (self.covariance + other.covariance)[:3, :3] @ along
        return SpacingScore(
            owner,
            f"{self.sphere.name} to {other.sphere.name}",
            float(np.linalg.norm(nominal)),
            distance,
            float(np.sqrt(variance)),
        )
