"""``slbench design rig``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from slbench.cli.common import AllowModules, Json, Seed, print_json, progress
from slbench.cli.design.hardware import HardwareName
from slbench.cli.lazy import command


@command("slbench design rig hardware/macro-ch6 --out out/rig")
def rig(
    hardware: HardwareName,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/rig"),
    evaluations: Annotated[
        int, typer.Option(min=1, help="Budget of evaluated configurations.")
    ] = 20_000,
    objectives: Annotated[
        str, typer.Option(help="Some of error, coverage, dispersion.")
    ] = "error,coverage,dispersion",
    micro: Annotated[
        bool, typer.Option("--micro", help="Maximise the measurement volume instead (microscopes).")
    ] = False,
    max_footprint_mm: Annotated[
        float | None, typer.Option(help="Largest horizontal extent of bodies and volume.")
    ] = None,
    min_angle_deg: Annotated[
        float | None, typer.Option(help="Smallest triangulation angle.")
    ] = None,
    start: Annotated[
        Path | None, typer.Option(help="front.npz to go on from, or a CSV of configurations.")
    ] = None,
    pick: Annotated[
        int | None, typer.Option(min=0, help="Cluster for the scene, not the recommended one.")
    ] = None,
    seed: Seed = 0,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Search for the best rigs of given hardware.

    Written are a report of them and the scene of the recommended one, ready to be scanned.
    """
    import numpy as np

    from slbench.core import resources
    from slbench.design.rig.evaluate import evaluate as run
    from slbench.design.rig.hardware import (
        load_hardware,
        read_configurations,
        thesis_configurations,
    )
    from slbench.design.rig.optimise import optimise
    from slbench.design.rig.volume import largest_box
    from slbench.design.search.front import Front
    from slbench.report.plots.rig_design import DESIGN_FOLDER, write_design
    from slbench.scene.file import read_merged

    DESIGN_FOLDER.check(out)
    loaded = load_hardware(hardware, allow_modules=allow_modules)
    path = resources.find("scenes", hardware)
    begin: Any = None
    if start is not None:
        begin = Front.load(start) if start.suffix.lower() == ".npz" else read_configurations(start)
    with progress(as_json) as report:
        design = optimise(
            loaded,
            objectives=[name.strip() for name in objectives.split(",")],
            micro=micro,
            max_evaluations=evaluations,
            seed=seed,
            start=begin,
            max_footprint_mm=max_footprint_mm,
            min_angle_deg=min_angle_deg,
            on_progress=_reporter(report, evaluations) if report else None,
        )
    if pick is not None:
        design.member(pick)  # refuse a wrong number before anything is written
    known = None if micro else thesis_configurations(loaded)
    marked = None if known is None else run(loaded, known)
    parameters = {
        "hardware": hardware,
        "objectives": design.objectives,
        "evaluations": design.front.evaluations,
        "max_footprint_mm": max_footprint_mm,
        "min_angle_deg": min_angle_deg,
        "stopped": design.front.stopped,
        "seconds": design.seconds,
    }
    write_design(
        design, out, read_merged(path, allow_modules), parameters, seed, pick=pick, marked=marked
    )
    member = design.member(pick)
    best = design.evaluation.rows()[member]
    variables = np.append(design.front.x[member, :4], np.rad2deg(design.front.x[member, 4:]))
    summary: dict[str, Any] = {
        "front": len(design.front),
        "clusters": len(design.clusters),
        "evaluations": design.front.evaluations,
        "stopped": design.front.stopped,
        "recommended": design.recommended,
        "configuration": variables.tolist(),
        **best,
        "seconds": design.seconds,
        "out": str(out),
    }
    if micro:
        summary["box_mm"] = largest_box(loaded, design.front.x[[member]])[0]
    if as_json:
        print_json(summary)
        return
    print(
        f"{summary['front']} nondominated rigs in {summary['clusters']} clusters after "
        f"{summary['evaluations']} evaluations ({_ENDS[design.front.stopped]}), "
        f"{design.seconds:.1f} s"
    )
    names = ("z_ref", "w", "h", "l", "alpha_P", "beta_P")
    print("rig: " + ", ".join(f"{n} {v:.5g}" for n, v in zip(names, variables, strict=True)))
    print(f"Written to {out}: scan it with slbench scan {out / 'scene.toml'}")
    if design.front.stopped == "interrupted":
        print(f"--start {out / 'front.npz'} goes on from there")


def _reporter(report: Any, budget: int) -> Any:
    """Return a callback that shows how many rigs the front has, and its hypervolume.

    The reference point is a tenth of its extent beyond the worst of the first front that has
    one; the hypervolume is shown relative to that front's.
    """
    import numpy as np

    from slbench.design.search.front import hypervolume

    first: dict[str, Any] = {}
    batches = 0

    def on_progress(front: Any) -> None:
        nonlocal batches
        batches += 1
        if len(front) < 2 or batches % _SHOWN_EVERY:
            return
        if not first:
            first["reference"] = front.f.max(axis=0) + 0.1 * np.ptp(front.f, axis=0) + 1e-12
            first["volume"] = hypervolume(front.f, first["reference"])
        inside = front.f[np.all(front.f < first["reference"], axis=1)]
        growth = hypervolume(inside, first["reference"]) / first["volume"]
        note = f"({len(front)} rigs, hypervolume x {growth:.2f})"
        report("search", front.evaluations / budget, note)

    return on_progress


#: Why a search ended, in words.
_ENDS = {
    "tolerance": "converged",
    "budget": "as many as the budget holds",
    "interrupted": "interrupted: the front so far",
}
#: Polls between two updates of the progress bar.
_SHOWN_EVERY = 20
