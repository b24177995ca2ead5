"""Chapter 8: findings, tables and pictures of the registered objects (8.4.2, figs. 35 and 37)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LightSource
from numpy.typing import NDArray

from slbench.core.document import Cell, Cloud, Picture, Table
from slbench.core.random import generator
from slbench.thesis.ch8.views import Merged
from slbench.thesis.outcome import Finding
from slbench.thesis.pictures import new_figure, picture

Array = NDArray[np.float64]

#: Thesis 8.4.2: points, millions, as it puts them, and views.
THESIS_POINTS = {"coin-3": 2.0, "coin-n": 2.0, "watch-gear": 4.5}
_POINTS = {"coin-3": "more than 2", "coin-n": "more than 2", "watch-gear": "4.5"}
THESIS_VIEWS = {"coin-3": 5, "coin-n": 12, "watch-gear": 7}
_FIGURES = {"coin-3": "fig. 35", "coin-n": "fig. 35", "watch-gear": "fig. 37"}
#: Median of |error| over smooth surface, um: the thesis's own accuracy (table 13).
LIMIT_UM = 1.5
#: Cells across a picture, at most.
_CELLS = 420
_SHOWN_POINTS = 30_000
#: Heights are shaded this many times as high: roughness of a few tenths of a micrometre shows.
_EXAGGERATED = 5.0
_UM = 1e3


def object_finding(result: Merged, full_share: float) -> Finding:
    """Judge one object: points enough, errors below the stage's.

    Parameters
    ----------
    result : Merged
    full_share : float
        Pixels of this run's camera as a share of the full run's: a preview's points are
        counted as so many more.
    """
    millions = len(result.points) / full_share / 1e6
    smooth = _UM * float(np.median(np.abs(result.errors(result.smooth))))
    rms = _UM * result.smooth_rms_mm
    views = len(result.registration.poses)
    least = THESIS_POINTS[result.name]
    enough, good = millions >= least, smooth < LIMIT_UM
    measured, true = (_UM * value for value in result.roughness_mm)
    scaled = "" if full_share == 1.0 else " (scaled to the full camera)"
    return Finding(
        f"ch8-{result.name}",
        f"{result.name} from {views} registered views, {_POINTS[result.name]} million points "
        f"({_FIGURES[result.name]})",
        f"{least:g} million points or more{scaled}, and on smooth surface a median |error| below "
        f"{LIMIT_UM:g} µm; in part if one of the two. How many points there are follows from how "
        "many of the camera's pixels are put together, which is a choice of this run",
        "reproduced" if enough and good else "in part" if enough or good else "not reproduced",
        f"{millions:.2f} million points; on smooth surface median |error| {smooth:.3f} µm, RMS "
        f"{rms:.3f} µm without {100 * result.outliers:.2g} % of outliers; height between levels "
        f"{_UM * result.step_error_mm:+.3f} µm off; Ra {measured:.3f} µm, true {true:.3f} µm; "
        f"{100 * result.extrapolated:.0f} % of the points lie outside the dots' hull.",
        thesis=least,
        ours=millions,
        unit="million points",
        why=""
        if enough
        else "The camera's pixels are put together to save time; points are fewer with them.",
    )


def registration_finding(results: Sequence[Merged]) -> Finding:
    """Judge the registration: displacements of the views smaller than the stage left them."""
    pairs = {r.name: r.registration_rms_mm for r in results}
    shares = {name: after / before for name, (before, after) in pairs.items()}
    better = sum(share < 0.5 for share in shares.values())
    worst = max(shares, key=lambda name: shares[name])
    return Finding(
        "ch8-registration",
        "Views are registered from the stage's positions (8.4.2)",
        "for every object the views' displacements against each other are less than half of what "
        "the stage's errors make them (RMS per axis); in part if for some",
        "reproduced" if better == len(pairs) else "in part" if better else "not reproduced",
        "; ".join(
            f"{name} {_UM * before:.2f} µm by the stage, {_UM * after:.3f} µm registered"
            for name, (before, after) in pairs.items()
        )
        + ".",
        ours=shares[worst],
        unit="after / before, worst object",
    )


def objects_table(results: Sequence[Merged]) -> Table:
    """Return the scores of all objects."""
    rows: list[tuple[Cell, ...]] = []
    for r in results:
        before, after = r.registration_rms_mm
        known, smooth = np.abs(r.errors()), np.abs(r.errors(r.smooth))
        measured, true = r.roughness_mm
        rows.append(
            (
                r.name,
                len(r.registration.poses),
                len(r.points),
                float(_UM * np.median(known)),
                _UM * r.smooth_rms_mm,
                *(float(_UM * v) for v in (np.median(smooth), np.percentile(smooth, 95.0))),
                100.0 * r.outliers,
                _UM * r.step_error_mm,
                _UM * measured,
                _UM * true,
                _UM * r.registration.rms_start_mm,
                _UM * r.registration.rms_mm,
                _UM * before,
                _UM * after,
                float(_UM * np.linalg.norm(r.common_mm)),
            )
        )
    columns = (
        "object",
        "views",
        "points",
        "median |e| / µm",
        "smooth: RMS / µm",
        "smooth: median / µm",
        "smooth: 95 % / µm",
        "smooth: off by more than 5 µm / %",
        "height off / µm",
        "Ra / µm",
        "true Ra / µm",
        "overlap residual before / µm",
        "after / µm",
        "displacement before / µm",
        "after / µm ",
        "common / µm",
    )
    note = (
        "e: signed error along the true normal, without the views' common shift (last column), "
        "which no overlap can tell; RMS without those off by more than 5 µm. Displacement: of "
        "the views against each other, RMS per axis."
    )
    return Table("Objects measured in registered views (8.4.2)", columns, tuple(rows), note)


def object_picture(result: Merged) -> Picture:
    """Draw the surface from above: shaded, by height, and by signed error."""
    points = result.points.astype(np.float64)
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    # Coarser where points are few, or the cells between them would be empty.
    side = float((high - low).max()) / min(_CELLS, np.sqrt(len(points)) / 3.0)
    shape = tuple(int(n) for n in np.floor((high - low) / side).astype(int) + 1)
    cell = np.floor((points[:, :2] - low) / side).astype(int)
    flat = cell[:, 0] * shape[1] + cell[:, 1]

    def raster(values: Array) -> Array:
        good = np.isfinite(values)
        count = np.bincount(flat[good], minlength=shape[0] * shape[1])
        total = np.bincount(flat[good], values[good], minlength=shape[0] * shape[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            return (total / count).reshape(shape).T[::-1]

    height, error = (raster(points[:, 2]), raster(_UM * result.error_mm.astype(np.float64)))
    extent = (low[0], high[0], low[1], high[1])
    figure = new_figure(13.2, 4.4)
    shaded, left, right = figure.subplots(1, 3, width_ratios=[1.1, 1.2, 1.2])
    limits = np.nanpercentile(height, [0.5, 99.5])
    filled = np.where(np.isfinite(height), height, limits[0])
    light = LightSource(azdeg=315.0, altdeg=45.0)
    shade = light.hillshade(filled, vert_exag=_EXAGGERATED, dx=side, dy=side)
    grey = np.where(np.isfinite(height), shade, np.nan)
    shaded.imshow(grey, cmap="gray", extent=extent, vmin=0.0, vmax=1.0)
    shaded.set_title(f"shaded, heights times {_EXAGGERATED:g}")
    shown = left.imshow(
        _UM * height, cmap="viridis", extent=extent, vmin=_UM * limits[0], vmax=_UM * limits[1]
    )
    figure.colorbar(shown, ax=left, label="height / µm", shrink=0.7)
    left.set_title(f"{result.name}: {len(result.registration.poses)} views, {len(points)} points")
    limit = float(np.nanpercentile(np.abs(error), 90.0)) if np.isfinite(error).any() else 1.0
    drawn = right.imshow(error, cmap="RdBu_r", extent=extent, vmin=-limit, vmax=limit)
    figure.colorbar(drawn, ax=right, label="signed error / µm", shrink=0.7, extend="both")
    right.set_title("error along the true normal")
    for axes in (shaded, left, right):
        axes.set_facecolor("0.8")
        axes.set_xlabel("x / mm")
        axes.set_ylabel("y / mm")
    caption = (
        f"Registered views from above, means over cells of {_UM * side:.2g} µm; grey where nothing "
        "was measured."
    )
    return picture(f"{result.name} ({_FIGURES[result.name]})", figure, caption)


def object_cloud(result: Merged, seed: int) -> Cloud:
    """Return a sample of the points for the page."""
    known = np.flatnonzero(np.isfinite(result.error_mm))
    rng = generator(seed)
    if len(known) > _SHOWN_POINTS:
        known = np.sort(rng.choice(known, _SHOWN_POINTS, replace=False))
    return Cloud(
        f"{result.name}, registered",
        result.points[known].astype(np.float64),
        {"error / µm": _UM * result.error_mm[known].astype(np.float64)},
        caption=f"{len(known)} of {len(result.points)} points",
    )
