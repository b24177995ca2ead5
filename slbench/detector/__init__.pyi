"""The public names of :mod:`slbench.detector` and where they are defined."""

from .base import DetectorModel as DetectorModel
from .base import detectors as detectors
from .emva1288 import Detector as Detector
