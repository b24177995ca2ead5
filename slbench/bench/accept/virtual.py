"""A virtual scanner: the light of a standard in each of its places, and measurements in it.

Light is traced once a place and view.  Rig that measures, noise and certificate may differ from
measurement to measurement in the same light.  Which pixels belong to a ball or a plate is told by
the true surface, as an operator marks them in a picture: those that face both devices and have
no edge beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slbench.bench.accept.evaluate import Measured, Place, measured_place
from slbench.bench.accept.registering import Register, registered
from slbench.bench.accept.surfaces import Points, lines_of
from slbench.calibration.models.model import CalibrationModel
from slbench.cloud.triangulation import Axis, PointCloud
from slbench.core.errors import located
from slbench.core.random import tagged_seed
from slbench.objects import PlaneFeature
from slbench.rig import Pose, Rig
from slbench.scene.model import Scene, SceneObject
from slbench.scene.truth import GroundTruth
from slbench.score.features import MAX_INCIDENCE
from slbench.score.residuals import facing
from slbench.simulate.floors import halves, noise_free_coordinates
from slbench.simulate.lights import Lights
from slbench.simulate.reconstruct import joining_motion, reconstruct
from slbench.simulate.stack import capture_stack
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]

#: Distance of a point from a ball's surface, as a share of its radius, that its mesh's facets and
#: its stem are told apart by.
_ON = 0.01
#: Second differences of the panel coordinate, px, that tell an edge from a ball of few pixels.
_SMOOTH_PX = 1.0


@dataclass(frozen=True, eq=False)
class Light:
    """Stored light of a place, a view each.

    Parameters
    ----------
    place : Place
    scenes : tuple of Scene
        With the standard in the place of each view.
    transports : tuple of tuple of LightTransport
        Of each view, one a focus setting.
    pixels : tuple of tuple of (V, U) bool
        Of each view, those of each ball or of the plate.
    half_px : tuple of dict of axis to (V, U) float
        Of each view, what half of the renderer's samples would change of the coordinates.
    """

    place: Place
    scenes: tuple[Scene, ...]
    transports: tuple[tuple[LightTransport, ...], ...]
    pixels: tuple[tuple[NDArray[np.bool_], ...], ...]
    half_px: tuple[dict[Axis, Array], ...]


def light_of(
    scene: Scene, place: Place, lights: Lights, on_progress: Callable[[float], None] | None = None
) -> Light:
    """Trace a standard in its place, once a view.

    Parameters
    ----------
    scene : Scene
        Its objects are left out; the material of the first is the standard's.
    place : Place
    lights : Lights
        Light that is at hand.
    on_progress : callable, optional
    """
    artefact, material = place.standard.artefact(), scene.objects[0].material
    scenes, transports, pixels, half = [], [], [], []
    for k, pose in enumerate(place.poses):
        one = replace(scene, objects=(SceneObject(artefact, pose, material),))

        def progress(part: float, done: int = k) -> None:
            if on_progress:
                on_progress((done + part) / len(place.poses))

        transports.append(lights.traced(one, on_progress=progress))
        pixels.append(_pixels(one, pose, lights.truth(one)))
        half.append(_half_px(one, transports[-1]))
        scenes.append(one)
    return Light(place, tuple(scenes), tuple(transports), tuple(pixels), tuple(half))


def measure(
    light: Light,
    *,
    seed: int = 0,
    noise: bool = True,
    rig: Rig | None = None,
    register: Register = "poses",
) -> Measured:
    """Measure a place in its stored light.

    Parameters
    ----------
    light : Light
    seed : int
        Of the noise.
    noise : bool
    rig : Rig, optional
        That measures; by default what the scene is measured with.
    register : {"poses", "spheres"}
        How views are registered: by the poses of the standard, or by its balls.  Poses are in the
        scene's world, to which points of another rig or a model are brought first.

    Raises
    ------
    InputError
        Naming the place, where too little of the standard was measured, and where what measures
        cannot be brought to the scene's world.
    """
    views, motion = [], None
    if len(light.scenes) > 1 and register == "poses":
        motion = _to_scene(light.scenes[0], rig, seed)
    for k, scene in enumerate(light.scenes):
        used = scene
        if rig is not None:
            used = replace(scene, rig=rig, calibration=None)
        stack = capture_stack(
            scene, light.transports[k], seed=tagged_seed(seed, k) if k else seed, noise=noise
        )
        phase = stack.fuse().decode()
        cloud = reconstruct(used, phase, seed=seed).cloud
        parts = [points_of(cloud, own, light.half_px[k]) for own in light.pixels[k]]
        if motion is not None:
            parts = [part.moved(motion.rotation, motion.position) for part in parts]
        views.append(parts)
    return measured_place(light.place, registered(light.place, views, register))


def _to_scene(scene: Scene, rig: Rig | None, seed: int) -> Pose | None:
    """Return the motion from the world of what measures to the scene's, in which poses are.

    None where points come out in the scene's world.
    """
    made, axes = scene.calibration, scene.sequence.axes
    if rig is scene.rig or (rig is None and (made is None or made.align)):
        return None
    measures: Rig | CalibrationModel
    if rig is not None:
        measures = rig
    else:
        assert made is not None
        measures = made.model or made.rig_for(scene.rig, seed)
    with located(f"scene {scene.name}: calibration"):
        return joining_motion(scene, measures, axes)


def points_of(
    cloud: PointCloud, pixels: NDArray[np.bool_], half_px: Mapping[Axis, Array] | None = None
) -> Points:
    """Return the points of some pixels of a cloud, with their predicted noise.

    Parameters
    ----------
    cloud : PointCloud
    pixels : (V, U) bool
    half_px : mapping of axis to (V, U) float, optional
        What half of the renderer's samples would change of the panel coordinates, px.
    """
    u, v = cloud.pixels.T
    own = pixels[v, u]
    sensitivity = cloud.sensitivity[own]
    sampling = None
    if half_px:
        shift = np.stack([half_px[axis][v[own], u[own]] for axis in cloud.axes], axis=-1)
        sampling = np.einsum("na,nai->ni", np.nan_to_num(shift), sensitivity)
    return Points(
        cloud.points[own],
        sensitivity * cloud.sigma_px[own][..., None],
        lines_of(cloud.pixels[own], cloud.axes),
        sampling_mm=sampling,
    )


def _half_px(scene: Scene, transports: tuple[LightTransport, ...]) -> dict[Axis, Array]:
    """Return what half of the samples would change of each pixel's coordinates, px."""
    half = halves(transports)
    if half is None:
        return {}
    weights = None
    if scene.focus is not None:
        weights = capture_stack(scene, transports, noise=False).weights()
    whole, part = (
        noise_free_coordinates(one, scene.sequence, scene.rig.projector, weights)
        for one in (list(transports), half)
    )
    return {axis: part[axis] - whole[axis] for axis in whole}


def _pixels(scene: Scene, pose: Pose, truth: GroundTruth) -> tuple[NDArray[np.bool_], ...]:
    """Return the pixels of each ball, or of the plate, that are fitted."""
    smooth = truth.smooth(_SMOOTH_PX)
    seen = smooth.copy()
    seen[smooth] = facing(scene.rig, truth.point[smooth], truth.normal[smooth], MAX_INCIDENCE)
    found = []
    for feature in scene.objects[0].artefact.features:
        own = seen.copy()
        local = pose.to_local(truth.point[seen])
        if isinstance(feature, PlaneFeature):
            if len(scene.objects[0].artefact.spheres):
                continue
            own[seen] = feature.contains(local) & (np.abs(local[:, 2] - feature.z_mm) < 1e-6)
        else:
            off = np.linalg.norm(local - feature.centre_mm, axis=-1) / feature.radius_mm - 1.0
            own[seen] = np.abs(off) < _ON
        found.append(own)
    return tuple(found)
