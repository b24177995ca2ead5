"""Scores: how far a point cloud is from the truth, and what it says of known features.

Point errors are taken pixel by pixel: the point measured at a pixel against the point that
the pixel's centre ray truly meets.  Features (steps, planes, spheres) are fitted to the
measured points alone, as one does with a real artefact; they need no ground truth.

Plane flatness, sphere form and spacing follow the *definitions* of VDI/VDE 2634-2 and
ISO 10360-13 (distance between the extreme residuals of a least-squares feature after 0.3 % of
the points have been set aside; least-squares diameter).  They are not an accredited procedure:
artefact, positions and number of repeats are the caller's.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.objects import REFERENCE, Artefact, PlaneFeature, SphereFeature
from slbench.patterns import PhaseMap
from slbench.reconstruct import PointCloud
from slbench.rig import Pose
from slbench.scene import SceneObject
from slbench.truth import GroundTruth

Array = NDArray[np.float64]

#: Share of points set aside before form is taken (VDI/VDE 2634-2).
SET_ASIDE = 0.003
#: Fewer points than this carry no feature.
MIN_POINTS = 20
#: A point further off than this many predicted standard deviations of all points (robust) is
#: an outlier: beyond 6 sigma a Gaussian has two in a billion.
OUTLIER_SIGMAS = 6.0
#: How often the points set aside are chosen anew; after three the radius stands to 0.01 um.
_REFITS = 3


@dataclass(frozen=True)
class StepScore:
    """Height of one step above the reference face, mm.

    ``measured_mm`` is the difference between the least-squares planes of step and reference,
    each taken over the middle of its own face, along the object's z axis (thesis 6.2.3: the
    block is aligned with the stage); ``std_mm`` the standard deviation of the step's points
    about their plane; ``uncertainty_mm`` the standard uncertainty of the height that the
    points' scatter leaves.
    """

    object: str
    name: str
    nominal_mm: float
    measured_mm: float
    std_mm: float
    uncertainty_mm: float
    points: int


@dataclass(frozen=True)
class PlaneScore:
    """Flatness of one plane: range of residuals, mm, 0.3 % of the points set aside."""

    object: str
    name: str
    flatness_mm: float
    std_mm: float
    points: int


@dataclass(frozen=True)
class SphereScore:
    """Least-squares sphere, mm, through the points that are left once 0.3 % are set aside.

    ``form_mm`` is the range of their residuals.
    """

    object: str
    name: str
    nominal_radius_mm: float
    radius_mm: float
    radius_uncertainty_mm: float
    centre_error_mm: float
    form_mm: float
    std_mm: float
    points: int


FeatureScore = StepScore | PlaneScore | SphereScore


@dataclass(frozen=True)
class Score:
    """Errors of a scan.

    Errors in mm are over all measured pixels that truth says are lit, edges included; z is
    the world's height.  ``completeness`` is the share of lit pixels that were measured,
    ``false_points`` the number measured where truth says no light falls.
    """

    points: int
    completeness: float
    false_points: int
    outliers: int
    bias_z_mm: float
    rms_z_mm: float
    rms_mm: float
    median_abs_mm: float
    mad_mm: float
    p95_abs_mm: float
    predicted_sigma_mm: float
    smooth_rms_mm: float
    smooth_bias_px: dict[str, float]
    smooth_rms_px: dict[str, float]
    steps: list[StepScore] = field(default_factory=list)
    planes: list[PlaneScore] = field(default_factory=list)
    spheres: list[SphereScore] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


def point_errors(cloud: PointCloud, truth: GroundTruth) -> Array:
    """Return measured minus true point, (N, 3), mm; NaN where truth has no lit point."""
    rows, columns = cloud.pixels[:, 1], cloud.pixels[:, 0]
    error = cloud.points - truth.point[rows, columns]
    error[~truth.lit[rows, columns]] = np.nan
    return error


def score(
    cloud: PointCloud,
    truth: GroundTruth,
    phase: PhaseMap,
    objects: tuple[SceneObject, ...] = (),
) -> Score:
    """Score a point cloud against exact truth.

    Parameters
    ----------
    cloud : PointCloud
    truth : GroundTruth
        Of the same camera.
    phase : PhaseMap
        What the cloud was triangulated from.
    objects : tuple of SceneObject
        Whose features are fitted.

    Returns
    -------
    Score
        Numbers are NaN where nothing was measured.
    """
    error = point_errors(cloud, truth)
    lit = np.isfinite(error[:, 0])
    distance = np.linalg.norm(error[lit], axis=-1)
    z = error[lit, 2]
    smooth = truth.smooth()
    in_smooth = smooth[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    panel = {axis: phase.coordinate[axis] - truth.panel[..., k] for k, axis in _axes(phase)}
    residual_px = {axis: values[smooth & phase.mask] for axis, values in panel.items()}
    median = _median(z)
    mad = _median(np.abs(z - median))
    # 1.4826 MAD estimates the standard deviation of a Gaussian core.
    limit = OUTLIER_SIGMAS * max(1.4826 * mad, 1e-12)
    features = _features(cloud, truth, objects)
    return Score(
        points=len(cloud),
        completeness=_ratio(np.count_nonzero(lit), np.count_nonzero(truth.lit)),
        false_points=int(np.count_nonzero(~lit)),
        outliers=int(np.count_nonzero(np.abs(z - median) > limit)),
        bias_z_mm=_mean(z),
        rms_z_mm=_rms(z),
        rms_mm=_rms(distance),
        median_abs_mm=_median(distance),
        mad_mm=mad,
        p95_abs_mm=float(np.percentile(distance, 95)) if distance.size else float("nan"),
        predicted_sigma_mm=_median(cloud.sigma_total_mm),
        smooth_rms_mm=_rms(np.linalg.norm(error[lit & in_smooth], axis=-1)),
        smooth_bias_px={axis: _mean(values) for axis, values in residual_px.items()},
        smooth_rms_px={axis: _rms(values) for axis, values in residual_px.items()},
        steps=[f for f in features if isinstance(f, StepScore)],
        planes=[f for f in features if isinstance(f, PlaneScore)],
        spheres=[f for f in features if isinstance(f, SphereScore)],
    )


def _axes(phase: PhaseMap) -> list[tuple[int, Any]]:
    return [("uv".index(axis), axis) for axis in phase.coordinate]


def _features(
    cloud: PointCloud, truth: GroundTruth, objects: tuple[SceneObject, ...]
) -> list[FeatureScore]:
    """Fit the features of every object to the points that lie on it."""
    found: list[FeatureScore] = []
    owner = truth.object_id[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    # What a projector's square pixels do to the phase is the same all along a panel line, so
    # errors go together along the camera line that follows it.
    line = cloud.pixels[:, 0 if "u" in cloud.axes else 1]
    for k, item in enumerate(objects):
        chosen = owner == k
        found += fit_features(cloud.points[chosen], item.artefact, item.pose, line[chosen])
    return found


def fit_features(
    points: Array, artefact: Artefact, pose: Pose, groups: NDArray[np.integer] | None = None
) -> list[FeatureScore]:
    """Fit an artefact's features to measured points; no ground truth needed.

    Parameters
    ----------
    points : (N, 3) float
        World coordinates, mm, of points on the artefact.
    artefact : Artefact
    pose : Pose
        Where the artefact is; good to a fraction of the features' margins.
    groups : (N,) int, optional
        Points of one group have errors that go together (e.g. those of one image column);
        without them every point is its own.

    Returns
    -------
    list of StepScore, PlaneScore, SphereScore
        Features with fewer than 20 points are left out.  Uncertainties are cluster-robust:
        they allow for any correlation within a group (Liang and Zeger, Biometrika 73, 1986).
    """
    local = pose.to_local(points)
    labels = np.arange(len(local)) if groups is None else np.asarray(groups)
    faces: list[PlaneFeature] = []
    chosen: list[NDArray[np.bool_]] = []
    for feature in artefact.planes:
        over = feature.contains(local)
        # Gross errors of the fringe order would tilt the plane; they are far off the face.
        over &= np.abs(local[:, 2] - feature.z_mm) < _reach(artefact, feature)
        if np.count_nonzero(over) >= MIN_POINTS:
            faces.append(feature)
            chosen.append(over)
    planes = {
        face.name: _Plane.fit(face, local[over], labels[over])
        for face, over in zip(faces, chosen, strict=True)
    }
    found: list[FeatureScore] = [plane.flatness(artefact.name) for plane in planes.values()]
    base = planes.get(REFERENCE)
    if base is not None:
        steps = (planes[face.name] for face in faces if face.name != REFERENCE)
        found += [plane.step(artefact.name, base) for plane in steps]
    for sphere in artefact.spheres:
        distance = np.linalg.norm(local - np.array(sphere.centre_mm), axis=-1)
        near = np.abs(distance - sphere.radius_mm) < 0.2 * sphere.radius_mm
        if np.count_nonzero(near) >= MIN_POINTS:
            found.append(_score_sphere(artefact.name, sphere, local[near], labels[near]))
    return found


def _reach(artefact: Artefact, feature: PlaneFeature) -> float:
    """Return how far from a face its points may lie: half way to the next level."""
    others = [abs(p.z_mm - feature.z_mm) for p in artefact.planes if p.name != feature.name]
    return 0.5 * min(others) if others else np.inf


@dataclass(frozen=True)
class _Plane:
    """Least-squares plane through the points of one face, in the object frame.

    ``height_mm`` is its z over the middle of the face's interior, ``variance_mm2`` the
    variance of that.
    """

    face: PlaneFeature
    height_mm: float
    variance_mm2: float
    residuals: Array

    @classmethod
    def fit(cls, face: PlaneFeature, points: Array, labels: NDArray[np.integer]) -> _Plane:
        middle = np.array([np.mean(face.x_mm), np.mean(face.y_mm)])
        design = np.column_stack((np.ones(len(points)), points[:, :2] - middle))
        coefficients, *_ = np.linalg.lstsq(design, points[:, 2], rcond=None)
        residuals = points[:, 2] - design @ coefficients
        covariance = _clustered_covariance(design, residuals, labels)
        normal = residuals / np.sqrt(1.0 + np.sum(coefficients[1:] ** 2))
        return cls(face, float(coefficients[0]), float(covariance[0, 0]), normal)

    def flatness(self, owner: str) -> PlaneScore:
        return PlaneScore(
            owner,
            self.face.name,
            _trimmed_range(self.residuals),
            _spread(self.residuals, 3),
            len(self.residuals),
        )

    def step(self, owner: str, base: _Plane) -> StepScore:
        return StepScore(
            owner,
            self.face.name,
            self.face.height_mm,
            self.height_mm - base.height_mm,
            _spread(self.residuals, 3),
            float(np.sqrt(self.variance_mm2 + base.variance_mm2)),
            len(self.residuals),
        )


def _clustered_covariance(jacobian: Array, residuals: Array, labels: NDArray) -> Array:
    """Covariance of least-squares coefficients, robust to correlation within groups."""
    _, group = np.unique(labels, return_inverse=True)
    scores = np.zeros((group.max() + 1, jacobian.shape[1]))
    np.add.at(scores, group, jacobian * residuals[:, None])
    bread = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    n, k, g = len(residuals), jacobian.shape[1], len(scores)
    correction = g / max(g - 1, 1) * (n - 1) / max(n - k, 1)
    return correction * bread @ (scores.T @ scores) @ bread


def _spread(residuals: Array, fitted: int) -> float:
    """Return the standard deviation of residuals after `fitted` parameters were taken from them."""
    return float(np.sqrt(np.sum(residuals**2) / max(len(residuals) - fitted, 1)))


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


def _score_sphere(
    name: str, sphere: SphereFeature, points: Array, labels: NDArray[np.integer]
) -> SphereScore:
    # At the rim a pixel sees sphere and background; a handful of such points, millimetres
    # off, would decide the radius.
    kept = np.arange(len(points))
    for _ in range(_REFITS):
        centre, radius, _, _ = fit_sphere(points[kept])
        distance = np.abs(np.linalg.norm(points - centre, axis=-1) - radius)
        kept = np.argsort(distance)[: _n_kept(len(points))]
    centre, radius, residuals, jacobian = fit_sphere(points[kept])
    covariance = _clustered_covariance(jacobian, residuals, labels[kept])
    return SphereScore(
        name,
        sphere.name,
        sphere.radius_mm,
        radius,
        float(np.sqrt(covariance[3, 3])),
        float(np.linalg.norm(centre - np.array(sphere.centre_mm))),
        float(np.ptp(residuals)),
        _spread(residuals, 4),
        len(points),
    )


def _trimmed_range(residuals: Array) -> float:
    """Range of the residuals after the 0.3 % furthest from zero have been set aside."""
    order = np.argsort(np.abs(residuals))[: _n_kept(residuals.size)]
    return float(np.ptp(residuals[order]))


def _n_kept(points: int) -> int:
    """Return how many points remain after 0.3 % have been set aside."""
    return max(points - int(np.ceil(SET_ASIDE * points)), 1)


def _mean(values: Array) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _median(values: Array) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _ratio(part: Any, whole: Any) -> float:
    return float(part) / float(whole) if whole else float("nan")
