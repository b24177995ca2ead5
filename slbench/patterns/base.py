"""What a code is: a part of a pattern sequence, from what it shows to what is decoded from it.

A :class:`Code` says which panel axes it codes, how many frames it has, what each of them shows,
how it is written and read, and how its frames become a panel coordinate.  Sequence
(:mod:`slbench.patterns.sequence`) and decoder (:mod:`slbench.patterns.decode`) know no code by
name: they find families in the registry (:data:`slbench.patterns.registry.pattern_codes`) and ask.

Three things are kept apart:

- *what was shown*: the fields of a code and its :meth:`Code.profile` or :meth:`Code.image`;
- *how a relative value is estimated*: :meth:`Code.relative_phase`, and the loops in
  :mod:`slbench.patterns.kernels`;
- *how ambiguity is resolved*: :meth:`Code.decode_run`, from what coarser codes have found
  (:class:`Found`), and :meth:`Code.check_run`, which refuses what could not be.

**Runs.**  Adjacent codes of one family along the same axes are decoded together, as a
:class:`Run`.  The short text puts them into one word likewise (``1,10,50@4``).  Codes of other
axes and frames that code nothing may stand between them.  A family that refines
(:attr:`Code.refines`) has one run an axis, after all others: all fringe sets are one pass over
their frames, in whatever order they were shown.

**What the interface carries.**  Every planned key and code, and where it goes:

=================================  ==============================================================
fringes: real ``count``,           fields of the code; `profile` shows them, `relative_phase`
``period_px``, ``shifts_deg``,     takes them out again, and neither caller knows.  A period in
``direction``, ``phase_deg``,      pixels becomes a count where the panel's size is known, which
``origin``                         every method is given
Gray: ``code``, ``bits``,          fields; `n_frames` and `profile` count and show the cells
``cell_px``, ``offset_px``
``complementary``, ``shifted``     one more frame of the same code
``threshold = "flats"``            :meth:`Observed.flats`, which asks every code for its
                                   :meth:`Code.flat_level`
``threshold = "mean"``             frames of other codes are in :attr:`Observed.codes`; a code's
                                   frames have the mean of the scene where their profiles have
                                   one mean at every panel place, which follows from `profile`
``threshold = "range"``, a number  the code's own frames
``unwrap``                         field of :class:`Run`, as `check_run` needs it too
``use_bits``,                      fields of :class:`Observed`, as `min_modulation` is
``max_order_residual``
codes in any order                 :meth:`PatternSequence.runs` chooses the order of decoding
                                   (:attr:`Code.refines`); `check_run` says what a family needs
                                   to have before it
heterodyne, number-theoretic       all sets of an axis are in one run
relative phase as the result       :attr:`Found.relative`
``images``, decoded by matching    `varies` = "uv", `image`, and a `decode_run` that returns both
                                   axes; ``files`` are relative to the folder that `from_table`
                                   and `to_table` are given
images that code one axis          `axes` = ("u",) with `varies` = "uv": two questions
colour packings, ``crosstalk``     a frame is one channel; pixels are unmixed before codes see
                                   them
saturation, one rule a part        :meth:`Code.may_saturate` takes a frame out of the common
                                   search; the code then judges it in its own mask
evidence                           :attr:`Found.evidence`, by part and name
=================================  ==============================================================
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.core.validation.types import Axis
from slbench.core.validation.values import Value, validated
from slbench.patterns.noise import NoiseModel
from slbench.rig.optics.response import Response

FloatArray = NDArray[np.float64]
#: Of what no digit beyond single precision is of use: in half the memory.
AnyFloatArray = NDArray[np.float32] | NDArray[np.float64]
#: What a frame varies along; "uv" is a whole image.
Variation = Literal["u", "v", "uv"]
#: Panel width and height, px.
Panel = tuple[int, int]
#: What tells fringes apart (:mod:`slbench.patterns.fringes.ways`).
Unwrap = Literal["auto", "sequential", "gray", "heterodyne", "number-theoretic", "spatial", "none"]


class Rule(IntEnum):
    """By which rule a pixel has no coordinate; the least of those that apply, as it is the cause.

    A pixel without light has undecided bits and a random fringe order too.
    """

    KEPT = 0
    """It has one."""
    SATURATED = 1
    """A frame that must not is saturated, or not a number."""
    MODULATION = 2
    """Fringes, or all bits of a Gray code, below the least modulation or its ratio to noise."""
    BIT = 3
    """Bits of a coarse code are undecided, or its place is not known to a fringe."""
    ORDER = 4
    """The fringe order is further off a whole number than is believed."""
    END = 5
    """Beyond the panel, or at one of its ends that cannot be told from the other."""
    RELATIVE = 6
    """Nothing is wrong, but only relative phases were asked for."""
    OTHER = 7
    """A code's own rule."""


def extent(panel: Panel, axis: Axis) -> int:
    """Return the number of panel pixels along an axis: W for "u", H for "v"."""
    return panel[0] if axis == "u" else panel[1]


class Code(Value, ABC):
    """A part of a pattern sequence: an immutable value, usually a frozen dataclass.

    A family derives from this class, gives the abstract members and registers itself
    (:data:`slbench.patterns.registry.pattern_codes`).  The fields of a dataclass are checked by
    their types; any other :class:`InputError` names a field as ``"Fringes: count"``, or the code
    alone (``"Fringes"``) where no field is at fault.
    """

    kind: ClassVar[str]
    """Name in the registry and in tables (``kind = "fringes"``)."""
    words: ClassVar[tuple[str, ...]] = ()
    """What the short text has for the family, for messages: ``("gray",)``."""
    refines: ClassVar[bool] = False
    """Whether the family is decoded after all others of its axes, as one run, wherever it stands:
    fringes, which a coarser code tells apart."""
    spatial: ClassVar[bool] = False
    """Whether a pixel is decoded by its neighbours in the picture, so that none can be left out."""

    # What was shown.

    axis: Axis
    """The coded panel axis, a field of families that code one."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The panel axes whose coordinate is decoded from the code, none for a flat frame.

        By default the one of the field `axis`.
        """
        return (self.axis,)

    @abstractmethod
    def n_frames(self, panel: Panel) -> int:
        """Return the number of frames on a panel of this width and height."""

    def varies(self, k: int) -> Variation | None:
        """Return what frame `k` varies along, None for a flat frame; by default `axes`."""
        if len(self.axes) == 2:
            return "uv"
        return self.axes[0] if self.axes else None

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k`, which varies along one axis of `size` pixels or none.

        Returns
        -------
        (size,) float64
            Panel values in [0, 1], one a column or row.
        """
        raise NotImplementedError(f"{type(self).__name__} shows images")

    def image(self, k: int, panel: Panel) -> FloatArray:
        """Return frame `k` as a panel image, (H, W) in [0, 1]; by default its profile, spread."""
        width, height = panel
        if self.varies(k) == "v":
            return np.repeat(self.profile(k, height)[:, np.newaxis], width, axis=1)
        return np.repeat(self.profile(k, width)[np.newaxis], height, axis=0)

    def flat_level(self, k: int) -> float | None:
        """Return the panel value of frame `k` if it has only one, None by default."""
        return None

    def multiplexed_orders(self, panel: Panel) -> tuple[NDArray[np.intp], ...]:
        """Return orders in which projectors show the code's frames at once and are told apart.

        Returns
        -------
        tuple of (N,) int
            One a projector: its k-th frame is in this picture.  By default there are none.
        """
        return ()

    def straightened(
        self, frames: NDArray[Any], panel: Panel, response: Response, saturation: float
    ) -> NDArray[Any]:
        """Return the code's frames, (N, P), as a linear projector would have made them.

        Black and white are the same by any response; by default nothing else can be told.

        Raises
        ------
        InputError
            For a code of grey values that is decoded as if the projector were linear.
        """
        for k in range(self.n_frames(panel)):
            along = self.varies(k)
            alone = along in ("u", "v")
            shown = self.profile(k, extent(panel, along)) if alone else self.image(k, panel)  # type: ignore[arg-type]
            if not np.all((shown == 0.0) | (shown == 1.0)):
                expected = (
                    "fringes, codes of black and white and those decoded by matching, "
                    "or pictures that undo it"
                )
                raise InputError("response", expected, f"{self.kind}, which is grey")
        return frames

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError if the panel cannot show the code, after the codes `before`."""
        return

    def extended(self, extra: int) -> Self | None:
        """Return the code with `extra` more frames that lower its noise, None if it has none."""
        return None

    # Table and short text.

    @classmethod
    def from_table(cls, table: Mapping[str, Any], folder: Path | None) -> Self:
        """Return the code of a table, its ``kind`` taken away.

        Here the keys are the fields of the dataclass, those without a default required.

        Parameters
        ----------
        table : mapping
        folder : path or None
            Where the file with the table stands; names of files are relative to it.

        Raises
        ------
        InputError
            For a key that is missing or unknown, or a value that is not acceptable.
        """
        return validated(cls, table, cls.__name__, ": ")

    def to_table(self, folder: Path | None) -> dict[str, Any]:
        """Return what :meth:`from_table` reads, as plain values; by default all fields.

        Parameters
        ----------
        folder : path or None
            Where the file with the table will stand, for a code that is kept in files.
        """
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}  # type: ignore[arg-type]

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Return the codes of a word of the short text, None if the family has no such word.

        Parameters
        ----------
        word : str
            What stands between two ``+``, without spaces.
        axis : {"u", "v"}
            The axis that is coded.
        shifts : int
            Phase shifts of fringes that state none.

        Raises
        ------
        InputError
            For a word that is the family's but has a mistake.
        """
        return None

    @property
    def word(self) -> str:
        """The code in the short text; by default its kind, which is not read back."""
        return f"({self.kind})"

    @classmethod
    def write_run(cls, codes: Sequence[Self]) -> str:
        """Return adjacent codes of the family as short text; by default word + word."""
        return "+".join(code.word for code in codes)

    # How a relative value is estimated.

    def fringe_count(self, panel: Panel) -> float | None:
        """Return the periods across the panel if the frames are shifted fringes, else None.

        Any real number; an int where it is whole.
        """
        return None

    def periods(self, panel: Panel) -> float:
        """Return how often the code repeats itself across the panel; of codes that refine.

        The finest is decoded last, whatever was shown last.
        """
        return self.fringe_count(panel) or 1.0

    def relative_phase(
        self, frames: ArrayLike, panel: Panel
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return relative phase, modulation and mean, (V, U) each, of its frames (N, V, U).

        For a code with a :meth:`fringe_count`; the phase is that of fringes that begin at the
        panel's edge.
        """
        raise NotImplementedError(f"{type(self).__name__} has no phase")

    # How frames become a coordinate.

    def may_saturate(self, k: int) -> bool:
        """Return whether a pixel may saturate (or be NaN) in frame `k` and still be decoded.

        A saturated pixel of any other frame is masked out by the decoder.  Of these frames
        :meth:`decode_run` decides itself.
        """
        return False

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError if a run cannot be resolved, given those before it on its axes."""
        return

    @classmethod
    def decode_run(cls, run: Run, observed: Observed, found: Mapping[Axis, Found]) -> Decoded:
        """Decode a run of codes of the family.

        Called for codes with axes.  Compiled code and SciPy are imported here and not before:
        reading a sequence must stay cheap.

        Parameters
        ----------
        run : Run
        observed : Observed
            All frames, and what is asked of the decoder.
        found : mapping of axis to Found
            What the runs before this one have found.

        Returns
        -------
        dict of axis to Found
            For every axis of the run.
        """
        raise NotImplementedError(f"{cls.__name__} codes no axis")


@dataclass(frozen=True)
class Placed:
    """A code at its place in a sequence."""

    index: int
    """Index into ``PatternSequence.parts``."""
    code: Code
    frames: range
    """Indices of its frames."""

    __repr__ = brief


@dataclass(frozen=True)
class Run:
    """Codes of one family along the same axes, with no other family along them in between.

    Parameters
    ----------
    parts : tuple of Placed
    panel : (int, int)
        Width and height of the panel, px.
    unwrap : str
        What is to tell fringes apart; "auto" chooses it from what is there.
    searched : tuple of int
        Frames to search for saturated and non-finite pixels, where the family can do so while
        it reads them anyway; see :attr:`Found.complete`.
    final : bool
        Whether no other run along any of its axes follows: what it finds is the result.
    """

    parts: tuple[Placed, ...]
    panel: Panel
    unwrap: Unwrap = "auto"
    searched: tuple[int, ...] = ()
    final: bool = False

    __repr__ = brief

    @property
    def family(self) -> type[Code]:
        """The class of the codes."""
        return type(self.parts[0].code)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes that the codes share."""
        return self.parts[0].code.axes


@dataclass(frozen=True, kw_only=True)
class Observed:
    """The frames of a whole sequence, and what is asked of the decoder.

    Parameters
    ----------
    pixels : (N, P) uint8, uint16, float32 or float64
        Frames in digital numbers, one row each, contiguous.
    shape : (int, int)
        Rows and columns of a frame, P in all: for what looks at neighbours.
    panel : (int, int)
        Width and height of the panel, px.
    codes : tuple of Placed
        All parts of the sequence.
    noise : NoiseModel
    saturation : float
        Value at and above which a pixel is saturated.
    min_modulation, min_snr : float
        Least modulation, DN, and its least ratio to the noise of a frame.
    max_order_residual : float
        Largest residual of a fringe order that is believed, turns.
    keep_relative, keep_evidence : bool
        Whether :attr:`Found.relative` and :attr:`Found.evidence` are wanted.
    response : Response or None
        Of the projector, for codes whose frames are not straightened (:meth:`Code.straightened`).
    """

    pixels: NDArray[Any]
    shape: tuple[int, int]
    panel: Panel
    codes: tuple[Placed, ...]
    noise: NoiseModel
    saturation: float
    min_modulation: float
    min_snr: float
    max_order_residual: float
    keep_relative: bool
    keep_evidence: bool
    response: Response | None = None

    __repr__ = brief

    def flats(self, level: float) -> list[int]:
        """Return the indices of the frames that show one level all over the panel."""
        return flat_frames(self.codes, level)


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a run has found along one axis; all arrays flat, (P,).

    Parameters
    ----------
    coordinate : (P,) float64
        Panel coordinate, px; NaN where the code gives none.  A coarse code may state it where
        its own mask is False: finer ones judge for themselves.
    sigma : (P,) float64
        Standard deviation of the coordinate, px.
    modulation, mean : (P,) float32 or float64
        Contrast and mean of the frames that decide the coordinate, DN.
    mask : (P,) bool
        Where the coordinate is good enough to be the result.
    complete : bool
        Whether the pixels that saturate in ``run.searched`` are out of the mask already, and
        coordinate and sigma NaN outside it; both arrays are then the decoder's to write to.
        The decoder does both where it is False.
    spare : bool
        Whether a finer code may write its own results over coordinate and sigma: fresh memory
        takes longer than arithmetic.
    relative : tuple of (fringes, (P,) float64)
        Relative phase in [0, 2 pi) of every fringe set of the run, if wanted.
    evidence : mapping of part index to mapping of name to (..., P) float32 or float64
        By what a user may judge the coordinate, if wanted.
    dropped : (P,) uint8, optional
        By which :class:`Rule` a pixel is masked out, if evidence is wanted and the code says so;
        of a saturated pixel in ``run.searched`` the decoder says it.
    """

    coordinate: FloatArray
    sigma: FloatArray
    modulation: AnyFloatArray
    mean: AnyFloatArray
    mask: NDArray[np.bool_]
    complete: bool = False
    spare: bool = False
    relative: tuple[tuple[float, FloatArray], ...] = ()
    evidence: Mapping[int, Mapping[str, AnyFloatArray]] = field(default_factory=dict)
    dropped: NDArray[np.uint8] | None = None

    __repr__ = brief


Decoded = Mapping[Axis, Found]


def flat_frames(codes: Sequence[Placed], level: float) -> list[int]:
    """Return the indices of the frames that show one level all over the panel."""
    return [
        frame
        for placed in codes
        for k, frame in enumerate(placed.frames)
        if placed.code.flat_level(k) == level
    ]
