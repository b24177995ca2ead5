"""``slbench characterise``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import AllowModules, AllowOutside, Json, print_json, print_table, window_of
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import Grey

#: Files by whose times a capture's hour is told.
_PICTURES = {".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg"}


@command("slbench characterise run1 run2 run3 --out hardware.toml")
def characterise(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Captures of one camera and projector; of the same patterns: repeats."),
    ],
    out: Annotated[Path, typer.Option(help="File to write to (.toml).")] = Path("hardware.toml"),
    black_dn: Annotated[
        Grey | None,
        typer.Option(help="Black level, DN.  [default: by the black frames]"),
    ] = None,
    edge: Annotated[
        str | None,
        typer.Option(
            metavar="U,V,WIDTH,HEIGHT",
            help="Window of the white frame with one straight edge, turned a little, px.",
        ),
    ] = None,
    even: Annotated[
        list[Path] | None,
        typer.Option(help="Captures of a surface that is equally bright everywhere; give each."),
    ] = None,
    hours: Annotated[
        str | None,
        typer.Option(
            metavar="H,H,...",
            help='When each folder was captured, for drift: 0,0.5,1; or "files" by their times.',
        ),
    ] = None,
    picture: Annotated[
        bool, typer.Option("--picture/--no-picture", help="Draw NAME-characterise.png.")
    ] = True,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Measure what a real camera and projector are, for scenes.

    Captures may be simulated or photographed.
    """
    from slbench.calibration.characterise.hardware import hardware_output, write_hardware
    from slbench.calibration.characterise.measure import characterise as measured
    from slbench.capture.capture import Capture
    from slbench.core.io import check_output_file

    check_output_file(out, (".toml",))
    hardware_output(out).check(out.parent, "--out")
    window = None if edge is None else window_of(edge, "--edge")
    times = None if hours is None else _hours(hours, folders)
    names = [str(folder) for folder in (*folders, *(even or ()))]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError("folders", "each folder once: it is no repeat of itself", twice)
    captures = {
        name: Capture.load(name, allow_modules=allow_modules, allow_outside=allow_outside)
        for name in names
    }
    evenly = {str(folder): captures.pop(str(folder)) for folder in even or ()}
    found = measured(captures, black_dn=black_dn, edge=window, even=evenly, hours=times)
    files = {}
    if picture:
        from slbench.report.plots.characterise import write_characterisation_picture

        files[f"{out.stem}-characterise.png"] = write_characterisation_picture
    write_hardware(found, out, files)
    if as_json:
        print_json(found.to_dict() | {"out": str(out)})
        return
    print_table(found.table())
    for lost in found.untold:
        print(f"{lost.name}: not told, {lost.why}; capture {lost.capture}")
    beside = out.with_name(f"{out.stem}-characterise.png")
    print(f"Written to {out}" + (f": open {beside}" if picture else ""))


def _hours(text: str, folders: list[Path]) -> list[float]:
    """Return the hours of folders: as stated, or when their pictures were written."""
    if text.strip() == "files":
        return [_written_hours(folder) for folder in folders]
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--hours", "hours such as 0,0.5,1, or files", text) from None


def _written_hours(folder: Path) -> float:
    root = folder.parent if folder.suffix.lower() == ".toml" else folder
    times = [
        file.stat().st_mtime
        for file in root.rglob("*")
        # What is projected is no picture that the camera took.
        if file.suffix.lower() in _PICTURES and file.parent.name != "patterns"
    ]
    if not times:
        raise InputError("--hours", f"pictures in {folder}", "none")
    return min(times) / 3600.0
