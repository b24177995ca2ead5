"""``slbench twin``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import (
    AllowModules,
    AllowOutside,
    Json,
    Seed,
    pose_of,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.units import Unit
from slbench.core.validation.types import Bounces, Samples


@command(
    "slbench twin run --hardware hardware.toml --rig rig.yaml --object plane --out out/twin",
)
def twin(
    folder: Annotated[
        Path, typer.Argument(help="A capture of the objects; repeats in it are held out.")
    ],
    shapes: Annotated[
        list[str],
        typer.Option(
            "--object",
            help="What was measured: plane, a shipped artefact (step-block-20), a mesh file; "
            "give each, the first first.",
        ),
    ],
    hardware: Annotated[
        Path | None,
        typer.Option(help="What slbench characterise wrote.  [default: the capture's noise]"),
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig.  [default: the capture's]")] = None,
    held_out: Annotated[
        list[Path] | None,
        typer.Option(help="Another capture of the same, unmoved, to judge by; give each."),
    ] = None,
    unit: Annotated[Unit | None, typer.Option(help="Of mesh files.")] = None,
    material: Annotated[
        list[str] | None,
        typer.Option(help="Of each object, or of all.  [default: matt-white-spray]"),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z[,RX,RY,RZ]",
            help="About where the first object is, mm and degrees.  [default: looked for]",
        ),
    ] = None,
    bounces: Annotated[
        Bounces | None,
        typer.Option(help="Interreflections.  [default: 0 for a plane alone, else 2]"),
    ] = None,
    spp: Annotated[Samples, typer.Option(help="Monte Carlo samples a pixel.")] = 64,
    seed: Seed = 0,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/twin"),
    picture: Annotated[bool, typer.Option("--picture/--no-picture", help="Draw twin.png.")] = True,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Make a scene that stands for a real scanner.

    It says how far the scene is from photographs that nothing was fitted to.  Everything that runs
    on a scene runs on it: scan, compare, budget, check.
    """
    from slbench.capture.capture import Capture
    from slbench.rig.opencv import read_rig
    from slbench.rig.parameters import covariance_beside
    from slbench.twin.content import TwinObject
    from slbench.twin.twin import TWIN_FOLDER, make_twin, write_twin

    TWIN_FOLDER.check(out, "--out")
    looks = material or ["matt-white-spray"]
    if len(looks) not in (1, len(shapes)):
        raise InputError("--material", f"one, or {len(shapes)}, one for each object", len(looks))
    first = None if at is None else pose_of(at, "--at")
    objects = [
        TwinObject(
            shape=shape,
            unit=unit,
            material=looks[k if len(looks) > 1 else 0],
            start=first if k == 0 else None,
        )
        for k, shape in enumerate(shapes)
    ]
    given = {"allow_modules": allow_modules, "allow_outside": allow_outside}
    shots = Capture.load(folder, **given)
    if rig is not None:
        known = covariance_beside(rig)
        shots = replace(shots, rig=read_rig(rig, shots.pair), rig_covariance=known)
    elif shots.rig is None:
        raise InputError(folder, "a capture with its rig, or --rig rig.yaml", "none")
    others = [Capture.load(other, **given) for other in held_out or ()]
    with progress(as_json) as report:
        found = make_twin(
            shots,
            objects,
            hardware=hardware,
            held_out=others,
            bounces=bounces,
            samples=spp,
            name=out.resolve().name,
            seed=seed,
            on_progress=report,
        )
    files = {}
    if picture:
        from slbench.report.plots.twin import write_twin_picture

        files["twin.png"] = write_twin_picture
    write_twin(found, out, files)
    if as_json:
        print_json(found.to_dict() | {"out": str(out)})
        return
    for table in found.likeness.tables():
        print_table(table, left=3 if table.title == "Frames" else 1)
    misfits = found.likeness.misfits()
    print("The twin fits." if not misfits else "The twin does not fit:")
    for misfit in misfits:
        print(f"  {misfit}")
    print(f"Written to {out}: slbench scan {out / 'twin.toml'}")
