"""Calibration: detect a target, re-map it to the panel, fit models of the scanner."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
