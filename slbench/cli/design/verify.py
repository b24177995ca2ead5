"""``slbench design verify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import AllowModules, Json, SceneChanges, Seed, print_json, progress
from slbench.cli.design.hardware import HardwareName
from slbench.cli.lazy import command
from slbench.core.validation.types import Interval, Samples

#: Rigs to draw: three at least, for a correlation.
Drawn = Annotated[int, Interval(ge=3, le=10_000)]


@command("slbench design verify hardware/macro-ch6 scenes/hardware/table4.csv")
def verify(
    hardware: HardwareName,
    configurations: Annotated[
        Path | None, typer.Argument(help="CSV of rigs; without it feasible ones are drawn.")
    ] = None,
    count: Annotated[Drawn, typer.Option(help="How many rigs to draw.")] = 24,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/verify"),
    patterns: Annotated[
        str, typer.Option(help="A pattern set of three shifts, along the hardware's coded axes.")
    ] = "1,5",
    spp: Annotated[Samples, typer.Option(help="Samples a pixel.")] = 16,
    seed: Seed = 0,
    changes: SceneChanges = None,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Scan a plate with rigs; compare errors with predicted ones.

    Both are for the panel axes that the hardware codes: coded_axes of its [design] is "u", "v" or
    "uv", or 1 for the better one of each rig, as for a camera above the projector.
    """
    import numpy as np

    from slbench.core.io import OutputFolder, write_json
    from slbench.design.rig.constraints import feasible_sample
    from slbench.design.rig.hardware import load_hardware, read_configurations
    from slbench.design.rig.verify import draw
    from slbench.design.rig.verify import verify as run
    from slbench.scene.changes import listed, read_changes

    folder = OutputFolder("verification", ("verify.json", "verify.png"))
    folder.check(out, "--out")
    made = read_changes(changes or (), "--set")
    loaded = load_hardware(hardware, allow_modules=allow_modules, changes=made)
    if configurations is None:
        rows = feasible_sample(loaded, count, seed)
    else:
        rows = read_configurations(configurations, loaded.variables)
    with progress(as_json) as report:
        result = run(
            loaded,
            rows,
            patterns=patterns,
            samples=spp,
            seed=seed,
            allow_modules=allow_modules,
            on_progress=report,
        )
    found = {
        "configurations": np.column_stack((rows[:, :4], np.rad2deg(rows[:, 4:]))),
        "rank_correlation": result.rank_correlation,
        "axes": result.predicted.axes.tolist(),
        "predicted_mm": result.predicted.mu_mm,
        "rendered_mm": result.rendered_mm,
        "rendered_z_mm": result.rendered_z_mm,
    }
    parameters = {"hardware": hardware, "set": listed(made), "patterns": patterns, "samples": spp}
    with folder.writing(out, parameters, seed) as temporary:
        write_json(temporary / "verify.json", found)
        draw(result, temporary / "verify.png")
    if as_json:
        print_json(found | {"out": str(out)})
        return
    predicted = result.predicted
    for k, (mu, rms) in enumerate(zip(predicted.mu_mm, result.rendered_mm, strict=True)):
        errors = f"predicted {1e3 * mu:7.1f} µm   rendered {1e3 * rms:7.1f} µm"
        print(f"{k + 1:3}  {errors}   coded {predicted.axes[k]}")
    print(f"rank correlation {result.rank_correlation:.3f}; written to {out}")
