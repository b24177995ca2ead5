"""Triangulation with all rays that see a point: several cameras, several projectors.

Every camera pixel that a projector was decoded at has a point on its ray, X = o + t d.  Another
camera that sees this point measures the panel coordinate of the same place by noise of its own,
so that the difference of what it measures at its picture of X and what X projects to,

    r_j(t) = U_j(p_j(X)) - u(X),   dr_j / dt = (grad U_j . dp_j/dX - du/dX) d,

is zero but for noise: its measured surface cuts the ray.  The same camera's pixel under another
projector is the case of a place that does not move.  The distance is that of the least squares of
all of them, each by its own variance; what is known of a point is the sum of what all know of it
(their Fisher information), sum_j (dr_j/dt)^2 / sigma_j^2.  That the cameras' rays meet in points of
equal phase needs no equation of its own: it is the difference of two of these.

**What is joined.**  A camera j takes part where its picture of the point lies on smooth measured
surface (:mod:`slbench.cloud.between`) and its coordinate agrees within `limit` standard deviations,
those of the point's own place included.  Where a rig's calibration makes all of them disagree by
more than noise does, they are taken in units of what they do disagree by (the median), never
beyond half a panel pixel.  Occluded surfaces and wrong fringe orders are further off: they are not
averaged in, and both points stay.

**Each element of the surface once.**  Pairs have their turn in the rig's order.  A later pixel has
no point of its own where its point lies in the footprint of an earlier pair's measured pixel and
agrees with it: it has taken part there already.

The noise of a point is right; that of neighbours is not independent where cameras share a point, as
each takes some pixels of the others.  Errors that views share, a projector's response above all,
are not noise: :meth:`JointCloud.with_shared` adds them with their signs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.cloud.between import PanelField
from slbench.cloud.files.write import point_fields
from slbench.cloud.triangulation import Axis, PointCloud, meet
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.show.display import block, length, share
from slbench.core.validation.types import Positive
from slbench.core.validation.values import checked
from slbench.patterns import PhaseMap
from slbench.rig import Camera, Pair, Pose, Projector, Rig

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Standard deviations within which views agree; of Gaussian noise 6 in 100,000 are beyond.
LIMIT = 4.0
#: Panel pixels beyond which views that noise does not explain never agree.
_COARSE_PX = 0.5
#: Points that a median disagreement is of, at the least; a normal deviate's median magnitude.
_LEAST, _MEDIAN = 50, 0.6745
#: Deviation of a coordinate that has none.
_EXACT_PX = 1e-9
#: Footprints of a pixel within which a point beside smooth surface is of its surface, along the
#: pixel's ray: a surface turned by 63 degrees.
_FOOTPRINTS = 2.0
_STEPS = 3


@dataclass(frozen=True, eq=False, repr=False)
class JointCloud(PointCloud):
    """Points that all views of a rig measured together.

    Parameters
    ----------
    points : (N, 3) float
        World coordinates, mm: those of the first pair in its camera's order of pixels, then those
        that only later pairs see.
    pixels : (N, 2) int
        Pixel (u, v) of each point in its own camera.
    shape : (int, int)
        Image (V, U) of the first camera; that of each is in `shapes`.
    axes : tuple of "u", "v"
        Of the columns: each coded axis of each pair, K of them.
    sigma_px : (N, K) float
        Standard deviation of each panel coordinate that took part, px; zero of those that did not.
    sensitivity : (N, K, 3) float
        Derivative of the point by each of them, mm/px; zero of those that did not.
    pairs : tuple of Pair
        Of the columns.
    camera : (N,) int
        Which of the cameras the point's pixel is of, by place in `shapes`.
    shapes : mapping of str to (int, int)
        Image (V, U) of each camera.
    rays : (N,) int
        Devices whose rays meet in the point: two where one camera sees it by one projector.
    chi_square : (N,) float
        Reduced chi-square of the coordinates that took part, one in the mean where their noise is
        all; NaN where there is only one.
    places : (N, C, 2) float32
        Where each camera that took part sees the point, px; NaN for those that did not.
    disagreement : mapping of (Pair, Pair) to float
        What the coordinates of two views differ by where they may be the same, in units of their
        noise (a robust standard deviation, 1 where noise is all).
    agreeing : mapping of (Pair, Pair) to float
        Share of the points that lie on what the other view measured, smooth surface, which agree.
    shared_mm2 : (N, 3, 3) float, optional
        Covariance of errors that views share.
    """

    pairs: tuple[Pair, ...] = ()
    camera: NDArray[np.int8] = field(default_factory=lambda: np.empty(0, np.int8))
    shapes: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    rays: NDArray[np.int8] = field(default_factory=lambda: np.empty(0, np.int8))
    chi_square: Array = field(default_factory=lambda: np.empty(0))
    places: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 0, 2), np.float32))
    disagreement: Mapping[tuple[Pair, Pair], float] = field(default_factory=dict)
    agreeing: Mapping[tuple[Pair, Pair], float] = field(default_factory=dict)
    shared_mm2: Array | None = None

    def __repr__(self) -> str:
        names = ", ".join(self.shapes)
        head = f"JointCloud of {len(self)} points, cameras {names}"
        if not len(self):
            return block(head)
        return block(
            head,
            f"{share(self.several.mean())} with rays of more than two devices, reduced "
            f"chi-square {float(np.nanmean(self.chi_square)) if self.several.any() else 0.0:.3g}",
            f"standard deviation by noise {length(float(np.median(self.sigma_total_mm)))}, "
            f"uncertainty {length(float(np.nanmedian(self.u_total_mm)))} (medians)",
        )

    @property
    def several(self) -> Mask:
        """Points that the rays of more than two devices meet in, (N,)."""
        return np.asarray(self.rays > 2)

    @property
    def u_mm(self) -> Array:
        """Standard uncertainty per world axis, (N, 3), mm: noise and all else that is known."""
        own = super().u_mm
        if self.shared_mm2 is None:
            return own
        shared = np.diagonal(self.shared_mm2, axis1=1, axis2=2)
        return np.sqrt(own**2 + shared)

    def of(self, camera: str) -> PointCloud:
        """Return the points whose pixels are one camera's.

        Raises
        ------
        InputError
            If there is no such camera.
        """
        own = self._of(camera)
        known = self.calibration_mm2
        if self.shared_mm2 is not None:
            known = self.shared_mm2 if known is None else known + self.shared_mm2
        return PointCloud(
            self.points[own],
            self.pixels[own],
            self.shapes[camera],
            self.axes,
            self.sigma_px[own],
            self.sensitivity[own],
            None if self.steady_px is None else self.steady_px[own],
            None if known is None else known[own],
        )

    def image(self, values: NDArray) -> Array:
        """Spread values over the image of the only camera; :meth:`of` is for one of several."""
        if len(self.shapes) > 1:
            raise InputError("image", "points of one camera (cloud.of)", ", ".join(self.shapes))
        return super().image(values)

    def chosen(self, kept: NDArray[np.bool_] | slice) -> JointCloud:
        """Return the cloud of some of its points."""
        result = super().chosen(kept)
        assert isinstance(result, JointCloud)
        parts = {n: getattr(self, n)[kept] for n in ("camera", "rays", "chi_square", "places")}
        shared = None if self.shared_mm2 is None else self.shared_mm2[kept]
        return replace(result, **parts, shared_mm2=shared)

    def moved(self, motion: Pose) -> JointCloud:
        """Return the cloud after a rigid motion: its ``to_world``."""
        result = super().moved(motion)
        assert isinstance(result, JointCloud)
        turn, known = motion.rotation, self.shared_mm2
        return replace(result, shared_mm2=None if known is None else turn @ known @ turn.T)

    def with_steady(self, steady_px: Mapping[Axis, ArrayLike]) -> JointCloud:
        """Return the cloud with a steady error more, the same deviation in all views.

        Errors of different views are taken for independent.

        Raises
        ------
        InputError
            For images of several cameras: :meth:`with_own` takes those.
        """
        if len(self.shapes) > 1 and any(np.ndim(one) for one in steady_px.values()):
            raise InputError("steady_px", "numbers, or with_own", "images of several cameras")
        return self.with_own(dict.fromkeys(self.pairs, steady_px))

    def with_own(self, steady_px: Mapping[Pair, Mapping[Axis, ArrayLike]]) -> JointCloud:
        """Return the cloud with steady errors more that are each view's own.

        Parameters
        ----------
        steady_px : mapping of Pair to mapping of axis to float or (V, U) float
            Standard deviations, px; NaN, and what is not named, are none.
        """
        columns = [
            self._at_places(pair.camera, steady_px.get(pair, {}).get(axis, 0.0))
            for pair, axis in zip(self.pairs, self.axes, strict=True)
        ]
        own = np.stack(columns, axis=1)
        known = 0.0 if self.steady_px is None else self.steady_px
        return replace(self, steady_px=np.hypot(known, own))

    def with_shared(self, steady_px: Mapping[Pair, Mapping[Axis, float]]) -> JointCloud:
        """Return the cloud with errors more that views of one projector share.

        Errors of its response are the same in all cameras, as they are of places on the panel:
        they add with the signs of what they do to the point, and cancel where cameras stand to
        either side.

        Parameters
        ----------
        steady_px : mapping of Pair to mapping of axis to float
            Standard deviations, px; what is not named is none.
        """
        total = np.zeros((len(self), 3, 3)) if self.shared_mm2 is None else self.shared_mm2.copy()
        kinds = {(p.projector, axis) for p, axis in zip(self.pairs, self.axes, strict=True)}
        for projector, axis in sorted(kinds):
            moved = np.zeros((len(self), 3))
            for k, (pair, own) in enumerate(zip(self.pairs, self.axes, strict=True)):
                if (pair.projector, own) == (projector, axis):
                    moved += self.sensitivity[:, k] * steady_px.get(pair, {}).get(axis, 0.0)
            total += moved[:, :, None] * moved[:, None, :]
        return replace(self, shared_mm2=total)

    def fields(self, grey: Mapping[str, ArrayLike] | None = None) -> dict[str, Array]:
        """Return what is known of the points, for :func:`slbench.core.io.write_ply`.

        Parameters
        ----------
        grey : mapping of str to (V, U) float, optional
            Grey values of each camera's pixels.

        Returns
        -------
        dict of str to (N,) float
            As :func:`slbench.cloud.files.write.point_fields`, and ``rays``, ``camera`` (its place
            in `shapes`) and ``residual``: the root of the reduced chi-square, zero where there is
            none.
        """
        found: dict[str, Array] = {}
        for camera in self.shapes:
            own = self._of(camera)
            values = None if grey is None else grey[camera]
            for name, part in point_fields(self.of(camera), values).items():
                found.setdefault(name, np.zeros(len(self)))[own] = part
        residual = np.sqrt(np.nan_to_num(self.chi_square))
        more = {"rays": self.rays, "camera": self.camera, "residual": residual}
        return found | {name: np.asarray(one, np.float64) for name, one in more.items()}

    def _of(self, camera: str) -> Mask:
        names = list(self.shapes)
        if camera not in names:
            raise InputError("camera", f"one of {', '.join(names)}", quoted(camera, names))
        return np.asarray(self.camera == names.index(camera))

    def _at_places(self, camera: str, values: ArrayLike) -> Array:
        """Return values of a camera's image where it sees the points, 0 where it does not."""
        image = np.nan_to_num(np.asarray(values, np.float64))
        if image.ndim == 0:
            return np.full(len(self), float(image))
        place = self.places[:, list(self.shapes).index(camera)]
        seen = np.isfinite(place[:, 0])
        u, v = np.rint(place[seen]).astype(np.intp).T
        result = np.zeros(len(self))
        result[seen] = image[v, u]
        return result


class _View:
    """A pair's panel coordinates, and its points."""

    def __init__(self, rig: Rig, pair: Pair, phase: PhaseMap) -> None:
        self.pair = pair
        self.camera: Camera = rig.cameras[pair.camera]
        self.projector: Projector = rig.projectors[pair.projector]
        self.axes: tuple[Axis, ...] = tuple(phase.coordinate)
        self.columns = ["uv".index(axis) for axis in self.axes]
        expected = (self.camera.height, self.camera.width)
        if phase.mask.shape != expected:
            size = f"the camera's {expected[1]} x {expected[0]} px"
            got = f"{phase.mask.shape[1]} x {phase.mask.shape[0]} px"
            raise InputError(f"phase map of {'-'.join(pair)}", size, got)
        self.mask = phase.mask
        if not self.axes:
            raise InputError(f"phase map of {'-'.join(pair)}", "a coded axis", "none")
        self.value = np.stack([phase.coordinate[axis] for axis in self.axes])
        self.sigma = np.maximum(np.stack([phase.sigma[axis] for axis in self.axes]), _EXACT_PX)
        self.field = PanelField(self.value, self.sigma, self.mask)
        v, u = np.nonzero(self.mask)
        self.pixels = np.column_stack((u, v)).astype(np.int32)
        self.panel, self.noise = (one[:, v, u].T for one in (self.value, self.sigma))
        self.points, slopes = meet(rig.pair(pair), self.pixels, self.axes, self.panel, self.noise)
        along = np.linalg.norm(slopes, axis=2) * self.noise
        with np.errstate(invalid="ignore"):
            self.sigma_mm = np.sqrt(np.sum(along**2, axis=1))
            good = np.isfinite(self.points.sum(axis=1)) & np.isfinite(self.sigma_mm)
        if not good.all():
            for name in ("pixels", "panel", "noise", "points", "sigma_mm"):
                setattr(self, name, getattr(self, name)[good])
        self.index = np.full(self.mask.shape, -1)
        self.index[self.pixels[:, 1], self.pixels[:, 0]] = np.arange(len(self.pixels))

    def residual(
        self, points: Array, directions: Array, pixels: NDArray[Any] | None
    ) -> tuple[Array, Array, Array, Mask, Array]:
        """Return what points on rays differ from this view's coordinates by, N of them, A axes.

        Parameters
        ----------
        points, directions : (N, 3) float
        pixels : (N, 2) int, optional
            Where the rays are this camera's own.

        Returns
        -------
        residual, slope, variance : (N, A) float
            Px, px/mm along the rays, px^2.
        good : (N,) bool
        places : (N, 2) float
        """
        on_panel, by_point = self.projector.project_with_jacobian(points)
        slope = -np.einsum("nki,ni->nk", by_point, directions)[:, self.columns]
        if pixels is None:
            places, moving = self.camera.project_with_jacobian(points)
            there = self.field.at(places)
            value, variance, good = there.value, there.variance, there.good
            across = np.einsum("nki,ni->nk", moving, directions)
            slope = slope + np.einsum("nak,nk->na", there.gradient, across)
        else:
            u, v = pixels.T
            places = pixels.astype(np.float64)
            value, variance, good = (
                self.value[:, v, u].T,
                self.sigma[:, v, u].T ** 2,
                self.mask[v, u],
            )
        residual = value - on_panel[:, self.columns]
        good = good & np.isfinite(residual).all(axis=1) & np.isfinite(slope).all(axis=1)
        return residual, slope, variance, good, places

    def in_footprint(self, points: Array, sigma_mm: Array, limit: float) -> Mask:
        """Return which points lie in the footprint of a measured pixel, beside smooth surface."""
        if not len(self.points):
            return np.zeros(len(points), bool)
        place, by_point = self.camera.project_with_jacobian(points)
        rows, columns = self.mask.shape
        on = np.isfinite(place).all(axis=1) & self.camera.contains(np.nan_to_num(place, nan=-9.0))
        u, v = np.rint(np.where(on[:, None], place, 0.0)).astype(np.intp).T
        own = self.index[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)]
        on &= own >= 0
        apart = points - self.points[own]
        _, directions = self.camera.unproject(self.pixels[own])
        with np.errstate(invalid="ignore", divide="ignore"):
            footprint = np.sqrt(2.0) / np.linalg.norm(by_point, axis=(1, 2))
            along = np.abs(np.einsum("ni,ni->n", apart, directions))
            noise = limit * np.hypot(sigma_mm, self.sigma_mm[own])
            return np.asarray(on & (along <= _FOOTPRINTS * footprint + noise))


@checked
def triangulate_jointly(
    rig: Rig, phases: Mapping[Pair, PhaseMap], limit: Positive = LIMIT
) -> JointCloud:
    """Triangulate what several cameras measured, all rays of a point together.

    Parameters
    ----------
    rig : Rig
    phases : mapping of Pair to PhaseMap
        Panel coordinates by camera and projector, of pairs of the rig: those that were captured.
    limit : float
        Standard deviations within which views of one point agree.

    Returns
    -------
    JointCloud
        Each element of the surface once.  With one pair it is what
        :func:`~slbench.cloud.triangulation.triangulate` gives.

    Raises
    ------
    InputError
        Without phase maps, for a pair that the rig does not have, and a map of another size.
    """
    order = [pair for pair in rig.pairs if pair in phases]
    unknown = [pair for pair in phases if pair not in order]
    if unknown or not order:
        names = ["-".join(pair) for pair in rig.pairs]
        got = quoted("-".join(unknown[0]), names) if unknown else "none"
        raise InputError("phase maps", f"those of pairs of the rig: {', '.join(names)}", got)
    views = [_View(rig, pair, phases[pair]) for pair in order]
    told: dict[tuple[Pair, Pair], tuple[float, float]] = {}
    parts = [_points_of(views, i, limit, told) for i in range(len(views))]
    cameras = list(dict.fromkeys(pair.camera for pair in order))
    starts = np.cumsum([0, *(len(view.axes) for view in views)])
    total = sum(len(part.points) for part in parts)
    sigma, sensitivity = np.zeros((total, starts[-1])), np.zeros((total, starts[-1], 3))
    places = np.full((total, len(cameras), 2), np.nan, np.float32)
    seen = np.zeros((total, len(views)), bool)
    chi, at = np.full(total, np.nan), 0
    for part in parts:
        stop = at + len(part.points)
        freedom = np.full(len(part.points), -1)
        squares = np.zeros(len(part.points))
        for j, (rows, found, weight) in part.taken.items():
            residual, _, variance, _, place = found
            own = slice(starts[j], starts[j + 1])
            sigma[at + rows, own] = np.sqrt(variance)
            sensitivity[at + rows, own] = weight[..., None] * part.directions[rows, None]
            places[at + rows, cameras.index(views[j].pair.camera)] = place
            seen[at + rows, j] = True
            freedom[rows] += residual.shape[1]
            squares[rows] += np.sum(residual**2 / variance, axis=1)
        known = freedom > 0
        chi[at:stop][known] = squares[known] / freedom[known]
        at = stop
    rays = np.zeros(total, np.int8)
    for k in (0, 1):
        names = [view.pair[k] for view in views]
        for name in dict.fromkeys(names):
            rays += seen[:, [own == name for own in names]].any(axis=1)
    return JointCloud(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.pixels for part in parts]),
        views[0].mask.shape,
        tuple(axis for view in views for axis in view.axes),
        sigma,
        sensitivity,
        pairs=tuple(view.pair for view in views for _ in view.axes),
        camera=np.concatenate(
            [
                np.full(len(part.points), cameras.index(view.pair.camera), np.int8)
                for view, part in zip(views, parts, strict=True)
            ]
        ),
        shapes={view.pair.camera: view.mask.shape for view in views},
        rays=rays,
        chi_square=chi,
        places=places,
        disagreement={key: scale for key, (scale, _) in told.items()},
        agreeing={key: agreeing for key, (_, agreeing) in told.items()},
    )


#: What a view says of points: residual, slope, variance, good, places.
_Said = tuple[Array, Array, Array, Mask, Array]


@dataclass(frozen=True, eq=False)
class _Part:
    """The points of one pair's pixels, and by view which of them it took part in, and how."""

    points: Array
    pixels: NDArray[np.int32]
    directions: Array
    taken: dict[int, tuple[NDArray[np.intp], _Said, Array]]


def _points_of(
    views: list[_View],
    i: int,
    limit: float,
    told: dict[tuple[Pair, Pair], tuple[float, float]],
) -> _Part:
    """Return the points of a pair's pixels that no earlier pair has."""
    view = views[i]
    _, directions = view.camera.unproject(view.pixels)
    owned = np.zeros(len(view.pixels), bool)
    agreeing: dict[int, Mask] = {}
    for j, other in enumerate(views):
        if j == i:
            continue
        same = other.pair.camera == view.pair.camera
        said = other.residual(view.points, directions, view.pixels if same else None)
        agrees, scale = _agreeing(said, view.sigma_mm, limit)
        if (both := np.count_nonzero(said[3])) >= _LEAST:
            told[view.pair, other.pair] = scale, np.count_nonzero(agrees) / both
        if j > i:
            agreeing[j] = agrees
            continue
        owned |= agrees
        if not same:
            owned |= ~said[3] & other.in_footprint(view.points, view.sigma_mm, limit)
    kept = np.nonzero(~owned)[0]
    directions, pixels = directions[kept], view.pixels[kept]
    points = view.points[kept]
    rows = {i: np.arange(len(kept))} | {j: np.nonzero(ok[kept])[0] for j, ok in agreeing.items()}
    joined = np.unique(np.concatenate([own for j, own in rows.items() if j != i] or [rows[i][:0]]))
    said_by = {}
    for step in range(_STEPS):
        needed = len(kept) and (len(joined) or step == 0)
        if not needed:
            break
        information, pull = np.zeros(len(kept)), np.zeros(len(kept))
        for j, own in rows.items():
            same = views[j].pair.camera == view.pair.camera
            said = views[j].residual(points[own], directions[own], pixels[own] if same else None)
            if not said[3].all():  # a step led off the smooth surface
                own, said = own[said[3]], _of_rows(said, said[3])
                rows[j] = own
            said_by[j] = said
            residual, slope, variance = said[:3]
            information[own] += np.sum(slope**2 / variance, axis=1)
            pull[own] += np.sum(slope * residual / variance, axis=1)
        move = np.zeros(len(kept))
        move[joined] = -pull[joined] / information[joined]
        points = points + move[:, None] * directions
    taken = {}
    for j, own in rows.items():
        if not len(own):
            continue
        residual, slope, variance, good, places = said_by[j]
        weight = -slope / variance / information[own, None]
        left = residual + slope * move[own, None]
        taken[j] = own, (left, slope, variance, good, places), weight
    return _Part(points, pixels, directions, taken)


def _of_rows(said: _Said, kept: Mask) -> _Said:
    residual, slope, variance, good, places = said
    return residual[kept], slope[kept], variance[kept], good[kept], places[kept]


def _agreeing(said: _Said, sigma_mm: Array, limit: float) -> tuple[Mask, float]:
    """Return where a view agrees with points, and what it disagrees by, in units of noise."""
    residual, slope, variance, good, _ = said
    with np.errstate(invalid="ignore"):
        deviation = np.sqrt(variance + (slope * sigma_mm[:, None]) ** 2)
        scale, agree = agreement(residual, deviation, good, limit)
    return agree, scale


def agreement(residual: Array, deviation: Array, good: Mask, limit: float) -> tuple[float, Mask]:
    """Return what coordinates disagree by, and which of them agree.

    Parameters
    ----------
    residual, deviation : (N, A) float
        Differences of panel coordinates and the standard deviations that noise gives them, px.
    good : (N,) bool
        Which are to be considered.
    limit : float
        Standard deviations within which they agree.

    Returns
    -------
    scale : float
        Robust standard deviation of those that may agree, in units of noise; 1 for too few.
    agree : (N,) bool
        Within `limit` of it, or of noise where it is less, and no further than half a pixel off
        but by noise.
    """
    size = np.abs(residual)
    with np.errstate(invalid="ignore", divide="ignore"):
        near = good & (size <= np.maximum(limit * deviation, _COARSE_PX)).all(axis=1)
        scale = 1.0
        if np.count_nonzero(near) >= _LEAST:
            scale = float(np.median(size[near] / deviation[near])) / _MEDIAN
        return scale, near & (size <= limit * max(scale, 1.0) * deviation).all(axis=1)
