"""Look into shared libraries from a child process.

A library can only be asked for its version or its devices once it is loaded, and a loaded
library cannot be unloaded: an old LLVM or a broken GPU driver would stay in the process and
can end it.  This file is therefore run as a script, by path, in a child process that imports
nothing but the standard library; :mod:`slbench.simulate.render.backend.choice` reads the JSON it
prints.

The CUDA calls are those of the driver API (NVIDIA, "CUDA Driver API", sections 6.2-6.5); the
limits are those that Dr.Jit 1.5 itself enforces.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
from typing import Any

MINIMUM_CUDA_DRIVER = 12020
"""CUDA 12.2 (driver R535), in the driver API's notation 1000 major + 10 minor."""

MINIMUM_COMPUTE_CAPABILITY = (7, 5)
"""Turing: Dr.Jit skips older devices."""

_COMPUTE_CAPABILITY_MAJOR = 75
_COMPUTE_CAPABILITY_MINOR = 76


def llvm_version(path: str) -> dict[str, Any]:
    """Load a library and ask it which LLVM it is.

    Parameters
    ----------
    path : str
        Path of the library, or a bare name for the system's loader to find.

    Returns
    -------
    dict
        ``{"version": [major, minor, patch]}``, or ``{"problem": sentence}``.
    """
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        return {"problem": f"it does not load ({error})"}
    # The C interface has this function since LLVM 16.
    if not hasattr(library, "LLVMGetVersion"):
        return {"problem": "it is older than LLVM 16, or not LLVM"}
    numbers = [ctypes.c_uint() for _ in range(3)]
    library.LLVMGetVersion(*(ctypes.byref(number) for number in numbers))
    return {"version": [number.value for number in numbers]}


def gpu() -> dict[str, Any]:
    """Find the first NVIDIA GPU on which Mitsuba can trace rays.

    Returns
    -------
    dict
        ``{"name": name}``, or ``{"problem": sentence}``.
    """
    windows = sys.platform == "win32"
    name = os.environ.get("DRJIT_LIBCUDA_PATH") or ("nvcuda.dll" if windows else "libcuda.so.1")
    try:
        cuda = ctypes.CDLL(name)
    except OSError:
        return {"problem": f"there is no NVIDIA driver ({name})"}
    if status := cuda.cuInit(0):
        return {"problem": f"the NVIDIA driver does not start (cuInit returned {status})"}

    version = ctypes.c_int()
    cuda.cuDriverGetVersion(ctypes.byref(version))
    if version.value < MINIMUM_CUDA_DRIVER:
        found = f"{version.value // 1000}.{version.value % 1000 // 10}"
        return {"problem": f"the NVIDIA driver offers CUDA {found}, and 12.2 is needed"}

    # Rays are traced by OptiX, a part of the driver that containers often leave out.  On
    # Windows it has no fixed place and Dr.Jit searches the driver store itself.
    optix = os.environ.get("DRJIT_LIBOPTIX_PATH") or "libnvoptix.so.1"
    if not windows:
        try:
            ctypes.CDLL(optix)
        except OSError:
            return {"problem": f"the NVIDIA driver comes without OptiX ({optix})"}

    count = ctypes.c_int()
    cuda.cuDeviceGetCount(ctypes.byref(count))
    for index in range(count.value):
        device = ctypes.c_int()
        if cuda.cuDeviceGet(ctypes.byref(device), index):
            continue
        major, minor = ctypes.c_int(), ctypes.c_int()
        cuda.cuDeviceGetAttribute(ctypes.byref(major), _COMPUTE_CAPABILITY_MAJOR, device)
        cuda.cuDeviceGetAttribute(ctypes.byref(minor), _COMPUTE_CAPABILITY_MINOR, device)
        if (major.value, minor.value) < MINIMUM_COMPUTE_CAPABILITY:
            continue
        buffer = ctypes.create_string_buffer(256)
        cuda.cuDeviceGetName(buffer, len(buffer), device)
        return {"name": buffer.value.decode(errors="replace")}
    return {"problem": f"none of {count.value} NVIDIA devices has compute capability 7.5"}


if __name__ == "__main__":
    print(json.dumps(llvm_version(sys.argv[2]) if sys.argv[1] == "llvm" else gpu()))
