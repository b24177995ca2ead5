"""Find a libLLVM that Dr.Jit can use, without loading one that it cannot.

On the CPU Dr.Jit compiles its kernels with an LLVM that it loads at run time.  With LLVM 14,
15 and 16, which older systems ship, the first kernel with a maximum in it aborts the whole
process ("Cannot select: fmaximum"): no exception, no exit code of ours.  So the version is
settled before anything is loaded: from the name of the file where the name tells, else by
asking the library in a child process.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import site
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from slbench.core.errors import InputError
from slbench.simulate.render.backend import probe

MINIMUM_LLVM = 17
"""The first major version that selects ``fmaximum`` on every processor."""

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Dr.Jit's own variable: the library that it loads instead of the system's."""

WHEEL = "karellen-llvm-core"
"""A package of nothing but LLVM's shared libraries."""

Version = tuple[int, ...]

# libLLVM.so.23.1 | libLLVM-14.so.1, libLLVM-18.dylib | libLLVM.19.1.dylib.  Two digits at
# least: in libLLVM.so.1 the number is the interface's, not LLVM's.
_NAMES = (
    re.compile(r"libLLVM\.so\.(\d{2,}(?:\.\d+)*)"),
    re.compile(r"libLLVM-(\d{2,}(?:\.\d+)*)\.(?:so(?:\.\d+)*|dylib)"),
    re.compile(r"libLLVM\.(\d{2,}(?:\.\d+)*)\.dylib"),
)
_PATTERNS = ("libLLVM.so*", "libLLVM-*.so*", "libLLVM*.dylib", "LLVM-C.dll")
_PROBE_SECONDS = 30.0  # loading takes 0.03 s, from a cold disk a few seconds


class BackendError(InputError):
    """No way to render on this machine; ``str(error)`` is one line for the user."""


def find_llvm() -> tuple[Path, Version]:
    """Find the LLVM for Dr.Jit to load.

    In this order: the library that the user named in ``DRJIT_LIBLLVM_PATH``; the one in the
    wheel ``karellen-llvm-core`` or elsewhere in this Python environment; the newest of the
    system's.  None of them is loaded into this process.

    Returns
    -------
    path : Path
        The library; the bare name if the user gave one for the system's loader to find.
    version : tuple of int
        Its version, as far as it is known: ``(23, 1)``.

    Raises
    ------
    BackendError
        When the user's choice is missing, not LLVM, or older than 17; when there is no
        suitable library anywhere.
    """
    if chosen := os.environ.get(LLVM_VARIABLE):
        return _check_users_choice(chosen)

    refused: list[Path] = []
    for group in (_wheel_candidates(), _environment_candidates(), _system_candidates()):
        for path in _newest_first(group):
            version, _ = library_version(path)
            if version and version[0] >= MINIMUM_LLVM:
                return path, version
            refused.append(path)
    got = f"only older ones ({', '.join(map(str, refused))})" if refused else "none"
    raise BackendError("render backend", f"an LLVM {MINIMUM_LLVM} or newer ({advice()})", got)


def advice(platform: str = sys.platform) -> str:
    """Return how to install an LLVM on this kind of machine."""
    if platform == "darwin":
        return "install it with: brew install llvm"
    if platform == "win32":
        return "install it with the LLVM installer"
    return f"install it with: pip install {WHEEL}"


def library_version(path: Path | str) -> tuple[Version | None, str]:
    """Return the version of a libLLVM without loading it into this process.

    Parameters
    ----------
    path : Path or str
        The library; symbolic links are followed, because the name of the file itself tells
        more, and more truly, than that of a link.

    Returns
    -------
    version : tuple of int or None
        None where it cannot be told.
    problem : str
        Why it cannot, else empty.
    """
    if version := _version_from_name(os.path.basename(os.path.realpath(path))):
        return version, ""
    answer = ask_probe("llvm", str(path))
    if numbers := answer.get("version"):
        return tuple(numbers), ""
    return None, answer["problem"]


def ask_probe(*arguments: str) -> dict:
    """Run the probe (:mod:`.probe`) in a child process and return its answer."""
    command = [sys.executable, "-I", "-S", probe.__file__, *arguments]
    try:
        child = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=True,
        )
        return json.loads(child.stdout)
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        return {"problem": f"asking it in a child process failed ({error})"}


def _check_users_choice(chosen: str) -> tuple[Path, Version]:
    expected = f"the path of an LLVM {MINIMUM_LLVM} or newer ({advice()}, and unset it)"
    named_by_path = Path(chosen).name != chosen
    if (named_by_path or Path(chosen).exists()) and not Path(chosen).is_file():
        raise BackendError(LLVM_VARIABLE, expected, f"{chosen}, which is not a file")
    version, problem = library_version(chosen)
    if version is None:
        raise BackendError(LLVM_VARIABLE, expected, f"{chosen}: {problem}")
    if version[0] < MINIMUM_LLVM:
        raise BackendError(LLVM_VARIABLE, expected, f"{chosen} (LLVM {dotted(version)})")
    return Path(chosen), version


def dotted(version: Version) -> str:
    """Write a version the usual way: ``(23, 1)`` is ``"23.1"``."""
    return ".".join(map(str, version))


def _version_from_name(name: str) -> Version | None:
    for pattern in _NAMES:
        if match := pattern.fullmatch(name):
            return tuple(int(number) for number in match[1].split("."))
    return None


def _newest_first(paths: Iterable[Path]) -> list[Path]:
    """Drop links to the same file; versions that the name does not tell come last."""
    files = {Path(os.path.realpath(path)) for path in paths}
    return sorted(files, key=lambda file: (_version_from_name(file.name) or (), str(file)))[::-1]


def _libraries_in(folders: Iterable[Path]) -> Iterator[Path]:
    for folder in folders:
        for pattern in _PATTERNS:
            yield from (path for path in folder.glob(pattern) if path.is_file())


def _wheel_candidates() -> Iterator[Path]:
    """Libraries that the wheel's own record lists, wherever it was installed.

    The links in it are made after installation by a helper package and may be absent: only
    the folders of the record are used, not its names.
    """
    try:
        record = importlib.metadata.files(WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return
    folders = {
        Path(os.path.realpath(str(file.locate()))).parent
        for file in record
        if file.name.startswith("libLLVM")
    }
    yield from _libraries_in(sorted(folders))


def _environment_candidates() -> Iterator[Path]:
    prefixes = [sys.prefix, sys.base_prefix, site.getuserbase()]
    yield from _libraries_in(Path(prefix) / "lib" for prefix in prefixes)


def _system_candidates() -> Iterator[Path]:
    yield from _libraries_in(_system_folders())


def _system_folders() -> Iterator[Path]:
    """Where distributions, Homebrew and the Windows installer put LLVM."""
    if sys.platform == "win32":
        yield Path(os.environ.get("PROGRAMFILES", r"C:\Program Files")) / "LLVM" / "bin"
        yield from (Path(entry) for entry in os.environ.get("PATH", "").split(";") if entry)
        return
    if sys.platform == "darwin":
        for root in (Path("/opt/homebrew/opt"), Path("/usr/local/opt")):
            yield from (formula / "lib" for formula in root.glob("llvm*"))
        return
    entries = os.environ.get("LD_LIBRARY_PATH", "").split(":")
    yield from (Path(entry) for entry in entries if entry)
    machine = os.uname().machine
    for root in (Path("/usr/local"), Path("/usr")):
        yield from (root / "lib" / f"{machine}-linux-gnu", root / "lib64", root / "lib")
        yield from root.glob("lib*/llvm*/lib*")
        yield from root.glob("lib/llvm/*/lib*")  # Gentoo
