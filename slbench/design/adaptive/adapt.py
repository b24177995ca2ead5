"""A scene measured with fringes that are chosen while it is measured, and why each was chosen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import block, length
from slbench.core.show.document import Table
from slbench.core.validation.types import Interval, Measure
from slbench.core.validation.values import checked
from slbench.design.adaptive.choose import (
    Forecast,
    Known,
    best,
    forecasts,
    known,
    levels,
    percentile,
    reach_px,
)
from slbench.design.adaptive.estimate import Estimate, estimated
from slbench.design.adaptive.shots import SHIFTS, Instrument, Shot, Taken
from slbench.patterns import PhaseMap
from slbench.patterns.base import FloatArray
from slbench.scene.model import Scene
from slbench.simulate.reconstruct import reconstruct
from slbench.simulate.transport import LightTransport

#: Frames that are taken at most, unless said otherwise.
MAX_FRAMES = 30
#: Counts of the first sets, and what for.
FIRST = {1: "what is lit, and where it is"}
#: Gain of a set, of the mean logarithm of the deviations, that is none.
_NO_GAIN = 0.01
#: Deviation of a coordinate, of the fringes that most pixels have, beyond which it is none.
_RESOLVED = 0.125
#: Frames that a budget may have.
MOST_FRAMES = 1000
Frames = Annotated[int, Interval(ge=2 * SHIFTS, le=MOST_FRAMES)]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A set that was taken, and why.

    Parameters
    ----------
    fringes, shifts : int
    exposure : float
        Over that of the scene.
    dimmed : float
        Share of the panel's columns that are dimmed.
    least : float
        Smallest factor of the mask; 1 without any.
    frames : int
        Taken so far, these included.
    predicted_um, reached_um : float
        95th percentile of the deviations of lit pixels, before by prediction and after; infinite
        where more than a twentieth is not measured.
    unmeasured, saturated : float
        Shares of the lit pixels after it: without a coordinate, saturated in every set.
    wrong : float
        99th percentile of the probability of a wrong order.
    why : str
    """

    fringes: int
    shifts: int
    exposure: float
    dimmed: float
    least: float
    frames: int
    predicted_um: float
    reached_um: float
    unmeasured: float
    saturated: float
    wrong: float
    why: str

    def to_dict(self) -> dict[str, Any]:
        """Return the choice as plain values for JSON, None for what is infinite."""
        return {
            name: None if isinstance(value, float) and not np.isfinite(value) else value
            for name, value in vars(self).items()
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class Adapted:
    """A scene measured adaptively.

    Parameters
    ----------
    phase : PhaseMap
    choices : tuple of Choice
        In order of time.
    light : float
        Exposure of all frames, in exposures of the scene.
    end : str
        Why no more were taken.
    trail : tuple of (V, U) float
        Deviations of the coordinate after each set, infinite where it is not known; where they were
        asked for.
    """

    phase: PhaseMap
    choices: tuple[Choice, ...]
    light: float
    end: str
    trail: tuple[FloatArray, ...] = ()

    @property
    def frames(self) -> int:
        """Frames that were taken."""
        return self.choices[-1].frames

    @property
    def reached_um(self) -> float:
        """95th percentile of the deviations of lit pixels."""
        return self.choices[-1].reached_um

    def __repr__(self) -> str:
        sets = ", ".join(f"{one.fringes}" for one in self.choices)
        return block(
            f"Adapted: {self.frames} frames, fringes {sets}; {_um(self.reached_um)} at the 95th "
            "percentile",
            self.end,
        )

    def table(self) -> Table:
        """Lay out the choices, a row each."""
        columns = (
            "frames", "fringes", "exposure", "dimmed / %", "predicted / µm", "reached / µm",
            "unmeasured / %", "why",
        )  # fmt: skip
        rows = tuple(
            (
                one.frames,
                one.fringes,
                f"{one.exposure:.3g}",
                f"{100 * one.dimmed:.0f}",
                _number(one.predicted_um),
                _number(one.reached_um),
                f"{100 * one.unmeasured:.1f}",
                one.why,
            )
            for one in self.choices
        )
        return Table("Adaptive fringes", columns, rows, self.end)

    def log(self) -> list[str]:
        """Say line by line what was taken and why."""
        lines = []
        for one in self.choices:
            mask = f", {100 * one.dimmed:.0f} % of the columns dimmed to {one.least:.2g}"
            lines.append(
                f"{one.frames:3d} frames: {one.fringes} fringes, {one.shifts} shifts, exposure "
                f"{one.exposure:.3g}{mask if one.dimmed else ''}: {one.why}"
            )
            lines.append(
                f"    predicted {_um(one.predicted_um)}, reached {_um(one.reached_um)}; unmeasured "
                f"{100 * one.unmeasured:.1f} %, saturated {100 * one.saturated:.1f} %, wrong "
                f"orders below {one.wrong:.1g}"
            )
        return [*lines, self.end]

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values for JSON."""
        return {
            "frames": self.frames,
            "light": self.light,
            "p95_um": self.choices[-1].to_dict()["reached_um"],
            "end": self.end,
            "choices": [one.to_dict() for one in self.choices],
        }


@checked
def adapt(
    scene: Scene,
    transport: LightTransport,
    *,
    max_frames: Frames = MAX_FRAMES,
    want_um: Measure | None = None,
    max_light: Measure | None = None,
    seed: int = 0,
    noise: bool = True,
    keep_trail: bool = False,
    on_progress: Callable[[float], None] | None = None,
) -> Adapted:
    """Measure a scene with fringes that are chosen by what was seen so far.

    Parameters
    ----------
    scene : Scene
        Its rig, detector and exposure; columns are coded.
    transport : LightTransport
        With the marginal "u".
    max_frames : int
        Budget of frames.
    want_um : float, optional
        95th percentile of the deviation of points at which to stop, µm.
    max_light : float, optional
        Budget of exposure, in exposures of the scene.
    seed : int
        Of the detector's temporal noise.
    noise : bool
        False leaves out noise and vibration.
    keep_trail : bool
        Keep :attr:`Adapted.trail`.
    on_progress : callable, optional
        Called with the finished fraction.

    Raises
    ------
    InputError
        For a scene that cannot be measured so (:func:`check_adaptable`).
    """
    tool = Instrument(scene, transport, seed=seed, noise=noise)
    taken: list[Taken] = []
    trail: list[FloatArray] = []
    choices: list[Choice] = []
    chosen: list[tuple[Shot, Forecast | None, str]] = [
        (Shot(count), None, f"a first set: {reason}") for count, reason in FIRST.items()
    ]
    end, estimate = "", None
    per_px = np.ones(tool.shape[0] * tool.shape[1])
    while True:
        for shot, forecast, why in chosen:
            level = None
            if shot.mask is not None:
                assert estimate is not None  # a mask is of what was seen
                reach = reach_px(known(taken, estimate, tool))
                level = levels(shot.mask, estimate, tool.width, reach)
            taken.append(tool.take(shot, level))
            estimate = estimated(taken, tool.width)
            if len(taken) >= len(FIRST):
                per_px = _per_px(scene, estimate, tool, seed)
            before = known(taken, estimate, tool)
            if keep_trail:
                known_so_far = np.where(estimate.sure, estimate.sigma, inf)
                trail.append(known_so_far.reshape(tool.shape))
            choices.append(_choice(shot, forecast, why, len(taken), estimate, before, per_px))
        assert estimate is not None  # sets were taken
        if on_progress:
            on_progress(min(SHIFTS * len(taken) / max_frames, 1.0))
        if want_um is not None and choices[-1].reached_um <= want_um:
            end = f"enough: {_um(choices[-1].reached_um)} of {want_um:g} µm wanted"
            break
        if SHIFTS * (len(taken) + 1) > max_frames:
            end = f"the budget of {max_frames} frames is used"
            break
        left = inf if max_light is None else max_light - sum(one.shot.light for one in taken)
        possible = forecasts(before, estimate, tool, per_px)
        every = list(possible)
        found = best([one for one in every if one.shot.light <= left])
        if found is None and best(every) is not None:
            end = f"the budget of {max_light:g} exposures is used"
            break
        if found is None or found.gain < _NO_GAIN:
            gain = 0.0 if found is None else found.gain
            end = f"no further set gains: the best would lower deviations by {100 * gain:.2g} %"
            break
        chosen = [(found.shot, found, _reason(found, before, estimate))]
    final = _phase_map(estimate, before, tool)
    return Adapted(
        phase=final,
        choices=tuple(choices),
        light=sum(one.shot.light for one in taken),
        end=end,
        trail=tuple(trail),
    )


def _per_px(scene: Scene, estimate: Estimate, tool: Instrument, seed: int) -> FloatArray:
    """Return the millimetres that a panel pixel makes at each pixel; the median where unknown."""
    ones = np.where(estimate.sure, 1.0, np.nan).reshape(tool.shape)
    blank = np.zeros(tool.shape, np.float32)
    phase = PhaseMap(
        coordinate={"u": np.where(estimate.sure, estimate.coordinate, np.nan).reshape(tool.shape)},
        sigma={"u": ones},
        modulation=blank,
        mean=blank,
        mask=estimate.sure.reshape(tool.shape),
    )
    if not estimate.sure.any():
        return np.ones(estimate.sure.shape)
    cloud = reconstruct(scene, phase, seed=seed).cloud
    image = cloud.image(cloud.sigma_total_mm).ravel() if len(cloud) else np.full(ones.size, np.nan)
    known_at = np.isfinite(image)
    return np.where(known_at, image, np.median(image[known_at]) if known_at.any() else 1.0)


def _choice(
    shot: Shot,
    forecast: Forecast | None,
    why: str,
    sets: int,
    estimate: Estimate,
    before: Known,
    per_px: FloatArray,
) -> Choice:
    sigma = np.where(estimate.sure, estimate.sigma, inf) * per_px
    lit = before.lit
    wrong = estimate.wrong[lit & estimate.sure]
    return Choice(
        fringes=shot.count,
        shifts=SHIFTS,
        exposure=shot.exposure,
        dimmed=0.0 if shot.mask is None else float(np.mean(shot.mask < 1.0)),
        least=1.0 if shot.mask is None else float(shot.mask.min()),
        frames=SHIFTS * sets,
        predicted_um=inf if forecast is None else 1e3 * forecast.percentile_mm,
        reached_um=1e3 * percentile(sigma, lit),
        unmeasured=float(np.mean(~estimate.sure[lit])) if lit.any() else 1.0,
        saturated=float(np.mean(before.saturated[lit])) if lit.any() else 0.0,
        wrong=float(np.percentile(wrong, 99.0)) if wrong.size else 0.0,
        why=why,
    )


def _reason(found: Forecast, before: Known, estimate: Estimate) -> str:
    """Say why a set was chosen, with figures."""
    shot, parts = found.shot, []
    times = [one.count for one in estimate.waves].count(shot.count)
    finest = max(one.count for one in estimate.waves)
    if times:
        parts.append(f"{shot.count} fringes again, at other shifts")
    elif shot.count > finest:
        parts.append(f"finer than {finest}")
    else:
        parts.append(f"between those before, for pixels whose order {finest} leaves open")
    parts.append(f"orders are safe at {100 * found.safe:.0f} % of the pixels that see it")
    if shot.exposure != 1.0:
        what = "longer for dark parts" if shot.exposure > 1.0 else "shorter for bright parts"
        parts.append(f"{shot.exposure:.3g} times the exposure, {what}")
    if shot.mask is not None:
        parts.append(f"columns dimmed that would saturate, down to {shot.mask.min():.2g}")
    parts.append(f"used by {100 * found.used:.0f} %, saturated {100 * found.saturated:.0f} %")
    fall = 100.0 * (1.0 - np.exp(-found.gain))
    parts.append(f"deviations of the worst quarter to fall by {fall:.0f} %")
    return "; ".join(parts)


def _phase_map(estimate: Estimate, before: Known, tool: Instrument) -> PhaseMap:
    """Return the coordinates, without pixels that are not known to an eighth of a usual fringe."""
    shape, sure = tool.shape, estimate.sure
    if sure.any():
        usual = float(np.median(estimate.finest[sure]))
        sure = sure & (estimate.sigma <= _RESOLVED * tool.width / usual)

    def image(values: NDArray[Any]) -> NDArray[Any]:
        return np.where(sure, values, np.nan).reshape(shape)

    finest = np.zeros(len(estimate.sigma))
    for one in estimate.waves:
        finest = np.where(estimate.finest == one.count, np.sqrt(one.power), finest)
    return PhaseMap(
        coordinate={"u": image(estimate.coordinate)},
        sigma={"u": image(estimate.sigma)},
        modulation=finest.reshape(shape).astype(np.float32),
        mean=before.mean.reshape(shape).astype(np.float32),
        mask=sure.reshape(shape),
    )


def _um(value: float) -> str:
    return length(1e-3 * value) if np.isfinite(value) else "more than a twentieth unmeasured"


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "-"
