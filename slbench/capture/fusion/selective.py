"""Selective all-in-focus fusion: average where the focus is uncertain, select where it is not.

S. Pertuz, D. Puig, M. A. Garcia, A. Fusiello, "Generation of all-in-focus images by
noise-robust selective fusion of limited depth-of-field images", IEEE Trans. Image Processing
22(3), 2013; the thesis's algorithm [83].  A pixel in focus somewhere in the stack has a focus
curve like a Gaussian; where noise makes up the curve, it is not, and frames are then averaged.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.capture.fusion import _kernels
from slbench.capture.fusion.measures import check_measure, measure_into
from slbench.capture.fusion.stack import Banded, Stack, banded, frames, workers_for
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.core.validation.types import Finite, Interval
from slbench.core.validation.values import checked

FloatArray = NDArray[np.float64]
Variant = Literal["corrected", "published"]

#: Fewest frames from which a selectivity says something: the Gaussian takes up three.
LEAST_FRAMES = 5
_BAND_BYTES = 1 << 25  # of the focus measure of a band, all frames
_LEAST_ROWS = 32  # of a band: its margins are some 30 rows
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

    The focus is measured in bands of rows: beyond the frames and the weights, two bytes a pixel
    and frame, memory is some 200 MB whatever their size.  Frames that a stack reads when it is
    asked are held, as deep as they are.

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
    published = check_variant(variant, len(stack))
    check_measure(measure, window)  # ahead of the frames, which may have to be read
    bands = selective_bands(
        banded(stack),
        positions=positions,
        measure=measure,
        window=window,
        alpha=alpha,
        threshold_db=threshold_db,
        published=published,
        on_progress=on_progress,
    )
    return _joined(bands, len(stack))


def check_variant(variant: Variant, count: int) -> bool:
    """Return whether the variant is the published one, and refuse it for too few frames."""
    published = variant == "published"
    if published and count < LEAST_FRAMES:
        raise InputError("stack", "at least 5 frames for the published variant", count)
    return published


def selective_bands(
    stack: Banded,
    *,
    positions: ArrayLike | None = None,
    measure: str = "variance",
    window: int = 9,
    alpha: float = 0.2,
    threshold_db: float = 13.0,
    published: bool = False,
    on_progress: Callable[[str, float, str], None] | None = None,
) -> Iterator[tuple[int, FusionWeights]]:
    """Yield the weights of :func:`selective_weights` by bands, each with its first row."""
    for top, curves in _focus_curves(stack, positions, measure, window, published, on_progress):
        known = np.nan_to_num(curves.selectivity_db, nan=np.inf)
        phi = (1.0 + np.tanh(alpha * (known - threshold_db))) / (2.0 * alpha)
        phi = cv2.medianBlur(phi.astype(np.float32), 3)
        inner = curves.inner
        focus = np.ascontiguousarray(curves.focus[:, inner])
        weights = np.empty(focus.shape, dtype=np.uint16)
        _kernels.soft_weights(focus, curves.peak[inner], phi[inner], weights)
        yield top, FusionWeights(weights, curves.place[inner], curves.selectivity_db[inner])


def _joined(bands: Iterator[tuple[int, FusionWeights]], count: int) -> FusionWeights:
    """Return the weights of all bands as one."""
    parts = [part for _, part in bands]
    if len(parts) == 1:
        return parts[0]
    width = parts[0].focus.shape[1]
    weights = np.empty((count, sum(len(part.focus) for part in parts), width), dtype=np.uint16)
    focus, selectivity = np.empty((2, *weights.shape[1:]))
    top = 0
    while parts:  # each is let go as soon as it is copied
        part = parts.pop(0)
        rows = slice(top, top + len(part.focus))
        weights[:, rows], focus[rows] = part.weights, part.focus
        selectivity[rows] = part.selectivity_db
        top = rows.stop
    return FusionWeights(weights, focus, selectivity)


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
    check_measure(measure, window)
    bands = maximum_bands(
        banded(stack),
        positions=positions,
        measure=measure,
        window=window,
        on_progress=on_progress,
    )
    return _joined(bands, len(stack))


def maximum_bands(
    stack: Banded,
    *,
    positions: ArrayLike | None = None,
    measure: str = "variance",
    window: int = 9,
    on_progress: Callable[[str, float, str], None] | None = None,
) -> Iterator[tuple[int, FusionWeights]]:
    """Yield the weights of :func:`maximum_weights` by bands, each with its first row."""
    for top, curves in _focus_curves(stack, positions, measure, window, False, on_progress):
        inner = curves.inner
        sharpest = curves.sharpest[inner]
        weights = np.zeros((len(stack), *sharpest.shape), dtype=np.uint16)
        np.put_along_axis(weights, sharpest[None], _kernels.FULL_WEIGHT, axis=0)
        yield top, FusionWeights(weights, curves.place[inner], curves.selectivity_db[inner])


class _Curves(NamedTuple):
    """The focus curves of a band's pixels, and what a fit says about each.

    The selectivity is right in the rows `inner` and one more either side, the rest wherever it is.
    """

    inner: slice  # the band's own rows
    focus: NDArray[np.float32]  # (P, V, U)
    peak: NDArray[np.float32]  # (V, U)
    sharpest: NDArray[np.int32]  # (V, U), frame
    place: FloatArray  # (V, U)
    selectivity_db: FloatArray  # (V, U)


def _focus_curves(
    stack: Banded,
    positions: ArrayLike | None,
    measure: str,
    window: int,
    published: bool,
    on_progress: Callable[[str, float, str], None] | None,
) -> Iterator[tuple[int, _Curves]]:
    """Measure the focus of every frame and fit the curves, band by band, each with its first row.

    A pixel depends on the rows around it, so each band is measured with a margin, whose outer
    part is not right and not used: results do not depend on the height of the bands.
    """
    check_measure(measure, window)
    count = len(stack)
    x = _checked_positions(positions, count)
    order = np.argsort(x)
    height, width = stack.shape
    half = window // 2
    rows = max(_LEAST_ROWS, _BAND_BYTES // (4 * count * width))
    with ThreadPoolExecutor(workers_for(count)) as pool:
        for top in range(0, height, rows):
            bottom = min(top + rows, height)
            # The median's neighbours, and the window in which the errors are averaged.
            first, last = max(top - half - 1, 0), min(bottom + half + 1, height)
            focus = np.empty((count, last - first, width), dtype=np.float32)
            measured = _Measuring(stack, measure, window, first, last, focus)
            for p, _ in enumerate(pool.map(measured.of, range(count))):
                if on_progress is not None:
                    done = (top + (bottom - top) * (p + 1) / count) / height
                    on_progress("focus", done, "")
            shape = focus.shape[1:]
            peak, error = np.empty((2, *shape), dtype=np.float32)
            index = np.empty(shape, dtype=np.int32)
            place = np.empty(shape)
            _kernels.fit_peaks(focus, order, x[order], published, peak, index, place, error)
            if count < LEAST_FRAMES:
                selectivity = np.full(shape, np.nan)
            else:
                mean_error = np.empty_like(error)
                _kernels.box_mean(error, half, mean_error)
                floor = np.maximum(mean_error.astype(np.float64), _LEAST_ERROR)
                selectivity = -20.0 * np.log10(floor)
            inner = slice(top - first, bottom - first)
            yield top, _Curves(inner, focus, peak, index, place, selectivity)


class _Measuring(NamedTuple):
    """What measures the focus of one frame in the rows `first` to `last`."""

    stack: Banded
    measure: str
    window: int
    first: int
    last: int
    focus: NDArray[np.float32]

    def of(self, p: int) -> None:
        # The mean over the window, of a detail that sees as far as a window.
        margin = self.window // 2 + self.window
        top = max(self.first - margin, 0)
        bottom = min(self.last + margin, self.stack.shape[0])
        with np.errstate(over="ignore"):  # found out below
            rows = self.stack.rows(p, top, bottom)
            values = np.ascontiguousarray(rows, dtype=np.float32)
        out = np.empty_like(values)
        measure_into(values, self.measure, self.window, np.empty_like(values), out)
        self.focus[p] = out[self.first - top : self.last - top]
        if not np.isfinite(self.focus[p].max()):
            raise InputError(f"stack: frame {p}", "values whose squares float32 holds", "larger")


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
