"""The data card: what a data set holds and how it came about, for those who might use it.

``README.md`` beside the data, where hosting sites show it, with its pictures in ``card/``:
a contact sheet, the heights of the same samples, and a histogram of every drawn quantity.  It
starts with the YAML that the Hugging Face Hub reads: licence, size, and where the samples stand.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import tomli_w
import yaml

from slbench.core.errors import InputError
from slbench.core.io import plain
from slbench.core.show.display import length_unit
from slbench.core.show.document import Cell, Picture, Table
from slbench.datasets.manifest import Manifest
from slbench.datasets.spec.patterns import Patterns
from slbench.datasets.spec.specification import from_dict
from slbench.datasets.store import index
from slbench.datasets.store.sample import REQUIRED, RIG, TRANSPORT, TRUTH, unpack, unpacked
from slbench.datasets.store.storage import Storage
from slbench.report.plots.layout import (
    TICK_PT,
    Place,
    Sheet,
    Window,
    cells,
    limits_of,
    steps_of,
)
from slbench.scene.truth import GroundTruth
from slbench.simulate.transport import LightTransport

CARD = "README.md"
FOLDER = "card"
#: Samples on the contact sheet, and its columns.
_SHOWN, _COLUMNS = 24, 6
#: Width of a sample's picture and its margins, height of its name, room of a colour bar, px.
_WIDTH, _GAP, _NAME, _BAR = 200.0, 6.0, 22.0, 90.0
#: Histograms beside each other, size of one, px; bars and their letters at most.
_ABREAST, _DRAWN_WIDTH, _DRAWN_HEIGHT = 4, 290.0, 200.0
_MOST_BARS, _LETTERS = 12, 18
_BINS = 16

#: Licences that the Hub knows by these names, in lower case; others it takes as ``other``.
_LICENCES = {
    *("apache-2.0", "bsd-3-clause", "cc0-1.0", "cc-by-4.0", "cc-by-nc-4.0", "cc-by-nc-nd-4.0"),
    *("cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-sa-4.0", "gpl-3.0", "mit", "odbl", "odc-by"),
    "pddl",
}
_UNKNOWN = "not stated"
#: Names of the Hub for numbers of samples, by the least number that each is too small for.
_SIZES = (
    *((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M")),
    (10**9, "n>1M"),
)

Row = Mapping[str, Any]


def write_card(url: str) -> None:
    """Write a data set's card; its index must be there.

    Raises
    ------
    InputError
        If there is no data set, or a sample for the contact sheet is damaged.
    """
    storage = Storage(url)
    manifest = Manifest.load(storage)
    rows = index.decode(storage.read(index.INDEX), storage.where(index.INDEX))
    good = [row for row in rows if row["status"] == index.OK]
    pictures: list[tuple[str, Picture]] = []
    frames = rest = float("nan")
    if good:
        chosen = [good[k] for k in np.unique(np.linspace(0, len(good) - 1, _SHOWN).astype(int))]
        samples = [_seen(storage, row) for row in chosen]
        pictures.append(("samples", contact_sheet(chosen, [s[0] for s in samples])))
        pictures.append(("heights", height_sheet(chosen, [s[1] for s in samples])))
        frames = float(np.mean([s[2] for s in samples]))
        rest = float(np.mean([row["size"] for row in chosen])) - frames
        if manifest.drawn:
            pictures.append(("drawn", histograms(manifest, good)))
    for name, picture in pictures:
        storage.write(f"{FOLDER}/{name}.png", picture.png)
    text = card(manifest, rows, pictures, rest, frames)
    storage.write(CARD, text.encode())


def card(
    manifest: Manifest,
    rows: Sequence[Row],
    pictures: Sequence[tuple[str, Picture]],
    bytes_without_frames: float,
    bytes_of_frames: float,
) -> str:
    """Return the card's Markdown.

    Parameters
    ----------
    manifest : Manifest
    rows : sequence of mappings
        Of the index.
    pictures : sequence of (str, Picture)
        By name of their file in ``card/``.
    bytes_without_frames, bytes_of_frames : float
        Mean of a sample.
    """
    good = [row for row in rows if row["status"] == index.OK]
    failed = [row for row in rows if row["status"] != index.OK]
    lines = [*front_matter(manifest, len(good)), f"# {manifest.name}", ""]
    if manifest.description:
        lines += [manifest.description, ""]
    camera = manifest.specification["scene"].get("camera", {}).get("resolution_px")
    facts = [
        ("licence", manifest.licence),
        ("samples", f"{len(good)} of {manifest.count}"),
        ("seed", str(manifest.seed)),
        ("distinct objects", str(len({row["object"] for row in good}))),
        ("shards", f"{manifest.shards}, {manifest.samples_per_shard} samples each"),
        ("size", _size(sum(row["size"] for row in good))),
    ]
    if good:
        facts.append(("a sample without frames", _size(bytes_without_frames)))
        facts.append(("its frames", _size(bytes_of_frames)))
        draws = sum(row["draws"] for row in good)
        facts.append(("rejected draws", f"{100.0 * (1.0 - len(good) / draws):.1f} % of {draws}"))
    if camera and not manifest.preview:
        facts.append(("camera", f"{camera[0]} x {camera[1]} px"))
    if manifest.preview:
        facts.append(("camera", "a preview: fewer, larger pixels"))
    made = manifest.environment
    facts.append(("made with", f"slbench {made.get('slbench')}, Mitsuba {made.get('variant')}"))
    lines.append(Table("What it is", ("", ""), tuple(facts)).markdown())
    for name, picture in pictures:
        lines += [f"## {picture.title}", "", f"![{picture.caption}]({FOLDER}/{name}.png)", ""]
        lines += [picture.caption, ""]
    kinds = Counter(row["kind"] for row in good if row["kind"])
    if kinds:
        counts = tuple((kind, number) for kind, number in sorted(kinds.items()))
        lines.append(Table("Objects", ("kind", "samples"), counts).markdown())
    lines += [_drawn_table(manifest, good).markdown()] if manifest.drawn else []
    lines.append(_patterns_table(manifest).markdown())
    if good:
        lines.append(_statistics_table(manifest, good).markdown())
    if failed:
        reasons = tuple((row["key"], row["attempts"], row["reason"]) for row in failed)
        lines.append(Table("Failed samples", ("key", "attempts", "reason"), reasons).markdown())
    lines += ["## Use", "", *_USE.format(name=manifest.name).splitlines(), ""]
    lines += ["## Specification", "", "Complete, base scene included.", "", "```toml"]
    specification = plain(manifest.specification, keep_non_finite=True)
    lines += [tomli_w.dumps(specification).rstrip(), "```", ""]
    return "\n".join(lines)


def front_matter(manifest: Manifest, samples: int) -> list[str]:
    """Return the lines of YAML by which the Hugging Face Hub and its ``datasets`` know the data.

    ``load_dataset(folder)`` gives the samples; all files of a data set have one format there, so
    the index is read by itself, as Parquet.
    """
    known = manifest.licence.lower()
    stated: dict[str, Any] = {"license": known}
    if manifest.licence == _UNKNOWN:
        stated = {"license": "unknown"}
    elif known not in _LICENCES:
        stated = {"license": "other", "license_name": manifest.licence}
    values = {
        "pretty_name": manifest.name,
        **stated,
        "size_categories": [next(name for most, name in _SIZES if samples < most)],
        "task_categories": ["depth-estimation"],
        "tags": ["structured-light", "fringe-projection", "light-transport", "synthetic"],
        "configs": [
            {
                "config_name": "default",
                "data_files": [{"split": "train", "path": "shards/*.tar"}],
            }
        ],
    }
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    return ["---", *text.splitlines(), "---", ""]


_USE = """\
Every sample holds its light transport, so any pattern sequence can be put on it:

```python
import slbench.datasets

data = slbench.datasets.open_dataset("{name}")
shots = data[0].capture("1,8,64")
```"""


def _size(count: float) -> str:
    """Return a number of bytes with a unit."""
    for unit in ("B", "kB", "MB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} GB"


def _drawn_table(manifest: Manifest, rows: Sequence[Row]) -> Table:
    ways: dict[str, set[str]] = {}
    specification = from_dict(manifest.specification, "specification")
    for name, _, _, distribution in specification.columns_drawn():
        ways.setdefault(name, set()).add(distribution.described())
    body: list[tuple[Cell, ...]] = []
    for name in manifest.drawn:
        values = [row[name] for row in rows if row.get(name) is not None]
        numbers = values if values and not isinstance(values[0], str) else []
        ends = [float(min(numbers)), float(max(numbers))] if numbers else [None, None]
        body.append((name, "; ".join(sorted(ways.get(name, ()))), len(values), *ends))
    heading = ("column", "distribution", "samples", "lowest", "highest")
    return Table("What is drawn", heading, tuple(body))


def _patterns_table(manifest: Manifest) -> Table:
    body = tuple(
        (prefix, Patterns(**value).title, value.get("shifts"), value.get("axes"))
        for prefix, value in manifest.captures.items()
    )
    note = "" if body else "None: light transport alone."
    return Table("Frames", ("capture", "patterns", "shifts", "axes"), body, note)


def _statistics_table(manifest: Manifest, rows: Sequence[Row]) -> Table:
    first = next(iter(manifest.captures), None)
    names = [*index.STATISTICS, *(f"{first}_{name}" for name in index.SCORES if first)]
    body: list[tuple[Cell, ...]] = []
    for name in names:
        values = np.array([row[name] for row in rows if row.get(name) is not None], float)
        if values.size:
            body.append((name, *(float(np.quantile(values, q)) for q in (0.0, 0.5, 1.0))))
    return Table("Statistics", ("column", "lowest", "median", "highest"), tuple(body))


def _seen(storage: Storage, row: Row) -> tuple[Any, Any, int]:
    """Return a sample's fully lit picture, its heights, and the bytes of its frames."""
    content = storage.read_range(row["shard"], row["offset"], row["size"])
    where = f"{storage.where(row['shard'])}: sample {row['key']}"
    members = unpack(row["sample"], content, where)
    for name in REQUIRED:
        if name not in members:
            raise InputError(where, name, "no such file")
    frames = sum(len(value) for name, value in members.items() if name.endswith(".png"))
    kept = {name: members[name] for name in (TRANSPORT, TRUTH, RIG)}
    with unpacked(kept) as folder:
        white = LightTransport.load(folder / TRANSPORT).white()
        truth = GroundTruth.load(folder / TRUTH)
    heights = np.where(truth.object_id == 0, truth.point[..., 2], np.nan)
    return white, heights, frames


def contact_sheet(rows: Sequence[Row], pictures: Sequence[Any]) -> Picture:
    """Return the fully lit pictures of samples, each scaled to its own brightness."""
    sheet, places = _sheet(pictures)
    for place, row, picture in zip(places, rows, pictures, strict=True):
        box = _tile(place, picture)
        small = _reduced(picture, box)
        top = max(float(np.percentile(small, 99.5)), 1e-30)
        # A square root, about what a display does, so that dark objects are seen too.
        sheet.raster(box, np.sqrt(np.clip(small / top, 0.0, 1.0)), "gray", (0.0, 1.0))
        _name(sheet, place, row)
    caption = "Samples in the light of the whole panel, each scaled to its own brightness."
    return Picture.drawn("Samples", sheet.figure, caption)


def height_sheet(rows: Sequence[Row], heights: Sequence[Any]) -> Picture:
    """Return the true heights of the drawn objects, all on one scale."""
    sheet, places = _sheet(heights, _BAR)
    unit = length_unit(*(limits_of(image) for image in heights if np.isfinite(image).any()))
    small = [
        unit.per_mm * _reduced(image, _tile(place, image))
        for place, image in zip(places, heights, strict=True)
    ]
    low, high = limits_of(np.concatenate([image.ravel() for image in small]), 0.5)
    if low == high:
        low, high = low - 0.5, high + 0.5
    for place, row, image in zip(places, rows, small, strict=True):
        box = _tile(place, image)
        sheet.ground(box)
        sheet.raster(box, image, "viridis", (low, high))
        _name(sheet, place, row)
    bar_height = min(sheet.height - 70.0, 320.0)
    bar = Place(sheet.width - _BAR - 8.0, 0.5 * (sheet.height - bar_height), 0.0, bar_height)
    sheet.bar(bar, "viridis", (low, high), f"z / {unit.name}")
    caption = "True height of the drawn object, seen by the camera; grey where it is not seen."
    return Picture.drawn("Heights", sheet.figure, caption)


def _sheet(pictures: Sequence[Any], right: float = 0.0) -> tuple[Sheet, list[Place]]:
    """Return a sheet with a place for each of some pictures, and room on the right."""
    columns = min(_COLUMNS, len(pictures))
    tallest = max(min(max(p.shape[0] / p.shape[1], 0.3), 1.2) for p in pictures)
    height = (_WIDTH - 2.0 * _GAP) * tallest + _NAME + _GAP
    places = cells(len(pictures), columns, _WIDTH, height)
    return Sheet(columns * _WIDTH + right, -(-len(pictures) // columns) * height + _GAP), places


def _tile(place: Place, picture: Any) -> Place:
    """Return where a picture stands in its place, below its name."""
    rows, columns = picture.shape
    return place.within(_GAP, _NAME, _GAP, _GAP).fitted(rows / columns)


def _reduced(picture: Any, box: Place) -> Any:
    """Return a picture of about as many pixels as it is shown with."""
    step = max(1, int(picture.shape[1] / (1.5 * box.width)))
    return picture[::step, ::step]


def _name(sheet: Sheet, place: Place, row: Row) -> None:
    """Write the key of a sample above its picture, and what it shows where that has room."""
    key, kind = str(row["key"]), str(row["kind"] or "")
    # Letters are some 6.5 px wide.
    fits = len(key) + 1 + len(kind) <= (_WIDTH - 2.0 * _GAP) / 6.5
    text = f"{key} {kind}".strip() if fits else key
    sheet.text(place.left + _GAP, place.top + 5.0, text, "title", TICK_PT)


def histograms(manifest: Manifest, rows: Sequence[Row]) -> Picture:
    """Return a histogram of every drawn quantity, numbers by bins and texts by value."""
    specification = from_dict(manifest.specification, "specification")
    further = () if specification.clutter is None else specification.clutter.slots()
    # Of several objects the first: the others are drawn alike.
    ends = tuple(slot for slot, _ in further if slot)
    names = [name for name in manifest.drawn if not name.endswith(ends)]
    columns = min(_ABREAST, len(names))
    ways: dict[str, bool] = {}
    for name, _, _, distribution in specification.columns_drawn():
        ways[name] = ways.get(name, True) and distribution.log_uniform is not None
    logarithmic = {name for name, always in ways.items() if always}
    values = {name: [row[name] for row in rows if row.get(name) is not None] for name in names}
    bars = max((len(set(v)) for v in values.values() if v and isinstance(v[0], str)), default=0)
    height = max(_DRAWN_HEIGHT, 60.0 + 18.0 * min(bars, _MOST_BARS))
    sheet = Sheet(columns * _DRAWN_WIDTH, -(-len(names) // columns) * height)
    for cell, name in zip(cells(len(names), columns, _DRAWN_WIDTH, height), names, strict=True):
        title = f"{name} ({len(values[name])})"
        sheet.text(cell.left + 0.5 * cell.width, cell.top + 8.0, title, "title", ha="center")
        if values[name] and isinstance(values[name][0], str):
            _bars(sheet, cell, Counter(values[name]))
        elif values[name]:
            whole = manifest.columns[name] == "int64"
            _distribution(sheet, cell, np.array(values[name], float), whole, name in logarithmic)
    caption = "What was drawn, after rejection; in brackets how many samples have it."
    return Picture.drawn("Drawn quantities", sheet.figure, caption)


def _bars(sheet: Sheet, cell: Place, counts: Counter[str]) -> None:
    """Draw a bar for each text, the most frequent where there are many."""
    chosen = sorted(dict(counts.most_common(_MOST_BARS)))
    left = 16.0 + 6.5 * min(max(len(text) for text in chosen), _LETTERS)
    box = cell.within(left, 30.0, 14.0, 30.0)
    window = Window(box, (0.0, 1.05 * max(counts.values())), (len(chosen) - 0.5, -0.5))
    sheet.frame(box)
    sheet.ticks(window, most=(3, 0), counts=(True, True))
    for k, text in enumerate(chosen):
        n = counts[text]
        sheet.area(window.at([0.0, n, n, 0.0], [k - 0.35, k - 0.35, k + 0.35, k + 0.35]), "C0")
        y = float(window.at(0.0, k)[1])
        label = textwrap.shorten(text, _LETTERS, placeholder="…")
        sheet.text(box.left - 4.0, y, label, "tick", TICK_PT, ha="right", va="center")


def _distribution(sheet: Sheet, cell: Place, values: Any, whole: bool, by_log: bool) -> None:
    """Draw a histogram of numbers: whole ones by themselves, others in bins."""
    low, high = float(values.min()), float(values.max())
    # What a draw is added to may be negative.
    by_log = by_log and 0.0 < low < high
    if whole and high - low < 2 * _BINS:
        edges = np.arange(low, high + 2.0) - 0.5
    elif by_log:
        edges = np.geomspace(low, high, _BINS + 1)
        edges[[0, -1]] = low, high
    else:
        edges = np.histogram_bin_edges(values, _BINS)
    counts = np.histogram(values, edges)[0]
    box = cell.within(42.0, 30.0, 14.0, 30.0)
    ends = (float(edges[0]), float(edges[-1]))
    window = Window(box, ends, (0.0, 1.05 * max(counts.max(), 1)), (by_log, False))
    sheet.area(window.at(*steps_of(counts, edges)), "C0", edgecolor="C0", linewidth=0.5)
    sheet.frame(box)
    sheet.ticks(window, most=(4, 3), counts=(False, True))
