"""Random numbers of light samples: few of them, placed well, in two independent halves.

A pixel's samples are spread over its area, two lenses and the hemisphere of each bounce.  What they
look up is nearly linear in all of these, and there two old tricks are strong:

* **antithetic pairs** (J. M. Hammersley and K. W. Morton, Proc. Camb. Phil. Soc. 52, 1956): with
  every sample goes its mirror image, so that what is linear cancels exactly;
* **Latin hypercubes** (M. D. McKay, R. J. Beckman, W. J. Conover, Technometrics 21(2), 1979): each
  number on its own is stratified over all pairs, so that what is a sum of functions of single
  numbers is integrated as if it had one dimension.

Either half of a pixel's samples is such a set, independent of the other: their difference is an
unbiased estimate of the Monte Carlo error.  The numbers depend on seed, pixel and sample alone, so
that it does not matter in which passes an image is traced.
"""

from __future__ import annotations

from typing import Any

from slbench.simulate.render.mitsuba import dr, mi


class Strata:
    """The random numbers of samples, lane by lane; each call gives further ones.

    Parameters
    ----------
    pixel : mi.UInt32
        Pixel that each lane belongs to.
    sample : mi.UInt32
        Number of the sample within it.
    pairs : int
        Antithetic pairs in either half of a pixel's samples; a power of two.
    seed : int
        Of 32 bits.
    """

    def __init__(self, pixel: Any, sample: Any, pairs: int, seed: int) -> None:
        self.pairs = pairs
        per_half = dr.opaque(mi.UInt32, 2 * pairs)
        half = sample // per_half
        within = sample - half * per_half
        self.pair = within >> 1
        self.mirrored = (within & 1) == 1
        self.own, self.other = mi.sample_tea_32(2 * pixel + half, dr.opaque(mi.UInt32, seed))
        self.dimension = 0

    def next_1d(self) -> Any:
        """Return a number in [0, 1) for each lane."""
        self.dimension += 1
        step = mi.UInt32((self.dimension * _ODD) & 0xFFFFFFFF)
        order = _mixed(self.own + step)
        # An odd factor and a shift, modulo a power of two: a permutation of the pairs.
        stratum = (self.pair * (order | 1) + (order >> 16)) & mi.UInt32(self.pairs - 1)
        jitter = mi.Float(_mixed(self.other + step + self.pair * mi.UInt32(_OTHER_ODD)) >> 8)
        number = (mi.Float(stratum) + jitter * 2.0**-24) / self.pairs
        number = dr.select(self.mirrored, 1.0 - number, number)
        return dr.clip(number, 0.0, _BELOW_ONE)

    def next_2d(self) -> Any:
        """Return a point in [0, 1)^2 for each lane."""
        return mi.Point2f(self.next_1d(), self.next_1d())

    def stream(self) -> Any:
        """Return a generator of plain random numbers for each lane, for loops of any length."""
        self.dimension += 1
        step = mi.UInt32((self.dimension * _ODD) & 0xFFFFFFFF)
        lane = 2 * self.pair + dr.select(self.mirrored, mi.UInt32(1), mi.UInt32(0))
        a, b = mi.sample_tea_32(self.own + step, self.other ^ lane)
        return mi.PCG32(dr.width(lane), mi.UInt64(a), mi.UInt64(b))


#: Odd numbers that set the hashed counters of dimensions and pairs apart (the golden ratio's).
_ODD, _OTHER_ODD = 0x9E3779B9, 0x85EBCA77


def _mixed(x: Any) -> Any:
    """Return a hash of 32 bits: A. Appleby's finaliser of MurmurHash3 (public domain)."""
    x = (x ^ (x >> 16)) * mi.UInt32(0x85EBCA6B)
    x = (x ^ (x >> 13)) * mi.UInt32(0xC2B2AE35)
    return x ^ (x >> 16)


#: The largest number below 1 in single precision.
_BELOW_ONE = 1.0 - 2.0**-24
