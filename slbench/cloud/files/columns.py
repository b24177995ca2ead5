"""Columns of numbers by the names that programs give them, and what they are of a cloud."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.files.measured import MeasuredCloud
from slbench.core.errors import InputError
from slbench.core.units import MILLIMETRES

Array = NDArray[np.float64]

#: Names of a grey value, and of colours; the weights are those of luma (ITU-R BT.601).
_GREY = ("grey", "gray", "intensity", "luminance", "reflectance")
_COLOURS = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
)
_LUMA = (0.299, 0.587, 0.114)
_NORMALS = (
    ("nx", "ny", "nz"),
    ("normal_x", "normal_y", "normal_z"),
    ("normalx", "normaly", "normalz"),
)
#: Scalars that are lengths in the unit of the file.
LENGTHS = ("sigma", "u", "error")
#: What follows a name in a header: x_mm, x [mm], x (mm), x/mm.
_UNIT = re.compile(r"^(.*?)\s*(?:_|\s|/|\[|\()\s*(um|µm|mm|cm|inch|in|m)\s*[\])]?$", re.IGNORECASE)
_SPELLINGS = {"µm": "um", "in": "inch"}


def plain_name(text: str) -> tuple[str, str | None]:
    """Return the name of a column in lower case, and the unit that it states, if any."""
    name = text.strip().strip('"').removeprefix("//").lstrip("#").strip().lower()
    name = name.removeprefix("scalar_")
    match = _UNIT.match(name)
    if match is None:
        return name, None
    return match[1], _SPELLINGS.get(match[2].lower(), match[2].lower())


def cloud_of(
    columns: Mapping[str, NDArray[Any]], source: object, unit: str | None, usual: str = "mm"
) -> MeasuredCloud:
    """Return the cloud that named columns are.

    Parameters
    ----------
    columns : mapping of str to (N,) array
        ``x``, ``y``, ``z``, and what there is besides.
    source : object
        The file, for messages.
    unit : str or None
        What the user says the unit is.
    usual : str
        The unit otherwise, where no name states one.

    Raises
    ------
    InputError
        Without coordinates or points, and where the names state another unit than the user.
    """
    named: dict[str, NDArray[Any]] = {}
    stated: dict[str, str] = {}
    for text, values in columns.items():
        name, own = plain_name(text)
        if name in named:  # x and X, sigma and scalar_sigma: the first one has the name
            name = text
        named[name] = values
        if own is not None:
            stated[name] = own
    if missing := [axis for axis in "xyz" if axis not in named]:
        have = ", ".join(columns) or "none"
        raise InputError(source, "columns or properties x, y, z", f"{have} (no {missing[0]})")
    used = _unit_of({axis: stated.get(axis) for axis in "xyz"}, source, unit, usual)
    scale = MILLIMETRES[used["x"]]
    several = len(set(used.values())) > 1
    points = np.stack(
        [MILLIMETRES[used[axis]] * np.asarray(named.pop(axis), np.float64) for axis in "xyz"],
        axis=1,
    )
    if "v" in named and "u" in named:  # pixels or texture coordinates, no uncertainty
        named["pixel_u"], named["pixel_v"] = named.pop("u"), named.pop("v")
    normals = _normals(named)
    grey = _grey(named)
    scalars = {}
    for name, values in named.items():
        if several and name in LENGTHS and name not in stated:
            expected = f"the unit of {name} in its name ({name}_mm), as coordinates have several"
            raise InputError(source, expected, f"{name!r}")
        own_scale = MILLIMETRES[stated[name]] if name in stated else scale
        scalars[name] = np.asarray(values, np.float64) * (own_scale if name in LENGTHS else 1.0)
    own_unit = "mm" if several else used["x"]
    known = MeasuredCloud(points, normals, grey, scalars, unit=own_unit, source=str(source))
    return finite_cloud(known)


def _unit_of(
    stated: Mapping[str, str | None], source: object, unit: str | None, usual: str
) -> dict[str, str]:
    """Return the unit of each coordinate; what some state and others do not must be no other."""
    written = [own for own in stated.values() if own is not None]
    words = ", ".join(
        f"{axis} in {own}" if own else f"{axis} in none" for axis, own in stated.items()
    )
    for own in written:
        if unit is not None and unit != own:
            said = own if len(set(written)) == 1 else words
            raise InputError(source, f"coordinates in {said}, as the header says", f"--unit {unit}")
    if len(written) == len(stated):
        return {axis: own or usual for axis, own in stated.items()}
    used = unit or usual
    if any(own != used for own in written):
        raise InputError(source, "a header that states the unit of x, y and z, or of none", words)
    return dict.fromkeys(stated, used)


def finite_cloud(cloud: MeasuredCloud) -> MeasuredCloud:
    """Return a cloud without the points that are not finite.

    Raises
    ------
    InputError
        If none is.
    """
    kept: NDArray[np.bool_] = np.isfinite(cloud.points.sum(axis=1))
    count, given = int(np.count_nonzero(kept)), len(cloud)
    if count == 0:
        raise InputError(cloud.source, "a cloud with finite points", f"{given}, none finite")
    return cloud if count == given else replace(cloud.chosen(kept), dropped=given - count)


def _normals(named: dict[str, NDArray[Any]]) -> Array | None:
    """Take the normals out of the columns; those that are no directions become NaN."""
    for names in _NORMALS:
        if all(name in named for name in names):
            normals = np.stack([np.asarray(named.pop(name), np.float64) for name in names], axis=1)
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            with np.errstate(invalid="ignore", divide="ignore"):
                normals /= length
            normals[~np.isfinite(normals).all(axis=1)] = np.nan
            return normals
    return None


def _grey(named: dict[str, NDArray[Any]]) -> Array | None:
    """Take grey values, or the luma of colours, out of the columns."""
    found: Array | None = None
    for names in _COLOURS:
        if all(name in named for name in names):
            colours = [np.asarray(named.pop(name), np.float64) for name in names]
            found = np.dot(_LUMA, colours)
            named.pop("alpha", None)
            break
    for name in _GREY:
        if name in named:
            found = np.asarray(named.pop(name), np.float64)
            break
    return found
