"""What several cameras see of a lit surface, each place of it once.

Completeness of several cameras needs places that count once, however many see them.  A place is a
pixel's: those of the first camera whose centre ray meets a lit point, then those of the second
whose point the first does not see, and so on.  Lit is what any projector lights.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import block, share

#: Pixel of a place that a camera does not see.
UNSEEN = -1


@dataclass(frozen=True, eq=False)
class LitSurface:
    """Places of the lit surface that the cameras of a rig see.

    Parameters
    ----------
    pixels : mapping of str to (P,) int64
        By camera: the pixel, ``v * U + u``, whose centre is nearest to where the camera sees each
        place; :data:`UNSEEN` where it does not.
    """

    pixels: Mapping[str, NDArray[np.int64]]

    def __len__(self) -> int:
        return len(next(iter(self.pixels.values())))

    def __repr__(self) -> str:
        shares = (f"{name} {share(float(np.mean(self.seen_by([name]))))}" for name in self.pixels)
        return block(f"LitSurface of {len(self)} places, seen by {', '.join(shares)}")

    def seen_by(self, cameras: Iterable[str]) -> NDArray[np.bool_]:
        """Return which places any of some cameras sees, (P,)."""
        return np.logical_or.reduce([self.pixels[name] != UNSEEN for name in cameras])

    def measured(self, masks: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """Return which places are measured, (P,).

        Parameters
        ----------
        masks : mapping of str to (V, U) bool
            Pixels that have a point, by camera; one that is not named has none.
        """
        found = np.zeros(len(self), np.bool_)
        for name, mask in masks.items():
            own = self.pixels[name]
            found |= (own != UNSEEN) & mask.reshape(-1)[own]
        return found
