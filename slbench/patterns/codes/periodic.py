"""Codes that repeat themselves across the panel, and say where within a period a pixel is."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.threads import in_bands
from slbench.core.validation.types import FringeNumber
from slbench.patterns.base import (
    AnyFloatArray,
    Axis,
    Code,
    FloatArray,
    Found,
    Observed,
    Panel,
    Placed,
    Rule,
    Run,
    extent,
)
from slbench.patterns.noise import NoiseModel
from slbench.patterns.phase import unwrap_spatially
from slbench.patterns.response import PLACES, straightened
from slbench.rig.optics.response import Response

#: Three pixels a period are the least that carry amplitude, phase and mean.
MIN_PIXELS_PER_PERIOD = 3
#: Standard deviations within which the two ends of the panel are not told apart.
END_SIGMAS = 3.0


@dataclass(frozen=True)
class Estimate:
    """Where within its period a pixel is.

    Parameters
    ----------
    turns, sigma : (P,) float64
        Periods since the last one began, in any turn, and their standard deviation.
    modulation, mean : (P,) float32 or float64
        Half the range of the frames and their mean, DN.
    """

    turns: FloatArray
    sigma: FloatArray
    modulation: AnyFloatArray
    mean: AnyFloatArray


@dataclass(frozen=True)
class PeriodicCode(Code):
    """A code of `count` equal periods, unwrapped as fringes are (thesis eq. 26).

    A family says what it shows and gives :meth:`estimate`.  Its codes are decoded after all other
    families of the axis, fewer periods before more; the first needs one period or less, a coarser
    code, or ``unwrap = "spatial"``.  Evidence: ``order_residual``, the order
    before it is rounded less the whole number it is rounded to, turns.
    """

    refines: ClassVar[bool] = True
    #: Whether the code's own frames tell the place, whatever their gain and offset.
    alone: ClassVar[bool] = False

    count: FringeNumber
    axis: Axis = "u"

    @abstractmethod
    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return where within a period each pixel is, from the frames of the code."""

    def phase(self, size: int) -> FloatArray:
        """Return periods since the panel's edge, (size,)."""
        return self.count * (np.arange(size) + 0.5) / size

    def periods(self, panel: Panel) -> float:
        """Return the count."""
        return self.count

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for more periods than the panel has pixels for."""
        most = extent(panel, self.axis) / MIN_PIXELS_PER_PERIOD
        if self.count > most:
            name = type(self).__name__
            raise InputError(f"{name}: count", f"at most {most:.4g}", f"{self.count:g}")

    def straightened(
        self, frames: NDArray[Any], panel: Panel, response: Response, saturation: float
    ) -> NDArray[Any]:
        """Return the code's frames, (N, P), as a linear projector would have made them.

        Raises
        ------
        InputError
            For a code that other frames than its own decode, and a response so steep that two
            places look alike.
        """
        if not self.alone:
            return super().straightened(frames, panel, response, saturation)
        period, count = replace(self, count=1.0), self.n_frames(panel)
        placed = Placed(0, period, range(count))

        def estimate(values: NDArray[Any]) -> tuple[FloatArray, AnyFloatArray]:
            observed = Observed(
                pixels=values,
                shape=(1, values.shape[1]),
                panel=panel,
                codes=(placed,),
                noise=NoiseModel(),
                saturation=np.inf,
                min_modulation=0.0,
                min_snr=0.0,
                max_order_residual=0.5,
                keep_relative=False,
                keep_evidence=False,
            )
            own = period.estimate(placed, observed)
            return own.turns, own.modulation

        shown = np.stack([period.profile(k, PLACES) for k in range(count)])
        return straightened(frames, shown, estimate, response, saturation)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read the family's name and the number of periods, ``trapezoid16``."""
        match = re.fullmatch(rf"{cls.kind}(\d{{1,6}}(?:\.\d+)?)", word)
        return [cls(float(match[1]), axis)] if match else None

    @property
    def word(self) -> str:
        """The word that is read back."""
        return self.kind + np.format_float_positional(self.count, trim="-")

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError if nothing tells the periods apart."""
        least = min(cast(Self, placed.code).count for placed in run.parts)
        if not before and least > 1.0 and run.unwrap != "spatial":
            where = f"decode: parts[{run.parts[0].index}]"
            expected = (
                f'one period or less, a coarser code along {run.axes[0]}, or unwrap = "spatial"'
            )
            raise InputError(where, expected, f"{least:g} periods")

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Decode the codes of the run, each unwrapped from the one before."""
        from slbench.patterns.kernels.blocks import LEAST, most_unsaturated
        from slbench.patterns.kernels.periodic import resolve

        (axis,) = run.axes
        size = extent(observed.panel, axis)
        frames, pixels = observed.pixels, observed.pixels.shape[1]
        parts = sorted(run.parts, key=lambda placed: cast(Self, placed.code).count)
        faults, none = np.zeros(pixels, np.uint8), np.empty(0)
        most = frames.dtype.type(most_unsaturated(observed.saturation, frames.dtype))
        searched = np.array(run.searched, np.int64)
        limits = np.array([observed.min_modulation, observed.min_snr])
        coarser = found.get(axis)
        closed = coarser is None and all(cast(Self, p.code).count % 1.0 == 0.0 for p in parts)
        # What is known before, of the panel: scale and shift, and half a cell by deviations.
        before, deviation, known = none, none, np.zeros(3)
        if coarser is not None:
            before, deviation = coarser.coordinate, np.require(coarser.sigma, requirements="C")
            known = np.array([1.0 / size, 0.5, np.sqrt(3.0) / size])
        evidence: dict[int, dict[str, AnyFloatArray]] = {}
        for placed in parts:
            code = cast(Self, placed.code)
            own = code.estimate(placed, observed)
            turns, sigma = (np.require(a, np.float64, ["C", "W"]) for a in (own.turns, own.sigma))
            last = placed is parts[-1]
            mask = np.empty(pixels if last else 0, np.bool_)
            panel = np.array([code.count, size, END_SIGMAS, closed], np.float64)
            estimate = (turns, sigma, own.modulation, own.mean)
            given = (frames, searched, most, *estimate, observed.noise.coefficients, limits)
            if not len(before):
                turns -= np.floor(turns)
                if code.count > 1.0:  # unwrap = "spatial", by check_run
                    judged = (*given, none, none, np.zeros(4), none, panel, faults, none)
                    in_bands(partial(resolve, *judged), pixels, LEAST)
                    good = (faults == 0) & ~saturated(placed, observed)
                    turns[:] = _by_neighbours(turns, good, observed.shape, code.count)
            keep = observed.keep_evidence and len(before) > 0
            residual = np.empty(pixels if keep else 0)
            relation = np.array([*known, 0.0]) * [code.count, 1.0, code.count, 1.0]
            relation[3] = observed.max_order_residual
            rest = (before, deviation, relation, residual, panel, faults, mask)
            in_bands(partial(resolve, *given, *rest), pixels, LEAST)
            if keep:
                evidence[placed.index] = {"order_residual": residual}
            searched = searched[:0]
            before, deviation, known = turns, sigma, np.array([1.0 / code.count, 0.0, 0.0])
        return {
            axis: Found(
                coordinate=turns,
                sigma=sigma,
                modulation=own.modulation,
                mean=own.mean,
                mask=mask,
                complete=True,
                evidence=evidence,
                dropped=_rules(faults, coarser) if observed.keep_evidence else None,
            )
        }


def _rules(faults: NDArray[np.uint8], coarser: Found | None) -> NDArray[np.uint8]:
    """Return by which rule pixels are dropped; a coarser code's own where it has no place."""
    from slbench.patterns.kernels.periodic import COARSE, DIM, END, ORDER, SATURATED

    rules = {
        SATURATED: Rule.SATURATED,
        DIM: Rule.MODULATION,
        COARSE: Rule.BIT,
        ORDER: Rule.ORDER,
        END: Rule.END,
    }
    has = [(faults & fault) != 0 for fault in rules]
    dropped = np.select(has, list(rules.values()), Rule.KEPT).astype(np.uint8)
    if coarser is not None and coarser.dropped is not None:
        lost = (dropped == Rule.ORDER) & (coarser.dropped != Rule.KEPT)
        dropped[lost] = coarser.dropped[lost]
    return dropped


def saturated(placed: Placed, observed: Observed) -> NDArray[np.bool_]:
    """Return where a frame of a part is saturated or not a number, (P,)."""
    own = observed.pixels[placed.frames.start : placed.frames.stop]
    return np.logical_or.reduce(~(own < observed.saturation), axis=0)


def _by_neighbours(
    turns: FloatArray, good: NDArray[np.bool_], shape: tuple[int, int], count: float
) -> FloatArray:
    """Return turns unwrapped by their neighbours, NaN where they are not good.

    Of all whole numbers that they may be off by, the one is taken that brings the median nearest
    to the middle of the panel.
    """
    if not good.any():
        return np.full_like(turns, np.nan)
    phase = 2.0 * np.pi * turns.reshape(shape)
    found = unwrap_spatially(phase, good.reshape(shape)).ravel() / (2.0 * np.pi)
    return found + np.round(0.5 * count - np.nanmedian(found))


def own_frames(placed: Placed, observed: Observed) -> tuple[FloatArray, FloatArray]:
    """Return the frames of a part and their variances, (n, P) each, DN and DN^2."""
    frames = observed.pixels[placed.frames.start : placed.frames.stop].astype(np.float64)
    return frames, observed.noise.variance(frames)
