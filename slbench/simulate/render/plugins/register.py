"""Registration of our Mitsuba plugins.

After :func:`register` any Mitsuba scene, dictionary or XML, may use ``thinlens_projector`` and
``slbench_camera``.
"""

from __future__ import annotations

from slbench.simulate.render.mitsuba import mi
from slbench.simulate.render.plugins.camera import SlbenchCamera
from slbench.simulate.render.plugins.projector import ThinLensProjector

_registered = False


def register() -> None:
    """Register the plugins with Mitsuba; calling it again does nothing."""
    global _registered
    if not _registered:
        mi.register_emitter("thinlens_projector", ThinLensProjector)
        mi.register_sensor("slbench_camera", SlbenchCamera)
        _registered = True
