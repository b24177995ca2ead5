"""Pictures that the experiments share: clouds seen from the side, distributions.

Clouds are drawn as a z-buffer of points, parallel projection: a scatter plot of a hundred
thousand markers is slow to draw and large to keep.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.spatial import KDTree

from slbench.core.random import generator
from slbench.core.show.document import Picture

Array = NDArray[np.float64]

#: Towards the light that shades clouds, in the view's frame (right, up, to the viewer).
_LIGHT = np.array([-0.4, 0.5, 0.77])
#: Part of the brightness that a surface keeps which faces away from that light.
_AMBIENT = 0.6
#: Thickness of the layers in which points cover one another, as a share of the cloud's width.
_LAYER = 0.03
#: Sides of the squares that points are drawn as, at most, px.
_LARGEST_SPLAT = 8


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches, 100 pixels each."""
    return Figure(figsize=(width, height), dpi=100, layout="constrained")


def picture(title: str, figure: Figure, caption: str) -> Picture:
    """Return a figure as a picture of at most 256 colours: a third of the size, same look."""
    drawn = Picture.drawn(title, figure, caption)
    image = Image.open(io.BytesIO(drawn.png)).convert("RGB")
    buffer = io.BytesIO()
    image.quantize(256, dither=Image.Dither.NONE).save(buffer, format="png", optimize=True)
    return Picture(title, buffer.getvalue(), caption)


def draw_cloud(
    axes: Any,
    points: ArrayLike,
    values: ArrayLike,
    limits: tuple[float, float],
    *,
    colours: str = "coolwarm",
    normals: ArrayLike | None = None,
    elevation_deg: float = 40.0,
    azimuth_deg: float = -60.0,
    width_px: int = 420,
    title: str = "",
) -> None:
    """Draw a cloud into matplotlib `axes` as seen from afar, coloured and shaded.

    Parameters
    ----------
    axes : matplotlib axes
    points : (N, 3) float
        World points, mm; z is up.
    values : (N,) float
        What the colours show.
    limits : (float, float)
        Values at the ends of the colour map.
    colours : str
        A colour map's name.
    normals : (N, 3) float, optional
        Unit normals, for the shading; flat colours without.
    elevation_deg, azimuth_deg : float
        Where the viewer stands: above the x-y plane, and about z from x.
    width_px : int
        Width of the z-buffer.
    title : str
    """
    xyz, shown = np.asarray(points, float), np.asarray(values, float)
    view = _view(np.deg2rad(elevation_deg), np.deg2rad(azimuth_deg))
    seen = (xyz - xyz.mean(axis=0)) @ view.T
    size = max(np.ptp(seen[:, 0]), 1e-9)
    scale = (width_px - 4) / size
    column = np.rint((seen[:, 0] - seen[:, 0].min()) * scale).astype(int) + 1
    row = np.rint((seen[:, 1].max() - seen[:, 1]) * scale).astype(int) + 1
    colour = colormaps[colours](Normalize(*limits, clip=True)(shown))[:, :3]
    if normals is not None:
        light = view.T @ (_LIGHT / np.linalg.norm(_LIGHT))
        lambert = np.clip(np.asarray(normals, float) @ light, 0.0, 1.0)
        colour = colour * (_AMBIENT + (1.0 - _AMBIENT) * lambert)[:, None]
    splat = _splat(row, column)
    raster = np.ones((row.max() + splat + 1, width_px + splat, 3))
    # The nearest last: it covers the others.  In layers much thicker than the noise, shuffled,
    # or points that err towards the viewer would hide their neighbours.
    order = generator(0).permutation(len(seen))
    order = order[np.argsort(np.round(seen[order, 2] / (_LAYER * size)), kind="stable")]
    offsets = np.arange(splat)
    rows = (row[order, None, None] + offsets[:, None] + 0 * offsets).ravel()
    columns = (column[order, None, None] + offsets + 0 * offsets[:, None]).ravel()
    raster[rows, columns] = np.repeat(colour[order], splat * splat, axis=0)
    axes.imshow(raster, interpolation="nearest")
    axes.set_title(title, fontsize=10)
    axes.set_axis_off()


def colour_bar(
    figure: Figure, axes: Any, limits: tuple[float, float], colours: str, label: str
) -> None:
    """Add the colour bar of clouds that share limits."""
    shown = ScalarMappable(Normalize(*limits), colours)
    figure.colorbar(shown, ax=axes, shrink=0.75, label=label, extend="both")


def draw_distributions(
    axes: Any,
    samples: Mapping[str, Array],
    medians: Sequence[float],
    label: str,
    title: str,
) -> None:
    """Draw distributions over one logarithmic axis, medians marked.

    Parameters
    ----------
    axes : matplotlib axes
    samples : mapping of str to (N,) float
        Positive numbers; NaN are left out.
    medians : sequence of float
        One a distribution.
    label, title : str
    """
    finite = {name: x[np.isfinite(x) & (x > 0)] for name, x in samples.items()}
    everything = np.concatenate(list(finite.values()))
    low, high = np.percentile(everything, [0.1, 99.5])
    bins = np.geomspace(low, high, 120)
    for k, (name, x) in enumerate(finite.items()):
        axes.hist(
            x,
            bins,
            weights=np.full(x.size, 100.0 / x.size),
            histtype="stepfilled",
            alpha=0.55,
            color=f"C{k}",
            label=f"{name}: {medians[k]:.3g}",
        )
        axes.axvline(medians[k], color=f"C{k}", linewidth=1.2, linestyle="--")
    axes.set_xscale("log")
    axes.set_ylim(0.0, 1.35 * axes.get_ylim()[1])  # room for the legend
    axes.set_xlabel(label)
    axes.set_ylabel("% of pixels a bin")
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=8, title="medians", title_fontsize=8, loc="upper center", ncols=3)


def _splat(row: NDArray[np.int_], column: NDArray[np.int_]) -> int:
    """Return the side of the squares that close a surface of points, px."""
    places = np.unique(np.column_stack((row, column)), axis=0).astype(float)
    if len(places) < 2:
        return 1
    spacing = KDTree(places).query(places, k=2)[0][:, 1]
    # The coarser of a grid's two directions is seen at up to twice the nearest distance.
    return int(np.clip(np.ceil(1.6 * np.percentile(spacing, 75.0)), 1, _LARGEST_SPLAT))


def _view(elevation: float, azimuth: float) -> Array:
    """Return the rows right, up and to the viewer, (3, 3)."""
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return np.stack([right, np.cross(towards, right), towards])
