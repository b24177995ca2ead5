"""How far simulated and photographed frames differ: brightness, contrast, noise, points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.motion import moves_of
from slbench.calibration.characterise.noise import of_fit, of_repeats
from slbench.capture.capture import Capture
from slbench.core.show.display import brief
from slbench.core.show.document import Table
from slbench.detector.emva1288 import Detector
from slbench.patterns import Fringes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Side of the window over which noise averages out, px.
WINDOW = 9
#: Relative differences of noise and of contrast beyond which a twin does not fit, and the chi^2.
NOISE, CONTRAST, CHI_SQUARE = 0.05, 0.02, 1.5
#: Times the twin's own steady error of points beyond which it does not fit.
POINTS = 2.0
#: Pixels that a judgement needs.
LEAST = 200


class FrameLikeness(NamedTuple):
    """A frame photographed and expected."""

    frame: int
    shows: str
    held_out: bool
    photographed_dn: float
    simulated_dn: float
    rms_dn: float
    """Of the differences, pixel by pixel."""
    expected_rms_dn: float
    """By noise, fixed pattern, vibration and the renderer's sampling."""
    steady_rms_dn: float
    """Of the differences averaged over 9 x 9 pixels."""
    chi_square: float
    """Mean square of the differences over their variances."""


class ContrastLikeness(NamedTuple):
    """Modulation of a fringe set photographed, over that expected."""

    shows: str
    middle: float
    """Its middle frame."""
    axis: str
    fringes: float
    cycles_per_px: float
    held_out: bool
    ratio: float


class NoiseLikeness(NamedTuple):
    """Temporal noise by one estimator, of photographs and of simulated frames."""

    method: str
    photographed_dn: float
    simulated_dn: float

    @property
    def ratio(self) -> float:
        """Simulated over photographed."""
        return self.simulated_dn / self.photographed_dn


@dataclass(frozen=True, eq=False, kw_only=True)
class PointLikeness:
    """Distances of points from the object along its normal, (V, U), mm; NaN without a point."""

    photographed_mm: Array
    simulated_mm: Array

    @property
    def both(self) -> Mask:
        """Pixels that both have."""
        return np.isfinite(self.photographed_mm) & np.isfinite(self.simulated_mm)

    def rms_mm(self) -> tuple[float, float]:
        """Return RMS distances, photographed and simulated, of 99 % of the points."""
        one, other = (_rms(_usual(x[self.both])) for x in (self.photographed_mm, self.simulated_mm))
        return one, other

    def steady_mm(self) -> tuple[float, float]:
        """Return the same of distances averaged over 9 x 9 pixels."""
        pictures = (self.photographed_mm, self.simulated_mm)
        one, other = (_rms(_usual(averaged(x, self.both)[self.both])) for x in pictures)
        return one, other


@dataclass(frozen=True, eq=False, kw_only=True)
class Likeness:
    """How far a twin's frames and points are from those of photographs.

    Parameters
    ----------
    frames : tuple of FrameLikeness
    contrasts : tuple of ContrastLikeness
    noise : NoiseLikeness or None
        None where the frames do not tell it.
    points : PointLikeness
    white_dn : float
        Of the brightest frame, above black: what brightness is a share of.
    chi_square_map : (V, U) float
        Mean over the held-out frames, pixel by pixel; NaN where none was judged.
    """

    frames: tuple[FrameLikeness, ...]
    contrasts: tuple[ContrastLikeness, ...]
    noise: NoiseLikeness | None
    points: PointLikeness
    white_dn: float
    chi_square_map: Array

    __repr__ = brief

    @property
    def chi_square(self) -> float:
        """Mean over the frames that were held out."""
        return float(np.mean([one.chi_square for one in self.frames if one.held_out]))

    @property
    def steady_share(self) -> float:
        """Steady difference of the held-out frames, RMS, as a share of white."""
        own = [one.steady_rms_dn for one in self.frames if one.held_out]
        return float(np.sqrt(np.mean(np.square(own)))) / self.white_dn

    def misfits(self) -> list[str]:
        """Return what does not fit, a sentence each, with the likely cause."""
        found = []
        if not self.chi_square <= CHI_SQUARE:
            found.append(
                f"held-out frames differ by {self.chi_square**0.5:.3g} times what noise explains, "
                f"steadily by {100 * self.steady_share:.2g} % of white: texture, interreflections, "
                "the projector's response, or another place"
            )
        judged = [one for one in self.contrasts if one.held_out] or self.contrasts
        worst = max(judged, key=lambda one: abs(one.ratio - 1.0), default=None)
        if worst is not None and not abs(worst.ratio - 1.0) <= CONTRAST:
            found.append(
                f"contrast of {worst.fringes:g} fringes along {worst.axis} is "
                f"{worst.ratio:.3g} times the twin's: blur, focus or the projector's response"
            )
        if self.noise is not None and not abs(self.noise.ratio - 1.0) <= NOISE:
            found.append(
                f"the twin's noise is {self.noise.ratio:.3g} times the photographs': gain, "
                "read noise, vibration or flicker"
            )
        one, other = self.points.steady_mm()
        if not self.points.both.any():
            found.append(
                "no point of the photographs and the twin is on the same surface: another rig, a "
                "unit, or another place"
            )
        elif not one <= POINTS * other:
            found.append(
                f"points are off by {1e3 * one:.3g} µm, steadily, the twin's by "
                f"{1e3 * other:.3g} µm: the rig, another shape, or the projector's response"
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        rms, steady = self.points.rms_mm(), self.points.steady_mm()
        return {
            "fits": not self.misfits(),
            "misfits": self.misfits(),
            "chi_square": self.chi_square,
            "steady_share_of_white": self.steady_share,
            "noise": None
            if self.noise is None
            else self.noise._asdict() | {"ratio": self.noise.ratio},
            "contrast": [one._asdict() for one in self.contrasts],
            "points": {
                "count": int(np.count_nonzero(self.points.both)),
                "rms_mm": {"photographed": rms[0], "simulated": rms[1]},
                "steady_rms_mm": {"photographed": steady[0], "simulated": steady[1]},
            },
            "frames": [one._asdict() for one in self.frames],
        }

    def tables(self) -> list[Table]:
        """Return the frames, and the numbers of the whole."""
        held = {True: "held out", False: "fitted to"}
        frames = tuple(
            (
                *(one.frame, one.shows, held[one.held_out], one.photographed_dn, one.simulated_dn),
                *(one.rms_dn, one.expected_rms_dn, one.steady_rms_dn, one.chi_square),
            )
            for one in self.frames
        )
        columns = (
            *("frame", "shows", "used", "photographed / DN", "simulated / DN"),
            *("RMS difference / DN", "expected / DN", "steady / DN", "chi²"),
        )
        numbers: list[tuple[str, float | str, float | str, float]] = []
        for c in self.contrasts:
            name = f"contrast of {c.fringes:g} fringes along {c.axis}, {held[c.held_out]}"
            numbers.append((name, c.ratio, 1.0, c.ratio))
        if self.noise is not None:
            own = self.noise.photographed_dn, self.noise.simulated_dn, 1.0 / self.noise.ratio
            numbers.append(("noise / DN", *own))
        for name, pair in (
            ("points, RMS / µm", self.points.rms_mm()),
            ("points, steady RMS / µm", self.points.steady_mm()),
        ):
            numbers.append((name, 1e3 * pair[0], 1e3 * pair[1], pair[0] / pair[1]))
        heads = ("quantity", "photographed", "twin", "ratio")
        return [
            Table("Frames", columns, frames),
            Table("Twin", heads, tuple(numbers)),
        ]


def frame_likeness(
    capture: Capture,
    expected: NDArray[np.float32],
    halved: NDArray[np.float32],
    detector: Detector,
    vibration_px: float,
    where: Mask,
    held_out: Mask,
) -> tuple[tuple[FrameLikeness, ...], Array]:
    """Compare frames one by one; return each, and the map of :attr:`Likeness.chi_square_map`.

    Parameters
    ----------
    capture : Capture
    expected, halved : (N, V, U) float32
        What the twin expects, DN before rounding, by all samples and by half of them.
    detector : Detector
    vibration_px : float
    where : (V, U) bool
        Pixels to judge by.
    held_out : (N,) bool
        Frames that nothing was fitted to.
    """
    model, black = detector.noise_model(), detector.black_dn
    found = []
    total = np.zeros(where.shape)
    for k, frame in enumerate(capture.sequence.frames()):
        own, twin = capture.frames[k].astype(np.float64), expected[k].astype(np.float64)
        off = own - twin
        sampling = averaged((twin - halved[k]) ** 2, where)
        slope = sum(one**2 for one in np.gradient(twin))
        variance = (
            np.asarray(model.variance(twin))
            + (detector.prnu * (twin - black)) ** 2
            + (detector.dsnu_e / detector.e_per_dn) ** 2
            + sampling
            + vibration_px**2 * slope
        )
        chi_square = off**2 / variance
        total += held_out[k] * chi_square
        found.append(
            FrameLikeness(
                frame=k,
                shows=_shown(frame.part, frame.index),
                held_out=bool(held_out[k]),
                photographed_dn=float(own[where].mean()),
                simulated_dn=float(twin[where].mean()),
                rms_dn=_rms(off[where]),
                expected_rms_dn=float(np.sqrt(variance[where].mean())),
                steady_rms_dn=_rms(averaged(off, where)[where]),
                chi_square=float(np.mean(chi_square[where])),
            )
        )
    return tuple(found), np.where(where, total / np.count_nonzero(held_out), np.nan)


def contrast_likeness(
    capture: Capture, expected: NDArray[np.float32], where: Mask, held_out: Mask
) -> tuple[ContrastLikeness, ...]:
    """Compare the modulation of fringe sets; arguments as of :func:`frame_likeness`."""
    panel = capture.sequence.panel
    found = []
    for placed in capture.sequence.placed():
        code = placed.code
        if not isinstance(code, Fringes):
            continue
        frames = slice(placed.frames.start, placed.frames.stop)
        one, other = (
            code.relative_phase(stack[frames].astype(np.float64), panel)[1][where]
            for stack in (capture.frames, expected)
        )
        # Noise adds to the square of a modulation; of sums over many pixels it does not.
        fringes = float(code.fringe_count(panel))
        found.append(
            ContrastLikeness(
                shows=_shown(code, None),
                middle=0.5 * (placed.frames.start + placed.frames.stop - 1),
                axis=code.axis,
                fringes=fringes,
                cycles_per_px=fringes / capture.sequence.size(code.axis),
                held_out=bool(held_out[frames].all()),
                ratio=float((one * other).sum() / (other * other).sum()),
            )
        )
    return tuple(found)


def noise_likeness(
    capture: Capture, simulated: Capture, where: Mask, held_out: Mask
) -> NoiseLikeness | None:
    """Compare temporal noise: of frames shown twice, else of what sinusoids leave of fringes."""
    top = capture.top_dn
    repeats: dict[Any, list[int]] = {}
    for k, frame in enumerate(capture.sequence.frames()):
        repeats.setdefault((frame.part, frame.index), []).append(k)
    chosen = [own for own in repeats.values() if len(own) > 1 and held_out[own[1:]].all()]
    pairs = []
    if chosen:
        method = f"differences of {sum(map(len, chosen))} frames that show the same"
        for own in chosen:
            stacks = (c.frames[own].astype(np.float32) for c in (capture, simulated))
            pairs.append([of_repeats(moves_of(stack, top)[1], top) for stack in stacks])
    else:
        sets = [
            placed
            for placed in capture.sequence.placed()
            if isinstance(placed.code, Fringes) and len(placed.frames) >= 4
        ]
        sets = [one for one in sets if held_out[list(one.frames)].all()] or sets
        method = f"what sinusoids leave of {len(sets)} sets of fringes"
        for placed in sets:
            steps = placed.code.steps(capture.sequence.size(placed.code.axis))  # type: ignore[attr-defined]
            frames = slice(placed.frames.start, placed.frames.stop)
            fits = [of_fit(c.frames[frames], steps, top) for c in (capture, simulated)]
            pairs += [[one for one in fits if one is not None]] if None not in fits else []
    sums = np.zeros(2)
    for one, other in pairs:
        good = where & one.good & other.good
        sums += [one.variance[good].sum(), other.variance[good].sum()]
        sums = sums.astype(np.float64)
    count = sum(int(np.count_nonzero(where & a.good & b.good)) for a, b in pairs)
    if count < LEAST or not sums.all():
        return None
    photographed, twin = np.sqrt(sums / count)
    return NoiseLikeness(method, float(photographed), float(twin))


def averaged(picture: NDArray[Any], where: Mask) -> Array:
    """Return the mean of a picture over 9 x 9 pixels, of those of a mask."""
    from scipy.ndimage import uniform_filter

    weight = uniform_filter(where.astype(np.float64), WINDOW, mode="constant")
    total = uniform_filter(
        np.where(where, picture, 0.0).astype(np.float64), WINDOW, mode="constant"
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(weight > 1e-9, total / weight, 0.0))


def _shown(code: Any, index: int | None) -> str:
    level = None if index is None else code.flat_level(index)
    if level is not None:
        return f"flat {level:g}"
    name = type(code).write_run([code])
    return name if index is None else f"{name} [{index}]"


def _usual(values: Array) -> Array:
    """Return values without the hundredth that is farthest from their median."""
    off = np.abs(values - np.median(values)) if values.size else values
    return values[off <= np.quantile(off, 0.99)] if values.size else values


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")
