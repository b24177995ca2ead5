"""A cloud against a part of known shape: a certified artefact, or a mesh.

The part is placed by the cloud (:mod:`slbench.score.clouds.placing`) unless it stands in the
cloud's frame already.  A point's error is the vector to it from the nearest point of the part's
surface; heights are along the part's z.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.files.measured import MeasuredCloud
from slbench.core.errors import InputError
from slbench.objects import Artefact
from slbench.rig import Pose
from slbench.score.clouds.borders import Inner, inner_points
from slbench.score.clouds.cloudscore import CloudScore, score_intervals, unmeasured
from slbench.score.clouds.expected import DEVIATIONS, check_part, expected_deviations, question_unit
from slbench.score.clouds.placing import (
    LEAST,
    Placed,
    largest_plane,
    place_on_surface,
    plane_behind,
)
from slbench.score.clouds.surface import Surface
from slbench.score.clouds.tiles import effective_tiles, tiles_of
from slbench.score.features import fit_features
from slbench.score.points import Score, by_kind
from slbench.score.values import FeatureScore

Array = NDArray[np.float64]

#: How far from the part a point is still one of it, as a share of the part's size.
REACH = 0.05
#: Least share of a cloud that a plane is which the part stands on.
_LEAST_PLANE = 0.05
#: A point further than this many robust deviations (1.4826 MAD) from the others is an outlier.
_OUTLIER = 6.0
#: Places on the surface that are asked whether a point is near, cells of the part along its size,
#: and spacings of the points that a cell has at least.
_PLACES, _CELLS, _SPACINGS = 20_000, 200, 3.0


def score_against_part(
    cloud: MeasuredCloud,
    part: Artefact,
    *,
    placed: bool = False,
    start: Pose | None = None,
    expected_um: float | None = None,
) -> CloudScore:
    """Score a cloud against a part's surface, and its certified features.

    Parameters
    ----------
    cloud : MeasuredCloud
        Of the part; some points may be wrong or of something else.
    part : Artefact
        Certified, or of a mesh file.
    placed : bool
        Whether the part is in the cloud's frame already, and is left there.
    start : Pose, optional
        About where the part is in the cloud's frame; looked for by default.
    expected_um : float, optional
        Expected deviation of the points, instead of what the cloud says.

    Returns
    -------
    CloudScore
        Errors are of points within 5 % of the part's size of it; ``false_points`` counts the
        others, but for a plane that the part stands on; ``completeness`` is the share of the
        part's surface with points near.

    Raises
    ------
    InputError
        For fewer than 50 points, and if fewer than 70 % of them lie within three expected
        deviations of the part.

    Warns
    -----
    InputWarning
        If the cloud is far larger or smaller than the part, naming the likely unit.
    """
    if len(cloud) < LEAST:
        raise InputError(cloud.source, f"at least {LEAST} points of {part.name}", len(cloud))
    surface = Surface(part.mesh)
    question_unit(cloud, surface.size_mm, part.name)
    motion: Pose | None = None
    free: tuple[str, ...] = ()
    if not placed:
        found = _placed(cloud, part, surface, start)
        motion, free = found.to_part, found.free
        cloud = cloud.moved(motion)
    near = surface.nearest(cloud.points, REACH * surface.size_mm)
    away = np.abs(near.distance)
    expected = expected_deviations(cloud, away, surface.size_mm, expected_um)
    limit = DEVIATIONS * expected.mm
    with np.errstate(invalid="ignore"):
        other = plane_behind(cloud.points, surface.bounds, limit) & ~(away <= limit)
    if np.mean(other) < _LEAST_PLANE:
        other[:] = False  # a few wrong points that lie in a plane of the part
    nearest, distance = near.point, near.distance
    if other.any():
        kept = ~other
        cloud, away = cloud.chosen(kept), away[kept]
        # Of the part alone: of much background the usual distance is the background's.
        expected = expected_deviations(cloud, away, surface.size_mm, expected_um)
        nearest, distance = nearest[kept], distance[kept]
    share = check_part(cloud, away, expected, part.name)
    on = np.isfinite(away)
    errors = cloud.points[on] - nearest[on]
    tiles = tiles_of(cloud.points[on])
    lines = None if cloud.pixels is None else cloud.pixels[on, 0]
    inner = Inner()
    features: list[FeatureScore] = []
    if part.features or part.declared:
        inner = inner_points(cloud.points[on], part)
        features = fit_features(
            *(cloud.points[on], part, Pose(), lines),
            smooth=inner.mask,
            level=motion is not None,
            stripes=True,
        )
    numbers = _score(cloud, distance, errors, surface, features)
    return CloudScore(
        score=numbers,
        reference="mesh" if part.kind == "mesh" else "artefact",
        name=part.name,
        source=cloud.source,
        points=cloud.points,
        deviation_mm=distance,
        share=share,
        expected=expected,
        intervals=score_intervals(tiles, away[on], errors[:, 2]),
        tiles=effective_tiles(tiles),
        dropped=cloud.dropped,
        background=int(np.count_nonzero(other)),
        near_edges=inner.left_out,
        unmeasured=unmeasured(part, numbers, inner.reason),
        motion=motion,
        free=free,
    )


def _placed(cloud: MeasuredCloud, part: Artefact, surface: Surface, start: Pose | None) -> Placed:
    """Place a part; points with normals tell from which side they were seen."""
    eye = None
    if cloud.normals is not None:
        known = cloud.normals[np.isfinite(cloud.normals[:, 0])]
        mean = known.mean(axis=0) if len(known) else np.zeros(3)
        # Points of all sides have no mean direction.
        eye = mean if np.linalg.norm(mean) > 0.5 else None
    if start is None and part.kind == "plane":
        start = _on_plane(cloud.points, eye)
    return place_on_surface(cloud.points, part.mesh, surface, start, eye)


def _on_plane(points: Array, eye: Array | None) -> Pose:
    """Return the pose of a plate whose top is the plane of most points."""
    point, normal, near = largest_plane(points)
    own = points[np.abs((points - point) @ normal) <= near]
    middle = own.mean(axis=0)
    axes = np.linalg.svd(own[:: max(1, len(own) // 100_000)] - middle, full_matrices=False)[2]
    up = axes[2] if eye is None or axes[2] @ eye > 0.0 else -axes[2]
    return Pose(np.stack((axes[0], np.cross(up, axes[0]), up), axis=1), middle)


def _score(
    cloud: MeasuredCloud,
    distance: Array,
    errors: Array,
    surface: Surface,
    features: list[FeatureScore],
) -> Score:
    """Return the numbers of a scan's score, as far as a surface tells them."""
    on = np.isfinite(distance)
    side, length, z = distance[on], np.linalg.norm(errors, axis=1), errors[:, 2]
    middle = float(np.median(side))
    limit = _OUTLIER * max(1.4826 * float(np.median(np.abs(side - middle))), 1e-12)
    nan = float("nan")
    known = {name: np.asarray(cloud.scalars.get(name, [nan]))[...] for name in ("sigma", "u")}
    medians = {name: _median(values) for name, values in known.items()}
    coverage = [nan] * 3
    if np.isfinite(medians["u"]):
        own = known["u"][on]
        fine = np.isfinite(own)
        coverage = [float(np.mean(length[fine] <= k * own[fine])) for k in (1, 2, 3)]
    return Score(
        points=len(cloud),
        completeness=_covered(cloud.points[on], surface),
        false_points=int(np.count_nonzero(~on)),
        outliers=int(np.count_nonzero(np.abs(side - middle) > limit)),
        bias_z_mm=float(np.mean(z)),
        rms_z_mm=float(np.sqrt(np.mean(z**2))),
        rms_mm=float(np.sqrt(np.mean(length**2))),
        median_abs_mm=float(np.median(length)),
        mad_mm=float(np.median(np.abs(z - np.median(z)))),
        p95_abs_mm=float(np.percentile(length, 95)),
        predicted_sigma_mm=medians["sigma"],
        predicted_u_mm=medians["u"],
        coverage_1u=coverage[0],
        coverage_2u=coverage[1],
        coverage_3u=coverage[2],
        smooth_rms_mm=nan,
        smooth_bias_px={},
        smooth_rms_px={},
        **by_kind(features),
    )


def _median(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _covered(points: Array, surface: Surface) -> float:
    """Return the share of a surface's area in cells that hold points."""
    spacing = np.sqrt(surface.area_mm2 / max(len(points), 1))
    cell = max(_SPACINGS * spacing, surface.size_mm / _CELLS)
    low = surface.bounds[0] - cell
    # An odd number of cells more than any index keeps codes of cells apart.
    base = int(np.ceil(float(np.ptp(surface.bounds, axis=0).max()) / cell)) + 5

    def codes(places: Array) -> NDArray[np.int64]:
        code = np.zeros(len(places), np.int64)
        for axis in range(3):
            index = ((places[:, axis] - low[axis]) / cell).astype(np.int32)
            code = code * base + np.clip(index, 0, base - 1)
        return code

    held = np.zeros(base**3, np.bool_)
    held[codes(points)] = True
    return float(np.mean(held[codes(surface.sample(_PLACES)[0])]))
