"""The public names of :mod:`slbench.simulate` and where they are defined."""

from . import render as render
from .colour import ColourTransport as ColourTransport
from .expose import capture as capture
from .expose import shutter_for as shutter_for
from .folder import write_scan as write_scan
from .render.groundtruth import ground_truth as ground_truth
from .render.trace import trace as trace
from .scan import Scan as Scan
from .scan import score_scan as score_scan
from .several.folder import write_rig_scan as write_rig_scan
from .several.scan import RigScan as RigScan
from .several.scan import scan_rig as scan_rig
from .stack import capture_stack as capture_stack
from .stack import traced as traced
from .transport import LightTransport as LightTransport
