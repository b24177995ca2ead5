"""Chapter 8 for people: tables, pictures, clouds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import LightSource
from numpy.typing import NDArray

from slbench.calibration.models.model import COORDINATES
from slbench.cloud.registration import STAGE_SIGMA_MM
from slbench.core.random import generator
from slbench.core.show.document import Cell, Cloud, Picture, Table
from slbench.design.fringes.noise import PhaseNoise
from slbench.thesis.ch8.findings import _FIGURES
from slbench.thesis.ch8.noise import MIDDLE_MM
from slbench.thesis.ch8.results import PLANE_MIDDLE_MM, Calibrations, Merged, MicroRig, Stage
from slbench.thesis.pictures import new_figure, picture
from slbench.twin.report import THESIS_13

Array = NDArray[np.float64]

_UM = 1e3


def rig_table(best: MicroRig, wider: MicroRig) -> Table:
    """Return the rig of the largest volume beside the best of those with a larger angle."""
    rows = tuple(
        (name, rig.angle_deg, *rig.box_mm, rig.volume_mm3, rig.gap_mm)
        for name, rig in (("largest volume", best), ("axes 10 deg further apart", wider))
    )
    columns = ("rig", "angle / deg", "x / mm", "y / mm", "z / mm", "volume / mm³", "gap / mm")
    note = "Boxes of which each point is in focus for both devices at some setting of the sweep."
    return Table("The rig that the hardware leads to (8.1.2)", columns, rows, note)


def model_table(found: Mapping[Stage, Calibrations]) -> Table:
    """Return table 13 for all stages, the thesis's numbers beside ours."""
    rows = []
    for stage, calibration in found.items():
        rms = _UM * np.median(calibration.validation(), axis=0)
        mad = _UM * np.median(calibration.validation("validation_mad"), axis=0)
        true = _UM * np.median(calibration.true_rms, axis=0)
        for k, c in enumerate(COORDINATES):
            rows.append(
                (
                    stage,
                    c,
                    100.0 * calibration.share(c),
                    float(rms[k]),
                    THESIS_13[c][0],
                    float(mad[k]),
                    THESIS_13[c][1],
                    float(true[k]),
                )
            )
    columns = (
        "stage",
        "coordinate",
        "M3 chosen / %",
        "validation RMS / µm",
        "thesis",
        "validation MAD / µm",
        "thesis",
        "RMS against true positions / µm",
    )
    note = "Medians over the draws of the stage's errors. MAD: median of absolute errors (eq. 45)."
    return Table("Validation errors of the calibration (table 13)", columns, tuple(rows), note)


def model_picture(found: Mapping[Stage, Calibrations]) -> Picture:
    """Draw the cross-validation errors of all models (figs. 30-32), over the draws."""
    figure = new_figure(12.0, 3.8)
    for axes, c in zip(figure.subplots(1, 3), COORDINATES, strict=True):
        for k, (stage, calibration) in enumerate(found.items()):
            forms = list(calibration.selections[0].scores[c])
            cv = _UM * np.array(
                [[s.scores[c][form].cv for form in forms] for s in calibration.selections]
            )
            low, middle, high = np.percentile(cv, [2.5, 50.0, 97.5], axis=0)
            x = np.arange(len(forms)) + 0.15 * (k - 1)
            axes.errorbar(x, middle, (middle - low, high - middle), fmt="o", label=stage, ms=4)
        axes.set_xticks(np.arange(len(forms)), forms)
        axes.set_yscale("log")
        axes.set_title(f"{c}: leave-one-out error")
        axes.grid(visible=True, axis="y", which="both", alpha=0.3)
    figure.axes[0].set_ylabel("CV / µm")
    figure.axes[-1].legend(title="stage", fontsize=8)
    caption = "Median and 95 % range over draws of the stage's errors."
    return picture("Cross-validation of the models (figs. 30-32)", figure, caption)


def noise_table(found: Mapping[str, PhaseNoise]) -> Table:
    """Return sigma(n, z) of all ways."""
    heights = found["single"].z_mm
    columns = ("way", "fringes", *(f"z {1e3 * z:+.0f} µm" for z in heights))
    rows = []
    for name, noise in found.items():
        at = dict(zip(np.round(noise.z_mm, 6), range(len(noise.z_mm)), strict=True))
        for n, sigma in zip(noise.fringes, noise.sigma_rad, strict=True):
            places = (at.get(z) for z in np.round(heights, 6))
            cells = [None if k is None or not np.isfinite(sigma[k]) else sigma[k] for k in places]
            rows.append((name, int(n), *(None if c is None else float(c) for c in cells)))
    note = "Standard deviation of the relative phase, rad; a dash where fringes are washed out."
    return Table("Phase noise through the volume (fig. 25)", columns, tuple(rows), note)


def noise_picture(found: Mapping[str, PhaseNoise]) -> Picture:
    """Draw fig. 25, a panel a way."""
    figure = new_figure(4.2 * len(found), 4.2)
    panels = figure.subplots(1, len(found), squeeze=False, sharey=True)[0]
    for axes, (name, noise) in zip(panels, found.items(), strict=True):
        for n, sigma in zip(noise.fringes, noise.sigma_rad, strict=True):
            shown = np.where(np.isfinite(sigma), sigma, np.nan)
            axes.semilogy(1e3 * noise.z_mm, shown, ".-", label=f"{n}")
        axes.axvspan(-1e3 * MIDDLE_MM, 1e3 * MIDDLE_MM, color="0.92", zorder=0)
        axes.set_title(name)
        axes.set_xlabel("height z / µm")
        axes.grid(visible=True, which="both", alpha=0.3)
        axes.legend(title="fringes", fontsize=7, ncols=2)
    panels[0].set_ylabel(r"phase noise $\sigma_\phi$ / rad")
    caption = "Noise of the relative phase over the height; the thesis's middle is shaded."
    return picture("Phase noise through the volume (fig. 25)", figure, caption)


#: Cells across a picture, at most.
_CELLS = 420


_SHOWN_POINTS = 30_000


#: Heights are shaded this many times as high: roughness of a few tenths of a micrometre shows.
_EXAGGERATED = 5.0


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


def plane_table(z_mm: Array, columns: dict[str, Array]) -> Table:
    """Return medians of |error| per height, um; `columns` are (draws, positions), mm."""
    heights = np.unique(np.round(z_mm, 9))
    rows: list[tuple[Cell, ...]] = []
    for z in heights:
        at = np.abs(z_mm - z) < 1e-9
        cells = [float(_UM * np.median(np.abs(values[:, at]))) for values in columns.values()]
        rows.append((f"{1e3 * z:+.0f}", *cells))
    heads = ("z / µm", *(f"{name} / µm" for name in columns))
    return Table("Median plane position error by height (fig. 33)", heads, tuple(rows))


def plane_picture(z_mm: Array, off: Array, exact: Array) -> Picture:
    """Draw fig. 33: one draw of the stage's errors as the thesis has it, and an exact stage."""
    figure = new_figure(10.5, 3.8)
    left, right = figure.subplots(1, 2)
    for axes, values, title in (
        (left, off[0], f"stage off by {_UM * STAGE_SIGMA_MM:g} µm, one draw"),
        (right, exact[0], "exact stage"),
    ):
        heights = np.unique(np.round(z_mm, 9))
        groups = [_UM * values[np.abs(z_mm - z) < 1e-9] for z in heights]
        axes.boxplot(groups, positions=_UM * heights, widths=25.0, manage_ticks=False)
        axes.plot(_UM * z_mm, _UM * values, "k.", ms=3)
        axes.axvspan(
            _UM * PLANE_MIDDLE_MM[0] - 25, _UM * PLANE_MIDDLE_MM[1] + 25, color="0.92", zorder=0
        )
        axes.axhline(0.0, color="0.5", lw=0.7)
        axes.set_title(title)
        axes.set_xlabel("height z / µm")
        axes.set_ylabel("position error / µm")
    caption = "Measured less nominal height of a plate; the thesis's middle is shaded."
    return picture("Plane position error (fig. 33)", figure, caption)
