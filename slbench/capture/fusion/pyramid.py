"""Fusion in a Laplacian pyramid: at each scale, the frame of largest detail.

P. J. Burt, E. H. Adelson, "The Laplacian pyramid as a compact image code", IEEE Trans.
Communications 31(4), 1983; J. M. Ogden, E. H. Adelson, J. R. Bergen, P. J. Burt,
"Pyramid-based computer graphics", RCA Engineer 30(5), 1985.  A baseline: it is sharp where
frames are clean, and picks the largest noise where they are not.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.capture.fusion.stack import Stack, frames
from slbench.core.errors import InputError
from slbench.core.show.display import brief

FloatImage = NDArray[np.float32]
_COARSEST = 8  # pixels: least side of the coarsest level


@dataclass(frozen=True)
class PyramidSelection:
    """Which frame each coefficient of the fused pyramid comes from.

    Attributes
    ----------
    choice : tuple of (V_l, U_l) ndarray of uint16
        Frame of each coefficient, finest level first.  The low-pass rest below the coarsest
        level, which has no detail to choose by, is the mean over the frames.
    count : int
        Frames of the stack, P.
    """

    choice: tuple[NDArray[np.uint16], ...]
    count: int

    __repr__ = brief

    @property
    def noise_gain(self) -> float:
        """Noise of the fusion over that of one frame: 1, as most coefficients are one frame's."""
        return 1.0

    def fuse(self, stack: Stack) -> NDArray[np.float64]:
        """Return the fusion of a stack's frames, which are read one at a time.

        Parameters
        ----------
        stack : Stack
            P frames, (V, U) or (V, U, C), at the same focus positions as those that gave the
            selection.

        Returns
        -------
        (V, U) or (V, U, C) ndarray of float64
            In the unit of the frames; it may exceed their range a little.

        Raises
        ------
        InputError
            If number, shape or content of the frames is not as above.
        """
        fused: list[FloatImage] = []
        for p, frame in enumerate(frames(stack, count=self.count, colour=True)):
            if frame.shape[:2] != self.choice[0].shape:
                raise InputError("stack", f"frames of shape {self.choice[0].shape}", frame.shape)
            pyramid = _laplacian_pyramid(frame, len(self.choice))
            if not fused:
                fused = [np.zeros_like(level) for level in pyramid]
            for level, source, choice in zip(fused, pyramid, self.choice, strict=False):
                chosen = choice == p
                level[chosen] = source[chosen]
            fused[-1] += pyramid[-1] / self.count
        image = fused.pop()
        while fused:
            detail = fused.pop()
            image = _up(image, detail) + detail
        return image.astype(np.float64)


def pyramid_selection(stack: Stack) -> PyramidSelection:
    """Choose, at each coefficient of a Laplacian pyramid, the frame of largest magnitude.

    Parameters
    ----------
    stack : Stack
        P frames (V, U), at least 2 x 2 pixels, read once each.

    Returns
    -------
    PyramidSelection
        Of several equal frames the first is chosen.

    Raises
    ------
    InputError
        If number, shape or content of the frames is not as above.
    """
    largest: list[FloatImage] = []
    choice: list[NDArray[np.uint16]] = []
    for p, frame in enumerate(frames(stack)):
        if min(frame.shape) < 2 or len(stack) > np.iinfo(np.uint16).max:
            raise InputError("stack", "frames of at least 2 x 2 pixels, up to 65535", frame.shape)
        levels = max(1, int(np.log2(min(frame.shape) / _COARSEST)))
        detail = [np.abs(level) for level in _laplacian_pyramid(frame, levels)[:-1]]
        if not largest:
            largest = detail
            choice = [np.zeros(level.shape, dtype=np.uint16) for level in detail]
            continue
        for magnitude, best, source in zip(detail, largest, choice, strict=True):
            better = magnitude > best
            best[better] = magnitude[better]
            source[better] = p
    return PyramidSelection(tuple(choice), len(stack))


def _laplacian_pyramid(frame: NDArray[np.generic], levels: int) -> list[FloatImage]:
    """Return the band-pass levels, finest first, and the low-pass rest."""
    image = np.ascontiguousarray(frame, dtype=np.float32)
    pyramid = []
    for _ in range(levels):
        lower = cv2.pyrDown(image)
        if image.ndim == 3 and lower.ndim == 2:  # OpenCV drops a channel axis of length 1
            lower = lower[:, :, None]
        pyramid.append(image - _up(lower, image))
        image = lower
    return [*pyramid, image]


def _up(image: FloatImage, like: FloatImage) -> FloatImage:
    """Enlarge an image twofold, to the size of another."""
    height, width = like.shape[:2]
    larger: FloatImage = cv2.pyrUp(image, dstsize=(width, height))
    return larger.reshape(like.shape)
