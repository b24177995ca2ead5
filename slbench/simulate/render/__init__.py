"""Everything that needs Mitsuba: backend, plugins, light transport, ground truth.

Importing this package is cheap: Mitsuba itself is imported by :func:`activate`.
"""

from slbench.simulate.render.backend.choice import (
    Backend,
    activate,
    choose,
    current,
    find_gpu,
    threads,
)
from slbench.simulate.render.backend.llvm import BackendError, find_llvm

__all__ = [
    "Backend",
    "BackendError",
    "activate",
    "choose",
    "current",
    "find_gpu",
    "find_llvm",
    "threads",
]
