"""``slbench accept``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    Json,
    MeasuredWith,
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
from slbench.core.registry import quoted
from slbench.core.validation.types import Interval, Samples

if TYPE_CHECKING:
    from slbench.bench.accept.specification import Specification


#: Of a place: what turns past each other in a volume.
Views = Annotated[int, Interval(ge=1, le=12)]


@command(
    "slbench accept plane --mpe-um probing_size=40 --mpe-um 'sphere_spacing=30 + L/50' "
    "--measured-with calibrated.yaml --report acceptance.html"
)
def accept(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE|FOLDER", help="A scene, or a folder with places.toml.")
    ],
    standard: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND",
            help="Measure sphere, ball_bar or plane only; give each.  [default: all; those held]",
        ),
    ] = None,
    mpe_um: Annotated[
        list[str] | None,
        typer.Option(
            "--mpe-um",
            metavar="TEST=LIMIT",
            help="Maximum permissible error, µm: probing_size=20, 'length=15 + L/50'; give each.",
        ),
    ] = None,
    mpe: Annotated[
        Path | None, typer.Option(help="Limits and certificates (TOML): [mpe], [standards.KIND].")
    ] = None,
    against: Annotated[
        Path | None, typer.Option(help="Hold it to the claims.toml of an earlier acceptance.")
    ] = None,
    views: Annotated[
        Views | None, typer.Option(help="Registered views of each place.  [default: 1]")
    ] = None,
    register: Annotated[
        Literal["poses", "spheres"] | None,
        typer.Option(help="How views are registered.  [default: poses]"),
    ] = None,
    spp: Annotated[Samples | None, typer.Option(help="Monte Carlo samples a pixel.")] = None,
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Detector noise; rounding stays.")
    ] = True,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: out/accept-NAME]")
    ] = None,
    junit: Annotated[Path | None, typer.Option(help="JUnit XML to write, for CI servers.")] = None,
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    seed: Seed = 0,
    changes: SceneChanges = None,
    measured_with: MeasuredWith = None,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Accept a scanner: balls, bars and plates against limits.

    Exit status: 0 pass, 1 fail, 3 undecided.
    """
    from dataclasses import replace

    from slbench.bench.accept.acceptance import accept as run
    from slbench.bench.accept.acceptance import planned
    from slbench.bench.accept.definitions import STANDARDS, TESTS
    from slbench.bench.accept.held import (
        ACCEPTANCE_FOLDER,
        held_to,
        write_acceptance,
        write_acceptance_junit,
    )
    from slbench.core.io import check_output_file

    for kind in standard or ():
        if kind not in STANDARDS:
            raise InputError(
                "--standard", f"one of {', '.join(STANDARDS)}", quoted(kind, STANDARDS)
            )
    stated = _stated(mpe, against, mpe_um)
    folder = Path(scene)
    real = folder.is_dir()
    name = folder.resolve().name if real else ""
    if real:
        given = {
            "--standard": standard,
            "--views": views,
            "--register": register,
            "--spp": spp,
            "--no-noise": not noise,
            "--set": changes,
            "--measured-with": measured_with,
            "--preview": preview,
            "--seed": seed,
            "--allow-modules": allow_modules,
        }
        for option, value in given.items():
            if value:
                raise InputError(option, "none with a folder: it is of scenes", option)
        from slbench.bench.accept.specification import PLACES_FILE, read_specification

        views = max(
            (len(p.files) for p in read_specification(folder / PLACES_FILE).places), default=1
        )
        if mpe is not None and (own := read_specification(mpe).standards):
            expected = "limits alone with a folder: its certificates stand in places.toml"
            raise InputError(f"--mpe {mpe}", expected, ", ".join(f"[standards.{k}]" for k in own))
    else:
        views, register = views or stated.views or 1, register or stated.register or "poses"
        loaded = load_changed(
            scene,
            changes,
            preview=preview,
            allow_modules=allow_modules,
            measured_with=measured_with,
        )
        loaded = loaded if spp is None else replace(loaded, samples=spp)
        name = loaded.name
        wanted = standard or {TESTS[name].standard for name in stated.held} or STANDARDS
        kinds = tuple(kind for kind in STANDARDS if kind in wanted)
        places = planned(loaded, stated.standards, kinds=kinds, counts=stated.counts, views=views)
    if stated.held and stated.views not in (None, views):
        raise InputError("--against", f"{stated.views} views of each place, as it was held", views)
    target = out or Path("out") / f"accept-{name}"
    ACCEPTANCE_FOLDER.check(target, "--out")
    if junit is not None:
        check_output_file(junit, where="--junit")
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    with progress(as_json) as report:
        if real:
            from slbench.bench.accept.folder import accept_folder

            result = accept_folder(folder, stated, on_progress=report)
        else:
            result = run(
                loaded,
                places,
                limits=stated.limits,
                register=register or "poses",
                seed=seed,
                noise=noise,
                on_progress=report,
            )
        result = held_to(result, stated.held)
        write_acceptance(result, target)
        if junit is not None:
            write_acceptance_junit(result, junit)
        if page is not None:
            from slbench.report.page import write_page
            from slbench.report.pages.acceptance import acceptance_page

            write_page(acceptance_page(result), page)
    if as_json:
        print_json(result.to_dict() | {"out": target, "status": result.status})
    else:
        table = result.table()
        print_table(table, left=2)
        print(table.note)
        for line in (result.why(), *result.against()):
            if line:
                print(line)
        print(f"Written to {target}: open {page or target / 'acceptance.png'}")
    raise typer.Exit(result.status)


def _stated(mpe: Path | None, against: Path | None, limits: list[str] | None) -> Specification:
    """Return what files and options state: options go before files, --mpe before --against."""
    from slbench.bench.accept.specification import Specification, overridden, read_specification
    from slbench.bench.accept.verdict import read_limits

    found = Specification()
    if against is not None:
        found = read_specification(against)
        if not found.held:
            raise InputError(
                "--against", "the claims.toml of an acceptance, with [[held]]", against
            )
    if mpe is not None:
        own = read_specification(mpe)
        found = overridden(found, own)
    given = {}
    for text in limits or ():
        test, equals, limit = text.partition("=")
        if not equals:
            raise InputError("--mpe-um", "TEST=LIMIT, such as probing_size=20", text)
        given[test.strip()] = limit
    return overridden(found, Specification(limits=read_limits(given, "--mpe-um")))
