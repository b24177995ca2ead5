"""``slbench design patterns``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    AllowOutside,
    Json,
    Preview,
    SceneChanges,
    Seed,
    load_changed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import (
    FINITE,
    Frames,
    FringeCount,
    FringeWidth,
    Interval,
    LearningSeeds,
    LearningSteps,
    PanelWidth,
    PhaseDeviation,
    Proportion,
    Repeats,
    Shifts,
)

#: Of the noise to be prepared for.
Safety = Annotated[float, FINITE, Interval(ge=1.0, le=1000.0)]

#: Which options go with what: (option, what it needs).
APPLIES = {
    "noise_step": "--criterion thesis",
    "phase_model": "--criterion thesis",
    "method": "--criterion thesis",
    "mc_repeats": "--method monte-carlo",
    "max_order_error": "--criterion bounded",
    "frames": "--criterion bounded",
    "axis": "--capture",
    "estimator": "--capture",
    "repeats": "--scene",
    "scans": "--scene",
    "changes": "--scene",
    "preview": "--scene",
    "shifts": "--noise-rad, --noise-table or --scene",
    "seed": "--scene or --method monte-carlo",
    **dict.fromkeys(("data", "held_out", "binary", "against", "steps", "seeds", "out"), "--learn"),
}


@command(
    "slbench design patterns --width-px 400 --noise-rad 0.036 --noise-step 0.001 "
    "--phase-model thesis --json; slbench design patterns --learn --data data --frames 6"
)
def patterns(
    context: typer.Context,
    width_px: Annotated[
        PanelWidth | None, typer.Option(help="Coded panel width; a scene or a capture has its own.")
    ] = None,
    noise_rad: Annotated[
        PhaseDeviation | None,
        typer.Option(
            help="Noise of the relative phase, sqrt(2/N) of a frame's over b, for any fringes."
        ),
    ] = None,
    noise_table: Annotated[Path | None, typer.Option(help="CSV: fringes,z_mm,sigma_rad.")] = None,
    capture: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="<path>", help="Folder of one of several captures of a plane; give each."
        ),
    ] = None,
    axis: Annotated[
        Literal["u", "v"], typer.Option(help="capture: axis that the fringes code.")
    ] = "u",
    estimator: Annotated[
        Literal["per-pixel", "pooled"],
        typer.Option(help="capture: deviation of each pixel, or of all together."),
    ] = "per-pixel",
    scene: Annotated[
        str | None,
        typer.Option(help="Scene whose rig's noise is simulated; the design is then scanned."),
    ] = None,
    criterion: Annotated[
        Literal["thesis", "bounded"],
        typer.Option(
            help="thesis: least error over a range of noise; bounded: few wrong fringe orders."
        ),
    ] = "thesis",
    safety: Annotated[
        Safety,
        typer.Option(help="Noise to be prepared for: the grid's extent (thesis), the bound's."),
    ] = 2.0,
    noise_step: Annotated[
        PhaseDeviation | None,
        typer.Option(help="thesis: step of the grid, rad.  [default: 1/72]"),
    ] = None,
    phase_model: Annotated[
        Literal["exact", "thesis"],
        typer.Option(help="thesis: ideal phases, exact or sampled at both ends."),
    ] = "exact",
    method: Annotated[
        Literal["exact", "monte-carlo"], typer.Option(help="thesis: how errors are summed.")
    ] = "exact",
    mc_repeats: Annotated[
        Frames, typer.Option(help="monte-carlo: captures of all pixels a noise level.")
    ] = 20,
    max_order_error: Annotated[
        Proportion, typer.Option(help="bounded: probability of any fringe-order error a pixel.")
    ] = 1e-6,
    frames: Annotated[
        Frames | None, typer.Option(help="bounded: frames to project; shifts are chosen too.")
    ] = None,
    max_fringes: Annotated[FringeCount | None, typer.Option(help="Most fringes of a set.")] = None,
    min_px_per_fringe: Annotated[FringeWidth, typer.Option(help="Least pixels a fringe.")] = 5.0,
    shifts: Annotated[Shifts, typer.Option(help="Phase shifts that the noise is for.")] = 3,
    compare: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<str>",
            help="Another set to predict and scan: 1,2,4, mine.toml; give each.",
        ),
    ] = None,
    repeats: Annotated[Repeats, typer.Option(help="scene: captures for the noise.")] = 20,
    scans: Annotated[Repeats, typer.Option(help="scene: scans a sequence to verify.")] = 15,
    write_noise: Annotated[
        Path | None, typer.Option(help="CSV to write the noise to, as --noise-table reads it.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Figure to write (.png, .pdf, .svg).")] = None,
    learn: Annotated[
        bool,
        typer.Option(
            "--learn",
            help="Learn a code of --frames (6) by gradients, on --scene or --data; torch.",
        ),
    ] = False,
    data: Annotated[
        str | None, typer.Option(help="learn: data set; a quarter of its objects is held out.")
    ] = None,
    held_out: Annotated[
        list[str] | None,
        typer.Option(metavar="SCENE", help="learn: scene to judge the code on; give each."),
    ] = None,
    binary: Annotated[
        bool,
        typer.Option("--binary", help="learn: columns on or off, which the lens softens."),
    ] = False,
    against: Annotated[
        Literal["matching", "bound"],
        typer.Option(help="learn: the matching decoder's error, or the Cramér-Rao bound."),
    ] = "matching",
    steps: Annotated[LearningSteps, typer.Option(help="learn: steps of the descent.")] = 3000,
    seeds: Annotated[
        LearningSeeds, typer.Option(help="learn: so many codes, of --seed and the next.")
    ] = 1,
    out: Annotated[
        Path | None, typer.Option(help="learn: folder to write.  [default: out/learned-patterns]")
    ] = None,
    seed: Seed = 0,
    changes: SceneChanges = None,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Design fringe sets for the noise of a system, or learn a code."""
    if learn:
        from slbench.cli.design.learn import OPTIONS, run_learn

        ignored = [name for name in _given(context) if name not in OPTIONS]
        if ignored:
            option = next(one.opts[0] for one in context.command.params if one.name == ignored[0])
            raise InputError(option, "not beside --learn", "given")
        run_learn(
            scene=scene,
            data=data,
            held_out=held_out,
            frames=frames,
            max_fringes=max_fringes,
            binary=binary,
            against=against,
            steps=steps,
            seeds=seeds,
            out=out,
            scans=scans if "scans" in _given(context) else None,
            seed=seed,
            changes=changes,
            preview=preview,
            allow_modules=allow_modules,
            as_json=as_json,
        )
        return
    from slbench.capture.capture import Capture
    from slbench.core.io import check_output_file
    from slbench.design.fringes.bounded import bounded_sequence
    from slbench.design.fringes.design import (
        candidates,
        doubling,
        left_out,
        predict_text,
        sequence_table,
        single_step,
        thesis_sequence,
        usable,
    )
    from slbench.design.fringes.noise import PhaseNoise, noise_of_captures
    from slbench.design.fringes.trial import noise_of_scene, scan_repeatedly
    from slbench.report.plots.fringe_design import check_figure, draw

    sources = {
        "--noise-rad": noise_rad,
        "--noise-table": noise_table,
        "--capture": capture or None,
        "--scene": scene,
    }
    given = [name for name, value in sources.items() if value is not None]
    if len(given) != 1:
        raise InputError("noise", f"one of {', '.join(sources)}", " and ".join(given) or "none")
    chosen = [given[0], f"--criterion {criterion}"]
    _check_options(context, chosen + ([f"--method {method}"] if criterion == "thesis" else []))
    if plot is not None:
        check_figure(plot)
    if write_noise is not None:
        check_output_file(write_noise, where="--write-noise")
    loaded = None
    if scene is not None:
        loaded = load_changed(scene, changes, preview=preview, allow_modules=allow_modules)
    allowances = {"allow_modules": allow_modules, "allow_outside": allow_outside}
    shots = [Capture.load(folder, **allowances) for folder in capture or ()]
    side = "uv".index(axis)
    widths = [loaded.rig.projector.width] if loaded else [s.sequence.panel[side] for s in shots[:1]]
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
            noise = noise_of_captures(
                shots,
                axis,
                estimator=estimator,
                names=[str(folder) for folder in capture or ()],
            )
        if write_noise is not None:
            noise.write(write_noise)
        excluded = left_out(noise, counts, width)
        counts = usable(counts, noise)
        seconds = {"noise": time.perf_counter() - begin}
        _load_compiled(criterion, method)
        start = time.perf_counter()
        if criterion == "thesis":
            design = thesis_sequence(
                width,
                noise,
                counts,
                safety=safety,
                noise_step=noise_step,
                phase_model=phase_model,
                method=method,
                repeats=mc_repeats,
                seed=seed,
                on_progress=report,
            )
        else:
            design = bounded_sequence(
                width,
                noise,
                counts,
                max_probability=max_order_error,
                safety=safety,
                frames=frames,
                on_progress=report,
            )
        seconds["design"] = time.perf_counter() - start
        others = {
            "doubling": doubling(width, noise, counts),
            "single step": single_step(width, noise, counts),
        }
        for text in compare or ():
            others[text] = predict_text(
                text, width, noise, "--compare", allow_modules=allow_modules
            )
        trials = []
        if loaded is not None:
            start = time.perf_counter()
            trials = scan_repeatedly(
                loaded, [design, *others.values()], repeats=scans, seed=seed, on_progress=report
            )
            seconds["scans"] = time.perf_counter() - start
    if plot is not None:
        draw(design, noise, plot, others)

    name = design.sequence((width, width)).name
    if as_json:
        print_json(
            design.to_dict()
            | {
                "patterns": name,
                "criterion": criterion,
                "width_px": width,
                "candidates": counts,
                "left_out": excluded,
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
    print_table(sequence_table({"designed": design, **others}), left=2)
    if len(design.fringes) == 1 and len(counts) > 1:
        print("no step is worth it: more --frames (bounded) or less --safety may allow one")
    for count, why in excluded.items():
        print(f"no candidate: {count} fringes, {why}")
    for trial in trials:
        print(trial.text())
    along = f" --axes {axis}" if axis != "u" else ""
    print(f'slbench scan {scene or "SCENE"} --patterns "{name}"{along}')
    for path in (write_noise, plot):
        if path is not None:
            print(f"Written to {path}")


def _given(context: typer.Context) -> list[str]:
    """Return the names of the options that the user gave."""
    sources = {
        one.name: context.get_parameter_source(one.name or "") for one in context.command.params
    }
    return [
        name for name, source in sources.items() if source and source.name != "DEFAULT" and name
    ]


def _check_options(context: typer.Context, chosen: list[str]) -> None:
    """Refuse options that the user gave and that the chosen source, criterion or method ignores."""
    given = _given(context)
    for name, needs in APPLIES.items():
        if name not in given:
            continue
        if not any(choice in needs.replace(" or ", ", ").split(", ") for choice in chosen):
            option = next(one.opts[0] for one in context.command.params if one.name == name)
            raise InputError(option, f"only with {needs}", ", ".join(chosen))


def _load_compiled(criterion: str, method: Literal["exact", "monte-carlo"]) -> None:
    """Design a tiny case, so that loading compiled code is not in the time of the real one."""
    from slbench.design.fringes.bounded import bounded_sequence
    from slbench.design.fringes.design import thesis_sequence
    from slbench.design.fringes.noise import PhaseNoise

    tiny = PhaseNoise.constant(0.2, [1, 2, 4])
    if criterion == "bounded":
        bounded_sequence(20, tiny, [1, 2, 4])
    else:
        thesis_sequence(20, tiny, [1, 2, 4], method=method, repeats=1, noise_step=0.1)


def _width(given: int | None, known: list[int]) -> int:
    """Return the width that the user gave or a file has; both must agree."""
    if given is None:
        if not known:
            raise InputError("--width-px", "the coded panel width", "nothing")
        return known[0]
    if known and known[0] != given:
        raise InputError("--width-px", f"the panel's {known[0]} px, or nothing", given)
    return given
