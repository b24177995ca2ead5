"""``slbench diagnose``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    AllowOutside,
    Gamma,
    Json,
    ResponseFile,
    print_json,
    print_table,
    read_response,
    window_of,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import Positive, Shifts


@command("slbench diagnose out/plane --shape plane --out out/diagnosis")
def diagnose(
    measured: Annotated[
        Path,
        typer.Argument(
            help="A plane or a ball: a folder with a capture.toml, or a cloud (.ply; .csv of "
            "x_mm,y_mm,z_mm and perhaps sigma)."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder to write to.  [default: diagnosis in or beside MEASURED]"),
    ] = None,
    shape: Annotated[
        Literal["auto", "plane", "sphere"], typer.Option(help="What was measured.")
    ] = "auto",
    region: Annotated[
        str | None,
        typer.Option(metavar="U,V,WIDTH,HEIGHT", help="Window of camera pixels with the object."),
    ] = None,
    diameter_mm: Annotated[
        Positive | None, typer.Option(help="Of the ball, as it is certified.")
    ] = None,
    fringe_mm: Annotated[
        Positive | None,
        typer.Option(help="Of a cloud: period of the finest fringes on the object."),
    ] = None,
    shifts: Annotated[
        Shifts | None, typer.Option(help="Of a cloud: frames of the finest fringes.")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig to triangulate with: rig.yaml.")] = None,
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    gamma: Gamma = None,
    response: ResponseFile = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Say what the errors of a measured plane or ball come from."""
    from slbench.bench.diagnose.capture import diagnose_capture
    from slbench.bench.diagnose.cloud import diagnose_cloud
    from slbench.bench.diagnose.diagnosis import DIAGNOSIS_FOLDER, write_diagnosis
    from slbench.capture.capture import Capture
    from slbench.cloud.decoded import decode_capture
    from slbench.rig.opencv import read_rig

    window = None if region is None else window_of(region, "--region")
    target = out or (measured if measured.is_dir() else measured.parent) / "diagnosis"
    DIAGNOSIS_FOLDER.check(target, "--out")
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    straight = read_response(gamma, response)
    if measured.suffix.lower() in (".ply", ".csv"):
        given = {"--region": region, "--rig": rig, "--gamma": gamma, "--response": response}
        for option, value in given.items():
            if value is not None:
                raise InputError(option, "none with a cloud: it is of captures", value)
        points, fields = _cloud(measured)
        result = diagnose_cloud(
            points,
            fields,
            shape=shape,
            fringe_mm=fringe_mm,
            shifts=shifts,
            diameter_mm=diameter_mm,
            where=measured,
        )
    else:
        for option, value in {"--fringe-mm": fringe_mm, "--shifts": shifts}.items():
            if value is not None:
                raise InputError(option, "none with a capture, which states its fringes", value)
        shots = Capture.load(measured, allow_modules=allow_modules, allow_outside=allow_outside)
        if rig is not None:
            shots = replace(shots, rig=read_rig(rig, shots.pair))
        if straight is not None:
            shots = replace(shots, response=straight)
        result = diagnose_capture(
            decode_capture(shots, where=measured),
            shape=shape,
            region=window,
            diameter_mm=diameter_mm,
            where=measured,
        )
    parameters = {
        "measured": str(measured),
        "rig": str(rig) if rig else None,
        "shape": shape,
        "region": region,
        "diameter_mm": diameter_mm,
        "fringe_mm": fringe_mm,
        "shifts": shifts,
        "response": str(straight) if straight else None,
    }
    result = replace(result, parameters=parameters)
    write_diagnosis(result, target)
    if page is not None:
        from slbench.report.page import write_page
        from slbench.report.pages.diagnose import diagnosis_page

        write_page(diagnosis_page(result), page)
    if as_json:
        written = {"out": str(target)} | ({} if page is None else {"report": str(page)})
        print_json(result.to_dict() | written)
        return
    table = result.table()
    print_table(table)
    print(table.note)
    for sentence in result.sentences():
        print(sentence)
    print(f"Written to {target}: open {page or target / 'diagnosis.png'}")


def _cloud(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return the points of a cloud (N, 3), mm, and its fields."""
    from slbench.core.io import read_ply, read_table

    if path.suffix.lower() == ".ply":
        return read_ply(path)
    table = read_table(path, ("x_mm", "y_mm", "z_mm"), optional=("sigma",))
    return table[:, :3], {"sigma": table[:, 3]} if table.shape[1] > 3 else {}
