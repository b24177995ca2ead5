"""Codes as sums of waves: band-limited profiles that fill the panel's range.

Frame k shows ``a_k + b_k sum_n (p_nk cos 2 pi n x / W + q_nk sin 2 pi n x / W)`` with counts n of
0.5, 1, 1.5, ... up to a highest one; a_k and b_k stretch it to the range [0, 1] exactly.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slbench.core.extras import extra

#: How the first waves fall with their counts.
_FALL = 0.5
#: Places a panel pixel at which extremes are looked for.
_FINE = 2


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
        random = np.random.default_rng(seed)
        first = random.normal(size=(2, len(self.counts), frames))
        first /= self.counts.numpy()[:, np.newaxis] ** _FALL
        self.weights = torch.tensor(first, dtype=torch.float32, requires_grad=True)
        self._grid = self.series(torch.arange(size * _FINE) / _FINE - 0.5 + 0.5 / _FINE)

    def series(self, places: Any) -> tuple[Any, Any]:
        """Return cosines and sines at places (n,), px: (n, counts) each."""
        torch = extra("torch", "torch")
        turns = 2.0 * np.pi * torch.outer((places + 0.5) / self.size, self.counts)
        return torch.cos(turns), torch.sin(turns)

    def range(self) -> tuple[Any, Any]:
        """Return the least value and the extent of each frame before it is stretched, (K,)."""
        raw = self._grid[0] @ self.weights[0] + self._grid[1] @ self.weights[1]
        low = raw.amin(dim=0)
        return low, raw.amax(dim=0) - low

    def at(self, series: tuple[Any, Any], ends: tuple[Any, Any]) -> Any:
        """Return values in [0, 1] at places whose series are known, (n, K)."""
        raw = series[0] @ self.weights[0] + series[1] @ self.weights[1]
        return ((raw - ends[0]) / ends[1]).clamp(0.0, 1.0)

    def slope(self, series: tuple[Any, Any], ends: tuple[Any, Any]) -> Any:
        """Return slopes at places whose series are known, a pixel, (n, K)."""
        per_px = (2.0 * np.pi / self.size) * self.counts[:, None]
        cosine, sine = self.weights
        raw = series[0] @ (per_px * sine) - series[1] @ (per_px * cosine)
        return raw / ends[1]
