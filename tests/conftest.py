"""Settings for all tests: reproducible examples, a cache of their own, no windows."""

import os
import tempfile

from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")

# Artefacts are cached for this run alone: neither read from nor left in the user's cache.
_cache = tempfile.TemporaryDirectory(prefix="slbench-cache-")
os.environ["SLBENCH_CACHE"] = _cache.name

# No deadline: the first call of a compiled function compiles it.  The same examples on every
# run, so that a failure belongs to the change at hand.
settings.register_profile("slbench", deadline=None, derandomize=True)
settings.load_profile("slbench")
