"""``slbench leaderboard score``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import Json, print_json, print_table, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError


@command("slbench leaderboard score board my-network --baseline closed-form")
def score(
    board: Annotated[Path, typer.Argument(help="What `slbench leaderboard make` wrote.")],
    predictions: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of predictions: TASK/000123.npy or .exr for each scene."),
    ] = None,
    baseline: Annotated[
        list[str] | None,
        typer.Option(help="Score a baseline too: closed-form.  Repeat for others."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write scores (.json) or tables (.md) to a file too.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Score predictions on the scenes of the leaderboard."""
    from slbench.core.io import check_output_file, write_json
    from slbench.core.io.atomic import atomic_path
    from slbench.core.registry import quoted
    from slbench.leaderboard.baselines import BASELINES
    from slbench.leaderboard.board import open_board
    from slbench.leaderboard.predictions import read_predictions
    from slbench.leaderboard.scoring import of_baseline, of_folder, score_entries, tables

    if out is not None:
        check_output_file(out, (".json", ".md"))
    known = list(BASELINES)
    for name in baseline or ():
        if name not in BASELINES:
            raise InputError("--baseline", f"one of {', '.join(known)}", quoted(name, known))
    scenes = open_board(board)
    entries = [of_folder(read_predictions(folder, scenes.keys)) for folder in predictions or ()]
    entries += [of_baseline(name) for name in baseline or ()]
    names = [name for name, _, _ in entries]
    if not names:
        raise InputError("PREDICTIONS", "a folder, or --baseline closed-form", "none")
    if len(set(names)) < len(names):
        raise InputError("PREDICTIONS", "entries of different names", ", ".join(names))
    with progress(as_json) as bar:
        results = score_entries(scenes, entries, None if bar is None else partial(bar, "score"))
    made = tables(results)
    manifest = scenes.data.manifest
    values = {
        "specification": manifest.name,
        "preview": manifest.preview,
        "scenes": len(scenes),
        "results": [result.to_dict() for result in results],
    }
    if out is not None and out.suffix.lower() == ".json":
        write_json(out, values)
    elif out is not None:
        with atomic_path(out) as temporary:
            temporary.write_text("\n".join(table.markdown() for table in made), encoding="utf-8")
    if as_json:
        print_json(values | ({} if out is None else {"out": str(out)}))
        return
    for table in made:
        print_table(table)
    print(f"Means over {len(scenes)} scenes with 95 % intervals of the bootstrap over scenes.")
