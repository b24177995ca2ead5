"""Focus measures: how much fine detail an image has around each pixel.

All are means over a square window of something that grows with contrast at high spatial
frequency (S. Pertuz, D. Puig, M. A. Garcia, "Analysis of focus measure operators for
shape-from-focus", Pattern Recognition 46(5), 2013).
"""

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.capture.fusion import _kernels
from slbench.capture.fusion.stack import frames
from slbench.core.errors import InputError

Measure = Literal["variance", "gradient", "laplacian"]
MEASURES: tuple[str, ...] = get_args(Measure)


def focus_measure(
    image: ArrayLike, measure: Measure = "variance", window: int = 9
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
        As above.
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
    if measure not in MEASURES:
        raise InputError("measure", f"one of {', '.join(MEASURES)}", measure)
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
    if measure == "variance":
        _kernels.squared_deviation(values, window // 2, scratch)
    elif measure == "gradient":
        _kernels.squared_gradient(values, scratch)
    else:
        _kernels.modified_laplacian(values, scratch)
    _kernels.box_mean(scratch, window // 2, out)
