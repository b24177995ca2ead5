"""What a configuration can be expected to measure: the metrics of thesis 3.2.

A flat plane at several heights of the measurement volume is seen by a sample of the camera's
pixels.  Each sends 3 x 3 rays, at 1/4, 1/2 and 3/4 of its width and height, to the plane and
on to the panel; where at least 5 of them meet the same panel pixel, the pixel has a *unique
correspondence* with it (3.1.3).  The error of the point ``T`` where the centre ray meets the
plane is ``e = |T' - T|`` with the reconstructed point ``T'`` (3.1.4, eq. 13):

* one coded axis: the centre ray cut with the plane through the projector's nodal point and
  the panel column's centre (where it meets the column, if the projector's lens distorts), or
  the row's where rows are coded;
* two: the least-squares point of the rays of both pixels, the middle of their shortest
  connection: what ``triangulate(..., meeting="nearest")`` does.

Which axis is coded where the hardware states their number only, and whether one that is stated
can measure at all: :mod:`slbench.design.rig.coded`.

Metrics, over all points in the volume: mean ``mu`` and standard deviation ``sigma`` of e (with
N - 1), their number ``N_s``, their mean distance ``d`` to the nearest other one, and ``eta``,
the share of the panel inside the silhouette of the volume (hull of its eight corners).

Pixel coordinates are those of pixel *centres* throughout; the mean error is then about a third
of thesis table 5's, at nearly the same ranking.  With the ray a quarter of a pixel beside the
centre and the column's place three quarters beside it (``convention = "thesis"``) it is 0.88 of
it, within 3 %: an index that begins at another number in either place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.design.rig.coded import CodedMaps, question_axes
from slbench.design.rig.constraints import CONSTRAINTS, Constraints
from slbench.design.rig.convex import coverage
from slbench.design.rig.hardware import Hardware, Placement
from slbench.rig import DesignVariables

Array = NDArray[np.float64]

#: Which ray of a pixel and which place of a panel column a point is reconstructed from.
Convention = Literal["centres", "thesis"]
#: Camera columns and rows between sampled pixels, which reproduces thesis table 5's N_s.
THESIS_STRIDE = (20, 24)
#: Heights of the planes as shares of the volume's half depth.
_PLANES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])


@dataclass(frozen=True)
class Evaluation:
    """Metrics and constraints of n configurations.

    Parameters
    ----------
    mu_mm, sigma_mm : (n,) float
        Mean and standard deviation of the error; NaN with no point, or with only one.
    eta : (n,) float
        Share of the panel that the volume's silhouette covers; NaN where a corner of the
        volume is behind the projector.
    n_points : (n,) int
        Points with a unique correspondence, N_s.
    dispersion_mm : (n,) float
        Mean distance of a point to its nearest neighbour; NaN with fewer than two.
    margins : (n, 6) float
        Signed margins of g1..g6, mm, positive where the constraint holds.
    camera_distance_mm, projector_distance_mm : (n,) float
        From the world's origin.
    angle_deg : (n,) float
        Triangulation angle.
    axes : (n,) str
        Panel axes that the patterns code: ``"u"``, ``"v"`` or ``"uv"``.
    """

    mu_mm: Array
    sigma_mm: Array
    eta: Array
    n_points: NDArray[np.int64]
    dispersion_mm: Array
    margins: Array
    camera_distance_mm: Array
    projector_distance_mm: Array
    angle_deg: Array
    axes: NDArray[np.str_]

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.mu_mm)

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Where all six margins are positive, (n,)."""
        return np.all(self.margins > 0, axis=1)

    @property
    def objectives(self) -> Array:
        """To minimise: ``(mu sigma, -eta N_s, -d)`` of thesis eq. 20, (n, 3).

        Infinite in all three where there are fewer than two points: nothing was measured.
        """
        return _objectives(self.mu_mm, self.sigma_mm, self.n_points, self.dispersion_mm, self.eta)

    def rows(self) -> list[dict[str, Any]]:
        """Return one dictionary of plain numbers a configuration, for JSON and tables."""
        return [
            {
                "mu_mm": float(self.mu_mm[i]),
                "sigma_mm": float(self.sigma_mm[i]),
                "eta": float(self.eta[i]),
                "n_points": int(self.n_points[i]),
                "dispersion_mm": float(self.dispersion_mm[i]),
                "feasible": bool(self.feasible[i]),
                "margins": dict(zip(CONSTRAINTS, self.margins[i].tolist(), strict=True)),
                "camera_distance_mm": float(self.camera_distance_mm[i]),
                "projector_distance_mm": float(self.projector_distance_mm[i]),
                "angle_deg": float(self.angle_deg[i]),
                "axes": str(self.axes[i]),
            }
            for i in range(len(self))
        ]


def evaluate(
    hardware: Hardware,
    configurations: ArrayLike | Sequence[DesignVariables],
    *,
    stride: tuple[int, int] = THESIS_STRIDE,
    planes_mm: ArrayLike | None = None,
    convention: Convention = "centres",
) -> Evaluation:
    """Evaluate configurations of a rig.

    Parameters
    ----------
    hardware : Hardware
    configurations : (n, 6 + m) float or list of DesignVariables
        In mm and rad.
    stride : (int, int)
        Every how many-th camera column and row is sampled, from the first; (1, 1) is the
        whole sensor.
    planes_mm : (p,) float or None
        Heights of the planes, inside the volume; by default -1/2, -1/4, 0, 1/4 and 1/2 of
        its depth (thesis: -15, -7.5, 0, 7.5, 15 mm).
    convention : {"centres", "thesis"}
        From which ray of the camera's pixel and which place of the panel's column points are
        reconstructed: their centres, or those that reproduce thesis table 5, at (1/4, 1/4) and 3/4
        beside them; for one coded axis and lenses without distortion.

    Returns
    -------
    Evaluation
        Metrics of infeasible configurations, too, as far as they make sense.

    Raises
    ------
    InputError
        If configurations, stride, planes or convention cannot be used.

    Warns
    -----
    InputWarning
        If the axis that the hardware states runs along the epipolar lines of a configuration.
    """
    evaluator = Evaluator(hardware, stride=stride, planes_mm=planes_mm, convention=convention)
    placement = hardware.place(configurations)
    result = evaluator.evaluate(placement)
    evaluator.question(placement, result)
    return result


class Evaluator:
    """Evaluates configurations of one hardware, whose own part of the work is done once.

    Parameters and errors are those of :func:`evaluate`.
    """

    def __init__(
        self,
        hardware: Hardware,
        *,
        stride: tuple[int, int] = THESIS_STRIDE,
        planes_mm: ArrayLike | None = None,
        convention: Convention = "centres",
    ) -> None:
        if convention not in get_args(Convention):
            raise InputError("convention", " or ".join(get_args(Convention)), repr(convention))
        plain = not any(hardware.camera.distortion) and not any(hardware.projector.distortion)
        if convention == "thesis" and not (plain and hardware.coded_axes not in (2, "uv")):
            expected = "one coded axis and lenses without distortion, as the thesis's"
            raise InputError("convention thesis", expected, "others")
        planes = _checked_planes(planes_mm, 0.5 * hardware.volume_mm[2])
        whole = np.asarray(stride)
        if whole.shape != (2,) or whole.dtype.kind not in "iu" or whole.min() < 1:
            raise InputError("stride", "two whole numbers, at least 1", stride)
        strides = (int(whole[0]), int(whole[1]))
        self._maps = CodedMaps(hardware, planes, strides, edges=convention == "thesis")
        self._size = (hardware.projector.width, hardware.projector.height)
        self._constraints = Constraints(hardware)
        self._hardware = hardware
        self._sampled: dict[str, Any] = {
            "stride": strides,
            "planes_mm": planes,
            "convention": convention,
        }

    def objectives(self, placement: Placement) -> Array:
        """Return :attr:`Evaluation.objectives` alone, without the margins, (n, 3)."""
        metrics, _, eta = self._measured(placement)
        mu, sigma, count, dispersion = metrics.T
        return _objectives(mu, sigma, count, dispersion, eta)

    def evaluate(self, placement: Placement) -> Evaluation:
        """Return metrics and constraints of devices placed."""
        metrics, axes, eta = self._measured(placement)
        return Evaluation(
            mu_mm=metrics[:, 0],
            sigma_mm=metrics[:, 1],
            eta=eta,
            n_points=metrics[:, 2].astype(np.int64),
            dispersion_mm=metrics[:, 3],
            margins=self._constraints.margins(placement),
            camera_distance_mm=placement.camera_distance,
            projector_distance_mm=placement.projector_distance,
            angle_deg=np.rad2deg(placement.angle),
            axes=axes,
        )

    def question(self, placement: Placement, evaluation: Evaluation) -> None:
        """Warn where the other axis would measure far better (:func:`evaluate`)."""
        if self._hardware.optics:
            return  # the maps are those of other lenses
        question_axes(self._maps, placement, evaluation.mu_mm, stacklevel=4)

    def _measured(self, placement: Placement) -> tuple[Array, NDArray[np.str_], Array]:
        if self._hardware.optics:
            each = [self._of_lenses(placement.of([k])) for k in range(len(placement.valid))]
            metrics, axes, eta = (np.concatenate(part) for part in zip(*each, strict=True))
            return metrics, axes, eta
        metrics, axes = self._maps.metrics(placement)
        return metrics, axes, coverage(self._maps.silhouette(placement), *self._size)

    def _of_lenses(self, placement: Placement) -> tuple[Array, NDArray[np.str_], Array]:
        """Return what is measured of one configuration, whose lenses have maps of their own."""
        variant = self._hardware.variant(placement.optics[0])
        return Evaluator(variant, **self._sampled)._measured(placement)


def _objectives(
    mu: Array, sigma: Array, count: NDArray[Any], dispersion: Array, eta: Array
) -> Array:
    """Return (mu sigma, -eta N_s, -d), (n, 3); infinite where something is not known."""
    values = np.stack((mu * sigma, -eta * count, -dispersion), axis=1)
    values[~np.all(np.isfinite(values), axis=1)] = np.inf
    return values


def _checked_planes(planes_mm: ArrayLike | None, half_depth: float) -> Array:
    if planes_mm is None:
        return _PLANES * half_depth
    expected = f"distinct heights within {half_depth} mm of the reference plane"
    try:
        planes = np.sort(np.asarray(planes_mm, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError("planes", expected, planes_mm) from None
    inside = planes.ndim == 1 and planes.size and np.all(np.abs(planes) <= half_depth)
    if not inside or np.any(np.diff(planes) <= 0):
        raise InputError("planes", expected, planes.tolist())
    return planes
