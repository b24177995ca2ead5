"""Scans of scenes with several cameras or projectors.

Light, truth, frames and panel coordinates belong to a pair of a camera and a projector; what a pair
gives is a :class:`~slbench.simulate.scan.Scan` of its own, and their points are joined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from slbench.capture.stack import WeightSource
from slbench.core.errors import located
from slbench.rig import Pair
from slbench.scene.model import Scene
from slbench.simulate.lights import Lights
from slbench.simulate.scan import Progress, Run, Scan, Stages, scan
from slbench.simulate.several.capture import (
    camera_seed,
    capture_pairs,
    check_multiplexed,
    pair_seed,
)
from slbench.simulate.stack import check_frame_errors
from slbench.simulate.transport import LightTransport


@dataclass(frozen=True, eq=False, kw_only=True)
class RigScan:
    """What all cameras and projectors of a scene measured.

    Parameters
    ----------
    scene : Scene
    scans : mapping of Pair to Scan
        Of each camera and projector.
    run : Run
    """

    scene: Scene
    scans: Mapping[Pair, Scan]
    run: Run


def scan_rig(
    scene: Scene,
    *,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    weights: WeightSource = "lit",
    score: bool = True,
    on_progress: Progress | None = None,
) -> RigScan:
    """Measure a scene by all its cameras and projectors.

    Parameters
    ----------
    scene : Scene
    seed, noise, samples, weights, score, on_progress
        As for :func:`slbench.simulate.scan.scan`; the scan of the first pair is the same as that of
        a scene which has no other.

    Returns
    -------
    RigScan

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        If the scene cannot be measured as it is.

    Warns
    -----
    InputWarning
        As :func:`slbench.simulate.scan.scan`, by pair.
    """
    # Mitsuba is needed from here on, and only here.
    from slbench.simulate.render.backend.choice import current

    if samples is not None:
        scene = replace(scene, samples=samples)
    pairs = scene.rig.pairs
    parts = {pair: _part(scene, pair) for pair in pairs}
    check_multiplexed(scene)
    with located(f"scene {scene.name}"):
        check_frame_errors(scene)
    for one in parts.values():
        with located(f"scene {one.name}: patterns {one.sequence.name}"):
            one.sequence.runs()
    stage = Stages(on_progress)
    lights = {pair: Lights(camera_seed(seed, scene.rig, pair.camera)) for pair in pairs}
    transports: dict[Pair, LightTransport] = {}
    with stage("trace") as progress:
        for k, (pair, one) in enumerate(parts.items()):
            sharp = one if scene.focus is None else one.all_in_focus()
            done = _within(progress, k, len(pairs))
            (transports[pair],) = lights[pair].traced(sharp, on_progress=done)
    with stage("relight") as progress:
        stacks = capture_pairs(
            scene, parts, transports, seed=seed, noise=noise, on_progress=progress
        )
    scans: dict[Pair, Scan] = {}
    for pair, one in parts.items():
        scans[pair] = scan(
            one,
            seed=pair_seed(seed, scene.rig, pair),
            noise=noise,
            weights=weights,
            score=score,
            lights=lights[pair],
            stack=stacks[pair],
        )
        for name, seconds in scans[pair].run.seconds.items():
            if name != "total":
                stage.seconds[name] = stage.seconds.get(name, 0.0) + seconds
    stage.end()
    run = Run(seed=seed, noise=noise, variant=current().variant, seconds=stage.seconds)
    return RigScan(scene=scene, scans=scans, run=run)


def _part(scene: Scene, pair: Pair) -> Scene:
    """Return the scene of a pair, which messages and titles call by its devices too."""
    one = scene.pair(pair)
    return one if one is scene else replace(one, name=f"{scene.name} {'-'.join(pair)}")


def _within(progress: Callable[[float], None], done: int, count: int) -> Callable[[float], None]:
    """Return what is told of one of several parts of a stage."""
    return lambda fraction: progress((done + fraction) / count)
