"""How good is a fused stack?  Against the frames of the same scene that are sharp everywhere.

A simulation has them: the scene through pinholes (:mod:`slbench.simulate.sharp`).

Intensities are compared over all patterns, phases over the finest fringe set; both for the
fused frames and for the single middle setting, inside and outside that setting's depth of
field.  A pixel is inside where the circles of confusion of both devices together, in periods of
the finest fringes, are below ``BLUR``: there the fringes keep 81 % of their modulation or more,
as 2 J1(x) / x with x = pi BLUR is 0.81 for a blur disc of that diameter.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.stack import FocusStack, FusedCapture
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.patterns import Axis
from slbench.scene.truth import GroundTruth

Array = NDArray[np.float64]

#: Circle of confusion that ends the depth of field, periods of the finest fringes.
BLUR = 0.4


@dataclass(frozen=True)
class Sharpness:
    """Errors over some pixels: intensity as a share of full scale, phase in radians; RMS."""

    pixels: int
    intensity_rms: float
    phase_rms: float


@dataclass(frozen=True)
class FusionScore:
    """A fused stack and its middle setting against the all-in-focus truth.

    ``inside`` and ``outside`` the middle setting's depth of field; NaN where there are no
    pixels.  ``finest`` is the number of fringes whose phase is compared.
    """

    finest: float
    fused_inside: Sharpness
    fused_outside: Sharpness
    middle_inside: Sharpness
    middle_outside: Sharpness

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return the score as plain values for JSON."""
        parts = ("fused_inside", "fused_outside", "middle_inside", "middle_outside")
        return {"finest": self.finest} | {name: vars(getattr(self, name)) for name in parts}


def score_fusion(
    stack: FocusStack,
    fused: FusedCapture,
    expected: Iterable[tuple[int, Array]],
    truth: GroundTruth,
) -> FusionScore:
    """Score fused frames against sharp ones.

    Parameters
    ----------
    stack : FocusStack
    fused : FusedCapture
        Of that stack.
    expected : iterable of (int, (V, U) float)
        Index and picture of every frame without blur and noise, DN of the stack's captures.
    truth : GroundTruth

    Returns
    -------
    FusionScore
        Over smooth lit surface.

    Raises
    ------
    InputError
        If the patterns have no fringes.
    """
    sequence = stack.captures[0].sequence
    finest = sequence.finest()
    if finest is None:
        raise InputError("fusion score", "fringes among the patterns", sequence.name)
    fringes, (axis,) = finest.code.fringe_count(sequence.panel), finest.code.axes
    assert fringes is not None  # by finest
    smooth = truth.smooth()
    blur = _blur(truth, axis, fringes, sequence.size(axis))
    places = {"inside": smooth & (blur <= BLUR), "outside": smooth & (blur > BLUR)}

    middle = len(stack) // 2
    squares = {name: np.zeros(smooth.shape) for name in ("fused", "middle")}
    phases: dict[str, list[Array]] = {"true": [], "fused": [], "middle": []}
    top = 2.0 ** stack.captures[0].bit_depth - 1.0
    scale = 2.0 ** (fused.capture.bit_depth - stack.captures[0].bit_depth)
    for k, true in expected:
        shown = {
            "fused": fused.capture.frames[k] / scale,
            "middle": stack.frame(middle, k).astype(np.float64),
        }
        for name, frame in shown.items():
            squares[name] += ((frame - true) / top) ** 2 / sequence.n_frames
        if k in finest.frames:
            for name, frame in (shown | {"true": true}).items():
                phases[name].append(frame)
    exact = finest.code.relative_phase(np.stack(phases["true"]), sequence.panel)[0]
    results = {}
    for name, square in squares.items():
        off = finest.code.relative_phase(np.stack(phases[name]), sequence.panel)[0] - exact
        off = np.mod(off + np.pi, 2.0 * np.pi) - np.pi
        for place, mask in places.items():
            results[f"{name}_{place}"] = _sharpness(square[mask], off[mask])
    return FusionScore(fringes, **results)


def _sharpness(square: Array, off: Array) -> Sharpness:
    if square.size == 0:
        return Sharpness(0, float("nan"), float("nan"))
    return Sharpness(
        int(square.size), float(np.sqrt(square.mean())), float(np.sqrt(np.mean(off**2)))
    )


def _blur(truth: GroundTruth, axis: Axis, fringes: float, size: int) -> Array:
    """Circles of confusion of both devices together, in periods of the fringes, (V, U)."""
    coordinate = truth.panel[..., "uv".index(axis)]
    with np.errstate(invalid="ignore"):
        slope = np.hypot(*np.gradient(coordinate))  # panel pixels a camera pixel
        return np.hypot(truth.projector_coc, slope * truth.camera_coc) * fringes / size
