"""Balls and plates fitted to points, what noise does to them, and what a displacement would.

Fits are geometric least squares.  To first order a displacement ``d`` of the points changes the
fitted parameters by ``(A^T A)^-1 A^T (n . d)``, ``n`` the surface's normals and ``A`` the
derivatives of the distance from the surface, and the residuals by what is left of ``n . d``: this
is how the error of a rig's parameter, or noise of each point, reaches a size, a spacing and a form.

A form is a range of residuals after a share of the points, those furthest from the surface, has
been set aside.  What noise does to it is told by drawing noise anew on residuals shrunk to what
noise leaves of them, so that their spread is the one that was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.accept.definitions import DISPERSION_SHARE
from slbench.cloud.fits.covariance import along_lines
from slbench.cloud.fits.squares import core
from slbench.cloud.triangulation import Axis
from slbench.core.errors import InputError
from slbench.rig.pose import product
from slbench.score.features import fit_sphere
from slbench.score.residuals import MIN_POINTS, most_aside, trimmed_range

Array = NDArray[np.float64]

#: Draws of noise that a form's deviation is taken from, least and most: known to 5 and 1.8 %; and
#: numbers that are drawn for one.
_DRAWS, _NUMBERS = (200, 1500), 3_000_000


@dataclass(frozen=True, eq=False)
class Points:
    """Points of one ball or plate, as one view measured them.

    Parameters
    ----------
    points : (N, 3) float
        mm.
    noise_mm : (N, A, 3) float, optional
        One standard deviation of noise, along its directions; None where it is not predicted.
    lines : (N,) int, optional
        Image line of each point, along which errors go together where noise is not predicted.
    world : (N, 3) float, optional
        The points in the instrument's own frame, where they were moved since.
    turn : (N, 3, 3) float, optional
        Rotation from there.
    sampling_mm : (N, 3) float, optional
        One draw of what the renderer's samples leave in the points.
    left_out : int
        Points over the ball or plate that are too far from it to be its own.
    """

    points: Array
    noise_mm: Array | None = None
    lines: NDArray[np.integer] | None = None
    world: Array | None = None
    turn: Array | None = None
    sampling_mm: Array | None = None
    left_out: int = 0

    def __len__(self) -> int:
        return len(self.points)

    def chosen(self, some: NDArray[np.intp]) -> Points:
        """Return some of the points."""
        names = ("points", "noise_mm", "lines", "world", "turn", "sampling_mm")
        parts: dict[str, Any] = {name: getattr(self, name) for name in names}
        chosen = {k: own[some] for k, own in parts.items() if own is not None}
        return Points(**chosen)

    def moved(self, rotation: Array, shift: Array) -> Points:
        """Return the points after ``x -> R x + t``."""
        noise = None if self.noise_mm is None else product(self.noise_mm, rotation.T)
        turn = rotation if self.turn is None else rotation @ self.turn
        return replace(
            self,
            points=product(self.points, rotation.T) + shift,
            noise_mm=noise,
            world=self.points if self.world is None else self.world,
            turn=np.broadcast_to(turn, (len(self), 3, 3)),
            sampling_mm=None if self.sampling_mm is None else product(self.sampling_mm, rotation.T),
        )


def joined(parts: list[Points]) -> Points:
    """Return the points of several views as one cloud."""
    if len(parts) == 1:
        return parts[0]
    noise = _together([part.noise_mm for part in parts])
    sampling = _together([part.sampling_mm for part in parts])
    lines, first = [], 0
    for part in parts:
        own = np.arange(len(part)) if part.lines is None else part.lines - part.lines.min()
        lines.append(own + first)
        first += int(own.max()) + 1
    return Points(
        np.concatenate([part.points for part in parts]),
        noise,
        np.concatenate(lines),
        np.concatenate([part.points if part.world is None else part.world for part in parts]),
        np.concatenate([_turn(part) for part in parts]),
        sampling,
        sum(part.left_out for part in parts),
    )


def lines_of(pixels: NDArray[np.integer], axes: Sequence[Axis] = ("u",)) -> NDArray[np.integer]:
    """Return the image line of each pixel (N, 2) that runs along the fringes, (N,).

    Columns where the panel's u is coded, as where nothing is known of the axes; rows where its v
    alone is.
    """
    return pixels[:, 0 if "u" in axes else 1]


def _together(parts: list[Array | None]) -> Array | None:
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if len(known) == len(parts) else None


def _turn(part: Points) -> Array:
    return np.broadcast_to(np.eye(3), (len(part), 3, 3)) if part.turn is None else part.turn


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares ball or plate.

    Parameters
    ----------
    points : Points
    values : (k,) float
        Centre and radius of a ball; of a plate nothing that is tested.
    normals, residuals : (N, 3), (N,) float
        Outward normals, and distances from the surface along them.
    design : (N, k) float
        Derivatives of the distance of a point from the origin of its parameters.
    inliers : (N,) bool
        Points that the fit is of; the others are form.
    """

    points: Points
    values: Array
    normals: Array
    residuals: Array
    design: Array
    inliers: NDArray[np.bool_]

    @cached_property
    def inverse(self) -> Array:
        """Return what turns displacements along the normals into parameters, (k, N)."""
        inner = np.where(self.inliers[:, None], self.design, 0.0)
        solve = np.linalg.pinv(inner.T @ inner, hermitian=True)
        return np.asarray(solve @ inner.T)

    @property
    def form_mm(self) -> float:
        """Range of the residuals, 0.3 % of the points set aside."""
        return trimmed_range(self.residuals)

    @property
    def dispersion_mm(self) -> float:
        """Width of the thinnest shell about the surface that holds 95 % of the points."""
        return thinnest(self.residuals, DISPERSION_SHARE)

    def noise(self) -> Array | None:
        """Return the standard deviation of each point along its normal, (N,); None: unknown."""
        if self.points.noise_mm is None:
            return None
        along = np.einsum("nai,ni->na", self.points.noise_mm, self.normals)
        return np.sqrt(np.sum(along**2, axis=1))

    def covariance(self) -> Array:
        """Return what noise makes of the parameters, (k, k), mm^2.

        By the predicted noise of each point where there is any.  By the scatter of the residuals
        otherwise, along whole lines where five or more are known
        (:func:`~slbench.cloud.fits.covariance.along_lines`): it then holds what does not repeat to
        zero as well.
        """
        inverse, noise = self.inverse, self.noise()
        if noise is not None:
            scaled = inverse * noise
            return np.asarray(scaled @ scaled.T)
        inner = self.inliers
        parts = self.design[inner], self.residuals[inner]
        apart = np.arange(len(parts[1]))
        lines = apart if self.points.lines is None else self.points.lines[inner]
        together = along_lines(*parts, lines)
        return together if np.all(np.isfinite(together)) else along_lines(*parts, apart)

    def change(self, displacement: Array) -> tuple[Array, Array]:
        """Return what displacements (N, 3) make of parameters and residuals, to first order."""
        along = np.einsum("ni,ni->n", displacement, self.normals)
        values = self.inverse @ along
        return values, along - self.design @ values

    def displaced(self, displacement: Array) -> Fit:
        """Return the fit to points that are displaced (N, 3), to first order."""
        values, residuals = self.change(displacement)
        return replace(self, values=self.values + values, residuals=self.residuals + residuals)

    def thinned(self, count: int) -> Fit:
        """Return the fit with an even choice of its inliers in place of all points."""
        kept = np.flatnonzero(self.inliers)
        some = kept[np.linspace(0, len(kept) - 1, min(count, len(kept))).astype(np.intp)]
        return Fit(
            self.points.chosen(some),
            self.values,
            self.normals[some],
            self.residuals[some],
            self.design[some],
            self.inliers[some],
        )

    @property
    def roughness_mm(self) -> float:
        """Standard deviation of the inliers' residuals about a cubic of their place, mm."""
        points = self.points.points[self.inliers]
        axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][:2]
        x, y = product(points - points.mean(axis=0), axes.T).T
        x, y = x / np.abs(x).max(), y / np.abs(y).max()
        terms = [x**i * y**j for i in range(4) for j in range(4 - i)]
        design = np.stack(terms, axis=1)
        left = self.residuals[self.inliers]
        left = left - design @ np.linalg.lstsq(design, left, rcond=None)[0]
        return float(np.sqrt(np.sum(left**2) / max(len(left) - len(terms), 1)))

    @cached_property
    def form_deviations(self) -> tuple[float, float]:
        """Standard deviations that noise gives the form and the dispersion, mm."""
        noise, spread = self.noise(), float(np.std(self.residuals[self.inliers]))
        if noise is None:
            noise = np.full(len(self.residuals), spread)
        level = float(np.sqrt(np.mean(noise[self.inliers] ** 2)))
        kept = np.sqrt(max(0.0, 1.0 - (level / spread) ** 2)) if spread > 0.0 else 0.0
        still = np.where(self.inliers, kept, 1.0) * self.residuals
        # Seeded by what was measured: draws that all places share would be off to one side.
        rng = np.random.default_rng(np.frombuffer(self.residuals[:4].tobytes(), np.uint32))
        draws = np.empty((int(np.clip(_NUMBERS // len(noise), *_DRAWS)), 2))
        for k in range(len(draws)):
            drawn = still + noise * rng.standard_normal(len(noise))
            draws[k] = trimmed_range(drawn), thinnest(drawn, DISPERSION_SHARE)
        deviations = draws.std(axis=0, ddof=1)
        return float(deviations[0]), float(deviations[1])


def fit_ball(points: Points, where: str) -> Fit:
    """Fit a ball.

    Raises
    ------
    InputError
        For fewer than 20 points.
    """
    _check(points, where)
    start, *_ = fit_sphere(points.points)
    kept = core(np.linalg.norm(points.points - start, axis=-1))
    centre, radius, *_ = fit_sphere(points.points[kept])
    outward = points.points - centre
    distance = np.linalg.norm(outward, axis=-1)
    normals = outward / distance[:, None]
    design = np.column_stack((normals, np.ones(len(normals))))
    return Fit(points, np.array([*centre, radius]), normals, distance - radius, design, kept)


def fit_plate(points: Points, where: str) -> Fit:
    """Fit a plate, by orthogonal distances.

    Raises
    ------
    InputError
        For fewer than 20 points.
    """
    _check(points, where)
    kept = np.ones(len(points), bool)
    for _ in range(2):  # once with all, once without those that are far off
        middle = points.points[kept].mean(axis=0)
        axes = np.linalg.svd(points.points[kept] - middle, full_matrices=False)[2]
        local = product(points.points - middle, axes.T)
        kept = core(local[:, 2])
    design = np.column_stack((np.ones(len(local)), local[:, :2]))
    normals = np.broadcast_to(axes[2], points.points.shape)
    return Fit(points, np.zeros(3), normals, local[:, 2], design, kept)


def thinnest(residuals: Array, share: float) -> float:
    """Return the width of the shortest interval that holds at least a share of the residuals."""
    ordered = np.sort(residuals)
    inside = ordered.size - most_aside(ordered.size, 1.0 - share)
    return float(np.min(ordered[inside - 1 :] - ordered[: ordered.size - inside + 1]))


def _check(points: Points, where: str) -> None:
    if len(points) < MIN_POINTS:
        raise InputError(where, f"at least {MIN_POINTS} measured points", len(points))
