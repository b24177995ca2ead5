"""The simulated instrument beside the real one: its twin, and the calibration experiment."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
