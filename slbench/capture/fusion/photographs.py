"""Photographs fused into one, by one of the methods of this package, and what is written of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.capture.fusion.align import Alignment, Motion, align, magnified
from slbench.capture.fusion.exposure import Balanced, differ, frame_gains
from slbench.capture.fusion.folder import Luminance, Photographs, luma
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
from slbench.core.errors import InputError, warn_user
from slbench.core.io import OutputFolder, files_beside, write_exr, write_ply, write_png
from slbench.core.show.document import Cell, Table
from slbench.core.show.drawing import figure, write_figure

Progress = Callable[[str, float, str], None]

#: Names of a fused image's file: floats need EXR.
IMAGES = (".png", ".exr")
#: Exposures that differ by more are worth a warning where they are left as they are.
_UNLIKE = 1.05


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
    motion : {"auto", "translation", "magnification", "affine", "homography"} or None
        Between the frames, to be undone first; "auto" is a magnification where there is one.
    balance : bool
        Whether frames of different exposure are brought to that of the middle one.

    Raises
    ------
    InputError
        If the measure or the window is not one, ahead of the alignment, which takes long.
    """

    name: Literal["saf", "maximum", "pyramid"] = "saf"
    measure: str = "variance"
    window: int = 9
    variant: Variant = "corrected"
    motion: Motion | Literal["auto"] | None = "auto"
    balance: bool = True

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


@dataclass(frozen=True)
class Scale:
    """What heights and points are measured in.

    Parameters
    ----------
    step_um : float
        By how much the focus rises from frame to frame, towards the camera; may be negative.
    pixel_um : float or None
        Side of a pixel on the object.
    """

    step_um: float
    pixel_um: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return its numbers, for provenance."""
        return {"step_um": self.step_um, "pixel_um": self.pixel_um}


@dataclass(frozen=True, eq=False, kw_only=True)
class FusedPhotographs:
    """Photographs fused into one image.

    Parameters
    ----------
    pixels : (V, U) or (V, U, 3) ndarray
        Of the photographs' type.
    before : (V, U) or (V, U, 3) ndarray
        The photograph whose geometry and exposure the fusion has, the middle one.
    frames : int
        How many there were.
    method : FusionMethod
    alignment : Alignment or None
        What was undone.
    gains : (P,) ndarray of float64
        Factors that bring the frames to the exposure of the middle one.
    focus, selectivity_db, noise_gain : (V, U) ndarray or None
        As :class:`~slbench.capture.fusion.FusionWeights` has them; none of pyramids.
    """

    pixels: NDArray[Any]
    before: NDArray[Any]
    frames: int
    method: FusionMethod
    alignment: Alignment | None
    gains: NDArray[np.float64]
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

    def plot(self) -> Any:
        """Return a matplotlib figure: before, after, and where each pixel is in focus."""
        return figure(self)

    def heights_mm(self, step_um: float) -> NDArray[np.float64]:
        """Return heights by depth from focus, (V, U); NaN where nothing is in focus.

        Parameters
        ----------
        step_um : float
            By how much the focus rises from frame to frame, towards the camera; negative where
            it falls.

        Raises
        ------
        InputError
            For a fusion without a map of focus.
        """
        if self.focus is None:
            expected = "saf or maximum: a pyramid has no map of focus"
            raise InputError("heights", expected, self.method.name)
        return 1e-3 * step_um * self.focus

    def files(self, path: Path, scale: Scale | None = None, *, picture: bool = True) -> list[Path]:
        """Return what :meth:`save` writes, provenance last."""
        names = [f"{path.stem}-{name}.exr" for name in self.maps]
        if scale is not None:
            names.append(f"{path.stem}-heights.exr")
            names += [f"{path.stem}-points.ply"] if scale.pixel_um is not None else []
        names += [f"{path.stem}-summary.png"] if picture else []
        return [path, *map(path.with_name, [*names, fused_output(path).provenance])]

    def save(self, path: Path, scale: Scale | None = None, *, picture: bool = True) -> None:
        """Write the image, and beside it an EXR a map, a picture and provenance; all or none.

        Parameters
        ----------
        path : Path
            ``.png`` or ``.exr``; its name is that of the files beside it.
        scale : Scale, optional
            Heights too, and points where it has a pixel's size.
        picture : bool
            Whether :meth:`plot` is written, too.

        Raises
        ------
        InputError
            If the type of the pixels is not one of the file's, or as :meth:`heights_mm`.
        """
        exr = path.suffix.lower() == ".exr"
        if self.pixels.dtype.kind == "f" and not exr:
            raise InputError(path, "a name that ends in .exr for photographs of floats", path.name)
        parameters = self.to_dict() | ({} if scale is None else scale.to_dict())
        with fused_output(path).writing(path.parent, parameters, None) as temporary:
            if exr:
                names = "Y" if self.pixels.ndim == 2 else "RGB"
                layers = self.pixels.astype(np.float32).reshape(*self.pixels.shape[:2], -1)
                channels = {name: layers[:, :, k] for k, name in enumerate(names)}
                write_exr(temporary / path.name, channels)
            else:
                write_png(temporary / path.name, self.pixels)
            for name, values in self.maps.items():
                write_exr(temporary / f"{path.stem}-{name}.exr", {"Y": values})
            if scale is not None:
                heights = self.heights_mm(scale.step_um)
                values = heights.astype(np.float32)
                write_exr(temporary / f"{path.stem}-heights.exr", {"Y": values})
                if scale.pixel_um is not None:
                    self._write_points(temporary / f"{path.stem}-points.ply", heights, scale)
            if picture:
                write_figure(self, temporary / f"{path.stem}-summary.png")

    def _write_points(self, path: Path, heights: NDArray[np.float64], scale: Scale) -> None:
        """Write what is in focus somewhere as points: x right, y up, z towards the camera, mm."""
        assert scale.pixel_um is not None
        assert self.selectivity_db is not None
        v, u = np.nonzero(np.isfinite(heights))
        if u.size == 0:
            raise InputError(path.name, "pixels with a focus peak", "none")
        pitch = 1e-3 * scale.pixel_um
        points = np.stack((pitch * u, -pitch * v, heights[v, u]), axis=1)
        fields = {"grey": luma(self.pixels)[v, u], "selectivity": self.selectivity_db[v, u]}
        write_ply(path, points, fields)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the whole, for JSON."""
        method, alignment = self.method, self.alignment
        result: dict[str, Any] = {
            "method": method.name,
            "align": self._undone,
            "balanced": method.balance and differ(self.gains),
            "brightest_over_darkest": float(self.gains.max() / self.gains.min()),
            "frames": self.frames,
            "height_px": self.pixels.shape[0],
            "width_px": self.pixels.shape[1],
            "channels": 1 if self.pixels.ndim == 2 else 3,
            "bit_depth": 8 * self.pixels.dtype.itemsize,
            "floats": self.pixels.dtype.kind == "f",
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

    @property
    def _undone(self) -> str:
        """What motion was undone."""
        if self.alignment is None:
            return "none"
        return "magnification" if self.method.motion == "auto" else str(self.method.motion)

    def table(self, seconds: float) -> Table:
        """Return the same for people, with the time that it took."""
        found = self.to_dict()
        colour = "grey" if found["channels"] == 1 else "colour"
        size = f"{found['width_px']} x {found['height_px']} px"
        depth = f"{found['bit_depth']} bit" + (" floats" if found["floats"] else "")
        rows: list[tuple[Cell, ...]] = [("image", f"{size}, {colour}, {depth}")]
        if "reference" in found:
            which = f"frame {found['reference']}, correlation {found['least_correlation']:.3f}"
            rows.append((f"aligned ({found['align']}) with", f"{which} or better"))
        if differ(self.gains):
            ratio = f"{found['brightest_over_darkest']:.2f}"
            what = "balanced" if found["balanced"] else "not balanced"
            rows.append(("exposure, brightest over darkest", f"{ratio}, {what}"))
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
    alignment = undone(grey, method.motion, "photographs")
    if alignment is not None:
        grey, stack = alignment.apply(grey), alignment.apply(stack)
    middle = len(images) // 2
    whole = photographs.dtype.kind in "iu"
    gains = frame_gains(grey, middle, np.iinfo(photographs.dtype).max if whole else np.inf)
    if method.balance and differ(gains):
        grey, stack = Balanced(grey, gains), Balanced(stack, gains)
    elif gains.max() > _UNLIKE * gains.min():
        share = f"{100 * (gains.max() / gains.min() - 1):.0f} %"
        why = f"exposures differ by {share}, which shows as blotches; balance them"
        warn_user("photographs", why)
    pixels = np.empty(photographs.shape, photographs.dtype)
    common: dict[str, Any] = {
        "pixels": pixels,
        "before": images[middle],
        "gains": gains,
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


def undone(grey: Stack, motion: Motion | Literal["auto"] | None, where: str) -> Alignment | None:
    """Return the motion of a stack that is to be undone, None where there is none.

    Parameters
    ----------
    grey : Stack
    motion : {"auto", "translation", "magnification", "affine", "homography"} or None
    where : str
        What the stack is called in a warning, where "auto" finds no motion that explains it.
    """
    if motion is None or len(grey) < 2:
        return None
    if motion != "auto":
        return align(grey, motion=motion)
    try:
        return magnified(grey)
    except InputError as error:
        why = f"could not be aligned and are fused as they are ({error.where}); other scenes?"
        warn_user(where, why)
        return None


def _digitise(image: NDArray[np.float64], pixels: NDArray[Any]) -> None:
    """Write an image into pixels: as whole numbers, unless they are floats."""
    if pixels.dtype.kind == "f":
        pixels[...] = image
        return
    pixels[...] = np.clip(np.rint(image), 0, np.iinfo(pixels.dtype).max)


def fused_output(path: Path) -> OutputFolder:
    """Return the output of a fused photograph: the image and its maps beside it."""
    return files_beside("fused photograph", path)
