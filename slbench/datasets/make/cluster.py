"""A Dask cluster: one of this machine's own, or one that is there already.

A worker of this machine's own makes one sample at a time, with its share of the cores.  Tracing
uses many, but a good part of a sample (building the scene, truth, decoding, files) uses one, so
a worker a core serves a machine better than one worker with all of them (docs/how-to/datasets.md
has the measurement).

Whoever can talk to a scheduler can run code as its user, and a port of this machine is open to
all who have an account on it.  Workers of this machine's own therefore speak TLS, with a key that
is made for the run and kept in memory; without workers, nothing is said over a port.  Ports are
open to the loopback interface alone, HTTP servers have no page, and what is put aside (pickles)
lies in a folder that others cannot enter.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from slbench.core.errors import InputError
from slbench.core.extras import extra
from slbench.core.io.scratch import temporary_folder
from slbench.datasets.make.tasks import THREADS
from slbench.objects.cache import VARIABLE as CACHE

#: How long a scheduler may take to answer, s.
_ANSWER_S = 10.0
#: How long a cluster may take to have a worker, or to hand over what it has, s.
_PATIENCE_S = 30.0
#: What a worker may need: a scan stays under 2 GiB.
_MEMORY_BYTES = 2 << 30
#: What a worker of this machine's own does first: an interrupt from the terminal reaches all
#: processes, and the client ends the others.
_DEAF = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
#: Dask starts HTTP servers whatever is asked for; these have no page.
_NO_PAGES: dict[str, Any] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
#: How often the client looks whether the cluster is still there, s.
_LOOK_S = 1.0


class LostError(Exception):
    """The cluster is gone; what was made is kept."""


class Cluster:
    """A client of a cluster, and what a run asks of it.

    Parameters
    ----------
    client : distributed.Client
    dashboard : str or None
        Address of the cluster's dashboard, if it has one.
    """

    def __init__(self, client: Any, dashboard: str | None) -> None:
        self.dashboard = dashboard
        self._client = client
        self._distributed = extra("distributed")
        self._cancelled: type[Exception] = extra("distributed.client").FuturesCancelledError
        #: What a task raises whose workers died too often.
        self.killed: type[Exception] = extra("distributed.scheduler").KilledWorker
        #: How many may.
        self.allowed_deaths = 1 + int(
            extra("dask").config.get("distributed.scheduler.allowed-failures")
        )

    def threads(self) -> int:
        """Return how many tasks the cluster does at a time, at least one."""
        with self._reached():
            return max(1, sum(self._client.nthreads().values()))

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Hand a task out; equal ones are done again."""
        with self._reached():
            return self._client.submit(function, *arguments, pure=False)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Do a task on a worker and return its result."""
        future = self.submit(function, *arguments)
        while not self.finished([future]):
            pass
        return self.result(future)

    def finished(self, futures: list[Any]) -> list[Any]:
        """Return the tasks that are done; waits a moment if there are none.

        Raises
        ------
        LostError
            If the cluster is gone.
        """
        with self._reached(), suppress(TimeoutError, self._cancelled):
            self._distributed.wait(futures, timeout=_LOOK_S, return_when="FIRST_COMPLETED")
        if any(future.status == "cancelled" for future in futures):
            raise LostError("the scheduler has lost the tasks")
        return [future for future in futures if future.done()]

    def result(self, future: Any) -> Any:
        """Return what a finished task returned, or raise what it raised.

        Where the worker that holds the result has died, the task is done again elsewhere.
        """
        while future.status != "error":
            with self._reached(), suppress(TimeoutError, self._cancelled):
                return future.result(timeout=_LOOK_S)
            if future.status == "cancelled":
                raise LostError("the scheduler has lost the tasks")
        return future.result(timeout=_PATIENCE_S)

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """Turn what a broken connection raises into LostError."""
        gone = "the scheduler does not answer any more"
        if self._client.status != "running":
            raise LostError(gone)
        try:
            yield
        except TimeoutError:  # an OSError too, but no broken connection
            raise
        except (OSError, RuntimeError) as error:
            raise LostError(f"{gone} ({error})") from None


def workers_here() -> int:
    """Return how many workers serve this machine well: one a core that it may use.

    No more than memory allows, and one where a GPU does the tracing.
    """
    from slbench.simulate.render.backend.choice import choose

    if choose().variant.startswith("cuda"):
        return 1
    room = extra("distributed.system").MEMORY_LIMIT // _MEMORY_BYTES
    return int(max(1, min(_cores(), room)))


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def local_cluster(workers: int) -> Iterator[Cluster]:
    """Start a cluster on this machine.

    Parameters
    ----------
    workers : int
        Processes, one sample at a time each; 0: none, samples are made in this process.
    """
    distributed = extra("distributed")
    _quiet()
    threads = str(max(1, _cores() // max(1, workers)))
    with (
        # Drawn objects come once: they must not push others out of the user's cache.
        temporary_folder("objects") as objects,
        temporary_folder("workers") as aside,
        extra("dask").config.set(_NO_PAGES | {"temporary-directory": str(aside)}),
        distributed.LocalCluster(
            n_workers=max(1, workers),
            threads_per_worker=1,
            processes=workers > 0,
            host="127.0.0.1" if workers else None,
            security=_temporary_keys() if workers else None,
            dashboard_address="127.0.0.1:0",  # None would be a fixed port, which may be taken
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
            **(
                {"env": _worker_variables(threads, str(objects)), "preload": _DEAF}
                if workers
                else {"worker_class": _worker_here}
            ),
        ) as local,
        distributed.Client(local) as client,
    ):
        yield Cluster(client, None)


def _worker_here(*arguments: Any, **options: Any) -> Any:
    """Return a worker of this process; alone it would open its HTTP server to the network."""
    own = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    return extra("distributed").Worker(*arguments, **options | own)


def _temporary_keys() -> Any:
    """Return a key and a certificate that client, scheduler and workers share for one run."""
    extra("cryptography")  # distributed asks for it late, and names another way to get it
    return extra("distributed.security").Security.temporary()


@contextmanager
def existing_cluster(address: str) -> Iterator[Cluster]:
    """Attach to a scheduler by its address, e.g. ``tcp://127.0.0.1:8786``.

    Raises
    ------
    InputError
        If none answers there, or it has no worker.
    """
    distributed = extra("distributed")
    _quiet()
    try:
        client = distributed.Client(address, timeout=_ANSWER_S)
    except (OSError, ValueError, TimeoutError) as error:
        expected = "the address of a Dask scheduler, such as tcp://host:8786"
        raise InputError("--scheduler", expected, f"{address} ({error})") from None
    with client:
        limit = time.monotonic() + _PATIENCE_S
        while not client.nthreads():
            if time.monotonic() > limit:
                raise InputError("--scheduler", f"a worker at {address}", "none")
            time.sleep(0.1)
        yield Cluster(client, _dashboard(client))


def _dashboard(client: Any) -> str | None:
    """Return the address of the dashboard, if there is one: Dask needs bokeh to show it."""
    if importlib.util.find_spec("bokeh") is None:
        return None
    services = client.scheduler_info(n_workers=0).get("services", {})
    return client.dashboard_link if "dashboard" in services else None


def _worker_variables(threads: str, objects: str) -> dict[str, str]:
    """Return the environment variables of a local worker."""
    own = {THREADS: threads, "NUMBA_NUM_THREADS": threads}
    return own if CACHE in os.environ else {**own, CACHE: objects}


def _quiet() -> None:
    """Keep what Dask logs of dead workers off the terminal: the run tells what comes of them."""
    # Dask gives some of its modules' loggers a level and a handler of their own.
    own = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    for name in ("distributed", "tornado.application", "asyncio", *own):
        logging.getLogger(name).setLevel(logging.CRITICAL)
