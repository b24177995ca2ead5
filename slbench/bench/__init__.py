"""The bench: the thesis's experiments re-run, pattern sets compared, claims checked."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
