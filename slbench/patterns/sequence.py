"""Pattern sequences: what the projector's panel shows, and what is decoded from it, in order.

A :class:`PatternSequence` is a list of codes (:mod:`slbench.patterns.base`) on a panel of known
size.  Where a frame varies along one panel axis only, the light transport is multiplied with its
*profile*, one value a column or row; whole images are made where a code shows them, and to be
looked at.  The short text of a sequence, such as ``"1,10,50@4"``, follows the thesis's notation
{1, 10, 50} for fringe counts in order of unwrapping; each family of codes has words of its own.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.show.display import block
from slbench.core.show.document import Table
from slbench.core.show.drawing import figure
from slbench.core.validation.types import MinLen, NotNegative, OrderResidual, Pixels
from slbench.core.validation.values import Value, checked, validated
from slbench.patterns.base import (
    Axis,
    Code,
    Placed,
    Run,
    Unwrap,
    Variation,
    extent,
    flat_frames,
)
from slbench.patterns.crosstalk import UNMIXED, check_crosstalk
from slbench.patterns.flat import Flat
from slbench.patterns.registry import pattern_codes

#: Largest residual of a fringe order that is believed, turns, unless said otherwise.
MAX_ORDER_RESIDUAL = 0.3
#: Words of the short text that force a way to tell fringes apart; "gray" is a code.
_WAYS = tuple(way for way in get_args(Unwrap) if way not in ("auto", "gray"))

#: Last word of the short text of a set in colour.
PACKED = "rgb"
#: Sets that have a name.  By "characterisation" a camera and a projector are characterised: a ramp
#: of grey, for noise and response; one fringe and few, several times, for vibration; and many, for
#: blur.
NAMED = {"characterisation": "ramp9+" * 4 + "1,8@8+8@8+8@8+8@8+64@8"}

#: Spaces that part nothing: about the signs of the short text and a decoder's bar, before a unit.
_BESIDE_SIGNS = re.compile(r"\s*([,+@/|])\s*|\s+(?=px)")


@dataclass(frozen=True)
class Frame:
    """Where one frame of a sequence comes from."""

    part_index: int
    """Index into ``PatternSequence.parts``."""
    part: Code
    """The part itself."""
    index: int
    """Index of the frame within its part."""
    along: Variation | None
    """What the frame varies along: a panel axis, or "uv"; None for a flat frame."""


@dataclass(frozen=True)
class PatternSequence(Value):
    """The frames that are projected in one scan, in order.

    Parameters
    ----------
    panel : (int, int)
        Panel width W and height H in pixels.
    parts : tuple of Code
        What is shown, in order of time.
    unwrap : str
        What tells fringes apart (:mod:`slbench.patterns.fringes.ways`): "auto" chooses from what
        is there; "sequential", "gray", "heterodyne", "number-theoretic", "spatial" and "none"
        force it.
    max_order_residual : float
        Largest residual of a fringe order that is believed, turns: the order before it is rounded
        less the whole number that it is rounded to.  A half believes all.
    crosstalk : tuple of K tuples of K float, optional
        Every K frames in a row are the channels of one colour picture, and row i says which share
        of each camera channel i sees (:mod:`slbench.patterns.crosstalk`).
    assumed : tuple of K tuples of K float, optional
        A `crosstalk` equal to this is not stated but assumed: a scene takes its own instead.
        None: whatever `crosstalk` is, it is stated.

    Raises
    ------
    InputError
        For a panel or parts that cannot be shown: no parts, more fringes than the panel
        has pixels for (three each), a Gray code twice on an axis or on a single column; channels
        that fill no pictures, cannot be told apart or vary along different axes.
    """

    panel: tuple[Pixels, Pixels]
    parts: Annotated[tuple[Code, ...], MinLen(1)]
    unwrap: Unwrap = "auto"
    max_order_residual: OrderResidual = MAX_ORDER_RESIDUAL
    crosstalk: tuple[tuple[NotNegative, ...], ...] | None = None
    assumed: tuple[tuple[NotNegative, ...], ...] | None = field(default=UNMIXED, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for i, part in enumerate(self.parts):
            with _located(f"patterns: parts[{i}]"):
                part.check(self.panel, self.parts[:i])
        if self.crosstalk is not None:
            check_crosstalk(self.crosstalk, self.n_frames)
            carriers = self._carriers()
            for first in range(0, self.n_frames, self.channels):
                own = carriers[first : first + self.channels]
                if len(set(own)) > 1:
                    expected = "channels of a picture that vary along one axis"
                    got = f"frames {first} to {first + self.channels - 1} along {' and '.join(own)}"
                    raise InputError("patterns: crosstalk", expected, got)

    def __repr__(self) -> str:
        (width, height), axes = self.panel, " and ".join(self.axes) or "no axis"
        return block(
            f"PatternSequence {{{self.name}}}: {self.n_frames} frames along {axes} "
            f"on a panel of {width} x {height} px"
        )

    def _repr_html_(self) -> str:
        counts = Counter(frame.part_index for frame in self.frames())
        rows = tuple((repr(part), counts[k]) for k, part in enumerate(self.parts))
        return Table(self.name, ("part", "frames"), rows)._repr_html_()

    def plot(self) -> Any:
        """Return a matplotlib figure: what the panel shows, frame by frame."""
        return figure(self)

    @checked
    def size(self, axis: Axis) -> int:
        """Return the number of panel pixels along `axis`: W for "u", H for "v"."""
        return extent(self.panel, axis)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The coded panel axes, in order of their first appearance."""
        return tuple(dict.fromkeys(axis for part in self.parts for axis in part.axes))

    @property
    def n_frames(self) -> int:
        """Number of frames in one scan."""
        return sum(part.n_frames(self.panel) for part in self.parts)

    @property
    def name(self) -> str:
        """Short text such as ``"gray+1,10,50@4"``, which :meth:`parse` reads back.

        The coded axes are not part of it, nor are `max_order_residual` and `crosstalk`; and what
        the short text has no word for (a Gray code without inverses, two axes coded
        differently, the direction of fringes) is shown but not parsed.
        """
        alone = {axis: [p for p in self.parts if p.axes == (axis,)] for axis in self.axes}
        texts = {_text(own) for own in alone.values()}
        # What does not code one axis alone is shown once, with the first of them.
        others = self.axes[1:] if len(texts) <= 1 else ()
        text = _text([p for p in self.parts if p.axes not in [(axis,) for axis in others]])
        return f"{text}+{self.unwrap}" if self.unwrap in _WAYS else text

    # What the parts are.

    def placed(self) -> list[Placed]:
        """Return the parts with their places, in order."""
        placed, start = [], 0
        for i, part in enumerate(self.parts):
            stop = start + part.n_frames(self.panel)
            placed.append(Placed(i, part, range(start, stop)))
            start = stop
        return placed

    def runs(self) -> list[Run]:
        """Return the parts that code an axis as runs, in the order of decoding.

        Raises
        ------
        InputError
            For a sequence that cannot be resolved: no frames are needed to find out.
        """
        if not self.axes:
            raise InputError("decode: sequence", "fringes or a Gray code", self.name)
        groups: list[list[Placed]] = []
        latest: dict[Axis, list[Placed]] = {}  # the group that codes each axis so far
        refining: dict[tuple[type[Code], tuple[Axis, ...]], list[Placed]] = {}
        for placed in self.placed():
            code = placed.code
            if not code.axes:
                continue
            if code.refines:
                refining.setdefault((type(code), code.axes), []).append(placed)
                continue
            group = latest.get(code.axes[0], [])
            adjacent = all(latest.get(axis) is group for axis in code.axes)
            head = group[0].code if group else None
            if adjacent and head and type(head) is type(code) and head.axes == code.axes:
                group.append(placed)
            else:
                groups.append([placed])
                latest.update(dict.fromkeys(code.axes, groups[-1]))
        # The finest gives the coordinate, whatever was shown last.
        refined = sorted(
            refining.values(), key=lambda g: max(p.code.periods(self.panel) for p in g)
        )
        runs = [Run(tuple(group), self.panel, self.unwrap) for group in (*groups, *refined)]
        for i, run in enumerate(runs):
            run.family.check_run(run, [r for r in runs[:i] if set(r.axes) & set(run.axes)])
        return runs

    def fringe_sets(self, axis: Axis | None = None) -> list[Placed]:
        """Return the sets of shifted fringes, along one axis or all, in order of projection."""
        return [
            placed
            for placed in self.placed()
            if placed.code.fringe_count(self.panel) is not None
            and (axis is None or axis in placed.code.axes)
        ]

    @checked
    def fringe_counts(self, axis: Axis) -> tuple[float, ...]:
        """Return the fringe counts along `axis`, in order of projection; whole ones are ints."""
        counts = (placed.code.fringe_count(self.panel) for placed in self.fringe_sets(axis))
        return tuple(count for count in counts if count is not None)

    def finest(self, axis: Axis | None = None) -> Placed | None:
        """Return the set of most fringes, the last of equals; None if there are no fringes."""
        sets = self.fringe_sets(axis)
        if not sets:
            return None
        return max(sets, key=lambda p: (p.code.fringe_count(self.panel) or 0, p.index))

    @property
    def middle_picture(self) -> float:
        """The picture, from 0, at whose time points are measured where something moves.

        The middle of those that decide the coordinates: the finest fringes of each axis, or all
        that code an axis where one has no fringes.
        """
        placed = self.placed()
        finest = [self.finest(axis) for axis in self.axes]
        decide = [one for one in finest if one is not None]
        if len(decide) < len(finest) or not decide:
            decide = [one for one in placed if one.code.axes] or list(placed)
        pictures = [np.array(one.frames) // self.channels for one in decide]
        return float(np.mean([0.5 * (own[0] + own[-1]) for own in pictures]))

    @property
    def spatial(self) -> bool:
        """Whether pixels are decoded by their neighbours in the picture."""
        return self.unwrap == "spatial" or any(part.spatial for part in self.parts)

    @property
    def channels(self) -> int:
        """Number of frames that one picture of the camera holds: 1, or those of `crosstalk`."""
        return 1 if self.crosstalk is None else len(self.crosstalk)

    @property
    def lit_frame(self) -> int | None:
        """Index of the first fully lit frame (white), None if there is none."""
        return next(iter(flat_frames(self.placed(), 1.0)), None)

    # What the frames show.

    def frames(self) -> list[Frame]:
        """Return one :class:`Frame` for each projected frame, in order."""
        return [
            Frame(placed.index, placed.code, k, placed.code.varies(k))
            for placed in self.placed()
            for k in range(len(placed.frames))
        ]

    @property
    def variations(self) -> tuple[Variation, ...]:
        """What frames vary along, in order of first appearance: the light transport they need.

        Flat frames vary along nothing and share the first one's transport, or that of "u".
        """
        found = (frame.along for frame in self.frames())
        return tuple(dict.fromkeys(along for along in found if along is not None)) or ("u",)

    def frames_along(self, along: Variation) -> NDArray[np.intp]:
        """Return the indices of the frames that vary so, increasing.

        Flat ones come with the others of their picture, or with the first.
        """
        own = [k for k, carrier in enumerate(self._carriers()) if carrier == along]
        return np.array(own, dtype=np.intp)

    def _carriers(self) -> list[Variation]:
        """Return by which light transport each frame is exposed."""
        along = [frame.along for frame in self.frames()]
        carriers: list[Variation] = []
        for first in range(0, len(along), self.channels):
            own = along[first : first + self.channels]
            usual = next((one for one in own if one is not None), self.variations[0])
            carriers += [one or usual for one in own]
        return carriers

    def shown(self, indices: NDArray[np.intp], along: Variation) -> NDArray[np.float64]:
        """Return what frames of :meth:`frames_along` show, in [0, 1].

        Returns
        -------
        (n, W), (n, H) or (n, H, W) float64
            For `along` "u", "v" and "uv".
        """
        frames = self.frames()
        chosen = [frames[k] for k in indices]
        if along == "uv":
            values = [frame.part.image(frame.index, self.panel) for frame in chosen]
            shape: tuple[int, ...] = (self.panel[1], self.panel[0])
        else:
            size = self.size(along)
            values = [frame.part.profile(frame.index, size) for frame in chosen]
            shape = (size,)
        return np.array(values, dtype=np.float64).reshape(len(chosen), *shape)

    def profiles(self, axis: Axis) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Return the frames along `axis` and their profiles, for one product with its transport.

        Returns
        -------
        indices : ndarray of shape (n,)
            Frame indices in the sequence, increasing.
        values : ndarray of shape (n, W) or (n, H)
            Panel values in [0, 1]; flat frames come with the first coded axis.
        """
        indices = self.frames_along(axis)
        return indices, self.shown(indices, axis)

    def image(self, k: int) -> NDArray[np.float64]:
        """Return frame `k` as a panel image, (H, W), values in [0, 1].

        Raises
        ------
        InputError
            For a frame index outside the sequence.
        """
        frames = self.frames()
        if not 0 <= k < len(frames):
            raise InputError("patterns: frame index", f"0..{len(frames) - 1}", k)
        return frames[k].part.image(frames[k].index, self.panel)

    def images(self) -> NDArray[np.float64]:
        """Return all frames as panel images, shape (N, H, W), values in [0, 1]."""
        images = np.empty((self.n_frames, self.panel[1], self.panel[0]))
        for image, frame in zip(images, self.frames(), strict=True):
            image[:] = frame.part.image(frame.index, self.panel)
        return images

    # How a sequence is written and read.

    def to_dict(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the sequence as plain values for a TOML or JSON file in `folder`."""
        parts = [{"kind": part.kind} | part.to_table(folder) for part in self.parts]
        usual = {f.name: f.default for f in fields(self)}
        beside = {key: getattr(self, key) for key in ("unwrap", "max_order_residual")}
        kept = {key: value for key, value in beside.items() if value != usual[key]}
        if self.crosstalk is not None:
            kept["crosstalk"] = [list(row) for row in self.crosstalk]
        return {"panel": list(self.panel), "parts": parts} | kept

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: Path | None = None) -> PatternSequence:
        """Build a sequence from what :meth:`to_dict` gives.

        Parameters
        ----------
        data : mapping
        folder : path, optional
            Where the file stands that it was read from; names of files are relative to it.

        Raises
        ------
        InputError
            Naming the key at fault when one is missing, unknown or has a wrong value.
        """
        given = validated(SequenceTable, data, "patterns")
        parts = [
            _part_from_dict(f"patterns: parts[{i}]", table, folder)
            for i, table in enumerate(given.parts)
        ]
        beside = (given.unwrap, given.max_order_residual, given.crosstalk)
        return cls(given.panel, tuple(parts), *beside)

    @classmethod
    def parse(
        cls, text: str, panel: tuple[int, int], shifts: int = 3, axes: str = "u"
    ) -> PatternSequence:
        """Read a sequence from its short text.

        Parameters
        ----------
        text : str
            Words joined by ``+``: ``white``, ``black``, ``gray``, fringe counts joined by
            commas, or those of installed codes.  ``@N`` after a count sets N shifts for it and
            for the counts before it that have none: ``"1,10,50"``, ``"1,10,50@4"``,
            ``"gray+16@8"``.  A count is any real number (``28.8@4``), or a period (``22.5px``);
            ``@0/90/180`` is a list of shifts in degrees.  A last word forces what tells fringes
            apart: ``"15,16@4+heterodyne"``, ``"16@4+spatial"``.  With ``+rgb`` at the end three
            frames in a row are the channels of one colour picture; ``white`` and ``black`` are
            whole pictures then, and black fills the last one.  Spaces stand beside these signs
            alone: ``"1 10 50"`` is not ``"11050"``.  A word of :data:`NAMED` is a whole set.
        panel : (int, int)
            Panel width and height in pixels.
        shifts : int
            Number of shifts where the text gives none.
        axes : {"u", "v", "uv", "vu"}
            Coded panel axes, each in turn; what does not code one alone is shown once.

        Raises
        ------
        InputError
            For text that cannot be read, with the word at fault.
        """
        if not isinstance(text, str) or not text.strip():
            raise InputError("patterns", 'text such as "1,10,50@4" or "gray+16@8"', repr(text))
        if axes not in ("u", "v", "uv", "vu"):
            raise InputError("patterns: axes", '"u", "v", "uv" or "vu"', repr(axes))
        found = compact(text)
        found = "+".join(NAMED.get(word, word) for word in found.split("+"))
        joined = re.sub(r"\s+", "+", re.sub(r"(?<=\d)\s+(?=\d)", ",", found))
        *words, last = joined.split("+")
        packed = bool(words) and last == PACKED
        if packed:
            *words, last = words
        forced = bool(words) and last in _WAYS
        parts: list[Code] = []
        for i, axis in enumerate(cast(Sequence[Axis], axes)):
            for word in words if forced else (*words, last):
                codes = _read_word(f'patterns "{text}"', word, axis, shifts)
                parts += [code for code in codes if i == 0 or code.axes == (axis,)]
        if joined != found:
            expected = f'"{joined}": counts joined by commas, words by +'
            raise InputError(f'patterns "{text}"', expected, "spaces between them")
        unwrap = cast(Unwrap, last) if forced else "auto"
        if not packed:
            return cls(panel, tuple(parts), unwrap)
        parts = [part for one in parts for part in (one,) * (3 if isinstance(one, Flat) else 1)]
        count = sum(part.n_frames(panel) for part in parts)
        parts += [Flat(0.0)] * (-count % 3)
        return cls(panel, tuple(parts), unwrap, crosstalk=UNMIXED)


def _text(parts: Sequence[Code]) -> str:
    """Write codes in the language of :meth:`PatternSequence.parse`."""
    runs = groupby(parts, lambda part: type(part))
    return "+".join(family.write_run(list(run)) for family, run in runs)


@dataclass(frozen=True)
class SequenceTable(Value):
    """The keys of a sequence in a file, its parts not yet read."""

    panel: tuple[Pixels, Pixels]
    parts: Annotated[tuple[Mapping[str, Any], ...], MinLen(1)]
    unwrap: Unwrap = "auto"
    max_order_residual: OrderResidual = MAX_ORDER_RESIDUAL
    crosstalk: tuple[tuple[NotNegative, ...], ...] | None = None


@contextmanager
def _located(where: str) -> Iterator[None]:
    """Name the place of a part, and the key at fault, in the errors that it raises."""
    try:
        yield
    except InputError as error:
        _, _, key = error.where.partition(": ")
        place = f"{where}.{key}" if key else where
        raise InputError(place, error.expected, error.got) from None


def _part_from_dict(where: str, table: Mapping[str, Any], folder: Path | None) -> Code:
    family = pattern_codes.get(table.get("kind"), f"{where}.kind")
    values = {key: value for key, value in table.items() if key != "kind"}
    with _located(where):
        return family.from_table(values, folder)


def compact(text: str) -> str:
    """Return short text without the spaces that part no words."""
    return _BESIDE_SIGNS.sub(r"\1", text.strip())


def _read_word(where: str, word: str, axis: Axis, shifts: int) -> list[Code]:
    """Return the codes of one word, from the first family that knows it."""
    words: list[str] = []
    for name in pattern_codes:
        family = pattern_codes.get(name)
        try:
            codes = family.read_word(word, axis, shifts)
        except InputError as error:
            # A field at fault names itself, a word the text that it stands in.
            place = error.where if ": " in error.where else where
            raise InputError(place, error.expected, error.got) from None
        if codes is not None:
            return list(codes)
        words += family.words
    words += NAMED
    expected = " or ".join([", ".join(words[:-1]), words[-1]])
    raise InputError(where, expected, quoted(word, words))
