"""Focus fusion: one all-in-focus image from frames taken at different focus positions.

Thesis 5.1.1 and 5.4.2: the weights come from one stack, the fully lit one, and fuse every
other stack of the same focus positions, so that all fringe patterns are fused alike.  A stack
is any sequence of images that are read one at a time; this package knows arrays and files
only, not what was projected.
"""

from slbench.capture.fusion.align import Alignment, align
from slbench.capture.fusion.folder import Photographs
from slbench.capture.fusion.measures import focus_measure, focus_measures
from slbench.capture.fusion.pyramid import PyramidSelection, pyramid_selection
from slbench.capture.fusion.selective import (
    FusionWeights,
    maximum_weights,
    selective_weights,
)
from slbench.capture.fusion.stack import Stack

__all__ = [
    "Alignment",
    "FusionWeights",
    "Photographs",
    "PyramidSelection",
    "Stack",
    "align",
    "focus_measure",
    "focus_measures",
    "maximum_weights",
    "pyramid_selection",
    "selective_weights",
]
