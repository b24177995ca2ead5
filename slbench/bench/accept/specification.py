"""Files of an acceptance: limits, certificates, and the clouds that real scanners measured.

::

    [mpe]                                   # maximum permissible errors, um; L in mm
    probing_size_um = 20
    sphere_spacing_um = "15 + L/50"

    [standards.ball_bar]
    diameter_mm = 9.6
    spacing_mm = 34.0012                    # as the certificate says
    spacing_U_um = 0.6                      # k = 2
    expansion_per_K = 11.5e-6
    temperature = { celsius = 20.8, u_celsius = 0.2 }
    places = 7                              # of a virtual scanner

    [[place]]                               # of a real one: places.toml in a folder
    standard = "ball_bar"
    clouds = ["bar-1-left.ply", "bar-1-right.ply"]    # one a view
    registered_by = "spheres"

What ``accept`` writes to hold an instrument has the same tables, ``views``, ``registered_by``, what
was rendered (``[standards.KIND.rendered]``: the object's parameters) and ``[[held]]``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from slbench import objects
from slbench.bench.accept.definitions import TESTS, StandardKind
from slbench.bench.accept.evaluate import Place
from slbench.bench.accept.registering import Register
from slbench.bench.accept.standards import Celsius, Expansion, Standard, Temperature
from slbench.bench.accept.verdict import Limit, read_limits
from slbench.core import resources
from slbench.core.errors import InputError, located
from slbench.core.io import read_toml
from slbench.core.registry import quoted
from slbench.core.units import Unit
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Finite, Length, NotNegative, Word
from slbench.core.validation.values import validated
from slbench.rig import Pose
from slbench.rig.pose import checked_rotation

#: What lists the clouds of a folder.
PLACES_FILE = "places.toml"


class _Temperature(Parameters):
    celsius: Celsius
    u_celsius: NotNegative = 0.0


class _Standard(Parameters):
    object: Word | None = None
    diameter_mm: Length | None = None
    spacing_mm: Length | None = None
    size_mm: tuple[Length, Length] | None = None
    diameter_U_um: NotNegative = 0.0
    spacing_U_um: NotNegative = 0.0
    form_U_um: NotNegative = 0.0
    form_um: NotNegative = 0.0
    expansion_per_K: Expansion = 0.0
    u_expansion_per_K: NotNegative = 0.0
    temperature: _Temperature | None = None
    places: Annotated[int, Field(ge=1, le=1000)] | None = None
    rendered: dict[str, Any] | None = None


class _Place(Parameters):
    standard: StandardKind
    name: Word | None = None
    clouds: tuple[Word, ...] = ()
    captures: tuple[Word, ...] = ()
    poses: tuple[tuple[Finite, ...], ...] = ()
    registered_by: Register = "poses"


class _Held(Parameters):
    test: Word
    worst_um: Finite
    u_um: NotNegative


class _File(Parameters):
    name: Word | None = None
    views: Annotated[int, Field(ge=1, le=12)] | None = None
    registered_by: Register | None = None
    mpe: dict[str, Any] = Field(default_factory=dict)
    standards: dict[str, dict[str, Any]] = Field(default_factory=dict)
    rig: Word | None = None
    unit: Unit | None = None
    place: tuple[dict[str, Any], ...] = ()
    held: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True)
class MeasuredPlace:
    """A place of a real scanner: its standard, and a file or folder for each view.

    Parameters
    ----------
    place : Place
        With the standard's poses in the instrument's frame, where views are registered by them.
    files : tuple of path
        Clouds, or folders of captures.
    captured : bool
        Whether they are captures.
    registered_by : {"poses", "spheres"}
    """

    place: Place
    files: tuple[Path, ...]
    captured: bool
    registered_by: Register


@dataclass(frozen=True, kw_only=True)
class Specification:
    """What a file states of an acceptance.

    Parameters
    ----------
    limits : mapping of str to Limit
    standards : mapping of kind to Standard
    counts : mapping of kind to int
        Places of a virtual scanner.
    places : tuple of MeasuredPlace
        Of a real one.
    rig : path or None
        Of a real one's captures.
    unit : str or None
        Of the clouds' lengths.
    held : mapping of str to (float, float)
        The worst error of an earlier acceptance and its own standard uncertainty, mm, by test.
    views : int or None
        Of each place of a virtual scanner.
    register : {"poses", "spheres"} or None
        How they are registered.
    """

    limits: Mapping[str, Limit] = field(default_factory=dict)
    standards: Mapping[StandardKind, Standard] = field(default_factory=dict)
    counts: Mapping[StandardKind, int] = field(default_factory=dict)
    places: tuple[MeasuredPlace, ...] = ()
    rig: Path | None = None
    unit: Unit | None = None
    held: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    views: int | None = None
    register: Register | None = None


def read_specification(path: str | Path) -> Specification:
    """Read limits, certificates and places.

    Parameters
    ----------
    path : path
        TOML; files that it names stand in its folder.

    Raises
    ------
    InputError
        Naming the file, the key, what was expected and what was found.
    """
    path = Path(path)
    file = validated(_File, read_toml(path), path.name, separator=": ")
    standards: dict[StandardKind, Standard] = {}
    counts: dict[StandardKind, int] = {}
    for name, table in file.standards.items():
        where = f"{path.name}: standards"
        kind = _kind(name, where)
        read = validated(_Standard, table, f"{where}.{name}", separator=".")
        standards[kind] = _standard(kind, read, f"{where}.{name}")
        if read.places is not None:
            counts[kind] = read.places
    places = []
    for k, table in enumerate(file.place):
        where = f"{path.name}: place[{k}]"
        place = validated(_Place, table, where, separator=".")
        if place.standard not in standards:
            expected = f"its certificate, a table [standards.{place.standard}]"
            raise InputError(where, expected, "none")
        places.append(_place(place, standards[place.standard], k, path.parent, where))
    held = {}
    for k, table in enumerate(file.held):
        where = f"{path.name}: held[{k}]"
        one = validated(_Held, table, where, separator=".")
        if one.test not in TESTS:
            raise InputError(where, f"one of {', '.join(TESTS)}", quoted(one.test, list(TESTS)))
        held[one.test] = (1e-3 * one.worst_um, 1e-3 * one.u_um)
    rig = None
    if file.rig is not None:
        with located(f"{path.name}: rig"):
            rig = resources.inside(path.parent, file.rig)
    return Specification(
        limits=read_limits(file.mpe, f"{path.name}: mpe"),
        standards=standards,
        counts=counts,
        places=tuple(places),
        rig=rig,
        unit=file.unit,
        held=held,
        views=file.views,
        register=file.registered_by,
    )


def _kind(name: str, where: str) -> StandardKind:
    kinds: dict[str, StandardKind] = {"sphere": "sphere", "ball_bar": "ball_bar", "plane": "plane"}
    if name not in kinds:
        raise InputError(where, f"one of {', '.join(kinds)}", quoted(name, list(kinds)))
    return kinds[name]


def _standard(kind: StandardKind, table: _Standard, where: str) -> Standard:
    """Return a standard; sizes that are not stated are those of the object that is named."""
    stated = table.model_dump(exclude={"object", "temperature", "places", "rendered"})
    rendered: Mapping[str, Any] | None = table.rendered
    if rendered is not None:
        if table.object is not None:
            raise InputError(where, "object or rendered", "both")
        objects.build_artefact(kind, rendered, f"{where}.rendered")
    if table.object is not None:
        with located(f"{where}.object"):
            artefact = objects.load_artefact(table.object)
        if artefact.kind != kind:
            raise InputError(f"{where}.object", f"an object of kind {kind}", artefact.kind)
        rendered = artefact.parameters
        own: dict[str, Any] = {}
        if kind == "plane":
            own["size_mm"] = tuple(rendered["size_mm"])
        else:
            own["diameter_mm"] = 2.0 * artefact.spheres[0].radius_mm
        if kind == "ball_bar":
            own["spacing_mm"] = rendered["spacing_mm"]
        stated |= {key: value for key, value in own.items() if stated[key] is None}
    if table.temperature is not None:
        stated["temperature"] = Temperature(**table.temperature.model_dump())
    with located(where):
        return Standard(kind, rendered=rendered, **stated)


def _place(table: _Place, standard: Standard, k: int, folder: Path, where: str) -> MeasuredPlace:
    if bool(table.clouds) == bool(table.captures):
        got = "both" if table.clouds else "neither"
        raise InputError(where, "clouds or captures, one a view", got)
    key = "clouds" if table.clouds else "captures"
    files = []
    for name in table.clouds or table.captures:
        with located(f"{where}.{key}"):
            files.append(resources.inside(folder, name))
    poses = [_pose(numbers, f"{where}.poses[{n}]") for n, numbers in enumerate(table.poses)]
    needed = len(files) if len(files) > 1 and table.registered_by == "poses" else 0
    if len(poses) != needed:
        expected = f'{needed} poses, one a view, or registered_by = "spheres"' if needed else "none"
        raise InputError(f"{where}.poses", expected, len(poses))
    if len(files) > 1 and table.registered_by == "spheres" and standard.balls < 2:
        expected = "poses of the views, or a standard of two balls"
        raise InputError(f"{where}.registered_by", expected, "spheres")
    name = table.name or f"{table.standard.replace('_', ' ')} {k + 1}"
    return MeasuredPlace(
        Place(name, standard, tuple(poses)), tuple(files), not table.clouds, table.registered_by
    )


def _pose(numbers: tuple[float, ...], where: str) -> Pose:
    if len(numbers) not in (12, 16):
        expected = "12 or 16 numbers, rows of [R t], from the standard to the instrument, mm"
        raise InputError(where, expected, len(numbers))
    matrix = np.array(numbers[:12]).reshape(3, 4)
    return Pose(checked_rotation(matrix[:, :3], where), matrix[:, 3])


def overridden(first: Specification, other: Specification) -> Specification:
    """Return a specification with what another states instead of its own."""
    return replace(
        first,
        limits={**first.limits, **other.limits},
        standards={**first.standards, **other.standards},
        counts={**first.counts, **other.counts},
        views=other.views or first.views,
        register=other.register or first.register,
    )
