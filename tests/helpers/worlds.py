"""Rigs that stand in another world, as a calibration of its own leaves them."""

from dataclasses import replace

from slbench.rig import Pose, Rig


def in_another_world(rig: Rig, motion: Pose) -> Rig:
    """Return a rig in the world that a motion (its ``to_world``) takes this one's to."""

    def placed(device):
        own = device.pose
        pose = Pose(motion.rotation @ own.rotation, motion.to_world(own.position))
        return replace(device, pose=pose)

    return rig.having(**{name: placed(device) for name, device in rig.devices.items()})
