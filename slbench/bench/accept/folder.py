"""An acceptance from clouds or captures of a real scanner.

Balls and plates are found by what their certificate says of them: balls of that diameter, at that
distance, a plate of that size.  Which points are fitted depends on where they lie over the surface,
not on how far they are from it: those of a cap of 60 degrees about the direction that the ball is
seen from (facing both devices where the rig is known), and those of a plate that are away from its
edges.  An error of the instrument is form, however large.  Points further than half a radius, or a
tenth of a plate's diagonal, are taken for another thing; they are left out, counted, and warned of
where they are more than the 0.3 % that form sets aside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slbench.bench.accept.acceptance import Acceptance, assembled
from slbench.bench.accept.evaluate import Measured, measured_place
from slbench.bench.accept.registering import in_one_order, registered
from slbench.bench.accept.specification import PLACES_FILE, Specification, read_specification
from slbench.bench.accept.standards import Standard
from slbench.bench.accept.surfaces import Points, fit_plate, lines_of
from slbench.capture.capture import Capture
from slbench.cloud.decoded import decode_capture
from slbench.cloud.files import read_cloud
from slbench.cloud.triangulation import Axis
from slbench.core.errors import InputError, located, warn_user
from slbench.rig import Rig
from slbench.rig.opencv import read_rig
from slbench.rig.parameters import covariance_beside
from slbench.rig.pose import product
from slbench.score.features import MAX_INCIDENCE, MIN_POINTS, core, fit_sphere
from slbench.score.residuals import SET_ASIDE, facing

Array = NDArray[np.float64]

#: Sides of a plate that is found, as shares of the certified ones.
_LEAST_PLATE, _LARGEST_PLATE = 0.7, 1.2
#: Trial balls, points that they are tried on, and how near to one a point counts, of its radius.
_TRIALS, _TRIED, _NEAR = 300, 3000, 0.04
#: Distance from a ball's surface that it is found by, and from a plate's plane, as a share of the
#: radius and of the plate's diagonal.
_BAND, _PLATE_BAND = 0.1, 0.01
#: Distance beyond which points are of another thing, in the same shares, and where a ball's cap
#: ends, in radii from its centre.
_FAR, _PLATE_FAR, _ABOVE = 0.5, 0.1, 2.0
#: How far the spacing of two balls that belong together may be from the certified one.
_SPACING = 0.05
#: Part of a plate's width at each edge that is left out.
_EDGE = 0.05
#: Share of a cap's points within 30 degrees of its middle; 27 % of an even cap of 60 degrees.
_INNER = (0.1, 0.7)
_SEED = 14_253


def accept_folder(
    folder: str | Path,
    specification: Specification | None = None,
    *,
    on_progress: Callable[[str, float], None] | None = None,
) -> Acceptance:
    """Accept a real scanner by its clouds or captures of standards.

    Parameters
    ----------
    folder : path
        With ``places.toml`` (:mod:`slbench.bench.accept.specification`).
    specification : Specification, optional
        Its limits go before those of the folder.
    on_progress : callable, optional

    Returns
    -------
    Acceptance

    Raises
    ------
    InputError
        Naming file and key; for a cloud in which the standard is not found.
    """
    folder = Path(folder)
    own = read_specification(folder / PLACES_FILE)
    if not own.places:
        raise InputError(folder / PLACES_FILE, "a table [[place]] for each place", "none")
    limits = {**own.limits, **(specification.limits if specification else {})}
    rig = None
    if own.rig is not None:
        with located(f"{PLACES_FILE}: rig"):
            rig = read_rig(own.rig)
    measured: list[Measured] = []
    axes: tuple[Axis, ...] = ("u",)
    for k, one in enumerate(own.places):
        views = []
        for path in one.files:
            with located(f"{folder.name}: {one.place.name}: {path.name}"):
                if one.captured:
                    points, axes = _of_capture(path, one.place.standard, rig)
                else:
                    cloud = read_cloud(path, own.unit)
                    lines = None if cloud.pixels is None else lines_of(cloud.pixels)
                    points = found(Points(cloud.points, None, lines), one.place.standard, rig)
                views.append(points)
        with located(folder.name):
            views = in_one_order(one.place, views, one.registered_by)
            parts = registered(one.place, views, one.registered_by)
            measured.append(measured_place(one.place, parts))
        _doubt(folder.name, measured[-1])
        if on_progress:
            on_progress("places", (k + 1) / len(own.places))
    return assembled(
        folder.name,
        measured,
        limits=limits,
        rig=rig,
        axes=axes,
        covariance=None if own.rig is None else covariance_beside(own.rig),
        parameters={"folder": str(folder)},
    )


def _doubt(folder: str, place: Measured) -> None:
    """Warn where more was left out than form sets aside."""
    every = place.count + place.left_out
    if place.left_out > SET_ASIDE * every:
        share = 100.0 * place.left_out / every
        doubt = f"{place.left_out} of {every} points ({share:.2g} %) are so far from the standard "
        doubt += "that they were left out: another thing over it, or gross errors of the scanner?"
        warn_user(f"{folder}: {place.place.name}", doubt)


def _of_capture(
    path: Path, standard: Standard, rig: Rig | None
) -> tuple[list[Points], tuple[Axis, ...]]:
    shots = Capture.load(path)
    if rig is not None:
        shots = replace(shots, rig=rig)
    decoded = decode_capture(shots, where=path)
    cloud = decoded.cloud
    if cloud is None:
        raise InputError("rig", "the capture's rig (rig = in places.toml)", "none")
    noise = cloud.sensitivity * cloud.sigma_px[..., None]
    points = Points(cloud.points, noise, lines_of(cloud.pixels, cloud.axes))
    return found(points, standard, shots.rig), cloud.axes


def found(points: Points, standard: Standard, rig: Rig | None = None) -> list[Points]:
    """Find the balls or the plate of a standard in a cloud.

    Parameters
    ----------
    points : Points
        Of the whole cloud.
    standard : Standard
    rig : Rig, optional
        So that balls are fitted where they face both devices.

    Returns
    -------
    list of Points
        Of each ball, or of the plate.

    Raises
    ------
    InputError
        Where there is no such ball or plate.
    """
    if standard.size_mm is not None:
        return [_plate(points, standard)]
    assert standard.diameter_mm is not None
    radius = 0.5 * standard.diameter_mm
    first = _ball(points.points, radius, None)
    centres = [first]
    if standard.spacing_mm is not None:
        centres.append(_ball(points.points, radius, (first, standard.spacing_mm)))
    balls = []
    for centre in centres:
        cap = _cap(points.points, centre, radius, rig)
        off = np.abs(np.linalg.norm(points.points[cap] - centre, axis=1) / radius - 1.0)
        balls.append(_without(points, cap, off > _FAR))
    return balls


def _without(points: Points, region: NDArray[np.intp], far: NDArray[np.bool_]) -> Points:
    """Return the points of a region but for those that are far off, which are counted."""
    return replace(points.chosen(region[~far]), left_out=int(np.count_nonzero(far)))


def _ball(points: Array, radius: float, beside: tuple[Array, float] | None) -> Array:
    """Return the centre of a ball of known radius: that of most points on its surface."""
    rng = np.random.default_rng(_SEED)
    if beside is not None:
        away = np.linalg.norm(points - beside[0], axis=1)
        points = points[np.abs(away - beside[1]) < 1.2 * radius]
    some = points[rng.permutation(len(points))[:_TRIED]]
    best, most = None, MIN_POINTS - 1
    if len(some) >= MIN_POINTS:
        tree = cKDTree(some)
        for k in rng.integers(0, len(some), _TRIALS):
            close = tree.query_ball_point(some[k], 0.9 * radius)
            if len(close) < 3:
                continue
            for centre in _through(some[rng.choice(close, 3, replace=False)], radius):
                if beside is not None:
                    gap = float(np.linalg.norm(centre - beside[0])) / beside[1]
                    if abs(gap - 1.0) > _SPACING:
                        continue
                off = np.abs(np.linalg.norm(some - centre, axis=1) - radius)
                count = int(np.count_nonzero(off < _NEAR * radius))
                if count > most:
                    best, most = centre, count
    if best is not None:
        best = _settled(points, best, radius)
    if best is None:
        expected = f"a ball of {2.0 * radius:g} mm"
        expected += f" at {beside[1]:g} mm from the other" if beside else ""
        raise InputError("cloud", expected, f"none in {len(points)} points: another unit?")
    return best


def _settled(points: Array, centre: Array, radius: float) -> Array | None:
    """Return the centre of the ball fitted to all its points; None where they are no cap of it.

    A plane that a ball touches or cuts has points on it too: near its pole alone, or away from it.
    """
    for _ in range(3):
        own = points[np.abs(np.linalg.norm(points - centre, axis=1) - radius) < _BAND * radius]
        if len(own) < MIN_POINTS:
            return None
        kept = core(np.linalg.norm(own - centre, axis=1))
        centre, fitted, *_ = fit_sphere(own[kept])
        if abs(fitted / radius - 1.0) > _BAND:
            return None
    normals = points[_cap(points, centre, radius, None)] - centre
    normals = normals[np.abs(np.linalg.norm(normals, axis=1) / radius - 1.0) < _BAND]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    middle = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    low, high = _INNER
    return centre if low < np.mean(normals @ middle > np.cos(np.deg2rad(30.0))) < high else None


def _through(three: Array, radius: float) -> list[Array]:
    """Return the centres of the balls of a radius through three points."""
    a, b = three[1] - three[0], three[2] - three[0]
    normal = np.cross(a, b)
    square = float(normal @ normal)
    if square < 1e-6 * radius**4:
        return []
    middle = np.cross(normal, a) * float(b @ b) + np.cross(b, normal) * float(a @ a)
    middle = middle / (2.0 * square)
    height = radius**2 - float(middle @ middle)
    if height <= 0.0:
        return []
    up = normal * np.sqrt(height / square)
    return [three[0] + middle + up, three[0] + middle - up]


def _cap(points: Array, centre: Array, radius: float, rig: Rig | None) -> NDArray[np.intp]:
    """Return the indices of the points over the part of a ball that is fitted."""
    outward = points - centre
    distance = np.linalg.norm(outward, axis=1)
    own = np.flatnonzero((distance > 0.0) & (distance < _ABOVE * radius))
    normals = outward[own] / distance[own, None]
    if rig is not None:
        return own[facing(rig, centre + radius * normals, normals, MAX_INCIDENCE)]
    seen = normals[np.abs(distance[own] / radius - 1.0) < _BAND].mean(axis=0)
    seen = seen / np.linalg.norm(seen)
    return own[normals @ seen > np.cos(MAX_INCIDENCE)]


def _plate(points: Points, standard: Standard) -> Points:
    """Return the points of a plate that are away from its edges."""
    rng = np.random.default_rng(_SEED)
    assert standard.size_mm is not None
    band = _PLATE_BAND * float(np.hypot(*standard.size_mm))
    some = points.points[rng.permutation(len(points))[:_TRIED]]
    best, most = None, MIN_POINTS - 1
    for _ in range(_TRIALS if len(some) >= MIN_POINTS else 0):
        a, b, c = some[rng.choice(len(some), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        size = float(np.linalg.norm(normal))
        if size < 1e-3 * band**2:
            continue
        count = int(np.count_nonzero(np.abs((some - a) @ normal) < band * size))
        if count > most:
            best, most = (a, normal / size), count
    if best is None:
        raise InputError("cloud", "a plate", f"none in {len(points)} points")
    near = np.flatnonzero(np.abs((points.points - best[0]) @ best[1]) < band)
    fit = fit_plate(points.chosen(near), "plate")
    inner = points.points[near[fit.inliers]]
    normal = fit.normals[0]
    flat = np.linalg.svd(np.eye(3) - np.outer(normal, normal))[2][:2].T
    local = product(points.points - inner.mean(axis=0), flat)
    height = (points.points - inner.mean(axis=0)) @ normal
    box = cv2.minAreaRect(local[near].astype(np.float32))
    middle, sides, turn = np.array(box[0]), np.array(box[1]), np.deg2rad(box[2])
    # A cloud may lack the edges of a plate, not a third of it.
    share = np.sort(sides) / np.sort(standard.size_mm)
    if share.max() > _LARGEST_PLATE or share.min() < _LEAST_PLATE:
        got = f"a plane of {sides[0]:.4g} x {sides[1]:.4g} mm"
        got += ": another unit, a part of it, or a table?"
        expected = f"a plate of {standard.size_mm[0]:g} x {standard.size_mm[1]:g} mm"
        raise InputError("cloud", expected, got)
    across = product(
        local - middle, np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    )
    region = np.flatnonzero(np.all(np.abs(across) < (0.5 - _EDGE) * sides, axis=1))
    far = np.abs(height[region]) > _PLATE_FAR * float(np.hypot(*standard.size_mm))
    return _without(points, region, far)
