"""Photographs fused into one, by one of the methods of this package, and what is written of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.capture.fusion.align import Alignment, Motion, align
from slbench.capture.fusion.folder import Luminance, Photographs
from slbench.capture.fusion.measures import check_measure
from slbench.capture.fusion.pyramid import PyramidSelection, pyramid_selection
from slbench.capture.fusion.selective import (
    FusionWeights,
    Variant,
    check_variant,
    maximum_bands,
    maximum_weights,
    selective_bands,
    selective_weights,
)
from slbench.capture.fusion.stack import Band, Banded, Kept, Stack, banded, frames
from slbench.core.io import OutputFolder, files_beside, write_exr, write_png
from slbench.core.show.document import Cell, Table

Progress = Callable[[str, float, str], None]


@dataclass(frozen=True, kw_only=True)
class FusionMethod:
    """How to fuse a stack of images.

    Parameters
    ----------
    name : {"saf", "maximum", "pyramid"}
        Selective all-in-focus fusion, the frame of largest measure, or a Laplacian pyramid.
    measure : str
        Of focus; not for pyramids.
    window : int
        Side of the measure's window, pixels, odd.
    variant : {"corrected", "published"}
        Of selective fusion.
    motion : {"translation", "affine", "homography"} or None
        Between the frames, to be undone first.

    Raises
    ------
    InputError
        If the measure or the window is not one, ahead of the alignment, which takes long.
    """

    name: Literal["saf", "maximum", "pyramid"] = "saf"
    measure: str = "variance"
    window: int = 9
    variant: Variant = "corrected"
    motion: Motion | None = None

    def __post_init__(self) -> None:
        check_measure(self.measure, self.window)

    def weights(
        self, grey: Stack, on_progress: Progress | None = None
    ) -> FusionWeights | PyramidSelection:
        """Return what fuses every stack that was focused like `grey`."""
        if self.name == "pyramid":
            return pyramid_selection(grey)
        options: dict[str, Any] = {
            "measure": self.measure,
            "window": self.window,
            "on_progress": on_progress,
        }
        if self.name == "maximum":
            return maximum_weights(grey, **options)
        return selective_weights(grey, variant=self.variant, **options)

    def bands(
        self, grey: Banded, on_progress: Progress | None = None
    ) -> Iterator[tuple[int, FusionWeights]]:
        """Yield the same weights by bands of rows, each with its first row; not of pyramids."""
        options: dict[str, Any] = {
            "measure": self.measure,
            "window": self.window,
            "on_progress": on_progress,
        }
        if self.name == "maximum":
            return maximum_bands(grey, **options)
        return selective_bands(grey, published=check_variant(self.variant, len(grey)), **options)


@dataclass(frozen=True, eq=False, kw_only=True)
class FusedPhotographs:
    """Photographs fused into one image.

    Parameters
    ----------
    pixels : (V, U) or (V, U, 3) uint8 or uint16
        As deep as the photographs.
    frames : int
        How many there were.
    method : FusionMethod
    alignment : Alignment or None
    focus, selectivity_db, noise_gain : (V, U) ndarray or None
        As :class:`~slbench.capture.fusion.FusionWeights` has them; none of pyramids.
    """

    pixels: NDArray[Any]
    frames: int
    method: FusionMethod
    alignment: Alignment | None
    focus: NDArray[np.float64] | None = None
    selectivity_db: NDArray[np.float64] | None = None
    noise_gain: NDArray[np.float64] | None = None

    @property
    def maps(self) -> dict[str, NDArray[np.float32]]:
        """Frame in focus at each pixel, counted from 0, and selectivity, dB; none of pyramids."""
        if self.focus is None or self.selectivity_db is None:
            return {}
        return {
            "depth": self.focus.astype(np.float32),
            "selectivity": self.selectivity_db.astype(np.float32),
        }

    def files(self, path: Path) -> list[Path]:
        """Return what :meth:`save` writes."""
        maps = [f"{path.stem}-{name}.exr" for name in self.maps]
        return [path, *map(path.with_name, [*maps, fused_output(path).provenance])]

    def save(self, path: Path) -> None:
        """Write the image (.png), and beside it an EXR a map and provenance; all or none."""
        with fused_output(path).writing(path.parent, self.to_dict(), None) as temporary:
            image, *maps, _ = self.files(temporary / path.name)
            write_png(image, self.pixels)
            for file, (name, values) in zip(maps, self.maps.items(), strict=True):
                write_exr(file, {name: values})

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the whole, for JSON."""
        method, alignment = self.method, self.alignment
        result: dict[str, Any] = {
            "method": method.name,
            "align": method.motion or "none",
            "frames": self.frames,
            "height_px": self.pixels.shape[0],
            "width_px": self.pixels.shape[1],
            "channels": 1 if self.pixels.ndim == 2 else 3,
            "bit_depth": 8 * self.pixels.dtype.itemsize,
        }
        if alignment is not None:
            result["reference"] = alignment.reference
            result["least_correlation"] = float(alignment.correlation.min())
        if method.name == "saf":
            result["variant"] = method.variant
        if (
            self.focus is not None
            and self.selectivity_db is not None
            and self.noise_gain is not None
        ):
            result |= {
                "measure": method.measure,
                "window_px": method.window,
                "pixels_with_peak": float(np.isfinite(self.focus).mean()),
                "median_selectivity_db": float(np.median(self.selectivity_db)),
                "median_noise_gain": float(np.median(self.noise_gain)),
            }
        return result

    def table(self, seconds: float) -> Table:
        """Return the same for people, with the time that it took."""
        found = self.to_dict()
        colour = "grey" if found["channels"] == 1 else "colour"
        size = f"{found['width_px']} x {found['height_px']} px"
        rows: list[tuple[Cell, ...]] = [("image", f"{size}, {colour}, {found['bit_depth']} bit")]
        if "reference" in found:
            which = f"frame {found['reference']}, correlation {found['least_correlation']:.3f}"
            rows.append((f"aligned ({found['align']}) with", f"{which} or better"))
        if "median_noise_gain" in found:
            selectivity = found["median_selectivity_db"]
            known = np.isfinite(selectivity)  # of fewer than five frames it is not
            rows += [
                ("pixels with a focus peak", f"{100 * found['pixels_with_peak']:.1f} %"),
                ("median selectivity", f"{selectivity:.1f} dB" if known else "-"),
                ("noise, times that of one frame", f"{found['median_noise_gain']:.2f}"),
            ]
        rows.append(("seconds", f"{seconds:.2f}"))
        title = f"{self.frames} photographs fused: {found['method']}"
        return Table(title, ("quantity", "value"), tuple(rows))


def fuse_photographs(
    photographs: Photographs, method: FusionMethod, on_progress: Progress | None = None
) -> FusedPhotographs:
    """Fuse photographs taken at different focus into one that is in focus everywhere.

    Parameters
    ----------
    photographs : Photographs
        Their luminance gives alignment and weights, their pixels are fused.
    method : FusionMethod
    on_progress : callable, optional
        Called with a stage, a fraction and a note.

    Returns
    -------
    FusedPhotographs
    """
    # Read once, and held as deep as they are: all else is done by bands of rows.
    images = list(frames(photographs, colour=True))
    grey: Any = Luminance(images)
    stack: Any = images
    alignment = None
    if method.motion is not None:
        alignment = align(grey, motion=method.motion)
        grey, stack = alignment.apply(grey), alignment.apply(stack)
    pixels = np.empty(photographs.shape, photographs.dtype)
    common: dict[str, Any] = {
        "pixels": pixels,
        "frames": len(photographs),
        "method": method,
        "alignment": alignment,
    }
    if method.name == "pyramid":
        _digitise(pyramid_selection(grey).fuse(stack), pixels)
        return FusedPhotographs(**common)
    focus, selectivity, noise_gain = np.empty((3, *pixels.shape[:2]))
    grey_bands = Kept(banded(grey))
    bands = grey_bands if len(photographs.shape) == 2 else banded(stack, colour=True)
    for top, weights in method.bands(grey_bands, on_progress):
        bottom = top + len(weights.focus)
        rows = slice(top, bottom)
        _digitise(weights.fuse(Band(bands, top, bottom)), pixels[rows])
        focus[rows], selectivity[rows] = weights.focus, weights.selectivity_db
        noise_gain[rows] = weights.noise_gain
    return FusedPhotographs(
        **common, focus=focus, selectivity_db=selectivity, noise_gain=noise_gain
    )


def _digitise(image: NDArray[np.float64], pixels: NDArray[Any]) -> None:
    """Write an image as whole numbers of the pixels' type."""
    pixels[...] = np.clip(np.rint(image), 0, np.iinfo(pixels.dtype).max)


def fused_output(path: Path) -> OutputFolder:
    """Return the output of a fused photograph: the image and its maps beside it."""
    return files_beside("fused photograph", path)
