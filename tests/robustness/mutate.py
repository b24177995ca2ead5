"""Hostile versions of a good file: of its structure, and of its bytes.

Seeded, so that a find stays.

A *mutator* takes a generator and content and returns other content.  Those of structure take what
a TOML or JSON file says (tables, lists, values); those of tables take rows of cells; those of
bytes take anything.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import tomli_w

Random = np.random.Generator

NUMBERS: list[Any] = [
    *(0, -1, 1, 2, 3, 255, 65536, 2**31, 2**31 - 1, -(2**31), 2**32, 2**63, 10**20, 10**400),
    *(0.0, -0.0, 0.5, -1.5, 1e-308, 5e-324, 1e-12, 1e6, 1e12, 1e154, 1e308, -1e308),
    *(float("nan"), float("inf"), float("-inf")),
]
TEXTS: list[Any] = [
    *(
        "",
        " ",
        "a",
        "x" * 5000,
        "../../etc/passwd",
        "/dev/null",
        ".",
        "a\0b",
        "a\nb",
        "Größe\u202e",
    ),
    *("1,2", "NaN", "true", "[red]", "%s%n", "{0}", "🙂", "uv", "1e999", "0x10", "-", "--out"),
]
OTHERS: list[Any] = [True, False, [], {}, [[]], [1, "a"], {"a": 1}, [1] * 3, [0.5] * 100, [None]]


def pick(random: Random, items: list[Any]) -> Any:
    """Return one of the items, a copy."""
    return copy.deepcopy(items[int(random.integers(len(items)))])


def places(content: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value inside tables and lists."""
    if isinstance(content, dict):
        items: Any = content.items()
    else:
        items = enumerate(content[:8]) if isinstance(content, list) else ()
    for key, value in items:
        yield (*at, key)
        yield from places(value, (*at, key))


def structured(random: Random, content: dict[str, Any]) -> dict[str, Any]:
    """Return tables with one or two values changed, removed, moved or doubled."""
    changed = copy.deepcopy(content)
    for _ in range(int(random.integers(1, 3))):
        found = list(places(changed))
        if not found:
            break
        *way, key = found[int(random.integers(len(found)))]
        place: Any = changed
        for part in way:
            place = place[part]
        _change(random, place, key)
    return changed


def _change(random: Random, place: Any, key: Any) -> None:
    value = place[key]
    match int(random.integers(10)):
        case 0:
            del place[key]
        case 1 | 2 | 3:
            place[key] = pick(random, NUMBERS)
        case 4:
            place[key] = pick(random, TEXTS)
        case 5:
            place[key] = pick(random, OTHERS)
        case 6:  # nested, once or often
            for _ in range(int(random.choice([1, 2, 60]))):
                value = [value] if random.random() < 0.5 else {"a": value}
            place[key] = value
        case 7:
            if isinstance(value, list):
                place[key] = value * int(random.choice([0, 2, 50]))
            elif isinstance(value, int | float) and not isinstance(value, bool):
                place[key] = value * float(random.choice([-1.0, 1e-6, 1e3, 1e9, 1e30]))
            else:
                place[key] = str(value)
        case 8:
            if isinstance(place, dict):
                place[pick(random, TEXTS) or "stranger"] = place.pop(key)
            else:
                place.append(pick(random, NUMBERS))
        case _:  # whole for broken, broken for whole, and a number as text
            if value is None or isinstance(value, bool | str | list | dict):
                place[key] = pick(random, NUMBERS)
            else:
                place[key] = pick(random, [float(value), str(value), [value], value + 0.5])


def toml(content: dict[str, Any]) -> bytes:
    """Write what a mutator made as TOML; whole numbers may have any size."""
    return tomli_w.dumps(_without_none(content)).encode("utf-8", "replace")


def as_json(content: dict[str, Any]) -> bytes:
    """Write what a mutator made as JSON, NaN and infinity too."""
    return json.dumps(content).encode()


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _without_none(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_none(item) for item in value if item is not None]
    return value


def cells(random: Random, content: bytes) -> bytes:
    """Return a CSV file with cells, rows or the header changed."""
    rows = [line.split(",") for line in content.decode().splitlines()]
    for _ in range(int(random.integers(1, 3))):
        row = int(random.integers(len(rows))) if rows else 0
        if not rows or not rows[row]:
            break
        column = int(random.integers(len(rows[row])))
        match int(random.integers(8)):
            case 0 | 1 | 2:
                rows[row][column] = str(pick(random, [n for n in NUMBERS if n != 10**400]))
            case 3:
                rows[row][column] = str(pick(random, TEXTS))
            case 4:
                del rows[row][column]
            case 5:
                del rows[row:]
            case 6:
                rows[row] = rows[row] * 2
            case _:
                for other in rows[1:]:
                    if column < len(other):
                        other[column] = rows[row][column]
    return "\n".join(map(",".join, rows)).encode("utf-8", "replace")


def damaged(random: Random, content: bytes) -> bytes:
    """Return bytes flipped, cut, put in, doubled, or dressed as another system's text."""
    changed = bytearray(content)
    size = max(1, len(changed))
    match int(random.integers(11)):
        case 0 | 1 | 2:
            for _ in range(int(random.integers(1, 6))):
                if changed:
                    # The start, where headers are, as often as all the rest.
                    end = min(size, 128) if random.random() < 0.5 else size
                    changed[int(random.integers(end))] = int(random.integers(256))
        case 3:
            del changed[int(random.integers(size)) :]
        case 4:
            at = int(random.integers(size))
            changed[at:at] = random.bytes(int(random.integers(1, 64)))
        case 5:
            at = int(random.integers(size))
            del changed[at : at + int(random.integers(1, 64))]
        case 6:
            changed[:0] = pick(random, [b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff", b"\0", b"\r\n"])
        case 7:
            changed = bytearray(
                bytes(changed).replace(b"\n", pick(random, [b"\r\n", b"\r", b"\0"]))
            )
        case 8:
            at = int(random.integers(size))
            changed[at : at + 4] = pick(random, [b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff"])
        case 9:
            changed = bytearray(changed * int(random.choice([0, 2])))
        case _:
            with_bom = bytes(changed).decode("utf-8", "replace")
            changed = bytearray(with_bom.encode(pick(random, ["utf-16", "utf-8-sig", "utf-32"])))
    return bytes(changed)


Mutator = Callable[[Random], bytes]


def of_tables(content: dict[str, Any], write: Callable[[dict[str, Any]], bytes]) -> Mutator:
    """Return a mutator of a TOML or JSON file: its structure mostly, its bytes sometimes."""

    def mutate(random: Random) -> bytes:
        if random.random() < 0.75:
            return write(structured(random, content))
        return damaged(random, write(content))

    return mutate


def of_cells(content: bytes) -> Mutator:
    """Return a mutator of a CSV file."""

    def mutate(random: Random) -> bytes:
        return cells(random, content) if random.random() < 0.75 else damaged(random, content)

    return mutate


def of_bytes(content: bytes) -> Mutator:
    """Return a mutator of any file."""

    def mutate(random: Random) -> bytes:
        return damaged(random, content)

    return mutate


def of_text(content: str) -> Mutator:
    """Return a mutator of text with numbers in it: YAML, OBJ, the header of a PLY."""
    words = content.split(" ")
    numeric = [k for k, word in enumerate(words) if any(c.isdigit() for c in word)]

    def mutate(random: Random) -> bytes:
        if random.random() < 0.4 or not numeric:
            return damaged(random, content.encode())
        changed = list(words)
        for _ in range(int(random.integers(1, 4))):
            at = pick(random, numeric)
            end = "\n" if changed[at].endswith("\n") else ""
            number = pick(random, [n for n in NUMBERS if n != 10**400])
            changed[at] = str(number) + ("," if "," in changed[at] else "") + end
        return " ".join(changed).encode()

    return mutate
