"""One ordinary render of one pattern, which the speed of the light transport is compared with."""

from __future__ import annotations

from collections.abc import Callable

from slbench.scene.model import Scene
from slbench.simulate.render.mitsuba import mi
from slbench.simulate.render.translate import mitsuba_dict


def pattern_renderer(scene: Scene) -> Callable[[int], None]:
    """Return a function that renders the scene's first pattern with Mitsuba's own integrator.

    Parameters
    ----------
    scene : Scene
        With its number of samples a pixel.

    Returns
    -------
    callable
        Takes a seed; the picture is complete when it returns.  Loaded and compiled already.
    """
    loaded = mi.load_dict(mitsuba_dict(scene, scene.sequence.images()[0]))

    def render(seed: int) -> None:
        mi.render(loaded, spp=scene.samples, seed=seed).numpy()

    render(0)
    return render
