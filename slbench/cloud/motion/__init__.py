"""Motion between the frames of a capture: taken out where it is known, and estimated."""

from slbench.cloud.motion.at_rest import AtRest, at_rest
from slbench.cloud.motion.estimate import EstimatedMotion, estimated_motion

__all__ = ["AtRest", "EstimatedMotion", "at_rest", "estimated_motion"]
