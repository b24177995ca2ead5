"""Alignment of a focus stack's frames, which a change of focus shifts and magnifies.

G. D. Evangelidis, E. Z. Psarakis, "Parametric image alignment using enhanced correlation
coefficient maximization", IEEE TPAMI 30(10), 2008, as OpenCV has it: invariant to gain and
offset, and little moved by blur, which is symmetrical.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from slbench.capture.fusion.stack import Stack, frames
from slbench.core.errors import InputError
from slbench.core.show.display import brief

FloatArray = NDArray[np.float64]
Motion = Literal["translation", "affine", "homography"]
MOTIONS: tuple[str, ...] = get_args(Motion)

_OPENCV = {
    "translation": cv2.MOTION_TRANSLATION,
    "affine": cv2.MOTION_AFFINE,
    "homography": cv2.MOTION_HOMOGRAPHY,
}
_SIDE = 1024  # pixels: larger frames are reduced for the search; a million pixels say enough
_SMOOTHING = 5  # pixels: side of the Gaussian that both frames are smoothed with
_STEPS, _PRECISION = 200, 1e-7  # of the iteration: most steps, least gain in correlation
_LEAST_CORRELATION = 0.3  # of frames that show the same; other frames correlate around 0
_NODES = 6  # samples a direction that a frame is interpolated through
_MOST_SHIFT = 0.25  # of the longer side: beyond, the search has run away


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


@njit(parallel=True, cache=True, error_model="numpy")
def _warp(image: Any, transform: Any, out: Any) -> None:
    """out[v, u] = image at the place to which `transform` takes (u, v); borders are replicated.

    Lagrange interpolation through six samples a direction: exact for polynomials of degree
    five.  OpenCV's bicubic warp moves even a ramp by up to half as much again where shifts are
    small, and rounds them to 1/32 of a pixel.
    """
    height, width, layers = image.shape
    for v in prange(height):
        across, down = np.empty(_NODES), np.empty(_NODES)
        columns, rows = np.empty(_NODES, np.int64), np.empty(_NODES, np.int64)
        for u in range(width):
            scale = transform[2, 0] * u + transform[2, 1] * v + transform[2, 2]
            x = (transform[0, 0] * u + transform[0, 1] * v + transform[0, 2]) / scale
            y = (transform[1, 0] * u + transform[1, 1] * v + transform[1, 2]) / scale
            # Beyond the border all samples are its own.
            _weights(min(max(x, -_NODES), width + _NODES), width, across, columns)
            _weights(min(max(y, -_NODES), height + _NODES), height, down, rows)
            for layer in range(layers):
                total = 0.0
                for j in range(_NODES):
                    line = 0.0
                    for i in range(_NODES):
                        line += across[i] * image[rows[j], columns[i], layer]
                    total += down[j] * line
                out[v, u, layer] = total


@njit(cache=True)
def _weights(place: float, size: int, weights: Any, samples: Any) -> None:
    """Set the samples around a place, and their weights in Lagrange interpolation."""
    whole = int(np.floor(place))
    part = place - whole
    for i in range(_NODES):
        weight = 1.0
        for j in range(_NODES):
            if j != i:
                weight *= (part + _NODES // 2 - 1 - j) / (i - j)
        weights[i] = weight
        samples[i] = min(max(whole + i + 1 - _NODES // 2, 0), size - 1)


def align(stack: Stack, reference: int | None = None, motion: Motion = "translation") -> Alignment:
    """Find the motion of each frame of a stack against a reference frame.

    Each search starts from the motion of the neighbour nearer to the reference, since what
    focusing moves, it moves steadily.  Frames longer than 1024 pixels are reduced for it.

    Parameters
    ----------
    stack : Stack
        P frames (V, U); each is asked for once, and all are held at reduced size.
    reference : int, optional
        The frame that stays; the middle one otherwise.
    motion : {"translation", "affine", "homography"}
        What may happen to a frame.  Magnification needs affine.

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
    small, to_small = _reduced(stack)
    count = len(small)
    middle = count // 2 if reference is None else reference
    if not isinstance(middle, (int, np.integer)) or not 0 <= middle < count:
        raise InputError("reference", f"a frame from 0 to {count - 1}", reference)
    transforms = np.repeat(np.eye(3)[None], count, axis=0)
    correlation = np.ones(count)
    outwards = [(p, p - 1) for p in range(middle + 1, count)]
    outwards += [(p, p + 1) for p in range(middle - 1, -1, -1)]
    for p, start in outwards:
        found = _search(small[middle], small[p], motion, transforms[start])
        if found is None:
            which = f"stack: frame {p}"
            raise InputError(which, f"one that {motion} aligns with frame {middle}", "another")
        transforms[p], correlation[p] = found
    transforms = np.linalg.inv(to_small) @ transforms @ to_small
    transforms /= transforms[:, 2:, 2:]
    transforms[middle] = np.eye(3)
    return Alignment(transforms, correlation, middle)


def _reduced(stack: Stack) -> tuple[list[NDArray[np.float32]], FloatArray]:
    """Return the frames at a size fit for the search, and the (3, 3) map of pixels to theirs."""
    small: list[NDArray[np.float32]] = []
    to_small = np.eye(3)
    for frame in frames(stack):
        image = frame.astype(np.float32)
        height, width = image.shape
        if max(height, width) > _SIDE:
            ratio = _SIDE / max(height, width)
            size = (max(1, round(ratio * width)), max(1, round(ratio * height)))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            scale = np.array([size[0] / width, size[1] / height])
            # Corners of the image coincide; pixel centres are at integers.
            to_small[[0, 1], [0, 1]] = scale
            to_small[:2, 2] = 0.5 * scale - 0.5
        small.append(image)
    return small, to_small


def _search(template: Any, image: Any, motion: str, start: FloatArray) -> Any:
    """Return the (3, 3) map from template to image and the correlation, or None."""
    rows = 3 if motion == "homography" else 2
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, _PRECISION)
    try:
        correlation, warp = cv2.findTransformECC(
            template,
            image,
            start[:rows].astype(np.float32),
            _OPENCV[motion],
            criteria,
            None,
            _SMOOTHING,
        )
    except cv2.error:  # singular, or the frames have drifted out of each other
        return None
    transform = np.eye(3)
    transform[:rows] = warp
    height, width = template.shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1.0]]).T
    moved = transform @ corners
    shift = np.abs(moved[:2] / moved[2] - corners[:2]).max()
    near = np.isfinite(shift) and shift <= _MOST_SHIFT * max(height, width)
    return (transform, correlation) if near and correlation >= _LEAST_CORRELATION else None
