"""Frames of different exposure brought to the brightness of one of them.

An automatic exposure gives every frame of a focus stack a gain of its own, and where frames take
turns in a fused picture that shows as blotches, on plain surface most of all.  Blur moves light
but keeps it: means over blocks much wider than the blur have the ratio of the exposures, whatever
is in focus.  The ratio of two frames is the median over the blocks in which neither reaches the
top of its range.  A camera's encoding by a power law keeps it one factor.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.capture.fusion.stack import Banded, Stack, banded, frames

FloatArray = NDArray[np.float64]

_BLOCKS = 48  # along the longer side
_TOP = 0.98  # of the range: values from here on may be clipped
_DARK = 0.2  # of the mean of the reference: below, black level and stray light have a say
_LEAST_BLOCKS = 16
_SURE = 4.0  # deviations of a median by which a ratio must differ from 1
_LEAST_RATIO = 1.01  # of the brightest to the darkest frame; less shows nowhere


def frame_gains(stack: Stack, reference: int, top: float) -> FloatArray:
    """Return the factor that brings each frame to the exposure of a reference frame.

    Parameters
    ----------
    stack : Stack
        P frames (V, U), aligned, read once each.
    reference : int
        The frame whose factor is 1.
    top : float
        Largest value that a frame can have; infinite for floats without a limit.

    Returns
    -------
    (P,) ndarray of float64
        1 for a frame that does not surely differ, or has too few blocks to tell by: too dark,
        or clipped.
    """
    means, clipped = [], []
    for frame in frames(stack):
        height, width = frame.shape
        ratio = min(1.0, _BLOCKS / max(height, width))
        size = (max(1, round(ratio * width)), max(1, round(ratio * height)))
        means.append(cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_AREA))
        over = (frame >= _TOP * top).astype(np.float32)
        clipped.append(cv2.resize(over, size, interpolation=cv2.INTER_AREA) > 0)
    wanted = means[reference].astype(np.float64)
    bright = (wanted > _DARK * wanted.mean()) & ~clipped[reference]
    gains = np.ones(len(means))
    for p, (mean, over) in enumerate(zip(means, clipped, strict=True)):
        told = bright & ~over & (mean > 0)
        if p == reference or told.sum() < min(_LEAST_BLOCKS, wanted.size):
            continue
        ratios = wanted[told] / mean[told]
        middle = np.median(ratios)
        # Of normal values: the deviation is 1.48 MAD, that of the median 1.25 times a mean's.
        spread = 1.48 * 1.25 * np.median(np.abs(ratios - middle)) / np.sqrt(ratios.size)
        if abs(middle - 1.0) > _SURE * spread:
            gains[p] = middle
    return gains


def differ(gains: FloatArray) -> bool:
    """Return whether exposures differ by more than shows nowhere."""
    return bool(gains.max() > _LEAST_RATIO * gains.min())


@dataclass(frozen=True)
class Balanced:
    """A stack whose frames are multiplied by factors when they are asked for."""

    stack: Stack
    gains: FloatArray

    def __len__(self) -> int:
        return len(self.stack)

    def __getitem__(self, index: int) -> NDArray[np.float32]:
        return _scaled(np.asarray(self.stack[index]), self.gains[index])

    def banded(self) -> Banded:
        """Return the same by bands of rows."""
        return _BalancedBands(banded(self.stack, colour=True), self.gains)


class _BalancedBands:
    """Balanced frames by bands of rows."""

    def __init__(self, whole: Banded, gains: FloatArray) -> None:
        self._whole, self._gains, self.shape = whole, gains, whole.shape

    def __len__(self) -> int:
        return len(self._whole)

    def rows(self, index: int, top: int, bottom: int) -> NDArray[np.float32]:
        return _scaled(self._whole.rows(index, top, bottom), self._gains[index])


def _scaled(frame: NDArray[Any], gain: float) -> NDArray[np.float32]:
    return frame.astype(np.float32) * np.float32(gain)
