"""The one place that decides how Mitsuba computes, and that imports it first.

Mitsuba is compiled in *variants*.  slbench renders one wavelength band in single precision
over wide wavefronts: ``cuda_ad_mono`` on a usable NVIDIA GPU, else ``llvm_ad_mono`` on the
CPU.  Every module under :mod:`slbench.simulate.render` gets Mitsuba by :func:`activate`, which
points Dr.Jit at a suitable LLVM *before* the first import: it is loaded then, and for good.

A process has one variant: plugins are registered for it, and objects of two variants do not
mix.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

from slbench.core.interrupts import deferred
from slbench.simulate.render.backend.llvm import (
    LLVM_VARIABLE,
    MINIMUM_LLVM,
    BackendError,
    Version,
    advice,
    ask_probe,
    dotted,
    find_llvm,
)

VARIANTS = ("cuda_ad_mono", "llvm_ad_mono")
"""The variants that slbench works with."""

VARIANT_VARIABLE = "SLBENCH_VARIANT"
"""The environment variable that overrides the choice."""


@dataclass(frozen=True)
class Backend:
    """How Mitsuba computes in this process, and why.

    Attributes
    ----------
    variant : str
        Mitsuba's variant, one of :data:`VARIANTS`.
    reason : str
        Why it was chosen, in one sentence.
    llvm_path : Path or None
        The LLVM given to Dr.Jit; None where it is not needed, or was loaded before.
    llvm_version : tuple of int or None
        The version of Dr.Jit's LLVM; None where it is not needed.
    gpu : str or None
        The name of the usable GPU, if there is one.
    """

    variant: str
    reason: str
    llvm_path: Path | None
    llvm_version: Version | None
    gpu: str | None


_lock = threading.RLock()
_active: Backend | None = None


def find_gpu() -> tuple[str | None, str]:
    """Find an NVIDIA GPU that Mitsuba can use, without starting its driver in this process.

    Returns
    -------
    name : str or None
        The name of the first GPU that will do.
    problem : str
        Why there is none, as half a sentence; else empty.
    """
    if sys.platform == "darwin":
        return None, "macOS has no CUDA"
    answer = ask_probe("gpu")
    if name := answer.get("name"):
        return name, ""
    return None, answer["problem"]


def choose(variant: str | None = None) -> Backend:
    """Choose the backend for this machine, without importing Mitsuba.

    Parameters
    ----------
    variant : str, optional
        One of :data:`VARIANTS`; overrides ``SLBENCH_VARIANT``, which overrides the choice.

    Returns
    -------
    Backend

    Raises
    ------
    BackendError
        When Mitsuba is not installed, when the requested variant is unknown or cannot work
        here, and when there is neither a usable GPU nor a suitable LLVM.
    """
    return _decide(variant, find_llvm)


def activate(variant: str | None = None) -> ModuleType:
    """Import Mitsuba with a working variant set; further calls return it at once.

    A variant that the caller's program had already set is respected.

    Parameters
    ----------
    variant : str, optional
        As for :func:`choose`.

    Returns
    -------
    module
        ``mitsuba``.

    Raises
    ------
    BackendError
        As :func:`choose`; when Mitsuba cannot be imported; when this process already uses
        another variant; when Dr.Jit was imported earlier with an LLVM that it cannot use.
    """
    global _active
    with _lock:
        if _active is None:
            with deferred():
                _active = _start(variant)
        requested, where = _requested(variant)
        if requested not in (None, _active.variant):
            expected = f"{_active.variant}, which this process already uses"
            raise BackendError(where, expected, requested)
        return importlib.import_module("mitsuba")


def current() -> Backend:
    """Return the backend of this process, which is activated if need be.

    Raises
    ------
    BackendError
        As :func:`activate`.
    """
    activate()
    assert _active is not None
    return _active


def threads() -> int:
    """Return the number of threads that Dr.Jit computes with on the CPU.

    Raises
    ------
    BackendError
        As :func:`activate`.
    """
    activate()
    return int(importlib.import_module("drjit").thread_count())


def limit_threads(count: int) -> None:
    """Let Dr.Jit compute with `count` threads on the CPU, where several processes share it.

    Raises
    ------
    BackendError
        As :func:`activate`.
    """
    activate()
    importlib.import_module("drjit").set_thread_count(count)


def _decide(variant: str | None, llvm: Callable[[], tuple[Path | None, Version]]) -> Backend:
    """Choose, with the LLVM from wherever it must come from: it is looked for only if needed."""
    requested, where = _requested(variant)
    compiled = [name for name in VARIANTS if _compiled_in(name)]
    if requested is not None and requested not in compiled:
        raise BackendError(where, f"a variant that works here ({', '.join(compiled)})", requested)
    if requested == "llvm_ad_mono":
        return Backend("llvm_ad_mono", f"{where} asks for it", *llvm(), None)

    gpu, problem = find_gpu()
    if requested == "cuda_ad_mono":
        if gpu is None:
            raise BackendError(where, "a usable NVIDIA GPU for cuda_ad_mono", f"none: {problem}")
        return Backend("cuda_ad_mono", f"{where} asks for it", None, None, gpu)
    if gpu is None:
        return Backend("llvm_ad_mono", f"no GPU is usable: {problem}", *llvm(), None)
    if "cuda_ad_mono" not in compiled:
        reason = f"this Mitsuba has no CUDA variant for the {gpu}"
        return Backend("llvm_ad_mono", reason, *llvm(), gpu)
    return Backend("cuda_ad_mono", f"the {gpu} is usable", None, None, gpu)


def _requested(variant: str | None) -> tuple[str | None, str]:
    """Return the variant that was asked for, and by what."""
    if variant is not None:
        return variant, "variant"
    return os.environ.get(VARIANT_VARIABLE) or None, VARIANT_VARIABLE


def _compiled_in(variant: str) -> bool:
    """Return whether the installed Mitsuba has a variant, by its files: nothing is imported."""
    if loaded := sys.modules.get("mitsuba"):
        return variant in loaded.variants()
    try:
        spec = importlib.util.find_spec("mitsuba")
    except ValueError:  # what find_spec raises for a module that was blocked
        spec = None
    if spec is None:
        raise BackendError("render backend", "the package mitsuba (pip install mitsuba)", "none")
    folders = spec.submodule_search_locations or []
    return any(any(Path(folder).glob(f"{variant}.*")) for folder in folders)


def _start(variant: str | None) -> Backend:
    """Import Mitsuba, set the variant, and make sure that what was loaded will do."""
    preset = sys.modules["mitsuba"].variant() if sys.modules.get("mitsuba") else None
    if preset is not None:
        backend = _preset_backend(preset)
    elif "drjit" in sys.modules:
        # Dr.Jit loads LLVM when it is imported: it is too late to choose another.
        backend = _decide(variant, lambda: (None, _loaded_llvm()))
    else:
        backend = choose(variant)
        if backend.llvm_path is not None:
            os.environ[LLVM_VARIABLE] = str(backend.llvm_path)

    try:
        mitsuba = importlib.import_module("mitsuba")
        drjit = importlib.import_module("drjit")
        if backend.variant == "llvm_ad_mono":
            # The exact version, and the last line of defence: no kernel is compiled yet.
            backend = replace(backend, llvm_version=_loaded_llvm())
        mitsuba.set_variant(backend.variant)
    except ImportError as error:
        # Mitsuba reports a backend that does not start as an ImportError as well.
        raise BackendError("render backend", "a working Mitsuba", error) from error
    mitsuba.set_log_level(mitsuba.LogLevel.Warn)
    drjit.set_log_level(drjit.LogLevel.Warn)
    return backend


def _preset_backend(preset: str) -> Backend:
    """Describe the variant that the caller's program had set before us."""
    if preset not in VARIANTS:
        expected = f"{' or '.join(VARIANTS)}, or no variant set before slbench is used"
        raise BackendError("mitsuba.set_variant", expected, preset)
    gpu = find_gpu()[0] if preset == "cuda_ad_mono" else None
    return Backend(preset, "the program had set it", None, None, gpu)


def _loaded_llvm() -> Version:
    """Return the version of the LLVM that Dr.Jit has loaded, if it can use it."""
    version = tuple(importlib.import_module("drjit").detail.llvm_version())
    if version[0] < MINIMUM_LLVM:
        expected = f"LLVM {MINIMUM_LLVM} or newer in Dr.Jit ({advice()}"
        expected += ", and let slbench import mitsuba first)"
        # Dr.Jit says 0 or -1 where nothing was loaded.
        got = f"LLVM {dotted(version)}" if version[0] > 0 else "none that loads"
        raise BackendError("render backend", expected, got)
    return version
