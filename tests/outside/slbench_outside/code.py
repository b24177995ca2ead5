from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from slbench.patterns.base import Axis, Code, Found, extent


@dataclass(frozen=True)
class Ramp(Code):
    """Black, white and a ramp of grey: the coordinate is the ramp's share of white."""

    kind: ClassVar[str] = "ramp"
    words: ClassVar[tuple[str, ...]] = ("ramp",)

    axis: Axis = "u"

    @property
    def axes(self):
        return (self.axis,)

    def n_frames(self, panel):
        return 3

    def profile(self, k, size):
        return (np.zeros(size), np.ones(size), (np.arange(size) + 0.5) / size)[k]

    @classmethod
    def read_word(cls, word, axis, shifts):
        return [cls(axis)] if word == "ramp" else None

    @property
    def word(self):
        return "ramp"

    @classmethod
    def decode_run(cls, run, observed, found):
        (placed,) = run.parts
        size = extent(observed.panel, placed.code.axis)
        frames = observed.pixels[placed.frames.start : placed.frames.stop].astype(np.float64)
        black, white, ramp = frames
        span = white - black
        with np.errstate(divide="ignore", invalid="ignore"):
            coordinate = size * (ramp - black) / span - 0.5
            sigma = size * np.sqrt(observed.noise.variance(ramp)) / span
        mask = span > 2.0 * observed.min_modulation
        result = Found(
            coordinate=coordinate,
            sigma=sigma,
            modulation=0.5 * span,
            mean=0.5 * (black + white),
            mask=mask,
        )
        return {placed.code.axis: result}
