"""Registration of our Mitsuba plugins.

After :func:`register` any Mitsuba scene, dictionary or XML, may use ``thinlens_projector`` and
``slbench_camera``.
"""

from __future__ import annotations

from slbench.render.backend import activate

_registered: set[str] = set()


def register() -> None:
    """Register the plugins for the active variant; calling it again does nothing."""
    mi = activate()
    if mi.variant() in _registered:
        return
    # Imported late: classes derived from mi.Emitter exist only once a variant is set.
    from slbench.render.camera import SlbenchCamera
    from slbench.render.projector import ThinLensProjector

    mi.register_emitter("thinlens_projector", ThinLensProjector)
    mi.register_sensor("slbench_camera", SlbenchCamera)
    _registered.add(mi.variant())
