"""Captures of a plane at known heights become a look-up table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.calibration.models.height_table import (
    HeightTable,
    Kind,
    fit_height_table,
    plane_coordinates,
)
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.patterns import Axis
from slbench.rig import Rig

Array = NDArray[np.float64]

#: Share of the range of heights by which a rig may see the planes elsewhere.
_ELSEWHERE = 0.05
#: Pixels of a plane that its place is judged by.
_SOME = 2000


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaneTable:
    """A table, and what was found on the way.

    Parameters
    ----------
    table : HeightTable
    answered : float
        Share of the pixels that any plane was seen at for which the table answers.
    wrong : tuple of int
        Pixels of each plane that do not lie on it.
    doubt : str or None
        Why heights and rig may not be of one world.
    """

    table: HeightTable
    answered: float
    wrong: tuple[int, ...]
    doubt: str | None

    __repr__ = brief


def table_of_planes(
    folders: Sequence[str | Path],
    heights_mm: ArrayLike,
    *,
    kind: Kind = "reciprocal",
    axis: Axis | None = None,
    rig: Rig | None = None,
    allow_modules: bool = False,
    allow_outside: bool = False,
    on_progress: Callable[[str, float], None] | None = None,
) -> PlaneTable:
    """Fit a look-up table to captures of a plane.

    Parameters
    ----------
    folders : sequence of path
        Captures, one at each height.
    heights_mm : (m,) float
        World z of the level plane in each.
    kind : {"reciprocal", "linear"}
    axis : {"u", "v"}, optional
        Of the panel; by default the one whose coordinate changes more with height.
    rig : Rig, optional
        Its camera gives x and y; by default that of the first capture.

    Raises
    ------
    InputError
        Naming the folder: no capture, another size or other patterns, no plane; if no rig is
        known, or there are fewer than three heights.
    """
    z = np.asarray(heights_mm, dtype=np.float64)
    maps: dict[Axis, list[Array]] = {}
    wrong, first = [], None
    for k, folder in enumerate(folders):
        capture = Capture.load(folder, allow_modules=allow_modules, allow_outside=allow_outside)
        first = first or capture
        if capture.frames.shape[1:] != first.frames.shape[1:]:
            v, u = first.frames.shape[1:]
            got = f"{capture.frames.shape[2]} x {capture.frames.shape[1]} px"
            raise InputError(folder, f"{u} x {v} px, as the first folder has", got)
        phase = capture.decode()
        if k and set(phase.coordinate) != set(maps):
            expected = f"axes {''.join(maps)} coded, as in the first folder"
            raise InputError(folder, expected, "".join(phase.coordinate))
        lost = 0
        for name, coordinate in phase.coordinate.items():
            if axis in (None, name):
                try:
                    cleaned, off = plane_coordinates(np.where(phase.mask, coordinate, np.nan))
                except InputError as problem:
                    where = f"{folder}: {problem.where}"
                    raise InputError(where, problem.expected, problem.got) from None
                maps.setdefault(name, []).append(cleaned)
                lost = max(lost, off)
        if axis and axis not in maps:
            raise InputError(folder, f"panel axis {axis} coded", "".join(phase.coordinate))
        wrong.append(lost)
        if on_progress:
            on_progress("planes", (k + 1) / len(folders))
    assert first is not None  # there is a folder
    known = rig or first.rig
    if known is None:
        raise InputError(folders[0], "a rig beside the capture, or --rig, for x and y", "none")
    changes: dict[Axis, float] = {name: _change(np.array(of), z) for name, of in maps.items()}
    chosen = max(maps, key=lambda name: changes[name])
    coordinates = np.array(maps[chosen])
    table = fit_height_table(coordinates, z, known.camera, axis=chosen, kind=kind)
    lit = np.isfinite(coordinates).any(axis=0)
    answered = float(table.known.sum()) / max(int(lit.sum()), 1)
    return PlaneTable(
        table=table,
        answered=answered,
        wrong=tuple(wrong),
        doubt=_elsewhere(known, chosen, coordinates, z),
    )


def _change(coordinates: Array, z: Array) -> float:
    """Return by how much a coordinate changes over the heights, in its median pixel."""
    low, high = coordinates[np.argmin(z)], coordinates[np.argmax(z)]
    off = np.abs(high - low)
    return float(np.nanmedian(off)) if np.isfinite(off).any() else 0.0


def _elsewhere(rig: Rig, axis: Axis, coordinates: Array, z: Array) -> str | None:
    """Question heights that the rig, roughly right as it may be, sees far elsewhere."""
    camera, projector = rig.camera, rig.projector
    off = []
    for plane, height in zip(coordinates, z, strict=True):
        v, u = np.nonzero(np.isfinite(plane))
        some = np.linspace(0, len(u) - 1, min(len(u), _SOME)).astype(np.intp)
        pixels = np.column_stack((u[some], v[some])).astype(np.float64)
        origin, direction = camera.unproject(pixels)
        at = origin + ((height - origin[:, 2]) / direction[:, 2])[:, None] * direction
        expected = projector.project(at)[:, "uv".index(axis)]
        off.append(np.nanmedian(np.abs(expected - plane[v[some], u[some]])))
    change = _change(coordinates, z)
    share = float(np.max(off)) / change if change else np.inf
    if share <= _ELSEWHERE:
        return None
    return (
        f"the rig sees planes {100 * share:.0f} % of their range elsewhere: are heights and rig of "
        "one world? x and y are the rig's"
    )
