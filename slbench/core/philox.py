"""Normal random numbers by a counter-based generator: any of them by its place, in no order.

Bits are Philox4x32-10's (J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw, "Parallel random
numbers: as easy as 1, 2, 3", SC 2011): a key of 64 bits chooses a stream, a counter of 128 bits
the place in it, and each count gives four words of 32 bits.  They become normal numbers by the
transform of G. E. P. Box and M. E. Muller ("A note on the generation of random normal deviates",
Ann. Math. Statist. 29(2), 1958), two words a pair.  No number needs the one before it and none
is rejected, so that the compiler makes many at once, in less than half the time of NumPy's
ziggurat.

Number ``1024 b + 256 l + j`` of a stream (j below 256, l below 4) comes of count ``256 b + j``:
word 0 is the radius and word 1 the angle of lanes 0 and 1, words 2 and 3 are those of lanes 2
and 3; even lanes are the cosine, odd ones the sine.  Logarithm, sine and cosine are polynomials
in single precision (coefficients of S. L. Moshier's Cephes library), so that the same key gives
the same bits whatever mathematical library there is.  Radii are sqrt(-2 ln((w + 1/2) 2^-31)), w
the upper 31 bits of a word: up to sqrt(64 ln 2) = 6.66, beyond which one of 4e10 normal numbers
falls.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

#: Normal numbers that :func:`normal_block` gives.
BLOCK = 1024
_LANES = 4
_ROUNDS = 10
_MASK = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)

_F = np.float32
_ONE, _HALF_F = _F(1.0), _F(0.5)
_LN2_HIGH, _LN2_LOW = _F(0.693359375), _F(-2.12194440e-4)
_SQRT_HALF = _F(0.707106781186547524)
_L0, _L1, _L2 = _F(7.0376836292e-2), _F(-1.1514610310e-1), _F(1.1676998740e-1)
_L3, _L4, _L5 = _F(-1.2420140846e-1), _F(1.4249322787e-1), _F(-1.6668057665e-1)
_L6, _L7, _L8 = _F(2.0000714765e-1), _F(-2.4999993993e-1), _F(3.3333331174e-1)
_S0, _S1, _S2 = _F(-1.9515295891e-4), _F(8.3321608736e-3), _F(-1.6666654611e-1)
_C0, _C1, _C2 = _F(2.443315711809948e-5), _F(-1.388731625493765e-3), _F(4.166664568298827e-2)
#: Radians of a word that counts a turn.
_TURN = _F(2.0 * np.pi / 2.0**32)


@njit(nogil=True, cache=True)
def philox(key: Any, first: Any, word_2: Any, word_3: Any, words: Any) -> None:
    """Fill `words` with the words of consecutive counts.

    Parameters
    ----------
    key : (2,) uint32
    first : uint64
        Words 0 (lower half) and 1 of the first count; they grow by one a count.
    word_2, word_3 : int
        Words 2 and 3 of all counts.
    words : (4, n) uint32
    """
    one, two, three, four = words[0], words[1], words[2], words[3]
    c2, c3 = np.uint64(word_2), np.uint64(word_3)
    key0, key1 = np.uint64(key[0]), np.uint64(key[1])
    for i in range(words.shape[1]):
        count = np.uint64(first) + np.uint64(i)
        x0, x1, x2, x3 = count & _MASK, count >> _HALF, c2, c3
        k0, k1 = key0, key1
        for _ in range(_ROUNDS):
            left, right = x0 * _M0, x2 * _M1
            x0 = (right >> _HALF) ^ x1 ^ k0
            x1 = right & _MASK
            x2 = (left >> _HALF) ^ x3 ^ k1
            x3 = left & _MASK
            k0, k1 = (k0 + _W0) & _MASK, (k1 + _W1) & _MASK
        one[i], two[i], three[i], four[i] = x0, x1, x2, x3


@njit(error_model="numpy", nogil=True, cache=True)
def _pairs(radius: Any, angle: Any, out: Any, other: Any, share: Any) -> None:
    """Turn words `radius` and `angle` (n,) into the normal numbers `out` and `other` (n,).

    `share` (n,) float32 is overwritten.  Loops are short, so that each is made vectors of.
    """
    n = out.size
    bits = share.view(np.int32)
    for i in range(n):  # the middle of one of 2^31 parts of (0, 1]
        share[i] = (_F(np.int32(radius[i] >> np.uint32(1))) + _HALF_F) * _F(2.0**-31)
    for i in range(n):
        # share = mantissa 2^power, the mantissa between sqrt(1/2) and sqrt(2)
        power = (bits[i] >> np.int32(23)) - np.int32(126)
        bits[i] = (bits[i] & np.int32(0x007FFFFF)) | np.int32(0x3F000000)
        out[i] = _F(power)
    for i in range(n):
        m, e = share[i], out[i]
        low = m < _SQRT_HALF
        e = e - _ONE if low else e
        x = (m + m if low else m) - _ONE
        z = x * x
        y = (
            (
                (
                    ((((((_L0 * x + _L1) * x + _L2) * x + _L3) * x + _L4) * x + _L5) * x + _L6) * x
                    + _L7
                )
                * x
                + _L8
            )
            * x
            * z
        )
        log = x + (y + e * _LN2_LOW - _HALF_F * z) + e * _LN2_HIGH
        share[i] = np.sqrt(max(_F(-2.0) * log, _F(0.0)))
    for i in range(n):
        turn = np.int32(angle[i])
        quarter = (turn + np.int32(1 << 29)) >> np.int32(30)
        x = _F(np.int32(turn - (quarter << np.int32(30)))) * _TURN
        z = x * x
        sine = ((_S0 * z + _S1) * z + _S2) * z * x + x
        cosine = ((_C0 * z + _C1) * z + _C2) * z * z - _HALF_F * z + _ONE
        odd = (quarter & np.int32(1)) != 0
        a = cosine if odd else sine
        b = sine if odd else cosine
        a = -a if (quarter & np.int32(2)) != 0 else a
        b = -b if ((quarter + np.int32(1)) & np.int32(2)) != 0 else b
        out[i] = share[i] * b
        other[i] = share[i] * a


@njit(nogil=True, cache=True)
def normal_block(key: Any, stream: int, block: int, work: Any, out: Any) -> None:
    """Write block `block` of a stream's standard normal numbers.

    Parameters
    ----------
    key : (2,) uint32
    stream : int
        Word 2 of the counter: which of the key's streams.
    block : int
        From 0; numbers from ``1024 block`` on.
    work : (5, 256) uint32
        Overwritten.
    out : (1024,) float32
    """
    size = BLOCK // _LANES
    words = work[:_LANES]
    share = work[_LANES].view(np.float32)
    philox(key, np.uint64(size) * np.uint64(block), stream, 0, words)
    _pairs(words[0], words[1], out[:size], out[size : 2 * size], share)
    _pairs(words[2], words[3], out[2 * size : 3 * size], out[3 * size : BLOCK], share)


def work_space() -> NDArray[np.uint32]:
    """Return the `work` of :func:`normal_block`."""
    return np.empty((_LANES + 1, BLOCK // _LANES), np.uint32)


def normal(key: ArrayLike, size: int, stream: int = 0) -> NDArray[np.float32]:
    """Return the first standard normal numbers of a stream, (size,).

    Parameters
    ----------
    key : (2,) of whole numbers below 2^32
    size : int
    stream : int
    """
    words, work = np.asarray(key, np.uint32), work_space()
    out = np.empty((-(-size // BLOCK), BLOCK), np.float32)
    for block, row in enumerate(out):
        normal_block(words, stream, block, work, row)
    return out.ravel()[:size]
