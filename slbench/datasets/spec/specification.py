"""Specifications of data sets: TOML files that say what is drawn.

A specification holds a scene in which a distribution may stand for any value, the objects of
which one is drawn, the patterns whose frames are rendered, and what a draw must meet::

    name = "blocks"
    licence = "CC0-1.0"

    [scene]                       # as a scene file
    extends = "hardware/macro-ch6"
    [scene.exposure]
    white_level = { uniform = [0.5, 0.9] }
    [scene.rig]
    alpha_p_deg = { normal = [0.0, 0.1], add = true }    # around the base's

    [[objects]]                   # as an object of a scene, with a name and a weight
    name = "block"
    weight = 2
    kind = "step_block"
    [objects.parameters]
    heights_mm = [{ uniform = [1.0, 5.0] }]
    step_length_mm = 10.0
    width_mm = 20.0

    [[patterns]]                  # none: light transport alone
    sequence = "1,10,50"          # or "mine.toml", "pictures", "mine.py:SET"
    repeats = 2

    [constraints]
    inside_volume = true
    min_lit_share = 0.05

Several objects a sample, and what stands beside them::

    [clutter]                     # without: one object, where its table says
    count = [1, 5]
    distractors = [0, 2]
    height_mm = -8.0              # of the table on which they rest

    [[distractors]]               # as [[objects]]: drawn, but not of interest
    kind = "sphere"
    ...
    [materials.paint]             # drawn anew for each object that takes it
    bsdf = "principled"
    roughness = { uniform = [0.2, 0.6] }

``modules = ["my_parts.py"]`` at its top names Python files beside it that add to the registries
(:mod:`slbench.core.modules`).

:func:`load` resolves everything that stands in other files, so that what a data set keeps
(in ``dataset.json``, and meshes in ``files/``) is complete.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import plain, read_toml
from slbench.core.modules import load_modules
from slbench.core.registry import quoted
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Share
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.datasets.spec.clutter import COUNTS, Clutter
from slbench.datasets.spec.distributions import (
    Distribution,
    column,
    find,
    get,
    is_distribution,
    put,
    written,
)
from slbench.datasets.spec.distributions import Path as Place
from slbench.datasets.spec.embedded import (
    content_of,
    embedded,
    embedded_map,
    embedded_module,
    embedded_pictures,
    file_names,
    map_names,
    picture_names,
)
from slbench.datasets.spec.patterns import Patterns, resolved
from slbench.datasets.store.index import columns
from slbench.datasets.store.sample import EXACT_BITS, RIG, capture_prefix
from slbench.objects.registry import artefacts
from slbench.scene.file import extended
from slbench.scene.tables import ObjectTable

Count = Annotated[int, Field(ge=1, le=1_000_000)]

#: Keys of a drawn object that are not those of an object in a scene.
_OWN = ("name", "weight")
_SHIPPED = "datasets"
#: Tables of a scene that are looked into before it is loaded.
_TABLES = ("rig", "camera", "render", "preview", "environment")


class Constraints(Parameters):
    """What a draw must meet, or it is drawn again, at most `max_draws` times.

    Parameters
    ----------
    inside_volume : bool
        The drawn objects lie in the measurement volume, distractors left out.
    min_lit_share : float
        Share of the camera's pixels that see drawn objects lit; one pixel at least.
    max_draws : int
    """

    inside_volume: bool = False
    min_lit_share: Share = 0.0
    max_draws: Annotated[int, Field(ge=1, le=10_000)] = 100


class Specification(Parameters):
    """A specification, as read or resolved.

    Parameters
    ----------
    name, description, licence : str
    scene : dict
        Content of a scene file; its objects stand beside the drawn one, after it.
    objects : tuple of dict
        Of which one is drawn a sample: keys of an object in a scene, ``name``, ``weight``.
        Without any, the first of the scene's own is the sample's object.
    patterns : tuple of Patterns
        Whose frames are rendered; the index is the p of ``p0r0``.
    constraints : Constraints
    marginals : tuple of {"u", "v", "uv"}, optional
        Of the light transport; by default the axes that the patterns code.
    weight_bits : int
        Bits of mantissa that the transport's weights keep; 23 are all.
    samples_per_shard : int
    modules : tuple of str, optional
        Python files beside the specification; resolved, their names among the files of the
        data set, those of scenes that are extended included.
    clutter : Clutter, optional
        How many objects and distractors a sample has; without, one object.
    distractors : tuple of dict, optional
        Objects that are drawn besides and are not of interest.
    materials : dict, optional
        Materials by name, whose distributions are drawn for each object that takes one.
    instances : bool, optional
        Whether samples have an instance mask as a picture; they have with clutter.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=60)]
    description: str = ""
    licence: Annotated[str, Field(min_length=1)] = "not stated"
    scene: dict[str, Any]
    objects: tuple[dict[str, Any], ...] = ()
    patterns: tuple[Patterns, ...] = ()
    constraints: Constraints = Constraints()
    marginals: tuple[Literal["u", "v", "uv"], ...] | None = None
    weight_bits: Annotated[int, Field(ge=1, le=EXACT_BITS)] = EXACT_BITS
    samples_per_shard: Count = 64
    modules: tuple[str, ...] | None = None
    # What older specifications do not have is None, which no manifest holds.
    clutter: Clutter | None = None
    distractors: tuple[dict[str, Any], ...] | None = None
    materials: dict[str, dict[str, Any]] | None = None
    instances: bool | None = None

    @model_validator(mode="after")
    def _cluttered(self) -> Specification:
        if self.clutter is not None and not self.objects:
            raise ValueError("[[objects]] beside clutter")
        most = 0 if self.clutter is None else self.clutter.limits("distractors")[1]
        if bool(most) != bool(self.distractors):
            raise ValueError("[[distractors]] beside clutter.distractors, and the other way round")
        return self

    @model_validator(mode="after")
    def _distinct(self) -> Specification:
        if self.marginals is not None and len(set(self.marginals)) != max(1, len(self.marginals)):
            raise ValueError("marginals, each once")
        return self

    @property
    def has_instances(self) -> bool:
        """Whether samples have an instance mask as a picture."""
        return self.clutter is not None if self.instances is None else self.instances

    def drawn_from(self, which: str) -> tuple[dict[str, Any], ...]:
        """Return the tables of ``objects`` or of ``distractors``."""
        return self.objects if which == "objects" else self.distractors or ()

    def distributions(self) -> Iterator[tuple[Place, Distribution]]:
        """Yield every distribution; its place starts with its table and, in lists, an index."""
        yield from find(self.scene, self.name, ("scene",))
        yield from find(self.objects, self.name, ("objects",))
        yield from find(self.distractors or (), self.name, ("distractors",))
        yield from find(self.materials or {}, self.name, ("materials",))

    def columns_drawn(self) -> Iterator[tuple[str, Any, Place, Distribution]]:
        """Yield the column of every distribution in every slot, and what it belongs to.

        What a column belongs to is None for the scene, else slot, table and which of the table;
        of one slot and table, those of different objects or materials exclude each other.
        """
        known = [(place, one, column(place, one)) for place, one in self.distributions()]
        for place, one, name in known:
            if place[0] == "scene":
                yield name, None, place, one
        slots = [("", "objects")] if self.clutter is None else self.clutter.slots()
        for slot, which in slots:
            for place, one, name in known:
                if place[0] in (which, "materials"):
                    yield name + slot, (slot, place[0], place[1]), place, one

    def drawn_columns(self) -> dict[str, str]:
        """Return the index column of each distribution and its type.

        Raises
        ------
        InputError
            If two that can be drawn together share a name, or two of a name differ in type.
        """
        types: dict[str, str] = {}
        if self.clutter is not None:
            types = dict.fromkeys(COUNTS, "int64")
            types |= {f"kind{slot}": "string" for slot, _ in self.clutter.slots() if slot}
        owners: dict[str, set[Any]] = {name: {None} for name in types}
        for name, owner, place, distribution in self.columns_drawn():
            # Objects exclude each other: what two of them have is one column.
            others = owners.setdefault(name, set())
            alike = owner is not None and all(o is not None and o[:2] == owner[:2] for o in others)
            if owner in others or (others and not alike):
                where = f"{self.name}: {written(place)}"
                raise InputError(where, f"a name other than {name} (name = ...)", "a second one")
            others.add(owner)
            kind = distribution.type
            before = types.setdefault(name, kind)
            if before != kind:
                if "string" in (before, kind):
                    raise InputError(f"{self.name}: {written(place)}", f"{before}, as before", kind)
                types[name] = "double"
        return types

    def prefixes(self) -> list[tuple[str, Patterns]]:
        """Return the prefix of every capture and its patterns."""
        return [
            (capture_prefix(k, repeat), patterns)
            for k, patterns in enumerate(self.patterns)
            for repeat in range(patterns.repeats)
        ]

    def columns(self) -> dict[str, str]:
        """Return all columns of the index and their types."""
        return columns(self.drawn_columns(), [prefix for prefix, _ in self.prefixes()])

    def files(self) -> set[str]:
        """Return the names of the files that the resolved specification refers to."""
        names = {RIG} if self.scene.get("rig", {}).get("file") else set()
        names.update(self.modules or ())
        for patterns in self.patterns:
            names.update(patterns.files or ())
        tables = (*self.objects, *(self.distractors or ()), *self.scene.get("objects", ()))
        for table in tables:
            names.update(file_names(table))
        names.update(picture_names(self.scene.get("materials", {})))
        names.update(picture_names(self.materials or {}))
        names.update(map_names(self.scene.get("environment", {})))
        return names


def load(
    name_or_path: str | Path, *, allow_modules: bool = False
) -> tuple[Specification, dict[str, bytes]]:
    """Load a specification and everything that it refers to.

    Parameters
    ----------
    name_or_path : str or Path
        A file, or the name of a shipped one such as ``"mixed"``.
    allow_modules : bool
        Run the Python modules that it and its scenes name, here and in the workers that make
        the data set: code of their authors.

    Returns
    -------
    specification : Specification
        Complete: no ``extends``, no file but those of the second value.
    files : dict of str to bytes
        Meshes, modules, and the rig where the scene reads one.

    Raises
    ------
    InputError
        Naming the file and the first key that cannot be used.
    """
    path = _find(name_or_path)
    content = read_toml(path)
    for key in ("scene", "objects", "distractors", "materials"):
        # Ahead of the model, which cannot look into what it does not know.
        list(find(content.get(key, {}), path.name, (key,)))
    read = validated(Specification, content, path.name, separator=": ")
    files: dict[str, bytes] = {}
    own = plain(read.scene)
    ran = load_modules(read.modules or (), path.parent, allow_modules, f"{path.name}: modules")
    scene = extended(own, path, allow_modules)
    if "extends" in own:
        base = extended({"extends": own["extends"]}, path, allow_modules)
        _with_bases(scene, base, f"{path.name}: scene")
    modules = [embedded_module(module, files) for module in (*scene.pop("modules", ()), *ran)]
    if "focus" in scene:
        expected = "no focus settings (a sample has one light transport)"
        raise InputError(f"{path.name}: scene.focus", expected, "some")
    exposure = scene.get("exposure")
    several = {"exposures_ms", "bracket"} & set(exposure if isinstance(exposure, dict) else ())
    if several:
        where = f"{path.name}: scene.exposure.{min(several)}"
        raise InputError(where, "one exposure (a sample has one a picture)", "several")
    if "colour" in scene:
        expected = "no colour (a sample has the light transport of one band)"
        raise InputError(f"{path.name}: scene.colour", expected, "some")
    for key in ("rig", "model", "covariance"):
        if key in scene.get("calibration", {}):
            expected = "std alone (a sample holds no file of another calibration)"
            raise InputError(f"{path.name}: scene.calibration.{key}", expected, key)
    _check_tables(scene, f"{path.name}: scene")
    rig_file = scene["rig"].get("file")
    if rig_file is not None:
        files[RIG] = content_of(path, rig_file, "scene.rig.file")
        scene["rig"] = {**scene["rig"], "file": RIG}
    if isinstance(scene.get("materials"), dict):
        materials = scene["materials"]
        scene["materials"] = embedded_pictures(materials, path, "scene.materials", files)
    if "environment" in scene:
        scene["environment"] = embedded_map(scene["environment"], path, files)
    if "objects" in scene:
        scene["objects"] = [
            embedded(table, path, f"scene.objects[{k}]", files)
            for k, table in enumerate(_tables(scene["objects"], f"{path.name}: scene.objects"))
        ]
    resting = read.clutter is not None and read.clutter.poses == "resting"
    objects = _drawn_objects(read.objects, path, "objects", files, resting)
    cluttering: dict[str, Any] = {}
    if read.distractors is not None:
        tables = _drawn_objects(read.distractors, path, "distractors", files, resting)
        cluttering["distractors"] = tables
    if read.materials is not None:
        given = embedded_pictures(plain(read.materials), path, "materials", files)
        cluttering["materials"] = given
    sets, needed = [], []
    for k, patterns in enumerate(read.patterns):
        one, along, own_modules = resolved(
            *(patterns, k, content["patterns"][k], scene, path, files, allow_modules)
        )
        sets.append(one.model_dump(exclude_none=True))
        needed.append(along)
        modules += own_modules
    values = read.model_dump() | {"scene": scene, "objects": objects, "patterns": sets}
    values |= cluttering
    values["modules"] = list(dict.fromkeys(modules)) or None
    complete = validated(Specification, values, path.name, separator=": ")
    if not objects and not scene.get("objects"):
        raise InputError(f"{path.name}: objects", "one object at least", "none")
    for place, distribution in complete.distributions():
        if distribution.add and distribution.base is None:
            where = f"{path.name}: {written(place)}"
            raise InputError(where, "base = ..., to add to", "none")
    complete.columns()
    _check_marginals(complete, needed, path.name)
    return complete, files


def _check_tables(scene: Mapping[str, Any], where: str) -> None:
    """Refuse a scene without a rig, or something else in the place of a table."""
    if "rig" not in scene:
        raise InputError(f"{where}.rig", "a table, here or in a scene that it extends", "none")
    for key in _TABLES:
        table = scene.get(key, {})
        if not isinstance(table, dict) or is_distribution(table):
            raise InputError(f"{where}.{key}", "a table", shown(table))


def _check_marginals(
    specification: Specification, needed: Sequence[Sequence[str]], where: str
) -> None:
    """Refuse patterns that could not be exposed from the marginals that are kept."""
    kept = specification.marginals
    for k, along in enumerate(needed):
        for one in along:
            if kept and one not in kept:
                expected = f"{one!r} too, which patterns[{k}] code"
                raise InputError(f"{where}: marginals", expected, ", ".join(kept))


def from_dict(values: Mapping[str, Any], where: str) -> Specification:
    """Return the specification that a data set holds in ``dataset.json``."""
    return validated(Specification, values, where)


def _find(name_or_path: str | Path) -> Path:
    if Path(name_or_path).is_file():
        return Path(name_or_path)
    try:
        return resources.find("scenes", f"{_SHIPPED}/{name_or_path}")
    except InputError:
        known = shipped()
        expected = f"a path to a file or one of {', '.join(known)}"
        raise InputError("specification", expected, quoted(str(name_or_path), known)) from None


def shipped() -> list[str]:
    """Return the names of the shipped specifications."""
    folder = resources.find("scenes", resources.names("scenes")[0]).parent / _SHIPPED
    return sorted(path.stem for path in folder.glob("*.toml"))


def _drawn_objects(
    tables: Sequence[dict[str, Any]],
    path: Path,
    where: str,
    files: dict[str, bytes],
    resting: bool,
) -> list[dict[str, Any]]:
    """Return objects to draw from, checked, their files embedded."""
    found = []
    for k, table in enumerate(tables):
        found.append(_object(plain(table), path, f"{where}[{k}]", files))
        for key in ("position_mm", "rotation_deg"):
            if resting and key in table:
                expected = 'none of an object that rests on the table (clutter.poses = "stated")'
                raise InputError(f"{path.name}: {where}[{k}].{key}", expected, shown(table[key]))
    names = [table["name"] for table in found]
    if len(set(names)) != len(names):
        raise InputError(f"{path.name}: {where}", "a name of its own for each", names)
    return found


def _object(
    table: dict[str, Any], path: Path, where: str, files: dict[str, bytes]
) -> dict[str, Any]:
    """Return a drawn object with its name and weight, checked, its files embedded."""
    keys = [*_OWN, *ObjectTable.model_fields]
    for key in table:
        if key not in keys:
            expected = f"one of the keys {', '.join(keys)}"
            raise InputError(f"{path.name}: {where}", expected, quoted(key, keys))
    weight = table.get("weight", 1.0)
    if type(weight) not in (int, float) or not 0.0 < weight < float("inf"):
        raise InputError(f"{path.name}: {where}.weight", "a positive number", repr(weight))
    kind = table.get("kind")
    if kind is not None and not isinstance(kind, str):
        expected = "the name of one (to draw from several: a table [[objects]] for each)"
        raise InputError(f"{path.name}: {where}.kind", expected, shown(kind))
    default = next((table[way] for way in ("kind", "artefact", "mesh") if way in table), None)
    name = table.get("name", default)
    if not isinstance(name, str) or not name:
        raise InputError(f"{path.name}: {where}.name", "a name", repr(name))
    inner = {key: value for key, value in table.items() if key not in _OWN}
    complete = embedded(inner, path, where, files)
    kind = complete.get("kind")
    if kind is not None:
        known = artefacts.get(kind, f"{path.name}: {where}.kind").parameters.model_fields
        parameters = complete.get("parameters", {})
        if not isinstance(parameters, dict) or is_distribution(parameters):
            expected = f"a table with {', '.join(known)}"
            raise InputError(f"{path.name}: {where}.parameters", expected, shown(parameters))
        for key in parameters:
            if key not in known:
                at = f"{path.name}: {where}.parameters"
                raise InputError(
                    at, f"one of the keys {', '.join(known)}", quoted(key, list(known))
                )
    return {"name": name, "weight": weight, **complete}


def _tables(value: Any, where: str) -> list[dict[str, Any]]:
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise InputError(where, "tables", repr(value)[:60])
    return value


def _with_bases(scene: dict[str, Any], base: dict[str, Any], where: str) -> None:
    """Put the base scene's numbers where jitters are added to them, in place."""
    for place, distribution in list(find(scene, where)):
        if not distribution.add or distribution.base is not None:
            continue
        number = get(base, place)
        if type(number) not in (int, float):
            expected = "a number in the scene that it extends, to add to (or base = ...)"
            raise InputError(f"{where}.{written(place)}", expected, repr(number))
        put(scene, place, {**get(scene, place), "base": number})
