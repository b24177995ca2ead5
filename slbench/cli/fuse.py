"""``slbench fuse``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slbench.cli.common import AllowModules, AllowOutside, Json, print_json, print_table, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import Finite, Interval, Measure

#: Pixels along a side of a window.
Window = Annotated[int, Interval(ge=3, le=999)]

if TYPE_CHECKING:
    from slbench.capture.fusion.photographs import FusionMethod, Scale
    from slbench.capture.stack import FocusStack


@command("slbench fuse photographs --out fused.png")
def fuse(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Photographs in order of their names (PNG, TIFF, JPEG, BMP, PGM, EXR, NPY), a TIFF"
            " of several pages, or a stack.toml's folder."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(help="Image to write (.png, .exr); of a stack: folder of the fused capture."),
    ],
    method: Annotated[
        Literal["saf", "maximum", "pyramid", "modulation"],
        typer.Option(help="Of fusion; modulation is for stacks of captures."),
    ] = "saf",
    measure: Annotated[
        str, typer.Option(help="Measure of focus: variance, gradient, laplacian, or one added.")
    ] = "variance",
    align: Annotated[
        Literal["auto", "none", "translation", "magnification", "affine", "homography"],
        typer.Option(
            help="Motion to undo between the frames first; auto: a magnification, if there is one."
        ),
    ] = "auto",
    balance: Annotated[
        bool, typer.Option(help="Bring photographs of different exposure to one brightness.")
    ] = True,
    step_um: Annotated[
        Finite | None,
        typer.Option(
            help="Photographs: rise of the focus from frame to frame; writes heights (EXR, mm)."
        ),
    ] = None,
    pixel_um: Annotated[
        Measure | None,
        typer.Option(help="With --step-um: a pixel's side on the object; writes points (PLY, mm)."),
    ] = None,
    variant: Annotated[
        Literal["corrected", "published"],
        typer.Option(help="saf: corrected, or published (as the authors' program)."),
    ] = "corrected",
    window: Annotated[Window, typer.Option(help="Window of the measure, pixels, odd.")] = 9,
    picture: Annotated[
        bool, typer.Option(help="Photographs: draw before, after and focus (FILE-summary.png).")
    ] = True,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Fuse photographs of different focus into one all in focus.

    Beside the image: FILE-summary.png, before and after; FILE-depth.exr, the frame in focus at
    each pixel, counted from 0, and FILE-selectivity.exr, how clearly it is, dB (not for pyramid).

    A focus stack of captures (a folder with a stack.toml, as slbench scan writes it) becomes one
    capture: every pattern is fused with the weights of the lit frames.
    """
    from slbench.capture.fusion.photographs import FusionMethod
    from slbench.capture.stack import FUSED_FOLDER, MANIFEST, FocusStack

    stack = None
    if (folder / MANIFEST).exists():
        if out.absolute().resolve().is_relative_to(folder.absolute().resolve()):
            raise InputError("--out", "a folder outside the stack's", out)
        FUSED_FOLDER.check(out, "--out")
        # Ahead of the measure's name, which a module of the stack may have added.
        stack = FocusStack.load(folder, allow_modules=allow_modules, allow_outside=allow_outside)
    scale = _scale(step_um, pixel_um, stack is None, method)
    if method == "modulation":
        if stack is None:
            expected = "saf, maximum or pyramid, as these are photographs"
            raise InputError("--method", expected, method)
        if align not in ("auto", "none"):
            expected = "none, as modulation has no lit frames to align"
            raise InputError("--align", expected, align)
        _fuse_stack(stack, out, window, as_json)
        return
    motion = None if align == "none" else align
    how = FusionMethod(
        name=method,
        measure=measure,
        window=window,
        variant=variant,
        motion=motion,
        balance=balance,
    )
    if stack is None:
        _fuse_photographs(folder, out, how, scale, picture, as_json)
    else:
        _fuse_stack(stack, out, how, as_json)


def _scale(
    step_um: float | None, pixel_um: float | None, photographs: bool, method: str
) -> Scale | None:
    """Return what heights and points are measured in; refuse options that go with others."""
    from slbench.capture.fusion.photographs import Scale

    if step_um is None:
        if pixel_um is not None:
            raise InputError("--pixel-um", "--step-um beside it", "none")
        return None
    if not photographs:
        raise InputError("--step-um", "photographs", "a stack of captures")
    if method == "pyramid":
        raise InputError("--step-um", "saf or maximum: a pyramid has no map of focus", method)
    if step_um == 0.0:
        raise InputError("--step-um", "a length other than 0", step_um)
    return Scale(step_um, pixel_um)


def _fuse_photographs(
    folder: Path,
    out: Path,
    how: FusionMethod,
    scale: Scale | None,
    picture: bool,
    as_json: bool,
) -> None:
    """Fuse photographs into one, with the maps of the weights beside it."""
    from slbench.capture.fusion.folder import Photographs
    from slbench.capture.fusion.photographs import fuse_photographs

    _check_out(out, folder)
    photographs = Photographs.open(folder)
    begin = time.perf_counter()
    with progress(as_json) as report:
        fused = fuse_photographs(photographs, how, report)
        fused.save(out, scale, picture=picture)
    seconds = time.perf_counter() - begin
    files = [str(path) for path in fused.files(out, scale, picture=picture)]
    if as_json:
        print_json(fused.to_dict() | {"seconds": seconds, "files": files})
        return
    print_table(fused.table(seconds))
    print(f"Written to {', '.join(files)}")


def _fuse_stack(stack: FocusStack, out: Path, how: FusionMethod | int, as_json: bool) -> None:
    """Fuse a stack of captures into one by a method, or by modulation in a window."""
    begin = time.perf_counter()
    with progress(as_json):
        if isinstance(how, int):
            method, align, fused = "modulation", None, stack.fuse("modulation", window=how)
        else:
            method, fused = how.name, stack.fuse_by(how)
            align = None if how.motion == "auto" else how.motion  # captures are warned of
        fused.save(out)
    result = {
        "method": method,
        "align": align or "none",
        "settings": len(stack),
        "patterns": fused.capture.sequence.name,
        "frames": len(fused.capture.frames),
        "seconds": time.perf_counter() - begin,
        "out": str(out),
    }
    if as_json:
        print_json(result)
        return
    for key, value in result.items():
        print(f"{key}: {value:.2f}" if isinstance(value, float) else f"{key}: {value}")


def _check_out(out: Path, folder: Path) -> None:
    """Refuse an image that cannot be written, or that would be fused the next time."""
    from slbench.capture.fusion.photographs import IMAGES, fused_output
    from slbench.core.io import check_output_file

    check_output_file(out, IMAGES)
    if out.absolute().parent.resolve() == folder.resolve():
        raise InputError("--out", "a file outside the folder that is fused", out)
    fused_output(out).check(out.parent, "--out")
