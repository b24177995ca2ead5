"""``slbench calibrate apply``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import AllowModules, AllowOutside, Json, MinModulation, print_json
from slbench.cli.lazy import command
from slbench.core.errors import InputError, warn_user


@command("slbench calibrate apply model.json out/coin --out cloud.ply")
def apply(
    model: Annotated[
        Path, typer.Argument(help="Model that `calibrate fit` wrote, or table of `planes`.")
    ],
    capture: Annotated[
        Path, typer.Argument(help="A folder of frames with a capture.toml beside them.")
    ],
    out: Annotated[Path, typer.Option(help="Cloud to write (.ply).")] = Path("cloud.ply"),
    inside_only: Annotated[
        bool, typer.Option("--inside-only", help="Leave out what the model would extrapolate to.")
    ] = False,
    min_modulation: MinModulation = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Decode frames; turn every pixel into a point."""
    import numpy as np

    from slbench.calibration.apply import measure, measure_by_table
    from slbench.calibration.doubts import resolution_doubt
    from slbench.calibration.models.height_table import HeightTable, is_height_table
    from slbench.calibration.models.model import CalibrationModel
    from slbench.capture.capture import Capture
    from slbench.cloud.files.write import point_fields
    from slbench.core.io import check_output_file, write_ply

    check_output_file(out, (".ply",))
    table = HeightTable.load(model) if is_height_table(model) else None
    calibration = None if table else CalibrationModel.load(model)
    shots = Capture.load(capture, allow_modules=allow_modules, allow_outside=allow_outside)
    phase = shots.decode(min_modulation=min_modulation)
    if calibration is not None:
        measured = measure(calibration, phase)
    else:
        assert table is not None  # one of both is read
        measured = measure_by_table(table, phase)
    outside = int(np.count_nonzero(measured.extrapolated))
    decoded = len(measured.cloud)
    if inside_only:
        measured = measured.inside()
    count = len(measured.cloud)
    if count == 0:
        expected = "pixels in the model's domain" if decoded else "pixels that can be decoded"
        raise InputError(capture, expected, f"none of {decoded}" if decoded else "none")
    if 2 * outside > decoded:
        share = f"{outside} of {decoded} pixels are outside the model's domain"
        why = calibration and resolution_doubt(calibration, phase.mask.shape)
        warn_user(capture, f"{share}: {why or 'another camera, or a larger object?'}")
    sigma, unsure = measured.cloud.sigma_total_mm, measured.cloud.u_total_mm
    outer = measured.extrapolated.astype(np.float64)
    fields = point_fields(measured.cloud, phase.mean) | {"extrapolated": outer}
    write_ply(out, measured.cloud.points, fields)
    result = {
        "points": count,
        "outside": outside,
        "predicted_sigma_mm": float(np.median(sigma)),
        "predicted_u_mm": float(np.median(unsure)),
        "out": str(out),
    }
    if as_json:
        print_json(result)
        return
    print(f"{count} points, {outside} of {decoded} pixels outside the model's domain", end="")
    print(" left out" if inside_only else "")
    print(
        f"standard deviation by noise {1e3 * float(np.median(sigma)):.4g} µm, "
        f"uncertainty {1e3 * float(np.median(unsure)):.4g} µm (medians)"
    )
    print(f"Written to {out}")
