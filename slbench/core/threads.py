"""Work on many items divided among threads, by loops that release the interpreter's lock.

Compiled loops take a first and a last item and are run by Python's threads.  They compile in a
fraction of the time that Numba's own parallel loops take, and no thread spins when they are done.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

#: Bands a thread: dear and cheap ones even out, and what else the machine does holds up none.
_BANDS_PER_THREAD = 4


def thread_count() -> int:
    """Return the number of threads that compiled loops may use (``NUMBA_NUM_THREADS``)."""
    from numba import config

    return int(config.NUMBA_NUM_THREADS)


def in_bands(work: Callable[[int, int], object], count: int, least: int) -> None:
    """Call ``work(first, last)`` for bands that together are ``range(count)``, in threads.

    Parameters
    ----------
    work : callable
        Must release the interpreter's lock to gain anything, and may write to its own band only.
    count : int
        Number of items.
    least : int
        Fewer items than this are not worth a thread of their own.
    """
    workers = min(thread_count(), count // least)
    if workers < 2:
        work(0, count)
        return
    bands = workers * _BANDS_PER_THREAD
    edges = [count * band // bands for band in range(bands + 1)]
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))  # raises what a band raises
