"""Pages for the report's tests, and a strict reader of their HTML."""

import base64
import re
from html.parser import HTMLParser

import cv2
import numpy as np

from slbench.core.io import provenance
from slbench.core.show.document import Cloud, Page, Picture, Table, Text

#: Would run, were it taken for HTML anywhere.
ATTACK = "<img src=x onerror='window.pwned=1'></script><script>window.pwned=1</script>&amp;\"$b$"

VOID = {"meta", "img", "input", "link", "br", "hr", "base", "col"}


def cloud(count: int = 1500, title: str = "Cloud", name: str = "error / µm") -> Cloud:
    """Return a wavy sheet of 20 mm x 20 mm with errors of both signs and some without."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-10.0, 10.0, (2, count))
    z = 2.0 * np.sin(x / 3.0)
    error = rng.normal(0.0, 0.01, count)
    values = {name: 1e3 * error, "σ / µm": 8.0 + np.abs(y)}
    values[name][:7] = np.nan
    points = np.column_stack((x, y, z + error))
    return Cloud(title, points, values, np.column_stack((x, y, z)), "A wavy sheet.")


def picture(width: int = 900, height: int = 300, title: str = "Ramp", caption: str = "A ramp."):
    """Return a grey ramp."""
    ramp = np.broadcast_to(np.linspace(0, 255, width).astype(np.uint8), (height, width))
    return Picture(title, cv2.imencode(".png", ramp)[1].tobytes(), caption)


def table(title: str = "Numbers", columns: int = 3) -> Table:
    """Return a table with texts, numbers and nothing."""
    names = tuple(f"column {k}" for k in range(columns))
    rows = (("a", *([1.23456] * (columns - 1))), ("b", *([None] * (columns - 1))))
    return Table(title, names, rows, "A note.")


def plain_page() -> Page:
    """Return a page without a cloud, as wide as pages get."""
    words = Text("Words", "One paragraph.\n\n" + "Antidisestablishmentarianism" * 12)
    parts = (table(), words, picture(), table("Wide", 24))
    return Page("Plain", parts, provenance({"scene": {"name": "x" * 400}}, 3))


def attacked_page() -> Page:
    """Return a page with :data:`ATTACK` wherever text may come from a scene."""
    parts = (
        Table(ATTACK, (ATTACK, "n"), ((ATTACK, 1),), ATTACK),
        Text(ATTACK, ATTACK),
        picture(title=ATTACK, caption=ATTACK),
        cloud(title=ATTACK, name=f"{ATTACK} / {ATTACK}"),
    )
    return Page(ATTACK, parts, {"slbench": "1", "parameters": {ATTACK: ATTACK}, ATTACK: ATTACK})


class Document(HTMLParser):
    """An HTML document, refused where elements do not nest.

    Attributes
    ----------
    tags : list of (str, dict)
        Elements in their order, with their attributes.
    raw : list of (dict, str)
        Script elements: attributes and content.
    text : str
        All text outside of script and style.
    """

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict]] = []
        self.raw: list[tuple[dict, str]] = []
        self.style = ""
        self.text = ""
        self._open: list[str] = []
        self._data: list[str] = []
        assert source.startswith("<!DOCTYPE html>\n")
        self.feed(source)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attributes: list) -> None:
        names = [name for name, _ in attributes]
        assert len(names) == len(set(names)), f"<{tag}> has an attribute twice"
        self.tags.append((tag, dict(attributes)))
        self._data = []
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open, f"</{tag}> closes nothing"
        assert self._open[-1] == tag, f"</{tag}> closes <{self._open[-1]}>"
        self._open.pop()
        if tag == "script":
            self.raw.append((self.tags[-1][1], "".join(self._data)))
        if tag == "style":
            self.style = "".join(self._data)

    def handle_data(self, data: str) -> None:
        self._data.append(data)
        if not self._open or self._open[-1] not in ("script", "style"):
            self.text += data

    def all(self, tag: str) -> list[dict]:
        """Return the attributes of all elements of a kind."""
        return [attributes for name, attributes in self.tags if name == tag]

    def data(self) -> list[str]:
        """Return the JSON of every cloud."""
        return [text for attributes, text in self.raw if attributes.get("type", "")[-4:] == "json"]


def unpacked(text: str) -> np.ndarray:
    """Return what the page's base64 holds."""
    return np.frombuffer(base64.b64decode(text), "<f4")


def luminance(colour: str) -> float:
    """Return the relative luminance of #rrggbb (WCAG 2)."""
    assert re.fullmatch(r"#[0-9a-f]{6}", colour)
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
