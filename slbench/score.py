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

from slbench.objects import Artefact, PlaneFeature, SphereFeature
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


@dataclass(frozen=True)
class StepScore:
    """Height of one step above the reference face, mm.

    ``measured_mm`` is the height of the step's least-squares plane over the reference's, at
    the middle of the step and along the reference's normal; ``std_mm`` the standard deviation
    of the step's points about their own plane; ``uncertainty_mm`` the standard uncertainty of
    the height that these two planes' scatter leaves.
    """

    name: str
    nominal_mm: float
    measured_mm: float
    std_mm: float
    uncertainty_mm: float
    points: int


@dataclass(frozen=True)
class PlaneScore:
    """Flatness of one plane: range of residuals, mm, 0.3 % of the points set aside."""

    name: str
    flatness_mm: float
    std_mm: float
    points: int


@dataclass(frozen=True)
class SphereScore:
    """Least-squares sphere, mm; `form_mm` is the range of residuals, 0.3 % set aside."""

    name: str
    nominal_radius_mm: float
    radius_mm: float
    radius_uncertainty_mm: float
    centre_error_mm: float
    form_mm: float
    std_mm: float
    points: int


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
) -> list[StepScore | PlaneScore | SphereScore]:
    """Fit the features of every object to the points that lie on it."""
    found: list[StepScore | PlaneScore | SphereScore] = []
    owner = truth.object_id[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    for k, item in enumerate(objects):
        chosen = owner == k
        found += fit_features(
            cloud.points[chosen], item.artefact, item.pose, cloud.sigma_mm[chosen]
        )
    return found


def fit_features(
    points: Array, artefact: Artefact, pose: Pose, sigma_mm: Array | None = None
) -> list[StepScore | PlaneScore | SphereScore]:
    """Fit an artefact's features to measured points; no ground truth needed.

    Parameters
    ----------
    points : (N, 3) float
        World coordinates, mm, of points on the artefact.
    artefact : Artefact
    pose : Pose
        Where the artefact is; good to a fraction of the features' margins.
    sigma_mm : (N, 3) float, optional
        Predicted standard deviations; without them uncertainties come from the residuals.

    Returns
    -------
    list of StepScore, PlaneScore, SphereScore
        Features with fewer than 20 points are left out.
    """
    local = pose.to_local(points)
    sigma = np.zeros_like(local) if sigma_mm is None else sigma_mm
    reference = artefact.reference
    planes: dict[str, _Plane] = {}
    for feature in artefact.planes:
        chosen = feature.contains(local)
        # A neighbour's points can lie over the face: a wall's, a shadow's.  Half the distance
        # to the next level would do; a twentieth of the artefact's height is tighter.
        near = np.abs(local[:, 2] - feature.z_mm) < _reach(artefact, feature)
        chosen &= near
        if np.count_nonzero(chosen) >= MIN_POINTS:
            planes[feature.name] = _Plane.fit(local[chosen])
    found: list[StepScore | PlaneScore | SphereScore] = [
        PlaneScore(name, _trimmed_range(plane.residuals), plane.std, len(plane.residuals))
        for name, plane in planes.items()
    ]
    base = planes.get(reference.name) if reference else None
    for feature in artefact.steps:
        plane = planes.get(feature.name)
        if base is None or plane is None:
            continue
        middle = np.array([np.mean(feature.x_mm), np.mean(feature.y_mm), 0.0])
        middle[2] = plane.height(middle)
        height = float((middle - base.centre) @ base.normal)
        found.append(
            StepScore(
                feature.name,
                feature.height_mm,
                height,
                plane.std,
                float(np.hypot(plane.uncertainty(middle), base.uncertainty(middle))),
                len(plane.residuals),
            )
        )
    for sphere in artefact.spheres:
        centre = np.array(sphere.centre_mm)
        near = np.abs(np.linalg.norm(local - centre, axis=-1) - sphere.radius_mm)
        chosen = near < 0.2 * sphere.radius_mm
        if np.count_nonzero(chosen) >= MIN_POINTS:
            found.append(_score_sphere(sphere, local[chosen], sigma[chosen]))
    return found


def _reach(artefact: Artefact, feature: PlaneFeature) -> float:
    """Return how far from a face its points may lie: half way to the next level."""
    others = [abs(p.z_mm - feature.z_mm) for p in artefact.planes if p.name != feature.name]
    return 0.5 * min(others) if others else np.inf


@dataclass(frozen=True)
class _Plane:
    """Least-squares plane ``z = c0 + c1 (x - cx) + c2 (y - cy)`` with its covariance."""

    centre: Array
    slopes: Array
    residuals: Array
    covariance: Array

    @classmethod
    def fit(cls, points: Array) -> _Plane:
        centre = points.mean(axis=0)
        x, y, z = (points - centre).T
        design = np.column_stack((np.ones_like(x), x, y))
        inverse = np.linalg.inv(design.T @ design)
        coefficients = inverse @ (design.T @ z)
        residuals = z - design @ coefficients
        variance = float(residuals @ residuals) / max(len(z) - 3, 1)
        centre = centre + np.array([0.0, 0.0, coefficients[0]])
        tilt = 1.0 / np.sqrt(1.0 + coefficients[1] ** 2 + coefficients[2] ** 2)
        return cls(centre, coefficients[1:], residuals * tilt, inverse * variance)

    @property
    def normal(self) -> Array:
        n = np.array([-self.slopes[0], -self.slopes[1], 1.0])
        return n / np.linalg.norm(n)

    @property
    def std(self) -> float:
        return float(np.sqrt(np.sum(self.residuals**2) / max(len(self.residuals) - 3, 1)))

    def height(self, point: Array) -> float:
        """Return the plane's z over a point's x and y."""
        return float(self.centre[2] + self.slopes @ (point[:2] - self.centre[:2]))

    def uncertainty(self, point: Array) -> float:
        """Return the standard uncertainty of the plane's z over a point."""
        row = np.concatenate(([1.0], point[:2] - self.centre[:2]))
        return float(np.sqrt(row @ self.covariance @ row))


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
    covariance : (4, 4) float
        Of centre and radius, from the residuals' variance.
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
        step, *_ = np.linalg.lstsq(jacobian, -(distance - radius), rcond=None)
        centre = centre + step[:3]
        radius += float(step[3])
        if np.max(np.abs(step)) < 1e-12 * max(radius, 1.0):
            break
    residuals = np.linalg.norm(p - centre, axis=-1) - radius
    variance = float(residuals @ residuals) / max(len(p) - 4, 1)
    return centre + offset, radius, residuals, np.linalg.inv(jacobian.T @ jacobian) * variance


def _score_sphere(sphere: SphereFeature, points: Array, sigma: Array) -> SphereScore:
    centre, radius, residuals, covariance = fit_sphere(points)
    return SphereScore(
        sphere.name,
        sphere.radius_mm,
        radius,
        float(np.sqrt(covariance[3, 3])),
        float(np.linalg.norm(centre - np.array(sphere.centre_mm))),
        _trimmed_range(residuals),
        float(np.sqrt(np.sum(residuals**2) / max(len(residuals) - 4, 1))),
        len(points),
    )


def _trimmed_range(residuals: Array) -> float:
    """Range of the residuals after the 0.3 % furthest from zero have been set aside."""
    kept = np.sort(np.abs(residuals)).size - int(np.ceil(SET_ASIDE * residuals.size))
    order = np.argsort(np.abs(residuals))[: max(kept, 1)]
    return float(np.ptp(residuals[order]))


def _mean(values: Array) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _median(values: Array) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _ratio(part: int, whole: int) -> float:
    return float(part) / float(whole) if whole else float("nan")
