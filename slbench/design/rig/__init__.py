"""Rig design (thesis chapter 3): where camera and projector should stand."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
