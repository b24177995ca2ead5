"""Surface roughness: an isotropic, correlated Gaussian height field of stated Ra.

The field is white noise on a square lattice, filtered with the Gaussian kernel
``exp(-2 r^2 / l^2)``; its autocovariance is then ``exp(-(r / l)^2)``, the common model of a
random rough surface (Bennett and Mattsson, *Introduction to Surface Roughness and
Scattering*, 2nd ed., 1999), where l is the correlation length at which it falls to 1/e.  A
lattice of spacing l / 2 is enough: the kernel's spectrum leaves 1e-4 of ripple in the
variance.  A weighted sum of normal deviates is normal everywhere, between the nodes too, and
can be taken at any place by itself, so points may be scattered and memory stays bounded.

Ra is the arithmetic mean deviation (ISO 4287; for an area Sa of ISO 25178-2); for normal
heights it is ``sqrt(2 / pi)`` times their standard deviation.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.validation.types import NotNegative, Positive, Seed
from slbench.core.validation.values import checked

#: Nodes of the noise lattice along either axis; the field repeats beyond.
_NODES = 1024
#: Nodes a correlation length apart.
_NODES_PER_LENGTH = 2.0
#: Nodes summed on either side of a point: the kernel is below 4e-6 beyond 5 of them.
_REACH = 5
#: Points at a time: 100 weights each, 13 MB an array.
_CHUNK = 1 << 14


@checked
def rough_height(
    x_mm: ArrayLike,
    y_mm: ArrayLike,
    ra_um: NotNegative,
    correlation_length_um: Positive,
    seed: Seed,
) -> NDArray[np.float64]:
    """Height of a rough surface of zero mean at given places.

    Mean and Ra are those *of the points given*, each counting alike: their mean is removed
    and their mean absolute height made equal to `ra_um`, exactly.  Before that scaling, the
    same seed gives the same surface wherever it is sampled; it repeats after 512 correlation
    lengths.  For the Ra of a mesh whose points are unevenly spread, scale what this returns
    by :func:`mean_and_ra`.

    Parameters
    ----------
    x_mm, y_mm : array_like of float
        Places, of the same shape: scattered or a grid.
    ra_um : float
        Arithmetic mean deviation; 0 for a flat surface.
    correlation_length_um : float
        Distance at which the autocovariance is 1/e of the variance.
    seed : int
        Not negative; another seed, another surface.

    Returns
    -------
    ndarray of float64
        Heights, mm, of the shape of `x_mm`.

    Raises
    ------
    InputError
        If the places differ in shape or are not finite, or Ra is negative, the correlation
        length not positive, the seed not an integer from 0, or the points too few (or all at
        one place) to be rough.
    """
    x, y = np.asarray(x_mm, dtype=np.float64), np.asarray(y_mm, dtype=np.float64)
    if x.shape != y.shape:
        raise InputError("roughness: x_mm and y_mm", "equal shapes", f"{x.shape} and {y.shape}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("roughness: x_mm and y_mm", "finite places", "some that are not")
    if ra_um == 0.0:
        return np.zeros(x.shape)

    node_mm = 1e-3 * correlation_length_um / _NODES_PER_LENGTH
    noise = generator(seed).standard_normal((_NODES, _NODES))
    places = np.stack([x.ravel(), y.ravel()]) / node_mm
    height = np.empty(x.size)
    for start in range(0, x.size, _CHUNK):
        part = slice(start, start + _CHUNK)
        height[part] = _filtered(noise, places[:, part])
    height -= height.mean() if x.size else 0.0
    deviation = float(np.abs(height).mean()) if x.size else 0.0
    if deviation < 1e-9:  # heights are of the order of 1 here; at one place, of rounding
        raise InputError("roughness: points", "two or more at different places", x.size)
    return (1e-3 * ra_um / deviation * height).reshape(x.shape)


def mean_and_ra(vertices_mm: ArrayLike, faces: ArrayLike) -> tuple[float, float]:
    """Mean height of a triangulated surface, and its Ra about z = 0.

    Both are integrals over the projected area, exact for flat triangles: what an instrument
    would find that resolves the mesh.  A mesh has a little less Ra than its vertices, because
    it cuts the corners off hills and valleys.

    Parameters
    ----------
    vertices_mm : (n, 3) array_like of float
        Points.
    faces : (m, 3) array_like of int
        The triangles of the surface; a height field.

    Returns
    -------
    mean_mm : float
        Mean of z.
    ra_um : float
        Mean of ``|z|``.
    """
    corners = np.asarray(vertices_mm, dtype=np.float64)[np.asarray(faces)]
    first, second = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    # A triangle that z = 0 cuts has one corner of its own sign, the tip.  The piece cut off
    # holds tip^3 / (3 (tip - a) (tip - b)) of the mean, which |mean| counts negatively.
    low, middle, high = np.sort(corners[:, :, 2], axis=1).T
    mean = (low + middle + high) / 3.0
    cut = (low < 0.0) & (high > 0.0)
    tip, far = np.where(middle > 0.0, [low, high], [high, low])
    spread = np.where(cut, (tip - middle) * (tip - far), 1.0)
    piece = np.where(cut, np.abs(tip) ** 3 / (3.0 * spread), 0.0)
    absolute = np.where(middle > 0.0, mean, -mean) + 2.0 * piece
    absolute = np.where(cut, absolute, np.abs(mean))
    return float(np.average(mean, weights=area)), 1e3 * float(np.average(absolute, weights=area))


def _filtered(noise: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum the noise around every place, given in lattice spacings, (2, n) float."""
    around = np.arange(1 - _REACH, _REACH + 1)
    nodes = np.floor(places).astype(np.int64)[..., None] + around
    distance = (nodes - places[..., None]) / _NODES_PER_LENGTH
    weight_x, weight_y = np.exp(-2.0 * distance**2)
    column, row = nodes % _NODES
    patch = noise[row[:, :, None], column[:, None, :]]
    return np.einsum("nyx,ny,nx->n", patch, weight_y, weight_x, optimize=False)
