"""Scores: how far a point cloud is from the truth, and what it says of known features.

Point errors are taken pixel by pixel: the point measured at a pixel against the point that
the pixel's centre ray truly meets.  Features are fitted to the measured points alone
(:mod:`slbench.score.features`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.squares import OUTLIER_SIGMAS
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError
from slbench.core.show.display import block, length, share
from slbench.core.show.document import Table
from slbench.core.validation.wording import shown
from slbench.patterns import PhaseMap
from slbench.rig import Rig
from slbench.scene.model import SceneObject
from slbench.scene.truth import GroundTruth
from slbench.score.features import fit_features
from slbench.score.values import (
    CircleScore,
    ConeScore,
    CylinderScore,
    DimensionScore,
    FeatureScore,
    PlaneScore,
    SpacingScore,
    SphereScore,
    StepScore,
)

Array = NDArray[np.float64]
_UM = 1e3
#: Lists of features of a score, and what is in each.
FEATURES: dict[str, type[FeatureScore]] = {
    "steps": StepScore,
    "planes": PlaneScore,
    "spheres": SphereScore,
    "spacings": SpacingScore,
    "cylinders": CylinderScore,
    "cones": ConeScore,
    "circles": CircleScore,
    "dimensions": DimensionScore,
}


@dataclass(frozen=True)
class Score:
    """Errors of a scan.

    Errors in mm are over all measured pixels that truth says are lit, edges included; z is
    the world's height.  ``completeness`` is the share of lit pixels that were measured,
    ``false_points`` the number measured where truth says no light falls.  ``predicted_sigma_mm`` is
    the median deviation by noise, ``predicted_u_mm`` the median uncertainty; ``coverage_1u`` to
    ``coverage_3u`` are the shares of errors on smooth surface, by world axis, that are at most one
    to three times the uncertainty (0.683, 0.954, 0.997 of a Gaussian).
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
    predicted_u_mm: float
    coverage_1u: float
    coverage_2u: float
    coverage_3u: float
    smooth_rms_mm: float
    smooth_bias_px: dict[str, float]
    smooth_rms_px: dict[str, float]
    steps: list[StepScore] = field(default_factory=list)
    planes: list[PlaneScore] = field(default_factory=list)
    spheres: list[SphereScore] = field(default_factory=list)
    spacings: list[SpacingScore] = field(default_factory=list)
    cylinders: list[CylinderScore] = field(default_factory=list)
    cones: list[ConeScore] = field(default_factory=list)
    circles: list[CircleScore] = field(default_factory=list)
    dimensions: list[DimensionScore] = field(default_factory=list)

    def __repr__(self) -> str:
        counts = {name: len(getattr(self, name)) for name in FEATURES}
        features = ", ".join(
            f"{count} {name if count > 1 else name[:-1]}" for name, count in counts.items() if count
        )
        return block(
            f"Score of {self.points} points: {share(self.completeness)} of the lit pixels, "
            f"{self.false_points} false, {self.outliers} outliers",
            f"distance from the truth: median {length(self.median_abs_mm)}, "
            f"RMS {length(self.rms_mm)}, 95 % within {length(self.p95_abs_mm)}",
            f"predicted from noise alone: {length(self.predicted_sigma_mm)}, from all that is "
            f"known: {length(self.predicted_u_mm)}",
            f"features: {features}" if features else "",
        )

    def _repr_html_(self) -> str:
        return Table("Score", ("quantity", "value"), tuple(self.rows()))._repr_html_()

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers of the whole cloud as they are shown, (quantity, value)."""
        return [
            ("points", f"{self.points}"),
            ("completeness", f"{100 * self.completeness:.2f} % of lit pixels"),
            ("median error", f"{_UM * self.median_abs_mm:.2f} µm"),
            ("95th percentile", f"{_UM * self.p95_abs_mm:.2f} µm"),
            ("RMS error, edges included", f"{_UM * self.rms_mm:.2f} µm"),
            ("RMS error, smooth surface", f"{_UM * self.smooth_rms_mm:.2f} µm"),
            ("predicted from noise alone", f"{_UM * self.predicted_sigma_mm:.2f} µm"),
            ("uncertainty u", f"{_UM * self.predicted_u_mm:.2f} µm"),
            (
                "smooth errors within 1, 2, 3 u",
                f"{100 * self.coverage_1u:.1f}, {100 * self.coverage_2u:.1f}, "
                f"{100 * self.coverage_3u:.1f} %",
            ),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Score:
        """Return the score that a ``score.json`` holds, whatever else stands in it.

        Raises
        ------
        InputError
            Naming what is missing or is no score's.
        """
        given: dict[str, Any] = {}
        for one in fields(cls):
            value = stored.get(one.name)
            if one.name in FEATURES:
                value = [] if value is None else value
                if not isinstance(value, list):
                    raise InputError(one.name, "a list of features", shown(value))
                value = [_restored(FEATURES[one.name], item, one.name) for item in value]
            elif isinstance(value, Mapping):
                value = {axis: _number(v) for axis, v in value.items()}
            else:
                value = (
                    int(_number(value))
                    if one.type == "int" and value is not None
                    else _number(value)
                )
            given[one.name] = value
        return cls(**given)


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
    rig: Rig | None = None,
    errors: Array | None = None,
    level: bool = False,
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
        Whose features are fitted, to points on smooth lit surface.
    rig : Rig, optional
        So that spheres are fitted where they face both devices.
    errors : (N, 3) float, optional
        Of the points; :func:`point_errors` by default, which takes every point as one of its
        pixel's centre ray.
    level : bool
        Whether the cloud was moved to the truth by its own points, so that steps are taken between
        parallel planes (:mod:`slbench.score.levels`).

    Returns
    -------
    Score
        Numbers are NaN where nothing was measured.
    """
    error = point_errors(cloud, truth) if errors is None else errors
    smooth = truth.smooth()
    rows, columns = cloud.pixels[:, 1], cloud.pixels[:, 0]
    in_smooth = smooth[rows, columns]
    panel = {axis: phase.coordinate[axis] - truth.panel[..., k] for k, axis in _axes(phase)}
    residual_px = {axis: values[smooth & phase.mask] for axis, values in panel.items()}
    owner = np.where(truth.lit, truth.object_id, -1)[rows, columns]
    # What a projector's square pixels do to the phase is the same all along a panel line, so
    # errors go together along the camera line that follows it.
    line = cloud.pixels[:, 0 if "u" in cloud.axes else 1]
    measured = _pixels(cloud, np.isfinite(error[:, 0]))
    return Score(
        completeness=_ratio(measured, np.count_nonzero(truth.lit)),
        **error_numbers(cloud, error, in_smooth),
        smooth_bias_px={axis: _mean(values) for axis, values in residual_px.items()},
        smooth_rms_px={axis: _rms(values) for axis, values in residual_px.items()},
        **by_kind(features_of(cloud, owner, in_smooth, line, objects, rig, level)),
    )


def error_numbers(cloud: PointCloud, error: Array, in_smooth: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what a score says of the errors of points.

    Parameters
    ----------
    cloud : PointCloud
    error : (N, 3) float
        Measured less true point, mm; NaN where there is no true one.
    in_smooth : (N,) bool
        Points on smooth lit surface.
    """
    lit = np.isfinite(error[:, 0])
    distance = np.linalg.norm(error[lit], axis=-1)
    z = error[lit, 2]
    median = _median(z)
    mad = _median(np.abs(z - median))
    # 1.4826 MAD estimates the standard deviation of a Gaussian core.
    limit = OUTLIER_SIGMAS * max(1.4826 * mad, 1e-12)
    unsure = cloud.u_total_mm
    coverage = _coverage(cloud, error, in_smooth & lit)
    return {
        "points": len(cloud),
        "false_points": int(np.count_nonzero(~lit)),
        "outliers": int(np.count_nonzero(np.abs(z - median) > limit)),
        "bias_z_mm": _mean(z),
        "rms_z_mm": _rms(z),
        "rms_mm": _rms(distance),
        "median_abs_mm": _median(distance),
        "mad_mm": mad,
        "p95_abs_mm": float(np.percentile(distance, 95)) if distance.size else float("nan"),
        "predicted_sigma_mm": _median(cloud.sigma_total_mm),
        "predicted_u_mm": _median(unsure[np.isfinite(unsure)]),
        "coverage_1u": coverage[0],
        "coverage_2u": coverage[1],
        "coverage_3u": coverage[2],
        "smooth_rms_mm": _rms(distance[in_smooth[lit]]),
    }


def _pixels(cloud: PointCloud, chosen: NDArray[np.bool_]) -> int:
    """Return how many pixels the chosen points are of."""
    seen = np.zeros(cloud.shape, np.bool_)
    u, v = cloud.pixels[chosen].T
    seen[v, u] = True
    return int(np.count_nonzero(seen))


def _number(value: Any) -> float:
    """Return a number of JSON, which has none for NaN."""
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise InputError("score", "numbers", shown(value))
    return float("nan") if value is None else float(value)


def _restored(kind: type[FeatureScore], stored: Any, where: str) -> FeatureScore:
    names = {one.name: one.type for one in fields(kind)}
    if not isinstance(stored, Mapping) or set(stored) - set(names):
        raise InputError(where, f"tables of {', '.join(names)}", shown(stored))
    values: Any = {k: _number(v) if names[k] == "float" else v for k, v in stored.items()}
    try:
        return kind(**values)
    except TypeError as error:
        raise InputError(where, f"tables of {', '.join(names)}", str(error)) from None


def by_kind(features: Iterable[FeatureScore]) -> dict[str, Any]:
    """Return features by the names of a score's lists."""
    found = list(features)
    return {name: [f for f in found if type(f) is kind] for name, kind in FEATURES.items()}


def _axes(phase: PhaseMap) -> list[tuple[int, Any]]:
    return [("uv".index(axis), axis) for axis in phase.coordinate]


def _coverage(cloud: PointCloud, error: Array, chosen: NDArray[np.bool_]) -> list[float]:
    """Return the shares of errors, by world axis, within one, two and three uncertainties."""
    own, unsure = np.abs(error[chosen]), cloud.u_mm[chosen]
    # Along an axis that a ray does not change there is nothing to be unsure of.
    known = unsure > 1e-6 * unsure.max(axis=1, keepdims=True, initial=0.0)
    return [
        _ratio(np.count_nonzero(own[known] <= k * unsure[known]), known.sum()) for k in (1, 2, 3)
    ]


def features_of(
    cloud: PointCloud,
    owner: NDArray[np.int32],
    usable: NDArray[np.bool_],
    line: NDArray[np.int32],
    objects: Sequence[SceneObject],
    rig: Rig | None,
    level: bool,
) -> list[FeatureScore]:
    """Fit the features of every object to the points that lie on it: surfaces to smooth ones.

    Parameters
    ----------
    cloud : PointCloud
    owner : (N,) int
        Index of the object that each point is on; -1 for none.
    usable : (N,) bool
        Points on smooth lit surface.
    line : (N,) int
        Points of one line have errors that go together.
    objects, rig, level
        As :func:`score` has them.
    """
    found: list[FeatureScore] = []
    for k, item in enumerate(objects):
        chosen = owner == k
        points, smooth = cloud.points[chosen], usable[chosen]
        found += fit_features(points, item.artefact, item.pose, line[chosen], rig, smooth, level)
    return found


def _mean(values: Array) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _median(values: Array) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _ratio(part: Any, whole: Any) -> float:
    return float(part) / float(whole) if whole else float("nan")
