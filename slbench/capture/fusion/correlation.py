"""Maximisation of the enhanced correlation coefficient of two pictures, coarse to fine.

G. D. Evangelidis, E. Z. Psarakis, "Parametric image alignment using enhanced correlation
coefficient maximization", IEEE TPAMI 30(10), 2008, with steps that are composed with the motion
so far (S. Baker, I. Matthews, "Lucas-Kanade 20 years on", IJCV 56(3), 2004): with I the image
moved onto the template T and J its gradients there, the step that maximises the correlation is

    H^-1 J^T (lambda T - I),   H = J^T J,   lambda = (I^T I - I^T P I) / (T^T I - T^T P I),

``P = J H^-1 J^T``, all without their means over the pixels that both show.  The image is
interpolated and its products are summed in one pass, row by row.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_COARSEST = 64  # pixels: the longer side at the first level is less than twice as long
_SMOOTHING = 3  # pixels: side of the Gaussian that the pictures are smoothed with
_STEPS = 50  # most iterations a level
_STILL = 1e-3  # pixels: a step that moves no corner by more is the last
_LEAST_DEPTH = 0.1  # of a corner in perspective; what goes beyond has run away
_LEAST_SHARE = 0.25  # of the template that must lie within the image
_WORST_CONDITION = 1e10  # of H, scaled to a diagonal of 1: no texture in some direction
#: Parameters of each motion: of magnification the scale and the shift, of the larger ones how often
#: (x, y, 1) and the perspective terms come in.
PARAMETERS = {"translation": 2, "magnification": 3, "affine": 6, "homography": 8}


@dataclass(frozen=True)
class Level:
    """A picture at one size.

    Parameters
    ----------
    image : (V, U) ndarray of float32
        Smoothed.
    to_level : (3, 3) ndarray of float64
        Pixels of the whole picture to those of this one.
    """

    image: NDArray[np.float32]
    to_level: FloatArray


def levels(picture: NDArray[Any], longest: int) -> list[Level]:
    """Return a picture at sizes from coarse to fine, each half as large as the next.

    Parameters
    ----------
    picture : (V, U) ndarray
    longest : int
        Most pixels of the longer side.
    """
    height, width = picture.shape
    image = picture.astype(np.float32)
    side = min(max(height, width), longest)
    found: list[Level] = []
    while True:
        ratio = side / max(height, width)
        size = (max(1, round(ratio * width)), max(1, round(ratio * height)))
        if size != (image.shape[1], image.shape[0]):
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        scale = np.array([size[0] / width, size[1] / height])
        # Corners of the pictures coincide; pixel centres are at integers.
        to_level = np.diag([*scale, 1.0])
        to_level[:2, 2] = 0.5 * scale - 0.5
        smooth = cv2.GaussianBlur(image, (_SMOOTHING, _SMOOTHING), 0)
        found.insert(0, Level(smooth, to_level))
        if side < 2 * _COARSEST:
            return found
        side = (side + 1) // 2


def improved(
    template: Level, image: Level, transform: FloatArray, parameters: int
) -> tuple[FloatArray, float] | None:
    """Improve a motion at one level.

    Parameters
    ----------
    template, image : Level
        Of equal size.
    transform : (3, 3) ndarray of float64
        Where to begin: pixels of the whole template to those of the whole image.
    parameters : int
        See :data:`PARAMETERS`.

    Returns
    -------
    tuple of (3, 3) ndarray and float, or None
        The motion of largest correlation that was met, and that; None where the pictures do
        not determine it.
    """
    to_level = template.to_level
    height, width = template.image.shape
    centre = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    reach = max(0.5 * max(width, height), 1.0)
    # Unit coordinates keep the parameters alike in size: x = (u - centre) / reach.
    to_unit = np.diag([1 / reach, 1 / reach, 1.0])
    to_unit[:2, 2] = -centre / reach
    from_unit, from_level = np.linalg.inv(to_unit), np.linalg.inv(to_level)
    moved = to_level @ transform @ from_level
    best: tuple[FloatArray, float] | None = None
    corners = np.array([[-1, -1, 1], [1, -1, 1], [-1, 1, 1], [1, 1, 1.0]]).T
    for _ in range(_STEPS):
        sums = np.zeros((parameters + 3, parameters + 3))
        _accumulate(template.image, image.image, moved, centre, reach, parameters, sums)
        if sums[-1, -1] < _LEAST_SHARE * width * height:
            break
        step, correlation = _step(sums, parameters)
        if step is None:
            break
        if best is None or correlation > best[1]:
            best = (from_level @ moved @ to_level, correlation)
        change = _matrix(step)
        shifted = change @ corners
        if not (shifted[2] > _LEAST_DEPTH).all():
            break
        moved = moved @ from_unit @ change @ to_unit
        moved /= moved[2, 2]
        if np.abs(shifted[:2] / shifted[2] - corners[:2]).max() * reach < _STILL:
            break
    return best


def _step(sums: FloatArray, parameters: int) -> tuple[FloatArray | None, float]:
    """Return the step, or None where it is not determined, and the correlation ahead of it.

    `sums` (k + 3, k + 3) are those of the products of J, T, I and 1.
    """
    n = sums[-1, -1]
    means = sums[-1, :-1] / n
    centred = sums[:-1, :-1] - n * np.outer(means, means)
    hessian, toward = centred[:parameters, :parameters], centred[:parameters, parameters:]
    (tt, ti), (_, ii) = centred[parameters:, parameters:]
    size = np.sqrt(np.abs(np.diag(hessian)))
    if not (np.isfinite(centred).all() and tt > 0 and ii > 0 and (size > 0).all()):
        return None, 0.0
    correlation = float(ti / np.sqrt(tt * ii))
    scaled = hessian / np.outer(size, size)
    if np.linalg.cond(scaled) > _WORST_CONDITION:
        return None, 0.0
    solved = np.linalg.solve(scaled, toward / size[:, None]) / size[:, None]
    over = ii - toward[:, 1] @ solved[:, 1]
    under = ti - toward[:, 0] @ solved[:, 1]
    # Where what J cannot explain does not correlate, the ratio of the contrasts.
    gain = over / under if under > 0 else np.sqrt(ii / tt)
    return gain * solved[:, 0] - solved[:, 1], correlation


def _matrix(step: FloatArray) -> FloatArray:
    """Return the map of unit coordinates with given parameters."""
    matrix = np.eye(3)
    if len(step) == 2:
        matrix[:2, 2] = step
    elif len(step) == 3:
        matrix[0, 0] += step[0]
        matrix[1, 1] += step[0]
        matrix[:2, 2] = step[1:]
    else:
        matrix[:2] += step[:6].reshape(2, 3)
        matrix[2, :2] = step[6:] if len(step) == 8 else 0.0
    return matrix


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _accumulate(template, image, moved, centre, reach, parameters, sums):  # type: ignore[no-untyped-def]
    """Write the sums of products of gradients by parameters, template, image and 1.

    `moved` takes pixels of the template to those of the image; pixels whose place is outside
    the image or on its border are left out.
    """
    height, width = template.shape
    rows, columns = image.shape
    size = parameters + 3
    line = np.empty((size, width))
    for v in range(height):
        count = 0
        y = (v - centre[1]) / reach
        for u in range(width):
            scale = moved[2, 0] * u + moved[2, 1] * v + moved[2, 2]
            s = (moved[0, 0] * u + moved[0, 1] * v + moved[0, 2]) / scale
            t = (moved[1, 0] * u + moved[1, 1] * v + moved[1, 2]) / scale
            if not (s >= 1.0 and s < columns - 2 and t >= 1.0 and t < rows - 2):
                continue
            i, j = int(t), int(s)
            p, q = s - j, t - i
            above = image[i, j] + p * (image[i, j + 1] - image[i, j])
            below = image[i + 1, j] + p * (image[i + 1, j + 1] - image[i + 1, j])
            x = (u - centre[0]) / reach
            # Central differences of the image, interpolated, and turned into the template's axes.
            du = (1.0 - q) * (
                (1.0 - p) * (image[i, j + 1] - image[i, j - 1])
                + p * (image[i, j + 2] - image[i, j])
            ) + q * (
                (1.0 - p) * (image[i + 1, j + 1] - image[i + 1, j - 1])
                + p * (image[i + 1, j + 2] - image[i + 1, j])
            )
            dv = (1.0 - q) * (
                (1.0 - p) * (image[i + 1, j] - image[i - 1, j])
                + p * (image[i + 1, j + 1] - image[i - 1, j + 1])
            ) + q * (
                (1.0 - p) * (image[i + 2, j] - image[i, j])
                + p * (image[i + 2, j + 1] - image[i, j + 1])
            )
            su = (moved[0, 0] - moved[2, 0] * s) / scale
            sv = (moved[0, 1] - moved[2, 1] * s) / scale
            tu = (moved[1, 0] - moved[2, 0] * t) / scale
            tv = (moved[1, 1] - moved[2, 1] * t) / scale
            gx = 0.5 * reach * (su * du + tu * dv)
            gy = 0.5 * reach * (sv * du + tv * dv)
            if parameters == 2:
                line[0, count], line[1, count] = gx, gy
            elif parameters == 3:
                line[0, count], line[1, count], line[2, count] = gx * x + gy * y, gx, gy
            else:
                line[0, count], line[1, count], line[2, count] = gx * x, gx * y, gx
                line[3, count], line[4, count], line[5, count] = gy * x, gy * y, gy
            if parameters == 8:
                along = gx * x + gy * y
                line[6, count], line[7, count] = -along * x, -along * y
            line[parameters, count] = template[v, u]
            line[parameters + 1, count] = above + q * (below - above)
            line[parameters + 2, count] = 1.0
            count += 1
        for a in range(size):
            for b in range(a, size):
                first, second = line[a, :count], line[b, :count]
                total = 0.0
                for k in range(count):
                    total += first[k] * second[k]
                sums[a, b] += total
    for a in range(size):
        for b in range(a):
            sums[a, b] = sums[b, a]
