"""Pictures for a real projector, and the manifest that reads the photographs of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import MANIFEST
from slbench.core.errors import InputError
from slbench.core.io import OutputFolder, write_png, write_toml
from slbench.core.modules import save_modules
from slbench.core.validation.types import PanelBits, Whole
from slbench.core.validation.values import checked
from slbench.patterns import PatternSequence, Response, pattern_codes

#: Where photographs are looked for, under the names of the pictures.
PHOTOGRAPHS = "photographs"
#: A projector whose light is what pictures say.
LINEAR = Response()
#: Channels of a colour picture, as a manifest names them.
CHANNELS = "rgb"
SHOWN_FOLDER = OutputFolder("patterns", ("patterns", MANIFEST, "*.py"))


@checked
def pictures(
    sequence: PatternSequence,
    *,
    bits: PanelBits = 8,
    response: Response = LINEAR,
    border_px: Whole = 0,
) -> Iterator[NDArray[np.unsignedinteger]]:
    """Make the pictures of a sequence for a projector, one a frame, or colour pictures.

    Parameters
    ----------
    sequence : PatternSequence
    bits : int
        Levels of the projector are ``2**bits``; up to 8 bits are pictures of 8 bit, more of 16 bit,
        whose top is full white.
    response : Response
        Of the projector.  Pictures are distorted by its inverse, so that the light is what the
        sequence says.
    border_px : int
        Panel pixels along every side that stay dark, and are not measured.

    Yields
    ------
    (H, W) or (H, W, 3) uint8 or uint16
        Colour where the sequence has ``crosstalk``: its channels in the order red, green, blue.

    Raises
    ------
    InputError
        For a border that leaves nothing of the panel, or more channels than a picture has.
    """
    if sequence.channels > len(CHANNELS):
        expected = f"at most {len(CHANNELS)} channels a picture"
        raise InputError("patterns: crosstalk", expected, sequence.channels)
    width, height = sequence.panel
    if 2 * border_px >= min(width, height):
        raise InputError("border_px", f"less than half of {min(width, height)} px", border_px)
    top, kind = (255, np.uint8) if bits <= 8 else (65535, np.uint16)
    levels = 2**bits - 1
    lit = np.zeros((height, width), bool)
    lit[border_px : height - border_px, border_px : width - border_px] = True

    def picture(k: int) -> NDArray[np.unsignedinteger]:
        value = np.rint(response.values(sequence.image(k)) * levels) / levels
        return np.rint(np.where(lit, value, 0.0) * top).astype(kind)

    for first in range(0, sequence.n_frames, sequence.channels):
        if sequence.crosstalk is None:
            yield picture(first)
            continue
        colour = np.zeros((height, width, len(CHANNELS)), kind)
        for i in range(sequence.channels):
            colour[..., i] = picture(first + i)
        yield colour


def write_pictures(
    sequence: PatternSequence,
    folder: str | Path,
    *,
    bits: int = 8,
    response: Response = LINEAR,
    border_px: int = 0,
) -> None:
    """Write the pictures of a sequence and a ``capture.toml`` for the photographs of them.

    Parameters
    ----------
    sequence, bits, response, border_px
        As for :func:`pictures`.
    folder : path
        Gets ``patterns/000.png`` and so on, to be projected in this order, and ``capture.toml``,
        which reads ``photographs/000.png`` and so on beside it.

    Raises
    ------
    InputError
        As :func:`pictures`, and if what slbench did not write is in the way.
    """
    channels = sequence.channels
    names = [f"{k:03d}.png" for k in range(sequence.n_frames // channels)]
    of_each = [""] if sequence.crosstalk is None else [f"#{c}" for c in CHANNELS[:channels]]
    made = pictures(sequence, bits=bits, response=response, border_px=border_px)
    parameters: dict[str, Any] = {
        "patterns": sequence.name,
        "bits": bits,
        "gamma": response.gamma,
        "curve": response.curve,
        "border_px": border_px,
    }
    with SHOWN_FOLDER.writing(folder, parameters, None) as temporary:
        (temporary / "patterns").mkdir()
        for name, picture in zip(names, made, strict=True):
            write_png(temporary / "patterns" / name, picture)
        manifest: dict[str, Any] = {
            "format": 1,
            "frames": [f"{PHOTOGRAPHS}/{name}{channel}" for name in names for channel in of_each],
            "patterns": sequence.to_dict(temporary),
        }
        origins = (pattern_codes.origin(part.kind) for part in sequence.parts)
        modules = save_modules(origins, temporary)
        if modules:
            manifest["modules"] = modules
        write_toml(temporary / MANIFEST, manifest)
