"""Local Dask clusters: no other user of this machine can use them, or read from them."""

import os
import socket
import stat
import urllib.error
import urllib.request
from pathlib import Path

import dask
import distributed
import psutil
import pytest
from distributed.security import Security

from slbench.datasets.make.cluster import local_cluster


def listening():
    """Return the addresses on which this process and its children listen."""
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return {
        tuple(one.laddr)
        for process in family
        for one in process.net_connections("inet")
        if one.status == psutil.CONN_LISTEN
    }


def greets(address):
    """Return whether a server there speaks Dask's protocol without a key.

    It then greets whoever connects; with TLS it waits for the client's first word, as HTTP does.
    """
    with socket.create_connection(address, timeout=1) as stranger:
        try:
            return bool(stranger.recv(1))
        except OSError:
            return False


def pages(address):
    """Return the pages that an HTTP server there has; None where it is no HTTP server."""
    found = []
    for page in ("", "health", "metrics", "status", "info/main/workers.html", "json/counts.json"):
        try:
            urllib.request.urlopen(f"http://{address[0]}:{address[1]}/{page}", timeout=3).close()
            found.append(page)
        except urllib.error.HTTPError:
            continue
        except OSError:
            return None
    return found


@pytest.fixture
def without_workers(monkeypatch):
    """Leave out the worker processes, which take seconds to start: the scheduler is real."""
    real = distributed.LocalCluster

    def start(**options):
        return real(**options | {"n_workers": 0})

    monkeypatch.setattr(distributed, "LocalCluster", start)


class TestScheduler:
    def test_nobody_without_the_key_runs_code(self, without_workers):
        with local_cluster(1) as cluster:
            address = cluster._client.scheduler.address
            place = address.split("://")[1]
            # This would run anything as the user who started the cluster.
            for other, security in (
                (f"tcp://{place}", None),
                (f"tls://{place}", Security.temporary()),
            ):
                with (
                    pytest.raises(OSError),
                    distributed.Client(other, security=security, timeout=3) as stranger,
                ):
                    stranger.run_on_scheduler(os.getpid)
            assert cluster._client.run_on_scheduler(os.getpid) == os.getpid()

    def test_keys_are_made_anew_and_kept_in_memory(self, without_workers):
        keys = set()
        for _ in range(2):
            with local_cluster(1) as cluster:
                key = cluster._client.security.tls_client_key
                assert key.startswith("-----BEGIN PRIVATE KEY-----")
                keys.add(key)
        assert len(keys) == 2

    def test_ports_are_of_the_loopback_interface_and_have_no_pages(self, without_workers):
        before = listening()
        with local_cluster(1):
            opened = listening() - before
            assert opened
            assert {host for host, _ in opened} == {"127.0.0.1"}
            assert not [place for place in opened if pages(place)]


class TestInProcess:
    def test_nothing_is_said_over_a_port(self):
        before = listening()
        with local_cluster(0) as cluster:
            assert cluster._client.scheduler.address.startswith("inproc://")
            assert cluster.call(os.getpid) == os.getpid()
            opened = listening() - before  # Dask's HTTP servers, which cannot be left out
            assert {host for host, _ in opened} <= {"127.0.0.1"}
            assert [pages(place) for place in opened] == [[]] * len(opened)

    def test_what_is_put_aside_lies_where_others_cannot_enter(self):
        before = dask.config.get("temporary-directory")
        with local_cluster(0):
            folder = Path(dask.config.get("temporary-directory"))
            assert stat.S_IMODE(folder.stat().st_mode) & 0o077 == 0
            assert list(folder.iterdir())  # Dask uses it, not /tmp/dask-scratch-space
        assert not folder.exists()
        assert dask.config.get("temporary-directory") == before


@pytest.mark.slow  # a worker process is started
class TestWorkers:
    def test_no_port_of_any_process_speaks_without_a_key(self):
        before = listening()
        with local_cluster(1) as cluster:
            assert cluster.call(os.getpid) != os.getpid()
            opened = listening() - before
            # Scheduler, nanny and worker, and HTTP servers of two of them.
            assert len(opened) >= 5
            assert {host for host, _ in opened} == {"127.0.0.1"}
            assert not [place for place in opened if greets(place)]
            assert not [place for place in opened if pages(place)]
