"""How good is a fused stack?  Against the frames of the same scene that are sharp everywhere.

A simulation has them: the scene through pinholes (:mod:`slbench.simulate.sharp`).

Intensities are compared over all patterns, phases over the finest fringe set; both for the
fused frames and for the single middle setting, inside and outside that setting's depth of
field.  A pixel is inside where defocus leaves the finest fringes ``KEPT`` of the modulation that
they have in focus, 82 %: for a lens without diffraction and blur, where 2 J1(x) / x is that for a
circle of confusion of 0.4 periods.  Diffraction forgives more of it
(:mod:`slbench.rig.optics.spread`), and fringes beyond a lens's cut-off are nowhere inside.  The
shares of a circle in that limit add up in quadrature for camera and projector, as losses that are
small do.
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
from slbench.rig.optics.spread import Spread
from slbench.scene.truth import GroundTruth

Array = NDArray[np.float64]

#: Share of their modulation in focus that fringes keep at the end of the depth of field.
KEPT = 0.81516
#: Frequencies at which the largest circle of confusion is found, and halvings that find it.
_FREQUENCIES, _HALVINGS = 33, 30
#: Slower fringes than one in so many pixels are as good as those; what is fainter in focus is lost.
_LEAST_FREQUENCY, _LEAST_CONTRAST = 1e-4, 1e-3


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
    rig = stack.captures[len(stack) // 2].rig
    spreads = (Spread(), Spread()) if rig is None else (rig.camera.spread, rig.projector.spread)
    share = _share(truth, axis, fringes / sequence.size(axis), *spreads)
    places = {"inside": smooth & (share <= 1.0), "outside": smooth & (share > 1.0)}

    middle = len(stack) // 2
    squares = {name: np.zeros(smooth.shape) for name in ("fused", "middle")}
    phases: dict[str, list[Array]] = {"true": [], "fused": [], "middle": []}
    top = 2.0 ** stack.captures[0].depth - 1.0
    scale = 2.0 ** (fused.capture.depth - stack.captures[0].depth)
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


def _share(
    truth: GroundTruth, axis: Axis, cycles_per_px: float, camera: Spread, projector: Spread
) -> Array:
    """Circles of confusion of both devices together, in what ends the depth of field, (V, U)."""
    coordinate = truth.panel[..., "uv".index(axis)]
    with np.errstate(invalid="ignore"):
        slope = np.hypot(*np.gradient(coordinate))  # panel pixels a camera pixel
    shown = truth.projector_coc / largest_circle(projector, np.array(cycles_per_px))
    seen = truth.camera_coc / largest_circle(camera, slope * cycles_per_px)
    return np.hypot(shown, seen)


def largest_circle(spread: Spread, cycles_per_px: Array) -> Array:
    """Return the circle of confusion that leaves a sinusoid ``KEPT`` of its contrast in focus, px.

    Parameters
    ----------
    spread : Spread
    cycles_per_px : float array
        Frequencies; NaN where there are none.

    Returns
    -------
    float array of the same shape
        Diameters; 1e-12, which nothing is below, where the lens passes no such frequency.
    """
    frequency = np.maximum(np.abs(cycles_per_px), _LEAST_FREQUENCY)
    known = frequency[np.isfinite(frequency)]
    if not known.size:
        return np.full(frequency.shape, np.nan)
    slowest, fastest = float(known.min()), float(known.max())
    last = _last_frequency(spread, fastest)
    if last <= slowest:
        return np.where(np.isfinite(frequency), 1e-12, np.nan)
    nodes = np.geomspace(slowest, last, _FREQUENCIES)
    wanted = KEPT * spread.contrast(nodes)
    low, high = np.zeros(nodes.size), 0.4 / nodes
    while np.any(short := spread.contrast(nodes, high) > wanted):
        high = np.where(short, 2.0 * high, high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        kept = spread.contrast(nodes, middle) > wanted
        low, high = np.where(kept, middle, low), np.where(kept, high, middle)
    # In periods the circle changes little with the frequency.
    periods = np.interp(np.log(frequency), np.log(nodes), high * nodes)
    return np.where(frequency > last, 1e-12, periods / frequency)


def _last_frequency(spread: Spread, fastest: float) -> float:
    """Return the fastest frequency up to `fastest` that is seen in focus, cycles a pixel."""
    low, high = 0.0, fastest * (1.0 + 1e-9)
    if spread.contrast(high) > _LEAST_CONTRAST:
        return high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        seen = bool(spread.contrast(middle) > _LEAST_CONTRAST)
        low, high = (middle, high) if seen else (low, middle)
    return low
