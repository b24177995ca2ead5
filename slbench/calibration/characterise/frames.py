"""The frames of many captures, sorted by what they show: repeats of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.patterns.base import Code

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Shot:
    """All frames that show the same, of one setting of the camera.

    Parameters
    ----------
    code : Code
        And which of its frames.
    index : int
    panel : (int, int)
    exposure_s : float or None
    frames : tuple of (R, V, U) arrays
        In the order of the folders, DN.
    folders : tuple of str
        Where each is from.
    """

    code: Code
    index: int
    panel: tuple[int, int]
    exposure_s: float | None
    frames: tuple[NDArray[Any], ...]
    folders: tuple[str, ...]

    @property
    def level(self) -> float | None:
        """Level of a flat frame; None of others."""
        return self.code.flat_level(self.index)

    def stack(self) -> NDArray[np.float32]:
        """Return the repeats, (R, V, U)."""
        return np.stack(self.frames).astype(np.float32)


def check_alike(captures: Mapping[str, Capture]) -> None:
    """Refuse captures of different cameras: other pixels, depth or saturation.

    Raises
    ------
    InputError
        Naming the folder; also for one of several exposures.
    """
    if not captures:
        raise InputError("characterise", "at least one capture", "none")
    (first, one), *others = captures.items()
    for name, capture in captures.items():
        capture.one_exposure(name)
    for name, other in others:
        for what, a, b in (
            ("frames of", one.frames.shape[1:][::-1], other.frames.shape[1:][::-1]),
            ("a bit depth of", one.bit_depth, other.bit_depth),
            ("saturation at", one.top_dn, other.top_dn),
        ):
            if a != b:
                raise InputError(name, f"{what} {a}, as {first} has (one camera)", b)


def shots(captures: Mapping[str, Capture]) -> list[Shot]:
    """Sort the frames of captures by what they show and how long they were exposed.

    Parameters
    ----------
    captures : mapping of str to Capture
        By the name of the folder.  Pictures of several channels are left out: what a channel
        shows is not one frame.
    """
    found: dict[Any, list[tuple[NDArray[Any], str]]] = {}
    for name, capture in captures.items():
        if capture.sequence.crosstalk is not None:
            continue
        for frame, pixels in zip(capture.sequence.frames(), capture.frames, strict=True):
            # The panel's size is not part of what a flat frame shows.
            flat = frame.part.flat_level(frame.index) is not None
            panel = (0, 0) if flat else capture.sequence.panel
            key = (frame.part, frame.index, panel, capture.exposure_s)
            found.setdefault(key, []).append((pixels, name))
    return [
        Shot(
            code=part,
            index=index,
            panel=panel,
            exposure_s=exposure,
            frames=tuple(pixels for pixels, _ in own),
            folders=tuple(name for _, name in own),
        )
        for (part, index, panel, exposure), own in found.items()
    ]


def unsaturated(frames: Sequence[NDArray[Any]] | NDArray[Any], top: float) -> NDArray[np.bool_]:
    """Return where no frame of several reaches the top of the range, (V, U)."""
    good = np.ones(frames[0].shape, bool)
    for frame in frames:
        good &= (frame < top) & np.isfinite(frame)
    return good


def flats(found: Sequence[Shot]) -> dict[float | None, dict[float, Shot]]:
    """Return the flat frames by exposure and by level."""
    sorted_: dict[float | None, dict[float, Shot]] = {}
    for shot in found:
        if shot.level is not None:
            own = sorted_.setdefault(shot.exposure_s, {})
            # A level may be shown by codes of two kinds; that of more repeats counts.
            if shot.level not in own or len(own[shot.level].frames) < len(shot.frames):
                own[shot.level] = shot
    return sorted_


def repeated(found: Sequence[Shot]) -> Iterator[Shot]:
    """Yield what was shown twice or more."""
    yield from (shot for shot in found if len(shot.frames) > 1)
