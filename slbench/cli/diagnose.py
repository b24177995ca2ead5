"""``slbench diagnose``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

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
from slbench.core.validation.types import Positive


@command("slbench diagnose out/plane --shape plane --out out/diagnosis")
def diagnose(
    measured: Annotated[
        Path, typer.Argument(help="A capture of a plane or a ball: a folder with a capture.toml.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: MEASURED/diagnosis]")
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
    rig: Annotated[Path | None, typer.Option(help="Rig to triangulate with: rig.yaml.")] = None,
    gamma: Gamma = None,
    response: ResponseFile = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Say what the errors of a measured plane or ball come from."""
    from slbench.bench.diagnose.capture import diagnose_capture
    from slbench.bench.diagnose.diagnosis import DIAGNOSIS_FOLDER, write_diagnosis
    from slbench.capture.capture import Capture
    from slbench.cloud.decoded import decode_capture
    from slbench.rig.opencv import read_rig

    chosen = None if region is None else window_of(region, "--region")
    target = out or (measured if measured.is_dir() else measured.parent) / "diagnosis"
    DIAGNOSIS_FOLDER.check(target, "--out")
    shots = Capture.load(measured, allow_modules=allow_modules, allow_outside=allow_outside)
    if rig is not None:
        shots = replace(shots, rig=read_rig(rig, shots.pair))
    straight = read_response(gamma, response)
    if straight is not None:
        shots = replace(shots, response=straight)
    decoded = decode_capture(shots, where=measured)
    result = diagnose_capture(
        decoded, shape=shape, region=chosen, diameter_mm=diameter_mm, where=measured
    )
    parameters = {
        "measured": str(measured),
        "rig": str(rig) if rig else None,
        "shape": shape,
        "region": region,
        "diameter_mm": diameter_mm,
        "response": str(straight) if straight else None,
    }
    write_diagnosis(replace(result, parameters=parameters), target)
    if as_json:
        print_json(result.to_dict() | {"out": str(target)})
        return
    table = result.table()
    print_table(table)
    print(table.note)
    for sentence in result.sentences():
        print(sentence)
    print(f"Written to {target}: open {target / 'diagnosis.png'}")
