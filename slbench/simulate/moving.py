"""Light of what moves: pictures that see other poses, smeared over their exposure.

A picture is the mean of the radiance at poses within its exposure, each traced anew.  All have the
same Monte Carlo samples, so that sampling noise does not masquerade as motion.  Poses follow one
another by at most :data:`STEP_PX` of motion, in pixels of camera and panel.  A pixel blurs as much
as four steps: in the mean of fringes of ten pixels, steps are off by 0.1 % of their contrast.

*Global shutter.*  The exposure is divided evenly, and the middles of the parts are traced.

*Rolling shutter.*  Each row has an exposure of its own.  Poses cover the exposures of all rows;
between two of them radiance is taken to be linear in time, which is off by 0.3 % of the contrast of
such fringes at most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.patterns import PatternSequence
from slbench.rig.device import Device
from slbench.rig.motion import FrameTiming
from slbench.scene.model import Scene
from slbench.simulate.frame_errors import FrameErrors
from slbench.simulate.transport import LightTransport, Marginal

Array = NDArray[np.float64]
#: Frame indices and their radiance: rows of the picture are the last axis but one.
Batch = tuple[NDArray[np.intp], NDArray[np.float32]]

#: Motion between the poses of a picture, px.
STEP_PX = 0.25
#: Poses of a picture beyond which its motion is a slip: it crosses a fringe of any use.
MOST_POSES = 256
#: Points of an object by which its motion is judged.
_MOST_POINTS = 4000


class MovingLight:
    """Radiance of a moving scene's pictures.

    Parameters
    ----------
    scene : Scene
    trace : callable
        Returns the light transport of a scene at rest, with marginals.
    step_px : float
        Motion between the poses of a picture.
    """

    def __init__(
        self,
        scene: Scene,
        trace: Callable[[Scene, tuple[Marginal, ...]], LightTransport],
        step_px: float = STEP_PX,
    ) -> None:
        self.scene = scene
        self._trace = trace
        self._step_px = step_px
        self._kept: tuple[Any, list[Batch]] | None = None

    def timing(self, exposure_s: float) -> FrameTiming:
        """Return when pictures are taken."""
        return self.scene.exposure.timing(exposure_s)

    def batches(
        self,
        sequence: PatternSequence,
        exposure_s: float,
        errors: FrameErrors | None,
        relight: Callable[[LightTransport, Sequence[int]], Iterable[Batch]],
    ) -> Iterator[Batch]:
        """Yield the radiance of all pictures, in the order in which a still scene's come.

        Without frame errors, which differ from scan to scan, they are kept for the next scan.

        Parameters
        ----------
        sequence : PatternSequence
        exposure_s : float
        errors : FrameErrors or None
        relight : callable
            Returns radiance of pictures, by a light transport and their indices.
        """
        key = sequence, exposure_s
        if errors is None and self._kept is not None and self._kept[0] == key:
            yield from ((indices, radiance.copy()) for indices, radiance in self._kept[1])
            return
        found: list[Batch] = []
        for batch in self._traced(sequence, exposure_s, errors, relight):
            if errors is None:
                found.append((batch[0], batch[1].copy()))
            yield batch
        if errors is None:
            self._kept = key, found

    def _traced(
        self,
        sequence: PatternSequence,
        exposure_s: float,
        errors: FrameErrors | None,
        relight: Callable[[LightTransport, Sequence[int]], Iterable[Batch]],
    ) -> Iterator[Batch]:
        n_pictures = -(-sequence.n_frames // sequence.channels)
        middles = self.timing(exposure_s).middles(n_pictures, sequence.middle_picture)
        poses = self.poses(exposure_s)
        order = [sequence.frames_along(along) // sequence.channels for along in sequence.variations]
        for picture in dict.fromkeys(np.concatenate(order).tolist()):
            shown = [picture] if errors is None else [k for k, _ in errors.seen_in(picture)]
            axes = _variations(sequence, [picture, *shown])
            sums: dict[bytes, Batch] = {}
            for delay, rows in zip(poses.delays_s, poses.shares.T, strict=True):
                light = self._trace(self.scene.at(middles[picture] + delay), axes)
                share = rows.astype(np.float32)[:, np.newaxis]
                for indices, radiance in relight(light, [picture]):
                    key = indices.tobytes()
                    before = sums.get(key)
                    radiance *= share
                    sums[key] = (indices, radiance if before is None else before[1] + radiance)
            yield from sums.values()

    def poses(self, exposure_s: float) -> Poses:
        """Return at which poses a picture of an exposure is traced.

        Raises
        ------
        InputError
            For motion that smears a picture beyond use.
        """
        exposure = self.scene.exposure
        opened, rolling = exposure.open_s(exposure_s), exposure.rolling_shutter_s
        moved = speed_px(self.scene, opened + rolling) * (opened + rolling)
        count = max(1, ceil(moved / self._step_px - 1e-9))
        if count > MOST_POSES:
            expected = f"motion of at most {MOST_POSES * self._step_px:g} px within a picture"
            got = f"{moved:.4g} px in {1e3 * (opened + rolling):.4g} ms"
            raise InputError(f"scene {self.scene.name}: exposure", expected, got)
        rows = self.scene.rig.camera.height
        if rolling == 0.0 or count == 1:
            return Poses(opened * ((np.arange(count) + 0.5) / count - 0.5), _even(rows, count))
        delays = (opened + rolling) * (np.arange(count + 1) / count - 0.5)
        middles = FrameTiming(period_s=1.0, rolling_s=rolling).delays(rows)
        return Poses(delays, _linear(delays, middles - 0.5 * opened, opened))


@dataclass(frozen=True, eq=False)
class Poses:
    """At which times a picture is traced, and what of each its rows see.

    Parameters
    ----------
    delays_s : (n,) float
        After the middle of the picture.
    shares : (V, n) float
        Of each row's light; they sum up to one.
    """

    delays_s: Array
    shares: Array


def _even(rows: int, count: int) -> Array:
    return np.full((rows, count), 1.0 / count)


def _linear(delays: Array, begins: Array, lasting: float) -> Array:
    """Return weights (V, n) of the mean over a time of what is linear between times (n,)."""
    width = delays[1] - delays[0]

    def until(time: Array) -> Array:
        """Return the integrals up to a time of functions that are one at their own time alone."""
        x = np.clip((time[:, np.newaxis] - delays) / width, -1.0, 1.0)
        return np.asarray(width * (0.5 + x - 0.5 * x * np.abs(x)))

    whole = until(begins + lasting) - until(begins)
    return np.asarray(whole / whole.sum(axis=1, keepdims=True))


def speed_px(scene: Scene, within_s: float) -> float:
    """Return the largest speed of a scene's objects on sensor and panel, px/s.

    Of what camera or projector see; of all there is where they see no corner of it.

    Parameters
    ----------
    scene : Scene
    within_s : float
        Time about the middle of the scan over which it is a mean.
    """
    fastest = 0.0
    for item in scene.objects:
        vertices = item.artefact.mesh.vertices
        some = vertices[:: max(1, -(-len(vertices) // _MOST_POINTS))]
        corners = item.pose.to_world(np.concatenate((some, item.artefact.mesh.bounds)))
        path = scene.path_of(item)
        ends = [path(time).to_world(corners) for time in (-0.5 * within_s, 0.5 * within_s)]
        for device in (*scene.rig.cameras.values(), *scene.rig.projectors.values()):
            fastest = max(fastest, _travel_px(device, ends) / within_s)
    return fastest


def _travel_px(device: Device, ends: Sequence[Array]) -> float:
    """Return the longest way of points on a sensor or panel, px."""
    with np.errstate(invalid="ignore", divide="ignore"):
        places = [device.project(points) for points in ends]
        way = np.linalg.norm(places[1] - places[0], axis=1)
        seen = np.isfinite(way) & (device.contains(places[0]) | device.contains(places[1]))
    known = way[seen] if seen.any() else way[np.isfinite(way)]
    return float(known.max(initial=0.0))


def _variations(sequence: PatternSequence, pictures: Sequence[int]) -> tuple[Marginal, ...]:
    """Return what the frames of pictures vary along."""
    return tuple(
        along
        for along in sequence.variations
        if np.isin(sequence.frames_along(along) // sequence.channels, pictures).any()
    )


def still(scene: Scene) -> Scene:
    """Return the scene with nothing that moves, and pictures of no particular time."""
    exposure = replace(scene.exposure, frame_period_s=None, rolling_shutter_s=0.0, pulse_s=None)
    return replace(scene.at_rest(), exposure=exposure)


def check_motion(scene: Scene) -> None:
    """Check that a scene's motion can be, before light is traced.

    Raises
    ------
    InputError
        For a pinhole whose exposure time is not known and matters, and several motions of which one
        is to be taken out.
    """
    if scene.compensate == "known" and scene.moves:
        _ = scene.common_path
    exposure = scene.exposure
    stated = exposure.pulse_s is not None and exposure.frame_period_s is not None
    if stated or not scene.moves:
        return
    for camera in scene.rig.cameras.values():
        if exposure.time_s is None and not np.isfinite(camera.lens.f_number):
            key = "frame_period_ms" if exposure.frame_period_s is None else "pulse_ms"
            expected = "stated with a pinhole, whose exposure time is not known, where objects move"
            raise InputError(f"exposure.{key}", expected, "nothing")
