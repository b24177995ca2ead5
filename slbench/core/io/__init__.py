"""Low-level files: EXR, PNG, PLY, NPZ, CSV, JSON, TOML, OpenCV YAML, and provenance.

One reader and one writer a format, each a thin layer over the library that owns it.  What
the layer adds is the same for all: writing is atomic, and a file that is missing, corrupt or
of the wrong kind raises :class:`~slbench.core.errors.InputError` in one line.  This package knows
arrays and dictionaries only; what they mean is the caller's business.
"""

import lazy_loader

from slbench.core.io.provenance import provenance as provenance  # not the module of that name

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
