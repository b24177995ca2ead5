"""``slbench scene new``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.lazy import command
from slbench.cli.scene.asking import Asking
from slbench.cli.scene.output import Overwrite, check_scene_output
from slbench.core.errors import warn_user
from slbench.core.units import Unit
from slbench.core.validation.types import FINITE, Interval

#: Focal lengths, distances and ratios that there are: the least and the most.
_Lens = Annotated[float, FINITE, Interval(ge=0.5, le=5000.0)]
_Distance = Annotated[float, FINITE, Interval(ge=1e-2, le=1e6)]
_Ratio = Annotated[float, FINITE, Interval(ge=0.1, le=30.0)]
_Number = Annotated[float, FINITE, Interval(ge=0.5, le=128.0)]
_Angle = Annotated[float, FINITE, Interval(ge=0.5, le=80.0)]
_Percent = Annotated[float, FINITE, Interval(ge=-1000.0, le=1000.0)]


@command(
    "slbench scene new mine.toml --camera flir-bfs-u3-51s5m --projector ti-lightcrafter-4500 "
    "--lens-mm 25 --focus-mm 300 --throw-ratio 1.4 --baseline-mm 110 --object step-block-20"
)
def new(
    out: Annotated[Path, typer.Argument(help="The scene to write (.toml).")],
    camera: Annotated[
        str | None, typer.Option(help="A hardware file, or the name of a shipped one.")
    ] = None,
    projector: Annotated[str | None, typer.Option(help="The same of the projector.")] = None,
    lens_mm: Annotated[
        _Lens | None, typer.Option(help="Focal length of the camera's lens, by its data sheet.")
    ] = None,
    f_number: Annotated[
        _Number | None, typer.Option(help="The f-number engraved on it.  [default: 4]")
    ] = None,
    focus_mm: Annotated[
        _Distance | None,
        typer.Option(help="From the camera's lens to the object, where it is in focus."),
    ] = None,
    throw_ratio: Annotated[
        _Ratio | None, typer.Option(help="Of the projector: distance over the picture's width.")
    ] = None,
    projector_f_number: Annotated[
        _Number | None, typer.Option(help="Of the projector's lens.  [default: 2.4]")
    ] = None,
    offset_percent: Annotated[
        _Percent | None,
        typer.Option(help="Of the projector: 100 has the picture's bottom edge on the axis."),
    ] = None,
    baseline_mm: Annotated[
        _Distance | None, typer.Option(help="From the camera's lens to the projector's.")
    ] = None,
    angle_deg: Annotated[
        _Angle | None, typer.Option(help="Between the lines from the object to the lenses.")
    ] = None,
    item: Annotated[
        str | None,
        typer.Option("--object", help="A shipped artefact, or a file beside the scene."),
    ] = None,
    unit: Annotated[
        Unit | None,
        typer.Option(help="Of a mesh file.  [default: mm]"),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a scene by what data sheets and a ruler tell.

    On a terminal it asks for what is missing. `slbench scene list --hardware` and `slbench objects
    list` have the names.
    """
    import tomllib

    from slbench import __version__
    from slbench.core.io.atomic import write_bytes
    from slbench.scene.file import scene_of
    from slbench.scene.new.devices import Lenses, has_lens
    from slbench.scene.new.doubts import new_scene_doubts
    from slbench.scene.new.hardware import find_hardware
    from slbench.scene.new.place import Place
    from slbench.scene.new.scene import Item, new_scene

    check_scene_output(out, overwrite)
    asking = Asking("scene new")
    camera = asking.text(camera, "--camera", "Camera: a shipped name, or a .toml")
    eye = None if camera is None else find_hardware(camera, "camera", out.parent, "--camera")
    if eye is None or not has_lens(eye, "camera"):
        lens_mm = asking.number(lens_mm, "--lens-mm", "Focal length of its lens, mm")
    focus_mm = asking.number(focus_mm, "--focus-mm", "From its lens to the object, mm")
    projector = asking.text(projector, "--projector", "Projector: a shipped name, or a .toml")
    beam = None
    if projector is not None:
        beam = find_hardware(projector, "projector", out.parent, "--projector")
    if beam is None or not has_lens(beam, "projector"):
        ratio = "Its throw ratio, distance over width"
        throw_ratio = asking.number(throw_ratio, "--throw-ratio", ratio)
    if angle_deg is None:
        between = "From the camera's lens to the projector's, mm"
        baseline_mm = asking.number(baseline_mm, "--baseline-mm", between)
    item = asking.text(item, "--object", "Object: a shipped artefact, or a file")
    asking.check()
    assert eye is not None  # as the others, by asking.check
    assert beam is not None
    assert item is not None
    assert focus_mm is not None
    options = {
        "--camera": camera,
        "--lens-mm": lens_mm,
        "--f-number": f_number,
        "--focus-mm": focus_mm,
        "--projector": projector,
        "--throw-ratio": throw_ratio,
        "--projector-f-number": projector_f_number,
        "--offset-percent": offset_percent,
        "--baseline-mm": baseline_mm,
        "--angle-deg": angle_deg,
        "--object": item,
        "--unit": unit,
    }
    words = [word for key, v in options.items() if v is not None for word in (key, f"{v}")]
    text = new_scene(
        eye,
        beam,
        Lenses(
            lens_mm=lens_mm,
            f_number=f_number,
            throw_ratio=throw_ratio,
            projector_f_number=projector_f_number,
            offset_percent=offset_percent,
        ),
        Place(focus_mm, baseline_mm, angle_deg),
        Item(item, unit),
        out,
        f"slbench {__version__}: {shlex.join(['slbench', 'scene', 'new', out.name, *words])}",
    )
    scene = scene_of(tomllib.loads(text), out)
    for option, doubt in new_scene_doubts(scene):
        warn_user(option, doubt)
    write_bytes(out, text.encode())
    print(f"Written to {out}: draw it by slbench scene show {out} --out rig.png")
