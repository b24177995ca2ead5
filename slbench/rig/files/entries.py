"""Entries of a rig's file: our own as they stand, and those of other programs in their place.

What a calibration does not say (a unit, the size of a panel, which device is the projector) is
asked for, all at once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.units import MILLIMETRES
from slbench.rig.files.base import Calibration, refuse_other_lenses
from slbench.rig.files.registry import format_of, rig_formats
from slbench.rig.files.source import Source
from slbench.rig.pose import checked_rotation

Order = Literal["camera-projector", "projector-camera", "camera-camera"]
#: Two cameras are never guessed.
_ORDERS: tuple[Order, ...] = ("camera-projector", "projector-camera")
_CAMERAS: Order = "camera-camera"
#: What two cameras are called whose names are none that entries can have.
_LEFT_RIGHT = ("left", "right")
#: Of our own files: either is theirs.
_OWN = ("K_camera", "K_projector")
#: Of our own files of several devices: a text of names.
_NAMES = "cameras"
#: The entry of a device that was calibrated alone: which it is.
DEVICE = "device"
#: Entries of an unknown file that a refusal names.
_MOST = 6


@dataclass(frozen=True, kw_only=True)
class Stated:
    """What a person states beside a calibration, in place of what it says or does not say.

    Parameters
    ----------
    unit : str or None
        Of lengths in it: "um", "mm", "cm", "inch" or "m".
    sizes_px : mapping of str to (int, int)
        Width and height by device, "camera" and "projector".
    pitches_um : mapping of str to float
        Pixel pitch by device.
    order : "camera-projector", "projector-camera", "camera-camera" or None
        What the file's first and second device are, where their names do not tell.
    first_pixel : int or None
        Coordinates of the centre of the top left pixel, 0 or 1, where not the format's own.
    """

    unit: str | None = None
    sizes_px: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    pitches_um: Mapping[str, float] = field(default_factory=dict)
    order: Order | None = None
    first_pixel: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Entries:
    """The entries of our own file of a rig, whatever file they come from.

    Parameters
    ----------
    path : Path
        The first file.
    values : mapping of str to ndarray, float, int, str or OtherEntry
    places : mapping of str to str
        Where an entry stands, where that is not under its own name in `path`.
    format : str
        "slbench", or a name of :data:`~slbench.rig.files.registry.rig_formats`.
    """

    path: Path
    values: Mapping[str, Any]
    places: Mapping[str, str] = field(default_factory=dict)
    format: str = "slbench"

    def beside(self, values: Mapping[str, Any], where: str) -> Entries:
        """Return the entries with others in their place that stand elsewhere, `where`."""
        places = {key: f"{where}: {key}" for key in values}
        return replace(self, values={**self.values, **values}, places={**self.places, **places})

    def place(self, key: str) -> str:
        """Return where an entry stands, for messages."""
        return self.places.get(key, f"{self.path}: {key}")


def is_own(path: str | Path) -> bool:
    """Return whether a file is a rig's of slbench's own."""
    return _is_own(Source(path))


def _is_own(source: Source) -> bool:
    return isinstance(source.storage.get(_NAMES), str) or any(key in source.storage for key in _OWN)


def rig_entries(paths: str | Path | Sequence[str | Path], stated: Stated | None = None) -> Entries:
    """Read the entries of a rig, from our own file or from a calibration of another program.

    Parameters
    ----------
    paths : path, or sequence of paths
        More than one where a program writes several.
    stated : Stated, optional

    Raises
    ------
    InputError
        For files of no known format, and where something is missing that nobody states.
    """
    given = [paths] if isinstance(paths, str | Path) else list(paths)
    sources = [Source(path) for path in given]
    stated = stated or Stated()
    if len(sources) == 1 and _is_own(sources[0]):
        if stated != Stated():
            expected = "no unit, size, pitch, order or first pixel beside a file of slbench's own"
            raise InputError(sources[0].path, expected, "some of them")
        if alone := sources[0].storage.get(DEVICE):
            made = f"slbench calibrate combine {sources[0].path.name} projector.yaml FOLDER ..."
            raise InputError(
                sources[0].path, f"a rig; `{made}` makes one of it", f"a {alone} alone"
            )
        refuse_other_lenses(sources)
        return Entries(path=sources[0].path, values=sources[0].storage)
    name = format_of(sources)
    if name is None:
        raise InputError(sources[0].path, f"a rig: ours; {_titles()}", _described(sources))
    return _translated(rig_formats.get(name).read(sources), stated, sources[0].path, name)


def _titles() -> str:
    return "; ".join(rig_formats.get(name).title for name in rig_formats)


def _described(sources: Sequence[Source]) -> str:
    keys = [str(key) for one in sources for key in (one.arrays or one.yaml)]
    more = " ..." if len(keys) > _MOST else ""
    return f"entries {', '.join(keys[:_MOST])}{more}" if keys else "none of them"


def _translated(found: Calibration, stated: Stated, path: Path, name: str) -> Entries:
    order = _order(found, stated, path)
    unit = stated.unit or found.unit
    if unit is not None and unit not in MILLIMETRES:
        raise InputError("unit", " or ".join(MILLIMETRES), quoted(unit, list(MILLIMETRES)))
    both = order == _CAMERAS
    roles = _camera_names(found) if both else (order or _ORDERS[0]).split("-")
    devices = dict(zip(roles, (found.first, found.second), strict=True))
    # What is stated of "the camera" is of both.
    stated_as = {role: "camera" if both else role for role in devices}
    sizes = {role: stated.sizes_px.get(stated_as[role], one.size) for role, one in devices.items()}
    _ask(path, found, unit, {stated_as[role]: size for role, size in sizes.items()}, order)
    rotation = checked_rotation(found.rotation, found.places.get("R", f"{path}: R"))
    if not np.isfinite(found.translation).all():
        expected = "three finite numbers"
        raise InputError(found.places.get("T", path), expected, found.translation.tolist())
    translation = found.translation * MILLIMETRES[unit or "mm"]
    if order == "projector-camera":
        rotation, translation = rotation.T, -rotation.T @ translation
    first_pixel = found.first_pixel if stated.first_pixel is None else stated.first_pixel
    of_second = f"_{roles[1]}" if both else ""
    values: dict[str, Any] = {f"R{of_second}": rotation, f"T{of_second}": translation}
    if both:
        values[_NAMES] = " ".join(roles)
    places = {f"{key}{of_second}": found.places[key] for key in "RT" if key in found.places}
    for role, one in devices.items():
        matrix = np.array(one.matrix, dtype=np.float64)
        matrix[:2, 2] -= first_pixel
        values[f"K_{role}"] = matrix
        values[f"size_{role}"] = np.array(sizes[role], dtype=np.float64)
        if one.distortion.size:
            values[f"dist_{role}"] = one.distortion
        if stated_as[role] in stated.pitches_um:
            values[f"pitch_um_{role}"] = np.full(2, stated.pitches_um[stated_as[role]])
        places |= {f"{key}_{role}": place for key, place in one.places.items()}
    return Entries(path=path, values=values, places=places, format=name)


def _camera_names(found: Calibration) -> list[str]:
    """Return what two cameras are called: as the file does, where entries can have such names."""
    names = [found.first.name, found.second.name]
    usable = len(set(names)) == 2 and all(
        re.fullmatch(r"[A-Za-z0-9_-]*[A-Za-z][A-Za-z0-9_-]*", n) for n in names
    )
    return names if usable else list(_LEFT_RIGHT)


def _order(found: Calibration, stated: Stated, path: Path) -> Order | None:
    """Return which device is which: as their names tell, or as a person states."""
    first, second = found.first.role, found.second.role
    told = [
        order
        for order in _ORDERS
        for one, two in [order.split("-")]
        if first != second and first in (one, None) and second in (two, None)
    ]
    if len(told) != 1 or (stated.order == _CAMERAS and "projector" not in (first, second)):
        return stated.order
    if stated.order not in (None, told[0]):
        names = f"the first device is named {found.first.name}, the second {found.second.name}"
        raise InputError(f"{path}: order", f"{told[0]}, as {names}", stated.order)
    return told[0]


def _ask(
    path: Path,
    found: Calibration,
    unit: str | None,
    sizes: Mapping[str, tuple[float, float] | None],
    order: Order | None,
) -> None:
    """Ask for all that is missing, by the options of ``slbench rig convert``."""
    missing = []
    if unit is None:
        length = float(np.linalg.norm(found.translation))
        missing.append(f"--unit {'|'.join(MILLIMETRES)} (T is {length:.4g} long)")
    if order is None:
        names = f"the devices are {found.first.name!r} and {found.second.name!r}"
        missing.append(f"--order {'|'.join((*_ORDERS, _CAMERAS))} ({names})")
    missing += [f"--size-{role} WIDTHxHEIGHT" for role, size in sizes.items() if size is None]
    if missing:
        what = "what the file does not say, with slbench rig convert"
        raise InputError(path, f"{what}: {', '.join(missing)}", "none of it")
