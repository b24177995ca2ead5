"""What scans of several views leave in their folder."""

from __future__ import annotations

import glob
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from slbench.capture.stack import WeightSource
from slbench.core.io import OutputFolder, write_json, write_ply
from slbench.core.show.drawing import write_figure
from slbench.scene.model import Scene
from slbench.simulate.folder import write_scan
from slbench.simulate.scan import Progress, Scan
from slbench.simulate.viewpoints.scan import ScannedViews, StageErrors, scan_views
from slbench.simulate.viewpoints.views import Viewpoint, Viewpoints


def views_folder(viewpoints: Viewpoints) -> OutputFolder:
    """Return the folder that scans of views are written to."""
    own = ("merged.ply", "views.json", "views.toml", "coverage.png")
    names = (glob.escape(view.name) for view in viewpoints.views)
    return OutputFolder("scan of views", (*own, *names))


def write_scanned_views(
    scene: Scene,
    viewpoints: Viewpoints,
    folder: str | Path,
    *,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    weights: WeightSource = "lit",
    score: bool = True,
    refine: bool = True,
    stage: StageErrors | None = None,
    picture: bool = True,
    on_progress: Progress | None = None,
) -> ScannedViews:
    """Scan all views into a folder; nothing appears in it until all are complete.

    Parameters
    ----------
    scene, viewpoints, seed, noise, samples, weights, score, refine, stage, on_progress
        As for :func:`slbench.simulate.viewpoints.scan.scan_views`.
    folder : path
        Gets a folder a view (:func:`slbench.simulate.folder.write_scan`), ``merged.ply`` in the
        part's frame, ``views.json``, ``views.toml`` and ``coverage.png``.
    picture : bool
        False leaves out all pictures.
    """
    errors = stage or StageErrors()
    parameters = {
        "scene": scene.specification,
        "patterns": scene.sequence.to_dict(),
        "views": [view.name for view in viewpoints.views],
        "noise": noise,
        "samples": samples or scene.samples,
        "weights": weights,
        "refine": refine,
        "stage_mm": errors.position_mm,
        "tilt_rad": errors.tilt_rad,
    }
    timings: dict[str, Any] = {}
    with views_folder(viewpoints).writing(folder, parameters, seed, timings=timings) as temporary:
        result = scan_views(
            scene,
            viewpoints,
            seed=seed,
            noise=noise,
            samples=samples,
            weights=weights,
            score=score,
            refine=refine,
            stage=stage,
            on_view=_writer(temporary, picture),
            on_progress=on_progress,
        )
        fields = {
            "view": result.view,
            "sigma": result.sigma_mm,
            "u": result.u_mm,
            "error": np.linalg.norm(result.error_mm, axis=1),
        }
        if len(result.points):
            write_ply(temporary / "merged.ply", result.points, fields)
        write_json(temporary / "views.json", result.to_dict())
        viewpoints.write(temporary / "views.toml")
        if picture:
            write_figure(result, temporary / "coverage.png")
        for view, seconds in zip(viewpoints.views, result.seconds, strict=True):
            timings[view.name] = float(seconds)
    return result


def _writer(folder: Path, picture: bool) -> Callable[[Viewpoint, Scan], None]:
    def write(view: Viewpoint, result: Scan) -> None:
        write_scan(result, folder / view.name, picture=picture)

    return write
