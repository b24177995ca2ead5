"""Codes whose profiles are parameters: sums of waves, and columns that are on or off.

*Waves.*  Frame k shows ``a_k + b_k sum_n (p_nk cos 2 pi n x / W + q_nk sin 2 pi n x / W)`` with
counts n of 0.5, 1, 1.5, ... up to a highest one; a_k and b_k stretch it to [0, 1] exactly.

*Bits.*  A column is on where its parameter is positive.  The gradient is that of a logistic curve
in the step's place: straight through (Y. Bengio, N. Leonard, A. Courville, arXiv:1308.3432, 2013).
What the decoder knows of a place is the columns as the lens softens them, between columns by
cubics.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from slbench.core.extras import extra

#: How the first waves fall with their counts.
_FALL = 0.5
#: Places a panel pixel at which extremes are looked for.
_FINE = 2
#: First size of a column's parameter, of the logistic curve's own.
_FIRST = 0.3
#: Reach of the softening, in its standard deviations.
_REACH = 4.0


class Profiles(Protocol):
    """What a code shows, at its parameters of the moment."""

    @property
    def shown(self) -> Any:
        """Values of the panel's columns, (W, K)."""

    def at(self, places: Any) -> Any:
        """Return the values that the decoder takes places (n,), px, for: (n, K)."""

    def slope(self, places: Any) -> Any:
        """Return their slopes a pixel, (n, K)."""


class Waves:
    """A code of K frames whose waves are parameters.

    Parameters
    ----------
    frames : int
    count : float
        Highest number of cycles across the panel.
    size : int
        Panel pixels.
    seed : int
        Of the waves that the descent begins with.
    """

    def __init__(self, frames: int, count: float, size: int, seed: int) -> None:
        torch = extra("torch", "torch")
        self.size = size
        self.counts = torch.arange(0.5, count + 0.25, 0.5, dtype=torch.float32)
        self.weights = torch.tensor(first_waves(frames, count, seed), requires_grad=True)
        self.columns = self.series(torch.arange(float(size)))
        self.fine = self.series(torch.arange(size * _FINE) / _FINE - 0.5 + 0.5 / _FINE)

    def series(self, places: Any) -> tuple[Any, Any]:
        """Return cosines and sines at places (n,), px: (n, counts) each."""
        torch = extra("torch", "torch")
        turns = 2.0 * np.pi * torch.outer((places + 0.5) / self.size, self.counts)
        return torch.cos(turns), torch.sin(turns)

    def profiles(self) -> Profiles:
        """Return what the code shows."""
        return _OfWaves(self)


class _OfWaves:
    def __init__(self, code: Waves) -> None:
        self.code = code
        raw = self._raw(code.fine)
        self.low = raw.amin(dim=0)
        self.extent = raw.amax(dim=0) - self.low

    @property
    def shown(self) -> Any:
        return self._stretched(self.code.columns)

    def at(self, places: Any) -> Any:
        return self._stretched(self.code.series(places))

    def slope(self, places: Any) -> Any:
        cosines, sines = self.code.series(places)
        per_px = (2.0 * np.pi / self.code.size) * self.code.counts[:, None]
        cosine, sine = self.code.weights
        return (cosines @ (per_px * sine) - sines @ (per_px * cosine)) / self.extent

    def _raw(self, series: tuple[Any, Any]) -> Any:
        return series[0] @ self.code.weights[0] + series[1] @ self.code.weights[1]

    def _stretched(self, series: tuple[Any, Any]) -> Any:
        return ((self._raw(series) - self.low) / self.extent).clamp(0.0, 1.0)


class Bits:
    """A code of K frames whose columns are on or off.

    Parameters
    ----------
    frames : int
    count : float
        Highest number of cycles of the waves that the descent begins with.
    size : int
        Panel pixels.
    seed : int
        Of these waves.
    blur_px : float
        Standard deviation of what lens and panel soften, px; greater than zero.
    """

    def __init__(self, frames: int, count: float, size: int, seed: int, blur_px: float) -> None:
        torch = extra("torch", "torch")
        self.size, self.blur_px = size, blur_px
        cosine, sine = first_waves(frames, count, seed)
        turns = 2.0 * np.pi * np.outer((np.arange(size) + 0.5) / size, _counts(count))
        raw = np.cos(turns) @ cosine + np.sin(turns) @ sine
        raw *= _FIRST / raw.std(axis=0)
        self.weights = torch.tensor(raw.astype(np.float32), requires_grad=True)
        reach = int(np.ceil(_REACH * blur_px))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / blur_px) ** 2)
        self.kernel = torch.tensor((kernel / kernel.sum()).astype(np.float32))

    def profiles(self) -> Profiles:
        """Return what the code shows."""
        return _OfBits(self)


class _OfBits:
    def __init__(self, code: Bits) -> None:
        torch = extra("torch", "torch")
        self.size = code.size
        smooth = torch.sigmoid(code.weights)
        self.shown = smooth + ((code.weights > 0.0).float() - smooth).detach()
        reach = len(code.kernel) // 2
        columns = self.shown.T[:, None]
        padded = torch.nn.functional.pad(columns, (reach, reach), mode="replicate")
        self.known = torch.nn.functional.conv1d(padded, code.kernel[None, None])[:, 0].T

    def at(self, places: Any) -> Any:
        (a, b, c, d), t = self._cubic(places)
        return a + t * (b + t * (c + t * d))

    def slope(self, places: Any) -> Any:
        (_, b, c, d), t = self._cubic(places)
        return b + t * (2.0 * c + t * 3.0 * d)

    def _cubic(self, places: Any) -> tuple[tuple[Any, Any, Any, Any], Any]:
        """Return powers of the cubics at places, and how far into them these are.

        E. Catmull, R. Rom, "A class of local interpolating splines", 1974.
        """
        left = places.floor().long().clamp(0, self.size - 2)
        before, here, next_, after = (
            self.known[(left + k).clamp(0, self.size - 1)] for k in (-1, 0, 1, 2)
        )
        one, two = 0.5 * (next_ - before), 0.5 * (after - here)
        step = next_ - here
        cubic = here, one, 3.0 * step - 2.0 * one - two, one + two - 2.0 * step
        return cubic, (places - left)[:, None]


def first_waves(frames: int, count: float, seed: int) -> Any:
    """Return cosines' and sines' amplitudes that a descent begins with, (2, counts, K) float32."""
    counts = _counts(count)
    first = np.random.default_rng(seed).normal(size=(2, len(counts), frames))
    return (first / counts[:, np.newaxis] ** _FALL).astype(np.float32)


def _counts(count: float) -> Any:
    return np.arange(0.5, count + 0.25, 0.5)
