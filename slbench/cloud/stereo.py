"""Stereo of two cameras on phase: the projector codes the surface and need not be calibrated.

A projector gives each place on the surface a code of its own.  Where both cameras read the same
one their rays meet, whatever the projector's lens, place, or response: what it does to the code it
does for both.  A pixel of the first camera is matched in two steps.

1. Rays that meet lie in one plane through the line between the cameras.  Each pixel of the second
   camera has such a plane's angle and a coordinate; the nearest in both, in pixels, is the start.
   Distortion makes epipolar lines curves, and needs no rectification here.  Where pixels far from
   each other are as near, the match is ambiguous and the pixel has no point.
2. Along the ray o + t d the second camera's coordinate is that of its picture p(t) of the point,
   between its pixels (:mod:`slbench.cloud.between`): Gauss and Newton's method solves
   U(p(t)) = u in the least-squares sense of all coded axes.

The point is on the first camera's ray, whose pixel is exact, and its picture in the second camera
on the epipolar curve: both rays meet, so that there is nothing left for an optimal correction
(Hartley and Sturm, "Triangulation", Computer Vision and Image Understanding 68(2), 1997) to do.
Its variance is that of both coordinates over the square of how fast they part along the ray,

    sigma_t^2 = 1 / sum_a [(grad U_a . dp/dt)^2 / (sigma_a^2 + s_a^2)],

sigma of the pixel and s of the place.  A long baseline, not a fine pattern alone, makes it small.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.between import PanelField
from slbench.cloud.joint import LIMIT, JointCloud, agreement
from slbench.cloud.triangulation import Axis
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.validation.types import Positive
from slbench.core.validation.values import checked
from slbench.patterns import PhaseMap
from slbench.rig import Camera, Pair, Rig

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Neighbours that are looked at, and pixels within which they are one match.
_NEIGHBOURS, _APART_PX = 4, 3.0
#: Pixels that a start may be off by: the nearest of a grid is within 0.71; surfaces stretch it.
_START_PX = 2.0
#: Pixels that the refined place may be from its start, and its last step.
_MOVED_PX, _LAST_PX = 4.0, 1e-6
_STEPS = 12
_EXACT_PX = 1e-9


@checked
def triangulate_stereo(
    rig: Rig, phases: Mapping[str, PhaseMap], limit: Positive = LIMIT
) -> JointCloud:
    """Triangulate what two cameras read of one projector's patterns; projectors are not used.

    Parameters
    ----------
    rig : Rig
        Of the cameras; its projectors, if it has any, are ignored.
    phases : mapping of str to PhaseMap
        Panel coordinates by camera, of two cameras and the same projector and patterns.
    limit : float
        Standard deviations within which two coded axes agree on a point, as of
        :func:`~slbench.cloud.joint.triangulate_jointly`.

    Returns
    -------
    JointCloud
        A point for each pixel of the first camera that the second one sees, in the order of
        pixels; `rays` are two each.  Columns are the axes of both cameras' coordinates, their
        `pairs` under the name "projector".

    Raises
    ------
    InputError
        Unless there are two cameras of the rig, whose maps have their sizes and the same axes.
    """
    for name in phases:
        if name not in rig.cameras:
            expected = f"cameras of the rig: {', '.join(rig.cameras)}"
            raise InputError("phase maps", expected, quoted(name, list(rig.cameras)))
    if len(phases) != 2:
        raise InputError("phase maps", "those of two cameras", ", ".join(phases) or "none")
    for name, phase in phases.items():
        camera = rig.cameras[name]
        rows, columns = phase.mask.shape
        if (columns, rows) != (camera.width, camera.height):
            expected = f"the camera's {camera.width} x {camera.height} px"
            raise InputError(f"phase map of {name}", expected, f"{columns} x {rows} px")
    (first, second), maps = phases, list(phases.values())
    axes: tuple[Axis, ...] = tuple(maps[0].coordinate)
    if set(axes) != set(maps[1].coordinate) or not axes:
        expected = f"the coded axes of {first}: {', '.join(axes) or 'one at least'}"
        raise InputError(
            f"phase map of {second}", expected, ", ".join(maps[1].coordinate) or "none"
        )
    one, two = _Coordinates(maps[0], axes), _Coordinates(maps[1], axes)
    cameras = rig.cameras[first], rig.cameras[second]
    index, place = _starts(*cameras, one, two)
    pixels, panel, sigma = one.pixels[index], one.panel[index], one.sigma[index]
    origins, directions = cameras[0].unproject(pixels)
    distance = _meeting(cameras[1], origins, directions, place)
    field = PanelField(two.value, two.noise, two.mask)
    begin, step = place, np.full(len(pixels), np.inf)
    for _ in range(_STEPS):
        points = origins + distance[:, None] * directions
        place, by_point = cameras[1].project_with_jacobian(points)
        across = np.einsum("nki,ni->nk", by_point, directions)
        said = field.at(place)
        slope = np.einsum("nak,nk->na", said.gradient, across)
        variance = said.variance + sigma**2
        with np.errstate(invalid="ignore", divide="ignore"):
            information = np.sum(slope**2 / variance, axis=1)
            residual = said.value - panel
            move = -np.sum(slope * residual / variance, axis=1) / information
            # At most a pixel a step: starts may lie where the map bends.
            most = 1.0 / np.linalg.norm(across, axis=1)
            move = np.clip(move, -most, most)
            step = np.abs(move) / most
        if not np.any(step > _LAST_PX):
            break
        distance = distance + np.where(np.isfinite(move), move, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        left = residual**2 / variance
        weight = slope / variance / information[:, None]
        chi = left.sum(axis=1) / (len(axes) - 1) if len(axes) > 1 else np.full(len(pixels), np.nan)
        good = said.good & (step <= _LAST_PX) & np.isfinite(weight).all(axis=1) & (distance > 0.0)
        good &= np.linalg.norm(place - begin, axis=1) < _MOVED_PX
        scale, agree = agreement(residual, np.sqrt(variance), good, limit)
        good &= agree | (len(axes) < 2)
    directions, weight = directions[good, None], weight[good][..., None]
    count = int(np.count_nonzero(good))
    places = np.stack([pixels[good], place[good]], axis=1).astype(np.float32)
    return JointCloud(
        points[good],
        pixels[good],
        maps[0].mask.shape,
        (*axes, *axes),
        np.hstack((sigma[good], np.sqrt(said.variance[good]))),
        np.concatenate((weight * directions, -weight * directions), axis=1),
        pairs=tuple(Pair(name) for name in phases for _ in axes),
        camera=np.zeros(count, np.int8),
        shapes={name: phase.mask.shape for name, phase in phases.items()},
        rays=np.full(count, 2, np.int8),
        chi_square=chi[good],
        places=places,
        disagreement={} if len(axes) < 2 else {(Pair(first), Pair(second)): scale},
    )


class _Coordinates:
    """A phase map as stacks and as lists of its measured pixels."""

    def __init__(self, phase: PhaseMap, axes: tuple[Axis, ...]) -> None:
        self.mask = phase.mask
        self.value = np.stack([phase.coordinate[axis] for axis in axes])
        self.noise = np.maximum(np.stack([phase.sigma[axis] for axis in axes]), _EXACT_PX)
        v, u = np.nonzero(self.mask)
        self.pixels = np.column_stack((u, v)).astype(np.int32)
        self.panel, self.sigma = (part[:, v, u].T for part in (self.value, self.noise))


def _starts(
    first: Camera, second: Camera, one: _Coordinates, two: _Coordinates
) -> tuple[NDArray[np.intp], Array]:
    """Return which pixels of the first camera have a match, and its pixel (n, 2) in the second."""
    from scipy.spatial import cKDTree

    none = np.empty(0, np.intp), np.empty((0, 2))
    if not len(one.pixels) or len(two.pixels) < _NEIGHBOURS:
        return none
    angle = _epipolar(first, second)
    own, other = angle(first, one.pixels), angle(second, two.pixels)
    # A pixel's step in the second camera is one, for the angle and for each coordinate.
    spread = [_step(second, lambda pixels: angle(second, pixels))]
    spread += [_step_of_map(value, two.mask) for value in two.value]
    scale = 1.0 / np.maximum(spread, 1e-300)
    tree = cKDTree(np.column_stack((other, two.panel)) * scale)
    apart, near = tree.query(
        np.column_stack((own, one.panel)) * scale, k=_NEIGHBOURS, distance_upper_bound=_START_PX
    )
    found = np.isfinite(apart)
    places = two.pixels[np.where(found, near, 0)].astype(np.float64)
    far = np.linalg.norm(places - places[:, :1], axis=2) > _APART_PX
    kept = np.nonzero(found[:, 0] & ~(far & found).any(axis=1))[0]
    return kept, places[kept, 0]


def _step(camera: Camera, of_pixels) -> float:  # type: ignore[no-untyped-def]
    """Return what a value of a camera's pixels changes by from one to the next, the median."""
    u, v = (np.linspace(0, n - 1, min(n, 16)) for n in (camera.width, camera.height))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    steps = [of_pixels(pixels + 0.5 * e) - of_pixels(pixels - 0.5 * e) for e in np.eye(2)]
    return float(np.median(np.hypot(*steps)))


def _step_of_map(value: Array, mask: Mask) -> float:
    """Return what a map changes by from one measured pixel to the next, the median."""
    along_u = np.abs(np.diff(value, axis=1))[mask[:, 1:] & mask[:, :-1]]
    along_v = np.abs(np.diff(value, axis=0))[mask[1:] & mask[:-1]]
    return float(max(np.median(one) if len(one) else 0.0 for one in (along_u, along_v))) or 1.0


def _epipolar(first: Camera, second: Camera):  # type: ignore[no-untyped-def]
    """Return what tells planes that hold rays of both cameras apart, a function of pixels.

    Such planes hold the line between two centres; a telecentric lens has its centre infinitely
    far along its axis, and where both have they are parallel.
    """
    far = [camera.lens.kind == "telecentric" for camera in (first, second)]
    axes = [camera.pose.rotation[:, 2] for camera in (first, second)]
    if all(far):
        normal = np.cross(axes[0], axes[1])
        if np.linalg.norm(normal) < 1e-9:
            raise InputError("rig devices", "two cameras that look along different lines", "one")
        normal /= np.linalg.norm(normal)
        return lambda camera, pixels: camera.unproject(pixels)[0] @ normal
    centre = (second if far[0] else first).pose.position
    line = axes[far.index(True)] if any(far) else second.pose.position - first.pose.position
    if np.linalg.norm(line) < 1e-9:
        raise InputError("rig devices", "two cameras in different places", "one place")
    line = line / np.linalg.norm(line)
    # Zero in the middle of what the cameras look at, away from where angles turn over.
    middle = sum(axes) - (sum(axes) @ line) * line
    if np.linalg.norm(middle) < 1e-9:
        raise InputError("rig devices", "cameras that look beside each other", "at each other")
    middle /= np.linalg.norm(middle)
    side = np.cross(line, middle)

    def angle(camera: Camera, pixels: Array) -> Array:
        origins, directions = camera.unproject(pixels)
        away = origins - centre if camera.lens.kind == "telecentric" else directions
        return np.arctan2(away @ side, away @ middle)

    return angle


def _meeting(second: Camera, origins: Array, directions: Array, place: Array) -> Array:
    """Return the distances along rays to where they are nearest to those of a camera's places."""
    others, along = second.unproject(place)
    apart = others - origins
    cosine = np.einsum("ni,ni->n", directions, along)
    one, two = (np.einsum("ni,ni->n", apart, way) for way in (directions, along))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((one - cosine * two) / (1.0 - cosine**2))
