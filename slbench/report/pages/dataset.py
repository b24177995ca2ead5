"""The data card: what a data set holds and how it came about, for those who might use it.

``README.md`` beside the data, where hosting sites show it, with its pictures in ``card/``:
a contact sheet, the heights of the same samples, and a histogram of every drawn quantity.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from slbench.core.errors import InputError
from slbench.core.io import plain
from slbench.core.show.document import Cell, Picture, Table
from slbench.datasets.manifest import Manifest
from slbench.datasets.spec.distributions import column
from slbench.datasets.spec.specification import from_dict
from slbench.datasets.store import index
from slbench.datasets.store.sample import REQUIRED, TRANSPORT, TRUTH, unpacked
from slbench.datasets.store.shards import unpack
from slbench.datasets.store.storage import Storage
from slbench.scene.truth import GroundTruth
from slbench.simulate.transport import LightTransport

CARD = "README.md"
FOLDER = "card"
#: Samples on the contact sheet, and its columns.
_SHOWN, _COLUMNS = 24, 6
_BINS = 16

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
    lines = [f"# {manifest.name}", ""]
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
    for place, distribution in specification.distributions():
        ways.setdefault(column(place, distribution), set()).add(distribution.described())
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
        (prefix, value["sequence"], value["shifts"], value["axes"])
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
    kept = {name: members[name] for name in (TRANSPORT, TRUTH)}
    with unpacked(kept) as folder:
        white = LightTransport.load(folder / TRANSPORT).white()
        truth = GroundTruth.load(folder / TRUTH)
    heights = np.where(truth.object_id == 0, truth.point[..., 2], np.nan)
    return white, heights, frames


def contact_sheet(rows: Sequence[Row], pictures: Sequence[Any]) -> Picture:
    """Return the fully lit pictures of samples, each scaled to its own brightness."""
    figure, axes = _sheet(len(rows))
    for ax, row, picture in zip(axes, rows, pictures, strict=True):
        top = max(float(np.percentile(picture, 99.5)), 1e-30)
        # A square root, about what a display does, so that dark objects are seen too.
        shown = np.sqrt(np.clip(picture / top, 0.0, 1.0))
        ax.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
        ax.set_title(_label(row), fontsize=8)
    caption = "Samples in the light of the whole panel, each scaled to its own brightness."
    return Picture.drawn("Samples", figure, caption)


def height_sheet(rows: Sequence[Row], heights: Sequence[Any]) -> Picture:
    """Return the true heights of the drawn objects, all on one scale."""
    finite = np.concatenate([image[np.isfinite(image)] for image in heights])
    low, high = np.percentile(finite, [0.5, 99.5]) if finite.size else (0.0, 1.0)
    figure, axes = _sheet(len(rows))
    shown: Any = None
    for ax, row, image in zip(axes, rows, heights, strict=True):
        shown = ax.imshow(image, cmap="viridis", vmin=low, vmax=high, interpolation="nearest")
        ax.set_facecolor("0.9")
        ax.set_title(_label(row), fontsize=8)
    figure.colorbar(shown, ax=axes, shrink=0.6, label="z / mm")
    caption = "True height of the drawn object, seen by the camera; grey where it is not seen."
    return Picture.drawn("Heights", figure, caption)


def _sheet(count: int) -> tuple[Figure, list[Any]]:
    columns = min(_COLUMNS, count)
    lines = -(-count // columns)
    figure = Figure(figsize=(2.0 * columns + 1.0, 1.75 * lines + 0.2), dpi=100)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(lines, columns, squeeze=False).ravel()
    for ax in grid:
        ax.set_xticks([])
        ax.set_yticks([])
    for ax in grid[count:]:
        ax.set_visible(False)
    return figure, list(grid[:count])


def _label(row: Row) -> str:
    return f"{row['key']} {row['kind'] or ''}".strip()


def histograms(manifest: Manifest, rows: Sequence[Row]) -> Picture:
    """Return a histogram of every drawn quantity, numbers by bins and texts by value."""
    names = list(manifest.drawn)
    columns = min(4, len(names))
    lines = -(-len(names) // columns)
    figure = Figure(figsize=(2.6 * columns, 2.2 * lines), dpi=100, layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False).ravel()
    ways: dict[str, bool] = {}
    specification = from_dict(manifest.specification, "specification")
    for place, distribution in specification.distributions():
        name = column(place, distribution)
        ways[name] = ways.get(name, True) and distribution.log_uniform is not None
    logarithmic = {name for name, always in ways.items() if always}
    for ax, name in zip(grid, names, strict=False):
        values = [row[name] for row in rows if row.get(name) is not None]
        if values and isinstance(values[0], str):
            counts = Counter(values)
            labels = ["\n".join(textwrap.wrap(label, 14)) for label in sorted(counts)]
            ax.barh(labels, [counts[label] for label in sorted(counts)], color="C0")
            ax.tick_params(axis="y", labelsize=6)
        elif values and manifest.columns[name] == "int64" and max(values) - min(values) < 2 * _BINS:
            edges = np.arange(min(values), max(values) + 2) - 0.5
            ax.hist(values, bins=edges, color="C0", edgecolor="white", linewidth=0.5)
        elif values:
            bins: Any = _BINS
            # What a draw is added to may be negative.
            if name in logarithmic and 0.0 < min(values) < max(values):
                bins = np.geomspace(min(values), max(values), _BINS + 1)
                ax.set_xscale("log")
            ax.hist(values, bins=bins, color="C0", edgecolor="white", linewidth=0.5)
        ax.set_title(f"{name} ({len(values)})", fontsize=8)
        ax.tick_params(labelsize=7)
    for ax in grid[len(names) :]:
        ax.set_visible(False)
    caption = "What was drawn, after rejection; in brackets how many samples have it."
    return Picture.drawn("Drawn quantities", figure, caption)
