"""Scans of one part from several viewpoints, put together in the part's frame.

The poses of the views are known.  Where the views themselves say that they are off, beyond what
noise makes of it, they are registered (:mod:`slbench.cloud.registration`) with the known poses for
a start; otherwise the known poses stay, and both are reported.

Every merged point is held against the point of the part that its own pixel truly meets, so that
sides of a thin wall are not taken for each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.stack import WeightSource
from slbench.cloud.registration import Registration, register_views
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError, located, warn_user
from slbench.core.random import Word, generator, tagged_seed
from slbench.core.show.display import block, length, share
from slbench.core.show.drawing import figure
from slbench.rig import Pose
from slbench.scene.model import Scene
from slbench.score.features import fit_features
from slbench.score.points import by_kind, point_errors
from slbench.score.values import FeatureScore
from slbench.simulate.scan import Progress, Scan, scan
from slbench.simulate.viewpoints.covered import measured_samples
from slbench.simulate.viewpoints.samples import SurfaceSamples, sample_surface
from slbench.simulate.viewpoints.views import Viewpoint, Viewpoints, alone, inside_volume

Array = NDArray[np.float64]

#: By how much registration has to lessen the residual of the overlaps to be believed: phase errors
#: that do not repeat from view to view lessen it by some percent, whatever the poses are.
_BETTER = 0.9
#: Least uncertainty of a known pose that registration starts from, mm and rad.
_LEAST_MM, _LEAST_RAD = 1.5e-3, 2e-4
#: Neighbours further apart than this many usual distances have an edge between them.
_EDGE = 4.0


@dataclass(frozen=True, kw_only=True)
class StageErrors:
    """How far a stage is off the poses it was told, in a simulation.

    Parameters
    ----------
    position_mm, tilt_rad : float
        Standard deviations along and about each axis.
    """

    position_mm: float = 0.0
    tilt_rad: float = 0.0

    def drawn(self, pose: Pose, rng: np.random.Generator) -> Pose:
        """Return where the part is when the stage has been told a pose."""
        from scipy.spatial.transform import Rotation

        turn, shift = rng.normal(size=3) * self.tilt_rad, rng.normal(size=3) * self.position_mm
        if not (turn.any() or shift.any()):
            return pose
        return Pose(Rotation.from_rotvec(turn).as_matrix() @ pose.rotation, pose.position + shift)


@dataclass(frozen=True, eq=False)
class _Part:
    """What is kept of one view: its points in the part's frame, and what is true there."""

    cloud: PointCloud
    points: Array
    true: Array  #: NaN where no light falls
    steady: NDArray[np.bool_]  #: away from edges of the picture
    smooth: NDArray[np.bool_]
    usable: NDArray[np.bool_]
    lit: int
    measured: int
    seconds: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ScannedViews:
    """A part, measured from several viewpoints.

    Parameters
    ----------
    scene : Scene
        That was scanned, the part alone.
    viewpoints : Viewpoints
    points : (M, 3) float
        Merged, in the part's frame, mm.
    view : (M,) int
        Number of the view that each point is of.
    sigma_mm, u_mm : (M,) float
        Standard deviation of the points by noise, and their standard uncertainty.
    error_mm : (M, 3) float
        Measured minus true point; NaN where no light falls in truth.
    known_rms_mm : float
        RMS distance from the truth with the known poses.
    registration : Registration or None
        Of the views; None for one view, or where they do not hang together.
    registered : bool
        Whether the points have been moved by it.
    why : str
        Why, or why not.
    samples : SurfaceSamples
    measured_mm : (N, K) float32
        Deviation with which each view measured each sample; NaN where it did not.
    completeness : (K,) float
        Share of each view's lit pixels that were measured.
    features : tuple of FeatureScore
        Fitted to the merged points.
    seconds : (K,) float
    """

    scene: Scene
    viewpoints: Viewpoints
    points: Array
    view: NDArray[np.int32]
    sigma_mm: Array
    u_mm: Array
    error_mm: Array
    known_rms_mm: float
    registration: Registration | None
    registered: bool
    why: str
    samples: SurfaceSamples
    measured_mm: NDArray[np.float32]
    completeness: Array
    features: tuple[FeatureScore, ...]
    seconds: Array

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of views that measured each sample with at most the deviation asked for, (N,)."""
        with np.errstate(invalid="ignore"):
            good = self.measured_mm <= self.viewpoints.counting.max_std_mm
        return np.asarray(np.sum(good & np.isfinite(self.measured_mm), axis=1))

    @property
    def coverage(self) -> float:
        """Share of the surface that was measured often enough."""
        return float(np.mean(self.counts >= self.viewpoints.counting.min_measurements))

    @property
    def false_points(self) -> int:
        """Points measured where no light falls in truth."""
        return int(np.count_nonzero(~np.isfinite(self.error_mm[:, 0])))

    @property
    def distances(self) -> Array:
        """Distances of the points from the truth, mm; false ones are left out."""
        return np.linalg.norm(self.error_mm[np.isfinite(self.error_mm[:, 0])], axis=1)

    def __repr__(self) -> str:
        part = self.scene.objects[0].artefact.name
        return block(
            f"ScannedViews of {part}: {len(self.points)} points of {len(self.viewpoints)} views",
            f"{share(self.coverage)} of the surface, RMS error {length(_rms(self.distances))}",
            self.why,
        )

    def plot(self) -> Any:
        """Return a matplotlib figure: the part by number of measurements, from six sides."""
        return figure(self)

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers of the whole as they are shown, (quantity, value)."""
        counting, planned = self.viewpoints.counting, self.viewpoints.predicted_coverage
        often = "" if counting.min_measurements == 1 else f" {counting.min_measurements} times"
        distances = self.distances
        rows = [
            ("views", f"{len(self.viewpoints)}"),
            ("points", f"{len(self.points)}, {self.false_points} false"),
            (f"surface measured{often}", f"{100 * self.coverage:.2f} %"),
        ]
        if planned is not None:
            rows.append(("as planned", f"{100 * planned:.2f} %"))
        return [
            *rows,
            ("median error", length(_median(distances))),
            ("95th percentile", length(_percentile(distances, 95))),
            ("RMS error", length(_rms(distances))),
            ("uncertainty u", length(_median(self.u_mm))),
            ("poses", self.why),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        distances = self.distances
        found = self.registration
        return {
            "scene": self.scene.name,
            "part": self.scene.objects[0].artefact.name,
            "points": len(self.points),
            "false_points": self.false_points,
            "coverage": self.coverage,
            "predicted_coverage": self.viewpoints.predicted_coverage,
            "median_abs_mm": _median(distances),
            "p95_abs_mm": _percentile(distances, 95),
            "rms_mm": _rms(distances),
            "rms_known_poses_mm": self.known_rms_mm,
            "predicted_sigma_mm": _median(self.sigma_mm),
            "predicted_u_mm": _median(self.u_mm),
            "registered": self.registered,
            "poses": self.why,
            "registration": None if found is None else found.to_dict(),
            "views": [
                {
                    "name": view.name,
                    "points": int(np.count_nonzero(self.view == k)),
                    "completeness": float(self.completeness[k]),
                }
                for k, view in enumerate(self.viewpoints.views)
            ],
            **{
                kind: [vars(one) for one in found_features]
                for kind, found_features in by_kind(self.features).items()
            },
        }


def scan_views(
    scene: Scene,
    viewpoints: Viewpoints,
    *,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    weights: WeightSource = "lit",
    score: bool = True,
    refine: bool = True,
    stage: StageErrors | None = None,
    on_view: Callable[[Viewpoint, Scan], None] | None = None,
    on_progress: Progress | None = None,
) -> ScannedViews:
    """Scan a part from every viewpoint, register the views where it helps, and merge them.

    Parameters
    ----------
    scene : Scene
    viewpoints : Viewpoints
    seed : int
        From which each view has one of its own.
    noise, samples, weights, score
        As for :func:`slbench.simulate.scan.scan`, of each view.
    refine : bool
        False keeps the known poses.
    stage : StageErrors, optional
        Of the poses, drawn from the seed; none by default.
    on_view : callable, optional
        Called with each view and its scan, which is not kept.
    on_progress : callable, optional

    Returns
    -------
    ScannedViews

    Raises
    ------
    BackendError, InputError
        As :func:`slbench.simulate.scan.scan`, and if the scene has no such object.

    Warns
    -----
    InputWarning
        If the views were planned for another scene or part.
    """
    where = f"scene {scene.name}"
    base = alone(scene, viewpoints.object)
    base.rig.only  # noqa: B018 - which refuses several
    _question(base, viewpoints, where)
    surface = sample_surface(base.objects[0].artefact.mesh, viewpoints.counting.samples)
    place, parts, measured = base.place, [], []
    errors = stage or StageErrors()
    for k, view in enumerate(viewpoints.views):
        pose = errors.drawn(view.pose, generator(seed, Word.STAGE, k))
        one = replace(alone(scene, viewpoints.object, pose), name=f"{scene.name}-{view.name}")
        with located(f"view {view.name}"):
            result = scan(
                one,
                seed=tagged_seed(seed, k),
                noise=noise,
                samples=samples,
                weights=weights,
                score=score,
                on_progress=_of_view(on_progress, k, len(viewpoints)),
            )
        poses_known = (view.pose, pose, place)
        parts.append(_part(result, *poses_known, viewpoints.counting.within_volume))
        if on_view:
            on_view(view, result)
    poses, found, registered, why = _poses(parts, refine, errors)
    for view, part, correction in zip(viewpoints.views, parts, poses, strict=True):
        points = correction.to_world(part.points)
        given = (part.cloud, points, part.usable)
        steepest = viewpoints.counting.max_incidence_deg
        deviations = measured_samples(surface, view.pose, base.rig, *given, steepest)
        measured.append(deviations.astype(np.float32))
    merged = np.concatenate(
        [pose.to_world(part.points) for pose, part in zip(poses, parts, strict=True)]
    )
    true = np.concatenate([part.true for part in parts])
    known = np.concatenate([part.points for part in parts]) - true
    clouds = [part.cloud for part in parts]
    features = _features(base, merged, parts) if score else []
    return ScannedViews(
        scene=base,
        viewpoints=viewpoints,
        points=merged,
        view=np.repeat(np.arange(len(parts), dtype=np.int32), [len(one) for one in clouds]),
        sigma_mm=np.concatenate([one.sigma_total_mm for one in clouds]),
        u_mm=np.concatenate([one.u_total_mm for one in clouds]),
        error_mm=merged - true,
        known_rms_mm=_rms(np.linalg.norm(known[np.isfinite(known[:, 0])], axis=1)),
        registration=found,
        registered=registered,
        why=why,
        samples=surface,
        measured_mm=np.stack(measured, axis=1),
        completeness=np.array([_ratio(part.measured, part.lit) for part in parts]),
        features=tuple(features),
        seconds=np.array([part.seconds for part in parts]),
    )


def _of_view(report: Progress | None, k: int, count: int) -> Progress | None:
    """Return what reports the progress of one view of several, which is that of its light."""
    if report is None:
        return None
    return lambda stage, done: report("views", (k + done) / count) if stage == "trace" else None


def _part(result: Scan, told: Pose, true_pose: Pose, place: Pose, within_volume: bool) -> _Part:
    """Return what is kept of a scan; the part was told to be in one pose and was in another."""
    cloud, truth = result.cloud, result.truth
    rows, columns = cloud.pixels[:, 1], cloud.pixels[:, 0]
    true = truth.point[rows, columns]
    lit = truth.lit[rows, columns]
    usable = np.ones(len(cloud), np.bool_)
    if within_volume:
        usable = inside_volume(result.scene.rig, place, cloud.points)
    true = np.where(lit[:, np.newaxis], true_pose.to_local(true), np.nan)
    return _Part(
        cloud=cloud,
        points=told.to_local(cloud.points),
        true=true,
        steady=_steady(cloud),
        smooth=truth.smooth()[rows, columns],
        usable=usable,
        lit=int(np.count_nonzero(truth.lit)),
        measured=int(np.count_nonzero(np.isfinite(point_errors(cloud, truth)[:, 0]))),
        seconds=float(result.run.seconds["total"]),
    )


def _steady(cloud: PointCloud) -> NDArray[np.bool_]:
    """Return a mask of points whose four neighbours in the picture are measured nearby, (M,).

    What a pixel at an edge sees of two surfaces is on neither.
    """
    image = cloud.image(cloud.points)
    apart = np.full((*cloud.shape, 4), np.inf)
    across = np.linalg.norm(np.diff(image, axis=1), axis=2)
    down = np.linalg.norm(np.diff(image, axis=0), axis=2)
    apart[:, 1:, 0] = apart[:, :-1, 1] = across
    apart[1:, :, 2] = apart[:-1, :, 3] = down
    farthest = np.nan_to_num(apart, nan=np.inf).max(axis=2)
    farthest = farthest[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    inner = farthest[np.isfinite(farthest)]
    return farthest <= _EDGE * (np.median(inner) if inner.size else 0.0)


def _poses(
    parts: Sequence[_Part], refine: bool, stage: StageErrors
) -> tuple[list[Pose], Registration | None, bool, str]:
    """Return the corrections of the views' poses, and what was found about them."""
    known = [Pose() for _ in parts]
    if len(parts) == 1:
        return known, None, False, "known: one view"
    if not refine:
        return known, None, False, "known"
    try:
        found = register_views(
            [part.points[part.steady] for part in parts],
            np.zeros((len(parts), 3)),
            stage_sigma_mm=max(stage.position_mm, _LEAST_MM),
            stage_sigma_rad=max(stage.tilt_rad, _LEAST_RAD),
        )
    except InputError as error:
        return known, None, False, f"known: the views do not hang together ({error.where})"
    shift = length(float(np.max(np.linalg.norm(found.shifts_mm, axis=1))))
    rms = (
        f"residual of the overlaps {length(found.rms_start_mm)}, registered {length(found.rms_mm)}"
    )
    if not found.rms_mm < _BETTER * found.rms_start_mm:
        return known, found, False, f"known: registration would not help ({rms})"
    return list(found.poses), found, True, f"registered: corrections of up to {shift}; {rms}"


def _features(scene: Scene, points: Array, parts: Sequence[_Part]) -> list[FeatureScore]:
    """Fit the part's features to the merged points on lit smooth surface."""
    part = scene.objects[0]
    on = np.isfinite(np.concatenate([one.true[:, 0] for one in parts]))
    smooth = np.concatenate([one.smooth for one in parts])[on]
    along = 0 if "u" in scene.sequence.axes else 1
    # Errors go together along the lines of one view's picture.
    most = max(max(one.cloud.shape) for one in parts)
    lines = np.concatenate([k * most + one.cloud.pixels[:, along] for k, one in enumerate(parts)])[
        on
    ]
    return list(fit_features(points[on], part.artefact, Pose(), lines, None, smooth, False))


def _question(scene: Scene, viewpoints: Viewpoints, where: str) -> None:
    """Warn of views that were planned for something else."""
    part = scene.objects[0].artefact.name
    for what, planned, own in (
        ("scene", viewpoints.scene, scene.name),
        ("part", viewpoints.part, part),
    ):
        if planned is not None and planned != own:
            warn_user(where, f"the views were planned for the {what} {planned}, not {own}")


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _median(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _percentile(values: Array, share_: float) -> float:
    return float(np.percentile(values, share_)) if values.size else float("nan")


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
