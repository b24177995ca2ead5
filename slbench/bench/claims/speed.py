"""How much a pattern costs, in renders: ratios of times of one run on one machine.

The yardstick is one render of one pattern by Mitsuba's own integrator, with 64 samples a
pixel through thin lenses, as one would render a picture.
Trace, relight and render take turns, so that slow spells of the machine meet all three, and of
several turns the fastest of each counts: what disturbs a run only ever makes it slower.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slbench.patterns import PatternSequence
from slbench.scene.model import Scene

#: Fringe patterns whose cost is measured: three sets of twelve shifts.
_PATTERNS, _TEXT = 36, "1,10,50@12"
_TURNS = 3
#: Samples a pixel of an ordinary render.
_RENDERED = 64


def speed_ratios(scene: Scene, seed: int) -> dict[str, float]:
    """Time a scan's light transport and its patterns beside one render.

    Parameters
    ----------
    scene : Scene
        Its camera and samples a pixel.
    seed : int

    Returns
    -------
    dict
        ``patterns36_per_render``: tracing and 36 patterns over one render;
        ``pattern_per_render``: a further pattern over one render.
    """
    from slbench.simulate.render.trace import trace

    profiles = PatternSequence.parse(_TEXT, scene.sequence.panel).profiles("u")[1]
    render = _renderer(_ordinary(scene))
    parts = scene.objects, scene.rig, scene.light
    light = functools.partial(trace, *parts, ("u",), samples=scene.samples, seed=seed)
    transport = light()
    transport.relight(profiles)  # compiles
    works: tuple[Callable[[], object], ...] = (
        light,
        lambda: transport.relight(profiles),
        lambda: render(seed),
    )
    times = np.array([[_seconds(work) for work in works] for _ in range(_TURNS)])
    traced, relit, rendered = times.min(axis=0)
    return {
        "patterns36_per_render": float((traced + relit) / rendered),
        "pattern_per_render": float(relit / _PATTERNS / rendered),
    }


def _ordinary(scene: Scene) -> Scene:
    """Return a scene as one would render a picture of it: by thin lenses, which are faster."""
    devices = {
        name: replace(one, lens=replace(one.lens, wavelength_nm=0.0), blur_px=0.0)
        for name, one in scene.rig.devices.items()
    }
    return replace(scene, rig=scene.rig.having(**devices), samples=_RENDERED)


@functools.lru_cache(maxsize=2)
def _renderer(scene: Scene) -> Callable[[int], None]:
    """Return the yardstick of a scene, compiled once."""
    from slbench.simulate.render.yardstick import pattern_renderer

    return pattern_renderer(scene)


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
