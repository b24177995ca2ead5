"""Traced light and ground truth, kept for scenes that share them.

Light transport depends on objects, materials, optics and poses, bounces, light from around and
samples.
It does not depend on detector, exposure, vibration, patterns (but for the axes that they vary
along) and on what the panel makes of a value (bit depth, response): scenes that differ in these
alone are seen in the same light.  Ground truth depends on objects and rig alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

from slbench.core.colour import BANDS
from slbench.rig import Rig
from slbench.scene.model import Scene, SceneObject
from slbench.scene.surfaces.materials import Material
from slbench.scene.truth import GroundTruth
from slbench.simulate.colour import ColourTransport
from slbench.simulate.stack import traced
from slbench.simulate.transport import LightTransport, Marginal


def light_key(scene: Scene) -> Hashable:
    """Return what a scene's light transport depends on, but for axes and seed.

    Scenes of equal keys have the same light, also where each was read from a file of its own.
    """
    if scene.colour is not None:
        return tuple(light_key(scene.in_band(band)) for band in BANDS)
    return (truth_key(scene), tuple(map(_seen, scene.rigs)), repr(vars(scene.light)), scene.samples)


def truth_key(scene: Scene) -> Hashable:
    """Return what a scene's ground truth depends on."""
    return (tuple(map(_shape, scene.objects)), _seen(scene.rig))


def _seen(rig: Rig) -> Hashable:
    """Return a rig without what comes before the panel's light and after the lens."""
    camera = replace(rig.camera, fill_factor=1.0)
    projector = rig.projector.linear()
    poses = [device.pose for device in (camera, projector)]
    where = b"".join(p.rotation.tobytes() + p.position.tobytes() for p in poses)
    values = [
        repr([(k, vars(v) if k == "lens" else v) for k, v in vars(device).items() if k != "pose"])
        for device in (camera, projector)
    ]
    return where, tuple(values)


def _shape(item: SceneObject) -> Hashable:
    mesh = item.artefact.mesh
    corners = [one for one in (mesh.uv, mesh.albedo, mesh.normals) if one is not None]
    held = b"".join(array.tobytes() for array in (mesh.vertices, mesh.faces, *corners))
    digest = hashlib.sha256(held).digest()
    parts = repr((item.artefact.kind, item.artefact.parameters))
    where = item.pose.rotation.tobytes() + item.pose.position.tobytes()
    looks = tuple((part, _look(item.material_of(part))) for part in item.artefact.parts)
    return digest, parts, where, looks


def _look(material: Material) -> str:
    return repr(material.bsdf)  # its class, its numbers, digests of its pictures


class Lights:
    """Light and truth of scenes, traced when they are first asked for.

    Parameters
    ----------
    seed : int
        Of the Monte Carlo samples.
    kept : int
        How many are kept, those asked for last: light is large.

    Attributes
    ----------
    traces : int
        How often light was traced.
    """

    def __init__(self, seed: int = 0, kept: int = 1) -> None:
        self.seed = seed
        self.traces = 0
        self._kept = kept
        self._lights: dict[Hashable, tuple[LightTransport, ...]] = {}
        self._truths: dict[Hashable, GroundTruth] = {}

    def traced(
        self,
        scene: Scene,
        axes: tuple[Marginal, ...] | None = None,
        on_progress: Callable[[float], None] | None = None,
    ) -> tuple[LightTransport, ...]:
        """Return the light of a scene at each of its focus settings; once where it has none.

        Parameters
        ----------
        scene : Scene
        axes : tuple of {"u", "v", "uv"}, optional
            Marginals to have, by default what the scene's patterns vary along.
        on_progress : callable, optional
            Called with the finished fraction, where light is traced.
        """
        wanted = scene.sequence.variations if axes is None else axes
        key = light_key(scene)
        held = self._lights.get(key)
        have: tuple[Marginal, ...] = () if held is None else tuple(held[0].marginals)
        if held is None or not set(wanted) <= set(have):
            both = tuple(dict.fromkeys((*have, *wanted)))
            held = traced(scene, both, seed=self.seed, on_progress=on_progress)
            self.traces += 1
        self._keep(self._lights, key, held)
        if scene.colour is not None:  # which mixes what was traced
            bands = [one.bands for one in held if isinstance(one, ColourTransport)]
            return tuple(ColourTransport.of(each, scene.colour) for each in bands)
        return held

    def put(self, scene: Scene, transports: tuple[LightTransport, ...]) -> None:
        """Take light of a scene that is at hand."""
        self._keep(self._lights, light_key(scene), transports)

    def truth(self, scene: Scene) -> GroundTruth:
        """Return the ground truth of a scene."""
        from slbench.simulate.render.groundtruth import ground_truth

        key = truth_key(scene)
        held = self._truths.get(key)
        if held is None:
            held = ground_truth(scene.objects, scene.rig)
        self._keep(self._truths, key, held)
        return held

    def _keep(self, held: dict[Hashable, Any], key: Hashable, value: Any) -> None:
        held.pop(key, None)
        held[key] = value
        while len(held) > self._kept:
            del held[next(iter(held))]
