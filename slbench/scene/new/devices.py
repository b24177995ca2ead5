"""``[camera]`` and ``[projector]`` of a new scene: what is stated beside hardware files."""

from __future__ import annotations

from dataclasses import dataclass

from slbench.core.errors import InputError
from slbench.core.validation.types import Coordinate, Measure
from slbench.core.validation.values import Value, validated
from slbench.scene.devices.optics import CameraOptics, ProjectorOptics
from slbench.scene.new.entries import Entry, values_of
from slbench.scene.new.hardware import HardwareFile

#: f-numbers of lenses where nobody states one.
_CAMERA_F_NUMBER, _PROJECTOR_F_NUMBER = 4.0, 2.4
_GREEN_NM = 550.0
#: Keys of which a table states one.
_LENSES = ("focal_length_mm", "lens_mm", "throw_ratio", "magnification")
_APERTURES = ("f_number", "lens_f_number", "aperture_radius_mm", "numerical_aperture")
_AXES = ("principal_point_px", "offset_percent", "lens_shift_percent")


@dataclass(frozen=True, kw_only=True)
class Lenses(Value):
    """What data sheets of lenses state; None is what the hardware files have.

    Parameters
    ----------
    lens_mm, f_number : float or None
        Of the camera's: focal length, and the f-number engraved on it.
    throw_ratio, projector_f_number, offset_percent : float or None
        Of the projector's.
    """

    lens_mm: Measure | None = None
    f_number: Measure | None = None
    throw_ratio: Measure | None = None
    projector_f_number: Measure | None = None
    offset_percent: Coordinate | None = None


def has_lens(file: HardwareFile, role: str) -> bool:
    """Return whether a hardware file states a lens."""
    return any(key in file.content[role] for key in _LENSES)


def camera_table(
    file: HardwareFile, lenses: Lenses, focus_mm: float
) -> tuple[list[Entry], CameraOptics]:
    """Return the lines of ``[camera]``, and the table that they make with the file's.

    Raises
    ------
    InputError
        For what is missing, or stated in two ways, naming the option.
    """
    entries = [
        _either(file, "camera", _LENSES, "lens_mm", lenses.lens_mm, "--lens-mm"),
        _aperture(file, "camera", lenses.f_number, "--f-number", _CAMERA_F_NUMBER),
        Entry("focus_distance_mm", focus_mm, "--focus-mm, from the lens"),
        *_assumed(file, "camera", "wavelength_nm", _GREEN_NM, "green, of diffraction"),
    ]
    table = {**file.content["camera"], **values_of(entries)}
    optics = validated(CameraOptics, table, f"{file.name}: camera")
    try:
        lens = optics.arguments(focus_mm)["lens"]
    except InputError as error:
        raise InputError("--focus-mm", error.expected, error.got) from None
    found = f"derived: principal distance {lens.focal_length_mm:.5g} mm, f d / (d - f)"
    if optics.lens_mm is not None:
        entries.insert(1, Entry("", None, f"{found}; magnification {lens.magnification:.4g}"))
    return entries, optics


def projector_table(
    file: HardwareFile, lenses: Lenses, distance_mm: float
) -> tuple[list[Entry], ProjectorOptics]:
    """Return the lines of ``[projector]``, and the table that they make with the file's.

    Raises
    ------
    InputError
        For what is missing, or stated in two ways, naming the option.
    """
    entries = [
        _either(file, "projector", _LENSES, "throw_ratio", lenses.throw_ratio, "--throw-ratio"),
        _aperture(
            file,
            "projector",
            lenses.projector_f_number,
            "--projector-f-number",
            _PROJECTOR_F_NUMBER,
        ),
        *_assumed(file, "projector", "wavelength_nm", _GREEN_NM, "green, of diffraction"),
        *_assumed(file, "projector", "blur_px", 1.0, "no lens keeps a panel's pixels square"),
    ]
    if lenses.offset_percent is not None:
        option, value = "--offset-percent", lenses.offset_percent
        entries.append(_either(file, "projector", _AXES, "offset_percent", value, option))
    table = {**file.content["projector"], **values_of(entries)}
    optics = validated(ProjectorOptics, table, f"{file.name}: projector")
    c = optics.arguments(distance_mm)["lens"].focal_length_mm
    width = 1e-3 * optics.resolution_px[0] * optics.pitches_um[0]
    found = f"derived: principal distance {c:.5g} mm, of a panel {width:.5g} mm wide"
    entries.insert(1, Entry("", None, found))
    return entries, optics


def _assumed(file: HardwareFile, role: str, key: str, value: float, why: str) -> list[Entry]:
    """Return the line of what nobody states; none where the file does."""
    return [] if key in file.content[role] else [Entry(key, value, f"assumed: {why}")]


def _either(
    file: HardwareFile,
    role: str,
    keys: tuple[str, ...],
    key: str,
    value: float | None,
    option: str,
) -> Entry:
    """Return the line of a key that an option states, or which the file has."""
    table = file.content[role]
    stated = [name for name in keys if name in table]
    if value is None:
        if not stated:
            raise InputError(option, f"a number, as {file.name} has none", "none")
        doubt = ", not confirmed" if f"{role}.{stated[0]}" in file.unconfirmed else ""
        return Entry("", None, f"{stated[0]} = {table[stated[0]]}: {file.name}{doubt}")
    others = [name for name in stated if name != key]
    if others:
        raise InputError(option, f"none, as {file.name} states {others[0]}", f"{value:g}")
    instead = f", in place of {table[key]} of {file.name}" if key in table else ""
    return Entry(key, value, f"{option}{instead}")


def _aperture(
    file: HardwareFile, role: str, value: float | None, option: str, usual: float
) -> Entry:
    # A telecentric lens has a numerical aperture, or is a pinhole.
    keys = (*_APERTURES, "magnification")
    if value is None and not any(key in file.content[role] for key in keys):
        return Entry("lens_f_number", usual, f"assumed: {option} states it")
    return _either(file, role, keys, "lens_f_number", value, option)
