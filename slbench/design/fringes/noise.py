"""Noise of the relative phase: how it is estimated, and as a table by fringes and height.

Thesis eq. 25 estimates one number from repeated captures of a plane.  As printed it pools all
pixels around one common mean, which measures noise only where the phase map is constant: over
a plane that is seen at an angle, or coded by fringes at all, the ramp of the phase itself is
far larger than its noise.  What the text means is a deviation from each pixel's own mean over
the repeats, and an average of these over the pixels.  That is done by default, with the root mean
square for the average, because variances add up and deviations do not: it is the larger one where
pixels differ (by 6 % if half of them have twice the noise of the others).  Both are here.

Where the projector or the camera defocuses, fine fringes lose modulation and their noise grows
(thesis 5.3): a :class:`PhaseNoise` therefore holds sigma_phi(n, z).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from math import pi, sqrt
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.io import read_table, write_table
from slbench.core.show.display import brief
from slbench.core.validation.values import checked
from slbench.patterns import Axis, Placed
from slbench.patterns.fringes.wrong_orders import phase_deviation, relative_noise
from slbench.simulate.floors import rms

Array = NDArray[np.float64]
Estimator = Literal["per-pixel", "pooled"]

COLUMNS = ("fringes", "z_mm", "sigma_rad")


@dataclass(frozen=True, eq=False)
class PhaseNoise:
    """Standard deviation of the relative phase by number of fringes and height.

    Parameters
    ----------
    fringes : (k,) int
        Fringe counts, ascending.
    sigma_rad : (k, m) float
        Positive, at most pi (noise that fills the circle has 1.8); infinite where the phase
        could not be measured.
    z_mm : (m,) float
        Heights.
    shifts : int
        Shifts N that it was measured with; other N scale it by sqrt(shifts / N).
    measured : bool
        Whether it was found from phases, whose deviation it is; otherwise it is that to first
        order, sqrt(2 / N) sigma_I / b, which a phase of much noise exceeds (4 % at 0.25 rad).
    floor_rad, monte_carlo_rad : (k, m) float, optional
        What a simulation knows beside its noise: the RMS error of the phase without the detector,
        and the part of it that more samples would take away; NaN where the fringes are washed out.
        Files do not keep them.

    Raises
    ------
    InputError
        For arrays that do not fit each other, or deviations that are not positive.
    """

    fringes: NDArray[np.int64]
    sigma_rad: Array
    z_mm: Array
    shifts: int = 3
    floor_rad: Array | None = None
    monte_carlo_rad: Array | None = None
    measured: bool = True

    __repr__ = brief

    def __post_init__(self) -> None:
        if self.fringes.ndim != 1 or len(self.fringes) == 0 or np.any(np.diff(self.fringes) < 1):
            raise InputError("phase noise: fringes", "ascending counts", self.fringes)
        shape = (len(self.fringes), len(self.z_mm))
        for name in ("sigma_rad", "floor_rad", "monte_carlo_rad"):
            array = getattr(self, name)
            if array is not None and (array.shape != shape or shape[1] == 0):
                raise InputError(f"phase noise: {name}", f"shape {shape}", array.shape)
        finite = self.sigma_rad[np.isfinite(self.sigma_rad)]
        if not (np.all(self.sigma_rad > 0.0) and np.all(finite <= pi)):
            expected = "positive numbers (rad), at most pi unless infinite"
            raise InputError("phase noise: sigma_rad", expected, _first_bad(self.sigma_rad))
        if self.fringes[0] < 1:
            raise InputError("phase noise: fringes", "counts of at least 1", self.fringes[0])

    @classmethod
    def constant(cls, sigma_rad: float, fringes: Iterable[int], shifts: int = 3) -> PhaseNoise:
        """Return the same noise for all `fringes`, at one height: sqrt(2 / N) sigma_I / b."""
        if not 0.0 < sigma_rad <= pi:
            raise InputError("noise", "a positive number (rad), at most pi", sigma_rad)
        counts = np.array(sorted(set(fringes)), np.int64)
        sigma = np.full((len(counts), 1), float(sigma_rad))
        return cls(counts, sigma, np.zeros(1), shifts, measured=False)

    @classmethod
    def read(cls, path: str | Path, shifts: int = 3) -> PhaseNoise:
        """Read a CSV file with the columns fringes, z_mm, sigma_rad: every count at every height.

        Raises
        ------
        InputError
            For a file that cannot be read, or with gaps or repetitions.
        """
        rows = read_table(path, COLUMNS, finite=False)
        if not np.all(np.isfinite(rows[:, :2])):
            bad = rows[:, :2][~np.isfinite(rows[:, :2])][0]
            raise InputError(path, "finite fringes and heights", bad)
        odd = (rows[:, 0] != np.rint(rows[:, 0])) | (rows[:, 0] < 1)
        if np.any(odd):
            raise InputError(f"{path}: fringes", "whole numbers >= 1", rows[odd, 0][0])
        finite = rows[np.isfinite(rows[:, 2]), 2]
        if not (np.all(rows[:, 2] > 0.0) and np.all(finite <= pi)):
            expected = "positive numbers (rad), at most pi, or inf where none was measured"
            raise InputError(f"{path}: sigma_rad", expected, _first_bad(rows[:, 2]))
        counts, which = np.unique(rows[:, 0], return_inverse=True)
        heights, where = np.unique(rows[:, 1], return_inverse=True)
        sigma = np.full((len(counts), len(heights)), np.nan)
        sigma[which, where] = rows[:, 2]
        if len(rows) != sigma.size or np.isnan(sigma).any():
            expected = f"each of {len(counts)} counts once at each of {len(heights)} heights"
            raise InputError(path, expected, f"{len(rows)} rows")
        return cls(counts.astype(np.int64), sigma, heights, shifts)

    def relative(self, fringes: int, shifts: int | None = None) -> Array:
        """Return the noise over modulation at all heights, (m,), for a number of shifts.

        sqrt(2 / N) sigma_I / b, which the density of the phase error follows from
        (:func:`slbench.patterns.fringes.wrong_orders.relative_noise`).
        """
        own = self.of(fringes)
        scale = sqrt(self.shifts / (shifts or self.shifts))
        return (relative_noise(own) if self.measured else own) * scale

    def write(self, path: str | Path) -> None:
        """Write what :meth:`read` reads: deviations of the phase."""
        found = self.sigma_rad if self.measured else phase_deviation(self.sigma_rad)
        write_table(
            path,
            COLUMNS,
            (
                (count, z, sigma)
                for count, row in zip(self.fringes, found, strict=True)
                for z, sigma in zip(self.z_mm, row, strict=True)
            ),
        )

    def floors(self) -> tuple[Array, Array] | None:
        """Return floor and Monte Carlo part, RMS over the heights, (k,) each, rad.

        None where they are not known; NaN for fringes that are washed out everywhere.
        """
        if self.floor_rad is None or self.monte_carlo_rad is None:
            return None
        whole, sampling = (
            [rms([row]) for row in rows] for rows in (self.floor_rad, self.monte_carlo_rad)
        )
        return np.array(whole), np.array(sampling)

    def of(self, fringes: int, shifts: int | None = None) -> Array:
        """Return sigma_phi of `fringes` at all heights, (m,), rad.

        Raises
        ------
        InputError
            If the table has no such count.
        """
        k = int(np.searchsorted(self.fringes, fringes))
        if k == len(self.fringes) or self.fringes[k] != fringes:
            known = ", ".join(map(str, self.fringes))
            raise InputError("phase noise", f"one of {known} fringes", fringes)
        return self.sigma_rad[k] * sqrt(self.shifts / (shifts or self.shifts))

    def measurable(self) -> list[int]:
        """Return the fringe counts with finite noise at every height."""
        return self.fringes[np.isfinite(self.sigma_rad).all(axis=1)].tolist()

    @property
    def typical_rad(self) -> float:
        """Noise of the first count, RMS over the heights, rad: the sigma of the thesis's grid."""
        return float(np.sqrt(np.mean(self.sigma_rad[0] ** 2)))


def _first_bad(sigma: Array) -> float:
    """Return the first deviation that is neither within (0, pi] nor infinite."""
    good = (sigma > 0.0) & ((sigma <= pi) | np.isinf(sigma))
    return float(sigma[~good].flat[0])


@dataclass(frozen=True)
class NoiseEstimate:
    """One estimated deviation of the relative phase.

    ``standard_error_rad`` is that of the estimate, sigma / sqrt(2 degrees of freedom), for
    noise that is independent from pixel to pixel.
    """

    sigma_rad: float
    standard_error_rad: float
    repeats: int
    pixels: int


@checked
def estimate_noise(phases: ArrayLike, estimator: Estimator = "per-pixel") -> NoiseEstimate:
    """Estimate the noise of repeated relative phases (thesis eq. 25).

    Parameters
    ----------
    phases : (R, ...) array_like
        Relative phase of R repeats, rad; NaN marks pixels to leave out.  Jumps of 2 pi between
        repeats do no harm.
    estimator : {"per-pixel", "pooled"}
        ``per-pixel``: deviations from each pixel's mean, root mean square over the pixels, with
        R - 1 degrees of freedom a pixel.  It does not depend on the shape of the phase map.
        ``pooled``: eq. 25 as printed, deviations of all pixels and repeats from one mean: it is
        the noise for a constant phase map only, and the spread of the map otherwise.

    Returns
    -------
    NoiseEstimate

    Raises
    ------
    InputError
        For fewer than two repeats or no pixel that all repeats have.
    """
    stack = np.asarray(phases, dtype=np.float64)
    if stack.ndim < 2 or len(stack) < 2:
        raise InputError("estimate_noise: phases", "shape (R >= 2, ...)", stack.shape)
    repeats = len(stack)
    stack = stack.reshape(repeats, -1)
    stack = stack[:, np.isfinite(stack).all(axis=0)]
    pixels = stack.shape[1]
    if pixels == 0:
        raise InputError("estimate_noise: phases", "a pixel that all repeats have", "none")
    axis = 0 if estimator == "per-pixel" else None
    centre = np.angle(np.exp(1j * stack).mean(axis=axis))
    off = np.mod(stack - centre + pi, 2.0 * pi) - pi
    off -= off.mean(axis=axis)
    freedom = pixels * (repeats - 1) if estimator == "per-pixel" else pixels * repeats - 1
    sigma = sqrt(float(np.sum(off * off)) / freedom)
    return NoiseEstimate(sigma, sigma / sqrt(2.0 * freedom), repeats, pixels)


def noise_of_captures(
    captures: Sequence[Capture],
    axis: Axis = "u",
    *,
    estimator: Estimator = "per-pixel",
    min_modulation: float = 3.0,
    names: Sequence[str] | None = None,
) -> PhaseNoise:
    """Estimate the phase noise of every fringe set from repeated captures of one plane.

    Parameters
    ----------
    captures : sequence of Capture
        At least two, of the same patterns and size, nothing moved in between.
    axis : {"u", "v"}
        Which fringes.
    estimator : {"per-pixel", "pooled"}
        As of :func:`estimate_noise`.
    min_modulation : float
        Least modulation, DN, of the pixels that count, from products of different captures, whose
        noise is independent and adds nothing; saturated pixels never count.
    names : sequence of str, optional
        Of the captures, for messages.

    Returns
    -------
    PhaseNoise
        At one height, called 0.  Infinite for sets that are washed out: that have the least
        modulation on less than half of the pixels that have it in the coarsest set.  All others
        are estimated on the same pixels, those that have it in every one of them.

    Raises
    ------
    InputError
        For captures that differ or are copies, have no fringes along the axis, sets of different
        numbers of shifts, or no pixels that can be measured.
    """
    if len(captures) < 2:
        raise InputError("captures", "at least 2 repeats", len(captures))
    known = names or [f"captures[{k}]" for k in range(len(captures))]
    sets = _fringe_sets(captures[0], axis)
    shifts = {len(own.frames) for own in sets}
    if len(shifts) > 1:
        raise InputError("captures", "one number of shifts for all fringes", sorted(shifts))
    _check_repeats(captures, known, sorted(k for own in sets for k in own.frames))
    panel = captures[0].sequence.panel
    counts = [own.code.fringe_count(panel) or 0 for own in sets]
    if any(count != int(count) for count in counts):
        raise InputError("captures", "whole numbers of fringes", counts)
    usable = []
    for own in sets:
        shape = captures[0].frames.shape[1:]
        wave, power, valid = np.zeros(shape, complex), np.zeros(shape), np.ones(shape, bool)
        for shot in captures:
            top = shot.top_dn
            frames = shot.frames[own.frames]
            valid &= (frames < top).all(axis=0)
            phase, modulation, _ = own.code.relative_phase(frames, panel)
            wave += modulation * np.exp(1j * phase)
            power += modulation**2
        square = (np.abs(wave) ** 2 - power) / (len(captures) * (len(captures) - 1))
        usable.append(valid & (np.maximum(square, 0.0) >= min_modulation**2))
    if not usable[0].any():
        where = f"captures: {counts[0]} fringes"
        raise InputError(where, f"a pixel with modulation >= {min_modulation} DN", "none")
    enough = 0.5 * usable[0].sum()
    measured = [(usable[0] & seen).sum() >= enough for seen in usable]
    common = np.logical_and.reduce(
        [seen for seen, good in zip(usable, measured, strict=True) if good]
    )
    if not common.any():
        raise InputError("captures", "a pixel that all fringe sets are measured on", "none")
    sigma = np.full((len(sets), 1), np.inf)
    for row, own, good in zip(sigma, sets, measured, strict=True):
        if good:
            stacks = (shot.frames[own.frames] for shot in captures)
            phases = [own.code.relative_phase(stack, panel)[0][common] for stack in stacks]
            row[0] = estimate_noise(phases, estimator).sigma_rad
    return PhaseNoise(np.array(counts, np.int64), sigma, np.zeros(1), shifts.pop())


def _fringe_sets(shot: Capture, axis: Axis) -> list[Placed]:
    """Return every fringe set along the axis, ascending by fringes."""
    sets = shot.sequence.fringe_sets(axis)
    if not sets:
        raise InputError("captures", f"fringes along {axis}", shot.sequence.name)
    return sorted(sets, key=lambda own: own.code.fringe_count(shot.sequence.panel) or 0)


def _check_repeats(
    captures: Sequence[Capture], names: Sequence[str], frames: Sequence[int]
) -> None:
    """Refuse captures of other patterns, and copies: noise never repeats a whole frame."""
    first = captures[0]
    seen: dict[bytes, str] = {}
    for name, shot in zip(names, captures, strict=True):
        shot.one_exposure(name)  # modulations are of one
        if shot.sequence != first.sequence:
            raise InputError(
                name, f"the patterns of the first, {first.sequence.name}", shot.sequence.name
            )
        if shot.frames.shape != first.frames.shape:
            raise InputError(
                name, f"the size of the first, {first.frames.shape}", shot.frames.shape
            )
        for k in frames:
            digest = blake2b(
                np.ascontiguousarray(shot.frames[k]).data, salt=str(k).encode()
            ).digest()
            if digest in seen:
                raise InputError(
                    f"{name}: frame {k}", "noise of its own", f"that of {seen[digest]}"
                )
            seen[digest] = name
