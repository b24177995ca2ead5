"""The public names of :mod:`slbench.capture` and where they are defined."""

from . import fusion as fusion
from .capture import Capture as Capture
from .capture import read_capture as read_capture
from .captures import Captures as Captures
from .captures import read_captures as read_captures
from .focus import Focus as Focus
from .stack import FocusStack as FocusStack
from .stack import FusedCapture as FusedCapture
from .stack import modulation_weights as modulation_weights
from .stack import read_stack as read_stack
