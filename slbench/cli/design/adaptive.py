"""``slbench design adaptive``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import Json, Seed, print_json, print_table, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import Interval, Repeats, Samples

Frames = Annotated[int, Interval(ge=9, le=500)]
Divisor = Annotated[int, Interval(ge=1, le=8)]


@command("slbench design adaptive dark-and-bright defocused --out out/adaptive")
def adaptive(
    scenes: Annotated[
        list[str] | None, typer.Argument(help="Scenes: files or names.  [default: all shipped]")
    ] = None,
    frames: Annotated[Frames, typer.Option(help="Frames of the fixed set, at most.")] = 24,
    repeats: Annotated[Repeats, typer.Option(help="Scans of each.")] = 4,
    spp: Annotated[Samples, typer.Option(help="Monte Carlo samples a pixel.")] = 8,
    divisor: Annotated[
        Divisor, typer.Option(help="Pixels of a preview that are one, along each side.")
    ] = 4,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write adaptive.json and adaptive.md to.")
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Count the frames adaptive fringes need, beside a fixed set."""
    from slbench.bench.compare.frames_needed import (
        FRAMES_FOLDER,
        frames_needed,
        table,
        write_frames_needed,
    )
    from slbench.core import resources
    from slbench.scene.file import load_scene

    if out is not None:
        FRAMES_FOLDER.check(out, "--out")
    names = scenes or resources.names("scenes")
    found, refused = [], []
    with progress(as_json) as report:
        for k, name in enumerate(names):
            scene = load_scene(name, preview=True).coarser(divisor, spp)

            def step(done: float, name: str = name, k: int = k) -> None:
                report(name, done)

            try:
                found.append(
                    frames_needed(
                        scene, frames=frames, repeats=repeats, seed=seed, on_progress=step
                    )
                )
            except InputError as error:
                if scenes:
                    raise
                refused.append((scene.name, f"expected {error.expected}, got {error.got}"))
    settings = {"frames": frames, "repeats": repeats, "spp": spp, "divisor": divisor}
    if out is not None:
        write_frames_needed(found, refused, out, settings, seed)
    if as_json:
        print_json({"scenes": [one.to_dict() for one in found], "refused": dict(refused)})
        return
    print_table(table(found, refused))
    if out is not None:
        print(f"Written to {out}")
