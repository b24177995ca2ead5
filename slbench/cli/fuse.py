"""``slbench fuse``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.cli.common import AllowModules, Json, check_folder, print_json, print_table, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

Method = Literal["saf", "maximum", "pyramid", "modulation"]
Alignment = Literal["none", "translation", "affine", "homography"]
Variant = Literal["corrected", "published"]


@command("slbench fuse photographs --out fused.png --align affine")
def fuse(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Photographs (PNG, TIFF, JPEG) in order of their names, or a stack.toml's folder."
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Image to write (.png); of a stack: folder of the fused capture.")
    ],
    method: Annotated[
        Method,
        typer.Option(help="Of fusion; modulation is for stacks of captures."),
    ] = "saf",
    measure: Annotated[
        str, typer.Option(help="Measure of focus: variance, gradient or laplacian.")
    ] = "variance",
    align: Annotated[
        Alignment,
        typer.Option(help="Motion to undo between the frames first."),
    ] = "none",
    variant: Annotated[
        Variant,
        typer.Option(help="saf: corrected, or published (as the authors' program)."),
    ] = "corrected",
    window: Annotated[int, typer.Option(help="Window of the measure, pixels, odd.")] = 9,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Fuse photographs of different focus into one all in focus.

    Beside the image: FILE-depth.exr, the frame in focus at each pixel, counted from 0, and
    FILE-selectivity.exr, how clearly it is, dB (not for pyramid).

    A focus stack of captures (a folder with a stack.toml, as slbench scan writes it) becomes one
    capture: every pattern is fused with the weights of the lit frames.
    """
    import numpy as np

    from slbench.capture.fusion import Photographs
    from slbench.capture.fusion.measures import check_measure
    from slbench.capture.stack import MANIFEST
    from slbench.core.io import atomic_folder, write_exr, write_png

    if (folder / MANIFEST).exists():
        _fuse_stack(folder, out, method, measure, align, variant, window, allow_modules, as_json)
        return
    if method == "modulation":
        raise InputError("--method", "saf, maximum or pyramid, as these are photographs", method)
    check_measure(measure, window)
    _check_out(out, folder)
    photographs = Photographs.open(folder)
    begin = time.perf_counter()
    with progress(as_json) as report:
        image, maps, result = _fused(
            photographs.luminance, photographs, method, measure, align, variant, window, report
        )
        top = np.iinfo(photographs.dtype).max
        pixels = np.clip(np.rint(image), 0, top).astype(photographs.dtype)
        with atomic_folder(out.parent) as temporary:
            write_png(temporary / out.name, pixels)
            for name, values in maps.items():
                channels = {name: values.astype(np.float32)}
                write_exr(temporary / f"{out.stem}-{name}.exr", channels)
    result = {
        "method": method,
        "align": align,
        "frames": len(photographs),
        "height_px": photographs.shape[0],
        "width_px": photographs.shape[1],
        "channels": 1 if len(photographs.shape) == 2 else 3,
        "bit_depth": 8 * photographs.dtype.itemsize,
        **result,
        "seconds": time.perf_counter() - begin,
        "files": [str(out), *(str(out.with_name(f"{out.stem}-{name}.exr")) for name in maps)],
    }
    if as_json:
        print_json(result)
        return
    print_table(_table(result))
    print(f"Written to {', '.join(result['files'])}")


def _fuse_stack(
    folder: Path,
    out: Path,
    method: Method,
    measure: str,
    align: Alignment,
    variant: Variant,
    window: int,
    allow_modules: bool,
    as_json: bool,
) -> None:
    """Fuse a stack of captures into one, with the maps of the weights beside it."""
    import numpy as np

    from slbench.capture import fusion
    from slbench.capture.fusion.measures import check_measure
    from slbench.capture.stack import FocusStack, modulation_weights
    from slbench.core.io import atomic_folder, write_exr

    if method != "modulation":
        check_measure(measure, window)
    elif align != "none":
        raise InputError("--align", "none, as modulation has no lit frames to align", align)
    check_folder(out)
    if out.absolute().resolve().is_relative_to(folder.absolute().resolve()):
        raise InputError("--out", "a folder outside the stack's", out)
    stack = FocusStack.load(folder, allow_modules=allow_modules)
    begin = time.perf_counter()
    alignment = None
    with progress(as_json):
        if method == "modulation":
            weights: Any = modulation_weights(stack, window)
        else:
            lit: Any = stack.lit()
            if align != "none":
                alignment = fusion.align(lit, motion=align)
                lit = alignment.apply(lit)
            weights = _weights(lit, method, measure, variant, window, None)
        capture = stack.fuse_with(weights, alignment).capture
        with atomic_folder(out) as temporary:
            capture.save(temporary)
            if isinstance(weights, fusion.FusionWeights):
                maps = {
                    "focus": weights.focus,
                    "selectivity": weights.selectivity_db,
                    "noise_gain": weights.noise_gain,
                }
                channels = {name: values.astype(np.float32) for name, values in maps.items()}
                write_exr(temporary / "fusion.exr", channels)
    result = {
        "method": method,
        "align": align,
        "settings": len(stack),
        "patterns": capture.sequence.name,
        "frames": len(capture.frames),
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
    if out.suffix.lower() != ".png":
        raise InputError("--out", "a name that ends in .png", out)
    if out.is_dir():
        raise InputError("--out", "the name of a file", f"{out}, a folder")
    if out.absolute().parent.resolve() == folder.resolve():
        raise InputError("--out", "a file outside the folder that is fused", out)
    check_folder(out.parent)


def _fused(
    grey: Any,
    stack: Any,
    method: Method,
    measure: str,
    align: Alignment,
    variant: Variant,
    window: int,
    report: Any,
) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Return the fused image, maps by the name of their file, and figures for the summary.

    `grey` gives the alignment and the weights, `stack` the frames that are fused.
    """
    import numpy as np

    from slbench.capture import fusion

    summary: dict[str, Any] = {}
    if align != "none":
        alignment = fusion.align(grey, motion=align)
        grey, stack = alignment.apply(grey), alignment.apply(stack)
        summary["reference"] = alignment.reference
        summary["least_correlation"] = float(alignment.correlation.min())
    weights = _weights(grey, method, measure, variant, window, report)
    if method == "pyramid":
        return weights.fuse(stack), {}, summary
    if method == "saf":
        summary["variant"] = variant
    peak = np.isfinite(weights.focus)
    summary |= {
        "measure": measure,
        "window_px": window,
        "pixels_with_peak": float(peak.mean()),
        "median_selectivity_db": float(np.median(weights.selectivity_db)),
        "median_noise_gain": float(np.median(weights.noise_gain)),
    }
    maps = {"depth": weights.focus, "selectivity": weights.selectivity_db}
    return weights.fuse(stack), maps, summary


def _weights(
    grey: Any, method: Method, measure: str, variant: Variant, window: int, report: Any
) -> Any:
    """Return what fuses stacks like `grey` by one of the methods."""
    from slbench.capture import fusion

    if method == "pyramid":
        return fusion.pyramid_selection(grey)
    options: dict[str, Any] = {"measure": measure, "window": window, "on_progress": report}
    if method == "maximum":
        return fusion.maximum_weights(grey, **options)
    return fusion.selective_weights(grey, variant=variant, **options)


def _table(result: dict[str, Any]) -> Table:
    """Lay the summary out for people."""
    import numpy as np
    from rich.table import Table

    table = Table(title=f"{result['frames']} photographs fused: {result['method']}")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    size = f"{result['width_px']} x {result['height_px']} px"
    colour = "grey" if result["channels"] == 1 else "colour"
    rows = [("image", f"{size}, {colour}, {result['bit_depth']} bit")]
    if "reference" in result:
        found = f"frame {result['reference']}, correlation {result['least_correlation']:.3f}"
        rows.append((f"aligned ({result['align']}) with", f"{found} or better"))
    if "median_noise_gain" in result:
        selectivity = result["median_selectivity_db"]
        known = np.isfinite(selectivity)  # of fewer than five frames it is not
        rows += [
            ("pixels with a focus peak", f"{100 * result['pixels_with_peak']:.1f} %"),
            ("median selectivity", f"{selectivity:.1f} dB" if known else "-"),
            ("noise, times that of one frame", f"{result['median_noise_gain']:.2f}"),
        ]
    rows.append(("seconds", f"{result['seconds']:.2f}"))
    for row in rows:
        table.add_row(*row)
    return table
