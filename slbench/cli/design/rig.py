"""``slbench design rig``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    Json,
    SceneChanges,
    Seed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.design.hardware import HardwareName
from slbench.cli.lazy import command
from slbench.core.validation.types import FINITE, Count, Interval, Length

#: A triangulation angle.
Degrees = Annotated[float, FINITE, Interval(gt=0.0, lt=180.0)]
Cluster = Annotated[int, Interval(ge=0, le=1000)]

if TYPE_CHECKING:
    from rich.table import Table

    from slbench.design.rig.evaluate import Evaluation
    from slbench.design.rig.optimise import RigDesign


@command("slbench design rig hardware/macro-ch6 --out out/rig")
def rig(
    hardware: HardwareName,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/rig"),
    evaluations: Annotated[
        Count, typer.Option(help="Budget of evaluated configurations.")
    ] = 20_000,
    objectives: Annotated[
        str, typer.Option(help="Some of error, coverage, dispersion.")
    ] = "error,coverage,dispersion",
    micro: Annotated[
        bool, typer.Option("--micro", help="Maximise the measurement volume instead (microscopes).")
    ] = False,
    max_footprint_mm: Annotated[
        Length | None, typer.Option(help="Largest horizontal extent of bodies and volume.")
    ] = None,
    min_angle_deg: Annotated[
        Degrees | None, typer.Option(help="Smallest triangulation angle.")
    ] = None,
    solver: Annotated[
        Literal["multisearch", "nsga2"],
        typer.Option(help="Direct MultiSearch, or NSGA-II (the extra pymoo)."),
    ] = "multisearch",
    start: Annotated[
        Path | None, typer.Option(help="front.npz to go on from, or a CSV of configurations.")
    ] = None,
    pick: Annotated[
        Cluster | None, typer.Option(help="Cluster for the scene, not the recommended one.")
    ] = None,
    seed: Seed = 0,
    changes: SceneChanges = None,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Search for the best rigs of given hardware.

    The error is that of patterns along coded_axes of [design].  Written are a report of the rigs
    and the scene of the recommended one, ready to be scanned.
    """
    import numpy as np

    from slbench.core import resources
    from slbench.design.rig.evaluate import evaluate as run
    from slbench.design.rig.hardware import (
        are_angles,
        load_hardware,
        own_configuration,
        read_configurations,
        thesis_configurations,
    )
    from slbench.design.rig.optimise import optimise
    from slbench.design.rig.volume import largest_box
    from slbench.design.search.front import Front
    from slbench.report.plots.rig_design import DESIGN_FOLDER, write_design
    from slbench.scene.changes import apply_changes, listed, read_changes
    from slbench.scene.file import read_merged

    DESIGN_FOLDER.check(out, "--out")
    made = read_changes(changes or (), "--set")
    loaded = load_hardware(hardware, allow_modules=allow_modules, changes=made)
    path = resources.find("scenes", hardware)
    begin: Any = None
    if start is not None:
        stored = start.suffix.lower() == ".npz"
        begin = Front.load(start) if stored else read_configurations(start, loaded.variables)
    with progress(as_json) as report:
        design = optimise(
            loaded,
            objectives=[name.strip() for name in objectives.split(",")],
            micro=micro,
            max_evaluations=evaluations,
            seed=seed,
            start=begin,
            solver=solver,
            max_footprint_mm=max_footprint_mm,
            min_angle_deg=min_angle_deg,
            on_progress=_reporter(report, evaluations) if report else None,
        )
    if pick is not None:
        design.member(pick)  # refuse a wrong number before anything is written
    plain = not (micro or loaded.optics)
    known = thesis_configurations(loaded) if plain else None
    marked = None if known is None else run(loaded, known)
    content = apply_changes(read_merged(path, allow_modules), made)
    own = own_configuration(content) if plain else None
    baseline = None if own is None else run(loaded, own)
    parameters = {
        "hardware": hardware,
        "set": listed(made),
        "objectives": design.objectives,
        "solver": solver,
        "evaluations": design.front.evaluations,
        "max_footprint_mm": max_footprint_mm,
        "min_angle_deg": min_angle_deg,
        "stopped": design.front.stopped,
        "seconds": design.seconds,
    }
    write_design(
        design, out, content, parameters, seed, pick=pick, marked=marked, baseline=baseline
    )
    member = design.member(pick)
    best = design.evaluation.rows()[member]
    angles = are_angles(loaded.variables)
    variables = np.where(angles, np.rad2deg(design.front.x[member]), design.front.x[member])
    summary: dict[str, Any] = {
        "front": len(design.front),
        "clusters": len(design.clusters),
        "evaluations": design.front.evaluations,
        "stopped": design.front.stopped,
        "recommended": design.recommended,
        "configuration": variables.tolist(),
        **best,
        "baseline": None if baseline is None else baseline.rows()[0],
        "rigs": [design.evaluation.rows()[design.member(k)] for k in range(len(design.clusters))],
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
    print_table(_rigs_table(design, baseline, pick))
    names = ("z_ref", "w", "h", "l", "alpha_P", "beta_P", *loaded.optics)
    print("rig: " + ", ".join(f"{n} {v:.5g}" for n, v in zip(names, variables, strict=True)))
    if micro:
        box = " x ".join(f"{size:.4g}" for size in summary["box_mm"])
        settings = len(loaded.sweep.heights_mm) if loaded.sweep else 1
        print(
            f"volume: {box} mm, in focus at {settings} settings"
            if settings > 1
            else f"volume: {box} mm"
        )
    print(f"coded: {best['axes']} of the panel")
    print(f"Written to {out}: scan it with slbench scan {out / 'scene.toml'}")
    if design.front.stopped == "interrupted":
        print(f"--start {out / 'front.npz'} goes on from there")


def _rigs_table(design: RigDesign, baseline: Evaluation | None, pick: int | None) -> Table:
    """Lay out what the representatives of the clusters measure, the file's own rig first."""
    from rich.table import Table

    from slbench.core.show.display import length_unit
    from slbench.core.show.document import shown
    from slbench.report.plots.rig_design import few_points

    rows, few, chosen = design.evaluation.rows(), few_points(design), design.member(pick)
    named = [] if baseline is None else [("own", baseline.rows()[0], shown(None))]
    notes = [] if baseline is None else ["own: the hardware file's rig"]
    # A search for the largest volume has its edge in place of the spacing of points.
    largest = design.objectives == ("volume",)
    # One unit a column: that of the rig that matters.
    units = [length_unit(rows[chosen][name]) for name in ("mu_mm", "dispersion_mm")]
    for k in range(len(design.clusters)):
        member = design.member(k)
        marks = "*" * (k == design.recommended) + ">" * (pick is not None and member == chosen)
        marks += "!" * bool(few[member])
        last = -float(design.front.f[member, 0])
        named.append((f"{k} {marks}".strip(), rows[member], f"{last:.4g}"))
    notes.append("*: recommended")
    notes += [">: picked"] * (pick is not None)
    notes += ["!: hardly any points"] * bool(few[design.clusters.representatives].any())
    table = Table(title="Predicted", caption="; ".join(notes))
    columns = ("rig", f"error / {units[0].name}", "angle / °", "coverage / %", "points")
    for k, name in enumerate(
        (*columns, "volume's edge / mm" if largest else f"spacing / {units[1].name}")
    ):
        table.add_column(name, justify="right" if k else "left")
    for name, row, edge in named:
        table.add_row(
            name,
            shown(units[0].per_mm * row["mu_mm"]),
            f"{row['angle_deg']:.1f}",
            f"{100.0 * row['eta']:.1f}",
            str(row["n_points"]),
            edge if largest else shown(units[1].per_mm * row["dispersion_mm"]),
        )
    return table


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
