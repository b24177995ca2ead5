"""How bright a picture is from its middle to its corners.

The camera's own shading is what it makes of a surface that is equally bright everywhere: the
opening of an integrating sphere, or a diffuser before the lens.  What a projector lights is no such
surface: its picture shows the product of the projector's light, the surface and the camera.  Both
are polynomials of degree four (:mod:`slbench.rig.optics.shading`), fitted by least squares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.frames import Shot, flats, unsaturated
from slbench.calibration.characterise.quantity import (
    BLOCKS,
    Quantity,
    Untold,
    blocks,
    jackknife,
)
from slbench.capture.capture import Capture
from slbench.rig.optics.shading import COUNTS, monomials, shading

Array = NDArray[np.float64]

#: Degree of the polynomial.
_DEGREE = 4
#: Share of the picture's blocks that must be lit: a polynomial does not reach far beyond them.
_SEEN = 0.9
#: Least light of a pixel, of the largest.
_LIT = 0.1

_UNIT = "of the middle"


def camera_shading(
    even: Mapping[str, Capture], black: float | None, top: float
) -> tuple[list[Quantity], list[Untold]]:
    """Measure the camera's shading by pictures of a surface that is equally bright everywhere.

    Parameters
    ----------
    even : mapping of str to Capture
        Whose frames, but for black ones, are all such pictures.
    black : float or None
        Black level, DN.
    top : float
        Saturation, DN.
    """
    name = "camera shading"
    if not even:
        capture = "a sphere's opening or a diffuser before the lens, and --even FOLDER"
        return [], [Untold(name, "no picture of an even surface", capture)]
    frames = [
        frame
        for capture in even.values()
        for frame, shown in zip(capture.frames, capture.sequence.frames(), strict=True)
        if shown.part.flat_level(shown.index) != 0.0
    ]
    return _measured(
        name,
        frames,
        black,
        top,
        method=f"{len(frames)} pictures of an even surface",
        note="the fall-off by the field angle is in it, so that natural_vignetting is none",
        key=("camera", "shading"),
    )


def white_shading(
    found: Sequence[Shot], camera: Quantity | None, black: float | None, top: float
) -> tuple[list[Quantity], list[Untold]]:
    """Measure how the projector's white lights the picture of a plane.

    Parameters
    ----------
    found : sequence of Shot
    camera : Quantity or None
        The camera's own shading, which is taken out.
    black, top : see :func:`camera_shading`
    """
    name = "white's shading"
    white = next((one for ramp in flats(found).values() if (one := ramp.get(1.0))), None)
    if white is None:
        return [], [Untold(name, "there is no white frame", "a white frame of a plane")]
    own: Array | float = 1.0
    parts = "projector, aim, surface and camera"
    if camera is not None:
        rows, columns = white.frames[0].shape
        v, u = np.mgrid[:rows, :columns]
        size = (columns, rows)
        own = shading(camera.written["shading"], np.stack([u, v], axis=-1), size)
        parts = "projector, aim and surface; the camera's is taken out"
    method = f"the white frame, {len(white.frames)} repeats"
    return _measured(name, white.frames, black, top, method=method, note=parts, divisor=own)


def _measured(
    name: str,
    frames: Sequence[NDArray[np.generic]],
    black: float | None,
    top: float,
    *,
    method: str,
    note: str,
    key: tuple[str, ...] = (),
    divisor: Array | float = 1.0,
) -> tuple[list[Quantity], list[Untold]]:
    """Return the brightness of the corners, over that of the middle, and the polynomial."""
    if black is None:
        return [], [Untold(name, "the black level is not known", "a black frame, or --black-dn")]
    mean = np.mean([frame.astype(np.float32) for frame in frames], axis=0) - np.float32(black)
    good = unsaturated(frames, top)
    good &= mean > _LIT * np.nanquantile(mean, 0.99)
    rows, columns = mean.shape
    number = blocks(mean.shape)
    seen = np.bincount(number.ravel(), good.ravel(), BLOCKS**2) > 0.5 * np.bincount(number.ravel())
    if seen.mean() < _SEEN:
        why = f"only {100 * seen.mean():.0f} % of the picture are lit and not saturated"
        return [], [Untold(name, why, "a surface that fills the picture, with less light")]
    v, u = np.nonzero(good)
    size = (columns, rows)
    terms = monomials(np.stack([u, v], axis=-1), size, _DEGREE)
    terms = np.concatenate([np.ones((len(terms), 1)), terms], axis=1)
    light = (mean / divisor)[good].astype(np.float64)
    own, count = number[good], terms.shape[1]
    sums = np.zeros((BLOCKS**2, count, count + 1))
    for block in range(BLOCKS**2):
        some = own == block
        sums[block, :, :count] = terms[some].T @ terms[some]
        sums[block, :, count] = terms[some].T @ light[some]
    corners = np.array([[-0.5, -0.5], [1.5, -0.5], [-0.5, 1.5], [1.5, 1.5]])

    def estimate(total: Array) -> Array:
        found = np.linalg.lstsq(total[:, :count], total[:, count], rcond=None)[0]
        coefficients = found[1:] / found[0]
        return np.append(shading(coefficients, corners, (2, 2)).mean(), coefficients)

    result = jackknife(sums, estimate)
    value, half = float(result.value[0]), float(result.half_width[0])
    coefficients = tuple(result.value[1:].tolist())
    assert len(coefficients) in COUNTS
    return [
        Quantity(
            name=name,
            value=value,
            low=value - half,
            high=value + half,
            unit=_UNIT,
            method=method,
            key=key,
            note=f"mean of the corners; {note}",
            written={"shading": coefficients, "natural_vignetting": False},
        )
    ], []
