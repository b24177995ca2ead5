"""Dots of a plate on a stage, in a capture: where the camera sees them, where the panel, and which.

At every position of the stage the plate is captured; its dots are detected in the lit picture,
numbered, and re-mapped to the panel (thesis 5.4.2 to 5.4.4).  The plate lies square to the stage:
its own axes are those of the world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.calibration.models.points import CalibrationPoints, joined
from slbench.calibration.target.detect import Dots, detect_dots
from slbench.calibration.target.indexing import index_grid
from slbench.calibration.target.remap import remap
from slbench.capture.capture import Capture
from slbench.capture.stack import MANIFEST as STACK_MANIFEST
from slbench.capture.stack import FocusStack, WeightSource
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.patterns import PhaseMap
from slbench.rig import Rig

Array = NDArray[np.float64]

Remapping = Literal["ring", "bilinear"]

#: Header of a file of stage positions: where the plate's origin is at each.
POSITIONS = ("x_mm", "y_mm", "z_mm")
#: Inner and outer radius of the ring about a dot, in radii: from beyond its blurred rim to
#: before the neighbours' at 3 radii (a pitch of two diameters).
_RING = (1.3, 2.5)


@dataclass(frozen=True, eq=False, kw_only=True)
class StageView:
    """Dots of a plate at one position of the stage, n of them, numbered and re-mapped.

    Parameters
    ----------
    numbers : (n,) int64
        Which of the plate's dots each is.
    pixels : (n, 4) float
        ``u_c, v_c, u_p, v_p``, px; ``v_p`` is NaN where it is not coded.
    sd : (n, 4) float
        Their predicted deviations.
    """

    numbers: NDArray[np.intp]
    pixels: Array
    sd: Array

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.numbers)

    def points(self, world: ArrayLike, position: int) -> CalibrationPoints:
        """Return calibration points.

        Parameters
        ----------
        world : (k, 3) float
            Where all dots of the plate are, mm.
        position : int
            Of the stage.
        """
        places = np.asarray(world, dtype=np.float64)[self.numbers]
        return CalibrationPoints(
            self.pixels, places, np.full(len(self), position, dtype=np.intp), self.sd
        )


def stage_view(
    capture: Capture,
    dots: ArrayLike,
    *,
    expected: ArrayLike | None = None,
    remapping: Remapping = "ring",
    phase: PhaseMap | None = None,
) -> StageView:
    """Find the dots of a plate in a capture.

    Parameters
    ----------
    capture : Capture
        Of a plate with dark dots, column coordinates coded.
    dots : (k, 3) float
        Centres on the plate: a grid, straight or staggered, whose rows run along +x, one after
        the other towards -y.
    expected : (k, 2) float, optional
        Where the camera should see them, to half a cell, px.  Without it the whole grid must be
        in view, its rows running right.
    remapping : {"ring", "bilinear"}
        ``bilinear`` interpolates the phase at the centre (thesis eq. 33-36), which is that of a
        dark dot: noisy, or lost where fringes are blurred.  ``ring`` fits a quadratic to the
        phase of the plate around the dot.
    phase : PhaseMap, optional
        Of the capture, decoded already.

    Raises
    ------
    InputError
        If no columns are coded, there are no dots, or they cannot be numbered.
    """
    if remapping not in ("ring", "bilinear"):
        raise InputError("remapping", "ring or bilinear", repr(remapping))
    if "u" not in capture.sequence.axes:
        got = capture.sequence.name
        raise InputError("patterns", "codes of the panel's columns (u)", got)
    decoded = capture.decode() if phase is None else phase
    lit = capture.sequence.lit_frame
    found = detect_dots(capture.evened(decoded.mean if lit is None else capture.frames[lit]))
    places = np.asarray(dots, dtype=np.float64)
    numbers = (
        _of_a_whole_grid(found, places)
        if expected is None
        else _near(found.centres, places, np.asarray(expected, dtype=np.float64))
    )
    ring = remapping == "ring"
    reach = int(np.ceil(_RING[1] * float(np.median(found.radii))))
    panel = remap(
        found.centres,
        decoded,
        centre_sd=found.sd,
        window=reach if ring else None,
        exclude_px=_RING[0] * found.semi_axes[:, 0] if ring else 0.0,
    )
    place, sd = np.full((2, len(found), 2), np.nan)
    for k, axis in enumerate(panel.axes):
        place[:, "uv".index(axis)], sd[:, "uv".index(axis)] = (
            panel.coordinates[:, k],
            panel.sd[:, k],
        )
    coded = [axis in panel.axes for axis in ("u", "v")]
    good = (numbers >= 0) & np.isfinite(place[:, coded]).all(axis=1)
    if not good.any():
        got = f"{np.count_nonzero(numbers >= 0)} numbered ones, none of them decoded"
        raise InputError("dots", "dots of the grid that the projector lights", got)
    centre_sd = np.column_stack((found.sd, found.sd))
    return StageView(
        numbers=numbers[good],
        pixels=np.column_stack((found.centres, place))[good],
        sd=np.column_stack((centre_sd, sd))[good],
    )


def stage_folders(
    folders: Sequence[str | Path],
    dots: ArrayLike,
    positions_mm: ArrayLike,
    *,
    rig: Rig | None = None,
    weights: WeightSource = "lit",
    remapping: Remapping = "ring",
    allow_modules: bool = False,
    allow_outside: bool = False,
    on_progress: Callable[[str, float], None] | None = None,
) -> tuple[CalibrationPoints, dict[str, InputError]]:
    """Find the dots of a plate in captures at known positions of the stage.

    Parameters
    ----------
    folders : sequence of path
        Captures or focus stacks, one a position.
    dots : (k, 3) float
        Centres on the plate (:func:`stage_view`), mm.
    positions_mm : (m, 3) float
        Of the plate's origin at each, as many as folders.
    rig : Rig, optional
        Where dots are expected, to half a cell; that of each capture otherwise, where it has one.
    weights, remapping
        Of stacks and dots.
    allow_modules, allow_outside : bool
        As for captures.
    on_progress : callable, optional

    Returns
    -------
    points : CalibrationPoints
        With positions, counted as the folders, and deviations.
    refused : dict of str to InputError
        Why a folder has no points, by its name.

    Raises
    ------
    InputError
        For a folder that is none of a capture, other numbers of folders and positions, and where
        no folder has points (the first cause).
    """
    places, own = np.asarray(positions_mm, dtype=np.float64), np.asarray(dots, dtype=np.float64)
    if len(places) != len(folders):
        expected = f"{len(folders)} positions, as many as folders"
        raise InputError("positions", expected, len(places))
    found, refused = [], {}
    for k, (folder, place) in enumerate(zip(folders, places, strict=True)):
        options: dict[str, Any] = {"allow_modules": allow_modules, "allow_outside": allow_outside}
        is_stack = (Path(folder) / STACK_MANIFEST).exists()
        stack = (
            FocusStack.load(folder, **options)
            if is_stack
            else FocusStack((Capture.load(folder, **options),))
        )
        world = own + place
        known = rig or stack.captures[0].rig
        try:
            fused = stack.fuse(weights)
            view = stage_view(
                fused.capture,
                own,
                expected=None if known is None else known.camera.project(world),
                remapping=remapping,
                phase=fused.decode(),
            )
            found.append(view.points(world, k))
        except InputError as problem:
            where = f"{folder}: {problem.where}"
            refused[str(folder)] = InputError(where, problem.expected, problem.got)
        if on_progress:
            on_progress("positions", (k + 1) / len(folders))
    if not found:
        raise next(iter(refused.values()))
    return joined(found), refused


def _near(centres: Array, dots: Array, expected: Array) -> NDArray[np.intp]:
    """Return which of the grid's dots each centre is, -1 for none, by where they are expected."""
    nodes = _nodes(dots)
    dot_at = {node: k for k, node in enumerate(map(tuple, nodes.tolist()))}
    anchor = int(np.nanargmin(np.sum((expected - centres.mean(axis=0)) ** 2, axis=1)))
    index = index_grid(
        centres,
        near=expected[anchor],
        anchor=tuple(nodes[anchor].tolist()),
        column_direction=expected[dot_at[1, 0]] - expected[dot_at[0, 0]],
    )
    which = [dot_at.get((column, row), -1) for column, row in index.indices.tolist()]
    return np.where(index.inlier, which, -1).astype(np.intp)


def _of_a_whole_grid(found: Dots, dots: Array) -> NDArray[np.intp]:
    """Return which of the grid's dots each is, where all of its lattice is in view."""
    nodes = _nodes(dots)
    dot_at = {node: k for k, node in enumerate(map(tuple, nodes.tolist()))}
    # Seen from the front, x to the right: y is up, and v down.
    step = (dots[dot_at[1, 0]] - dots[dot_at[0, 0]])[:2] * (1.0, -1.0)
    index = index_grid(found.centres, column_direction=step)
    seen = index.indices[index.inlier]
    spans, whole = np.ptp(seen, axis=0) + 1, np.ptp(nodes, axis=0) + 1
    if spans.tolist() != whole.tolist():
        raise InputError(
            "dots",
            f"the whole grid in view, {whole[0]} x {whole[1]} places, or where it is expected "
            "(a rig beside the capture, or --rig)",
            f"{spans[0]} x {spans[1]}",
        )
    shifted = index.indices - seen.min(axis=0) + nodes.min(axis=0)
    which = [dot_at.get((column, row), -1) for column, row in shifted.tolist()]
    return np.where(index.inlier, which, -1).astype(np.intp)


def _nodes(dots: Array) -> NDArray[np.int64]:
    """Return column and row, (k, 2), of a grid's dots on the lattice of their shortest steps.

    Where every other place of the rows is empty, the steps are those to the next row's dots:
    right and down, left and down.
    """
    # A tenth of a nanometre apart is rounding.
    column, row = (
        np.unique(np.round(along, 7), return_inverse=True)[1] for along in (dots[:, 0], -dots[:, 1])
    )
    if 2 * len(dots) > (column.max() + 1) * (row.max() + 1):
        return np.column_stack((column, row))
    return np.column_stack(((row + column) // 2, (row - column) // 2))
