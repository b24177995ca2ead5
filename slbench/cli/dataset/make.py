"""``slbench dataset make``."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from slbench.cli.common import AllowModules, Json, Preview, Seed, print_json, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import Count, Interval

Workers = Annotated[int, Interval(ge=0, le=1024)]

#: How often a line tells how far a run is where there is no terminal, s.
_QUIET_S = 30.0


@command("slbench dataset make clutter --out data --count 100 --preview")
def make(
    spec: Annotated[
        str, typer.Argument(help="A specification (TOML), or the name of a shipped one.")
    ],
    out: Annotated[str, typer.Option(help="Folder or URL to write to.")],
    count: Annotated[Count, typer.Option(help="Number of samples.")],
    workers: Annotated[
        Workers | None,
        typer.Option(help="Worker processes; 0: this process.  [default: by this machine]"),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Use the cluster at this address, e.g. tcp://host:8786.")
    ] = None,
    preview: Preview = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Finish what is there, or grow it to --count.")
    ] = False,
    seed: Seed = 0,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Make a data set: draw scenes, scan them, pack them in shards."""
    from slbench.datasets.croissant import write_croissant
    from slbench.datasets.make.cluster import (
        LostError,
        existing_cluster,
        local_cluster,
        workers_here,
    )
    from slbench.datasets.make.engine import check_request, make_dataset
    from slbench.datasets.make.tasks import SupersededError
    from slbench.datasets.spec.specification import load
    from slbench.report.pages.dataset import write_card

    if scheduler is not None and workers is not None:
        raise InputError("--workers", "no number of workers beside --scheduler", workers)
    in_processes = scheduler is not None or workers != 0
    if in_processes and any(part.startswith("memory:") for part in out.split("::")):
        expected = "a place that other processes reach too, or --workers 0"
        raise InputError("--out", expected, f"{out}, which each process has of its own")
    specification, files = load(spec, allow_modules=allow_modules)
    # Ahead of the cluster, which takes seconds to start.
    check_request(specification, files, out, seed=seed, preview=preview, resume=resume)
    opened = (
        local_cluster(workers_here() if workers is None else workers)
        if scheduler is None
        else existing_cluster(scheduler)
    )
    try:
        with opened as cluster:
            if not as_json and cluster.dashboard:
                print(f"dashboard: {cluster.dashboard}", file=sys.stderr)
            with _progress(as_json) as report:
                made = make_dataset(
                    specification,
                    files,
                    _absolute(out),
                    count,
                    cluster,
                    seed=seed,
                    preview=preview,
                    resume=resume,
                    on_progress=report,
                )
        write_card(out)
        write_croissant(out)
    except (LostError, SupersededError) as error:
        print(f"stopped: {error}; --resume makes the rest", file=sys.stderr)
        raise typer.Exit(1) from None
    if as_json:
        print_json(made.to_dict() | {"out": out})
    else:
        rate = made.made / made.seconds
        rejected = f"{100.0 * made.rejection_rate:.1f} % of draws rejected; "
        print(
            f"{made.count - made.failed} samples in {out}: {made.made} made, {made.kept} kept, "
            f"{made.failed} failed; {rejected if made.failed < made.count else ''}"
            f"{rate:.2f} samples a second. Card: {out.rstrip('/')}/README.md"
        )
    if made.failed:
        print(f"{made.failed} samples failed; slbench dataset info tells why", file=sys.stderr)
        raise typer.Exit(1)


def _absolute(out: str) -> str:
    """Return a folder by its whole path: workers need not stand where this process does."""
    from slbench.datasets.store.storage import Storage

    local = Storage(out).local
    return out if local is None else str(local.absolute())


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[int, int, int], None]]:
    """Yield a callback (done, count, failed) that shows rate and time left."""
    begin = time.monotonic()
    first: list[int] = []
    spoken = [begin]
    with progress(quiet) as bar:

        def report(done: int, count: int, failed: int) -> None:
            now = time.monotonic()
            first.append(done) if not first else None
            rate = (done - first[0]) / max(now - begin, 1e-9)
            left = f"{_span((count - done) / rate)} left" if rate > 0 else "-"
            note = f"{done}/{count}, {rate:.2f}/s, {left}" + (f", {failed} failed" * bool(failed))
            if bar is not None:
                bar("samples", done / count, note)
            elif not quiet and (now - spoken[0] > _QUIET_S or done == count):
                spoken[0] = now
                print(f"samples {note}", file=sys.stderr)

        yield report


def _span(seconds: float) -> str:
    """Return a time as h:mm:ss."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"
