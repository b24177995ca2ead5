"""slbench: a physically based synthetic structured-light scanner and test bench.

The stream is ``rig -> patterns -> capture -> decode -> triangulate -> score``; each noun is an
immutable value, each verb a function::

    import slbench as sl

    result = sl.scan(sl.load_scene("step-block"), seed=1)   # a virtual scan

    capture = sl.read_capture("shots")                      # or photographs
    cloud = sl.triangulate(capture.rig, capture.decode())

What most people need is here by name; everything else is reached through the subpackages, as
``sl.patterns`` or ``sl.design``.  Names are imported when they are first used: the list of them
is the stub beside this file, which type checkers and editors read too.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
