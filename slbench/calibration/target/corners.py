"""Find the inner corners of a chequerboard in an image, however many of them are in view.

A corner where four squares meet is a saddle of brightness: the determinant of the Hessian is
negative there, and stays so when the picture is blurred.  Candidates are the local extremes of

    S = I_xy^2 - I_xx I_yy

at several scales.  A ring around a true one is bright, dark, bright, dark; edges and ends of lines
are sifted out so.  The place is then refined by ``cv2.cornerSubPix``, the point to which all
gradients about it are perpendicular (W. Förstner, E. Gülch, 1987).

Its deviation is what noise permits at best: with gradients g about the corner, ``sigma_n^2
(sum g g^T)^-1``, the noise of the picture told by its second differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Scales at which saddles are looked for, standard deviations of the smoothing, px.
_SCALES = (1.5, 3.0, 6.0)
#: Least saddle of a candidate, as a share of the strongest at its scale (the square of contrast).
_LEAST_SADDLE = 0.05
#: Samples on the ring, its radius in scales, and least contrast of its sectors as a share of the
#: picture's range.
_RING, _RING_RADIUS, _LEAST_CONTRAST = 64, 2.5, 0.08
#: Most candidates of a scale: a picture of anything else has to end too.
_MOST = 4000
#: Least and largest half of the window in which a corner is refined and judged, px.
_LEAST_WINDOW_PX, _MOST_WINDOW_PX = 3, 40
#: Smoothing before a corner is refined, px.  Edges sharper than a pixel have gradients that depend
#: on where they cross it: corners of rendered boards are 0.04 px off without, 0.02 px with it.
#: Less in a small window, half of which is this many of its deviations at least: what is beyond
#: must not be smeared into it.
_SMOOTH_PX, _WINDOW_SMOOTHS = 1.2, 4.0
#: Deviation that is taken for granted, px: what is left of that.
LEAST_SD_PX = 0.02


@dataclass(frozen=True)
class Saddles:
    """Places where four sectors meet, n of them.

    Parameters
    ----------
    points : (n, 2) float
        Image coordinates, px.
    bright : (n,) float
        Direction of a bright sector, from u towards v, rad, modulo pi.
    """

    points: Array
    bright: Array


def detect_saddles(picture: Array) -> Saddles:
    """Find where four sectors meet, bright and dark in turn, to a pixel.

    Parameters
    ----------
    picture : (V, U) float

    Returns
    -------
    Saddles
        None at all where there are none.
    """
    span = float(np.subtract(*np.percentile(picture, (99.0, 1.0))))
    points, bright = np.empty((0, 2)), np.empty(0)
    for scale in _SCALES:
        smooth = cv2.GaussianBlur(picture, (0, 0), scale)
        dv, du = np.gradient(smooth)
        dvv, duv = np.gradient(dv)
        duu = np.gradient(du, axis=1)
        saddle = duv**2 - duu * dvv
        size = 2 * int(np.ceil(scale)) + 1
        peak = saddle == cv2.dilate(saddle, np.ones((size, size), np.uint8))
        peak &= saddle > _LEAST_SADDLE * float(saddle.max())
        v, u = np.nonzero(peak)
        strongest = np.argsort(-saddle[v, u], kind="stable")[:_MOST]
        places = np.column_stack((u, v))[strongest].astype(np.float64)
        good, direction = _ringed(smooth, places, _RING_RADIUS * scale, _LEAST_CONTRAST * span)
        places, direction = places[good], direction[good]
        if len(points) and len(places):
            # Once each: a finer scale has the better place.
            away = np.linalg.norm(places[:, None] - points[None], axis=2).min(axis=1)
            places, direction = places[away > 2.0 * scale], direction[away > 2.0 * scale]
        points, bright = np.concatenate((points, places)), np.concatenate((bright, direction))
    return Saddles(points, bright)


def _ringed(
    smooth: Array, places: Array, radius: float, contrast: float
) -> tuple[NDArray[np.bool_], Array]:
    """Return which places have a ring of four sectors, and the direction of a bright one."""
    angle = 2.0 * np.pi * np.arange(_RING) / _RING
    if len(places) == 0:
        return np.empty(0, dtype=np.bool_), np.empty(0)
    u = places[:, :1] + radius * np.cos(angle)
    v = places[:, 1:] + radius * np.sin(angle)
    ring = cv2.remap(
        smooth.astype(np.float32),
        u.astype(np.float32),
        v.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float64)
    middle = 0.5 * (ring.max(axis=1) + ring.min(axis=1))
    above = ring > middle[:, None]
    changes = np.count_nonzero(above != np.roll(above, 1, axis=1), axis=1)
    wave = np.fft.fft(ring, axis=1)
    second = np.abs(wave[:, 2])
    # Four sectors: the second harmonic rules, the first (an edge, a blob's flank) does not.
    good = (changes == 4) & (4.0 * second / _RING > contrast) & (second > 2.0 * np.abs(wave[:, 1]))
    inside = (u.min(axis=1) >= 0) & (v.min(axis=1) >= 0)
    inside &= (u.max(axis=1) < smooth.shape[1]) & (v.max(axis=1) < smooth.shape[0])
    return good & inside, np.mod(-0.5 * np.angle(wave[:, 2]), np.pi)


def window_px(reach_px: float) -> int:
    """Return half the window of a corner, px, where nothing else is within a reach of it."""
    return int(np.clip(np.floor(reach_px), _LEAST_WINDOW_PX, _MOST_WINDOW_PX))


def refine_corners(picture: Array, points: Array, half: int) -> tuple[Array, Array]:
    """Refine corners that are known to a pixel or two.

    Parameters
    ----------
    picture : (V, U) float
    points : (n, 2) float
    half : int
        Half the window, px.

    Returns
    -------
    points : (n, 2) float
    sd : (n,) float
        What noise permits at best along the worse direction, px.  Infinite where the window
        leaves the picture, which moves a corner by a tenth of a pixel, or a corner ran away.
    """
    smoothing = min(_SMOOTH_PX, half / _WINDOW_SMOOTHS)
    grey = cv2.GaussianBlur(picture, (0, 0), smoothing).astype(np.float32)
    found = np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 1, 2).copy()
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    cv2.cornerSubPix(grey, found, (half, half), (-1, -1), criteria)
    refined = found.reshape(-1, 2).astype(np.float64)
    noise = picture_noise(picture)
    du, dv = np.gradient(picture, axis=1), np.gradient(picture, axis=0)
    rows, columns = picture.shape
    last = np.array([columns, rows]) - 2 - half
    deviations = np.full(len(points), np.inf)
    still = np.linalg.norm(refined - points, axis=1) <= half
    pixel = np.rint(refined).astype(np.int64)
    inside = np.all((pixel > half) & (pixel < last), axis=1)
    for k in np.flatnonzero(still & inside):
        u, v = pixel[k, 0], pixel[k, 1]
        box = np.s_[v - half : v + half + 1, u - half : u + half + 1]
        gu, gv = du[box].ravel(), dv[box].ravel()
        # The noise has gradients too: half its variance a pixel by central differences.
        own = 0.5 * noise**2 * len(gu)
        tensor = np.array([[gu @ gu - own, gu @ gv], [gu @ gv, gv @ gv - own]])
        least = float(np.linalg.eigvalsh(tensor)[0])
        if least > 0.0:
            deviations[k] = noise / np.sqrt(least)
    return refined, np.hypot(deviations, LEAST_SD_PX)


def picture_noise(picture: Array) -> float:
    """Return the standard deviation of a picture's noise, told by its second differences.

    ``[1 -2 1; -2 4 -2; 1 -2 1]`` is blind to planes and to edges along rows and columns; of what
    is left the median counts, which fine texture does not carry away (J. Immerkær, CVIU 64, 1996).
    """
    kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
    response = cv2.filter2D(picture, cv2.CV_64F, kernel)[1:-1, 1:-1]
    return float(np.median(np.abs(response)) / 0.6745 / 6.0)
