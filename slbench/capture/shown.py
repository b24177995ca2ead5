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
from slbench.core.validation.types import Gamma, PanelBits, Whole
from slbench.core.validation.values import checked
from slbench.patterns import PatternSequence, pattern_codes

#: Where photographs are looked for, under the names of the pictures.
PHOTOGRAPHS = "photographs"
SHOWN_FOLDER = OutputFolder("patterns", ("patterns", MANIFEST, "*.py"))


@checked
def pictures(
    sequence: PatternSequence, *, bits: PanelBits = 8, gamma: Gamma = 1.0, border_px: Whole = 0
) -> Iterator[NDArray[np.unsignedinteger]]:
    """Make the pictures of a sequence for a projector, one a frame.

    Parameters
    ----------
    sequence : PatternSequence
    bits : int
        Levels of the projector are ``2**bits``; up to 8 bits are pictures of 8 bit, more of 16 bit,
        whose top is full white.
    gamma : float
        Exponent of the projector: what it makes of a value v is ``v**gamma``.  Pictures are
        distorted by its inverse, so that the light is what the sequence says.
    border_px : int
        Panel pixels along every side that stay dark, and are not measured.

    Yields
    ------
    (H, W) uint8 or uint16

    Raises
    ------
    InputError
        For a border that leaves nothing of the panel.
    """
    width, height = sequence.panel
    if 2 * border_px >= min(width, height):
        raise InputError("border_px", f"less than half of {min(width, height)} px", border_px)
    top, kind = (255, np.uint8) if bits <= 8 else (65535, np.uint16)
    levels = 2**bits - 1
    for k in range(sequence.n_frames):
        value = np.rint(sequence.image(k) ** (1.0 / gamma) * levels) / levels
        if border_px:
            inside = np.zeros(value.shape, bool)
            inside[border_px:-border_px, border_px:-border_px] = True
            value[~inside] = 0.0
        yield np.rint(value * top).astype(kind)


def write_pictures(
    sequence: PatternSequence,
    folder: str | Path,
    *,
    bits: int = 8,
    gamma: float = 1.0,
    border_px: int = 0,
) -> None:
    """Write the pictures of a sequence and a ``capture.toml`` for the photographs of them.

    Parameters
    ----------
    sequence, bits, gamma, border_px
        As for :func:`pictures`.
    folder : path
        Gets ``patterns/000.png`` and so on, to be projected in this order, and ``capture.toml``,
        which reads ``photographs/000.png`` and so on beside it.

    Raises
    ------
    InputError
        As :func:`pictures`, and if what slbench did not write is in the way.
    """
    names = [f"{k:03d}.png" for k in range(sequence.n_frames)]
    made = pictures(sequence, bits=bits, gamma=gamma, border_px=border_px)
    parameters: dict[str, Any] = {
        "patterns": sequence.name,
        "bits": bits,
        "gamma": gamma,
        "border_px": border_px,
    }
    with SHOWN_FOLDER.writing(folder, parameters, None) as temporary:
        (temporary / "patterns").mkdir()
        for name, picture in zip(names, made, strict=True):
            write_png(temporary / "patterns" / name, picture)
        manifest: dict[str, Any] = {
            "format": 1,
            "frames": [f"{PHOTOGRAPHS}/{name}" for name in names],
            "patterns": sequence.to_dict(temporary),
        }
        origins = (pattern_codes.origin(part.kind) for part in sequence.parts)
        modules = save_modules(origins, temporary)
        if modules:
            manifest["modules"] = modules
        write_toml(temporary / MANIFEST, manifest)
