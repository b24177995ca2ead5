"""``slbench patterns write``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import AllowModules, Gamma, ResponseFile, read_response
from slbench.cli.lazy import command
from slbench.cli.patterns.given import Axes, Panel, PatternText, sequence_of
from slbench.core.validation.types import PanelBits, Whole


@command('slbench patterns write "gray+16@4" --panel 1280x800 --gamma 2.2 --out session')
def write(
    patterns: PatternText,
    panel: Panel,
    out: Annotated[Path, typer.Option(help="Folder to write to.")],
    axes: Axes = "u",
    bits: Annotated[PanelBits, typer.Option(help="Of the projector; above 8: 16 bit files.")] = 8,
    gamma: Gamma = None,
    response: ResponseFile = None,
    border_px: Annotated[Whole, typer.Option(help="Panel pixels that stay dark at the ends.")] = 0,
    allow_modules: AllowModules = False,
) -> None:
    """Write pictures for a real projector, and a manifest."""
    from slbench.capture.shown import LINEAR, PHOTOGRAPHS, SHOWN_FOLDER, write_pictures

    sequence = sequence_of(patterns, panel, axes, allow_modules)
    if sequence.axes:
        sequence.runs()  # says what is missing where it cannot be decoded
    SHOWN_FOLDER.check(out, "--out")
    own = read_response(gamma, response) or LINEAR
    write_pictures(sequence, out, bits=bits, response=own, border_px=border_px)
    count = sequence.n_frames // sequence.channels
    measured = patterns.strip() == "characterisation" or not sequence.axes
    verb = "characterise" if measured else "decode"
    print(
        f"Written to {out}: project {out / 'patterns'} in order, put the {count} photographs into "
        f"{out / PHOTOGRAPHS} under the same names, then: slbench {verb} {out}"
    )
