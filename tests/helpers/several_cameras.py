"""Rigs of several cameras about a projector, and what they decode of analytic surfaces."""

from dataclasses import dataclass, replace

import numpy as np

from slbench.patterns import PhaseMap
from slbench.rig import Camera, Lens, Pair, Pose, Projector, Rig

DOWN = (0.0, -1.0, 0.0)
PANEL = (320, 240)


def camera_at(x, y=0.0, z=400.0, size=(40, 30), pitch=0.08, **more):
    camera = Camera(*size, (pitch, pitch), Lens(16.0), **more)
    return camera.posed(Pose.looking_at((x, y, z), (0.0, 0.0, 0.0), DOWN))


def projector_at(x, y=0.0, z=420.0, **more):
    projector = Projector(*PANEL, (0.02, 0.02), Lens(28.0), **more)
    return projector.posed(Pose.looking_at((x, y, z), (0.0, 0.0, 0.0), DOWN))


def mirrored(**more):
    """Return two equal cameras to either side of a projector."""
    cameras = {"left": camera_at(-150.0, **more), "right": camera_at(150.0, **more)}
    return Rig(cameras, {"main": projector_at(0.0)})


@dataclass(frozen=True)
class Plate:
    """A rectangle in a plane z = z0 + a x, as wide as x and y reach."""

    z0: float = 0.0
    a: float = 0.0
    x: tuple[float, float] = (-np.inf, np.inf)
    y: tuple[float, float] = (-np.inf, np.inf)

    def distance(self, origins, directions):
        across = directions[..., 2] - self.a * directions[..., 0]
        t = (self.z0 + self.a * origins[..., 0] - origins[..., 2]) / across
        hit = origins + t[..., None] * directions
        inside = (hit[..., 0] >= self.x[0]) & (hit[..., 0] <= self.x[1])
        inside &= (hit[..., 1] >= self.y[0]) & (hit[..., 1] <= self.y[1])
        return np.where(inside & (t > 0), t, np.inf)

    def normals(self, points):
        normal = np.array([-self.a, 0.0, 1.0])
        return np.broadcast_to(normal / np.linalg.norm(normal), points.shape)


@dataclass(frozen=True)
class Ball:
    """A sphere about the origin, moved along z."""

    radius: float = 30.0
    z: float = -20.0

    def distance(self, origins, directions):
        o = origins - [0.0, 0.0, self.z]
        b = np.sum(o * directions, axis=-1)
        root = b**2 - np.sum(o * o, axis=-1) + self.radius**2
        with np.errstate(invalid="ignore"):
            t = -b - np.sqrt(root)
        return np.where(root > 0, t, np.inf)

    def normals(self, points):
        return (points - [0.0, 0.0, self.z]) / self.radius


def hit(surfaces, origins, directions):
    """Return the distances to the first surface, and which it is."""
    all_of = np.stack([one.distance(origins, directions) for one in surfaces])
    return all_of.min(axis=0), all_of.argmin(axis=0)


def seen_from(device, surfaces, points):
    """Return whether a device sees points of surfaces: nothing is before them, and in its field."""
    pixels = device.project(points)
    origins, directions = device.unproject(np.nan_to_num(pixels))
    distance = np.linalg.norm(points - origins, axis=-1)
    return device.contains(np.nan_to_num(pixels, nan=-9.0)) & (
        hit(surfaces, origins, directions)[0] > distance - 1e-6
    )


def truth(rig, pair, surfaces):
    """Return the points (V, U, 3) that a camera's pixels see, and which a projector lights."""
    camera, projector = rig.cameras[pair.camera], rig.projectors[pair.projector]
    origins, directions = camera.unproject(camera.pixel_grid())
    distance, _ = hit(surfaces, origins, directions)
    points = origins + np.where(np.isfinite(distance), distance, np.nan)[..., None] * directions
    lit = np.isfinite(distance)
    lit[lit] = seen_from(projector, surfaces, points[lit])
    return points, lit


def phases(rig, surfaces, sigma=0.02, axes="u", seed=None, pairs=None):
    """Return panel coordinates by pair, with Gaussian noise unless there is no seed."""
    rng = None if seed is None else np.random.default_rng(seed)
    found = {}
    for pair in pairs or rig.pairs:
        points, lit = truth(rig, pair, surfaces)
        own = sigma[pair.camera] if isinstance(sigma, dict) else sigma
        panel = rig.projectors[pair.projector].project(points)
        if rng is not None:
            panel = panel + rng.normal(0.0, own, panel.shape)
        none = np.where(lit, 0.0, np.nan)
        found[pair] = PhaseMap(
            {axis: panel[..., "uv".index(axis)] + none for axis in axes},
            dict.fromkeys(axes, own + none),
            np.full(lit.shape, 50.0, np.float32),
            np.full(lit.shape, 100.0, np.float32),
            lit,
        )
    return found


def with_wrong(phase, block, by):
    """Return a phase map whose coordinates are off in a block of pixels."""
    coordinate = {axis: values.copy() for axis, values in phase.coordinate.items()}
    for values in coordinate.values():
        values[block] += by
    return replace(phase, coordinate=coordinate)


LEFT, RIGHT = Pair("left", "main"), Pair("right", "main")
