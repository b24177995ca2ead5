"""What a comparison of pattern sets found, as immutable values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.bench.compare.sets import Equal
from slbench.bench.compare.significance import Pair
from slbench.core.errors import InputError
from slbench.core.show.display import block, brief, length, share
from slbench.core.show.document import Cloud, Table
from slbench.core.show.drawing import figure
from slbench.core.validation.values import checked
from slbench.patterns import PatternSequence

Array = NDArray[np.float64]
#: Sets that a comparison's ``repr`` has lines for.
_SHOWN_SETS = 5


class Step(NamedTuple):
    """A step of the scene, measured in every repeat.

    ``measured_mm`` is the mean over the repeats, ``std_mm`` their standard deviation.
    """

    nominal_mm: float
    measured_mm: float
    std_mm: float

    @property
    def deviation_mm(self) -> float:
        """Measured minus nominal height."""
        return self.measured_mm - self.nominal_mm


@dataclass(frozen=True, eq=False)
class SetResult:
    """Repeated scans with one pattern set.

    All but ``order_error_rate``, ``right`` and ``completeness`` is for the pixels of the
    comparison, the same for all sets; and all but ``rms_mm`` for what was measured in the right
    order.

    Parameters
    ----------
    name : str
        As the user wrote it.
    sequence : PatternSequence
        As it was projected.
    frames : int
        Of one scan.
    exposure_s : float
        Exposure time of a frame.
    std_median_mm, std_ci95_mm : float, (float, float)
        Standard deviation of a point over the repeats, sqrt(var x + var y + var z): root mean
        square over the middle half of the pixels (:mod:`slbench.bench.compare.significance`), and
        its 95 % interval.
    std_z_median_mm, std_z_ci95_mm : float, (float, float)
        The same of the height alone.
    predicted_mm : float
        The same of the standard deviation that the decoder predicted.
    std_over_predicted : float
        RMS over the pixels of the ratio of both: 1 where the detector's noise is all there is.
    bound_mm : float
        Cramer-Rao bound of the same (:mod:`slbench.patterns.matching.bound`): what no decoder of
        these frames can fall below, median over an even choice of the pixels; NaN where there is
        none.
    bound_share : float
        The bound over the measured deviation, 1 / sqrt(mean (std / bound)^2) over these pixels: 1
        where the decoder uses all that the frames carry, whatever deviation it predicts.
    error_median_mm, error_ci95_mm : float, (float, float)
        Distance of a point from the truth: root mean square over the repeats and the middle half of
        the pixels.
    floor_median_mm, monte_carlo_median_mm : float
        Distance of a point from the truth without noise: median over the pixels; and the part of it
        that more samples would take away (:mod:`slbench.simulate.floors`), NaN where the transport
        does not know.
    bias_mm : float
        Mean height error.
    rms_mm : float
        RMS distance from the truth, over all repeats and pixels.
    order_error_rate : float
        Share of wrong fringe orders among the measured pixels of all repeats on smooth lit
        surface (:meth:`slbench.bench.compare.sets.PatternSet.tolerance_px`).
    right : float
        Share of smooth lit pixels whose panel coordinates were measured to within two panel
        pixels, the same for all sets (:data:`slbench.bench.compare.repeated.RIGHT_PX`), mean over
        the repeats.
    completeness : float
        Share of lit pixels that were measured, mean over the repeats.
    seconds : float
        To decode and triangulate one scan, median over the repeats.
    steps : tuple of Step
        Step features of the scene, where it has any.
    std_mm, std_z_mm, error_mm : (V, U) float
        Standard deviation, that of the height, and mean height error; NaN where a pixel is not
        in the comparison.
    shift_mm : (V, U, 3) float
        Mean deviation of the point from the truth; likewise.
    note : str
        What a reader must know of this set.
    """

    name: str
    sequence: PatternSequence
    frames: int
    exposure_s: float
    std_median_mm: float
    std_ci95_mm: tuple[float, float]
    std_z_median_mm: float
    std_z_ci95_mm: tuple[float, float]
    predicted_mm: float
    std_over_predicted: float
    bound_mm: float
    bound_share: float
    error_median_mm: float
    error_ci95_mm: tuple[float, float]
    floor_median_mm: float
    monte_carlo_median_mm: float
    bias_mm: float
    rms_mm: float
    order_error_rate: float
    right: float
    completeness: float
    seconds: float
    steps: tuple[Step, ...]
    std_mm: Array
    std_z_mm: Array
    error_mm: Array
    shift_mm: Array
    note: str = ""

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, without the maps."""
        return {
            "name": self.name,
            "patterns": self.sequence.name,
            "frames": self.frames,
            "exposure_ms": 1e3 * self.exposure_s,
            "std_median_mm": self.std_median_mm,
            "std_ci95_mm": list(self.std_ci95_mm),
            "std_z_median_mm": self.std_z_median_mm,
            "std_z_ci95_mm": list(self.std_z_ci95_mm),
            "predicted_mm": self.predicted_mm,
            "std_over_predicted": self.std_over_predicted,
            "bound_mm": self.bound_mm if isfinite(self.bound_mm) else None,
            "bound_share": self.bound_share if isfinite(self.bound_share) else None,
            "error_median_mm": self.error_median_mm,
            "error_ci95_mm": list(self.error_ci95_mm),
            "floor_median_mm": self.floor_median_mm,
            "monte_carlo_median_mm": self.monte_carlo_median_mm,
            "bias_mm": self.bias_mm,
            "rms_mm": self.rms_mm,
            "order_error_rate": self.order_error_rate,
            "right": self.right,
            "completeness": self.completeness,
            "steps": [step._asdict() for step in self.steps],
            "note": self.note,
        }


@dataclass(frozen=True, eq=False)
class Comparison:
    """Pattern sets beside one another.

    Parameters
    ----------
    scene : str
    repeats, seed : int
    equal : {"frames", "photons"} or None
    sets : tuple of SetResult
        In the order given.
    ranking : tuple of str
        By repeatability, ``std_median_mm``: the least first.
    pairs : tuple of Pair
        Every pair, by ``std_median_mm``.
    error_ranking, error_pairs
        The same by ``error_median_mm``, the distance from the truth.
    pixels, lit_pixels : int
        Pixels of the comparison; pixels that the projector lights.
    cloud : Cloud
        Mean points of the set that ranks first.
    seconds : mapping of str to float
        By stage.
    parameters : mapping
        For the provenance.
    """

    scene: str
    repeats: int
    seed: int
    equal: Equal | None
    sets: tuple[SetResult, ...]
    ranking: tuple[str, ...]
    pairs: tuple[Pair, ...]
    error_ranking: tuple[str, ...]
    error_pairs: tuple[Pair, ...]
    pixels: int
    lit_pixels: int
    cloud: Cloud
    seconds: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        lines = [
            f"{{{one.name}}}: deviation {length(one.std_median_mm)}, "
            f"error {length(one.error_median_mm)}, {share(one.completeness)} complete"
            for one in self.sets[:_SHOWN_SETS]
        ]
        if len(self.sets) > _SHOWN_SETS:
            lines.append(f"... {len(self.sets) - _SHOWN_SETS} more")
        count = f"{len(self.sets)} pattern {'set' if len(self.sets) == 1 else 'sets'}"
        return block(f"Comparison of {count} on {self.scene}: {self.repeats} repeats", *lines)

    def _repr_html_(self) -> str:
        columns = ("set", "frames", "deviation / µm", "error / µm", "complete / %")
        rows = tuple(
            (
                one.name,
                one.frames,
                1e3 * one.std_median_mm,
                1e3 * one.error_median_mm,
                100.0 * one.completeness,
            )
            for one in self.sets
        )
        note = f"Middle half of {self.pixels} pixels, {self.repeats} repeats."
        return Table(f"{self.scene}: pattern sets compared", columns, rows, note)._repr_html_()

    def plot(self) -> Any:
        """Return a matplotlib figure: a map of every set, distributions, medians."""
        return figure(self)

    def __getitem__(self, name: str) -> SetResult:
        """Return the result of the set of that name.

        Raises
        ------
        InputError
            If there is none.
        """
        for result in self.sets:
            if result.name == name.replace(" ", ""):
                return result
        raise InputError("set", f"one of {', '.join(s.name for s in self.sets)}", name)

    @checked
    def pair(self, a: str, b: str, by: Literal["std", "error"] = "std") -> Pair:
        """Return two sets beside one another, `a` over `b`, whichever is better.

        Parameters
        ----------
        a, b : str
            Names of sets.
        by : {"std", "error"}
            ``std_median_mm`` or ``error_median_mm``.

        Raises
        ------
        InputError
            For sets that are not there, or one twice.
        """
        first, second = self[a].name, self[b].name
        for pair in self.pairs if by == "std" else self.error_pairs:
            if (pair.a, pair.b) == (first, second):
                return pair
            if (pair.b, pair.a) == (first, second):
                return pair.reversed()
        raise InputError("pair", "two sets", f"{a} twice")

    @property
    def rankings_differ(self) -> bool:
        """Whether some set repeats better than another that is significantly nearer the truth."""
        place = {name: k for k, name in enumerate(self.ranking)}
        return any(pair.significant and place[pair.a] > place[pair.b] for pair in self.error_pairs)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, without maps and cloud."""
        return {
            "scene": self.scene,
            "repeats": self.repeats,
            "seed": self.seed,
            "equal": self.equal,
            "pixels": self.pixels,
            "lit_pixels": self.lit_pixels,
            "sets": [result.to_dict() for result in self.sets],
            "ranking": list(self.ranking),
            "pairs": [pair.to_dict() for pair in self.pairs],
            "error_ranking": list(self.error_ranking),
            "error_pairs": [pair.to_dict() for pair in self.error_pairs],
        }
