"""Alignment of a focus stack's frames, which a change of focus shifts and magnifies.

By the correlation of the frames (:mod:`slbench.capture.fusion.correlation`): invariant to gain
and offset, and little moved by blur, which is symmetrical.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from slbench.capture.fusion.correlation import PARAMETERS, Level, improved, levels
from slbench.capture.fusion.stack import Banded, Stack, banded, each_frame, frames
from slbench.core.errors import InputError
from slbench.core.show.display import brief

FloatArray = NDArray[np.float64]
Motion = Literal["translation", "magnification", "affine", "homography"]
MOTIONS: tuple[str, ...] = get_args(Motion)

_SIDE = 1024  # pixels: larger frames are reduced for the search; a million pixels say enough
_COARSE_SIDE = 256  # pixels: up to here a frame's search starts from its neighbour's motion
_LEAST_CORRELATION = 0.3  # of frames that show the same; other frames correlate around 0
_NODES = 6  # samples a direction that a frame is interpolated through
_MOST_SHIFT = 0.25  # of the longer side: beyond, the search has run away
#: Pixels, at the worst corner: less is as well left alone.  Of frames that stand still, blur that
#: changes across the picture makes up to half a pixel, and to undo as much gains nothing.
_LEAST_SHIFT = 0.6
#: Share by which what does not correlate must fall at the least: a plain surface, or one with edges
#: along one direction alone, correlates as well wherever it is.
_LEAST_GAIN = 0.1


@dataclass(frozen=True)
class Alignment:
    """Where each pixel of the reference frame lies in every frame.

    Attributes
    ----------
    transforms : (P, 3, 3) ndarray of float64
        Homographies from pixels (u, v, 1) of the reference frame to those of each frame.
    correlation : (P,) ndarray of float64
        Correlation coefficient of each aligned frame with the reference.
    reference : int
        The frame whose pixels stay where they are.
    """

    transforms: FloatArray
    correlation: FloatArray
    reference: int

    __repr__ = brief

    def shift_px(self, height: int, width: int) -> float:
        """Return the largest motion of a corner of any frame of this size, pixels."""
        return max(_shift(transform, height, width) for transform in self.transforms)

    def apply(self, stack: Stack) -> Stack:
        """Return a stack seen through the alignment.

        Parameters
        ----------
        stack : Stack
            P frames at the same focus positions; any other stack than the one aligned, too.

        Returns
        -------
        Stack
            Frames of float32, interpolated when they are asked for, borders
            replicated.

        Raises
        ------
        InputError
            If the stack has another number of frames.
        """
        if len(stack) != len(self.transforms):
            raise InputError("stack", f"{len(self.transforms)} frames", len(stack))
        return _Aligned(stack, self.transforms)


@dataclass(frozen=True)
class _Aligned:
    """A stack whose frames are warped when they are asked for."""

    stack: Stack
    transforms: FloatArray

    def __len__(self) -> int:
        return len(self.stack)

    def __getitem__(self, index: int) -> NDArray[np.float32]:
        frame = np.asarray(self.stack[index]).astype(np.float32)
        transform = self.transforms[index]
        if np.array_equal(transform, np.eye(3)):
            return frame
        layers = frame.reshape(*frame.shape[:2], -1)
        warped = np.empty_like(layers)
        _warp(layers, np.ascontiguousarray(transform, np.float64), warped)
        return warped.reshape(frame.shape)

    def banded(self) -> Banded:
        """Return the same by bands of rows."""
        return _AlignedBands(banded(self.stack, colour=True), self.transforms)


class _AlignedBands:
    """Aligned frames by bands: of the frames as they are, only the rows that a band shows."""

    def __init__(self, whole: Banded, transforms: FloatArray) -> None:
        self._whole, self.shape = whole, whole.shape
        self._transforms = np.ascontiguousarray(transforms, np.float64)

    def __len__(self) -> int:
        return len(self._whole)

    def rows(self, index: int, top: int, bottom: int) -> NDArray[np.float32]:
        height, width = self.shape[:2]
        transform = self._transforms[index]
        if np.array_equal(transform, np.eye(3)):
            return self._whole.rows(index, top, bottom).astype(np.float32)
        # Lines stay lines: the corners' places are the extremes, where none is at infinity.
        u, v = np.array([0, width - 1, 0, width - 1]), np.array([top, top, bottom, bottom])
        place = transform @ np.stack((u, v, np.ones(4)))
        first, last = 0, height
        if (place[2] > 0).all():
            y = np.clip(place[1] / place[2], -1.0, height)
            first = int(np.clip(np.floor(y.min()) - _NODES, 0, height - 1))
            last = int(np.clip(np.ceil(y.max()) + _NODES, first + 1, height))
        part = self._whole.rows(index, first, last).astype(np.float32)
        layers = part.reshape(*part.shape[:2], -1)
        out = np.empty((bottom - top, *layers.shape[1:]), np.float32)
        _warp_band(layers, first, height, transform, top, out)
        return out.reshape(bottom - top, *self.shape[1:])


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _warp(image: Any, transform: Any, out: Any) -> None:
    """out[v, u] = image at the place to which `transform` takes (u, v); borders are replicated."""
    for v in prange(image.shape[0]):
        _warp_row(image, 0, image.shape[0], transform, v, out[v])


@njit(cache=True, nogil=True, error_model="numpy")
def _warp_band(image: Any, first: int, height: int, transform: Any, top: int, out: Any) -> None:
    """As :func:`_warp`, of the rows from `top` on, on one thread.

    `image` has the rows from `first` on of a frame of `height` rows, all that are needed.
    """
    for row in range(out.shape[0]):
        _warp_row(image, first, height, transform, top + row, out[row])


@njit(cache=True, nogil=True, error_model="numpy")
def _warp_row(image: Any, first: int, height: int, transform: Any, v: int, out: Any) -> None:
    """Fill one row.

    Lagrange interpolation through six samples a direction: exact for polynomials of degree
    five.  OpenCV's bicubic warp moves even a ramp by up to half as much again where shifts are
    small, and rounds them to 1/32 of a pixel.
    """
    rows, width, layers = image.shape
    for u in range(width):
        scale = transform[2, 0] * u + transform[2, 1] * v + transform[2, 2]
        x = (transform[0, 0] * u + transform[0, 1] * v + transform[0, 2]) / scale
        y = (transform[1, 0] * u + transform[1, 1] * v + transform[1, 2]) / scale
        # Beyond the border all samples are its own.
        x = min(max(x, -float(_NODES)), float(width + _NODES))
        y = min(max(y, -float(_NODES)), float(height + _NODES))
        column, row = int(np.floor(x)), int(np.floor(y))
        a = _weights(x - column)
        b = _weights(y - row)
        column, row = column - 2, row - 2 - first
        inside = column >= 0 and row >= 0 and column + 5 < width and row + 5 < rows
        for layer in range(layers):
            total = 0.0
            if inside:
                for j in range(_NODES):
                    line = image[row + j]
                    total += b[j] * (
                        a[0] * line[column, layer]
                        + a[1] * line[column + 1, layer]
                        + a[2] * line[column + 2, layer]
                        + a[3] * line[column + 3, layer]
                        + a[4] * line[column + 4, layer]
                        + a[5] * line[column + 5, layer]
                    )
            else:
                for j in range(_NODES):
                    line = image[min(max(row + j + first, 0), height - 1) - first]
                    part = 0.0
                    for i in range(_NODES):
                        part += a[i] * line[min(max(column + i, 0), width - 1), layer]
                    total += b[j] * part
            out[u, layer] = total


@njit(cache=True, nogil=True, inline="always")
def _weights(t: float) -> Any:
    """Return the weights of the samples at -2 to 3 in Lagrange interpolation at t in [0, 1)."""
    p, q, r, s, w = t + 2.0, t + 1.0, t - 1.0, t - 2.0, t - 3.0
    low, high = p * q, s * w
    return (
        q * t * r * high * (-1.0 / 120.0),
        p * t * r * high * (1.0 / 24.0),
        low * r * high * (-1.0 / 12.0),
        low * t * high * (1.0 / 12.0),
        low * t * r * w * (-1.0 / 24.0),
        low * t * r * s * (1.0 / 120.0),
    )


def align(stack: Stack, reference: int | None = None, motion: Motion = "translation") -> Alignment:
    """Find the motion of each frame of a stack against a reference frame.

    Coarse to fine.  At the coarse levels each search starts from the motion of the neighbour
    nearer to the reference, since what focusing moves, it moves steadily; the fine ones improve
    every frame by itself.  Frames longer than 1024 pixels are reduced for it.

    Parameters
    ----------
    stack : Stack
        P frames (V, U); each is asked for twice.
    reference : int, optional
        The frame that stays; the middle one otherwise.
    motion : {"translation", "magnification", "affine", "homography"}
        What may happen to a frame.  Focusing shifts and magnifies; the three parameters of that
        are biased least where the blur changes across the picture.

    Returns
    -------
    Alignment

    Raises
    ------
    InputError
        If the stack or a parameter is not as above, or a frame cannot be aligned: the search
        diverges, or ends far away or without correlation.
    """
    if motion not in MOTIONS:
        raise InputError("motion", f"one of {', '.join(MOTIONS)}", motion)
    count = len(stack)
    middle = count // 2 if reference is None else reference
    if not isinstance(middle, (int, np.integer)) or not 0 <= middle < count:
        raise InputError("reference", f"a frame from 0 to {count - 1}", reference)
    parameters = PARAMETERS[motion]
    coarse = [levels(frame, _COARSE_SIDE) for frame in frames(stack)]
    template = levels(np.asarray(stack[middle]), _SIDE)

    def found(p: int, result: tuple[FloatArray, float] | None) -> tuple[FloatArray, float]:
        if result is None:
            expected = f"one that {motion} aligns with frame {middle}"
            raise InputError(f"stack: frame {p}", expected, "another")
        return result

    transforms = np.repeat(np.eye(3)[None], count, axis=0)
    correlation = np.ones(count)
    outwards = [(p, p - 1) for p in range(middle + 1, count)]
    outwards += [(p, p + 1) for p in range(middle - 1, -1, -1)]
    for p, start in outwards:
        result = _search(coarse[middle], coarse[p], transforms[start], parameters)
        transforms[p], correlation[p] = found(p, result)
    height, width = template[-1].image.shape

    def improve(p: int, frame: NDArray[Any]) -> None:
        finer = levels(frame, _SIDE)
        skipped = len([level for level in finer if max(level.image.shape) <= _COARSE_SIDE]) - 1
        result = _search(template[skipped:], finer[skipped:], transforms[p], parameters)
        transforms[p], correlation[p] = found(p, result)

    if max(height, width) > _COARSE_SIDE:
        each_frame(stack, improve, but=middle)
    for p in range(count):
        if not _near(transforms[p], *np.shape(stack[middle])[:2]) or (
            correlation[p] < _LEAST_CORRELATION
        ):
            found(p, None)
    return Alignment(transforms, correlation, int(middle))


def _search(
    template: list[Level], image: list[Level], start: FloatArray, parameters: int
) -> tuple[FloatArray, float] | None:
    """Return the motion from template to image, from coarse to fine, and the correlation."""
    found: tuple[FloatArray, float] | None = None
    for fixed, moving in zip(template, image, strict=True):
        found = improved(fixed, moving, start if found is None else found[0], parameters)
        if found is None:
            return None
    return found


def _near(transform: FloatArray, height: int, width: int) -> bool:
    return _shift(transform, height, width) <= _MOST_SHIFT * max(height, width)


def _shift(transform: FloatArray, height: int, width: int) -> float:
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1.0]]).T
    moved = transform @ corners
    shift = float(np.abs(moved[:2] / moved[2] - corners[:2]).max())
    return shift if np.isfinite(shift) else np.inf


def magnified(stack: Stack) -> Alignment | None:
    """Find what focusing did to the frames of a stack, where it did anything.

    Parameters
    ----------
    stack : Stack
        P frames (V, U).

    Returns
    -------
    Alignment or None
        None where no corner of a frame has moved by more than 0.6 pixels, which gains nothing
        to undo, or where frames correlate as well without.

    Raises
    ------
    InputError
        As :func:`align`.
    """
    found = align(stack, motion="magnification")
    template = levels(np.asarray(stack[found.reference]), _SIDE)[-1].image
    for p, transform in enumerate(found.transforms):
        frame = np.asarray(stack[p])
        if _shift(transform, *frame.shape) > _LEAST_SHIFT:
            still = np.corrcoef(template.ravel(), levels(frame, _SIDE)[-1].image.ravel())[0, 1]
            if 1.0 - found.correlation[p] < (1.0 - _LEAST_GAIN) * (1.0 - still):
                return found
    return None
