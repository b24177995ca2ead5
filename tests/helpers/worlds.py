"""Rigs that stand in another world, as a calibration of its own leaves them."""

from slbench.rig import Pose, Rig


def in_another_world(rig: Rig, motion: Pose) -> Rig:
    """Return a rig in the world that a motion (its ``to_world``) takes this one's to."""

    def moved(own):
        return Pose(motion.rotation @ own.rotation, motion.to_world(own.position))

    return rig.having(**{name: one.posed(moved(one.pose)) for name, one in rig.devices.items()})
