"""Pattern sets as people give them: short text, a TOML file, a folder of pictures, an object.

Everything that takes a pattern set reads it here, from the command line, from files and in
Python::

    1,10,50@4               short text (PatternSequence.parse)
    sets/mine.toml          a file with parts, or with a [patterns] table
    session                 a folder: pictures, or a capture.toml (or patterns.toml) in it
    mine.py:SET             an object of a Python file, or of a module: a sequence, a code, codes,
                            or a function of the panel that returns one of them

Words of the short text come before folders of the same name: ``./gray`` is a folder.  Python is
run only where the person at the keyboard says so (:mod:`slbench.core.modules`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from slbench.core.errors import InputError, located
from slbench.core.modules import load_modules, load_object, names_object
from slbench.core.registry import quoted
from slbench.core.resources import inside
from slbench.core.validation.types import NotNegative, OrderResidual, Pixels, Shifts
from slbench.core.validation.values import Value, validated
from slbench.patterns.base import Code, Panel, Unwrap
from slbench.patterns.decode import Decoder
from slbench.patterns.registry import pattern_codes
from slbench.patterns.sequence import PatternSequence

#: What a pattern set may be given as.
PatternSource = (
    str
    | Path
    | PatternSequence
    | Code
    | Sequence[Code]
    | Mapping[str, Any]
    | Callable[[Panel], PatternSequence | Code | Sequence[Code]]
)
#: A panel that any short text fits.
_LARGE = (8192, 8192)
#: Files of a folder that say what its pictures are.
MANIFESTS = ("capture.toml", "patterns.toml")
_FORMS = "short text, a TOML file, a folder of pictures or module:object"
_OBJECTS = "a PatternSequence, a Code, a list of them, or a function of the panel that returns one"


class GivenPatterns(NamedTuple):
    """A pattern set that was read, and what to call it.

    ``name`` is its short text without spaces, the stem of its file, the name of its folder, or
    ``module:object``; ``own_axes`` says whether the set states itself which axes it codes.
    """

    name: str
    sequence: PatternSequence
    own_axes: bool


def read_decoder(text: str, folder: Path | None, allowed: bool, where: str) -> Decoder:
    """Return a decoder of the user's own, ``mine.py:decode``.

    Parameters
    ----------
    text : str
        ``module:object``, the module by its file or its name.
    folder : path or None
        What the file is relative to; the working directory by default.
    allowed : bool
        Whether code may be run (``--allow-modules``).
    where : str
        What names it, for messages.

    Raises
    ------
    InputError
        For an object that is not there, may not be run, or is no function.
    """
    decoder = load_object(text, folder, allowed, where)
    if not callable(decoder):
        expected = "a function of frames and sequence that returns a PhaseMap"
        raise InputError(where, expected, type(decoder).__name__)
    return cast(Decoder, decoder)


@dataclass(frozen=True)
class PatternsTable(Value):
    """The ``[patterns]`` of a file: a set in words, or what a capture has.

    Parameters
    ----------
    sequence : str, optional
        In words; a scene's may name a file, a folder or an object too.
    shifts, axes : optional
        Of short text; 3 and "u".
    panel : (int, int), optional
        Size of the panel that the parts are for.
    parts, unwrap, max_order_residual : optional
        As :meth:`PatternSequence.from_dict` reads them.
    crosstalk : optional
        As a :class:`PatternSequence` has it, beside parts or words.
    """

    sequence: str | None = None
    shifts: Shifts | None = None
    axes: str | None = None
    panel: tuple[Pixels, Pixels] | None = None
    parts: tuple[Mapping[str, Any], ...] | None = None
    unwrap: Unwrap | None = None
    max_order_residual: OrderResidual | None = None
    crosstalk: tuple[tuple[NotNegative, ...], ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.parts is None:
            self._none_of(("panel", "unwrap", "max_order_residual"), "without parts")
        else:
            self._none_of(("sequence", "shifts", "axes"), "beside parts")

    def _none_of(self, names: tuple[str, ...], why: str) -> None:
        for name in names:
            if getattr(self, name) is not None:
                raise InputError(f"patterns: {name}", f"no such key {why}", getattr(self, name))

    def coloured(self, sequence: PatternSequence) -> PatternSequence:
        """Return the sequence that the words stand for, its frames packed as the table says."""
        if self.crosstalk is None:
            return sequence
        return replace(sequence, crosstalk=self.crosstalk, assumed=None)

    def content(self, panel: Panel) -> dict[str, Any]:
        """Return what :meth:`PatternSequence.from_dict` reads, for a panel unless one is stated."""
        stated = {name: value for name, value in vars(self).items() if value is not None}
        return {"panel": panel} | stated


def read_patterns(
    given: PatternSource,
    panel: Panel,
    *,
    shifts: int = 3,
    axes: str = "u",
    folder: Path | None = None,
    allow_modules: bool = False,
    keep_panel: bool = False,
    where: str = "patterns",
) -> GivenPatterns:
    """Read a pattern set, whatever it is given as.

    Parameters
    ----------
    given : str, path, PatternSequence, Code, sequence of Code, mapping or callable
        As the module's docstring says; a mapping is the table of a file.
    panel : (int, int)
        Width and height of the panel, px.
    shifts : int
        Phase shifts of fringes where short text states none.
    axes : {"u", "v", "uv", "vu"}
        Axes that short text codes; all else says it itself.
    folder : path, optional
        Of the file that names the set: paths are relative to it and stay inside it.  By default
        the person running this names it, and paths lead anywhere.
    allow_modules : bool
        Run the Python modules that the set names: code of their authors.
    keep_panel : bool
        Let a set that states the size of its panel keep it.
    where : str
        The argument, option or key, for messages.

    Returns
    -------
    GivenPatterns

    Raises
    ------
    InputError
        If it is none of these, cannot be read, or is for another panel.
    """
    read = _Reader(panel, shifts, axes, folder, allow_modules, keep_panel, where)
    if isinstance(given, str):
        return read.text(given)
    if isinstance(given, Path):
        return read.path(given, str(given))
    if isinstance(given, Mapping):
        sequence, own = read.table(given, where, folder)
        return GivenPatterns(sequence.name, sequence, own)
    sequence, own = read.value(given)
    return GivenPatterns(sequence.name, sequence, own)


class _Reader(NamedTuple):
    """What a pattern set is read for."""

    panel: Panel
    shifts: int
    axes: str
    folder: Path | None
    allow_modules: bool
    keep_panel: bool
    where: str

    def text(self, text: str) -> GivenPatterns:
        """Read what a person writes."""
        text = text.strip()
        if names_object(text):
            value = load_object(text, self.folder, self.allow_modules, self.where)
            named = self._replace(where=f"{self.where}: {text}")
            sequence, own = named.value(value)
            for code in sequence.parts:
                _check_registered(code, named.where)
            return GivenPatterns(object_name(text), sequence, own)
        if text.lower().endswith(".toml"):
            return self.path(self.place(text), text)
        try:
            sequence = PatternSequence.parse(text, self.panel, self.shifts, self.axes)
        except InputError:
            if not text or "\0" in text or len(text) > 1000:
                raise
            path = self.place(text) if _leads_somewhere(text, self.folder) else None
            if path is None:
                raise
            return self.path(path, text)
        return GivenPatterns("".join(text.split()), sequence, own_axes=False)

    def place(self, text: str) -> Path:
        """Return the path that a text is, inside the folder of the file that has it."""
        if self.folder is None:
            return Path(text).expanduser()
        try:
            return inside(self.folder, text)
        except InputError as error:
            raise InputError(self.where, error.expected, error.got) from None

    def path(self, path: Path, text: str) -> GivenPatterns:
        """Read a TOML file or a folder."""
        name = path.resolve().name
        if path.is_dir():
            manifests = [path / one for one in MANIFESTS if (path / one).is_file()]
            if not manifests:
                return GivenPatterns(name, self.pictures(path), own_axes=True)
            sequence, own = self.file(manifests[0])
            return GivenPatterns(name, sequence, own)
        if not path.is_file():
            beside = [one.name for one in path.parent.glob("*")] if path.parent.is_dir() else []
            got = text + quoted(path.name, beside).removeprefix(repr(path.name))
            kind = "a TOML file" if path.suffix.lower() == ".toml" else "a folder"
            raise InputError(self.where, f"{kind} that is there", got)
        if path.suffix.lower() != ".toml":
            raise InputError(self.where, _FORMS, text)
        sequence, own = self.file(path)
        return GivenPatterns(path.stem, sequence, own)

    def file(self, path: Path) -> tuple[PatternSequence, bool]:
        """Read a TOML file: a capture's or a scene's [patterns], or parts alone."""
        from slbench.core.io import read_toml

        content = dict(read_toml(path))
        names = content.pop("modules", ())
        load_modules(names, path.parent, self.allow_modules, f"{path}: modules")
        table = content.get("patterns", content)
        with located(path):
            return self.table(table, "patterns", path.parent)

    def table(self, table: Any, where: str, folder: Path | None) -> tuple[PatternSequence, bool]:
        """Read a table: ``parts`` as in a capture, or ``sequence`` as in a scene."""
        if not isinstance(table, Mapping):
            raise InputError(where, "a table with parts or a sequence", type(table).__name__)
        given = validated(PatternsTable, table, where)
        if given.parts is not None:
            sequence = PatternSequence.from_dict(given.content(self.panel), folder)
            return self.fitting(sequence, f"{where}.panel"), True
        if given.sequence is None:
            raise InputError(where, "parts or a sequence", "neither")
        shifts, axes = given.shifts or self.shifts, given.axes or self.axes
        sequence = PatternSequence.parse(given.sequence, self.panel, shifts, axes)
        return given.coloured(sequence), False

    def pictures(self, path: Path) -> PatternSequence:
        """Read the PNGs of a folder, in natural order, as one code."""
        from slbench.patterns.images import Images

        try:
            code = Images.from_table({"files": "*.png"}, path)
        except InputError as error:
            raise InputError(f"{self.where}: {path}", error.expected, error.got) from None
        pictures = code.pictures
        coded = "uv"
        if np.array_equal(pictures[:, :1].repeat(pictures.shape[1], 1), pictures):
            coded = "u"
        elif np.array_equal(pictures[:, :, :1].repeat(pictures.shape[2], 2), pictures):
            coded = "v"
        height, width = pictures.shape[1:]
        sequence = PatternSequence((width, height), (Images(pictures, cast(Any, coded)),))
        return self.fitting(sequence, f"{self.where}: {path}")

    def value(self, value: Any) -> tuple[PatternSequence, bool]:
        """Read a Python object: what it is, or what it makes for the panel."""
        own = True
        if isinstance(value, type) and issubclass(value, Code):
            family = value
            own = not (is_dataclass(family) and "axis" in {one.name for one in fields(family)})
            each = [{}] if own else [{"axis": axis} for axis in self.axes]
            value = self.made(lambda panel: [family(**axis) for axis in each])
        elif callable(value) and not isinstance(value, Code | PatternSequence):
            value = self.made(value)
        if isinstance(value, PatternSequence):
            return self.fitting(value, self.where), own
        codes = [value] if isinstance(value, Code) else value
        if not (isinstance(codes, list | tuple) and all(isinstance(one, Code) for one in codes)):
            raise InputError(self.where, _OBJECTS, type(value).__name__)
        return PatternSequence(self.panel, tuple(codes)), own

    def made(self, function: Callable[[Panel], Any]) -> Any:
        """Return what a function makes for the panel."""
        try:
            return function(self.panel)
        except InputError:
            raise
        except (Exception, SystemExit) as error:  # foreign code may fail in any way
            expected = "a function that takes the panel, (width, height), and runs"
            raise InputError(self.where, expected, repr(error)) from error

    def fitting(self, sequence: PatternSequence, where: str) -> PatternSequence:
        """Return a sequence that is for the panel, refuse another."""
        if not self.keep_panel and tuple(sequence.panel) != tuple(self.panel):
            width, height = sequence.panel
            expected = f"patterns for the panel's {self.panel[0]} x {self.panel[1]} px"
            raise InputError(where, expected, f"{width} x {height} px")
        return sequence


def in_words(text: str) -> bool:
    """Return whether a text is short text, on a panel that is large enough for it."""
    try:
        PatternSequence.parse(text, _LARGE)
    except InputError:
        return False
    return True


def object_name(text: str) -> str:
    """Return what to call ``module:object`` in tables: without the path and ``.py`` of a file."""
    module, _, name = text.rpartition(":")
    return f"{Path(module).stem if module.lower().endswith('.py') else module}:{name}"


def _leads_somewhere(text: str, folder: Path | None) -> bool:
    """Return whether what is no short text is a folder, or a path into one that there is."""
    path = Path(text).expanduser() if folder is None else folder / text
    return path.is_dir() or (("/" in text or "\\" in text) and path.parent.is_dir())


def _check_registered(code: Code, where: str) -> None:
    """Refuse a code that could not be read back from a capture of it."""
    kind, family = getattr(code, "kind", None), type(code)
    if kind not in pattern_codes or pattern_codes.get(kind) is not family:
        expected = f'a registered code: @pattern_codes.register("{kind}") above its class'
        raise InputError(where, expected, f"{family.__name__}, which is not")
