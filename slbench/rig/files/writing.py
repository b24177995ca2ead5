"""Rigs in the files of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slbench.core.errors import InputError, warn_user
from slbench.core.io.atomic import check_output_file, write_bytes
from slbench.core.registry import quoted
from slbench.rig.device import Device
from slbench.rig.files.base import CalibratedDevice, Calibration
from slbench.rig.files.registry import rig_formats
from slbench.rig.rig import Rig


def written_formats() -> list[str]:
    """Return the names of the formats that are written."""
    return [name for name in rig_formats if rig_formats.get(name).suffixes]


def write_calibration(path: Path, rig: Rig, name: str) -> list[Path]:
    """Write a rig in a format of another program.

    Parameters
    ----------
    path : Path
        The file, or what the names of several are made of.
    rig : Rig
        One camera and one projector.
    name : str
        Of the format (:func:`written_formats`).

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        For a format that is not written, another suffix, and a lens that the format has no words
        for.

    Warns
    -----
    InputWarning
        Where the world is not the camera's frame, in which calibrations are.
    """
    names = written_formats()
    if name not in names:
        raise InputError("--to", f"one of {', '.join(names)}", quoted(name, names))
    one = rig_formats.get(name)
    check_output_file(path, one.suffixes, "the last file")
    contents = one.contents(calibration_of(rig), path)
    for file in contents:
        check_output_file(file, (), "the last file")
    pose = rig.camera.pose
    if np.any(pose.position) or np.any(pose.rotation != np.eye(3)):
        warn_user(path, "has no word for the world: points are in the camera's frame")
    for file, content in contents.items():
        write_bytes(file, content)
    return list(contents)


def calibration_of(rig: Rig) -> Calibration:
    """Return what calibrations say of a rig: in mm, in the camera's frame.

    Raises
    ------
    InputError
        For a telecentric lens, which they have not.
    """
    camera, projector = rig.camera, rig.projector
    return Calibration(
        first=_device(camera, "camera"),
        second=_device(projector, "projector"),
        rotation=projector.pose.rotation.T @ camera.pose.rotation,
        translation=projector.pose.to_local(camera.pose.position),
        unit="mm",
    )


def _device(device: Device, name: str) -> CalibratedDevice:
    if device.lens.kind != "perspective":
        raise InputError(
            f"the {name}", "a perspective lens, as calibrations have", device.lens.kind
        )
    return CalibratedDevice(
        name=name,
        matrix=device.matrix,
        distortion=device.opencv_distortion,
        size=(device.width, device.height),
    )
