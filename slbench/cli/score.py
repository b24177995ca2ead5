"""``slbench score``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import Json, pose_of, print_json, print_table
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.units import Unit
from slbench.core.validation.types import Positive


@command("slbench score out/step-block --truth out/step-block --report out/score.html")
def score(
    measured: Annotated[
        Path,
        typer.Argument(
            help="A cloud (PLY, E57, XYZ, CSV, NPY, ...), a folder with one, or with --truth a "
            "panel map (EXR, NPZ, NPY)."
        ),
    ],
    truth: Annotated[
        Path | None, typer.Option(help="Folder of a scan: compare with its truth.")
    ] = None,
    artefact: Annotated[
        str | None, typer.Option(help="A shipped artefact, or the TOML of one.")
    ] = None,
    mesh: Annotated[Path | None, typer.Option(help="A mesh file: STL, OBJ, PLY, STEP, ...")] = None,
    unit: Annotated[
        Unit | None,
        typer.Option(help="Of the cloud.  [default: as its header says; E57: m; else mm]"),
    ] = None,
    mesh_unit: Annotated[Unit, typer.Option(help="Of the mesh file.")] = "mm",
    placed: Annotated[
        bool, typer.Option("--placed", help="The part is in the cloud's frame: do not align it.")
    ] = False,
    align: Annotated[
        bool, typer.Option("--align", help="With --truth: the cloud is in another frame.")
    ] = False,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z[,RX,RY,RZ]",
            help="About where the reference is in the cloud's frame, mm and degrees.  "
            "[default: looked for]",
        ),
    ] = None,
    expected_um: Annotated[
        Positive | None,
        typer.Option(help="Expected deviation of a point.  [default: u or sigma of the cloud]"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder to write to.  [default: scored in or beside MEASURED]"),
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    picture: Annotated[bool, typer.Option("--picture/--no-picture", help="Draw score.png.")] = True,
    as_json: Json = False,
) -> None:
    """Score any cloud against truth, an artefact or a mesh."""
    given = {"--truth": truth, "--artefact": artefact, "--mesh": mesh}
    named = [name for name, value in given.items() if value is not None]
    if len(named) != 1:
        expected = "one of --truth FOLDER, --artefact NAME and --mesh FILE"
        raise InputError("reference", expected, " and ".join(named) or "none")
    from slbench.score.clouds.scored import CLOUD_SCORE_FOLDER, score_cloud, write_cloud_score

    target = out or (measured if measured.is_dir() else measured.parent) / "scored"
    CLOUD_SCORE_FOLDER.check(target, "--out")
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    about = None if start is None else pose_of(start, "--start")
    try:
        result = score_cloud(
            measured,
            truth=truth,
            artefact=artefact,
            mesh=mesh,
            unit=unit,
            mesh_unit=mesh_unit,
            placed=placed,
            align=align,
            start=about,
            expected_um=expected_um,
        )
    except InputError as error:
        if error.where in ("placed", "align", "start", "unit", "mesh_unit"):
            option = f"--{error.where.replace('_', '-')}"
            raise InputError(option, error.expected, error.got) from None
        raise
    write_cloud_score(result, target, picture=picture)
    if page is not None:
        from slbench.report.page import write_page
        from slbench.report.pages.cloudscore import cloud_score_page

        write_page(cloud_score_page(result), page)
    if as_json:
        written = {"out": str(target)} | ({} if page is None else {"report": str(page)})
        print_json(result.to_dict() | written)
        return
    table = result.table()
    print_table(table)
    print(table.note)
    for found in result.tables():
        print_table(found)
    shown = page or (target / "score.png" if picture else None)
    print(f"Written to {target}" + (f": open {shown}" if shown else ""))
