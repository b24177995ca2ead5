"""slbench: a physically based synthetic structured-light scanner and test bench.

The stream is ``rig -> patterns -> render -> capture -> decode -> reconstruct -> score``;
each noun is an immutable value, each verb a function.  Importing :mod:`slbench` is cheap:
Mitsuba is loaded only when something under :mod:`slbench.simulate.render` is used.
"""

__version__ = "0.1.0"
