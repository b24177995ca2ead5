"""Settings for all tests: reproducible examples, a cache of their own, no windows.

Set before anything imports NumPy or Numba, which read their settings once.
"""

import fcntl
import os
import tempfile
import threading
from typing import Any

from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")

# Two workers fill two cores.  Idle threads of linear algebra and of Numba's loops would spin
# between calls, which takes more processor time than the small problems of the tests.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

WORKER = "PYTEST_XDIST_WORKER" in os.environ

# Artefacts are cached for this run alone: neither read from nor left in the user's cache.
# Workers inherit the folder of the process that started them, so each artefact is built once.
if not WORKER:
    _cache = tempfile.TemporaryDirectory(prefix="slbench-cache-")
    os.environ["SLBENCH_CACHE"] = _cache.name

# No deadline: the first call of a compiled function compiles it.  The same examples on every
# run, so that a failure belongs to the change at hand.
settings.register_profile("slbench", deadline=None, derandomize=True)
settings.load_profile("slbench")


def compile_in_turn() -> None:
    """Let one worker at a time compile, so that the others read what it put into the cache.

    Numba looks into its cache on disk before it compiles, under no lock between processes: two
    workers that reach a function at once would both compile it.
    """
    from numba.core.dispatcher import Dispatcher

    compile_alone = Dispatcher.compile
    turn = threading.RLock()
    file = open(__file__)  # noqa: SIM115 (held for the whole run)
    depth = 0

    def compile_(self: Any, signature: Any) -> Any:
        nonlocal depth
        with turn:
            # A function that calls another compiles it inside its own turn.
            if depth == 0:
                fcntl.flock(file, fcntl.LOCK_EX)
            depth += 1
            try:
                return compile_alone(self, signature)
            finally:
                depth -= 1
                if depth == 0:
                    fcntl.flock(file, fcntl.LOCK_UN)

    Dispatcher.compile = compile_


if WORKER:
    compile_in_turn()
