r"""Line spread: what a lens makes of a point, as one non-negative spread a device and depth.

Three parts, each of which may be absent:

* **defocus**, the disc of the circle of confusion, of radius ``R``;
* **diffraction** at the aperture.  With the pupil function ``exp(i 2 pi W rho^2 / lambda)`` of a
  circular pupil, defocused by ``W`` (which has a geometric disc of radius ``2 W / NA``), the
  transfer function is (H. H. Hopkins, "The frequency response of a defocused optical system",
  Proc. R. Soc. A 231, 1955)

      OTF(s) = 4/pi int_0^{1 - s/2} sqrt(1 - (x + s/2)^2) cos(4 pi (W / lambda) s x) dx

  with ``s`` the spatial frequency in units of ``NA / lambda``, up to 2.  Diffraction and defocus
  are *one* thing: their spreads do not simply convolve.  With ``lambda`` towards zero the transfer
  function becomes that of the disc, ``2 J1(x) / x`` with ``x = 2 pi nu R``;
* **blur**, a Gaussian for all that a real lens adds.

A thin lens has its numerical aperture on the panel's side from the principal distance ``c`` and the
radius ``a`` of its pupil, so the unit of diffraction, ``lambda c / a``, is one length a device,
whatever the depth; the depth decides ``R`` alone.  All lengths here are pixels of the panel.

The light transport needs the spread's *cumulative* along an axis (:meth:`Spread.lines`), rays its
radius by enclosed energy (:meth:`Spread.rings`), people its transfer function
(:meth:`Spread.contrast`) and its size (:meth:`Spread.radius`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Diffraction decays slowly, its line spread as ``1 / (pi^3 t^2)`` at ``t`` units.  It is followed
#: so far, which leaves out 0.8 % of the light; that is laid evenly over what is followed, where it
#: adds no contrast to fringes finer than that.
TAIL = 8.0
#: Standard deviations of the blur that are followed: 5e-4 of the light is left out.
_SIGMAS = 3.5
#: Spread of a device that has none, px: next to nothing beside a pixel.
_LEAST = 1e-3
#: Rows of a table, by defocus over the whole reach, and places from the middle to the end.
_ROWS, _PLACES = 48, 160
#: Rows between which nobody interpolates.
_FINE_ROWS = 384
#: Frequencies for the integrals: so many a period of the fastest oscillation.
_PER_PERIOD = 2.3
#: A disc so many times larger than everything else is a disc with a soft edge.
_LARGE = 60.0


@lru_cache(maxsize=64)
def _rule(count: int) -> tuple[Array, Array]:
    from scipy.special import roots_legendre

    nodes, weights = roots_legendre(count)
    return nodes, weights


def _gauss(count: float) -> tuple[Array, Array]:
    """Return nodes and weights of a Gauss-Legendre rule on [-1, 1] of at least so many nodes."""
    return _rule(32 * -(-int(count) // 32))


def hopkins(frequency: ArrayLike, defocus_waves: ArrayLike) -> Array:
    """Return the transfer function of a defocused circular pupil.

    Parameters
    ----------
    frequency : array_like
        Spatial frequency in units of ``NA / lambda``; the pupil passes none beyond 2.
    defocus_waves : array_like
        Defocus ``W / lambda`` at the pupil's edge, broadcast against `frequency`.

    Returns
    -------
    float, of the shape of both
        Negative where contrast is reversed.
    """
    s, w = np.broadcast_arrays(
        np.abs(np.asarray(frequency, dtype=np.float64)), np.asarray(defocus_waves, np.float64)
    )
    # With x = L sin(t)^2 both ends of the integrand are smooth in t.
    length = np.clip(1.0 - s / 2.0, 0.0, None)
    most = 4.0 * float(np.max(np.abs(w), initial=0.0)) * 0.5  # periods of the cosine at most
    nodes, weights = _gauss(24 + _PER_PERIOD * most)
    t = 0.25 * np.pi * (nodes + 1.0)
    share, slope = np.sin(t) ** 2, 0.5 * np.pi * weights * np.sin(t) * np.cos(t)
    result = np.zeros(s.shape)
    for place, weight in zip(share, slope, strict=True):
        x = length * place
        height = np.sqrt(np.clip(1.0 - (x + s / 2.0) ** 2, 0.0, None))
        result += weight * height * np.cos(4.0 * np.pi * w * s * x)
    return 4.0 / np.pi * length * result


class Table(NamedTuple):
    """A function of defocus and place, sampled: rows by defocus, columns by place.

    The row of a disc of radius ``R`` is ``round(R / (R + edge) * (rows - 1))``; its places run
    evenly from the middle to the end of the spread, ``reach = R + edge``.
    """

    values: NDArray[np.float32]
    edge: float


@dataclass(frozen=True)
class Spread:
    """Spread of one device.

    Parameters
    ----------
    diffraction_px : float
        ``lambda / NA`` at the panel, px; 0 is geometric optics.
    blur_px : float
        Standard deviation of the blur, px.
    """

    diffraction_px: float = 0.0
    blur_px: float = 0.0

    @property
    def edge(self) -> float:
        """How far the spread reaches beyond the geometric disc, px."""
        return TAIL * self.diffraction_px + _SIGMAS * self.blur_px + _LEAST

    def contrast(self, cycles_per_px: ArrayLike, circle_px: ArrayLike = 0.0) -> Array:
        """Return the contrast that a sinusoid keeps (the transfer function).

        Parameters
        ----------
        cycles_per_px : array_like
            Spatial frequency along any direction of the panel.
        circle_px : array_like
            Diameter of the circle of confusion, broadcast against the frequency.

        Returns
        -------
        float, of the shape of both
            Negative where defocus reverses the contrast.
        """
        frequency, circle = np.broadcast_arrays(
            np.abs(np.asarray(cycles_per_px, dtype=np.float64)), np.asarray(circle_px, np.float64)
        )
        if self.diffraction_px > 0:
            unit = self.diffraction_px
            passed = hopkins(frequency * unit, circle / (4.0 * unit))
        else:
            passed = _airy(np.pi * frequency * circle)
        result: Array = passed * np.exp(-2.0 * (np.pi * self.blur_px * frequency) ** 2)
        return result

    def radius(self, circle_px: ArrayLike, energy: float = 0.5) -> Array:
        """Return the radius about the middle that holds a share of the light, px.

        Parameters
        ----------
        circle_px : array_like
            Diameter of the circle of confusion.
        energy : float
            Share of the light, in (0, 1).
        """
        circle = np.asarray(circle_px, dtype=np.float64)
        disc = 0.5 * np.abs(np.nan_to_num(circle))
        shares, radii = _radii(self, energy)
        reach = disc + self.edge
        result: Array = np.interp(disc / reach, shares, radii) * reach
        return np.where(np.isfinite(circle), result, np.nan)

    def circle(self, circle_px: float) -> float:
        """Return the circle of confusion that is as acceptable here as one without other spread.

        In focus there is some spread already.  Defocus is taken to be acceptable while it adds to
        it no more than an acceptable disc would, in quadrature of the radii that hold half the
        light.  Diffraction forgives some defocus: its spread hardly grows at first.

        Parameters
        ----------
        circle_px : float
            Acceptable circle of confusion of geometric optics.
        """
        return _circle(self, circle_px)

    def lines(self) -> Table:
        """Return the share of the light between the middle and a place along an axis.

        Half the spread: it is symmetric.  From 0 in the middle to 1/2 at the end.
        """
        return _lines(self)

    def rings(self) -> Table:
        """Return radii by enclosed energy ``e``: columns are even in ``sqrt(e)``.

        Values are ``radius / reach * (1 - e + RING_SOFTENING)``, which is bounded: diffraction's
        radius grows as ``1 / (1 - e)``.
        """
        return _rings(self)


#: Keeps radii by enclosed energy finite at the very end.
RING_SOFTENING = 0.003


def _airy(x: Array) -> Array:
    """Return ``2 J1(x) / x``."""
    from scipy.special import j1

    safe = np.where(np.abs(x) < 1e-6, 1.0, x)
    result: Array = np.where(np.abs(x) < 1e-6, 1.0, 2.0 * j1(safe) / safe)
    return result


def _discs(edge: float, rows: int) -> Array:
    """Return the discs' radii that a table has rows for; the last, infinite one is left out."""
    share = np.arange(rows) / (rows - 1)
    result: Array = edge * share[:-1] / (1.0 - share[:-1])
    return result


def _frequencies(spread: Spread, reach: float) -> tuple[Array, Array]:
    """Return nodes and weights of the integral over frequency, cycles a pixel."""
    last = np.inf
    if spread.diffraction_px > 0:
        last = 2.0 / spread.diffraction_px
    if spread.blur_px > 0:
        last = min(last, 1.2 / spread.blur_px)
    nodes, weights = _gauss(32 + _PER_PERIOD * last * reach)
    return 0.5 * last * (nodes + 1.0), 0.5 * last * weights


def _soft(spread: Spread, disc: float) -> float | None:
    """Return the deviation of the soft edge of a disc that is large beside it, or None."""
    scale = max(spread.diffraction_px, spread.blur_px)
    if disc < _LARGE * scale:
        return None
    return float(np.hypot(spread.blur_px, 0.35 * spread.diffraction_px))


def _disc_line(x: Array, radius: float) -> Array:
    """Return the light of a disc between its middle and `x`."""
    q = np.clip(x / radius, -1.0, 1.0)
    result: Array = (q * np.sqrt(1.0 - q * q) + np.arcsin(q)) / np.pi
    return result


@lru_cache(maxsize=16)
def _lines(spread: Spread) -> Table:
    edge, share = spread.edge, np.arange(_PLACES) / (_PLACES - 1)
    coarse = np.empty((_ROWS, _PLACES))
    coarse[-1] = _disc_line(share, 1.0)
    normal, weights = np.polynomial.hermite_e.hermegauss(5)
    for row, disc in enumerate(_discs(edge, _ROWS)):
        reach = disc + edge
        x = share * reach
        soft = _soft(spread, disc)
        if spread.diffraction_px == 0 and spread.blur_px == 0:
            light = _disc_line(x, disc) if disc > 0 else np.minimum(0.5 * x / edge, 0.5)
        elif soft is not None:
            light = weights @ [_disc_line(x + soft * z, disc) for z in normal] / weights.sum()
        else:
            nu, step = _frequencies(spread, reach)
            passed = spread.contrast(nu, 2.0 * disc) * step / (np.pi * nu)
            light = np.sin(2.0 * np.pi * np.outer(x, nu)) @ passed
        light = np.maximum.accumulate(np.clip(light, 0.0, 0.5))
        # What lies beyond the reach, evenly.
        coarse[row] = light + (0.5 - light[-1]) * share
    return Table(_finer(coarse, _FINE_ROWS), edge)


@lru_cache(maxsize=16)
def _rings(spread: Spread) -> Table:
    edge = spread.edge
    energy = (np.arange(_PLACES) / (_PLACES - 1)) ** 2
    coarse = np.empty((_ROWS, _PLACES))
    coarse[-1] = np.sqrt(energy) * (1.0 - energy + RING_SOFTENING)
    for row, disc in enumerate(_discs(edge, _ROWS)):
        soft = _soft(spread, disc)
        if spread.diffraction_px == 0 and spread.blur_px == 0:
            radius = np.sqrt(energy) * disc
        elif soft is not None:
            # A large disc: the soft edge moves radii near the rim by less than its width.
            radius = np.sqrt(energy) * np.hypot(disc, 2.0**0.5 * soft)
        else:
            r = np.linspace(0.0, disc + edge, 2 * _PLACES)
            enclosed = _enclosed(spread, disc, r)
            # What lies beyond the reach, evenly, as in lines.
            enclosed += (1.0 - enclosed[-1]) * (r / r[-1]) ** 2
            radius = _inverse(enclosed, r, energy)
        coarse[row] = radius / (disc + edge) * (1.0 - energy + RING_SOFTENING)
    return Table(_finer(coarse, _FINE_ROWS), edge)


@lru_cache(maxsize=64)
def _radii(spread: Spread, energy: float) -> tuple[Array, Array]:
    """Return shares of defocus in the reach, and radii of an enclosed energy over the reach."""
    edge = spread.edge
    scaled = [_radius(spread, disc, energy) / (disc + edge) for disc in _discs(edge, _ROWS)]
    return np.arange(_ROWS) / (_ROWS - 1), np.array([*scaled, np.sqrt(energy)])


def _radius(spread: Spread, disc: float, energy: float) -> float:
    """Return the radius of an enclosed energy for a disc's radius."""
    none = spread.diffraction_px == 0 and spread.blur_px == 0
    if none or _soft(spread, disc) is not None:
        return float(np.sqrt(energy)) * disc
    places = np.linspace(0.0, disc + spread.edge, _PLACES)
    return float(np.sqrt(np.interp(energy, _enclosed(spread, disc, places), places**2)))


@lru_cache(maxsize=64)
def _circle(spread: Spread, circle_px: float) -> float:
    rest = _radius(spread, 0.0, 0.5)
    if rest <= _LEAST:
        return circle_px
    wanted = float(np.hypot(circle_px / np.sqrt(8.0), rest))
    low, high = 0.0, 4.0 * (circle_px + spread.edge)
    for _ in range(30):
        middle = 0.5 * (low + high)
        grown = _radius(spread, 0.5 * middle, 0.5) >= wanted
        low, high = (low, middle) if grown else (middle, high)
    return low


def _enclosed(spread: Spread, disc: float, radius: Array) -> Array:
    """Return the light within radii: ``2 pi r int OTF(nu) J1(2 pi nu r) d nu``."""
    from scipy.special import j1

    nu, step = _frequencies(spread, radius[-1])
    waves = j1(2.0 * np.pi * np.outer(radius, nu)) @ (spread.contrast(nu, 2.0 * disc) * step)
    result: Array = np.maximum.accumulate(np.clip(2.0 * np.pi * radius * waves, 0.0, 1.0))
    return result


def _inverse(enclosed: Array, radius: Array, energy: Array) -> Array:
    """Return the radii of given energies; linear in the square of the radius."""
    rising = np.concatenate(([True], np.diff(enclosed) > 1e-12))
    squares = np.interp(energy, enclosed[rising], radius[rising] ** 2)
    result: Array = np.sqrt(squares)
    return result


def _finer(coarse: Array, rows: int) -> NDArray[np.float32]:
    """Return a table with more rows, by linear interpolation."""
    at = np.linspace(0.0, len(coarse) - 1.0, rows)
    low = np.minimum(at.astype(int), len(coarse) - 2)
    share = (at - low)[:, None]
    fine: NDArray[np.float32] = ((1.0 - share) * coarse[low] + share * coarse[low + 1]).astype(
        np.float32
    )
    return fine
