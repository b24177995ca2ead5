"""Which panel axis a rig should code, and the evaluator's maps for it.

A coordinate tells distance where it changes along the camera's ray.  The panel axis along the
baseline does; the other runs along the epipolar lines and tells next to nothing.  A camera beside
the projector wants columns coded (u), a camera above or below it rows (v).

Where the hardware states how many axes are coded and not which, each configuration is given the
one of the smaller predicted mean error.  The change of u and of v along the rays at the middle and
the corners of the volume says where that is plain, and only there one axis is traced in place of
both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import warn_user
from slbench.design.rig.hardware import Hardware, Placement
from slbench.design.rig.kernels.maps import Maps

Array = NDArray[np.float64]

#: Estimated errors of two axes further apart than this factor are ranked as traced ones are.
_CLEAR = 5.0
#: An axis with this many times the other's predicted error runs along the epipolar lines.
_EPIPOLAR = 30.0

_OTHER = {"u": "v", "v": "u"}
_LINES = {"u": "columns", "v": "rows"}


class CodedMaps:
    """The maps of one hardware for the axes that it codes.

    Parameters and errors are those of :class:`~slbench.design.rig.kernels.maps.Maps`.
    """

    def __init__(
        self, hardware: Hardware, planes: Array, strides: tuple[int, int], edges: bool = False
    ) -> None:
        coded = hardware.coded_axes
        self._given = (hardware, planes, strides)
        self._edges = edges
        self.stated = "uv" if coded == 2 else None if coded == 1 else str(coded)
        self._maps: dict[str, Maps] = {}
        self._any = self.along(self.stated or "u")
        self.silhouette = self._any.silhouette

    def along(self, axes: str) -> Maps:
        """Return the maps for patterns along `axes`, made once."""
        if axes not in self._maps:
            self._maps[axes] = Maps(*self._given, axes, edges=self._edges)
        return self._maps[axes]

    def metrics(self, place: Placement) -> tuple[Array, NDArray[np.str_]]:
        """Return mu, sigma, the number of points and the dispersion, (n, 4); and the axes, (n,)."""
        if self.stated:
            return self._any.metrics(place), np.full(len(place.valid), self.stated)
        ratio = self.estimated_ratio(place)
        found = {}
        for axis, hopeless in (("u", ratio > _CLEAR), ("v", ratio < 1.0 / _CLEAR)):
            rows = np.flatnonzero(~hopeless)
            found[axis] = np.full((len(ratio), 4), np.nan)
            if rows.size:
                found[axis][rows] = self.along(axis).metrics(place.of(rows.tolist()))
        u, v = found["u"], found["v"]
        # One that was not traced has no number of points; of two without points, the estimate says.
        unseen = np.isnan(u[:, 0]) & np.isnan(v[:, 0])
        rows_coded = np.isnan(u[:, 2]) | (v[:, 0] < u[:, 0]) | (unseen & (ratio > 1.0))
        return np.where(rows_coded[:, np.newaxis], v, u), np.where(rows_coded, "v", "u")

    def estimated_ratio(self, place: Placement) -> Array:
        """Return the error with columns coded over that with rows, estimated, (n,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.mean(1.0 / self._any.slopes(place), axis=2)
            return np.asarray(error[:, 0] / error[:, 1])


def question_axes(maps: CodedMaps, place: Placement, mu: Array, *, stacklevel: int = 3) -> None:
    """Warn where the axis that the hardware states runs along the epipolar lines.

    Parameters
    ----------
    maps : CodedMaps
    place : Placement
    mu : (n,) float
        Predicted mean errors, mm.
    stacklevel : int
        As of :func:`~slbench.core.errors.warn_user`.
    """
    stated = maps.stated
    if stated not in _OTHER:
        return
    ratio = maps.estimated_ratio(place)
    # Only the estimate's suspects are traced with the other axis, too.
    suspects = np.flatnonzero((ratio if stated == "u" else 1.0 / ratio) > _EPIPOLAR / 10.0)
    if not suspects.size:
        return
    other = _OTHER[stated]
    better = maps.along(other).metrics(place.of(suspects.tolist()))[:, 0]
    bad = mu[suspects] > _EPIPOLAR * better
    if not bad.any():
        return
    first = int(np.flatnonzero(bad)[0])
    row = int(suspects[first])
    warn_user(
        f"coded_axes {stated}",
        f"{np.count_nonzero(bad)} of {len(mu)} rigs have their baseline along the panel's "
        f"{_LINES[stated]}, which tell no distance there; rig {row + 1}: predicted error "
        f"{mu[row]:.3g} mm, with {_LINES[other]} coded {better[first]:.3g} mm "
        f'(coded_axes = "{other}", or 1 for the better one of each rig)',
        stacklevel=stacklevel,
    )
