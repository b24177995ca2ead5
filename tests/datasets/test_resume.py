"""Data sets on real worker processes: numbers of workers, a scheduler, and kill -9."""

import functools
import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager, suppress

import psutil
import pytest
from dataset_specs import hashes, rows_of, write_spec

from slbench.core.errors import InputError
from slbench.datasets.make.cluster import existing_cluster, local_cluster
from slbench.datasets.make.engine import make_dataset
from slbench.datasets.spec.specification import load
from slbench.datasets.verify import verify_dataset

pytestmark = pytest.mark.slow

COUNT, SEED = 12, 3
KILLS = 20


def command(spec, out, *more):
    words = ["dataset", "make", spec, "--out", out, "--count", COUNT, "--seed", SEED, *more]
    return [sys.executable, "-m", "slbench", *map(str, words)]


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    # Frames once: the kills are about files, not about patterns.
    patterns = [{"sequence": "1,10"}]
    return write_spec(tmp_path_factory.mktemp("spec"), patterns=patterns, samples_per_shard=3)


@pytest.fixture(scope="module")
def reference_run(spec, tmp_path_factory):
    """Hashes of the samples made one after the other in this process, and seconds a sample."""
    url = str(tmp_path_factory.mktemp("reference") / "set")
    with local_cluster(0) as cluster:
        begin = time.monotonic()
        make_dataset(*load(spec), url, COUNT, cluster, seed=SEED)
    return hashes(url), (time.monotonic() - begin) / COUNT


@pytest.fixture(scope="module")
def reference(reference_run):
    return reference_run[0]


def check_whole(url, reference):
    problems, found = verify_dataset(str(url))
    assert problems == []
    assert (found["samples"], found["failed"]) == (COUNT, 0)
    assert [row["sample"] for row in rows_of(url)] == list(range(COUNT))
    assert hashes(url) == reference
    left = [path for path in url.rglob("*") if path.name.startswith(".") or path.name == "run.json"]
    assert left == []
    assert not (url / "staging").exists()


@contextmanager
def running(spec, out, *more):
    """Run the command line in a process group of its own, which is ended in any case."""
    process = subprocess.Popen(
        command(spec, out, *more),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    try:
        yield process
    finally:
        kill_group(process)


def kill_group(process):
    """End a process and its children at once."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stderr is not None:
        process.stderr.close()


def workers_of(process):
    """Return a run's worker processes, those that make samples."""
    try:
        children = psutil.Process(process.pid).children(recursive=True)
        return [c for c in children if "spawn_main" in " ".join(c.cmdline())]
    except psutil.Error:
        return []


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_do_not_change_a_sample(workers, spec, reference, tmp_path):
    with local_cluster(workers) as cluster:
        made = make_dataset(*load(spec), str(tmp_path / "set"), COUNT, cluster, seed=SEED)
    assert made.failed == 0
    check_whole(tmp_path / "set", reference)


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_do_not_change_a_sample(threads, spec, reference, tmp_path):
    # Dr.Jit and Numba take as many threads as the process may use cores.
    script = (
        "import os, sys\n"
        f"os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:{threads}])\n"
        "from slbench.datasets.make.sample_maker import make_sample\n"
        "from slbench.datasets.store.sample import pack\n"
        "from slbench.datasets.store.shards import digest\n"
        "from slbench.datasets.spec.specification import load\n"
        f"specification = load({str(spec)!r})\n"
        "for i in range(3):\n"
        f"    print(digest(pack(i, make_sample(*specification, {SEED}, i))))\n"
        "from slbench.simulate.render.backend.choice import threads\n"
        "print(threads())\n"
    )
    if not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < threads:
        pytest.skip("the cores of a process cannot be chosen here")
    child = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    *made, used = child.stdout.split()
    assert int(used) == threads
    assert made == reference[:3]


def token(place):
    """Return the token of the run that a data set belongs to, if there is one."""
    with suppress(OSError):
        return (place / "run.json").read_bytes()
    return None


def begun(place, before):
    """Tell whether a run of another token than `before` has begun."""
    return token(place) not in (before, None)


def stored(place):
    """Return the names of the files that samples and shards stand in."""
    return {path.name for path in place.glob("s*/0*")}


def more_stored(place, before):
    """Tell whether a sample or a shard is there that was not."""
    return bool(stored(place) - before)


def wait_for(process, event):
    """Wait until something has happened, or the process has ended."""
    deadline = time.monotonic() + 120.0
    while process.poll() is None and not event():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_killed_again_and_again(spec, reference_run, tmp_path):
    reference, pace = reference_run
    rng = random.Random(1)
    kills = {"worker": 0, "run": 0}
    finished = number = 0
    place = tmp_path / "set-0"
    while sum(kills.values()) < KILLS:
        more = ["--workers", 2] + (["--resume"] if place.exists() else [])
        before, there = token(place), stored(place)
        with running(spec, place, *more) as process:
            wait_for(process, functools.partial(workers_of, process))
            # Some die while they start, some with their first samples, most in the middle.
            moment = rng.random()
            if moment > 0.1:
                wait_for(process, functools.partial(begun, place, before))
            if moment > 0.3:
                wait_for(process, functools.partial(more_stored, place, there))
            time.sleep(rng.uniform(0.0, 4.0 * pace))
            workers = workers_of(process)
            if workers and process.poll() is None:
                rng.choice(workers).kill()
                kills["worker"] += 1
            time.sleep(rng.uniform(0.0, 4.0 * pace))
            done = process.poll()
            if done is None:
                kills["run"] += 1
            else:
                assert done == 0, process.stderr.read()
        if done is not None:
            check_whole(place, reference)
            finished += 1
            number += 1
            place = tmp_path / f"set-{number}"
    print(f"{kills}, {finished} finished meanwhile")
    assert min(kills.values()) > 0
    last = subprocess.run(
        command(spec, place, "--workers", 2, "--resume"), capture_output=True, text=True
    )
    assert last.returncode == 0, last.stderr
    check_whole(place, reference)


#: The command line in one process that dies right after its n-th file has appeared.
DYING = """\
import contextlib, os, sys
from slbench.datasets.store import storage
limit, writing = int(sys.argv.pop(1)), storage.Storage.writing
count = 0
@contextlib.contextmanager
def counted(self, name):
    global count
    with writing(self, name) as stream:
        yield stream
        if count == limit:
            os._exit(137)
    count += 1
    if count == limit:
        os._exit(137)
storage.Storage.writing = counted
from slbench.cli import main
main()
"""


def statuses_of(words, limits):
    """Run a command line that dies at its first file, or another; return exit statuses."""
    arguments = [[sys.executable, "-c", DYING, str(limit), *words] for limit in limits]
    return [subprocess.run(one, capture_output=True).returncode for one in arguments]


def test_killed_at_each_step(spec, reference, tmp_path):
    """Die right after each of the files that matter has appeared, in one process."""
    words = command(spec, tmp_path / "set", "--workers", 0, "--resume")[3:]
    assert statuses_of(words, (1, 3, 4, 2, 1, 5)) == [137] * 6
    last = subprocess.run([sys.executable, "-m", "slbench", *words], capture_output=True)
    assert last.returncode == 0, last.stderr
    check_whole(tmp_path / "set", reference)


def test_growth_that_is_killed_at_each_step(spec, reference, tmp_path):
    """Grow from seven samples of twelve, a shard of which has one of three."""
    place = tmp_path / "set"
    with local_cluster(0) as cluster:
        make_dataset(*load(spec), str(place), 7, cluster, seed=SEED)
    words = command(spec, place, "--workers", 0, "--resume")[3:]
    # dataset.json, run.json, the sample that is staged again; later ones get further.
    assert statuses_of(words, (1, 2, 3, 4, 5, 6, 2)) == [137] * 7
    last = subprocess.run([sys.executable, "-m", "slbench", *words], capture_output=True)
    assert last.returncode == 0, last.stderr
    check_whole(place, reference)
    with local_cluster(0) as cluster:
        make_dataset(*load(spec), str(tmp_path / "once"), COUNT, cluster, seed=SEED)
    for name in ("dataset.json", "index.parquet", "shards/000002.tar", "shards/000002.parquet"):
        assert (place / name).read_bytes() == (tmp_path / "once" / name).read_bytes()


@contextmanager
def program(*words):
    process = subprocess.Popen(
        [sys.executable, "-m", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        kill_group(process)


@contextmanager
def loopback(folder, workers=2):
    """Start a scheduler and separate workers; give the scheduler's address and process."""
    file = folder / "scheduler.json"
    address = ["--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", file]
    with program("distributed.cli.dask_scheduler", *address) as scheduler:
        deadline = time.monotonic() + 60.0
        while not file.exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        url = json.loads(file.read_text())["address"]
        options = ["--nthreads", 1, "--no-nanny", "--no-dashboard", "--local-directory", folder]
        with ExitStack() as stack:
            for _ in range(workers):
                stack.enter_context(program("distributed.cli.dask_worker", url, *options))
            yield url, scheduler


def test_two_workers_of_a_scheduler_by_its_address(spec, reference, tmp_path):
    with loopback(tmp_path) as (url, _):
        child = subprocess.run(
            command(spec, tmp_path / "set", "--scheduler", url), capture_output=True, text=True
        )
    assert child.returncode == 0, child.stderr
    check_whole(tmp_path / "set", reference)


def test_a_dead_scheduler_is_said_and_resumed(spec, reference, tmp_path):
    with (
        loopback(tmp_path) as (url, scheduler),
        running(spec, tmp_path / "set", "--scheduler", url) as process,
    ):
        deadline = time.monotonic() + 120.0
        while not list((tmp_path / "set").glob("staging/*.tar")):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        scheduler.kill()
        assert process.wait(timeout=120) == 1
        message = process.stderr.read()
    assert "--resume" in message
    assert "Traceback" not in message
    with local_cluster(0) as cluster:
        make_dataset(*load(spec), str(tmp_path / "set"), COUNT, cluster, seed=SEED, resume=True)
    check_whole(tmp_path / "set", reference)


def test_a_worker_that_dies_of_a_sample_fails_that_sample_alone(spec, tmp_path):
    # Its workers are killed whenever they make sample 2.
    def deadly(run, sample):
        from slbench.datasets.make import tasks

        if sample == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return tasks.make(run, sample)

    class Deadly:
        def __init__(self, cluster):
            self.__dict__.update(inner=cluster)

        def __getattr__(self, name):
            return getattr(self.inner, name)

        def submit(self, function, *arguments):
            from slbench.datasets.make import tasks

            return self.inner.submit(deadly if function is tasks.make else function, *arguments)

    with local_cluster(2) as cluster:
        made = make_dataset(*load(spec), str(tmp_path / "set"), 4, Deadly(cluster), seed=SEED)
    assert made.failed == 1
    row = rows_of(tmp_path / "set")[2]
    assert row["status"] == "failed"
    assert "worker died" in row["reason"]
    assert verify_dataset(str(tmp_path / "set"))[0] == []


def test_no_scheduler_is_one_line():
    with (
        pytest.raises(InputError, match="--scheduler: expected the address"),
        existing_cluster("tcp://127.0.0.1:9"),
    ):
        pass
