"""Selective all-in-focus fusion: average where the focus is uncertain, select where it is not.

S. Pertuz, D. Puig, M. A. Garcia, A. Fusiello, "Generation of all-in-focus images by
noise-robust selective fusion of limited depth-of-field images", IEEE Trans. Image Processing
22(3), 2013; the thesis's algorithm [83].  A pixel in focus somewhere in the stack has a focus
curve like a Gaussian; where noise makes up the curve, it is not, and frames are then averaged.
"""

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.capture.fusion import _kernels
from slbench.capture.fusion.measures import check_measure, measure_into
from slbench.capture.fusion.stack import Stack, frames
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.core.validation.types import Finite, Interval
from slbench.core.validation.values import checked

FloatArray = NDArray[np.float64]
Variant = Literal["corrected", "published"]

#: Fewest frames from which a selectivity says something: the Gaussian takes up three.
LEAST_FRAMES = 5
_MOST_WORKERS = 8  # frames in work at a time, which bounds the memory
_LEAST_ERROR = 1e-6  # 120 dB: what float32 resolves
_LEAST_ALPHA = 1e-3  # below, weights are equal but for rounding


@dataclass(frozen=True)
class FusionWeights:
    """How much of each frame goes into each pixel of the all-in-focus image.

    Attributes
    ----------
    weights : (P, V, U) ndarray of uint16
        Not normalised: 65535 for the frame at the peak of the pixel's focus curve.  A step
        of 1/65535 leaves an error well below that of a 16 bit image, at half the memory of
        float32.
    focus : (V, U) ndarray of float64
        Position of best focus between the frames, in the unit of the positions; NaN where
        the focus curve has no peak within them.
    selectivity_db : (V, U) ndarray of float64
        How much like a Gaussian the focus curve is; NaN for fewer than five frames.
    """

    weights: NDArray[np.uint16]
    focus: FloatArray
    selectivity_db: FloatArray

    __repr__ = brief

    @cached_property
    def _sums(self) -> tuple[FloatArray, FloatArray]:
        """Sum over the frames of the weights and of their squares, (V, U) each."""
        total, squares = np.empty((2, *self.focus.shape))
        _kernels.sums_of_weights(self.weights, total, squares)
        return total, squares

    @property
    def noise_gain(self) -> FloatArray:
        """The factor by which fusion reduces independent noise of the frames, (V, U).

        ``sqrt(sum w^2) / sum w``: 1 where one frame is selected, ``1 / sqrt(P)`` where all
        are averaged.  It holds for stacks other than the one that the weights came from,
        whose own noise has a part in the weights.
        """
        total, squares = self._sums
        return np.sqrt(squares) / total

    def fuse(self, stack: Stack) -> FloatArray:
        """Return the weighted mean of a stack's frames, which are read one at a time.

        Parameters
        ----------
        stack : Stack
            P frames at the same focus positions as those that gave the weights, under any
            illumination: (V, U), or (V, U, C) of which every channel is fused alike.

        Returns
        -------
        (V, U) or (V, U, C) ndarray of float64
            In the unit of the frames.

        Raises
        ------
        InputError
            If number, shape or content of the frames is not as above.
        """
        shape = self.focus.shape
        sums: FloatArray | None = None
        colour = False
        for p, frame in enumerate(frames(stack, count=len(self.weights), colour=True)):
            if frame.shape[:2] != shape:
                raise InputError("stack", f"frames of shape {shape}", frame.shape)
            colour = frame.ndim == 3
            planes = np.moveaxis(frame, 2, 0) if colour else frame[None]
            if sums is None:
                sums = np.zeros(planes.shape)
            for plane, total in zip(planes, sums, strict=True):
                _kernels.add_weighted(plane, self.weights[p], total)
        assert sums is not None  # a stack without frames has been refused
        sums /= self._sums[0]
        return np.ascontiguousarray(np.moveaxis(sums, 0, 2)) if colour else sums[0]


@checked
def selective_weights(
    stack: Stack,
    *,
    positions: ArrayLike | None = None,
    measure: str = "variance",
    window: int = 9,
    alpha: Annotated[float, Interval(ge=_LEAST_ALPHA, le=1.0)] = 0.2,
    threshold_db: Finite = 13.0,
    variant: Variant = "corrected",
    on_progress: Callable[[str, float, str], None] | None = None,
) -> FusionWeights:
    """Return the weights of selective all-in-focus fusion.

    With F_p the focus measure of frame p and B the mean over the window, each pixel's curve
    gets a Gaussian through three samples of ln F.  Its mean distance to the curve,
    ``e = B[sum_p |F_p - A exp(-(x_p - u)^2 / 2 s^2)| / (P F_max)]``, is the selectivity
    ``S = 20 log10(1 / e)``, which sets how strictly frames are selected:
    ``phi = median3x3[(1 + tanh(alpha (S - threshold))) / (2 alpha)]`` and
    ``w_p = 1/2 + 1/2 tanh(phi (F_p / F_max - 1))``.  All of it is independent of the unit
    of the grey values.

    The samples are the peak and those two positions either side, or the last ones where the
    stack ends sooner.  If the peak is the first or last frame, the three start from there; u
    then counts only if it lies within the positions.  Where three samples make no maximum
    (a flat or a log-convex curve) A is 0, so that a flat curve has 0 dB and its frames are
    averaged.  Fewer than five frames say nothing about the fit, and phi is the largest, 1 /
    alpha; u needs three frames; of one frame the fusion is that frame.

    The focus measure of all frames is held as float32: memory is six bytes a pixel and
    frame, the weights included, and some ten images besides, 880 MiB for 30 frames of 2048 x
    2048 pixels.

    Parameters
    ----------
    stack : Stack
        P frames (V, U), read once each, in order of their index.
    positions : (P,) array_like, optional
        Focus position of each frame, all different, in any order and unit; 0, 1, ... P - 1
        otherwise.
    measure : str
        ``"variance"``, ``"gradient"``, ``"laplacian"``, or one that was added;
        see :func:`~slbench.capture.fusion.measures.focus_measure`.
    window : int
        Side of the window, pixels: odd, at least 3.
    alpha : float
        How abruptly selection sets in around the threshold, per dB, in (0, 1].
    threshold_db : float
        Selectivity in the middle between averaging and selecting.
    variant : {"corrected", "published"}
        Published: the fit as in the authors' program, where a slip of an index gives both
        outer samples the value of one, so that u snaps to the middle sample, which at the
        ends is the third from there.  It needs five frames.
    on_progress : callable, optional
        Called with a stage, the fraction done and an empty note.

    Returns
    -------
    FusionWeights

    Raises
    ------
    InputError
        If a parameter or the stack is not as above, or a frame is not finite.
    """
    published = variant == "published"
    if published and len(stack) < LEAST_FRAMES:
        raise InputError("stack", "at least 5 frames for the published variant", len(stack))
    curves = _focus_curves(stack, positions, measure, window, published, on_progress)
    known = np.nan_to_num(curves.selectivity_db, nan=np.inf)
    phi = (1.0 + np.tanh(alpha * (known - threshold_db))) / (2.0 * alpha)
    phi = cv2.medianBlur(phi.astype(np.float32), 3)
    weights = np.empty(curves.focus.shape, dtype=np.uint16)
    _kernels.soft_weights(curves.focus, curves.peak, phi, weights)
    return FusionWeights(weights, curves.place, curves.selectivity_db)


def maximum_weights(
    stack: Stack,
    *,
    positions: ArrayLike | None = None,
    measure: str = "variance",
    window: int = 9,
    on_progress: Callable[[str, float, str], None] | None = None,
) -> FusionWeights:
    """Return weights that select the frame of largest focus measure at every pixel.

    The plain way, to compare with.  Of several equal frames it is that of the least position.
    Parameters, result and errors are those of :func:`selective_weights`.
    """
    curves = _focus_curves(stack, positions, measure, window, False, on_progress)
    weights = np.zeros(curves.focus.shape, dtype=np.uint16)
    np.put_along_axis(weights, curves.sharpest[None], _kernels.FULL_WEIGHT, axis=0)
    return FusionWeights(weights, curves.place, curves.selectivity_db)


class _Curves(NamedTuple):
    """The focus curves of all pixels, and what a fit says about each."""

    focus: NDArray[np.float32]  # (P, V, U)
    peak: NDArray[np.float32]  # (V, U)
    sharpest: NDArray[np.int32]  # (V, U), frame
    place: FloatArray  # (V, U)
    selectivity_db: FloatArray  # (V, U)


def _focus_curves(
    stack: Stack,
    positions: ArrayLike | None,
    measure: str,
    window: int,
    published: bool,
    on_progress: Callable[[str, float, str], None] | None,
) -> _Curves:
    """Measure the focus of every frame and fit the curves."""
    check_measure(measure, window)
    count = len(stack)
    x = _checked_positions(positions, count)
    focus = _measured(stack, measure, window, on_progress)
    shape = focus.shape[1:]
    peak, error = np.empty((2, *shape), dtype=np.float32)
    index = np.empty(shape, dtype=np.int32)
    place = np.empty(shape)
    order = np.argsort(x)
    _kernels.fit_peaks(focus, order, x[order], published, peak, index, place, error)
    if count < LEAST_FRAMES:
        return _Curves(focus, peak, index, place, np.full(shape, np.nan))
    mean_error = np.empty_like(error)
    _kernels.box_mean(error, window // 2, mean_error)
    selectivity = -20.0 * np.log10(np.maximum(mean_error.astype(np.float64), _LEAST_ERROR))
    return _Curves(focus, peak, index, place, selectivity)


def _measured(
    stack: Stack,
    measure: str,
    window: int,
    on_progress: Callable[[str, float, str], None] | None,
) -> NDArray[np.float32]:
    """Return the focus measure of every frame, (P, V, U), several frames being in work at once.

    Frames are read by this thread alone, in order: a stack need not know of threads.
    """
    count = len(stack)
    focus = np.empty((0, 0, 0), dtype=np.float32)

    def work(p: int, frame: NDArray[Any]) -> None:
        with np.errstate(over="ignore"):  # found out below
            values = np.ascontiguousarray(frame, dtype=np.float32)
        measure_into(values, measure, window, np.empty_like(values), focus[p])
        if not np.isfinite(focus[p].max()):
            raise InputError(f"stack: frame {p}", "values whose squares float32 holds", "larger")

    workers = min(count, os.cpu_count() or 1, _MOST_WORKERS)
    pending: deque[Future[None]] = deque()
    done = 0
    with ThreadPoolExecutor(max(workers, 1)) as pool:
        for p, frame in enumerate(frames(stack)):
            if p == 0:
                focus = np.empty((count, *frame.shape), dtype=np.float32)
            if len(pending) > workers:
                pending.popleft().result()
                done += 1
            pending.append(pool.submit(work, p, frame))
            if on_progress is not None:
                on_progress("focus", done / count, "")
        while pending:
            pending.popleft().result()
    if on_progress is not None:
        on_progress("focus", 1.0, "")
    return focus


def _checked_positions(positions: ArrayLike | None, count: int) -> FloatArray:
    """Return the focus positions as (P,) floats."""
    if positions is None:
        return np.arange(float(count))
    try:
        x = np.asarray(positions, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("positions", "numbers", positions) from error
    if x.shape != (count,) or not np.isfinite(x).all() or len(np.unique(x)) != count:
        raise InputError("positions", f"{count} different finite numbers", positions)
    return x
