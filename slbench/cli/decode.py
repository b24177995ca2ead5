"""``slbench decode``."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.common import (
    AllowModules,
    AllowOutside,
    Gamma,
    Json,
    MinModulation,
    ResponseFile,
    print_json,
    read_response,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import OrderResidual


@command("slbench decode out/step-block --out decoded")
def decode(
    folder: Annotated[
        Path, typer.Argument(help="A folder of frames with a capture.toml beside them.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: FOLDER/decoded]")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig to triangulate with: rig.yaml.")] = None,
    min_modulation: MinModulation = None,
    max_order_residual: Annotated[
        OrderResidual | None,
        typer.Option(
            help="Largest residual of a fringe order that is believed, turns.  "
            "[default: the capture's]"
        ),
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--report", help="Report to write too: one HTML page (.html).")
    ] = None,
    picture: Annotated[
        bool, typer.Option("--picture/--no-picture", help="Draw summary.png.")
    ] = True,
    decoder: Annotated[
        str | None,
        typer.Option(help="Decoder of your own, mine.py:decode; with --allow-modules."),
    ] = None,
    meeting: Annotated[
        Literal["ray", "nearest"],
        typer.Option(
            help="Point of two coded axes: on the camera's ray, or nearest to both rays (thesis)."
        ),
    ] = "ray",
    gamma: Gamma = None,
    response: ResponseFile = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Decode frames from disk; triangulate where a rig is known.

    The frames may be simulated or photographed.
    """
    from slbench.capture.capture import Capture
    from slbench.cloud.decoded import DECODED_FOLDER, decode_capture
    from slbench.rig.opencv import read_rig

    target = out or (folder if folder.is_dir() else folder.parent) / "decoded"
    DECODED_FOLDER.check(target, "--out")
    shots = Capture.load(folder, allow_modules=allow_modules, allow_outside=allow_outside)
    if rig is not None:
        shots = replace(shots, rig=read_rig(rig, shots.pair))
    straight = read_response(gamma, response)
    if straight is not None:
        shots = replace(shots, response=straight)
    if page is not None:
        from slbench.report.page import check_page_path

        check_page_path(page)
    own = None
    if decoder is not None:
        from slbench.patterns import read_decoder

        limits = {"--min-modulation": min_modulation, "--max-order-residual": max_order_residual}
        for name, limit in limits.items():
            if limit is not None:
                raise InputError(name, "none with --decoder, which has its own limits", limit)
        own = read_decoder(decoder, None, allow_modules, "--decoder")
    decoded = decode_capture(
        shots,
        min_modulation=min_modulation,
        max_order_residual=max_order_residual,
        decoder=own,
        meeting=meeting,
        where=folder,
    )
    parameters = {"folder": str(folder), "rig": str(rig) if rig else None, "decoder": decoder}
    parameters |= {"meeting": meeting}
    if shots.response is not None:
        parameters |= {"response": str(shots.response)}
    files = {}
    if picture:
        from slbench.report.plots.decoded import write_decoded_picture

        files["summary.png"] = partial(write_decoded_picture, decoded)
    decoded.save(target, parameters, files)
    if page is not None:
        from slbench.report.page import write_page
        from slbench.report.pages.decoded import decoded_page

        write_page(decoded_page(decoded, parameters), page)
    if as_json:
        written = {"out": str(target)} | ({} if page is None else {"report": str(page)})
        print_json(decoded.to_dict() | written)
        return
    for name, value in decoded.rows():
        print(f"{name}: {value}")
    shown = page or (target / "summary.png" if picture else None)
    print(f"Written to {target}" + (f": open {shown}" if shown else ""))
