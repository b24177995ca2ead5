"""``slbench design patterns``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slbench.cli.common import Json, Preview, Seed, print_json, print_table, progress
from slbench.errors import InputError

EXAMPLE = (
    "slbench design patterns --width-px 400 --noise-rad 0.036 --noise-step 0.001 "
    "--phase-model thesis --json"
)


def patterns(
    width_px: Annotated[
        int | None, typer.Option(help="Coded panel width; a scene or a capture has its own.")
    ] = None,
    noise_rad: Annotated[
        float | None, typer.Option(help="Noise of the relative phase, for any fringes.")
    ] = None,
    noise_table: Annotated[Path | None, typer.Option(help="CSV: fringes,z_mm,sigma_rad.")] = None,
    capture: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of one of several captures of a plane; give each."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="Scene whose rig's noise is simulated; the design is then scanned."),
    ] = None,
    criterion: Annotated[str, typer.Option(help="thesis or bounded.")] = "thesis",
    safety: Annotated[
        float, typer.Option(help="thesis: the grid reaches this many times the noise.")
    ] = 2.0,
    noise_step: Annotated[
        float | None, typer.Option(help="thesis: step of the grid, rad.  [default: 1/72 of it]")
    ] = None,
    phase_model: Annotated[
        str, typer.Option(help="thesis: ideal phases, exact or as thesis eq. 27 and 28.")
    ] = "exact",
    method: Annotated[str, typer.Option(help="thesis: exact or monte-carlo.")] = "exact",
    max_order_error: Annotated[
        float, typer.Option(help="bounded: probability of any fringe-order error a pixel.")
    ] = 1e-6,
    frames: Annotated[
        int | None, typer.Option(help="bounded: frames to project; shifts are chosen too.")
    ] = None,
    max_fringes: Annotated[int | None, typer.Option(help="Most fringes of a candidate.")] = None,
    min_px_per_fringe: Annotated[float, typer.Option(help="Least pixels a fringe.")] = 5.0,
    shifts: Annotated[int, typer.Option(min=3, help="Phase shifts that the noise is for.")] = 3,
    repeats: Annotated[
        int, typer.Option(min=2, help="Captures for the noise, and of the Monte Carlo.")
    ] = 20,
    scans: Annotated[int, typer.Option(min=2, help="Scans that verify a scene's design.")] = 15,
    plot: Annotated[Path | None, typer.Option(help="Figure to write (.png, .pdf, .svg).")] = None,
    seed: Seed = 0,
    preview: Preview = False,
    as_json: Json = False,
) -> None:
    """Design the sequence of fringe sets that the phase noise of a system asks for."""
    from slbench.capture import Capture
    from slbench.design.bounded import bounded_sequence
    from slbench.design.fringe_figures import check_figure, draw
    from slbench.design.fringes import candidates, doubling, single_step, thesis_sequence, usable
    from slbench.design.noise import PhaseNoise, noise_of_captures
    from slbench.design.trial import noise_of_scene, scan_repeatedly
    from slbench.scenefile import load_scene

    sources = {
        "--noise-rad": noise_rad,
        "--noise-table": noise_table,
        "--capture": capture or None,
        "--scene": scene,
    }
    given = [name for name, value in sources.items() if value is not None]
    if len(given) != 1:
        raise InputError("noise", f"one of {', '.join(sources)}", " and ".join(given) or "none")
    if criterion not in ("thesis", "bounded"):
        raise InputError("--criterion", "thesis or bounded", criterion)
    if frames is not None and criterion == "thesis":
        raise InputError("--frames", "--criterion bounded, which spends them", "thesis")
    if plot is not None:
        check_figure(plot)
    loaded = None if scene is None else load_scene(scene, preview=preview)
    shots = [Capture.load(folder) for folder in capture or ()]
    widths = [loaded.rig.projector.width] if loaded else [s.sequence.panel[0] for s in shots[:1]]
    width = _width(width_px, widths)
    counts = candidates(width, max_fringes=max_fringes, min_px_per_fringe=min_px_per_fringe)

    begin = time.perf_counter()
    with progress(as_json) as report:
        if noise_rad is not None:
            noise = PhaseNoise.constant(noise_rad, counts, shifts)
        elif noise_table is not None:
            noise = PhaseNoise.read(noise_table, shifts)
        elif loaded is not None:
            noise = noise_of_scene(
                loaded, counts, repeats=repeats, shifts=shifts, seed=seed, on_progress=report
            )
        else:
            noise = noise_of_captures(shots)
        counts = usable(counts, noise)
        start = time.perf_counter()
        if criterion == "thesis":
            design = thesis_sequence(
                width,
                noise,
                counts,
                safety=safety,
                noise_step=noise_step,
                phase_model=phase_model,  # type: ignore[arg-type]
                method=method,  # type: ignore[arg-type]
                repeats=repeats,
                seed=seed,
                on_progress=report,
            )
        else:
            design = bounded_sequence(
                width, noise, counts, max_probability=max_order_error, frames=frames
            )
        seconds = {"noise": start - begin, "design": time.perf_counter() - start}
        others = {
            "doubling": doubling(width, noise, counts),
            "single step": single_step(width, noise, counts),
        }
        trials = []
        if loaded is not None:
            trials = scan_repeatedly(
                loaded, [design, *others.values()], repeats=scans, seed=seed, on_progress=report
            )
            seconds["scans"] = time.perf_counter() - begin - sum(seconds.values())
    if plot is not None:
        draw(design, noise, plot, others)

    if as_json:
        print_json(
            design.to_dict()
            | {
                "criterion": criterion,
                "width_px": width,
                "candidates": counts,
                "noise_rad": noise.typical_rad,
                "noise": [
                    {"fringes": n, "z_mm": noise.z_mm, "sigma_rad": row}
                    for n, row in zip(noise.fringes, noise.sigma_rad, strict=True)
                ],
                "baselines": {name: other.to_dict() for name, other in others.items()},
                "verification": [trial.to_dict() for trial in trials],
                "seconds": seconds,
            }
        )
        return
    print_table(_table(design, others))
    for trial in trials:
        text = ", ".join(map(str, trial.fringes))
        print(
            f"scanned {trial.repeats} times with {{{text}}}: {trial.std_px:.4g} px "
            f"(predicted {trial.predicted_px:.4g}, with the scene's surfaces "
            f"{trial.expected_px:.4g}), "
            f"order errors {trial.order_error_rate:.2g} "
            f"(expected {trial.expected_order_error_rate:.2g})"
        )
    if plot is not None:
        print(f"Written to {plot}")


def _width(given: int | None, known: list[int]) -> int:
    """Return the width that the user gave or a file has; both must agree."""
    if given is None:
        if not known:
            raise InputError("--width-px", "the coded panel width", "nothing")
        return known[0]
    if known and known[0] != given:
        raise InputError("--width-px", f"the panel's {known[0]} px, or nothing", given)
    return given


def _table(design: Any, others: dict[str, Any]) -> Table:
    table = Table()
    for name in ("sequence", "fringes", "shifts", "frames", "σ / px", "order errors"):
        table.add_column(name, justify="left" if name in ("sequence", "fringes") else "right")
    for name, other in {"designed": design, **others}.items():
        shifts = set(other.shifts)
        table.add_row(
            name,
            ", ".join(map(str, other.fringes)),
            ", ".join(map(str, other.shifts if len(shifts) > 1 else shifts)),
            str(other.frames),
            f"{other.sigma_px:.4g}",
            f"{other.order_error_probability:.1e}",
        )
    return table
