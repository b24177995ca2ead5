"""Optics, cameras, projectors and rigs."""

from slbench.rig.device import Camera, Device, Projector
from slbench.rig.optics.lens import Lens
from slbench.rig.pose import Pose, box_corners
from slbench.rig.rig import ALONE, VOLUME_MM, DesignVariables, Pair, Rig, rotation_yx

__all__ = [
    "ALONE",
    "VOLUME_MM",
    "Camera",
    "DesignVariables",
    "Device",
    "Lens",
    "Pair",
    "Pose",
    "Projector",
    "Rig",
    "box_corners",
    "rotation_yx",
]
