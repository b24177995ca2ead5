"""How long decoding takes, and how that grows with the unwrapping steps.

Processor time of all threads, of one run on one machine, compared with one another: what else the
machine does counts little.  Sequences take turns, so that slow spells meet all of them, and the
lower quartile of all turns stands for a sequence: what disturbs a turn makes it slower.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.bench.statistics import Interval, bootstrap_interval
from slbench.cloud.triangulation import triangulate
from slbench.scene.model import Scene
from slbench.simulate.stack import capture_stack
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]


class Line(NamedTuple):
    """A straight line through times: seconds at no step, seconds a step, and R^2."""

    start_s: float
    per_step_s: float
    r_squared: float


@dataclass(frozen=True, eq=False)
class Timing:
    """Processor seconds to decode, and to decode and triangulate, sequences x turns."""

    sets: tuple[str, ...]
    steps: tuple[int, ...]
    decode_s: Array
    total_s: Array

    def line(self) -> Line:
        """Fit the decoding times by a straight line in the number of steps."""
        times = typical(self.decode_s)
        slope, start = np.polyfit(self.steps, times, 1)
        rest = times - (start + slope * np.array(self.steps))
        return Line(float(start), float(slope), 1.0 - float(rest.var() / times.var()))

    def ratio(self, a: str, b: str, seed: int, *, total: bool = True) -> Interval:
        """Return the time of `a` over that of `b`; 95 % interval: paired bootstrap of the turns."""
        times = self.total_s if total else self.decode_s
        first, second = times[self.sets.index(a)], times[self.sets.index(b)]

        def ratio(turns: NDArray[np.intp]) -> float:
            return float(typical(first[turns]) / typical(second[turns]))

        limits = bootstrap_interval(ratio, len(first), seed)
        return Interval(ratio(np.arange(len(first))), *limits)


def typical(seconds: Array) -> Array:
    """Return the lower quartile over the turns (..., turns)."""
    return np.asarray(np.percentile(seconds, 25.0, axis=-1))


def time_sets(
    scene: Scene, transport: LightTransport, sets: Sequence[str], *, turns: int, seed: int
) -> Timing:
    """Time the computation of a scan with each pattern set.

    Parameters
    ----------
    scene : Scene
    transport : LightTransport
    sets : sequence of str
    turns : int
        Every set is timed so often, after one turn that does not count.
    seed : int
    """
    captures = [
        capture_stack(scene.with_patterns(text), (transport,), seed=seed).captures[0]
        for text in sets
    ]
    times = np.empty((2, len(sets), turns))
    for turn in range(-1, turns):
        for k, shots in enumerate(captures):
            begin = time.process_time()
            phase = shots.decode()
            middle = time.process_time()
            triangulate(scene.rig, phase)
            if turn >= 0:
                times[:, k, turn] = middle - begin, time.process_time() - begin
    steps = tuple(len(shots.sequence.parts) - 1 for shots in captures)
    return Timing(tuple(sets), steps, times[0], times[1])
