"""What the experiments of chapter 7 found beside comparisons, as immutable values."""

from __future__ import annotations

from dataclasses import dataclass

from slbench.bench.compare.comparison import Comparison
from slbench.detector.emva1288 import Detector


@dataclass(frozen=True, eq=False)
class Blurred:
    """Comparisons with the blur of the projector that reproduces one factor.

    ``blur_px`` is its standard deviation in panel pixels.
    """

    blur_px: float
    found: dict[str, Comparison]


@dataclass(frozen=True, eq=False)
class Shaken:
    """Comparisons with the vibration that reproduces one factor.

    ``vibration_px`` is that of the camera that was simulated, ``divisor`` how much coarser it is
    than the thesis's; ``moved_um`` what the vibration is on the object.
    """

    vibration_px: float
    divisor: int
    moved_um: float
    detector: Detector
    found: dict[str, Comparison]

    @property
    def full_size_px(self) -> float:
        """The vibration in pixels of the thesis's camera."""
        return self.vibration_px * self.divisor
