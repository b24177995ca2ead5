"""The binary-reflected Gray code (F. Gray, US patent 2632058, 1953), and the binary code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.threads import in_bands
from slbench.core.validation.types import CellOffset, CellWidth, GrayBits, Grey
from slbench.patterns.base import (
    Axis,
    Code,
    FloatArray,
    Found,
    Observed,
    Panel,
    Placed,
    Rule,
    Run,
    extent,
)

Threshold = Literal["inverse", "flats", "mean", "range"]

#: Bits at the fine end that a pixel may leave out where it decides for itself: cells of a pixel or
#: two that the lens does not resolve.  Coarser than that a place is no measurement.
SPARE_BITS = 3


@dataclass(frozen=True)
class GrayCode(Code):
    """Binary-reflected Gray code of the panel column or row, or the plain binary code.

    Column u lies in cell ``floor((u + 1/2 + offset_px) / cell_px)``.  Neighbouring cells differ in
    one bit of the Gray code, so a pixel that sees the edge between two of them is sure of the
    others, and of the edge.

    Parameters
    ----------
    axis : {"u", "v"}
        Panel axis that is coded.
    inverse : bool
        Each bit is followed by its inverse; comparing the two needs no threshold.
    code : {"reflected", "binary"}
        The Gray code, or the number of the cell itself.
    bits : int, optional
        Number of bits, most significant first; by default those that tell the cells apart.
    cell_px, offset_px : float
        Width of a cell, and of what of cell 0 lies before the panel.
    threshold : {"inverse", "flats", "mean", "range"} or float, optional
        What tells lit from unlit: the inverse frames, the mean of a white and a black frame, the
        mean of all fringe frames, the middle of the darkest and the brightest frame of the code,
        or a grey value, DN.  By default the inverses if there are any, otherwise the flats.
    complementary, shifted : bool
        One more bit, the last: the code's own of cells half as wide, or one whose edges lie in the
        middle of the cells.  (In the reflected code they are the same.)
    use_bits : "auto" or int
        Bits to decode from, from the coarse end.  By default each pixel uses as many as it decides,
        and may leave out up to three.

    Raises
    ------
    InputError
        For a value outside its range, or a threshold by inverses that are not there.
    """

    kind: ClassVar[str] = "gray"
    words: ClassVar[tuple[str, ...]] = ("gray",)

    axis: Axis = "u"
    inverse: bool = True
    code: Literal["reflected", "binary"] = "reflected"
    bits: GrayBits | None = None
    cell_px: CellWidth = 1.0
    offset_px: CellOffset = 0.0
    threshold: Threshold | Grey | None = None
    complementary: bool = False
    shifted: bool = False
    use_bits: Literal["auto"] | GrayBits = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threshold == "inverse" and not self.inverse:
            raise InputError("GrayCode: threshold", "one without inverses", '"inverse"')
        if self.complementary and self.shifted:
            raise InputError("GrayCode: shifted", "complementary or shifted", "both")

    @property
    def divides(self) -> bool:
        """Whether one more bit divides the cells."""
        return self.complementary or self.shifted

    def n_bits(self, size: int) -> int:
        """Return the number of bits on `size` columns, the one that divides the cells included."""
        last = int((size - 0.5 + self.offset_px) / self.cell_px)
        own = last.bit_length() if self.bits is None else self.bits
        return own + self.divides

    def n_frames(self, panel: Panel) -> int:
        """Return the number of bits, twice that with inverses."""
        return self.n_bits(extent(panel, self.axis)) * (2 if self.inverse else 1)

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` (most significant bit first), shape (size,), of zeros and ones."""
        bit, inverted = divmod(k, 2) if self.inverse else (k, 0)
        bits = self.n_bits(size)
        width = self.cell_px * (0.5 if self.divides else 1.0)
        cell = np.floor((np.arange(size) + 0.5 + self.offset_px) / width).astype(np.int64)
        code = cell ^ (cell >> 1) if self.reflected(size)[bit] else cell
        lit = ((code >> (bits - 1 - bit)) & 1) ^ inverted
        return lit.astype(np.float64)

    def reflected(self, size: int) -> NDArray[np.bool_]:
        """Return of each bit whether it is the Gray code's, not the binary digit, (bits,)."""
        kinds = np.full(self.n_bits(size), self.code == "reflected")
        if self.shifted:
            kinds[-1] = True
        return kinds

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for a second Gray code along the axis, or cells that it cannot tell."""
        if any(isinstance(code, GrayCode) and code.axis == self.axis for code in before):
            raise InputError("GrayCode", f"one Gray code along {self.axis}", "a second one")
        size = extent(panel, self.axis)
        if size < 2:
            raise InputError("GrayCode", "at least 2 panel pixels to code", "1")
        least = replace(self, bits=None).n_bits(size)
        if least < 1:
            raise InputError("GrayCode: cell_px", f"less than the panel's {size} px", self.cell_px)
        if self.n_bits(size) < least:
            expected = (
                f"at least {least - self.divides}, for {size} px in cells of {self.cell_px:g}"
            )
            raise InputError("GrayCode: bits", expected, self.bits)
        if self.use_bits != "auto" and self.use_bits > self.n_bits(size):
            raise InputError("GrayCode: use_bits", f"at most {self.n_bits(size)}", self.use_bits)

    def to_table(self, folder: Path | None) -> dict[str, Any]:
        """Return axis and inverse, and what is not usual."""
        own = {f.name: (getattr(self, f.name), f.default) for f in fields(self)}
        always = {"axis", "inverse"}
        return {k: value for k, (value, usual) in own.items() if k in always or value != usual}

    def may_saturate(self, k: int) -> bool:
        """Return True: a lit bit beside a dark one is decided all the same."""
        return True

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``gray``."""
        return [cls(axis)] if word == "gray" else None

    @property
    def word(self) -> str:
        """``gray``; one with keys of its own is not read back."""
        own = self.to_table(None)
        inverse = own.pop("inverse")
        del own["axis"]
        keys = [f"{key}={value}" for key, value in own.items()]
        keys += [] if inverse else ["no inverse"]
        return f"gray({', '.join(keys)})" if keys else "gray"

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError if other codes of the axis come first."""
        if before:
            where = f"decode: parts[{run.parts[0].index}]"
            expected = f"the Gray code before the other codes along {run.axes[0]}"
            raise InputError(where, expected, "after")

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Decode the one code of the run to the middles of cells.

        The standard deviation is that of a uniform error, the cell over sqrt(12).  Where not all
        bits are decided a pixel has the edge that it sees, or a wider cell
        (:func:`slbench.patterns.kernels.gray.decode_gray`).  Evidence: ``bit_contrast`` (bits, P),
        half the difference between lit and unlit of every bit, DN.
        """
        from slbench.patterns.kernels.blocks import LEAST, by_type
        from slbench.patterns.kernels.gray import decode_gray

        (placed,) = run.parts
        code = cast(GrayCode, placed.code)
        axis, pixels, noise = code.axis, observed.pixels, observed.noise
        size = extent(observed.panel, axis)
        reflected = code.reflected(size)
        inverse = code.threshold in (None, "inverse") and code.inverse
        threshold = np.zeros(1) if inverse else _threshold(observed, placed)
        width = code.cell_px * (0.5 if code.divides else 1.0)
        spare = SPARE_BITS
        if code.use_bits != "auto":
            width *= 2.0 ** (len(reflected) - code.use_bits)
            reflected, spare = reflected[: code.use_bits], 1
        n_pixels = pixels.shape[1]
        # The rules tell what is off the panel by places that are not masked.
        final = run.final and not (run.searched or observed.keep_evidence)
        place, sigma = np.empty(n_pixels), np.empty(n_pixels)
        contrast, mean = np.empty(n_pixels, np.float32), np.empty(n_pixels, np.float32)
        mask = np.empty(n_pixels, dtype=np.bool_)
        given = (
            placed.frames.start,
            2 if code.inverse else 1,
            inverse,
            reflected,
            threshold,
            np.array([width, code.offset_px, size, -0.5 - code.offset_px]),
            noise.coefficients,
            np.array([observed.min_modulation**2, observed.min_snr**2]),
            spare,
            final,
        )
        frames = by_type(pixels)
        in_bands(
            lambda start, stop: decode_gray(
                *frames, *given, place, sigma, contrast, mean, mask, start, stop
            ),
            n_pixels,
            LEAST,
        )
        evidence, dropped = {}, None
        if observed.keep_evidence:
            contrasts = _bit_contrast(observed, placed, inverse, threshold)
            evidence = {placed.index: {"bit_contrast": contrasts}}
            dropped = _dropped(observed, placed, contrasts, place, mean, mask)
        return {
            axis: Found(
                coordinate=place,
                sigma=sigma,
                modulation=contrast,
                mean=mean,
                mask=mask,
                complete=final,
                spare=True,
                evidence=evidence,
                dropped=dropped,
            )
        }


def _dropped(
    observed: Observed,
    placed: Placed,
    contrasts: FloatArray,
    place: FloatArray,
    mean: NDArray[np.float32],
    mask: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return by which rule pixels are masked out, (P,)."""
    frames = observed.pixels[placed.frames.start : placed.frames.stop]
    step = 2 if cast(GrayCode, placed.code).inverse else 1
    strongest = np.nan_to_num(contrasts).max(axis=0)
    variance = observed.noise.variance(mean.astype(np.float64))
    dim = strongest**2 < np.maximum(observed.min_modulation**2, observed.min_snr**2 * variance)
    full = ~(frames < observed.saturation)
    both = full[0::2] & full[1::2] if step == 2 else full.all(axis=0, keepdims=True)
    lit = both.any(axis=0)  # a bit whose two states are one
    rules = [Rule.SATURATED, Rule.MODULATION, Rule.END]
    found = np.select([mask, lit, dim, np.isnan(place)], [Rule.KEPT, *rules], Rule.BIT)
    return found.astype(np.uint8)


def _threshold(observed: Observed, placed: Placed) -> FloatArray:
    """Return the level between lit and unlit, (P,), or (1,) for one."""
    code = cast(GrayCode, placed.code)
    if not isinstance(code.threshold, str) and code.threshold is not None:
        return np.array([float(code.threshold)])
    if code.threshold == "range":
        own = observed.pixels[placed.frames.start : placed.frames.stop]
        return 0.5 * (own.min(axis=0).astype(np.float64) + own.max(axis=0))
    if code.threshold == "mean":
        chosen = [k for one in observed.codes for k in _even_frames(one, observed.panel)]
        if not chosen:
            expected = 'fringe frames that are even on the whole, for threshold = "mean"'
            raise InputError("decode: Gray code", expected, "none")
        return observed.pixels[chosen].mean(axis=0, dtype=np.float64)
    black, white = observed.flats(0.0), observed.flats(1.0)
    if not (black and white):
        expected = "a white and a black frame, inverses, or another threshold"
        raise InputError("decode: Gray code", expected, "none of them")
    dark, lit = (observed.pixels[k].mean(axis=0, dtype=np.float64) for k in (black, white))
    return 0.5 * (dark + lit)


def _even_frames(placed: Placed, panel: Panel) -> range:
    """Return the frames of a code whose mean is half the light at every panel place, else none."""
    code = placed.code
    if code.fringe_count(panel) is None:
        return range(0)
    size = extent(panel, code.axes[0])
    mean = np.mean([code.profile(k, size) for k in range(len(placed.frames))], axis=0)
    return placed.frames if np.abs(mean - 0.5).max() < 1e-6 else range(0)


def _bit_contrast(
    observed: Observed, placed: Placed, inverse: bool, threshold: FloatArray
) -> FloatArray:
    """Return half the difference between lit and unlit of every bit, (bits, P), DN."""
    frames = observed.pixels[placed.frames.start : placed.frames.stop].astype(np.float64)
    if inverse:
        return 0.5 * np.abs(frames[0::2] - frames[1::2])
    code = cast(GrayCode, placed.code)
    return np.abs(frames[:: 2 if code.inverse else 1] - threshold)
