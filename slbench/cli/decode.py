"""``slbench decode``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from slbench.cli.common import Json, check_folder, print_json
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
    min_modulation: Annotated[
        float | None,
        typer.Option(min=0.0, help="Least modulation of a valid pixel, DN; 3, or the capture's."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Decode frames from disk; triangulate where a rig is known.

    The frames may be simulated or photographed.
    """
    import numpy as np

    from slbench.capture.capture import Capture
    from slbench.cloud.triangulation import triangulate
    from slbench.core.io import atomic_folder, write_exr, write_json, write_provenance
    from slbench.rig.opencv import read_rig
    from slbench.simulate.folder import write_cloud

    target = out or (folder if folder.is_dir() else folder.parent) / "decoded"
    check_folder(target)
    shots = Capture.load(folder)
    if rig is not None:
        shots = replace(shots, rig=read_rig(rig))
    phase = shots.decode(min_modulation=min_modulation)
    channels = {
        "modulation": phase.modulation,
        "mean": phase.mean,
        "mask": phase.mask,
        **{f"panel.{axis}": values for axis, values in phase.coordinate.items()},
        **{f"sigma.{axis}": values for axis, values in phase.sigma.items()},
    }
    result: dict[str, Any] = {
        "patterns": shots.sequence.name,
        "frames": len(shots.frames),
        "valid_pixels": int(np.count_nonzero(phase.mask)),
        "points": None,
        "predicted_sigma_mm": None,
    }
    with atomic_folder(target) as temporary:
        write_exr(temporary / "phase.exr", {k: v.astype(np.float32) for k, v in channels.items()})
        if shots.rig is not None:
            cloud = triangulate(shots.rig, phase)
            result["points"] = len(cloud)
            if len(cloud):
                write_cloud(temporary / "cloud.ply", cloud)
                result["predicted_sigma_mm"] = float(np.median(cloud.sigma_total_mm))
        write_json(temporary / "decode.json", result)
        write_provenance(temporary, {"folder": str(folder), "rig": str(rig) if rig else None}, None)
    if as_json:
        print_json(result | {"out": str(target)})
        return
    for key, value in result.items():
        print(f"{key}: {'-' if value is None else value}")
    print(f"Written to {target}")
