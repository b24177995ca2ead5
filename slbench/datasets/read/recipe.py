"""What to project on a data set's samples: patterns, detector and noise.

One recipe serves exports and training.  Each sample and epoch has noise of its own, which
follows from (seed, epoch, sample) and nothing else: not from the order in which samples are
drawn, nor from how many processes draw them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.random import derived_seed, generator
from slbench.core.validation.types import Seed
from slbench.core.validation.values import Value
from slbench.datasets.read.stored import Sample
from slbench.detector.base import DetectorModel
from slbench.patterns import PatternSequence

Patterns = str | PatternSequence
#: Patterns for a sample, drawn with the generator.
Chooser = Callable[[Sample, np.random.Generator], Patterns]


@dataclass(frozen=True)
class Recipe(Value):
    """Patterns, detector and noise.

    Parameters
    ----------
    patterns : str, PatternSequence, callable or None
        Text such as ``"1,10,50@4"``, or what else :meth:`Sample.capture` takes as text; a function
        that chooses for a sample, with a generator to draw from; None for the first stored capture
        as it is.
    detector : DetectorModel, optional
        Instead of each scene's own.
    noise : bool
    seed : int
    """

    patterns: Patterns | Chooser | None
    detector: DetectorModel | None = None
    noise: bool = True
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.patterns is None and self.detector is not None:
            raise InputError("detector", "patterns to expose with it", "stored frames")

    def seed_of(self, sample: Sample, epoch: int = 0) -> int:
        """Return the seed of a sample's noise in an epoch."""
        return derived_seed(self.seed, epoch, sample.number)

    def shots(self, sample: Sample, epoch: int = 0) -> Capture:
        """Return the frames of a sample.

        Raises
        ------
        InputError
            If the sample cannot be read, its light does not carry the patterns, or no frames
            are stored and no patterns given.
        """
        if self.patterns is None:
            return sample.stored()
        seed = self.seed_of(sample, epoch)
        patterns = self.patterns
        if callable(patterns):
            patterns = patterns(sample, generator(seed, 3))
        return sample.capture(patterns, self.detector, seed, self.noise)

    def lit(self, sample: Sample) -> Capture:
        """Return the fully lit picture of a sample, without frame errors.

        Its noise is its own, of another epoch than that of the frames.

        Raises
        ------
        InputError
            If the sample cannot be read.
        """
        exposure = sample.scene.exposure.without_frame_errors()
        seed = self.seed_of(sample, epoch=1)
        return sample.capture("white", self.detector, seed, self.noise, exposure=exposure)
