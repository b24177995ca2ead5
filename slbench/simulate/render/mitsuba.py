"""Mitsuba and Dr.Jit with a working variant set: what every rendering module imports.

Importing this module activates the backend (render/backend.py); ``import slbench.simulate.render``
alone does not.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import drjit as dr
    import mitsuba as mi
else:
    from slbench.simulate.render.backend.choice import activate

    mi = activate()
    # Dr.Jit loads its LLVM when it is imported, and activate() has chosen which.
    import drjit as dr

__all__ = ["dr", "mi"]
