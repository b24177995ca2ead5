"""The binary-reflected Gray code (F. Gray, US patent 2632058, 1953) of panel columns or rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import ClassVar, Self, cast

import numpy as np

from slbench.core.errors import InputError
from slbench.core.threads import in_bands
from slbench.patterns.base import (
    Axis,
    Code,
    FloatArray,
    Found,
    Observed,
    Panel,
    Placed,
    Run,
    extent,
)


@dataclass(frozen=True)
class GrayCode(Code):
    """Binary-reflected Gray code of the panel column or row.

    Neighbouring columns differ in one bit, so a pixel that sees the edge between two of
    them reads one or the other, never a third.

    Parameters
    ----------
    axis : {"u", "v"}
        Panel axis that is coded.
    inverse : bool
        Follow each bit by its inverse; comparing the two needs no threshold.

    Raises
    ------
    InputError
        For an unknown axis or an `inverse` that is not a bool.
    """

    kind: ClassVar[str] = "gray"
    words: ClassVar[tuple[str, ...]] = ("gray",)

    axis: Axis = "u"
    inverse: bool = True

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The coded axis."""
        return (self.axis,)

    def n_bits(self, size: int) -> int:
        """Return the number of bits that tell `size` columns apart, ceil(log2(size))."""
        return (size - 1).bit_length()

    def n_frames(self, panel: Panel) -> int:
        """Return the number of bits, twice that with inverses."""
        return self.n_bits(extent(panel, self.axis)) * (2 if self.inverse else 1)

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` (most significant bit first), shape (size,), of zeros and ones."""
        bit, inverted = divmod(k, 2) if self.inverse else (k, 0)
        column = np.arange(size)
        code = column ^ (column >> 1)
        lit = ((code >> (self.n_bits(size) - 1 - bit)) & 1) ^ inverted
        return lit.astype(np.float64)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for a second Gray code along the axis or a panel of one column."""
        if any(isinstance(code, GrayCode) and code.axis == self.axis for code in before):
            raise InputError("GrayCode", f"one Gray code along {self.axis}", "a second one")
        if extent(panel, self.axis) < 2:
            raise InputError("GrayCode", "at least 2 panel pixels to code", "1")

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``gray``."""
        return [cls(axis)] if word == "gray" else None

    @property
    def word(self) -> str:
        """``gray``; without inverses it is not read back."""
        return "gray" if self.inverse else "gray(no inverse)"

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError if other codes of the axis come first."""
        if before:
            where = f"decode: parts[{run.parts[0].index}]"
            expected = f"the Gray code before the fringes along {run.axes[0]}"
            raise InputError(where, expected, "after")

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Decode the one code of the run to whole columns.

        The standard deviation is 1 / sqrt(12), that of a uniform error.  Evidence:
        ``bit_contrast`` (bits, P), half the difference between lit and unlit of every bit, DN.
        """
        from slbench.patterns.kernels.blocks import LEAST, by_type
        from slbench.patterns.kernels.gray import decode_gray

        (placed,) = run.parts
        code = cast(GrayCode, placed.code)
        axis, pixels, noise = code.axis, observed.pixels, observed.noise
        size = extent(observed.panel, axis)
        bits, first = code.n_bits(size), placed.frames.start
        threshold = np.empty(0) if code.inverse else _threshold(observed)
        n_pixels = pixels.shape[1]
        column, mask = np.empty(n_pixels), np.empty(n_pixels, dtype=np.bool_)
        contrast, mean = np.empty(n_pixels, np.float32), np.empty(n_pixels, np.float32)
        frames = by_type(pixels)
        given = (
            first,
            bits,
            code.inverse,
            threshold,
            float(size),
            np.array([noise.constant_variance, noise.gain_dn_per_e, noise.offset_dn]),
            np.array([observed.min_modulation**2, observed.min_snr**2]),
        )
        in_bands(
            lambda start, stop: decode_gray(
                *frames, *given, column, contrast, mean, mask, start, stop
            ),
            n_pixels,
            LEAST,
        )
        evidence = {}
        if observed.keep_evidence:
            contrasts = _bit_contrast(observed, placed, code.inverse, threshold)
            evidence = {placed.index: {"bit_contrast": contrasts}}
        return {
            axis: Found(
                coordinate=column,
                sigma=np.broadcast_to(np.float64(1.0 / sqrt(12.0)), column.shape),
                modulation=contrast,
                mean=mean,
                mask=mask,
                evidence=evidence,
            )
        }


def _threshold(observed: Observed) -> FloatArray:
    """Return the level between white and black frames, (P,)."""
    black, white = observed.flats(0.0), observed.flats(1.0)
    if not (black and white):
        raise InputError(
            "decode: Gray code without inverses", "a white and a black frame", "not both"
        )
    dark, lit = (observed.pixels[k].mean(axis=0, dtype=np.float64) for k in (black, white))
    return 0.5 * (dark + lit)


def _bit_contrast(
    observed: Observed, placed: Placed, inverse: bool, threshold: FloatArray
) -> FloatArray:
    """Return half the difference between lit and unlit of every bit, (bits, P), DN."""
    frames = observed.pixels[placed.frames.start : placed.frames.stop].astype(np.float64)
    if inverse:
        return 0.5 * np.abs(frames[0::2] - frames[1::2])
    return np.abs(frames - threshold)
