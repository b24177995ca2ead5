"""Surroundings that light a scene beside the projector: environment maps.

A map holds radiance by direction, as a picture in the latitude-longitude projection: the first row
is straight up, the middle of the picture lies ahead, and its right half is to the right.  It is far
away: every point of the scene sees the same.  In a scene "up" is the z of the measurement's place
and "ahead" its x, before the map is turned.

Three maps are drawn.  ``overcast`` is the standard overcast sky (P. Moon and D. E. Spencer,
"Illumination from a non-uniform sky", Illum. Eng. 37, 1942), three times as bright overhead as at
the horizon, above a ground that reflects a fifth of its light.  ``workshop`` is a room with two
rows of tubular lamps at the ceiling, ``window`` a room with one window.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.colour import luminance
from slbench.core.errors import InputError
from slbench.core.io.images import read_exr
from slbench.core.registry import quoted
from slbench.core.validation.types import Finite
from slbench.core.validation.values import Value

Array = NDArray[np.float64]
_Row = tuple[Finite, Finite, Finite]

#: Size of a drawn map, and points a pixel and way that it is the mean of.
_HEIGHT, _WIDTH, _POINTS = 256, 512, 3
#: Share of the light that the ground below a sky reflects.
_GROUND = 0.2
#: Radiance of a room's ceiling, walls and floor over that of its lamps or its window.
_CEILING, _WALLS, _FLOOR = 0.02, 0.012, 0.006
#: Height of the ceiling above the table, mm.
CEILING_MM = 1500.0
#: Lamps at the ceiling: middle and half sides along x and y, mm.
LAMPS_MM = tuple((x, y, 600.0, 75.0) for y in (-900.0, 900.0) for x in (-1500.0, 0.0, 1500.0))
#: A window ahead: distance, half width, lower and upper edge above the table, mm.
WINDOW_MM = (2000.0, 700.0, 200.0, 1500.0)


class Radiance:
    """Radiance by direction, read-only, equal where it is the same.

    Parameters
    ----------
    values : (H, W) array_like of float
        W / (mm^2 sr); the first row is straight up.

    Raises
    ------
    InputError
        For values that are negative or not finite, a map of less than 4 x 2 pixels, or no light.
    """

    def __init__(self, values: ArrayLike) -> None:
        self.values: NDArray[np.float32] = np.array(values, dtype=np.float32)
        if self.values.ndim != 2 or self.values.shape[0] < 2 or self.values.shape[1] < 4:
            expected = "radiance of shape (H, W), 2 x 4 or more"
            raise InputError("environment", expected, self.values.shape)
        if not np.all(np.isfinite(self.values) & (self.values >= 0.0)):
            raise InputError("environment", "finite radiance >= 0", "others")
        if not self.values.any():
            raise InputError("environment", "light from somewhere", "a black map")
        self.values.setflags(write=False)
        shape = repr(self.values.shape).encode()
        self.sha256 = hashlib.sha256(shape + self.values.tobytes()).hexdigest()

    def __repr__(self) -> str:
        height, width = self.values.shape
        return f"<Radiance, {width} x {height}, SHA-256 {self.sha256[:16]}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Radiance) and self.sha256 == other.sha256

    def __hash__(self) -> int:
        return hash(self.sha256)


@dataclass(frozen=True)
class Environment(Value):
    """An environment map in the world.

    Parameters
    ----------
    radiance : Radiance
    axes : 3 x (float, float, float)
        Rotation matrix whose columns are ahead, left and up of the map in the world.
    """

    radiance: Radiance
    axes: tuple[_Row, _Row, _Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        axes = np.array(self.axes)
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-9) or np.linalg.det(axes) < 0.0:
            raise InputError("environment: axes", "a rotation matrix", self.axes)

    @property
    def irradiance_w_per_mm2(self) -> float:
        """Irradiance on a plane that faces up and sees all of the upper half."""
        return upward_irradiance(self.radiance.values)


def upward_irradiance(radiance: ArrayLike) -> float:
    """Return the irradiance on a plane that faces up, of a map's unit times steradian.

    Parameters
    ----------
    radiance : (H, W) array_like
    """
    values = np.asarray(radiance, dtype=np.float64)
    edges = np.clip(np.pi * np.arange(len(values) + 1) / len(values), 0.0, 0.5 * np.pi)
    # The integral of cos sin over a row: half the step of sin^2.
    weight = 0.5 * np.diff(np.sin(edges) ** 2)
    return float(2.0 * np.pi * weight @ values.mean(axis=1))


def environment_of(
    source: str | Path,
    *,
    irradiance_w_per_mm2: float | None = None,
    scale: float = 1.0,
    rotation_deg: float = 0.0,
    place: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
) -> Environment:
    """Return a drawn map or one of a file.

    Parameters
    ----------
    source : str or Path
        Name of a drawn map, or a path of an EXR whose numbers are radiance, W / (m^2 sr), of which
        colours count by their luminance.
    irradiance_w_per_mm2 : float, optional
        What the map is scaled to: the irradiance of an unobstructed plane that faces up.  A drawn
        map needs it.
    scale : float
        Factor on a file's radiance where no irradiance is given.
    rotation_deg : float
        About the map's vertical, counter-clockwise as seen from above.
    place : (3, 3) array_like
        Columns are ahead, left and up of a map that is not turned, in the world.

    Raises
    ------
    InputError
        For an unknown name, a file that is no picture of radiance, or one that is dark above the
        horizon where an irradiance is asked for.
    """
    if isinstance(source, Path):
        values = 1e-6 * scale * _read(source)
    elif irradiance_w_per_mm2 is None:
        raise InputError("environment", "irradiance_w_per_m2 beside the name of a map", source)
    else:
        values = drawn(source)
    if irradiance_w_per_mm2 is not None:
        own = upward_irradiance(values)
        if not own > 0.0:
            raise InputError(source, "light above the horizon, to be scaled", "none")
        values = values * (irradiance_w_per_mm2 / own)
    turn = np.deg2rad(rotation_deg)
    c, s = float(np.cos(turn)), float(np.sin(turn))
    axes = np.asarray(place, dtype=np.float64) @ [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    x, y, z = ((float(a), float(b), float(c)) for a, b, c in axes)
    return Environment(Radiance(values), (x, y, z))


def drawn(name: str) -> Array:
    """Return a drawn map, (256, 512), of relative radiance.

    Raises
    ------
    InputError
        For an unknown name.
    """
    if name not in DRAWN:
        known = list(DRAWN)
        raise InputError("environment map", f"one of {', '.join(known)}", quoted(name, known))
    total = np.zeros((_HEIGHT, _WIDTH))
    parts = (np.arange(_POINTS) + 0.5) / _POINTS
    for dv in parts:  # a lamp's edge is within a pixel
        for du in parts:
            total += DRAWN[name](*_directions((_HEIGHT, _WIDTH), du, dv))
    return total / _POINTS**2


def _directions(shape: tuple[int, int], du: float, dv: float) -> tuple[Array, Array, Array]:
    """Return ahead, left and up of the directions of a map's pixels, each (H, W)."""
    polar = np.pi * (np.arange(shape[0])[:, np.newaxis] + dv) / shape[0]
    around = 2.0 * np.pi * (np.arange(shape[1]) + du) / shape[1] - np.pi  # to the right
    x, y = np.sin(polar) * np.cos(around), -np.sin(polar) * np.sin(around)
    return x, y, np.broadcast_to(np.cos(polar), x.shape)


def _overcast(x: Array, y: Array, z: Array) -> Array:
    # The sky's irradiance is 7/9 pi of the zenith's radiance; the ground is Lambertian.
    return np.where(z > 0.0, (1.0 + 2.0 * z) / 3.0, _GROUND * 7.0 / 9.0)


def _room(z: Array) -> Array:
    """Return the radiance of a room's surfaces: ceiling, walls and floor by their elevation."""
    return np.where(z > 0.5, _CEILING, np.where(z > -0.2, _WALLS, _FLOOR))


def _workshop(x: Array, y: Array, z: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = CEILING_MM * x / z, CEILING_MM * y / z
    lit = np.zeros(z.shape, bool)
    for middle_x, middle_y, half_x, half_y in LAMPS_MM:
        lit |= (np.abs(u - middle_x) <= half_x) & (np.abs(v - middle_y) <= half_y)
    return np.where(lit & (z > 0.0), 1.0, _room(z))


def _window(x: Array, y: Array, z: Array) -> Array:
    distance, half, low, high = WINDOW_MM
    with np.errstate(divide="ignore", invalid="ignore"):
        across, up = distance * y / x, distance * z / x
    lit = (x > 0.0) & (np.abs(across) <= half) & (low <= up) & (up <= high)
    return np.where(lit, 1.0, _room(z))


#: Drawn maps by name: relative radiance of directions ahead, left and up.
DRAWN: dict[str, Callable[[Array, Array, Array], Array]] = {
    "overcast": _overcast,
    "workshop": _workshop,
    "window": _window,
}


def _read(path: Path) -> Array:
    """Return the luminance of a file of radiance, (H, W)."""
    channels = read_exr(path)
    if {"R", "G", "B"} <= set(channels):
        values = luminance(np.stack([channels[c] for c in "RGB"], axis=-1))
    elif "Y" in channels:
        values = np.asarray(channels["Y"], dtype=np.float64)
    else:
        raise InputError(path, "channels R, G and B, or Y", ", ".join(sorted(channels)))
    height, width = values.shape
    if width != 2 * height:
        expected = "a latitude-longitude map, twice as wide as high"
        raise InputError(path, expected, f"{width} x {height} px")
    return values
