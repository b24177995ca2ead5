"""The public names of :mod:`slbench.detector` and where they are defined."""

from .emva1288 import Detector as Detector
from .emva1288 import expose as expose
