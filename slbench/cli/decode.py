"""``slbench decode``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import AllowModules, AllowOutside, Json, MinModulation, print_json
from slbench.cli.lazy import command


@command("slbench decode out/step-block --out decoded")
def decode(
    folder: Annotated[
        Path, typer.Argument(help="A folder of frames with a capture.toml beside them.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: FOLDER/decoded]")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig (OpenCV YAML) to triangulate with.")] = None,
    min_modulation: MinModulation = None,
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
    decoded = decode_capture(shots, min_modulation=min_modulation, where=folder)
    decoded.save(target, {"folder": str(folder), "rig": str(rig) if rig else None})
    result = decoded.to_dict()
    if as_json:
        print_json(result | {"out": str(target)})
        return
    for key, value in result.items():
        print(f"{key}: {'-' if value is None else value}")
    print(f"Written to {target}")
