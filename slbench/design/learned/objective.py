r"""What a code is worth on light that was seen: how finely, and how surely, pixels are placed.

The decoder is that by matching (:mod:`slbench.patterns.matching`), which knows the code c(x) as it
was shown.  A pixel at the true place x has frames I of mean m, through lens and panel, and
deviations s_k; gain, offset and place are estimated by least squares with weights 1 / s_k^2.

*Matching.*  Linearised at x, with the orthonormal vectors that gain and offset span taken away
(left: ``_|``), ``g`` the fitted gain and ``r`` what it leaves of m,

    variance = 1 / (g^2 |c'_||^2),   bias = g (r, c'_|) / (g^2 |c'_||^2) .

The lens has blurred what the decoder takes for sharp: that is the bias.

*Bound.*  The Cramer-Rao bound has the slope m' that the camera sees instead, and no bias.

*Surely.*  With noise drawn, the likelihood of each place y is ``exp(e(y) / 2 s^2)``, e(y) the
energy of the frames along c(y).  The decoder keeps a pixel whose energy at the best place is
greater than at any other peak by :data:`~slbench.patterns.matching.match.AMBIGUOUS` variances; that
much is taken from the true place's, and the share of the likelihood that lies further than some
pixels from x is then the probability that the pixel is lost.  What is made least is the mean of
``log(variance + bias^2) / 2`` plus that share times a price.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.core.extras import extra
from slbench.design.learned.waves import Bits, Waves
from slbench.patterns.matching.match import AMBIGUOUS
from slbench.simulate.torch_exposure import TorchExposure

#: Pixels from which on a place is wrong, as in comparisons.
WRONG_PX = 2.0
#: One per cent of lost pixels costs as much as a deviation larger by a quarter.
PRICE = 25.0
#: Panel pixels between rivals that are looked at; where they begin is drawn.
_STEP = 2
#: The slope a pixel, to fourth order, by what is seen of the pattern moved by so many pixels.
_STENCIL = {1: 8 / 12, -1: -8 / 12, 2: -1 / 12, -2: 1 / 12}


class Lit(NamedTuple):
    """Light to learn on.

    Parameters
    ----------
    exposure : TorchExposure
        Of P pixels, along one panel axis.
    places : (P,) float
        True panel coordinates, px.
    """

    exposure: TorchExposure
    places: NDArray[np.float64]


class Worth(NamedTuple):
    """What a code is worth for pixels: deviation, px, and probability of being lost, (P,)."""

    deviation: Any
    lost: Any


def worth(code: Waves | Bits, lit: Lit, seen: Any, bound: bool, generator: Any) -> Worth:
    """Return what a code is worth for some pixels of light.

    Parameters
    ----------
    code : Waves or Bits
    lit : Lit
    seen : (n,) tensor
        Which of its pixels.
    bound : bool
        By the Cramer-Rao bound instead of the matching decoder's deviation.
    generator : torch.Generator
        Of the noise.
    """
    torch = extra("torch", "torch")
    profiles, exposure = code.profiles(), lit.exposure
    own, shown = exposure.detector, profiles.shown
    charge = exposure.electrons(shown.T)[:, seen].T
    mean = charge / own.e_per_dn
    variance = (charge + own.read_noise_e**2) / own.e_per_dn**2 + 1.0 / 12.0
    root = variance.sqrt()
    places = torch.as_tensor(lit.places, dtype=torch.float32)[seen]
    known = profiles.at(places)
    weighed, vector = mean / root, known / root
    one, two = _orthonormal(1.0 / root, vector)
    if bound:
        moved = (_moved(shown, by) for by in _STENCIL)
        charges = zip(_STENCIL.values(), moved, strict=True)
        slope = sum(share * exposure.electrons(one.T)[:, seen].T for share, one in charges)
        slope = slope / own.e_per_dn / root
        left = _taken(slope, *_orthonormal(1.0 / root, weighed))
        square = 1.0 / left.square().sum(dim=1).clamp(min=1e-12)
    else:
        gain = (weighed * two).sum(dim=1) / (vector * two).sum(dim=1).clamp(min=1e-6)
        left = _taken(profiles.slope(places) / root, one, two) * gain[:, None]
        information = left.square().sum(dim=1).clamp(min=1e-12)
        rest = _taken(weighed, one, two)
        square = 1.0 / information + ((rest * left).sum(dim=1) / information).square()

    noisy = mean + root * torch.randn(mean.shape, generator=generator)
    freedom = max(mean.shape[1] - 3, 1)
    # What the true place leaves of the frames is doubt too, where it is more than the noise.
    doubt = _taken(noisy / root, one, two).square().sum(dim=1, keepdim=True) / freedom
    spread = 2.0 * doubt.clamp(min=1.0) * variance.mean(dim=1, keepdim=True)
    noisy = noisy - noisy.mean(dim=1, keepdim=True)
    true = (noisy * _unit(known)).sum(dim=1, keepdim=True)
    every = _STEP * torch.arange(code.size // _STEP) + float(torch.rand((), generator=generator))
    others = noisy @ _unit(profiles.at(every)).T
    near = (every - places[:, None]).abs() <= WRONG_PX
    asked = torch.zeros(1 + len(every))
    asked[0] = 0.5 * AMBIGUOUS
    energy = torch.cat((true, others.masked_fill(near, 0.0)), dim=1).clamp(min=0.0).square()
    share = torch.softmax(energy / spread - asked, dim=1)
    return Worth(square.sqrt(), (share[:, 1:] * ~near).sum(dim=1))


def loss(found: Worth) -> Any:
    """Return what is made least: the mean logarithm of the deviations, and the pixels lost."""
    return found.deviation.log().mean() + PRICE * found.lost.mean()


def _moved(shown: Any, by: int) -> Any:
    """Return what columns (W, K) show so many pixels on; the last goes on at the end."""
    torch = extra("torch", "torch")
    return shown[(torch.arange(len(shown)) + by).clamp(0, len(shown) - 1)]


def _orthonormal(one: Any, two: Any) -> tuple[Any, Any]:
    one = one / one.norm(dim=1, keepdim=True)
    two = two - (two * one).sum(dim=1, keepdim=True) * one
    return one, two / two.norm(dim=1, keepdim=True).clamp(min=1e-9)


def _taken(values: Any, one: Any, two: Any) -> Any:
    """Return values less their parts along two orthonormal vectors."""
    values = values - (values * one).sum(dim=1, keepdim=True) * one
    return values - (values * two).sum(dim=1, keepdim=True) * two


def _unit(values: Any) -> Any:
    """Return vectors (n, K) less their means, of length one."""
    values = values - values.mean(dim=1, keepdim=True)
    return values / values.norm(dim=1, keepdim=True).clamp(min=1e-6)
