"""Captures of several cameras and projectors, a pair each, and the folder that holds them.

Keys at the top of its ``capture.toml`` hold for all pairs; each pair has a table with what is its
own, its frames at the least::

    format = 1
    bit_depth = 8
    rig = "rig.yaml"                 # of all devices, by name

    [patterns]
    panel = [640, 480]
    parts = [{ kind = "fringes", count = 1, shifts = 3 }, { kind = "fringes", count = 10 }]

    [[pairs]]
    camera = "left"
    projector = "main"               # may be left out where the rig has one
    frames = "left/*.png"

    [[pairs]]
    camera = "right"
    frames = "right/*.png"
    exposure_ms = 12.0

In the place of frames a pair may have ``folder = "left-main"``, a capture with a manifest of its
own.  So :meth:`Captures.save` writes them: every folder is a whole capture too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from slbench.capture.capture import MANIFEST, Capture, CaptureTable, manifest_path
from slbench.capture.reading import allowed
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import OutputFolder, read_toml, write_toml
from slbench.core.registry import quoted
from slbench.core.show.display import block
from slbench.core.validation.types import Word
from slbench.core.validation.values import Value, validated
from slbench.rig import ALONE, Pair, Rig
from slbench.rig.opencv import read_rig, write_rig

RIG = "rig.yaml"
_FORMAT = 1
#: Names that are parts of a folder's.
_NAME = re.compile(r"[A-Za-z0-9_-]+")
#: Pairs that a ``repr`` has lines for.
_SHOWN = 4
#: Keys of the whole that are no pair's.
_WHOLE = ("pairs", "rig")


@dataclass(frozen=True, kw_only=True)
class FolderTable(Value):
    """The keys of a pair of a ``capture.toml`` that is a capture of its own."""

    camera: Word
    projector: Word | None = None
    folder: str


@dataclass(frozen=True, eq=False)
class Captures:
    """What the cameras of a rig saw of its projectors' patterns, a capture a pair.

    Parameters
    ----------
    captures : mapping of Pair to Capture
        At least one.  Cameras have one size of frames, projectors one size of panel.
    rig : Rig or None
        All devices, where they are known: the pairs' own rigs are parts of it.  One without
        projectors is of cameras that measure with a projector that nobody calibrated.
    """

    captures: Mapping[Pair, Capture]
    rig: Rig | None = None

    def __post_init__(self) -> None:
        if not self.captures:
            raise InputError("captures", "at least one pair", "none")
        sizes: dict[str, tuple[Any, str]] = {}
        for pair, capture in self.captures.items():
            name = pair_name(pair)
            if self.rig is not None:
                check_known(pair, self.rig)
            rows, columns = capture.frames.shape[1:]
            if self.rig is not None:
                camera = self.rig.cameras[pair.camera]
                sizes.setdefault(pair.camera, ((camera.width, camera.height), "the rig"))
            for device, what, size in (
                (pair.camera, "frames", (columns, rows)),
                (pair.projector, "patterns.panel", capture.sequence.panel),
            ):
                known, of = sizes.setdefault(device, (tuple(size), name))
                if tuple(size) != known:
                    expected = f"{known[0]} x {known[1]} px, as {of} has"
                    raise InputError(f"{name}: {what}", expected, f"{size[0]} x {size[1]} px")

    def __getitem__(self, pair: Pair) -> Capture:
        if pair not in self.captures:
            names = [pair_name(one) for one in self.captures]
            expected = f"a captured pair: {', '.join(names)}"
            raise InputError("pair", expected, quoted(pair_name(pair), names))
        return self.captures[pair]

    def __len__(self) -> int:
        return len(self.captures)

    def __iter__(self) -> Iterator[Pair]:
        return iter(self.captures)

    def __repr__(self) -> str:
        return block(
            f"Captures of {len(self)} pairs, known: {'rig' if self.rig else 'no rig'}",
            *(
                f"{pair_name(pair)}: {one.frames.shape[0]} frames "
                f"{one.frames.shape[2]} x {one.frames.shape[1]} px, {{{one.sequence.name}}}"
                for pair, one in list(self.captures.items())[:_SHOWN]
            ),
            f"and {len(self) - _SHOWN} more" if len(self) > _SHOWN else "",
        )

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of their captures."""
        return tuple(dict.fromkeys(pair.camera for pair in self.captures))

    def of(
        self, cameras: Sequence[str] | None = None, projectors: Sequence[str] | None = None
    ) -> Captures:
        """Return the captures of some cameras and projectors, in the order of their names.

        Raises
        ------
        InputError
            For a name that none has, and where no pair is left.
        """
        chosen = list(self.captures)
        for k, (role, names) in enumerate((("cameras", cameras), ("projectors", projectors))):
            known = list(dict.fromkeys(pair[k] for pair in self.captures))
            for name in names or ():
                if name not in known:
                    raise InputError(role, f"of {', '.join(known)}", quoted(name, known))
            if names is not None:
                chosen = [pair for name in names for pair in chosen if pair[k] == name]
        if not chosen:
            wanted = " and ".join(", ".join(names) for names in (cameras, projectors) if names)
            raise InputError("pairs", "at least one that was captured", f"none of {wanted}")
        return Captures({pair: self.captures[pair] for pair in chosen}, self.rig)

    def with_rig(self, rig: Rig) -> Captures:
        """Return the captures with another rig of all devices."""
        for pair in self.captures:
            check_known(pair, rig)
        own = {
            pair: replace(capture, rig=_rig_of(rig, pair), rig_covariance=None)
            for pair, capture in self.captures.items()
        }
        return Captures(own, rig)

    def save(self, folder: str | Path) -> None:
        """Write a folder a pair, the manifest of them all and the rig; all or nothing.

        Raises
        ------
        InputError
            If what slbench did not write is in the way, or a file cannot be written.
        """
        kind = OutputFolder("captures", (MANIFEST, RIG, *map(pair_name, self.captures)))
        with kind.writing(folder, {"pairs": [pair_name(pair) for pair in self]}, None) as made:
            self.write_into(made)

    def write_into(self, folder: str | Path) -> None:
        """Write them as part of a folder that is being made.

        Raises
        ------
        InputError
            For names that cannot be parts of a folder's.
        """
        root = Path(folder)
        names = folder_names(self.captures)
        for pair, capture in self.captures.items():
            capture.write_into(root / names[pair])
        manifest: dict[str, Any] = {"format": _FORMAT}
        if self.rig is not None:
            write_rig(root / RIG, self.rig)
            manifest["rig"] = RIG
        manifest["pairs"] = [pair._asdict() | {"folder": name} for pair, name in names.items()]
        write_toml(root / MANIFEST, manifest)

    @classmethod
    def load(
        cls, folder: str | Path, *, allow_modules: bool = False, allow_outside: bool = False
    ) -> Captures:
        """Read a folder of captures; one of a single pair makes captures of one.

        Parameters
        ----------
        folder : path
        allow_modules, allow_outside : bool
            As :meth:`Capture.load` has them.

        Raises
        ------
        InputError
            As :meth:`Capture.load`; and for names that the rig does not know, pairs that stand
            there twice, and sizes that differ.

        Warns
        -----
        InputWarning
            Where the rig has cameras or projectors that nothing was captured of, and where a pair's
            own rig or its covariance is not used.
        """
        path = manifest_path(folder)
        manifest = read_toml(path)
        how = {"allow_modules": allow_modules, "allow_outside": allow_outside}
        if "pairs" not in manifest:
            one = Capture.of_manifest(path, manifest, **how)  # type: ignore[arg-type]
            return cls({one.pair: one}, one.rig)
        common = {key: value for key, value in manifest.items() if key not in _WHOLE}
        keys = [field.name for field in fields(CaptureTable)]
        for key in common:
            if key not in keys or key in ALONE._fields:
                raise InputError(f"{path}: {key}", f"one of {', '.join(keys)}", quoted(key, keys))
        tables = manifest["pairs"]
        tabular = isinstance(tables, list) and all(isinstance(one, dict) for one in tables)
        if not tabular or not tables:
            expected = "a table [[pairs]] for every camera and projector"
            raise InputError(f"{path}: pairs", expected, repr(tables)[:60])
        rig = None
        if (name := manifest.get("rig")) is not None:
            if not isinstance(name, str):
                raise InputError(f"{path}: rig", "a file", repr(name))
            with located(path):
                rig = read_rig(allowed(path.parent, name, allow_outside))
        captures: dict[Pair, Capture] = {}
        for k, table in enumerate(tables):
            where = f"{path}: pairs[{k}]"
            pair = _pair_of(table, rig, where)
            if pair in captures:
                raise InputError(where, "each pair once", pair_name(pair))
            if "folder" in table:
                own = _of_folder(path, table, common, where, how)
            else:
                if "rig" in table:
                    expected = "one rig of all devices, at the top of the file"
                    raise InputError(f"{where}.rig", expected, repr(table["rig"]))
                merged = {**common, **table, **pair._asdict()}
                own = Capture.of_manifest(path, merged, where=where, **how)  # type: ignore[arg-type]
            with located(where):
                known = None if rig is None else _rig_of(rig, pair)
                captures[pair] = replace(own, pair=pair, rig=known, rig_covariance=None)
            if rig is None and own.rig is not None:
                doubt = "its own rig is not used: state one of all devices at the top, or --rig"
                warn_user(where, doubt)
            elif own.rig_covariance is not None:
                warn_user(where, "the covariance of its rig is left out: u has no calibration")
        with located(path):
            result = cls(captures, rig)
        _question_missing(path, result)
        return result


def read_captures(
    folder: str | Path, *, allow_modules: bool = False, allow_outside: bool = False
) -> Captures:
    """Read a folder with the captures of several cameras and projectors, or of one pair.

    The function of :meth:`Captures.load`, which says what is raised.
    """
    return Captures.load(folder, allow_modules=allow_modules, allow_outside=allow_outside)


def holds_pairs(folder: str | Path) -> bool:
    """Return whether the manifest of a folder names several pairs."""
    path = manifest_path(folder)
    return path.is_file() and "pairs" in read_toml(path)


def pair_name(pair: Pair) -> str:
    """Return how a pair is called, by people and as a folder: ``left-main``."""
    return "-".join(pair)


def folder_names(pairs: Iterable[Pair]) -> dict[Pair, str]:
    """Return how pairs are called as folders.

    Raises
    ------
    InputError
        For names that cannot be parts of a folder's, and pairs that are called alike.
    """
    names = {pair: pair_name(pair) for pair in pairs}
    for device in (one for pair in names for one in pair):
        if not _NAME.fullmatch(device):
            raise InputError("rig devices", "names of letters, digits, _ and -", repr(device))
    if len(set(names.values())) != len(names):
        expected = "other names: two pairs are alike"
        raise InputError("rig devices", expected, ", ".join(names.values()))
    return names


def check_known(pair: Pair, rig: Rig) -> None:
    """Refuse a pair whose devices a rig does not have; any projector where it has none at all.

    Raises
    ------
    InputError
        With the nearest name.
    """
    for role, name, known in (
        ("camera", pair.camera, rig.cameras),
        ("projector", pair.projector, rig.projectors),
    ):
        if known and name not in known:
            expected = f"a {role} of the rig: {', '.join(known)}"
            raise InputError(role, expected, quoted(name, list(known)))


def _rig_of(rig: Rig, pair: Pair) -> Rig | None:
    return rig.pair(pair) if rig.projectors else None


def _pair_of(table: Mapping[str, Any], rig: Rig | None, where: str) -> Pair:
    """Return the pair of a table; its projector may be the rig's only one."""
    names = list(rig.projectors) if rig is not None else []
    default = names[0] if len(names) == 1 else ALONE.projector
    pair = Pair(table.get("camera", ""), table.get("projector", default))
    for role, name in pair._asdict().items():
        if not isinstance(name, str) or not name:
            raise InputError(f"{where}.{role}", f"the name of a {role}", repr(table.get(role)))
    if rig is not None:
        with located(where):
            check_known(pair, rig)
    return pair


def _of_folder(
    path: Path,
    table: Mapping[str, Any],
    common: Mapping[str, Any],
    where: str,
    how: Mapping[str, bool],
) -> Capture:
    """Return the capture of a pair that has a folder of its own."""
    own = validated(FolderTable, dict(table), where, ".")
    for key in common:
        if key != "format":
            expected = "no keys beside those of the pairs' own folders"
            raise InputError(f"{path}: {key}", expected, key)
    with located(where):
        folder = allowed(path.parent, own.folder, how["allow_outside"])
    if not folder.is_dir():
        raise InputError(f"{where}.folder", "a folder with a capture.toml", own.folder)
    capture = Capture.load(folder, **how)  # type: ignore[arg-type]
    pair = Pair(own.camera, own.projector or capture.pair.projector)
    if capture.pair not in (ALONE, pair):
        expected = f"the capture of {pair_name(pair)}"
        raise InputError(f"{where}.folder", expected, pair_name(capture.pair))
    return capture


def _question_missing(path: Path, captures: Captures) -> None:
    """Question a rig with devices that nothing was captured of."""
    if captures.rig is None:
        return
    seen = {name for pair in captures for name in pair}
    missing = [name for name in captures.rig.devices if name not in seen]
    if missing:
        warn_user(path, f"nothing was captured of {', '.join(missing)}, which the rig has")
