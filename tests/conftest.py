"""Settings for all tests: reproducible examples, no windows."""

import os

from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")

# No deadline: the first call of a compiled function compiles it.  The same examples on every
# run, so that a failure belongs to the change at hand.
settings.register_profile("slbench", deadline=None, derandomize=True)
settings.load_profile("slbench")
