"""A report as one HTML page that needs nothing else: no network, no files beside it.

Everything that comes from a scene (titles, cells, captions, provenance) is text: the template
escapes it, data for the view are JSON in which ``<`` is written as an escape, and a content
security policy lets no script run but the page's own, named by their hashes, and no address be
asked for.  The library that draws clouds is put in compressed, and only where there is one.
"""

from __future__ import annotations

import base64
import functools
import gzip
import hashlib
import itertools
import json
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from slbench.core.errors import InputError
from slbench.core.io import plain
from slbench.core.io.atomic import check_output_file, write_bytes
from slbench.core.show.document import Cloud, Page, Part, Picture, Table, Text, shown
from slbench.report.cloud import cloud_view

_PNG = b"\x89PNG\r\n\x1a\n"
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|inf)(e[+-]?\d+)?")
#: Pictures that have more pixels across, px, stand alone: half a page would make their text small.
_WIDE = 640
#: Keys of the provenance that are shown first, and how they are called.
_FACTS = {
    "slbench": "slbench",
    "commit": "commit",
    "seed": "seed",
    "python": "Python",
    "platform": "platform",
}
#: Keys of the provenance that are no facts themselves; equal results have equal pages.
_APART = {"libraries", "parameters", "extensions", "time_utc"}


def write_page(page: Page, path: str | Path) -> None:
    """Write a report as one HTML file.

    Parameters
    ----------
    page : Page
    path : path
        Ends in ``.html``; its folder is made if need be.

    Raises
    ------
    InputError
        If the path is no such file's, or the page cannot be written.
    """
    check_page_path(path, "report")
    write_bytes(path, render_page(page).encode())


def check_page_path(path: str | Path, where: str = "--report") -> None:
    """Refuse a path that no report can be written to, before the work for it is done.

    Parameters
    ----------
    path : path
    where : str
        What to call it in the error.

    Raises
    ------
    InputError
        If it does not end in ``.html``, is a folder, or cannot be written.
    """
    check_output_file(path, (".html",), where)


def render_page(page: Page) -> str:
    """Return a report as HTML.

    Parameters
    ----------
    page : Page

    Returns
    -------
    str
        A whole document.  Without clouds it is the pictures and tables and some 15 kB; the
        first cloud adds 2 MB, and every cloud up to 2 MB of points.

    Raises
    ------
    InputError
        If a picture is no PNG.
    """
    blocks = list(_blocks(page.parts))
    clouds = any(block["kind"] == "cloud" and block["view"].shown for block in blocks)
    script = _source("cloud.js") if clouds else ""
    style = _source("style.css")
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            page=page,
            blocks=blocks,
            contents=[item for block in blocks for item in block["contents"]],
            facts=_facts(page.provenance),
            libraries=_libraries(page.provenance),
            parameters=_parameters(page.provenance),
            policy=_policy(style, script),
            style=Markup(style),
            script=Markup(script),
            library=Markup(_library()[0] if clouds else ""),
        )
    )


def _blocks(parts: Sequence[Part]) -> Iterator[dict[str, Any]]:
    """Give every part its place; pictures in a row stand side by side where there is room."""
    numbered = enumerate(parts, start=1)
    for pictures, group in itertools.groupby(numbered, lambda item: isinstance(item[1], Picture)):
        members = [(f"part-{k}", part) for k, part in group]
        if pictures:
            yield {
                "kind": "gallery",
                "pictures": [_image(part) | {"id": k, "part": part} for k, part in members],  # type: ignore[arg-type]
                "contents": [(k, part.title) for k, part in members],
            }
            continue
        for k, part in members:
            yield _block(part) | {"id": k, "part": part, "contents": [(k, part.title)]}


def _block(part: Part) -> dict[str, Any]:
    if isinstance(part, Table):
        rows = part.texts()
        # A unit stays with its slash where a heading is broken.
        headings = [heading.replace(" / ", " /\N{NO-BREAK SPACE}") for heading in part.columns]
        return {"kind": "table", "numeric": _numeric(rows), "rows": rows, "headings": headings}
    if isinstance(part, Text):
        return {"kind": "text", "paragraphs": [p for p in part.text.split("\n\n") if p.strip()]}
    assert isinstance(part, Cloud)
    view = cloud_view(part)
    still = None if view.still is None else _image(view.still)
    return {"kind": "cloud", "view": view, "data": script_json(view.data), "still": still}


def _numeric(rows: Sequence[Sequence[str]]) -> list[bool]:
    """Return a flag for each column: whether its cells are numbers, to be set flush right."""
    return [
        all(_NUMBER.fullmatch(cell) or cell in ("", "–") for cell in column)
        for column in zip(*rows, strict=True)
    ]


def _image(picture: Picture) -> dict[str, Any]:
    """Return a picture as a data URI, with its size so that the page does not jump."""
    if picture.png[:8] != _PNG or len(picture.png) < 24:
        raise InputError(f"picture {picture.title}", "a PNG", f"{len(picture.png)} other bytes")
    width, height = struct.unpack(">II", picture.png[16:24])
    return {
        "source": "data:image/png;base64," + base64.b64encode(picture.png).decode("ascii"),
        "width": width,
        "height": height,
        "wide": width > _WIDE,
        "alternative": picture.caption or picture.title,
    }


def script_json(values: Any) -> Markup:
    """Return JSON that may stand in a script element: no text can end the element.

    ``<``, ``>`` and ``&``, which JSON has in strings alone, are written as escapes.
    """
    text = json.dumps(plain(values), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _facts(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the short facts of a provenance: those known in their order, then others.

    Packages and modules beside slbench are named where there are any.
    """
    extensions: Mapping[str, Any] = provenance.get("extensions", {})
    beside = {key: value for key, value in extensions.items() if value}
    facts = {key: value for key, value in provenance.items() if key not in _APART} | beside
    keys = [key for key in _FACTS if key in facts] + sorted(set(facts) - set(_FACTS))
    return [(_FACTS.get(key, key), _fact(facts[key])) for key in keys]


def _fact(value: Any) -> str:
    if isinstance(value, Mapping | list | tuple):
        return json.dumps(plain(value), ensure_ascii=False)
    return shown(plain(value))


def _libraries(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(name, shown(v)) for name, v in dict(provenance.get("libraries", {})).items()]


def _parameters(provenance: Mapping[str, Any]) -> str:
    if "parameters" not in provenance:
        return ""
    return json.dumps(plain(provenance["parameters"]), indent=2, ensure_ascii=False)


def _policy(style: str, script: str) -> str:
    """Return the content security policy: nothing but what is in the page."""
    rules = ["default-src 'none'", "base-uri 'none'", "form-action 'none'", "img-src data:"]
    if script:
        # The library makes style elements of its own while it runs.
        rules.append("style-src 'unsafe-inline'")
        rules.append(f"script-src 'sha256-{_sha256(script)}' 'sha256-{_library()[1]}'")
    else:
        rules.append(f"style-src 'sha256-{_sha256(style)}'")
    return "; ".join(rules)


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


@functools.cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("slbench.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@functools.cache
def _source(name: str) -> str:
    return (files("slbench.report") / "templates" / name).read_text(encoding="utf-8")


@functools.cache
def _library() -> tuple[str, str]:
    """Return the plotting library, compressed and in base64, and the hash of its source."""
    from plotly.offline import get_plotlyjs

    source = get_plotlyjs()
    # A time of zero: the same library gives the same page.
    packed = gzip.compress(source.encode(), mtime=0)
    return base64.b64encode(packed).decode("ascii"), _sha256(source)
