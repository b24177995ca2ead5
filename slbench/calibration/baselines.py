"""Baselines of the calibration: look-up tables per pixel, and pinholes; scored side by side.

*Look-up tables* (thesis 2.4.2): a plane is seen at several heights, and every camera pixel has
its own regression of the height by the panel coordinate.  Linear [63]: ``z = a + b u_p``.
Reciprocal [55]: ``1 / h = b + a / d`` for the height ``h = z - z_0`` over a reference plane
and the change ``d = u_p - u_p0`` of the panel coordinate since it; exact for pinholes.  ``x``
and ``y`` are linear in ``z`` along a pixel's ray.

The literature sees a bare plane, so that a pixel has a phase for every height.  Here markings
are scattered: at each height ``u_p``, x, y and z are interpolated between them to the pixel in
question (piecewise cubic, Clough & Tocher), and the pixel's regression is made from those
values.  That is the table's entry of that very pixel: no cells, no interpolated coefficients.

*Pinholes* are in :mod:`~slbench.calibration.models.pinhole`.

Methods are scored on heights that none of them was fitted to.  Further ones are rows of
:data:`calibration_baselines`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.spatial import QhullError

from slbench.calibration.models.pinhole import PinholeModel
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import Axes, checked_inputs
from slbench.calibration.scores import median_absolute, rms
from slbench.calibration.selection import select_models
from slbench.core.errors import InputError, warn_user
from slbench.core.registry import Registry

Array = NDArray[np.float64]
TableKind = Literal["linear", "reciprocal"]

#: Least heights that a pixel must be seen at: one more than the regression has coefficients.
_LEAST_HEIGHTS = 3


class Predictor(Protocol):
    """What the comparison asks of a method."""

    def predict(self, points: ArrayLike) -> Array:
        """Return world points (n, 3), mm, NaN where the method has none."""


@dataclass(frozen=True)
class Training:
    """What a baseline is fitted to.

    Parameters
    ----------
    points : CalibrationPoints
    planes : (n,) int
        Height that each point belongs to; see :func:`plane_labels`.
    camera_size, panel_size : (int, int)
        Width and height, px.
    axes : {"u", "uv"}
        Panel axes that inputs of ``predict`` have.
    """

    points: CalibrationPoints
    planes: NDArray
    camera_size: tuple[int, int]
    panel_size: tuple[int, int]
    axes: Axes


#: Methods to compare with, by name: a row fits one, or returns None where such points do not
#: allow it.  To add one, write its function and name it here; outside slbench the entry-point
#: group ``slbench.calibration_baselines``, or a module that a scene names.
calibration_baselines: Registry[Callable[[Training], Predictor | None]] = Registry(
    "calibration baseline",
    "slbench.calibration_baselines",
    {
        "linear table": "slbench.calibration.baselines:linear_table",
        "reciprocal table": "slbench.calibration.baselines:reciprocal_table",
        "pinholes": "slbench.calibration.baselines:pinholes",
    },
    base="collections.abc:Callable",
)


def linear_table(training: Training) -> Predictor:
    """Fit the look-up table with straight lines."""
    return PhaseHeightTable("linear").fit(training.points, training.planes)


def reciprocal_table(training: Training) -> Predictor:
    """Fit the look-up table with the reciprocal relation."""
    return PhaseHeightTable("reciprocal").fit(training.points, training.planes)


def pinholes(training: Training) -> Predictor | None:
    """Calibrate two pinholes, where both panel coordinates are known."""
    if not np.all(np.isfinite(training.points.pixels)):
        return None
    model = PinholeModel(training.camera_size, training.panel_size, training.axes)
    return model.fit(training.points)


class PhaseHeightTable:
    """Phase-to-height look-up table per camera pixel; see the module's docstring.

    Parameters
    ----------
    kind : {"linear", "reciprocal"}

    Attributes
    ----------
    heights_ : (h,) float
        Mean height of each plane, mm, ascending.
    """

    def __init__(self, kind: TableKind = "reciprocal") -> None:
        if kind not in ("linear", "reciprocal"):
            raise InputError("look-up table", "linear or reciprocal", repr(kind))
        self.kind = kind

    def fit(self, points: CalibrationPoints, planes: NDArray) -> PhaseHeightTable:
        """Take the planes' markings.

        Parameters
        ----------
        points : CalibrationPoints
        planes : (n,) int
            Which height each point belongs to; see :func:`plane_labels`.

        Raises
        ------
        InputError
            With fewer than three heights, or markings on a line.
        """
        labels = np.unique(planes)
        if len(labels) < _LEAST_HEIGHTS:
            raise InputError("look-up table", f"at least {_LEAST_HEIGHTS} heights", len(labels))
        means = np.array([points.world[planes == label, 2].mean() for label in labels])
        order = np.argsort(means)
        self.heights_ = means[order]
        self._planes = []
        for label in labels[order]:
            some = points.select(planes == label)
            values = np.column_stack((some.pixels[:, 2], some.world))
            try:
                self._planes.append(CloughTocher2DInterpolator(some.pixels[:, :2], values))
            except (QhullError, ValueError):
                expected = "three markings or more, not on a line, at every height"
                raise InputError("look-up table", expected, f"{len(some)} points") from None
        return self

    def predict(self, points: ArrayLike) -> Array:
        """Return world points (n, 3), mm, at inputs (n, 3 or 4).

        NaN at pixels that fewer than three heights were seen at.
        """
        inputs = checked_inputs(points)
        seen = np.stack([plane(inputs[:, :2]) for plane in self._planes], axis=1)  # (n, h, 4)
        known = np.isfinite(seen).all(axis=2)
        enough = known.sum(axis=1) >= _LEAST_HEIGHTS
        panel, z = seen[..., 0], seen[..., 3]
        if self.kind == "linear":
            height = _regress(panel, z, known)(inputs[:, 2])
        else:
            height = _reciprocal(panel, z, known, inputs[:, 2])
        columns = [_regress(z, seen[..., k], known)(height) for k in (1, 2)]
        result = np.column_stack((*columns, height))
        result[~enough] = np.nan
        return result


def _regress(x: Array, y: Array, known: NDArray[np.bool_]) -> Any:
    """Return the function that evaluates, row by row, the straight line of y (n, h) over x."""
    count = np.maximum(known.sum(axis=1), 1)
    x0 = np.where(known, x, 0.0).sum(axis=1) / count
    y0 = np.where(known, y, 0.0).sum(axis=1) / count
    dx = np.where(known, x - x0[:, None], 0.0)
    dy = np.where(known, y - y0[:, None], 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.sum(dx * dy, axis=1) / np.sum(dx * dx, axis=1)
    return lambda at: y0 + slope * (at - x0)


def _reciprocal(panel: Array, z: Array, known: NDArray[np.bool_], at: Array) -> Array:
    """Return heights by ``d = a h + b h d`` about each pixel's lowest plane.

    The reciprocal relation times ``h d``, which is linear in a and b too, and weighs the
    planes by the noise of d rather than by that of 1 / d, which grows without bound as the
    reference plane comes near.
    """
    rows, first = np.arange(len(panel)), np.argmax(known, axis=1)
    u0, z0 = panel[rows, first], z[rows, first]
    d = np.where(known, panel - u0[:, None], 0.0)
    h = np.where(known, z - z0[:, None], 0.0)
    hd = h * d
    aa, ab, bb = (np.sum(p * q, axis=1) for p, q in ((h, h), (h, hd), (hd, hd)))
    ra, rb = np.sum(h * d, axis=1), np.sum(hd * d, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Two unknowns: Cramer's rule.
        determinant = aa * bb - ab * ab
        a, b = (ra * bb - rb * ab) / determinant, (rb * aa - ra * ab) / determinant
        return z0 + (at - u0) / (a + b * (at - u0))


def plane_labels(z_mm: ArrayLike, gap_mm: float | None = None) -> NDArray[np.intp]:
    """Group points by height.

    Parameters
    ----------
    z_mm : (n,) float
    gap_mm : float, optional
        Heights further apart than this belong to different planes.  By default half of the
        largest gap, which suits the even steps of a stage.

    Returns
    -------
    (n,) int
        0 for the lowest plane, and so on.
    """
    z = np.asarray(z_mm, dtype=np.float64)
    if z.ndim != 1 or len(z) == 0 or not np.all(np.isfinite(z)):
        raise InputError("heights", "finite numbers (n,)", f"shape {z.shape}")
    order = np.argsort(z, kind="stable")
    gaps = np.diff(z[order])
    limit = 0.5 * float(gaps.max(initial=0.0)) if gap_mm is None else gap_mm
    labels = np.empty(len(z), dtype=np.intp)
    labels[order] = np.concatenate(([0], np.cumsum(gaps > limit)))
    return labels


@dataclass(frozen=True)
class MethodScore:
    """Errors of one method on the heights held out, mm.

    Attributes
    ----------
    rms, mad : dict of "x", "y", "z" to float
        Root mean square, and median of absolute errors.
    rms_3d, mad_3d : float
        Root sum square of the three (the thesis's isometric errors).
    measured : float
        Share of the points that the method has an answer for.
    """

    rms: dict[str, float]
    mad: dict[str, float]
    rms_3d: float
    mad_3d: float
    measured: float


@dataclass(frozen=True)
class Comparison:
    """What :func:`compare_methods` found.

    Attributes
    ----------
    scores : dict of method name to MethodScore
    planes : int
        Heights in all.
    held_out : tuple of int
        Those held out, 0 being the lowest.
    points : int
        Points on them for which every method has an answer, which the scores are of.
    """

    scores: dict[str, MethodScore]
    planes: int
    held_out: tuple[int, ...]
    points: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; lengths in mm."""
        return {
            "methods": {name: vars(score) for name, score in self.scores.items()},
            "planes": self.planes,
            "held_out": self.held_out,
            "points": self.points,
        }


def compare_methods(
    points: CalibrationPoints,
    camera_size: tuple[int, int],
    panel_size: tuple[int, int],
    *,
    planes: NDArray | None = None,
    held_out: tuple[int, ...] | None = None,
    axes: Axes = "u",
    baselines: Sequence[str] | None = None,
    seed: int = 0,
) -> Comparison:
    """Score polynomial, look-up tables and pinholes on the same heights held out.

    Every method is fitted to those points of the other heights that fit together
    (:mod:`~slbench.calibration.trimmed`): tables and pinholes have no defence of their own against
    a wrong fringe order.  What is scored is all points of the heights held out: of wrong orders
    among those the medians tell, and not the root mean squares.

    Parameters
    ----------
    points : CalibrationPoints
    camera_size, panel_size : (int, int)
        Width and height, px, for the pinholes.
    planes : (n,) int, optional
        Height of each point; by default :func:`plane_labels`.
    held_out : tuple of int, optional
        Labels of the heights to score on; by default every other one, without the lowest and
        the highest, so that no method extrapolates.
    axes : {"u", "uv"}
        Panel axes that the polynomial uses.  The pinholes' calibration needs both where they
        are known, and so the pinholes are left out where ``v_p`` is not.
    baselines : sequence of str, optional
        Names of :data:`calibration_baselines`; all by default.
    seed : int
        Of the polynomial's split.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        With fewer than three heights left, or where no point has an answer by all.

    Warns
    -----
    InputWarning
        For a method that the points do not fit, which is left out.
    """
    labels = plane_labels(points.world[:, 2]) if planes is None else np.asarray(planes)
    if labels.shape != (len(points),):
        raise InputError("planes", f"a label for each of the {len(points)} points", labels.shape)
    names = np.unique(labels)
    chosen = tuple(int(k) for k in names[1:-1:2]) if held_out is None else tuple(held_out)
    test = np.isin(labels, chosen)
    if not test.any() or len(names) - len(chosen) < _LEAST_HEIGHTS:
        expected = f"heights to hold out, and {_LEAST_HEIGHTS} or more to fit to"
        raise InputError("calibration points", expected, f"{len(names)} heights")
    train, rest = points.select(~test), points.select(test)
    selection = select_models(train, axes=axes, seed=seed)
    methods: dict[str, Predictor] = {"polynomial": selection.model}
    right = np.ones(len(train), dtype=np.bool_)
    right[selection.gross] = right[selection.gross_validation] = False
    some = train.select(right)
    training = Training(some, labels[~test][right], camera_size, panel_size, axes)
    for name in calibration_baselines.names() if baselines is None else baselines:
        try:
            fitted = calibration_baselines.get(name)(training)
        except InputError as error:
            warn_user(f"calibration by {name}", f"left out of the comparison: {error}")
            continue
        if fitted is not None:
            methods[name] = fitted
    errors = {}
    for name, method in methods.items():
        errors[name] = method.predict(rest.inputs(axes)) - rest.world
    found = {name: np.isfinite(error).all(axis=1) for name, error in errors.items()}
    common = np.all(list(found.values()), axis=0)
    if not common.any():
        raise InputError("calibration points", "points that every method has an answer for", "none")
    scores = {
        name: _score(error[common], float(found[name].mean())) for name, error in errors.items()
    }
    return Comparison(scores, len(names), chosen, int(common.sum()))


def _score(errors: Array, measured: float) -> MethodScore:
    squares = {name: rms(errors[:, k]) for k, name in enumerate("xyz")}
    medians = {name: median_absolute(errors[:, k]) for k, name in enumerate("xyz")}
    return MethodScore(
        squares,
        medians,
        float(np.linalg.norm(list(squares.values()))),
        float(np.linalg.norm(list(medians.values()))),
        measured,
    )
