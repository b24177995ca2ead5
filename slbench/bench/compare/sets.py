"""Pattern sets to compare: read, checked, and given equal frames or equal light.

*Equal frames.*  Every set with fringes gets as many frames as the longest set has; frames that are
channels of one picture count once, and every picture as often as it is exposed.  Extra frames
become further phase shifts of the last fringe set, which alone decides the noise of a coordinate
whose fringe order is right: it falls with the root of that set's shifts, and with nothing else
(:mod:`slbench.patterns.phase`).  The sets before it only have to find the order.

*Equal photons.*  Every set has the total exposure of the shortest one: a set with k times its
frames exposes each for 1/k of the time.  The light falls, read noise and rounding stay.
"""

from __future__ import annotations

import hashlib
import math
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from slbench.capture.capture import Capture
from slbench.capture.exposures import check_exposures
from slbench.capture.fusion import FusionWeights
from slbench.capture.stack import FusedCapture, WeightSource
from slbench.core.errors import InputError, located
from slbench.core.random import tagged_seed
from slbench.core.registry import quoted
from slbench.core.resources import inside
from slbench.core.show.display import brief
from slbench.core.validation.values import checked
from slbench.core.validation.wording import shown
from slbench.design.adaptive.adapt import MAX_FRAMES, MOST_FRAMES, adapt
from slbench.design.adaptive.shots import check_adaptable
from slbench.patterns import (
    Axis,
    Decoder,
    GrayCode,
    PatternSequence,
    PatternSource,
    PhaseMap,
    Response,
    decoded_by,
    read_decoder,
    read_patterns,
)
from slbench.patterns.given import object_name
from slbench.rig.motion import COMPENSATIONS, Compensation
from slbench.scene.model import Scene
from slbench.simulate.moving import MovingLight
from slbench.simulate.reconstruct import decoded
from slbench.simulate.stack import capture_stack, check_frame_errors
from slbench.simulate.transport import LightTransport

Equal = Literal["frames", "photons"]
#: Text of an adaptive set, with its frames at most.
_ADAPTIVE = re.compile(r"adaptive(?:\s*@\s*(\d{1,6}))?")


class Measured(NamedTuple):
    """What one scan of a scene with a set found.

    ``shots`` are the frames, None where they are not those of one sequence; ``weights`` those by
    which a focus stack was fused; ``taken_s`` the seconds until all frames were taken.
    """

    shots: Capture | None
    phase: PhaseMap
    weights: FusionWeights | None
    taken_s: float


@dataclass(frozen=True)
class PatternSet:
    """A pattern sequence as it takes part in a comparison.

    Parameters
    ----------
    name : str
        Short text without spaces, or the name of a file, a folder or an object; different in every
        set of a comparison.
    sequence : PatternSequence
        As it is projected, further shifts included.
    exposure_share : float
        Exposure of a frame over that of the scene.
    bracket : tuple of float, optional
        Exposures of every picture, as factors (:class:`slbench.scene.model.Exposure`); None for the
        scene's own.
    note : str
        What a reader must know of it.
    decoder : callable, optional
        Of the user's own, ``decoder(frames, sequence) -> PhaseMap``, instead of the codes'.
    response : Response, optional
        Of the projector, which the codes' decoders take out.
    motion : {"none", "known", "estimated"}, optional
        Whether motion is taken out of its frames; None for what the scene says.
    """

    name: str
    sequence: PatternSequence
    exposure_share: float = 1.0
    note: str = ""
    decoder: Decoder | None = None
    response: Response | None = None
    bracket: tuple[float, ...] | None = None
    motion: Compensation | None = None

    __repr__ = brief

    @property
    def times(self) -> int:
        """How often every picture is taken."""
        return len(self.bracket or (1.0,))

    @property
    def frames(self) -> int:
        """Frames of one scan, those of all exposures."""
        return self.sequence.n_frames * self.times

    @property
    def exposures(self) -> int:
        """Pictures of one scan, the channels of one counted once."""
        return -(-self.frames // self.sequence.channels)

    @property
    def light(self) -> float:
        """Total exposure of one scan, in exposures of the scene; infinite where it is not known."""
        return self.exposures / self.times * sum(self.bracket or (1.0,))

    def with_light(self, light: float) -> PatternSet:
        """Return the set at another total exposure."""
        return replace(self, exposure_share=light / self.light)

    def measured(
        self,
        scene: Scene,
        transports: Sequence[LightTransport],
        *,
        seed: int,
        weights: WeightSource = "lit",
        moving: MovingLight | None = None,
    ) -> Measured:
        """Return what one scan of a scene that has the set (:meth:`of`) finds."""
        start = time.perf_counter()
        fused = capture_stack(scene, transports, seed=seed, moving=moving).fuse(weights)
        taken = time.perf_counter() - start
        return Measured(fused.capture, self.decode(fused, scene), fused.weights, taken)

    def check(self, scene: Scene) -> None:
        """Refuse a set that cannot be shown or decoded, before any light is traced."""
        panel = scene.sequence.panel
        if self.sequence.panel != panel:
            expected = f"patterns for the panel's {panel[0]} x {panel[1]} px"
            raise InputError("panel", expected, "{} x {} px".format(*self.sequence.panel))
        self.of(scene)  # exposures that it cannot have
        if self.decoder is None:
            self.sequence.runs()
            if self.response is not None:
                for part in self.sequence.parts:
                    dark = np.zeros((part.n_frames(panel), 1), np.float32)
                    part.straightened(dark, panel, self.response, 1.0)
        elif not self.sequence.axes:
            raise InputError("patterns", "a code of one axis at least", self.sequence.name)

    def of(self, scene: Scene) -> Scene:
        """Return the scene with these patterns and this exposure."""
        light = scene.exposure
        if self.bracket is not None:
            light = replace(light, bracket=self.bracket)
        if light.time_s is not None:
            light = replace(light, time_s=light.time_s * self.exposure_share)
        else:
            light = replace(light, white_level=light.white_level * self.exposure_share)
        motion = scene.compensate if self.motion is None else self.motion
        return replace(scene, sequence=self.sequence, exposure=light, compensate=motion)

    def decode(self, fused: FusedCapture, scene: Scene) -> PhaseMap:
        """Return what the set's decoder makes of its frames of a scene with its patterns."""
        if self.decoder is None:
            own = replace(fused, capture=replace(fused.capture, response=self.response))
            return decoded(scene, own)
        shots = fused.capture.apart()
        return decoded_by(self.decoder, shots.frames, shots.sequence, f"set {self.name}: decoder")

    def seed(self, seed: int, repeat: int) -> int:
        """Return the seed of one repeat, which no other set of another name shares."""
        digest = hashlib.sha256(self.name.encode()).digest()
        words = [int.from_bytes(digest[k : k + 4], "little") for k in range(0, 16, 4)]
        return tagged_seed(seed, *words, repeat)

    def with_frames(self, frames: int) -> PatternSet:
        """Return a set with further shifts of its finest fringe set, `frames` exposures in all.

        With two coded axes the further shifts are shared between their finest sets, the first axis
        taking the odd one.  A set without fringes keeps its frames, and its note says so.
        """
        sequence, missing = self.sequence, (frames - self.exposures) // self.times
        if missing <= 0:
            return self
        if sequence.crosstalk is not None:
            return replace(self, note=f"keeps its {self.exposures} colour pictures")
        last = {axis: placed for axis in sequence.axes if (placed := sequence.finest(axis))}
        if not last:
            return replace(
                self, note=f"keeps its {self.frames} frames: no fringes to shift further"
            )
        parts, added = list(sequence.parts), []
        for k, (axis, placed) in enumerate(last.items()):
            extra = math.ceil((missing - k) / len(last))
            longer = placed.code.extended(extra)
            if extra and longer is not None:
                parts[placed.index] = longer
                along = f" along {axis}" if len(last) > 1 else ""
                count, shifts = longer.fringe_count(sequence.panel), longer.n_frames(sequence.panel)
                added.append(f"{count:g} fringes{along} with {shifts} shifts")
        grown = replace(sequence, parts=tuple(parts))
        return replace(self, sequence=grown, note=", ".join(added))

    def tolerance_px(self, axis: Axis) -> float:
        """Return how far off a coordinate is when its order is wrong, px.

        Half a period of the finest fringe set; 0 where a Gray code stands alone, which has no
        order but the cell; for other codes two pixels, which blur does not take for one another.
        """
        counts = self.sequence.fringe_counts(axis)
        if counts:
            return 0.5 * self.sequence.size(axis) / max(counts)
        own = [part for part in self.sequence.parts if axis in part.axes]
        return 0.0 if all(isinstance(part, GrayCode) for part in own) else 2.0


@dataclass(frozen=True)
class AdaptiveSet(PatternSet):
    """Fringes that are chosen while a scene is measured (:mod:`slbench.design.adaptive`).

    ``sequence`` stands for them where patterns are asked for that are known before: what light
    alone gives is that of its finest set.

    Parameters
    ----------
    most : int
        Frames of one scan, at most.
    most_light : float or None
        Total exposure of one scan, at most, in exposures of the scene.
    """

    most: int = MAX_FRAMES
    most_light: float | None = None

    @property
    def frames(self) -> int:
        """Frames of one scan, at most."""
        return self.most

    @property
    def light(self) -> float:
        """Infinite where it is not limited: exposures are chosen too."""
        return math.inf if self.most_light is None else self.most_light

    def of(self, scene: Scene) -> Scene:
        """Return the scene with the patterns that stand for the set's."""
        found = replace(scene, sequence=self.sequence)
        check_adaptable(found)
        return found

    def with_frames(self, frames: int) -> AdaptiveSet:
        """Return the set with another budget of frames, which it uses by threes.

        Raises
        ------
        InputError
            For more than an adaptive scan may have.
        """
        if frames > MOST_FRAMES:
            expected = f"sets of at most {MOST_FRAMES} frames beside it (--equal frames)"
            raise InputError(f"set {self.name}", expected, frames)
        return replace(self, most=frames, note=f"chosen by what is seen, {frames} frames at most")

    def with_light(self, light: float) -> AdaptiveSet:
        """Return the set with a budget of exposure; itself where no other set has one."""
        return self if math.isinf(light) else replace(self, most_light=light)

    def measured(
        self,
        scene: Scene,
        transports: Sequence[LightTransport],
        *,
        seed: int,
        weights: WeightSource = "lit",
        moving: MovingLight | None = None,
    ) -> Measured:
        """Return what one adaptive scan finds."""
        start = time.perf_counter()
        light = transports[0]
        found = adapt(scene, light, max_frames=self.most, max_light=self.most_light, seed=seed)
        return Measured(None, found.phase, None, time.perf_counter() - start)

    def tolerance_px(self, axis: Axis) -> float:
        """Return two pixels: the finest set is another one in each scan and pixel."""
        return 2.0


@checked
def pattern_sets(
    given: Sequence[PatternSource | PatternSet],
    scene: Scene,
    *,
    shifts: int = 3,
    equal: Equal | None = None,
    folder: Path | None = None,
    allow_modules: bool = False,
) -> tuple[PatternSet, ...]:
    """Read pattern sets for a scene's panel and make them equal in frames or light.

    Parameters
    ----------
    given : sequence of str, PatternSet and whatever else is a pattern set
        As :func:`slbench.patterns.read_patterns` reads them; what is a set already stays.  Text may
        end in how it is decoded: by the user's own function, ``"1,10,50 | mine.py:decode"``, or
        with the projector's response taken out, ``"1,10,50 | gamma=2.2"`` and
        ``"1,10,50 | response=curve.csv"``, or with motion taken out, ``"1,16@4 | motion=known"``;
        or in the exposures of every picture, as factors of the
        scene's: ``"1,10,50 | bracket=0.25/1/4"``.  ``"adaptive"`` and
        ``"adaptive@24"`` are fringes chosen by what is seen, with so many frames at most.
    scene : Scene
        Its panel, and the axes that its own patterns code.
    shifts : int
        Phase shifts where a text gives none.
    equal : {"frames", "photons"} or None
    folder : path, optional
        Of the file that names the sets.
    allow_modules : bool
        Run the Python modules that the sets name: code of their authors.

    Returns
    -------
    tuple of PatternSet
        In the order given.  Sets that would have the same name are called by their whole text.

    Raises
    ------
    InputError
        For no sets, a set given twice, one that cannot be read, shown or decoded, another `equal`,
        or frame errors of the scene that a set cannot have.
    """
    if isinstance(given, str) or not given:
        raise InputError("sets", "one or more pattern sets", repr(given))
    sets: list[PatternSet] = []
    for one in given:
        if isinstance(one, PatternSet):
            sets.append(one)
        else:
            sets.append(_read(one, scene, shifts, folder, allow_modules))
        if sets[-1].bracket is None and scene.exposure.bracket != (1.0,):
            sets[-1] = replace(sets[-1], bracket=scene.exposure.bracket)
        with located(f"set {sets[-1].name}"):
            sets[-1].check(scene)
    names = [one.name for one in sets]
    for k, one in enumerate(given):
        if names.count(names[k]) > 1 and isinstance(one, str | Path):
            sets[k] = replace(sets[k], name="".join(str(one).split()))
    for one in sets:
        if [other.name for other in sets].count(one.name) > 1:
            raise InputError("sets", "every set once", f"{one.name} twice")
    if equal == "frames":
        longest = max(one.exposures for one in sets)
        sets = [one.with_frames(longest) for one in sets]
    elif equal == "photons":
        least = min(one.light for one in sets)
        sets = [one.with_light(least) for one in sets]
    for one in sets:
        with located(f"set {one.name}"):
            check_frame_errors(one.of(scene))
    return tuple(sets)


def _read(
    given: PatternSource, scene: Scene, shifts: int, folder: Path | None, allow_modules: bool
) -> PatternSet:
    """Read a set, and how it is decoded behind a bar."""
    text, bar, behind = given.rpartition("|") if isinstance(given, str) else ("", "", "")
    decoder, response, bracket, motion, suffix = None, None, None, None, ""
    if bar:
        where, behind = f"set {given}", behind.strip()
        key, sign, value = (one.strip() for one in behind.partition("="))
        if sign and key == "bracket":
            bracket, suffix = _bracket(value, where), f"|bracket={''.join(value.split())}"
        elif sign and key == "motion":
            motion, suffix = _motion(value, where), f"|motion={value}"
        elif sign:
            response, suffix = _response(key, value, folder, where), f"|{key}={Path(value).name}"
        else:
            decoder = read_decoder(behind, folder, allow_modules, f"{where}: decoder")
            suffix = f"|{object_name(behind)}"
        given = text
    adaptive = _ADAPTIVE.fullmatch(given.strip()) if isinstance(given, str) else None
    if adaptive:
        if bar:
            raise InputError(
                f"set {given}", "adaptive fringes alone: they have their own decoder", behind
            )
        most = int(adaptive[1] or MAX_FRAMES)
        if not 6 <= most <= 1000:
            raise InputError("set adaptive", "6 to 1000 frames, such as adaptive@30", most)
        shown = PatternSequence.parse("1,8,64", scene.sequence.panel)
        note = f"chosen by what is seen, {most} frames at most"
        return AdaptiveSet("".join(str(given).split()), shown, note=note, most=most)
    read = read_patterns(
        *(given, scene.sequence.panel),
        shifts=shifts,
        axes="".join(scene.sequence.axes) or "u",
        folder=folder,
        allow_modules=allow_modules,
    )
    return PatternSet(
        read.name + suffix,
        read.sequence,
        decoder=decoder,
        response=response,
        bracket=bracket,
        motion=motion,
    )


def _motion(value: str, where: str) -> Compensation:
    """Return how motion is taken out by what a set states."""
    for one in COMPENSATIONS:
        if value == one:
            return one
    raise InputError(f"{where}: motion", " or ".join(COMPENSATIONS), quoted(value, COMPENSATIONS))


def _bracket(text: str, where: str) -> tuple[float, ...]:
    """Return the exposures of a set, factors with a slash between."""
    try:
        factors = tuple(float(part) for part in text.split("/"))
    except ValueError:
        factors = ()
    if not factors or not all(1e-9 <= one <= 1e9 for one in factors):
        raise InputError(f"{where}: bracket", "factors > 0 such as 0.25/1/4", shown(text))
    check_exposures(factors, f"{where}: bracket")
    return factors


def _response(key: str, value: str, folder: Path | None, where: str) -> Response:
    """Return the response that a set states by ``gamma`` or by a file of its curve."""
    if key == "response":
        with located(where):
            return Response.read(Path(value) if folder is None else inside(folder, value))
    if key != "gamma":
        expected = (
            "gamma=2.2, response=curve.csv, bracket=0.25/1/4, motion=known or mine.py:decode "
            "behind the bar"
        )
        raise InputError(where, expected, quoted(key, ("bracket", "gamma", "motion", "response")))
    try:
        return Response(float(value))
    except ValueError:
        raise InputError(f"{where}: gamma", "a number > 0", value) from None
