"""Which fringes to project: the sequence that the noise of the system asks for (thesis ch. 4).

Each unwrapping step multiplies the number of fringes and divides the noise of the absolute
phase, until fringe orders are mistaken or fringes are too fine to be seen.  Two criteria:

*Thesis.*  Over a square grid of noise levels of reference and relative phase, up to a safety
factor times the measured noise, the next number of fringes minimises the integral of
``|grad sigma_Phi|^2`` (eq. 31); its sigma_Phi is the reference's noise of the step after.  The
sequence ends when a step lowers the noise of the grid by less than 1 % (eq. 32; as printed,
with an absolute value, it would also accept a step that raises the noise).  A table
sigma_phi(n, z) enters as a scale: the grid's levels are those of one fringe, and n fringes at
height z have sigma_phi(n, z) / sigma_phi(1) times as much.

*Bounded* (:mod:`slbench.design.fringes.bounded`).  Minimises the final noise itself, under a bound
on the probability of any fringe-order error, for a given number of frames.

What either sequence is worth is predicted by :func:`predict`, with the closed form of
:mod:`slbench.design.fringes.chain` for phases of one position.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import floor, pi
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.core.show.document import Cell, Table
from slbench.core.validation.types import FINITE, FringeCount, FringeWidth, Interval, PanelWidth
from slbench.core.validation.values import checked
from slbench.design.fringes.chain import any_error, unwrapping_chain
from slbench.design.fringes.noise import PhaseNoise
from slbench.design.fringes.unwrapping import (
    PhaseModel,
    absolute_sigma,
    sampled_sigma,
)
from slbench.patterns import (
    Axis,
    Fringes,
    PatternSequence,
    PatternSource,
    read_patterns,
)
from slbench.patterns.fringes import MIN_SHIFTS

Array = NDArray[np.float64]
Method = Literal["exact", "monte-carlo"]

#: Thesis eq. 32.
STOP_BELOW = 0.01
#: Noise levels of an axis of the grid where the step is not given: those of thesis 7.1.3.
LEVELS = 72
_MOST_LEVELS = 1000


@dataclass(frozen=True)
class Step:
    """One fringe set of a sequence and what is predicted after it.

    Parameters
    ----------
    fringes, shifts : int
    noise_rad : float
        Standard deviation of the set's relative phase, RMS over the heights.
    sigma_rad : float
        Standard deviation of the absolute phase, in radians of *one* fringe (Phi_n / n), RMS
        over the heights, fringe-order errors included.
    sigma_px : float
        The same in panel pixels, W / 2 pi times as much.
    order_error_probability : float
        Of this step alone, at the worst height.
    criterion : dict of int to float
        Eq. 31 by candidate, where it was used.
    """

    fringes: int
    shifts: int
    noise_rad: float
    sigma_rad: float
    sigma_px: float
    order_error_probability: float
    criterion: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SequenceDesign:
    """A sequence of fringe sets with its predicted noise.

    Parameters
    ----------
    width_px : int
        Coded panel width W.
    reference : Step
        The first set, whose relative phase is absolute.
    steps : tuple of Step
        The unwrapping steps after it.
    order_error_probability : float
        Of a mistake in any step, at the worst height.  The steps' errors are correlated;
        treated as independent they bound it from above: two steps that share an error are both the
        safer the less it is (Chebyshev's association inequality).
    levels : (L,) float
        Noise levels of the grid, rad; empty where no grid was used.
    surfaces : tuple of dict of int to (L, L) float
        For each step the noise after it by candidate, in radians of one fringe, over the
        levels of the first reference (rows) and of the relative phase (columns), RMS over the
        heights.
    """

    width_px: int
    reference: Step
    steps: tuple[Step, ...]
    order_error_probability: float
    levels: Array = field(default_factory=lambda: np.empty(0))
    surfaces: tuple[dict[int, Array], ...] = ()

    __repr__ = brief

    @property
    def fringes(self) -> tuple[int, ...]:
        """The fringe counts, the first set included."""
        return (self.reference.fringes, *(step.fringes for step in self.steps))

    @property
    def shifts(self) -> tuple[int, ...]:
        """The number of shifts of each set."""
        return (self.reference.shifts, *(step.shifts for step in self.steps))

    @property
    def frames(self) -> int:
        """Frames to project."""
        return sum(self.shifts)

    @property
    def sigma_rad(self) -> float:
        """Predicted noise of the whole sequence, radians of one fringe."""
        return (self.reference, *self.steps)[-1].sigma_rad

    @property
    def sigma_px(self) -> float:
        """Predicted noise of the whole sequence, panel pixels."""
        return (self.reference, *self.steps)[-1].sigma_px

    def sequence(self, panel: tuple[int, int], axis: Axis = "u") -> PatternSequence:
        """Return the patterns to project on a panel of (width, height) pixels."""
        sets = zip(self.fringes, self.shifts, strict=True)
        return PatternSequence(panel, tuple(Fringes(n, shifts, axis) for n, shifts in sets))

    def to_dict(self) -> dict[str, Any]:
        """Return the design as plain values for JSON."""

        def row(step: Step) -> dict[str, Any]:
            return {key: value for key, value in asdict(step).items() if value != {}}

        return {
            "fringes": list(self.fringes),
            "frames": self.frames,
            "sigma_rad": self.sigma_rad,
            "sigma_px": self.sigma_px,
            "order_error_probability": self.order_error_probability,
            "reference": row(self.reference),
            "steps": [row(step) for step in self.steps],
        }


@checked
def candidates(
    width_px: PanelWidth,
    *,
    max_fringes: FringeCount | None = None,
    min_px_per_fringe: FringeWidth = 5.0,
) -> list[int]:
    """Return the fringe counts that divide the width and are not too fine (thesis 4.2.1).

    Raises
    ------
    InputError
        For a width that cannot be coded, or limits that leave nothing.
    """
    most = min(width_px / min_px_per_fringe, max_fringes or width_px)
    found = [n for n in range(1, floor(most) + 1) if width_px % n == 0]
    if not found:
        expected = f"at most the width, {width_px} px"
        raise InputError("min_px_per_fringe", expected, min_px_per_fringe)
    return found


def usable(counts: Sequence[int], noise: PhaseNoise) -> list[int]:
    """Return the candidates whose noise is known and finite; one fringe must be among them.

    Raises
    ------
    InputError
        If it is not.
    """
    found = sorted(set(noise.measurable()).intersection(counts))
    if not found or found[0] != 1:
        raise InputError("phase noise", "finite noise of 1 fringe, where unwrapping begins", found)
    return found


def left_out(noise: PhaseNoise, counts: Sequence[int], width_px: int) -> dict[int, str]:
    """Return why counts of fringes whose noise is given are no candidates, by count."""
    found = {}
    for count, row in zip(noise.fringes.tolist(), noise.sigma_rad, strict=True):
        lost = [f"{z:g}" for z, sigma in zip(noise.z_mm, row, strict=True) if np.isinf(sigma)]
        if width_px % count:
            found[count] = f"no divisor of {width_px} px"
        elif count not in counts:
            found[count] = "finer than the least pixels per fringe or the most fringes allow"
        elif lost:
            found[count] = f"not measurable at z = {', '.join(lost)} mm"
    return found


@checked
def thesis_sequence(
    width_px: PanelWidth,
    noise: PhaseNoise,
    counts: Sequence[int] | None = None,
    *,
    safety: Annotated[float, FINITE, Interval(gt=1.0, le=1000.0)] = 2.0,
    noise_step: float | None = None,
    phase_model: PhaseModel = "exact",
    method: Method = "exact",
    repeats: int = 20,
    seed: int = 0,
    on_progress: Callable[[str, float], None] | None = None,
) -> SequenceDesign:
    """Design a sequence by the thesis's criterion (eq. 31) and stopping rule (eq. 32).

    Parameters
    ----------
    width_px : int
        Coded panel width W.
    noise : PhaseNoise
    counts : sequence of int, optional
        Candidates; those of :func:`candidates` by default.
    safety : float
        eta > 1: the grid goes up to eta times the noise of one fringe.
    noise_step : float, optional
        Step of the grid, rad; a 72nd of its extent by default.
    phase_model : {"exact", "thesis"}
        Of the criterion; predictions are for the exact one.
    method : {"exact", "monte-carlo"}
        Closed form, or the thesis's simulation of `repeats` captures with `seed`.
    on_progress : callable, optional
        Called with the stage and its finished fraction.

    Returns
    -------
    SequenceDesign

    Raises
    ------
    InputError
        For values outside their range, or noise that leaves no candidates.
    """
    options = usable(candidates(width_px) if counts is None else counts, noise)
    levels = noise_levels(noise.typical_rad, safety, noise_step)
    scale = {n: noise.of(n)[:, np.newaxis, np.newaxis] / noise.typical_rad for n in options}
    current = np.broadcast_to(
        scale[1] * levels[:, np.newaxis], (len(noise.z_mm), len(levels), len(levels))
    )
    spacing = levels[1] - levels[0]
    chosen: list[int] = [1]
    criteria: list[dict[int, float]] = []
    surfaces: list[dict[int, Array]] = []
    while True:
        maps: dict[int, Array] = {}
        for k, n in enumerate(options):
            relative = scale[n] * levels
            if method == "exact":
                maps[n] = absolute_sigma(n, current, relative, width_px=width_px, model=phase_model)
            else:
                sampling: dict[str, Any] = {"repeats": repeats, "seed": seed + len(chosen)}
                maps[n] = sampled_sigma(
                    n, current, relative, width_px=width_px, model=phase_model, **sampling
                )
            if on_progress:
                on_progress(f"step {len(chosen)}", (k + 1) / len(options))
        criterion = {n: _roughness(surface, spacing) for n, surface in maps.items()}
        best = min(criterion, key=criterion.__getitem__)
        improvement = 1.0 - np.linalg.norm(maps[best]) / np.linalg.norm(current)
        if best <= chosen[-1] or improvement < STOP_BELOW:
            break
        chosen.append(best)
        criteria.append(criterion)
        surfaces.append({n: np.sqrt(np.mean(s**2, axis=0)) for n, s in maps.items()})
        current = maps[best]
    return predict(
        width_px, noise, chosen, criteria=criteria, levels=levels, surfaces=tuple(surfaces)
    )


def noise_levels(sigma_rad: float, safety: float, noise_step: float | None) -> Array:
    """Return the grid's noise levels: multiples of the step up to safety times sigma, rad.

    Raises
    ------
    InputError
        For a step that makes fewer than two levels or too many.
    """
    extent = safety * sigma_rad
    step = extent / LEVELS if noise_step is None else noise_step
    # The sum of roundings must not cost the last level.
    count = floor(extent / step + 1e-9) if step > 0 and np.isfinite(step) else 0
    if not 2 <= count <= _MOST_LEVELS:
        expected = f"{extent / _MOST_LEVELS:.3g} to {extent / 2:.3g} rad for this noise"
        raise InputError("noise step", expected, noise_step)
    return np.arange(1, count + 1, dtype=np.float64) * step


def _roughness(surface: Array, spacing: float) -> float:
    """Integrate |grad sigma|^2 over the grid of each height, mean over the heights (eq. 31)."""
    rows, columns = np.gradient(surface, spacing, axis=(1, 2))
    integral = np.sum(rows**2 + columns**2, axis=(1, 2)) * spacing**2
    return float(np.mean(integral))


def single_step(width_px: int, noise: PhaseNoise, counts: Sequence[int]) -> SequenceDesign:
    """Return the best sequence of one step: least predicted noise (thesis ch. 2, rule of [51])."""
    options = usable(counts, noise)
    designs = [predict(width_px, noise, (1, n) if n > 1 else (1,)) for n in options]
    return min(designs, key=lambda design: design.sigma_rad)


def doubling(width_px: int, noise: PhaseNoise, counts: Sequence[int]) -> SequenceDesign:
    """Return the sequence 1, 2, 4, ... as far as there are candidates (thesis ch. 2, [49])."""
    options = usable(counts, noise)
    chosen = [1]
    while 2 * chosen[-1] in options:
        chosen.append(2 * chosen[-1])
    return predict(width_px, noise, chosen)


def predict_text(
    text: PatternSource,
    width_px: int,
    noise: PhaseNoise,
    where: str = "sequence",
    *,
    allow_modules: bool = False,
) -> SequenceDesign:
    """Return :func:`predict` of a pattern set, such as ``1,2,4``, ``1,8@12`` or ``mine.toml``.

    Raises
    ------
    InputError
        If it is none, or not of fringe sets alone.
    """
    found = read_patterns(
        *(text, (width_px, width_px)),
        shifts=noise.shifts,
        allow_modules=allow_modules,
        keep_panel=True,
        where=where,
    )
    sequence, text = found.sequence, found.name
    if sequence.panel[0] != width_px:
        raise InputError(where, f"patterns for a width of {width_px} px", f"{sequence.panel[0]} px")
    shifts = [len(placed.frames) for placed in sequence.fringe_sets("u")]
    if len(shifts) < len(sequence.parts):
        raise InputError(where, "fringe sets alone", text)
    counts = sequence.fringe_counts("u")
    whole = [int(count) for count in counts]
    if whole != list(counts):
        raise InputError(where, "whole numbers of fringes, whose noise is known", text)
    return predict(width_px, noise, whole, shifts)


def sequence_table(designs: Mapping[str, SequenceDesign]) -> Table:
    """Return sequences by name beside one another, with what is predicted of them."""

    def row(name: str, design: SequenceDesign) -> tuple[Cell, ...]:
        shifts = design.shifts if len(set(design.shifts)) > 1 else design.shifts[:1]
        return (
            name,
            ", ".join(map(str, design.fringes)),
            ", ".join(map(str, shifts)),
            design.frames,
            design.sigma_px,
            f"{design.order_error_probability:.1e}",
        )

    columns = ("sequence", "fringes", "shifts", "frames", "σ / px", "order errors")
    return Table("", columns, tuple(row(name, design) for name, design in designs.items()))


def predict(
    width_px: PanelWidth,
    noise: PhaseNoise,
    fringes: Sequence[int],
    shifts: int | Sequence[int] | None = None,
    *,
    criteria: Sequence[dict[int, float]] = (),
    levels: Array | None = None,
    surfaces: tuple[dict[int, Array], ...] = (),
) -> SequenceDesign:
    """Predict the noise and the fringe-order errors of any sequence.

    The closed form of :mod:`slbench.design.fringes.chain`.  Sequences whose counts divide one
    another agree with simulated ones within sampling error (0.3 %), wrong orders dominating or not.
    A ratio that is not whole costs up to 1 % ({1, 16, 25}, {1, 4, 5}, {1, 2, 3} with 2 to 13 % of
    wrong orders), two of them in one sequence 3 % ({1, 4, 10, 25}) to 10 % ({1, 2, 5, 8}).

    Parameters
    ----------
    width_px : int
        Coded panel width W.
    noise : PhaseNoise
    fringes : sequence of int
        Counts in order of unwrapping.
    shifts : int or sequence of int, optional
        Shifts of every set, or of each; those of `noise` by default.
    criteria, levels, surfaces
        Of the design, to keep with it.

    Returns
    -------
    SequenceDesign

    Raises
    ------
    InputError
        For a sequence that does not begin with one fringe and rise, or with unknown noise.
    """
    counts = [int(n) for n in fringes]
    rising = bool(counts) and counts[0] == 1 and bool(np.all(np.diff(counts) > 0))
    if not rising or counts != list(fringes):
        raise InputError("fringes", "ascending whole numbers from 1", list(fringes))
    if shifts is None or isinstance(shifts, int | np.integer):
        each = [noise.shifts if shifts is None else int(shifts)] * len(counts)
    else:
        each = [int(many) for many in shifts]
    if len(each) != len(counts) or min(each) < MIN_SHIFTS:
        expected = f"at least {MIN_SHIFTS} for each of {len(counts)} sets"
        raise InputError("shifts", expected, each)
    sigma = np.array([noise.of(n, many) for n, many in zip(counts, each, strict=True)])
    if not np.all(np.isfinite(sigma)):
        raise InputError("phase noise", "fringes that can be measured", f"infinite for {counts}")
    relative = [noise.relative(n, many) for n, many in zip(counts, each, strict=True)]
    variance, wrong = unwrapping_chain(counts, np.array(relative))
    total = np.sqrt(np.mean(variance, axis=1))
    steps = [
        Step(
            counts[k],
            each[k],
            float(np.sqrt(np.mean(sigma[k] ** 2))),
            float(total[k]),
            float(total[k]) * width_px / (2.0 * pi),
            float(wrong[k].max()),
            criteria[k - 1] if 0 < k <= len(criteria) else {},
        )
        for k in range(len(counts))
    ]
    return SequenceDesign(
        width_px,
        steps[0],
        tuple(steps[1:]),
        float(any_error(wrong).max()),
        np.empty(0) if levels is None else levels,
        surfaces,
    )
