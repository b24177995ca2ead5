"""``slbench scan --views``: a part from several viewpoints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from slbench.cli.common import print_json, print_table, progress

if TYPE_CHECKING:
    from slbench.capture.stack import WeightSource
    from slbench.scene.model import Scene


def scan_viewpoints(
    scene: Scene,
    path: Path,
    folder: Path,
    *,
    seed: int,
    noise: bool,
    samples: int | None,
    weights: WeightSource,
    score: bool,
    refine: bool,
    stage_um: float,
    tilt_mrad: float,
    picture: bool,
    as_json: bool,
) -> None:
    """Scan all views of a file, and print what they measured together."""
    from slbench.core.show.document import Table
    from slbench.simulate.viewpoints.folder import views_folder, write_scanned_views
    from slbench.simulate.viewpoints.scan import StageErrors
    from slbench.simulate.viewpoints.views import alone, read_views

    viewpoints = read_views(path)
    alone(scene, viewpoints.object)  # refused before anything is traced
    views_folder(viewpoints).check(folder, "--out")
    with progress(as_json) as report:
        result = write_scanned_views(
            scene,
            viewpoints,
            folder,
            seed=seed,
            noise=noise,
            samples=samples,
            weights=weights,
            score=score,
            refine=refine,
            stage=StageErrors(position_mm=1e-3 * stage_um, tilt_rad=1e-3 * tilt_mrad),
            picture=picture,
            on_progress=report,
        )
    if as_json:
        values: dict[str, Any] = result.to_dict() | {"seconds": result.seconds, "out": folder}
        print_json(values)
        return
    part = result.scene.objects[0].artefact.name
    print_table(
        Table(f"{part} from {len(viewpoints)} views", ("quantity", "value"), tuple(result.rows()))
    )
    shown = f": open {folder / 'coverage.png'}" if picture else ""
    print(f"Written to {folder}{shown}")
