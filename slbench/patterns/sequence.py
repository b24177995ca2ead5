"""Pattern sequences: what the projector's panel shows, frame by frame.

A :class:`PatternSequence` is a list of parts (:mod:`slbench.patterns.codes`) on a panel of
known size.  Because every frame varies along one panel axis only, the light transport is
multiplied with *profiles*, one value a column or row; whole images are made only to be
shown.  The short text of a sequence, such as ``"1,10,50@4"``, follows the thesis's notation
{1, 10, 50} for fringe counts in order of unwrapping.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.patterns.codes import (
    MIN_SHIFTS,
    Axis,
    Flat,
    Fringes,
    GrayCode,
    Part,
    require_axis,
    require_whole,
)

# Three pixels a fringe are the least that carry amplitude, phase and mean.
MIN_PIXELS_PER_FRINGE = 3

_KINDS: dict[str, type[Fringes] | type[GrayCode] | type[Flat]] = {
    "fringes": Fringes,
    "gray": GrayCode,
    "flat": Flat,
}
_KEYS: dict[str, tuple[set[str], set[str]]] = {  # kind -> (required, optional)
    "fringes": ({"count"}, {"shifts", "axis"}),
    "gray": (set(), {"axis", "inverse"}),
    "flat": ({"level"}, set()),
}


@dataclass(frozen=True)
class Frame:
    """Where one frame of a sequence comes from."""

    part_index: int
    """Index into ``PatternSequence.parts``."""
    part: Part
    """The part itself."""
    index: int
    """Index of the frame within its part."""
    axis: Axis | None
    """Panel axis the frame varies along; None for a flat frame."""


@dataclass(frozen=True)
class PatternSequence:
    """The frames that are projected in one scan, in order.

    Parameters
    ----------
    panel : (int, int)
        Panel width W and height H in pixels.
    parts : tuple of Fringes, GrayCode or Flat
        What is shown, in order of time.

    Raises
    ------
    InputError
        For a panel or parts that cannot be shown: no parts, more fringes than the panel
        has pixels for (three each), a Gray code twice on an axis or on a single column.
    """

    panel: tuple[int, int]
    parts: tuple[Part, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.panel, (tuple, list)) or len(self.panel) != 2:
            raise InputError("patterns: panel", "(width, height) in pixels", repr(self.panel))
        require_whole("patterns: panel width", self.panel[0], 1)
        require_whole("patterns: panel height", self.panel[1], 1)
        # Lists are accepted, as they come from files, and stored as the tuples promised.
        object.__setattr__(self, "panel", (int(self.panel[0]), int(self.panel[1])))
        object.__setattr__(self, "parts", tuple(self.parts))
        if not self.parts:
            raise InputError("patterns: parts", "at least one part", "none")
        gray_axes: set[str] = set()
        for i, part in enumerate(self.parts):
            where = f"patterns: parts[{i}]"
            if isinstance(part, Fringes):
                most = self.size(part.axis) // MIN_PIXELS_PER_FRINGE
                if part.count > most:
                    raise InputError(
                        f"{where}.count",
                        f"at most {most} fringes on {self.size(part.axis)} panel pixels",
                        part.count,
                    )
            elif isinstance(part, GrayCode):
                if part.axis in gray_axes:
                    raise InputError(where, f"one Gray code along {part.axis}", "a second one")
                if self.size(part.axis) < 2:
                    raise InputError(where, "at least 2 panel pixels to code", "1")
                gray_axes.add(part.axis)
            elif not isinstance(part, Flat):
                raise InputError(where, "Fringes, GrayCode or Flat", type(part).__name__)

    def size(self, axis: Axis) -> int:
        """Return the number of panel pixels along `axis`: W for "u", H for "v"."""
        require_axis("patterns: axis", axis)
        return self.panel[0] if axis == "u" else self.panel[1]

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The coded panel axes, in order of their first appearance."""
        return tuple(dict.fromkeys(part.axis for part in self.parts if not isinstance(part, Flat)))

    @property
    def n_frames(self) -> int:
        """Number of frames in one scan."""
        return sum(self._frames_of(part) for part in self.parts)

    @property
    def name(self) -> str:
        """Short text such as ``"gray+1,10,50@4"``, which :meth:`parse` reads back.

        The coded axes are not part of it, and what the short text has no word for (a grey
        flat, a Gray code without inverses, two axes coded differently) is shown but not
        parsed.
        """
        texts = {axis: self._text((axis,)) for axis in self.axes}
        if len(set(texts.values())) > 1:
            return self._text(self.axes)
        return next(iter(texts.values()), self._text(()))

    def fringe_counts(self, axis: Axis) -> tuple[int, ...]:
        """Return the fringe counts along `axis`, in order of projection."""
        require_axis("patterns: axis", axis)
        return tuple(p.count for p in self.parts if isinstance(p, Fringes) and p.axis == axis)

    def frames(self) -> list[Frame]:
        """Return one :class:`Frame` for each projected frame, in order."""
        return [
            Frame(i, part, k, None if isinstance(part, Flat) else part.axis)
            for i, part in enumerate(self.parts)
            for k in range(self._frames_of(part))
        ]

    def profile(self, k: int) -> tuple[Axis, NDArray[np.float64]]:
        """Return frame `k` as its axis and its values along it.

        Returns
        -------
        axis : {"u", "v"}
            Axis of variation.  Flat frames, which vary along neither, are given along the
            first coded axis (``"u"`` if there is none), so that they share its transport.
        values : ndarray of shape (W,) or (H,)
            Panel values in [0, 1].

        Raises
        ------
        InputError
            For a frame index outside the sequence.
        """
        frames = self.frames()
        if not 0 <= k < len(frames):
            raise InputError("patterns: frame index", f"0..{len(frames) - 1}", k)
        frame = frames[k]
        axis = self._profile_axis(frame.axis)
        return axis, frame.part.profile(frame.index, self.size(axis))

    def profiles(self, axis: Axis) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Return all frames that vary along `axis`, for one product with its transport.

        Returns
        -------
        indices : ndarray of shape (n,)
            Frame indices in the sequence, increasing.
        values : ndarray of shape (n, W) or (n, H)
            Panel values in [0, 1]; flat frames as in :meth:`profile`.
        """
        size = self.size(axis)
        chosen = [
            (k, frame.part.profile(frame.index, size))
            for k, frame in enumerate(self.frames())
            if self._profile_axis(frame.axis) == axis
        ]
        indices = np.array([k for k, _ in chosen], dtype=np.intp)
        values = np.array([row for _, row in chosen], dtype=np.float64)
        return indices, values.reshape(len(chosen), size)

    def images(self) -> NDArray[np.float64]:
        """Return all frames as panel images, shape (N, H, W), values in [0, 1]."""
        width, height = self.panel
        images = np.empty((self.n_frames, height, width))
        for k in range(self.n_frames):
            axis, values = self.profile(k)
            images[k] = values[np.newaxis, :] if axis == "u" else values[:, np.newaxis]
        return images

    def to_dict(self) -> dict[str, Any]:
        """Return the sequence as plain values for a TOML or JSON file."""
        parts: list[dict[str, Any]] = []
        for part in self.parts:
            if isinstance(part, Fringes):
                count, shifts = int(part.count), int(part.shifts)
                parts.append(
                    {"kind": "fringes", "count": count, "shifts": shifts, "axis": part.axis}
                )
            elif isinstance(part, GrayCode):
                parts.append({"kind": "gray", "axis": part.axis, "inverse": part.inverse})
            else:
                parts.append({"kind": "flat", "level": float(part.level)})
        return {"panel": list(self.panel), "parts": parts}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "PatternSequence":
        """Build a sequence from what :meth:`to_dict` gives.

        Raises
        ------
        InputError
            Naming the key at fault when one is missing, unknown or has a wrong value.
        """
        if not isinstance(data, Mapping):
            raise InputError("patterns", "a table with panel and parts", type(data).__name__)
        _require_keys("patterns", data, {"panel", "parts"}, set())
        if not isinstance(data["parts"], (list, tuple)):
            raise InputError("patterns: parts", "a list of tables", repr(data["parts"]))
        parts = [_part_from_dict(f"patterns: parts[{i}]", p) for i, p in enumerate(data["parts"])]
        return cls(data["panel"], tuple(parts))

    @classmethod
    def parse(
        cls, text: str, panel: tuple[int, int], shifts: int = 3, axes: str = "u"
    ) -> "PatternSequence":
        """Read a sequence from its short text.

        Parameters
        ----------
        text : str
            Parts joined by ``+``: ``white``, ``black``, ``gray`` or fringe counts joined by
            commas.  ``@N`` after a count sets N shifts for it and for the counts before it
            that have none: ``"1,10,50"``, ``"1,10,50@4"``, ``"gray+16@8"``.
        panel : (int, int)
            Panel width and height in pixels.
        shifts : int
            Number of shifts where the text gives none.
        axes : {"u", "v", "uv", "vu"}
            Coded panel axes, each in turn; white and black are shown once.

        Raises
        ------
        InputError
            For text that cannot be read, with the word at fault.
        """
        if not isinstance(text, str) or not text.strip():
            raise InputError("patterns", 'text such as "1,10,50@4" or "gray+16@8"', repr(text))
        if axes not in ("u", "v", "uv", "vu"):
            raise InputError("patterns: axes", '"u", "v", "uv" or "vu"', repr(axes))
        parts: list[Part] = []
        for i, axis in enumerate(axes):
            for word in text.replace(" ", "").split("+"):
                if word in ("white", "black"):
                    if i == 0:
                        parts.append(Flat(1.0 if word == "white" else 0.0))
                elif word == "gray":
                    parts.append(GrayCode(axis))  # type: ignore[arg-type]
                else:
                    parts.extend(
                        Fringes(count, n, axis)  # type: ignore[arg-type]
                        for count, n in _parse_fringes(text, word, shifts)
                    )
        return cls(panel, tuple(parts))

    def _frames_of(self, part: Part) -> int:
        return part.n_frames(1 if isinstance(part, Flat) else self.size(part.axis))

    def _profile_axis(self, axis: Axis | None) -> Axis:
        if axis is not None:
            return axis
        return self.axes[0] if self.axes else "u"

    def _text(self, axes: Sequence[Axis]) -> str:
        """Write the flat parts and those along `axes` in the language of :meth:`parse`."""
        words: list[str] = []
        sets: list[Fringes] = []
        for part in (*self.parts, None):
            if isinstance(part, Fringes):
                if part.axis in axes:
                    sets.append(part)
                continue
            if part is not None and not isinstance(part, Flat) and part.axis not in axes:
                continue
            if sets:
                words.append(_write_fringes(sets))
                sets = []
            if isinstance(part, GrayCode):
                words.append("gray" if part.inverse else "gray(no inverse)")
            elif isinstance(part, Flat):
                named = {1.0: "white", 0.0: "black"}
                words.append(named.get(float(part.level), f"flat({part.level:g})"))
        return "+".join(words)


def _parse_fringes(text: str, word: str, shifts: int) -> list[tuple[int, int]]:
    """Read ``1,10,50@4`` as (count, shifts) pairs; an @ also holds for counts before it."""
    pairs: list[tuple[int, int]] = []
    last = shifts
    for item in reversed(word.split(",")):
        match = re.fullmatch(r"(\d{1,6})(?:@(\d{1,6}))?", item)
        if match is None:
            raise InputError(
                f'patterns "{text}"', "white, black, gray or counts such as 1,10,50@4", repr(item)
            )
        last = int(match[2]) if match[2] else last
        pairs.append((int(match[1]), last))
    return pairs[::-1]


def _write_fringes(sets: Sequence[Fringes]) -> str:
    """Write fringe sets as :func:`_parse_fringes` reads them, with as few @ as possible."""
    items: list[str] = []
    following = MIN_SHIFTS
    for part in reversed(sets):
        mark = "" if part.shifts == following else f"@{part.shifts}"
        items.append(f"{part.count}{mark}")
        following = part.shifts
    return ",".join(reversed(items))


def _require_keys(
    where: str, table: Mapping[str, Any], required: set[str], optional: set[str]
) -> None:
    for key in sorted(required - set(table)):
        raise InputError(f"{where}.{key}", "a value", "nothing: the key is missing")
    for key in sorted(set(table) - required - optional, key=str):
        raise InputError(f"{where}.{key}", f"only {sorted(required | optional)}", "this key")


def _part_from_dict(where: str, table: object) -> Part:
    if not isinstance(table, Mapping):
        raise InputError(where, "a table with a kind", repr(table))
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise InputError(f"{where}.kind", " or ".join(_KINDS), repr(kind))
    values = {key: value for key, value in table.items() if key != "kind"}
    _require_keys(where, values, *_KEYS[kind])
    try:
        return _KINDS[kind](**values)
    except InputError as error:
        key = error.where.rsplit(": ", 1)[-1]
        raise InputError(f"{where}.{key}", error.expected, error.got) from None
