r"""What is known of a lens's distortion: of the field that its coefficients make together.

Coefficients of a wide model are told together: of a rational lens k1 and k4, k2 and k5, k3 and k6
nearly do the same, so that each may be off by more than it is itself while pictures tell their
field well.  So it is the field that is judged, by the coefficients' whole covariance C.

A pixel is moved by the coefficients as J says, px.  A part of that is what a pinhole does: another
focal length, centre or turn of the device, which other parameters take up.  With B what these do,
and at the points that were seen ``B_s^+`` its inverse, what is left is

    F = J - B B_s^+ J_s,        S = F C F^T

wherever in the picture, S of the two coordinates of a pixel.  A deviation is here a distance, the
root of the trace of S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.bundle.adjustment.adjust import pixels_by
from slbench.rig import Rig
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.parameters import LENS, TURN, ParameterCovariance

Array = NDArray[np.float64]

#: Distortion is not determined where its deviation in the picture is more, px.
DISTORTION_PX = 2.0
#: Places of the picture where it is looked at, along each axis.
_PLACES = 9
#: Radial coefficients, those of the widest models first, and tangential ones.
_RADIAL, _TANGENTIAL = ("k6", "k5", "k4", "k3", "k2", "k1"), ("p1", "p2")


@dataclass(frozen=True, eq=False, kw_only=True)
class DistortionField:
    """A device's distortion and what is known of it, of m coefficients.

    Parameters
    ----------
    names : tuple of str
        Of the coefficients that were fitted: ``k1``.
    covariance : (m, m) float
    seen : (n, 2, m) float
        F of the module's docstring at the points that were seen, px.
    picture : (k, 2, m) float
        The same all over the picture, where the lens is defined.
    """

    names: tuple[str, ...]
    covariance: Array
    seen: Array
    picture: Array

    @cached_property
    def seen_px(self) -> float:
        """Root mean square deviation of the field where points were seen, px."""
        return float(np.sqrt(np.mean(_traces(self.seen, self.covariance))))

    @cached_property
    def picture_px(self) -> float:
        """Largest deviation of the field anywhere in the picture, px."""
        return self._largest(())

    def _largest(self, fixed: Sequence[str]) -> float:
        """Return the largest deviation in the picture if some coefficients were known, px."""
        at = np.isin(self.names, fixed)
        own, cross = self.covariance[np.ix_(~at, ~at)], self.covariance[np.ix_(~at, at)]
        given = own - cross @ np.linalg.pinv(self.covariance[np.ix_(at, at)]) @ cross.T
        traces = _traces(self.picture[:, :, ~at], given)
        return float(np.sqrt(np.max(traces, initial=0.0)))

    @cached_property
    def superfluous(self) -> tuple[tuple[str, ...], float]:
        """Coefficients without which the field is determined, and its deviation then, px.

        The fewest that do, and among these those of the widest model; none where it is determined.
        """
        radial = [name for name in _RADIAL if name in self.names]
        tangential = [name for name in _TANGENTIAL if name in self.names]
        narrower = [radial[:k] for k in range(len(radial) + 1)]
        trials = [*narrower, *([name] for name in (*radial, *tangential))]
        trials += [[*some, *tangential] for some in narrower]
        for fixed in (*sorted(trials, key=len), self.names):
            left = self._largest(fixed)
            if left <= DISTORTION_PX:
                break
        return tuple(name for name in self.names if name in fixed), left

    @cached_property
    def together(self) -> tuple[str, ...]:
        """Coefficients, two at least, that are not known each, of a field that is."""
        if self.superfluous[0]:
            return ()
        alone = np.sqrt(np.diag(self.covariance)) * np.max(
            np.linalg.norm(self.picture, axis=1), axis=0, initial=0.0
        )
        names = tuple(np.array(self.names)[alone > DISTORTION_PX].tolist())
        return names if len(names) > 1 else ()


def distortion_field(
    rig: Rig, role: str, seen: Array, known: ParameterCovariance
) -> DistortionField | None:
    """Return what is known of a device's distortion; None where none of it was fitted.

    Parameters
    ----------
    rig : Rig
    role : {"camera", "projector"}
    seen : (n, 2) float
        Where the device has the points, px.
    known : ParameterCovariance
        Of the rig's parameters.
    """
    names = tuple(name for name in COEFFICIENTS if f"{role}.{name}" in known.names)
    if not names:
        return None
    device = getattr(rig, role)
    across = [np.linspace(0.0, n - 1.0, _PLACES) for n in (device.width, device.height)]
    picture = np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2)

    def fields(pixels: Array) -> tuple[Array, Array]:
        origins, directions = device.unproject(pixels)
        columns = [
            pixels_by(rig, f"{role}.{name}", origins + directions)
            for name in (*names, *LENS, *TURN)
        ]
        both = np.stack(columns, axis=-1)
        both = both[np.isfinite(both).all(axis=(1, 2))]  # within the fold of the lens
        return both[:, :, : len(names)], both[:, :, len(names) :]

    (own, pinhole), (wide, beside) = fields(seen), fields(picture)
    size = np.maximum(np.linalg.norm(pinhole.reshape(-1, pinhole.shape[-1]), axis=0), 1e-300)
    taken, *_ = np.linalg.lstsq(
        (pinhole / size).reshape(-1, len(size)), own.reshape(-1, len(names)), rcond=1e-9
    )
    return DistortionField(
        names=names,
        covariance=known.part([f"{role}.{name}" for name in names]),
        seen=own - (pinhole / size) @ taken,
        picture=wide - (beside / size) @ taken,
    )


def _traces(fields: Array, covariance: Array) -> Array:
    """Return the variance of a field's distance at each place, (n,)."""
    return np.maximum(np.einsum("nia,ab,nib->n", fields, covariance, fields), 0.0)
