"""Measure ellipses in an image by sub-pixel points of their edge.

The edge is first looked for on a few rays from the centre, where a step between the plateaus
inside and outside would have the same integral.  Then, near its place, on as many rays as the
outline has pixels, by the shift of each ray's profile against the mean L(s) of all: least
squares give

    e(theta) = - sum L'(s) (P(s, theta) - L(s)) / sum L'(s)^2 ,

which is the best that white noise permits, whatever the shape of the blur (the mean profile
is the template, so no model of it is needed), and blur that is symmetric does not move it.
Uneven light does not either: the part of ``P - L`` that varies over the dot as light does, as
``s L(s)`` and, where the window leaves clear ground on both sides of the edge, ``s``, times
the cosine and sine of theta, is fitted along with the shift and taken out.

An ellipse is ``x = centre + M (cos theta, sin theta)``, with rays sampled in that frame, where
it is the unit circle.  A small change of it moves the edge along the rays by

    e(theta) - 1 = c + x cos(theta) + y sin(theta) + a cos(2 theta) + b sin(2 theta),

linear in the five unknowns: the centre moves by ``M (x, y)``, and M becomes ``M (I + E)`` with
``E = [[c + a, b], [b, c - a]]``.  Least squares with Tukey's weights (J. W. Tukey's biweight,
95 % efficient) and sampling anew on the changed ellipse are repeated until all is still.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Tukey's tuning constant.
_TUKEY = 4.685
#: Samples interpolated at once, 16 MB an array.
SAMPLES_AT_ONCE = 1 << 21
#: A plateau may be off its dot's by this fraction of the contrast; beyond, something else is
#: there (the end of the light, dust, another dot) and the ray is left out.
_PLATEAU_TOLERANCE = 0.3
#: Rays of the first passes, and most of the last.
_FEW_RAYS, _MOST_RAYS = 48, 720
#: Least half-width of the window about the edge, px: a sharp edge of pixels and two samples
#: of each plateau.
_LEAST_WINDOW_PX = 2.5
#: Neighbouring rays, about 1 px apart, share the noise of the pixels interpolated: the
#: variance of the mean of many is that much larger than for independent rays.
_CORRELATION = 2.0
#: Least fraction of rays that a fit needs.
_LEAST_COVERAGE = 0.2
#: Passes in the narrow window end when no centre moves further than this, px, or a tenth of
#: its deviation, and after this many.
_STILL_PX, _MOST_PASSES = 2e-4, 5
#: Scatter of an edge that is taken for granted, px: interpolation alone has some.
_LEAST_SCATTER_PX = 0.02
#: The change of an ellipse along its rays: 1, cos, sin, cos 2, sin 2.
_HARMONICS = ((0, np.cos), (1, np.cos), (1, np.sin), (2, np.cos), (2, np.sin))
#: Windows narrower than this fraction of the radius leave a ring of the dot's inside to see
#: uneven light by; in wider ones a shift of the dot would look the same.
_NARROW = 0.6
#: Edges this close to the ellipse, in radii, are of its outline.
_NEAR_OUTLINE = 0.15
#: Distance from 10 % to 90 % of a Gaussian edge, in standard deviations.
_TEN_TO_NINETY = 2.563


@dataclass(frozen=True)
class Ellipses:
    """Ellipses measured in an image, n of them.

    Parameters
    ----------
    centres : (n, 2) float
        Centres (u, v), px.
    matrices : (n, 2, 2) float
        Maps of the unit circle to the ellipse about its centre, px.
    contrast : (n,) float
        Brightness outside less inside.
    width : (n,) float
        Width of the edge from 10 % to 90 %, px.
    coverage : (n,) float
        Fraction of the rays that met an edge.
    sd : (n,) float
        Predicted standard deviation of the centre along either axis, px.
    """

    centres: Array
    matrices: Array
    contrast: Array
    width: Array
    coverage: Array
    sd: Array

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def radii(self) -> Array:
        """Radius of the circle of the same area, (n,), px."""
        return np.sqrt(np.abs(np.linalg.det(self.matrices)))

    def select(self, which: NDArray[Any]) -> Self:
        """Return some of the ellipses, by mask or by index."""
        return type(self)(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def put(self, where: NDArray[Any], others: Ellipses) -> None:
        """Overwrite some of the ellipses, by index, with others."""
        for f in fields(self):
            getattr(self, f.name)[where] = getattr(others, f.name)

    def axes(self) -> tuple[Array, Array]:
        """Return the semi-axes (n, 2), the major one first, and the major one's angle (n,)."""
        directions, lengths, _ = np.linalg.svd(self.matrices)
        angle = np.arctan2(directions[:, 1, 0], directions[:, 0, 0])
        # The axis has no sense: (-pi/2, pi/2].
        return lengths, -(np.mod(np.pi / 2.0 - angle, np.pi) - np.pi / 2.0)


def circles(centres: Array, radii: Array) -> Ellipses:
    """Return circles of which nothing else is known yet."""
    matrices = radii[:, None, None] * np.eye(2)
    return Ellipses(centres, matrices, *np.zeros((4, len(centres))))


@njit(parallel=True, cache=True)
def sample_rays(image, centres, matrices, cosine, sine, positions, out):  # type: ignore[no-untyped-def]
    """Interpolate an image bilinearly at points ``centre + s M (cos, sin)``; NaN outside it.

    ``cv2.remap`` rounds coordinates to 1/32 px, which is too coarse here.

    Parameters
    ----------
    image : (V, U) float
    centres, matrices : (n, 2) and (n, 2, 2) float
    cosine, sine : (K,) float
        Of the rays' angles.
    positions : (n, S) float
        Where on the rays, s.
    out : (n, K, S) float
        Result.
    """
    rows, columns = image.shape
    for i in prange(len(centres)):
        m = matrices[i]
        for k in range(len(cosine)):
            du = m[0, 0] * cosine[k] + m[0, 1] * sine[k]
            dv = m[1, 0] * cosine[k] + m[1, 1] * sine[k]
            for j in range(positions.shape[1]):
                u = centres[i, 0] + positions[i, j] * du
                v = centres[i, 1] + positions[i, j] * dv
                if not (u >= 0.0 and v >= 0.0 and u <= columns - 1.0 and v <= rows - 1.0):
                    out[i, k, j] = np.nan
                    continue
                column, row = min(int(u), columns - 2), min(int(v), rows - 2)
                f, g = u - column, v - row
                top = image[row, column] * (1.0 - f) + image[row, column + 1] * f
                bottom = image[row + 1, column] * (1.0 - f) + image[row + 1, column + 1] * f
                out[i, k, j] = top * (1.0 - g) + bottom * g


def locate(image: Array, centres: Array, radii: Array) -> Ellipses:
    """Find the ellipses of dark dots roughly, on few rays.

    Parameters
    ----------
    image : (V, U) float
    centres, radii : (n, 2) and (n,) float
        First estimates, good to about a third of the radius.

    Returns
    -------
    Ellipses
        Good to about a tenth of a pixel or of the blur; those whose fit failed are left out.
    """
    ellipses = circles(centres, radii)
    for _ in range(3):
        ellipses = _pass(image, ellipses, 0.6 * ellipses.radii, coarse=True)
        ellipses = ellipses.select(ellipses.coverage > 0.0)
    return ellipses


def refine(image: Array, ellipses: Ellipses, room_px: Array) -> Ellipses:
    """Measure the ellipses of dark dots.

    Parameters
    ----------
    image : (V, U) float
    ellipses : Ellipses
        From :func:`locate`.
    room_px : (n,) float
        Distance from each centre within which there is no other dot's blur.

    Returns
    -------
    Ellipses
        In the order given, less those whose fit failed.
    """
    moving = np.arange(len(ellipses))
    for number in range(_MOST_PASSES):
        some = ellipses.select(moving)
        window = np.minimum(1.5 * some.width + 1.5, room_px[moving] - some.radii)
        done = _pass(image, some, window, coarse=False)
        ellipses.put(moving, done)
        moved = np.linalg.norm(done.centres - some.centres, axis=1)
        going = moved > np.maximum(0.1 * done.sd, _STILL_PX)
        # The first pass changes the width too, and so the window of the second.
        moving = moving[(done.coverage > 0.0) & (going | (number == 0))]
    return ellipses.select(ellipses.coverage > 0.0)


def _pass(image: Array, ellipses: Ellipses, window: Array, *, coarse: bool) -> Ellipses:
    """Sample edges in windows of half-width `window`, px, and change the ellipses by them."""
    radii = np.maximum(ellipses.radii, 1.0)
    window = np.clip(window, np.minimum(_LEAST_WINDOW_PX, 0.95 * radii), 0.95 * radii)
    if coarse:
        rays = np.full(len(radii), _FEW_RAYS)
    else:
        # In quarters of octaves: dots of like size are done together.
        rounded = 2.0 ** (np.ceil(4.0 * np.log2(radii)) / 4.0)
        rays = np.clip(np.rint(2.0 * np.pi * rounded), 32, _MOST_RAYS).astype(np.int64)
    # An odd number of samples, less than a pixel apart, in steps that leave few groups.
    samples = 8 * np.ceil((2.0 * window + 4.0) / 8.0).astype(np.int64) + 1
    out = circles(ellipses.centres.copy(), radii)
    for count, size in np.unique(np.stack((rays, samples), axis=1), axis=0).tolist():
        group = np.flatnonzero((rays == count) & (samples == size))
        at_once = max(1, SAMPLES_AT_ONCE // (count * size))
        for first in range(0, len(group), at_once):
            some = group[first : first + at_once]
            done = _fit(
                image, ellipses.select(some), window[some] / radii[some], count, size, coarse=coarse
            )
            out.put(some, done)
    return out


def _fit(
    image: Array,
    ellipses: Ellipses,
    window: Array,
    n_rays: int,
    n_samples: int,
    *,
    coarse: bool,
) -> Ellipses:
    """Find edges within 1 +- `window` on the rays of the ellipses, and fit."""
    angle = 2.0 * np.pi * np.arange(n_rays) / n_rays
    offset = window[:, None] * np.linspace(-1.0, 1.0, n_samples)  # (n, S)
    profiles = np.empty((len(ellipses), n_rays, n_samples))
    sample_rays(
        image,
        ellipses.centres,
        ellipses.matrices,
        np.cos(angle),
        np.sin(angle),
        1.0 + offset,
        profiles,
    )
    valid: Mask = np.all(np.isfinite(profiles), axis=2)
    profiles[~valid] = 0.0
    ends = max(2, n_samples // 6)
    inside, outside = profiles[..., :ends].mean(axis=2), profiles[..., -ends:].mean(axis=2)
    low, high = _median(inside, valid), _median(outside, valid)
    contrast = high - low
    tolerance = _PLATEAU_TOLERANCE * np.abs(contrast)[:, None]
    valid &= np.abs(inside - low[:, None]) < tolerance
    valid &= np.abs(outside - high[:, None]) < tolerance
    design = np.stack([f(n * angle) for n, f in _HARMONICS], axis=1)
    if coarse:
        edge = _by_integral(profiles, low, high, window)
        inflation = np.ones(len(edge))
    else:
        # Clear ground: plateaus within the window, on both sides of the edge.
        width = ellipses.width / ellipses.radii
        reaching = window > 1.2 * width
        kinds = np.stack((reaching, reaching & (window < _NARROW)), axis=1)
        edge, inflation = _by_template(profiles, valid, offset, design, kinds)
    # An edge at either end of the window is none: the plateau is not there.
    valid &= np.abs(edge) < 0.8 * window[:, None]
    values, weights, covariance = _robust(design, edge, valid, _LEAST_SCATTER_PX / ellipses.radii)
    good = ((weights > 0.0).mean(axis=1) > _LEAST_COVERAGE) & (contrast > 0.0)
    # A few per cent of sound rays are outliers to the fit, yet show the outline.
    coverage = (valid & (np.abs(edge - values @ design.T) < _NEAR_OUTLINE)).mean(axis=1)
    values = np.where(good[:, None], np.clip(values, -0.5, 0.5), 0.0)

    c, x, y, a, b = values.T
    change = np.stack((1.0 + c + a, b, b, 1.0 + c - a), axis=1).reshape(-1, 2, 2)
    shift = np.einsum("nij,nj->ni", ellipses.matrices, np.stack((x, y), axis=1))
    in_pixels = ellipses.matrices @ covariance[:, 1:3, 1:3] @ ellipses.matrices.transpose(0, 2, 1)
    variance = 0.5 * inflation * np.trace(in_pixels, axis1=1, axis2=2)
    # Rays closer together than a pixel share its noise.
    rays_per_px = n_rays / (2.0 * np.pi * ellipses.radii)
    sd = np.sqrt(variance * np.maximum(_CORRELATION * rays_per_px, 1.0))
    mean = np.einsum("nk,nks->ns", weights, profiles)
    mean /= np.maximum(weights.sum(axis=1), 1e-9)[:, None]
    level = (mean - low[:, None]) / np.where(contrast > 0.0, contrast, 1.0)[:, None]
    # For a Gaussian blur of deviation s the integral of L (1 - L) is s / sqrt(pi).
    spread = np.maximum(level * (1.0 - level), 0.0).sum(axis=1)
    pixels_per_sample = 2.0 * window * ellipses.radii / (n_samples - 1)
    return Ellipses(
        ellipses.centres + shift,
        ellipses.matrices @ change,
        contrast,
        _TEN_TO_NINETY * np.sqrt(np.pi) * spread * pixels_per_sample,
        np.where(good, coverage, 0.0),
        np.where(good, sd, np.nan),
    )


def _by_integral(profiles: Array, low: Array, high: Array, window: Array) -> Array:
    """Return where a step has the integral of each profile, (n, K), from the window's middle."""
    step = np.where(high > low, high - low, 1.0)[:, None, None]
    level = np.clip((profiles - low[:, None, None]) / step, -0.5, 1.5)
    # By the trapezoid rule; the integral is the distance from the edge to the far end.
    integral = level.sum(axis=2) - 0.5 * (level[..., 0] + level[..., -1])
    edge: Array = window[:, None] * (1.0 - 2.0 / (profiles.shape[2] - 1) * integral)
    return edge


def _by_template(
    profiles: Array, valid: Mask, offset: Array, design: Array, kinds: Mask
) -> tuple[Array, Array]:
    """Return the shift of each profile against the mean profile of its dot, (n, K).

    `kinds` (n, 2) tells which kinds of uneven light to reckon with: ``s L(s)``, ``s``.  Also
    returned is the factor by which that raises the variance of the centre, (n,).
    """
    # Harmonics of the profiles in theta, sample by sample, over the valid rays: (n, 5, S).
    normal = np.einsum("nk,ki,kj->nij", valid.astype(np.float64), design, design)
    right = np.einsum("nk,ki,nks->nis", valid.astype(np.float64), design, profiles)
    harmonics = np.linalg.solve(normal + 1e-9 * np.eye(design.shape[1]), right)
    mean, first = harmonics[:, 0], harmonics[:, 1:3]
    slope = np.gradient(mean, axis=1) / (offset[:, 1] - offset[:, 0])[:, None]
    position = 1.0 + offset
    by_light, by_offset = (kind[:, None] for kind in kinds.T)
    # Unit columns: the solution must not depend on the image's units.
    columns = np.stack(
        (slope, position * mean * by_light, position * by_offset), axis=2
    )  # (n, S, 3)
    columns /= np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-12)
    gram = columns.transpose(0, 2, 1) @ columns + 1e-9 * np.eye(3)
    parts = np.linalg.solve(gram, columns.transpose(0, 2, 1) @ first.transpose(0, 2, 1))
    light = columns[:, :, 1:] @ parts[:, 1:]  # (n, S, 2), of cosine and sine
    power = np.maximum((slope**2).sum(axis=1), 1e-12)[:, None]
    filtered = np.einsum("nks,ns->nk", profiles, slope)
    filtered -= (slope * mean).sum(axis=1)[:, None]
    filtered -= np.einsum("ns,nsi->ni", slope, light) @ design[:, 1:3].T
    # How much the centre's variance grows because light is fitted too; columns are of unit
    # length, so it is 1 where the slope is like neither kind.
    return -filtered / power, np.linalg.inv(gram)[:, 0, 0]


def _median(data: Array, valid: Mask) -> Array:
    """Median of each row (n, K) over its valid entries, (n,); 0 where none is."""
    ordered = np.sort(np.where(valid, data, np.inf), axis=1)
    count = valid.sum(axis=1)
    row = np.arange(len(data))
    low = ordered[row, np.maximum(count - 1, 0) // 2]
    high = ordered[row, np.minimum(count // 2, data.shape[1] - 1)]
    return np.where(count > 0, 0.5 * (low + high), 0.0)


def _robust(design: Array, data: Array, valid: Mask, least: Array) -> tuple[Array, Array, Array]:
    """Fit rows of data by Tukey's biweight.

    Parameters
    ----------
    design : (K, p) float
    data : (n, K) float
    valid : (n, K) bool
    least : (n,) float
        Least scatter to reckon with.

    Returns
    -------
    values : (n, p) float
    weights : (n, K) float
        Zero for outliers.
    covariance : (n, p, p) float
        Of the values, for independent errors.
    """
    size = design.shape[1]
    products = design[:, :, None] * design[:, None, :]
    # The start has to withstand outliers: the median alone.
    residual = data - _median(data, valid)[:, None]
    for _ in range(5):
        scale = np.maximum(1.4826 * _median(np.abs(residual), valid), least)
        ratio = residual / (_TUKEY * scale)[:, None]
        weights = np.where(valid & (np.abs(ratio) < 1.0), (1.0 - ratio**2) ** 2, 0.0)
        # A trace of the identity: rows without data have a solution too.
        normal = np.tensordot(weights, products, axes=(1, 0)) + 1e-12 * np.eye(size)
        values = np.linalg.solve(normal, ((weights * data) @ design)[..., None])[..., 0]
        residual = data - values @ design.T
    freedom = np.maximum(weights.sum(axis=1) - size, 1.0)
    variance = (weights * residual**2).sum(axis=1) / freedom
    covariance: Array = variance[:, None, None] * np.linalg.inv(normal)
    return values.astype(np.float64), weights, covariance
