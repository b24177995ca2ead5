"""Check the dimensions that a part's file declares against the features that they are of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from slbench.cloud.fits.geometry import Element
from slbench.core.errors import InputError, warn_user
from slbench.core.registry import quoted
from slbench.objects.declared.declare import check_name
from slbench.objects.declared.dimensions import (
    FORMS,
    TYPES,
    ZONES,
    Dimension,
    is_flipped,
    relation_of,
    size_of,
)
from slbench.objects.declared.tables import DimensionTable

#: Without a tolerance, a certified value that is off the mesh by this share of it is questioned.
_OFF = 0.01
#: Facets and files in single precision leave so much of a mesh's own value open, as a share of it.
_ROUNDING = 1e-5


def declare_dimensions(
    tables: Sequence[DimensionTable], features: Mapping[str, Element], where: str
) -> tuple[Dimension, ...]:
    """Check declared dimensions against the features that they are of.

    Parameters
    ----------
    tables : sequence of DimensionTable
    features : mapping of str to Element
        Nominal elements by name.
    where : str
        The file, for messages.

    Raises
    ------
    InputError
        For a type, a feature or a key that cannot be.

    Warns
    -----
    InputWarning
        Where the mesh does not have the certified value within its tolerance.
    """
    names: list[str] = []
    found = []
    for index, table in enumerate(tables):
        place = f"{where}: dimensions[{index}] {table.name!r}"
        check_name(table.name, names, place)
        names.append(table.name)
        found.append(_dimension(table, features, place))
    return tuple(found)


def _dimension(table: DimensionTable, features: Mapping[str, Element], place: str) -> Dimension:
    if table.type not in TYPES:
        raise InputError(f"{place}: type", f"one of {', '.join(TYPES)}", quoted(table.type, TYPES))
    of = (table.of,) if isinstance(table.of, str) else tuple(table.of)
    known = list(features)
    for name in of:
        if name not in features:
            expected = f"one of the features {', '.join(known) or 'that are declared (none)'}"
            raise InputError(f"{place}: of", expected, quoted(name, known))
    if len(set(of)) < len(of):
        raise InputError(f"{place}: of", "different features", list(of))
    elements = [features[name] for name in of]
    _check_kinds(table.type, of, elements, place)
    unit, other = ("deg", "mm") if table.type == "angle" else ("mm", "deg")
    for key in ("value", "tolerance", "uncertainty"):
        if getattr(table, f"{key}_{other}") is not None:
            raise InputError(place, f"{key}_{unit}: {table.type} is in {unit}", f"{key}_{other}")
    value = getattr(table, f"value_{unit}")
    zone = table.type in FORMS or table.type in ZONES
    if zone and value is not None:
        raise InputError(f"{place}: value_mm", f"none: {table.type} is nominally 0", value)
    flipped = is_flipped(table.type, elements, value)
    own = 0.0 if zone else size_of(table.type, elements, flipped)
    lower, upper = _limits(getattr(table, f"tolerance_{unit}"), zone, f"{place}: tolerance_{unit}")
    if value is not None:
        _check_value(value, own, (lower, upper), unit, place)
    return Dimension(
        table.name,
        table.type,
        of,
        own if value is None else value,
        unit,
        lower,
        upper,
        getattr(table, f"uncertainty_{unit}") or 0.0,
        flipped,
    )


def _check_kinds(type_: str, of: tuple[str, ...], elements: Sequence[Element], place: str) -> None:
    if type_ in FORMS:
        takes: tuple[tuple[str, ...], ...] = (FORMS[type_],)
        most = 1
    else:
        relation = relation_of(type_, len(of))
        takes, most = relation.takes, len(relation.takes) - 1 + relation.repeats
    if not len(takes) <= len(of) <= most:
        count = f"{len(takes)} to {most}" if most > len(takes) else f"{len(takes)}"
        raise InputError(f"{place}: of", f"{count} features of {type_}", list(of))
    for position, (name, element) in enumerate(zip(of, elements, strict=True)):
        allowed = takes[min(position, len(takes) - 1)]
        if element.kind not in allowed:
            ordinal = ("first", "second", "third", "fourth")[position]
            expected = f"a {' or '.join(allowed)} as the {ordinal} of {type_}"
            raise InputError(f"{place}: of", expected, f"{name!r}, a {element.kind}")


def _limits(
    given: float | tuple[float, float] | None, zone: bool, place: str
) -> tuple[float | None, float | None]:
    if given is None:
        return None, None
    if isinstance(given, tuple):
        if zone or given[0] > given[1]:
            expected = "the width of the zone" if zone else "the lower limit, then the upper"
            raise InputError(place, expected, list(given))
        return given
    if given < 0.0:
        raise InputError(place, "a number that is not negative, or two limits", given)
    return (None, given) if zone else (-given, given)


def _check_value(
    value: float, own: float, limits: tuple[float | None, float | None], unit: str, place: str
) -> None:
    # Limits are of what a part has less what is certified, and the mesh is a part.
    off, rounding = own - value, _ROUNDING * max(abs(own), 1e-9)
    lower, upper = limits
    if lower is None and upper is None:
        upper = _OFF * max(abs(own), 1e-9)
        lower = -upper
    below = lower is not None and off < lower - rounding
    if below or (upper is not None and off > upper + rounding):
        doubt = (
            f"certified {value:.6g} {unit}, but the mesh has {own:.6g} {unit}: another part, "
            "another unit, or features in another order?"
        )
        warn_user(f"{place}: value_{unit}", doubt, stacklevel=6)
