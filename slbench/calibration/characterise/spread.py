r"""The line spread of projector and camera: contrast over fringe count, and a slanted edge.

Fringes of ``f`` cycles a panel pixel keep of their contrast

    sinc(f) sinc(f g) exp(-2 pi^2 f^2 (s_p^2 + g^2 s_c^2))

for square pixels of both devices and Gaussian blur ``s_p`` of the projector and ``s_c`` of the
camera, each in its own pixels, where ``g`` panel pixels lie beside each other in a camera pixel.
Fringes tell the sum alone.  The camera's share comes from an edge that it sees a little turned to
its pixels (ISO 12233:2017, e-SFR): a step through a Gaussian, integrated over square pixels, is
fitted.

Frames of a set that vibrate by ``s`` camera pixels lose contrast as by a blur of ``g s``, which is
taken out where repeats tell the vibration.  Defocus and diffraction are in both blurs, as they are
at the depth that was captured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.frames import Shot, flats, unsaturated
from slbench.calibration.characterise.quantity import (
    BLOCKS,
    LEVEL,
    Quantity,
    Untold,
    blocks,
    jackknife,
)
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.patterns import Fringes
from slbench.patterns.base import Axis, Code

Array = NDArray[np.float64]

#: Least contrast of a set, of the coarsest, and least modulation of a pixel, of the largest.
_LEAST, _LIT = 0.05, 0.2
#: Fringes whose contrast is lost by less than this tell no blur.
_LOST = 0.02
#: Sides of an edge's window, px; contrast of its sides in deviations of the noise.
_WINDOW, _CONTRAST = 8, 10.0
#: Places in a pixel over which an edge is integrated, each axis.
_INSIDE = 4
#: Slant of an edge that shows it between pixels, rad.
_SLANT = np.radians(1.5)

_LENS = "defocus and diffraction of this depth count too"


class Contrast(NamedTuple):
    """Contrast over fringes of one axis, of the coarsest set, without that of square pixels."""

    axis: Axis
    cycles: Array
    """A panel pixel, (K,)."""
    kept: Array
    """(K,)."""
    blur_px: float
    """Of both devices, panel px."""


def camera_blur(
    found: Sequence[Shot], edge: tuple[int, int, int, int] | None, top: float
) -> tuple[list[Quantity], list[Untold]]:
    """Measure the camera's blur by a slanted edge in the white frame.

    Parameters
    ----------
    found : sequence of Shot
    edge : (u, v, width, height) or None
        Window that holds one straight edge and nothing else, px.
    top : float

    Raises
    ------
    InputError
        For a window that leaves the picture or shows no slanted edge.
    """
    from scipy.stats import norm

    name = "camera blur"
    if edge is None:
        capture = "a white frame with a straight edge, turned by some degrees, and --edge"
        return [], [Untold(name, "no edge was named", capture)]
    white = next((one for ramp in flats(found).values() if (one := ramp.get(1.0))), None)
    if white is None:
        return [], [Untold(name, "there is no white frame", "a white frame")]
    u, v, width, height = edge
    image = white.stack().mean(axis=0)
    inside = u >= 0 and v >= 0 and u + width <= image.shape[1] and v + height <= image.shape[0]
    if not inside or min(width, height) < _WINDOW:
        rows, columns = image.shape
        expected = f"a window of {_WINDOW} px or more each way in {columns} x {rows} px"
        raise InputError("edge", expected, f"{u},{v},{width},{height}")
    own = image[v : v + height, u : u + width].astype(np.float64)
    if not unsaturated([own], top).all():
        raise InputError("edge", "a window without saturated pixels", "some")
    value, deviation = _edge_blur(own)
    half = deviation * norm.ppf(0.5 + 0.5 * LEVEL)
    return [
        Quantity(
            name=name,
            value=value,
            low=max(value - half, 0.0),
            high=value + half,
            unit="px",
            method=f"slanted edge of {width} x {height} px",
            key=("camera", "blur_px"),
            note=_LENS,
        )
    ], []


def _edge_blur(image: Array) -> tuple[float, float]:
    """Return the deviation of a Gaussian that blurs a straight edge, px, and its own."""
    from scipy.optimize import least_squares
    from scipy.special import ndtr

    rows, columns = image.shape
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    x -= 0.5 * (columns - 1)
    y -= 0.5 * (rows - 1)
    within = (np.arange(_INSIDE) + 0.5) / _INSIDE - 0.5
    dx, dy = (one.ravel()[:, np.newaxis, np.newaxis] for one in np.meshgrid(within, within))
    low, high = np.quantile(image, [0.05, 0.95])
    gy, gx = np.gradient(image)
    start = np.arctan2(gy.sum(), gx.sum())
    middle = image > 0.5 * (low + high)
    side = x * np.cos(start) + y * np.sin(start)
    place = float(np.sort(side.ravel())[np.count_nonzero(~middle)]) if middle.any() else 0.0

    def model(p: Array) -> Array:
        angle, at, sigma, dark, bright, tilt_dark, tilt_bright = p
        c, s = np.cos(angle), np.sin(angle)
        far = (x + dx) * c + (y + dy) * s - at
        share = ndtr(far / max(abs(sigma), 1e-3)).mean(axis=0)
        plain = x * c + y * s - at
        lit = bright + tilt_bright * np.maximum(plain, 0.0)
        return np.asarray((dark + tilt_dark * np.minimum(plain, 0.0)) * (1.0 - share) + lit * share)

    def residual(p: Array) -> Array:
        return (model(p) - image).ravel()

    fit = least_squares(
        residual, [start, place, 0.8, low, high, 0.0, 0.0], x_scale=[0.1, 1, 1, high, high, 1, 1]
    )
    noise = np.sqrt(2.0 * fit.cost / (image.size - len(fit.x)))
    angle, _, sigma, dark, bright, *_ = fit.x
    turned = abs((angle + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi)
    if bright - dark < _CONTRAST * noise or turned < _SLANT:
        expected = "one straight edge, turned by two degrees or more to the pixels"
        got = f"contrast {bright - dark:.3g} DN, {np.degrees(turned):.2g} degrees"
        raise InputError("edge", expected, got)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * noise**2
    return abs(float(sigma)), float(np.sqrt(covariance[2, 2]))


def projector_blur(
    captures: Mapping[str, Capture],
    camera: Quantity | None,
    vibration: Quantity | None,
    shaken: Mapping[Code, NDArray[np.floating]],
    top: float,
) -> tuple[list[Quantity], list[Untold], list[Contrast]]:
    """Measure the projector's blur by the contrast of fringes of several counts.

    Parameters
    ----------
    captures : mapping of str to Capture
    camera : Quantity or None
        Blur of the camera; None leaves it in.
    vibration : Quantity or None
        From frame to frame; None leaves it in.
    shaken : mapping of Code to (..., 2) float
        Displacements, px, of the repeats of a set's frames.
    top : float
    """
    quantities: list[Quantity] = []
    curves = []
    axes: tuple[Axis, ...] = ("u", "v")
    for axis in axes:
        measured = _of_axis(captures, axis, camera, vibration, shaken, top)
        if measured is not None:
            quantities.append(measured[0])
            curves.append(measured[1])
    if not quantities:
        capture = "fringes of few and of many, such as 1,8,64@8, on a plane"
        why = "no two sets of fringes of one axis differ enough in contrast"
        return [], [Untold("projector blur", why, capture)], []
    return quantities[:1], [], curves


def _of_axis(
    captures: Mapping[str, Capture],
    axis: Axis,
    camera: Quantity | None,
    vibration: Quantity | None,
    shaken: Mapping[Code, NDArray[np.floating]],
    top: float,
) -> tuple[Quantity, Contrast] | None:
    sets: dict[Fringes, list[NDArray[np.float32]]] = {}
    first = next(iter(captures.values()))
    for capture in captures.values():
        sequence = capture.sequence
        if sequence.crosstalk is not None or sequence.panel != first.sequence.panel:
            continue
        for placed in sequence.placed():
            if isinstance(placed.code, Fringes) and placed.code.axis == axis:
                own = capture.frames[placed.frames.start : placed.frames.stop]
                sets.setdefault(placed.code, []).append(own.astype(np.float32))
    panel = first.sequence.panel
    size = first.sequence.size(axis)
    codes = sorted(sets, key=lambda code: code.fringe_count(panel))
    if len(codes) < 2:
        return None
    frames = [np.mean(sets[code], axis=0) for code in codes]
    good = np.logical_and.reduce([unsaturated(one, top) for one in frames])
    sizes = [code.relative_phase(own, panel)[1] for code, own in zip(codes, frames, strict=True)]
    if not good.any():
        return None
    good &= sizes[0] > _LIT * np.quantile(sizes[0][good], 0.99)
    number = blocks(good.shape)[good]
    cycles = np.array([code.fringe_count(panel) / size for code in codes])
    across = _across(frames[-1], codes[-1], panel, size, good)
    step = float(np.hypot(*across))
    # A panel's and a camera's square pixels, and what vibrates.
    square = np.sinc(cycles) * np.sinc(cycles * step)
    loss = [_shaken(code, len(sets[code]), across, vibration, shaken.get(code)) for code in codes]
    square *= np.exp(-2.0 * np.pi**2 * cycles**2 * [variance for variance, _ in loss])
    added = [np.bincount(number, one[good], BLOCKS**2) for one in sizes]
    sums = np.stack(added, axis=1).astype(np.float64)
    total = sums.sum(axis=0)
    kept = total / total[0] / (square / square[0])
    used = kept >= _LEAST
    used[0] = True
    far = 2.0 * np.pi**2 * (cycles**2 - cycles[0] ** 2)
    if used.sum() < 2 or kept[used].min() > 1.0 - _LOST:
        return None

    def estimate(own: Array) -> Array:
        share = (own / own[0] / (square / square[0]))[used]
        # The error of a logarithm is that of the contrast over it.
        weight = share**2
        variance = -(weight * far[used] * np.log(share)).sum() / (weight * far[used] ** 2).sum()
        return np.array([variance])

    result = jackknife(sums, estimate)
    both = max(float(result.value[0]), 0.0)
    camera_part, spread, note = 0.0, 0.0, f"the camera's blur is in it; {_LENS}"
    if camera is not None:
        camera_part = (step * camera.value) ** 2
        spread = step**2 * 0.5 * (camera.high**2 - camera.low**2)
        note = f"without the camera's {step * camera.value:.3g} px; {_LENS}"
    if vibration is not None:
        note = f"without the vibration's {np.sqrt(loss[-1][0]):.2g} px; {note}"
    half = float(np.linalg.norm([result.half_width[0], spread, loss[-1][1]]))
    value, low, high = (
        float(np.sqrt(max(both - camera_part + sign * half, 0.0))) for sign in (0.0, -1.0, 1.0)
    )
    counts = ", ".join(f"{code.fringe_count(panel):g}" for code in codes)
    quantity = Quantity(
        name="projector blur",
        value=value,
        low=low,
        high=high,
        unit="px",
        method=f"contrast of {counts} fringes along {axis}",
        key=("projector", "blur_px"),
        note=note,
    )
    return quantity, Contrast(axis, cycles[used], kept[used], float(np.sqrt(both)))


def _shaken(
    code: Fringes,
    repeats: int,
    across: tuple[float, float],
    vibration: Quantity | None,
    moved: NDArray[np.floating] | None,
) -> tuple[float, float]:
    """Return the variance of a set's frames by vibration, panel px^2, and its half interval.

    What repeats of a frame differ by was seen; by what their means do, the vibration alone says,
    and that of few frames differs from it by chance.
    """
    if vibration is None:
        return 0.0, 0.0
    seen = 0.0 if moved is None else float(np.mean((moved @ np.array(across)) ** 2))
    square = across[0] ** 2 + across[1] ** 2
    free = code.shifts - 1
    rest = square * vibration.value**2 * free / code.shifts / repeats
    share = 0.5 * (vibration.high**2 - vibration.low**2) / max(vibration.value, 1e-12) ** 2
    return seen + rest, rest * float(np.hypot(share, 1.96 * np.sqrt(2.0 / max(free, 1))))


def _across(
    frames: NDArray[np.float32],
    code: Fringes,
    panel: tuple[int, int],
    size: int,
    good: NDArray[np.bool_],
) -> tuple[float, float]:
    """Return how many panel pixels lie in a camera pixel, along u and v, by the fine phase."""
    phase = code.relative_phase(frames, panel)[0]
    turns = [np.angle(np.exp(1j * np.diff(phase, axis=axis))) for axis in (0, 1)]
    down, across = (
        float(np.median(one[np.delete(good, -1, axis) & np.delete(good, 0, axis)]))
        for axis, one in enumerate(turns)
    )
    scale = size / (2.0 * np.pi * float(code.fringe_count(panel)))
    return across * scale, down * scale
