"""``slbench leaderboard make``."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import Json, print_json, progress
from slbench.cli.lazy import command
from slbench.core.validation.types import Interval

Workers = Annotated[int, Interval(ge=0, le=1024)]


@command("slbench leaderboard make board --preview")
def make(
    out: Annotated[Path, typer.Argument(help="Folder to write to.")],
    preview: Annotated[
        bool, typer.Option("--preview", help="50 scenes with fewer pixels: a minute or two.")
    ] = False,
    workers: Annotated[
        Workers | None,
        typer.Option(help="Worker processes; 0: this process.  [default: by this machine]"),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Finish what is there.")] = False,
    as_json: Json = False,
) -> None:
    """Make the scenes of the leaderboard and what entrants are given."""
    from slbench.datasets.make.cluster import LostError, local_cluster, workers_here
    from slbench.datasets.make.engine import check_request, make_dataset
    from slbench.datasets.make.tasks import SupersededError
    from slbench.leaderboard import frozen
    from slbench.leaderboard.board import DATA, INPUTS, INPUTS_FOLDER, open_board, write_inputs

    specification, files = frozen.frozen_specification()
    url = str((out / DATA).absolute())
    INPUTS_FOLDER.check(out / INPUTS)
    seed = frozen.SEED
    check_request(specification, files, url, seed=seed, preview=preview, resume=resume)
    try:
        with (
            local_cluster(workers_here() if workers is None else workers) as cluster,
            progress(as_json) as bar,
        ):

            def report(done: int, count: int, failed: int) -> None:
                if bar is not None:
                    bar("scenes", done / count, f"{done}/{count}, {failed} failed")

            made = make_dataset(
                specification,
                files,
                url,
                frozen.count_of(preview),
                cluster,
                seed=seed,
                preview=preview,
                resume=resume,
                on_progress=report,
            )
    except (LostError, SupersededError) as error:
        print(f"stopped: {error}; --resume makes the rest", file=sys.stderr)
        raise typer.Exit(1) from None
    board = open_board(out)
    with progress(as_json) as bar:
        write_inputs(board, None if bar is None else partial(bar, "inputs"))
    if as_json:
        print_json(made.to_dict() | {"out": str(out)})
    else:
        print(
            f"{len(board)} scenes in {out}: what entrants are given in {out / INPUTS}. "
            f"Next: slbench leaderboard score {out} PREDICTIONS"
        )
