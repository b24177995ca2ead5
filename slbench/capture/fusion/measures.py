"""Focus measures: how much fine detail an image has around each pixel.

All are means over a square window of something that grows with contrast at high spatial
frequency (S. Pertuz, D. Puig, M. A. Garcia, "Analysis of focus measure operators for
shape-from-focus", Pattern Recognition 46(5), 2013).
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.capture.fusion import _kernels
from slbench.capture.fusion.stack import frames
from slbench.core.errors import InputError
from slbench.core.registry import Registry

#: ``detail(image, window, out)`` writes what a measure averages, pixel by pixel: `image` and `out`
#: are (V, U) float32, not the same array, `window` is the side of the window in pixels.  A pixel
#: may depend on those up to a window away: large images are measured by bands of rows.
Detail: TypeAlias = Callable[[Any, int, Any], None]

#: Focus measures by name.  To add one, write its detail below and name it here; outside slbench
#: the entry-point group ``slbench.focus_measures``, or a module that a capture names.
focus_measures: Registry[Detail] = Registry(
    "focus measure",
    "slbench.focus_measures",
    {
        "variance": "slbench.capture.fusion.measures:variance",
        "gradient": "slbench.capture.fusion.measures:gradient",
        "laplacian": "slbench.capture.fusion.measures:laplacian",
    },
    base="collections.abc:Callable",
)


def variance(image: Any, window: int, out: Any) -> None:
    """Write the squared deviation from the window's mean."""
    _kernels.squared_deviation(image, window // 2, out)


def gradient(image: Any, window: int, out: Any) -> None:
    """Write the squared gradient."""
    _kernels.squared_gradient(image, out)


def laplacian(image: Any, window: int, out: Any) -> None:
    """Write the modified Laplacian."""
    _kernels.modified_laplacian(image, out)


def focus_measure(
    image: ArrayLike, measure: str = "variance", window: int = 9
) -> NDArray[np.float32]:
    """Return the focus measure at every pixel.

    With B the mean over the window, borders replicated:

    - ``"variance"``: ``B[(I - B[I])^2]``, grey-level local variance (Pertuz et al., IEEE TIP
      22(3), 2013);
    - ``"gradient"``: ``B[I_u^2 + I_v^2]``, squared gradient by central differences (thesis
      5.1.1);
    - ``"laplacian"``: ``B[|I_uu| + |I_vv|]``, modified Laplacian by second differences (S. K.
      Nayar, Y. Nakagawa, "Shape from focus", IEEE TPAMI 16(8), 1994).

    Parameters
    ----------
    image : (V, U) array_like
        Grey values in any unit g.
    measure : str
        As above, or one that was added to :data:`focus_measures`.
    window : int
        Side of the window, pixels: odd, at least 3.

    Returns
    -------
    (V, U) ndarray of float32
        In g^2; g for the modified Laplacian.

    Raises
    ------
    InputError
        If the image is not one, or the measure or the window is not as above.
    """
    check_measure(measure, window)
    image = next(frames([image], where="focus measure"))  # type: ignore[list-item]
    values = np.ascontiguousarray(image, dtype=np.float32)
    out = np.empty_like(values)
    measure_into(values, measure, window, np.empty_like(values), out)
    return out


def check_measure(measure: str, window: int) -> None:
    """Refuse an unknown measure and a window without a centre."""
    focus_measures.get(measure, "measure")
    check_window(window, 3)


def check_window(window: int, least: int) -> None:
    """Refuse a window without a centre."""
    whole = isinstance(window, (int, np.integer)) and not isinstance(window, bool)
    if not whole or window < least or window % 2 == 0:
        raise InputError("window", f"an odd number of pixels, at least {least}", window)


def measure_into(
    values: NDArray[np.float32],
    measure: str,
    window: int,
    scratch: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the focus measure of a (V, U) float32 image to `out`, `scratch` being overwritten."""
    focus_measures.get(measure)(values, window, scratch)
    _kernels.box_mean(scratch, window // 2, out)
