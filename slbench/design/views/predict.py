"""What one view of a part measures, predicted sample by sample of its surface.

A sample is *measured* where it is lit and seen (free ways to both lenses, inside panel and
picture), inside the measurement volume, not at a grazing angle, and decoded, with a standard
deviation that is at most the one asked for.  The deviation is that of the scan's own decoder and
triangulation (:mod:`slbench.design.views.seen`), so that focus, incidence, saturation and the
detector's noise need no limits of their own; grazing angles alone have one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.triangulation import meet
from slbench.design.views.seen import Frames
from slbench.patterns import PhaseMap
from slbench.rig import Pose, Rig
from slbench.scene.model import Scene
from slbench.simulate.expose import shutter_of
from slbench.simulate.viewpoints.samples import SurfaceSamples
from slbench.simulate.viewpoints.views import (
    Counting,
    inside_volume,
    moved,
    within_incidence,
)

Array = NDArray[np.float64]

#: A coordinate is right within so many deviations, and what a panel's pixels do to it.
_SIGMAS, _NEAR_PX = 4.0, 1.0
#: Pixels by which the automatic exposure is chosen.
_PIXELS = 4096


@dataclass(frozen=True, eq=False)
class Prediction:
    """What one view measures of the samples.

    Parameters
    ----------
    seen : (N,) bool
        Lit by the projector and seen by the camera, wherever it is in the world.
    sigma_mm : (N,) float
        Predicted standard deviation of the point by noise; NaN where none is measured.
    """

    seen: NDArray[np.bool_]
    sigma_mm: Array

    def measured(self, max_std_mm: float = np.inf) -> NDArray[np.bool_]:
        """Return a mask (N,) of the samples measured with at most a deviation."""
        with np.errstate(invalid="ignore"):
            return np.isfinite(self.sigma_mm) & (self.sigma_mm <= max_std_mm)


class Predictor:
    """Predicts views of the first object of a scene, the rig in its place.

    Parameters
    ----------
    scene : Scene
        With the part alone, of one camera and one projector.
    samples : SurfaceSamples
        Of the part.
    counting : Counting, optional
        What counts as measured.

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        As :class:`slbench.design.views.seen.Frames`.
    """

    def __init__(
        self, scene: Scene, samples: SurfaceSamples, counting: Counting | None = None
    ) -> None:
        self.scene, self.samples, self.counting = scene, samples, counting or Counting()
        self.place = scene.place
        # Mitsuba is needed from here on, and only here.
        from slbench.simulate.render.lookout import Lookout

        self._frames = Frames(scene)
        # The part stays and the devices move about it: its tree of triangles is built once.
        part = replace(scene.objects[0], pose=Pose())
        self._lookout = Lookout((part,), samples.points, samples.normals)
        self._ambient = np.zeros(len(samples))
        if scene.light.ambient_w_per_mm2 > 0.0:
            self._ambient = self._lookout.albedo() * scene.light.ambient_w_per_mm2 / np.pi
        self._across = _tangents(samples.normals)

    def predict(self, pose: Pose) -> Prediction:
        """Predict the view of the part in a pose in the world."""
        count = len(self.samples)
        rig = moved(self.scene.rig, pose.inverse)
        points = self.samples.points
        pixel, panel = rig.camera.project(points), rig.projector.project(points)
        with np.errstate(invalid="ignore"):
            seen = rig.camera.contains(pixel) & rig.projector.contains(panel)
        for device in (rig.camera, rig.projector):
            seen = self._lookout.seen_by(device, seen)
        sigma = np.full(count, np.nan)
        kept = np.flatnonzero(seen)
        if len(kept):
            found = self._deviations(rig, kept, pixel[kept], panel[kept])
            near = (points[kept], self.samples.normals[kept])
            found[~within_incidence(rig, *near, self.counting.max_incidence_deg)] = np.nan
            if self.counting.within_volume:
                world = pose.to_world(points[kept])
                found[~inside_volume(self.scene.rig, self.place, world)] = np.nan
            sigma[kept] = found
        return Prediction(seen, sigma)

    def _deviations(self, rig: Rig, kept: NDArray[np.intp], pixel: Array, panel: Array) -> Array:
        """Return the deviations of samples that are seen, (n,), mm."""
        points, across = self.samples.points[kept], self._across[kept]
        by_surface = rig.camera.project_with_jacobian(points)[1] @ across
        by_pixel = (
            rig.projector.project_with_jacobian(points)[1] @ across @ np.linalg.inv(by_surface)
        )
        fall_off = rig.camera.relative_illumination(pixel)
        radiance = self._lookout.radiance(rig)[kept] * fall_off
        ambient = self._ambient[kept] * fall_off
        # A sample stands for as many pixels as its area fills.
        pixels = np.cumsum(np.abs(np.linalg.det(by_surface)))
        chosen = np.searchsorted(pixels, (np.arange(_PIXELS) + 0.5) / _PIXELS * pixels[-1])
        scene = self.scene
        lit = radiance[chosen] > 0.0
        if not lit.any():
            return np.full(len(kept), np.nan)
        white = (radiance + ambient)[chosen][lit]
        shutter = shutter_of([white], rig.camera, scene.detector, scene.exposure)
        blur = self._frames.blur(rig, points, by_pixel)
        found = np.full(len(kept), np.nan)
        for factor in scene.exposure.bracket:
            given = (radiance, ambient, shutter.times(factor))
            phase = self._frames.decoded(panel, blur, *given)
            # The longest exposure that does not saturate tells most.
            found = np.fmin(found, _deviation(rig, pixel, panel, phase))
        return found


def _deviation(rig: Rig, pixel: Array, panel: Array, phase: PhaseMap) -> Array:
    """Return the standard deviation of points by that of their panel coordinates, (n,), mm."""
    axes = tuple(phase.coordinate)
    own = np.stack([phase.sigma[axis][0] for axis in axes], axis=1)
    coded = panel[:, ["uv".index(axis) for axis in axes]]
    _, sensitivity = meet(rig, pixel, axes, coded, np.nan_to_num(own, nan=1.0))
    deviation = np.sqrt(np.sum((sensitivity * own[..., np.newaxis]) ** 2, axis=(1, 2)))
    found = np.stack([phase.coordinate[axis][0] for axis in axes], axis=1)
    with np.errstate(invalid="ignore"):  # a fringe order that noise makes wrong is no measurement
        right = np.all(np.abs(found - coded) <= _SIGMAS * own + _NEAR_PX, axis=1)
    return np.where(phase.mask[0] & right, deviation, np.nan)


def _tangents(normals: Array) -> Array:
    """Return two unit vectors across each normal, (N, 3, 2)."""
    least = np.argmin(np.abs(normals), axis=1)
    first = np.cross(normals, np.eye(3)[least])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack((first, np.cross(normals, first)), axis=2)
