"""Formats of rigs that other programs write, in the order in which they are tried."""

from __future__ import annotations

from collections.abc import Sequence

from slbench.core.registry import Registry
from slbench.rig.files.base import RigFormat
from slbench.rig.files.source import Source

#: Named ones before OpenCV's, which takes any usual names.
rig_formats: Registry[RigFormat] = Registry(
    "format of rigs",
    "slbench.rig_formats",
    {
        "slstudio": "slbench.rig.files.programs:SLSTUDIO",
        "moreno-taubin": "slbench.rig.files.programs:MORENO_TAUBIN",
        "slmaster": "slbench.rig.files.programs:SLMASTER",
        "mrcal": "slbench.rig.files.mrcal:MRCAL",
        "ros": "slbench.rig.files.ros:ROS",
        "bouguet": "slbench.rig.files.bouguet:BOUGUET",
        "matlab": "slbench.rig.files.matlab:MATLAB",
        "opencv": "slbench.rig.files.matrices:OPENCV",
    },
    "slbench.rig.files.base:RigFormat",
)


def format_of(sources: Sequence[Source]) -> str | None:
    """Return the name of the first format that recognises the files."""
    for name in rig_formats:
        if rig_formats.get(name).recognises(sources):
            return name
    return None
