"""``slbench design evaluate``, ``rig`` and ``verify``; ``patterns`` joins them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from slbench.cli.common import (
    Json,
    Seed,
    check_folder,
    new_app,
    print_json,
    print_table,
    progress,
)
from slbench.cli.design import patterns
from slbench.core import resources

app = new_app("Design of structured-light systems: rigs and pattern sequences.")
app.command(epilog=f"Example: {patterns.EXAMPLE}")(patterns.patterns)
app.command(epilog=f"Example: {patterns.NOISE_EXAMPLE}")(patterns.noise)

HardwareName = Annotated[
    str, typer.Argument(help="A hardware file, or the name of a shipped one: hardware/macro-ch6.")
]


@app.command(
    epilog="Example: slbench design evaluate hardware/macro-ch6 scenes/hardware/table4.csv --json"
)
def evaluate(
    hardware: HardwareName,
    configurations: Annotated[Path, typer.Argument(help="CSV of z_ref_mm, w_mm, ... beta_p_deg.")],
    full: Annotated[
        bool, typer.Option("--full", help="Every camera pixel instead of the thesis's sample.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Predict error, coverage and constraints of rig configurations."""
    from slbench.design.rig.evaluate import THESIS_STRIDE
    from slbench.design.rig.evaluate import evaluate as run
    from slbench.design.rig.hardware import load_hardware, read_configurations

    rows = read_configurations(configurations)
    result = run(load_hardware(hardware), rows, stride=(1, 1) if full else THESIS_STRIDE)
    if as_json:
        print_json(result.rows())
        return
    table = Table(title=f"{len(rows)} configurations")
    for name in ("", "μ / mm", "σ / mm", "η", "points", "d / mm", "angle / °", "feasible"):
        table.add_column(name, justify="right")
    for i, row in enumerate(result.rows()):
        failed = [name for name, margin in row["margins"].items() if not margin > 0]
        table.add_row(
            str(i + 1),
            f"{row['mu_mm']:.4f}",
            f"{row['sigma_mm']:.4f}",
            f"{row['eta']:.3f}",
            str(row["n_points"]),
            f"{row['dispersion_mm']:.2f}",
            f"{row['angle_deg']:.1f}",
            "yes" if row["feasible"] else f"no: {', '.join(failed)}",
        )
    print_table(table)


@app.command(epilog="Example: slbench design rig hardware/macro-ch6 --out out/rig")
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
    as_json: Json = False,
) -> None:
    """Search for the best rigs of given hardware; report them, and a scene to scan."""
    from slbench.design.rig.evaluate import evaluate as run
    from slbench.design.rig.hardware import (
        load_hardware,
        read_configurations,
        thesis_configurations,
    )
    from slbench.design.rig.optimise import optimise
    from slbench.design.rig.volume import largest_box
    from slbench.design.search.front import Front
    from slbench.report.plots.rig_design import write_design
    from slbench.scene.file import read_merged

    check_folder(out)
    loaded = load_hardware(hardware)
    path = resources.find("scenes", hardware)
    begin: Any = None
    if start is not None:
        begin = Front.load(start) if start.suffix == ".npz" else read_configurations(start)
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
    }
    write_design(design, out, read_merged(path), parameters, seed, pick=pick, marked=marked)
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
        f"{summary['evaluations']} evaluations ({summary['stopped']}), {design.seconds:.1f} s"
    )
    names = ("z_ref", "w", "h", "l", "alpha_P", "beta_P")
    print("rig: " + ", ".join(f"{n} {v:.5g}" for n, v in zip(names, variables, strict=True)))
    print(f"Written to {out}: scan it with slbench scan {out / 'scene.toml'}")


@app.command(epilog="Example: slbench design verify hardware/macro-ch6 scenes/hardware/table4.csv")
def verify(
    hardware: HardwareName,
    configurations: Annotated[
        Path | None, typer.Argument(help="CSV of rigs; without it feasible ones are drawn.")
    ] = None,
    count: Annotated[int, typer.Option(min=3, help="How many rigs to draw.")] = 24,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/verify"),
    patterns: Annotated[str, typer.Option(help="Fringes of three shifts.")] = "1,5",
    spp: Annotated[int, typer.Option(min=1, max=65536, help="Samples a pixel.")] = 16,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Scan a plate with each rig and compare the errors with the predicted ones."""
    from slbench.core.io import atomic_folder, write_json, write_provenance
    from slbench.design.rig.constraints import feasible_sample
    from slbench.design.rig.hardware import load_hardware, read_configurations
    from slbench.design.rig.verify import draw
    from slbench.design.rig.verify import verify as run

    check_folder(out)
    loaded = load_hardware(hardware)
    if configurations is None:
        rows = feasible_sample(loaded, count, seed)
    else:
        rows = read_configurations(configurations)
    with progress(as_json) as report:
        result = run(
            loaded,
            rows,
            patterns=patterns,
            samples=spp,
            seed=seed,
            on_progress=report,
        )
    found = {
        "configurations": np.column_stack((rows[:, :4], np.rad2deg(rows[:, 4:]))),
        "rank_correlation": result.rank_correlation,
        "predicted_mm": result.predicted.mu_mm,
        "rendered_mm": result.rendered_mm,
        "rendered_z_mm": result.rendered_z_mm,
    }
    with atomic_folder(out) as temporary:
        write_json(temporary / "verify.json", found)
        draw(result, temporary / "verify.png")
        parameters = {"hardware": hardware, "patterns": patterns, "samples": spp}
        write_provenance(temporary, parameters, seed)
    if as_json:
        print_json(found | {"out": str(out)})
        return
    for k, (mu, rms) in enumerate(zip(result.predicted.mu_mm, result.rendered_mm, strict=True)):
        print(f"{k + 1:3}  predicted {1e3 * mu:7.1f} µm   rendered {1e3 * rms:7.1f} µm")
    print(f"rank correlation {result.rank_correlation:.3f}; written to {out}")


def _reporter(report: Any, budget: int) -> Any:
    """Return a callback that shows how many rigs the front has, and its hypervolume.

    The reference point is a tenth of its extent beyond the worst of the first front that has
    one; the hypervolume is shown relative to that front's.
    """
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


#: Polls between two updates of the progress bar.
_SHOWN_EVERY = 20
