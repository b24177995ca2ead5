"""The lit surface of a scene with several cameras, by rays that see it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from slbench.rig import Camera, Pair
from slbench.scene.lit import UNSEEN, LitSurface
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth

Array = NDArray[np.float64]

#: Sine of the angle to a place's tangent plane up to which the point of the nearest pixel is of
#: the same surface: beside an edge that pixel may meet what stands before it.
_FLAT = 0.5


def lit_surface(scene: Scene, truths: Mapping[Pair, GroundTruth]) -> LitSurface:
    """Return what of the lit surface the cameras of a scene see, each place once.

    Whether a camera sees the point of another one's pixel is asked of a ray between them.

    Parameters
    ----------
    scene : Scene
    truths : mapping of Pair to GroundTruth
        Of all pairs.
    """
    from slbench.simulate.render.translate import geometry
    from slbench.simulate.render.ways import free_view

    shapes, cameras = geometry(scene.objects), scene.rig.cameras
    of_camera = {pair.camera: truth for pair, truth in truths.items()}
    lit = {
        name: np.logical_or.reduce([one.lit for pair, one in truths.items() if pair.camera == name])
        for name in cameras
    }
    parts: dict[str, list[NDArray[np.int64]]] = {name: [] for name in cameras}
    for k, (name, truth) in enumerate(of_camera.items()):
        own = np.flatnonzero(lit[name])
        point, normal = (one.reshape(-1, 3)[own] for one in (truth.point, truth.normal))
        hit = np.ones(len(own), np.bool_)
        seen = {name: hit}
        pixels = {name: own}
        for other, camera in cameras.items():
            if other != name:
                with np.errstate(invalid="ignore"):
                    inside = camera.contains(camera.project(point))
                seen[other] = inside & free_view(shapes, camera, point, normal, hit)
                theirs = of_camera[other], lit[other]
                pixels[other] = _nearest(camera, point, normal, seen[other], *theirs)
        before = list(cameras)[:k]
        new = ~np.logical_or.reduce([seen[one] for one in before]) if before else hit
        for one, found in pixels.items():
            parts[one].append(found[new])
    return LitSurface({name: np.concatenate(found) for name, found in parts.items()})


def _nearest(
    camera: Camera,
    point: Array,
    normal: Array,
    seen: NDArray[np.bool_],
    truth: GroundTruth,
    lit: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Return the pixels whose own points are beside points that a camera sees."""
    found = np.full(len(point), UNSEEN, np.int64)
    u, v = np.rint(camera.project(point[seen])).astype(np.intp).T
    apart = truth.point[v, u] - point[seen]
    with np.errstate(invalid="ignore"):
        off = np.abs(np.sum(apart * normal[seen], axis=1))
        beside = lit[v, u] & (off <= _FLAT * np.linalg.norm(apart, axis=1))
    found[seen] = np.where(beside, v * camera.width + u, UNSEEN)
    return found
