"""What slbench would run on here, and whether it computes correctly.

The first thing to run on a new machine, and the first thing to send with a problem report:
versions, the chosen backend and why, and a render whose answer is known.  The render runs in
a child process, because the doctor must survive the patient: a compiler or a driver that
does not fit can end a process without an exception.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

import slbench
from slbench.core.errors import InputError
from slbench.simulate.render.backend.choice import choose, find_gpu

PACKAGES = (
    "mitsuba",
    "drjit",
    "karellen-llvm-core",
    "numpy",
    "scipy",
    "numba",
    "opencv-python-headless",
    "scikit-image",
    "trimesh",
    "manifold3d",
    "OpenEXR",
    "plyfile",
    "pydantic",
    "matplotlib",
    "typer",
    "rich",
)
"""The distributions whose versions matter in a problem report."""

_SELFTEST_SECONDS = 120.0  # takes about one; a first run on a GPU compiles for longer

_EXIT_STATUS = {"ok": 0, "self-test failed": 1, "no backend": 2}


def diagnose() -> dict[str, Any]:
    """Collect versions, backend and hardware, and run the self-test.

    Returns
    -------
    dict
        Ready for JSON.  ``status``: ``"ok"``, ``"self-test failed"`` or ``"no backend"``;
        ``slbench``, ``python``, ``platform``: str; ``packages``: version by name, None where
        missing; ``cores``: ``machine``, and ``usable`` by this process; ``gpu``: ``name``
        and ``problem``, one of them None; ``backend``: ``variant``, ``reason``,
        ``llvm_path``, ``llvm_version``, or ``error``; ``selftest``: the fields of
        :class:`slbench.simulate.render.backend.selftest.SelfTest`, or ``error``, or None without a
        backend.
    """
    backend = _backend()
    selftest = None if "error" in backend else _selftest()
    if selftest is None:
        status = "no backend"
    else:
        status = "ok" if selftest.get("ok") else "self-test failed"
    return {
        "status": status,
        "slbench": slbench.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: _version(name) for name in PACKAGES},
        "cores": {"machine": os.cpu_count(), "usable": _usable_cores()},
        "gpu": _gpu(),
        "backend": backend,
        "selftest": selftest,
    }


def exit_status(diagnosis: dict[str, Any]) -> int:
    """Return the command's exit status: 0 all well, 1 self-test failed, 2 no backend."""
    return _EXIT_STATUS[diagnosis["status"]]


def report(diagnosis: dict[str, Any]) -> Group:
    """Lay a diagnosis out for the terminal.

    Parameters
    ----------
    diagnosis : dict
        From :func:`diagnose`.

    Returns
    -------
    rich.console.Group
        To be printed by a :class:`rich.console.Console`.
    """
    backend, gpu, cores = diagnosis["backend"], diagnosis["gpu"], diagnosis["cores"]
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")

    def row(name: str, value: str) -> None:
        table.add_row(name, Text(value))  # Text: brackets in a path are not markup

    row("slbench", diagnosis["slbench"])
    row("python", f"{diagnosis['python']} on {diagnosis['platform']}")
    versions = (f"{name} {version or 'MISSING'}" for name, version in diagnosis["packages"].items())
    row("packages", ", ".join(versions))
    row("cores", f"{cores['usable']} usable of {cores['machine']}")
    row("GPU", gpu["name"] or f"none: {gpu['problem']}")
    if "error" in backend:
        row("backend", backend["error"])
    else:
        row("backend", f"{backend['variant']} ({backend['reason']})")
        if backend["llvm_version"]:
            row("LLVM", f"{backend['llvm_version']}, {backend['llvm_path']}")
    if diagnosis["selftest"] is not None:
        row("self-test", _selftest_line(diagnosis["selftest"]))
    well = diagnosis["status"] == "ok"
    return Group(table, Text(diagnosis["status"], style="bold green" if well else "bold red"))


def _selftest_line(selftest: dict[str, Any]) -> str:
    if "error" in selftest:
        return selftest["error"]
    return (
        f"mean radiance {selftest['measured']:.6f}, {selftest['expected']:.6f} expected; "
        f"largest difference of a pixel {selftest['relative_difference']:.1e}, "
        f"{selftest['tolerance']:.0e} allowed; {selftest['seconds']:.2f} s"
    )


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _usable_cores() -> int | None:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count()


def _gpu() -> dict[str, str | None]:
    name, problem = find_gpu()
    return {"name": name, "problem": problem or None}


def _backend() -> dict[str, Any]:
    try:
        backend = choose()
    except InputError as error:
        return {"error": str(error)}
    version = backend.llvm_version
    return {
        "variant": backend.variant,
        "reason": backend.reason,
        "llvm_path": str(backend.llvm_path) if backend.llvm_path else None,
        "llvm_version": ".".join(map(str, version)) if version else None,
    }


def _selftest() -> dict[str, Any]:
    """Run the self-test in a child process and return its outcome, or how it ended."""
    # The child must find this very slbench, however the parent did.
    root = str(Path(slbench.__file__).resolve().parents[1])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    try:
        child = subprocess.run(
            [sys.executable, "-m", "slbench.simulate.render.backend.selftest"],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_SELFTEST_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"error": f"not done after {_SELFTEST_SECONDS:.0f} s"}
    except OSError as error:
        return {"error": f"the child process did not start: {error}"}
    try:
        return json.loads(child.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        last = (child.stderr.strip().splitlines() or ["it printed nothing"])[-1]
        return {"error": f"the render ended by {_how_it_ended(child.returncode)}: {last}"}


def _how_it_ended(returncode: int) -> str:
    if returncode < 0:
        return signal.Signals(-returncode).name
    return f"exit status {returncode}"
