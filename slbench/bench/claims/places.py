"""Places of a scene's objects in the measurement volume, and claims over them.

The objects of a scene are moved together, as a stage moves them.  Moves are along the axes of the
measurement volume (:attr:`slbench.scene.model.Scene.place`) and turns about its middle; a move of
zero leaves the scene as it is.

*Over places*, repeat by repeat: the worst one, the mean of all, or the one that 95 % of them are
not worse than.  What is worst is told by the claim's bounds: the place with the least margin.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Vector
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.rig import Pose
from slbench.rig.pose import product
from slbench.scene.model import Scene

Array = NDArray[np.float64]
#: What is taken of all places.
Over = Literal["worst", "mean", "p95"]
#: Places that may be planned, and the share of them that ``p95`` is about.
MOST, _SHARE = 1000, 0.95
#: Tag of the random stream of places.
_PLACES = 19


class PlaceTable(Parameters):
    """A place as a table: ``{ move_mm = [x, y, z], turn_deg = [rx, ry, rz] }``."""

    move_mm: Vector = (0.0, 0.0, 0.0)
    turn_deg: tuple[
        Annotated[float, Field(ge=-180.0, le=180.0)],
        Annotated[float, Field(ge=-180.0, le=180.0)],
        Annotated[float, Field(ge=-180.0, le=180.0)],
    ] = (0.0, 0.0, 0.0)


class Displacement(NamedTuple):
    """A move along the axes of the volume, and a turn about its middle as a rotation vector."""

    move_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


#: Given places, how many are to be planned, or a new one for each repeat.
Places = tuple[Displacement, ...] | int | Literal["random"]


def read_places(value: Any, where: str) -> Places:
    """Read ``places``: a number, ``"random"``, or a list of moves or of tables.

    Raises
    ------
    InputError
        For anything else, naming the place.
    """
    if value == "random":
        return "random"
    if isinstance(value, int) and not isinstance(value, bool) and 2 <= value <= MOST:
        return value
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= MOST:
        expected = f'2 to {MOST}, "random", or a list of [x, y, z] / mm or of tables with move_mm'
        raise InputError(where, f"{expected} and turn_deg", shown(value))
    found = []
    for k, one in enumerate(value):
        table = one if isinstance(one, dict) else {"move_mm": one}
        own = validated(PlaceTable, table, f"{where}[{k}]")
        found.append(Displacement(own.move_mm, own.turn_deg))
    if len(set(found)) < len(found):
        raise InputError(where, "each place once", f"{len(found) - len(set(found))} twice")
    return tuple(found)


def planned(scene: Scene, count: int) -> tuple[Displacement, ...]:
    """Return places that fill the volume: its middle, corners, faces, edges, then in between.

    Parameters
    ----------
    scene : Scene
    count : int

    Raises
    ------
    InputError
        If the objects leave no room to move in the volume.
    """
    from scipy.stats import qmc

    low, high = _room(scene)
    corners = sorted(itertools.product((-1, 0, 1), repeat=3), key=_order)
    points = np.array(corners[:count], dtype=np.float64)
    if count > len(corners):
        halton = qmc.Halton(3, scramble=False)
        halton.fast_forward(1)
        points = np.concatenate((points, 2.0 * halton.random(count - len(corners)) - 1.0))
    moves = 0.5 * (low + high) + 0.5 * (high - low) * points
    found = tuple(dict.fromkeys(Displacement(tuple(move)) for move in moves.tolist()))
    if len(found) < count:
        raise InputError(
            f"scene {scene.name}: places",
            f"{count} different ones in the volume of {_words(scene.rig.volume_mm)}",
            f"{len(found)}: the objects leave no room along some axis; list places instead",
        )
    return found


def _order(point: tuple[int, ...]) -> tuple[int, int]:
    """Middle first, then corners, faces and edges; opposite ones follow one another."""
    rank = (0, 2, 3, 1)[sum(map(abs, point))]
    first = next((k for k in point if k), 0)
    other = tuple(first * k for k in point)
    return rank, 2 * sum(3**k * (c + 1) for k, c in enumerate(other)) + (first < 0)


def drawn(scene: Scene, seed: int) -> Displacement:
    """Return a place drawn evenly from those at which the objects are in the volume."""
    low, high = _room(scene)
    move = generator(seed, _PLACES).uniform(low, np.maximum(high, low))
    return Displacement(tuple(move.tolist()))


def placed(scene: Scene, place: Displacement) -> Scene:
    """Return the scene with all objects at a place."""
    from scipy.spatial.transform import Rotation

    volume = scene.place
    turn = Rotation.from_rotvec(place.turn_deg, degrees=True).as_matrix()
    whole = volume.rotation @ turn @ volume.rotation.T
    middle = volume.position + volume.rotation @ np.array(place.move_mm)

    def moved(pose: Pose) -> Pose:
        position = product(pose.position - volume.position, whole.T) + middle
        return Pose(whole @ pose.rotation, position)

    return replace(scene, objects=tuple(replace(o, pose=moved(o.pose)) for o in scene.objects))


def _room(scene: Scene) -> tuple[Array, Array]:
    """Return the least and largest moves at which the objects are in the volume, (3,) each, mm.

    What is as wide as the volume, such as a stage, does not count; where nothing else is there, the
    objects are moved in height alone.
    """
    half = 0.5 * np.array(scene.rig.volume_mm)
    boxes = []
    for item in scene.objects:
        corners = item.pose.to_world(item.artefact.mesh.vertices)
        own = scene.place.to_local(corners)
        if np.all(np.ptp(own[:, :2], axis=0) < 2.0 * half[:2]):
            boxes.append((own.min(axis=0), own.max(axis=0)))
    if not boxes:
        return np.array([0.0, 0.0, -half[2]]), np.array([0.0, 0.0, half[2]])
    low = -half - np.min([box[0] for box in boxes], axis=0)
    high = half - np.max([box[1] for box in boxes], axis=0)
    none = high < low
    return np.where(none, 0.0, low), np.where(none, 0.0, high)


def _words(size: Sequence[float]) -> str:
    return " x ".join(f"{length:g}" for length in size) + " mm"


def over_places(values: Array, margins: Sequence[Array], over: Over) -> tuple[Array, list[Array]]:
    """Return a quantity and its margins over all places, repeat by repeat.

    Parameters
    ----------
    values : (places, n) float
        NaN where it was not measured.
    margins : sequence of (places, n) float
        How far inside each bound.
    over : {"worst", "mean", "p95"}

    Returns
    -------
    values : (n,) float
        At the place that decides; the mean for ``"mean"``.  NaN where any place has none.
    margins : list of (n,) float
    """
    count = len(values)
    if over == "mean":
        return values.mean(axis=0), [margin.mean(axis=0) for margin in margins]
    # The margin that a share of the places reaches: that of a place, not one in between.
    rank = 0 if over == "worst" else int((1.0 - _SHARE) * count + 1e-9)
    lost = ~np.isfinite(values).all(axis=0)
    found = []
    for margin in margins:
        own = np.sort(margin, axis=0)[rank]
        found.append(np.where(lost | ~np.isfinite(margin).all(axis=0), np.nan, own))
    nearest = np.argsort(np.min(margins, axis=0), axis=0)[rank]
    shown_ = np.take_along_axis(values, nearest[np.newaxis], axis=0)[0]
    return np.where(lost, np.nan, shown_), found
