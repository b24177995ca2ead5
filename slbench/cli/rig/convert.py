"""``slbench rig convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from slbench.cli.common import Json, print_json
from slbench.cli.lazy import command
from slbench.cli.rig.given import (
    FirstPixel,
    Order,
    PitchCamera,
    PitchProjector,
    RigUnit,
    SizeCamera,
    SizeProjector,
    stated_of,
)
from slbench.core.errors import InputError, located


@command("slbench rig convert stereo.yml rig.yaml --unit mm --size-projector 1280x800")
def convert(
    files: Annotated[
        list[Path],
        typer.Argument(help="One file or more of a rig, and at last the file to write (.yaml)."),
    ],
    to: Annotated[
        str | None,
        typer.Option(help="Write another program's format: opencv, slstudio, bouguet, ros, ..."),
    ] = None,
    unit: RigUnit = None,
    order: Order = None,
    size_camera: SizeCamera = None,
    size_projector: SizeProjector = None,
    pitch_camera: PitchCamera = None,
    pitch_projector: PitchProjector = None,
    first_pixel: FirstPixel = None,
    as_json: Json = False,
) -> None:
    """Convert a calibration of another program to a rig, or back.

    Formats are recognised by what is in the files: OpenCV's stereoCalibrate, MATLAB's
    stereoParameters, Bouguet's toolbox, SLStudio, SLMaster, Moreno and Taubin's program, ROS,
    mrcal.
    """
    from slbench.core.io import check_output_file
    from slbench.rig.files.entries import is_own, rig_entries
    from slbench.rig.files.writing import write_calibration
    from slbench.rig.opencv import rig_of, write_rig
    from slbench.rig.parameters import covariance_beside
    from slbench.rig.summary import summary_lines, summary_of

    *given, out = files
    if not given:
        raise InputError("files", "a calibration, and the file to write after it", str(out))
    if to is None:
        check_output_file(out, (".yaml", ".yml"), "the last file")
    # Who forgets it names a file of the calibration last.
    if out.exists() and not (is_own(out) and to is None):
        expected = "a new one, or a rig's of slbench" if to is None else "a new one"
        raise InputError("the last file", expected, str(out))
    sizes = {"camera": size_camera, "projector": size_projector}
    pitches = {"camera": pitch_camera, "projector": pitch_projector}
    entries = rig_entries(given, stated_of(unit, order, sizes, pitches, first_pixel))
    rig = rig_of(entries)
    alone = len(rig.pairs) == 1
    if to is None:
        write_rig(out, rig, covariance_beside(given[0]) if alone else None)
        written = [out]
    else:
        with located(given[0]):
            written = write_calibration(out, rig.pair(rig.only), to)
    summary: dict[str, Any] = summary_of(rig) if alone else {"devices": list(rig.devices)}
    if as_json:
        print_json({"format": entries.format, "files": list(map(str, written))} | summary)
        return
    for line in summary_lines(summary) if alone else ():
        print(line)
    missing = [f"--pitch-{role}" for role in sizes if f"pitch_um_{role}" not in entries.values]
    if missing and alone:
        nominal = f"{summary['camera']['pitch_um'][0]:g} µm is taken: rays do not depend on it"
        print(f"pitch: not stated ({', '.join(missing)}), {nominal}")
    print(f"Written to {', '.join(map(str, written))}, from {entries.format}")
