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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from slbench.capture.exposures import check_exposures
from slbench.capture.stack import FusedCapture
from slbench.core.errors import InputError, located
from slbench.core.random import tagged_seed
from slbench.core.registry import quoted
from slbench.core.resources import inside
from slbench.core.show.display import brief
from slbench.core.validation.values import checked
from slbench.core.validation.wording import shown
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
from slbench.simulate.reconstruct import decoded
from slbench.simulate.stack import check_frame_errors

Equal = Literal["frames", "photons"]


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
        """Total exposure of one scan, in exposures of the scene."""
        return self.exposures / self.times * sum(self.bracket or (1.0,))

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
        scene's: ``"1,10,50 | bracket=0.25/1/4"``.
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
        if sets[-1].bracket is None and len(scene.exposure.bracket) > 1:
            sets[-1] = replace(sets[-1], bracket=scene.exposure.bracket)
        with located(f"set {sets[-1].name}"):
            _check(sets[-1], scene)
    names = [one.name for one in sets]
    for k, one in enumerate(given):
        if names.count(names[k]) > 1 and isinstance(one, str | Path):
            sets[k] = replace(sets[k], name="".join(str(one).split()))
    for one in sets:
        if [other.name for other in sets].count(one.name) > 1:
            raise InputError("sets", "every set once", f"{one.name} twice")
    if equal == "frames":
        longest = max(one.exposures for one in sets)
        sets = [with_frames(one, longest) for one in sets]
    elif equal == "photons":
        least = min(one.light for one in sets)
        sets = [replace(one, exposure_share=least / one.light) for one in sets]
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


def _check(one: PatternSet, scene: Scene) -> None:
    """Refuse a set that cannot be shown or decoded, before any light is traced."""
    panel = scene.sequence.panel
    if one.sequence.panel != panel:
        expected = f"patterns for the panel's {panel[0]} x {panel[1]} px"
        raise InputError("panel", expected, "{} x {} px".format(*one.sequence.panel))
    one.of(scene)  # exposures that it cannot have
    if one.decoder is None:
        one.sequence.runs()
        if one.response is not None:
            for part in one.sequence.parts:
                dark = np.zeros((part.n_frames(panel), 1), np.float32)
                part.straightened(dark, panel, one.response, 1.0)
    elif not one.sequence.axes:
        raise InputError("patterns", "a code of one axis at least", one.sequence.name)


def with_frames(given: PatternSet, frames: int) -> PatternSet:
    """Return a set with further shifts of its finest fringe set, `frames` exposures in all.

    With two coded axes the further shifts are shared between their finest sets, the first axis
    taking the odd one.  A set without fringes keeps its frames, and its note says so.
    """
    sequence, missing = given.sequence, (frames - given.exposures) // given.times
    if missing <= 0:
        return given
    if sequence.crosstalk is not None:
        return replace(given, note=f"keeps its {given.exposures} colour pictures")
    last = {axis: placed for axis in sequence.axes if (placed := sequence.finest(axis))}
    if not last:
        return replace(given, note=f"keeps its {given.frames} frames: no fringes to shift further")
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
    return replace(given, sequence=grown, note=", ".join(added))
