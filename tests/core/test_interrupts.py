"""Signals: none is lost, none leaves something half done."""

import signal
import subprocess
import sys
import threading
import time

import pytest

from slbench.core.interrupts import came_of_interrupt, cleaning_up, deferred


@pytest.fixture(autouse=True)
def interrupts():
    """A shell that runs the tests in its background has interrupts ignored, children's too."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


DROPPED = """
import os, signal, sys, time, weakref
from slbench.core.interrupts import cleaning_up

class Thing:
    pass

def callback(_):  # what is raised in here is dropped by Python
    os.kill(os.getpid(), int(sys.argv[1]))
    for _ in range(1000):
        pass

with cleaning_up():
    thing = Thing()
    watched = weakref.ref(thing, callback)
    del thing
    time.sleep(20)
    print("survived")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_python_drops_comes_again(number):
    line = [sys.executable, "-c", DROPPED, str(int(number))]
    done = subprocess.run(line, capture_output=True, text=True, timeout=15)
    assert "survived" not in done.stdout
    assert "Exception ignored" not in done.stderr
    assert done.returncode in (-number, 128 + number)


def test_a_signal_waits_for_the_end_of_the_block():
    reached = []

    def work():
        with deferred():
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.01)
            reached.append(True)
        reached.append(False)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert reached == [True]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_request_to_end_leaves_by_way_of_the_blocks_around():
    before = signal.getsignal(signal.SIGTERM)
    left = []

    def work():
        with cleaning_up():
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                left.append(True)

    with pytest.raises(SystemExit) as caught:
        work()
    assert (caught.value.code, left) == (143, [True])
    assert signal.getsignal(signal.SIGTERM) is before


def test_other_threads_have_no_signals():
    done = []

    def work():
        with cleaning_up(), deferred():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]


def test_an_error_that_is_an_interrupt_in_disguise():
    def importing():
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error

    with pytest.raises(ImportError) as caught:
        importing()
    assert came_of_interrupt(caught.value)
    assert not came_of_interrupt(ImportError("no such module"))
