"""Several objects a sample: how many, and how they rest on a table.

``[clutter]`` of a specification draws a number of objects of ``[[objects]]`` and of
``[[distractors]]``.  Each has a *slot*: the first object has none to its name, further ones are
``_1``, ``_2``, ..., distractors ``_d0``, ``_d1``, ...; a slot's columns and random streams end so.

At rest, an object stands on a table in one of the poses in which its centre of mass is above its
support, drawn by the probability that a fall ends there (:mod:`slbench.objects.resting`).  It is
turned at random and set down where it is clear of the others: the convex hulls of their outlines
from above are apart by a gap.  Nothing lies on top of another object.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Coordinate, Measure, NotNegative
from slbench.objects import Artefact, Mesh
from slbench.objects.resting import stable_poses

Array = NDArray[np.float64]

#: Most objects, and most distractors, of a sample; each has columns of its own in the index.
_MOST = 32
#: Places that are tried for an object before there is no room for it.
_PLACES = 200
#: Word of the poses' random stream; no column has it, it is no word.
_REST = 0x5E57

Count = Annotated[int, Field(ge=0, le=_MOST)]
#: Columns that ``[clutter]`` adds for what is drawn.
COUNTS = ("count", "distractors")


class Clutter(Parameters):
    """``[clutter]``: how many objects a sample has and where they are.

    Parameters
    ----------
    count : int or (int, int)
        Objects of ``[[objects]]`` a sample, or the least and the most; each with its own kind.
    distractors : int or (int, int)
        Objects of ``[[distractors]]``, likewise.
    poses : {"resting", "stated"}
        On a table, in stable poses, apart; or as their tables say, whatever they meet.
    area_mm : (float, float), optional
        Of the table, about the origin along x and y, for resting objects as a whole; by default
        the measurement volume's.
    height_mm : float
        Of the table's top, along the world's z.
    gap_mm : float
        Between the hulls of the objects' outlines from above.
    """

    count: Count | tuple[Count, Count] = 1
    distractors: Count | tuple[Count, Count] = 0
    poses: Literal["resting", "stated"] = "resting"
    area_mm: tuple[Measure, Measure] | None = None
    height_mm: Coordinate = 0.0
    gap_mm: NotNegative = 1.0

    @model_validator(mode="after")
    def _in_order(self) -> Clutter:
        for name in COUNTS:
            least, most = self.limits(name)
            if least > most or (name == "count" and least < 1):
                first = "1 or more objects, the" if name == "count" else "the"
                raise ValueError(f"{name} with {first} least number first")
        if self.poses == "stated" and (self.area_mm or self.height_mm):
            raise ValueError("area_mm and height_mm with resting poses only")
        return self

    def limits(self, name: str) -> tuple[int, int]:
        """Return the least and the largest number of ``count`` or ``distractors``."""
        value = getattr(self, name)
        return (value, value) if isinstance(value, int) else value

    def slots(self, counts: tuple[int, int] | None = None) -> Iterator[tuple[str, str]]:
        """Yield the slot of every object of a sample, and the list that it is drawn from.

        Parameters
        ----------
        counts : (int, int), optional
            Objects and distractors; the most that may be drawn if not given.
        """
        objects, distractors = counts or (self.limits("count")[1], self.limits("distractors")[1])
        yield from ((f"_{k}" if k else "", "objects") for k in range(objects))
        yield from ((f"_d{k}", "distractors") for k in range(distractors))


@dataclass(frozen=True)
class Resting:
    """How the first objects of a drawn scene come to rest.

    Parameters
    ----------
    count : int
        How many they are.
    words : tuple of int
        Of the random stream.
    clutter : Clutter
    """

    count: int
    words: tuple[int, ...]
    clutter: Clutter

    def poses(self, artefacts: Sequence[Artefact], area_mm: tuple[float, float]) -> list[Any]:
        """Return ``position_mm`` and ``rotation_deg`` of the objects, keys of their tables.

        Parameters
        ----------
        artefacts : sequence of Artefact
        area_mm : (float, float)
            Where the table states none.

        Raises
        ------
        InputError
            Where there is no room for one, or it has no stable pose.
        """
        from scipy.spatial.transform import Rotation

        width, height = self.clutter.area_mm or area_mm
        taken: list[Any] = []
        found = []
        for k, artefact in enumerate(artefacts):
            rng = generator(*self.words, _REST, k)
            turn = _turned(artefact, rng)
            corners = _hull(artefact.mesh) @ turn.T
            low = corners.min(axis=0)
            outline = _outline(corners)
            left, down, right, up = outline.bounds
            room = width - (right - left), height - (up - down)
            # All numbers of a place are drawn, whether they are used or not.
            places = rng.random((_PLACES, 2))
            shift = None if min(room) < 0.0 else self._free(outline, room, places, taken)
            if shift is None:
                expected = f"room on {width:g} x {height:g} mm for object {k + 1} of {self.count}"
                got = f"{right - left:.4g} x {up - down:.4g} mm ({artefact.name})"
                raise InputError("clutter", expected, got)
            taken.append(_moved(outline, shift))
            with warnings.catch_warnings():  # a turn by 90 degrees is as good as any
                warnings.simplefilter("ignore", UserWarning)
                angles = Rotation.from_matrix(turn).as_euler("XYZ", degrees=True)
            position = [*shift, self.clutter.height_mm - float(low[2])]
            found.append({"position_mm": position, "rotation_deg": angles.tolist()})
        return found

    def _free(
        self, outline: Any, room: tuple[float, float], places: Array, taken: Sequence[Any]
    ) -> tuple[float, float] | None:
        """Return the first place at which an outline is clear of others; None where none is."""
        left, down, right, up = outline.bounds
        middle = (0.5 * (left + right), 0.5 * (down + up))
        for u, v in places:
            x, y = (u - 0.5) * room[0] - middle[0], (v - 0.5) * room[1] - middle[1]
            here = _moved(outline, (x, y))
            if all(here.distance(other) > self.clutter.gap_mm for other in taken):
                return float(x), float(y)
        return None


def _turned(artefact: Artefact, rng: np.random.Generator) -> Array:
    """Return the rotation of a stable pose, drawn by its probability, and of a turn, (3, 3)."""
    rotations, shares = stable_poses(artefact.mesh)
    edges = np.cumsum(shares)
    if not len(edges):
        raise InputError("clutter", "a shape that stands on a table", artefact.name)
    which = int(np.searchsorted(edges, rng.random() * edges[-1], side="right"))
    angle = 2.0 * np.pi * rng.random()
    c, s = np.cos(angle), np.sin(angle)
    about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about @ rotations[min(which, len(edges) - 1)])


@lru_cache(maxsize=64)
def _hull(mesh: Mesh) -> Array:
    """Return the corners of a mesh's convex hull, (n, 3)."""
    return np.asarray(mesh.as_trimesh.convex_hull.vertices, dtype=np.float64)


def _outline(corners: Array) -> Any:
    """Return the convex hull of points (n, 3) from above."""
    import shapely

    return shapely.MultiPoint(corners[:, :2]).convex_hull


def _moved(outline: Any, shift: tuple[float, float]) -> Any:
    import shapely.affinity

    return shapely.affinity.translate(outline, *shift)
