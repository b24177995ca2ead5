"""The public names of :mod:`slbench.simulate` and where they are defined."""

from . import render as render
from .expose import capture as capture
from .expose import exposure as exposure
from .folder import write_scan as write_scan
from .render.groundtruth import ground_truth as ground_truth
from .render.trace import trace as trace
from .scan import Scan as Scan
from .transport import LightTransport as LightTransport
