"""Places for a standard in the measurement volume of a rig.

A place must lie in the volume, and what is fitted there must face both devices and lie well inside
both pictures.  Among all such places of a grid those are taken that are furthest apart, one after
the other; equal rigs give equal places.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slbench.bench.accept.definitions import LEAST_PLACES, StandardKind
from slbench.bench.accept.evaluate import Place
from slbench.bench.accept.standards import Standard
from slbench.core.errors import InputError
from slbench.objects import PlaneFeature
from slbench.rig import Device, Pose, Rig
from slbench.rig.pose import product
from slbench.score.features import MAX_INCIDENCE
from slbench.score.residuals import facing

Array = NDArray[np.float64]

#: Positions of a grid along each axis of the volume; what is turned as well has enough in fewer.
_GRID: dict[StandardKind, int] = {"sphere": 5, "ball_bar": 3, "plane": 3}
#: Distance of what is fitted from the border of a picture, as a share of its sides.
_BORDER = 0.01
#: Turns of a bar about the volume's z axis, and how steeply it may stand, degrees.
_TURNS, _RISES = np.arange(0.0, 180.0, 22.5), np.array([0.0, 15.0, -15.0, 25.0, -25.0])
#: Tilts of a plate, and about which axes, degrees.
_TILTS, _ABOUT = np.array([0.0, 12.0, 20.0]), np.arange(0.0, 360.0, 45.0)
#: Turns of the second and all further views of a place, degrees about the volume's z axis.
_VIEW_TILT = 15.0
#: What a standard turned by a right angle is worth beside one that is moved by the volume's
#: diagonal.
_TURN_WEIGHT = 0.5
#: Least share of a ball's upper half that must face both devices.
_LEAST_SEEN = 0.25


def plan(rig: Rig, place: Pose, standard: Standard, count: int | None = None) -> list[Place]:
    """Place a standard about the measurement volume.

    Parameters
    ----------
    rig : Rig
        One camera and one projector.
    place : Pose
        Where the volume is, z towards the devices (:attr:`slbench.scene.model.Scene.place`).
    standard : Standard
    count : int, optional
        How many; by default as few as the guideline allows.

    Returns
    -------
    list of Place
        With a pose each.

    Raises
    ------
    InputError
        If fewer places are seen and lit by both devices.
    """
    wanted = LEAST_PLACES[standard.kind] if count is None else count
    body = _Body(standard)
    half = np.array(rig.volume_mm) / 2.0
    poses = [pose for pose in _candidates(standard, half, body) if body.seen(rig, place, pose)]
    if len(poses) < wanted:
        size = f"{standard.kind} of {standard.longest_mm:g} mm"
        raise InputError(
            f"places of a {size}",
            f"at least {wanted} in the volume that both devices see",
            f"{len(poses)}: a smaller standard?",
        )
    chosen = _apart(poses, wanted, float(np.linalg.norm(2.0 * half)), standard)
    return [
        Place(f"{standard.kind.replace('_', ' ')} {k + 1}", standard, (_in_world(place, pose),))
        for k, pose in enumerate(chosen)
    ]


def with_views(rig: Rig, place: Pose, places: Sequence[Place], views: int) -> list[Place]:
    """Return places that are seen in several views: the standard turned and tilted between them.

    Raises
    ------
    InputError
        Where a place is not seen in all of them.
    """
    found = []
    for one in places:
        (pose,), body = one.poses, _Body(one.standard)
        local = Pose(
            product(place.rotation.T, pose.rotation.T), place.to_local(pose.position[None])[0]
        )
        poses = [local]
        for angle in np.arange(0.0, 360.0, 15.0):
            if len(poses) == views:
                break
            axis = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle)), 0.0])
            turn = Rotation.from_rotvec(np.deg2rad(_VIEW_TILT) * axis).as_matrix()
            other = Pose(turn @ local.rotation, local.position)
            step = 360.0 / max(views - 1, 1)
            if angle + 1e-9 < step * (len(poses) - 1) or not body.seen(rig, place, other):
                continue
            poses.append(other)
        if len(poses) < views:
            expected = f"{views} views of {one.name} that both devices see"
            raise InputError("views", expected, len(poses))
        turned = tuple(_in_world(place, pose) for pose in poses)
        found.append(Place(one.name, one.standard, turned))
    return found


def _in_world(place: Pose, pose: Pose) -> Pose:
    return Pose(place.rotation @ pose.rotation, place.to_world(pose.position[None])[0])


class _Body:
    """What must be inside the volume, and what must be seen, in the standard's own frame."""

    def __init__(self, standard: Standard) -> None:
        self.plate = standard.kind == "plane"
        artefact = standard.artefact()
        if self.plate:
            face = next(f for f in artefact.features if isinstance(f, PlaneFeature))
            x, y = np.meshgrid(np.linspace(*face.x_mm, 5), np.linspace(*face.y_mm, 5))
            self.points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
            self.normals = np.broadcast_to([0.0, 0.0, 1.0], self.points.shape)
            self.centres = np.zeros((1, 3))
            self.radius = 0.0
            corners = itertools.product(
                *(np.array((-0.5, 0.5)) * s for s in standard.size_mm or ())
            )
            self.extent = np.array([[*corner, 0.0] for corner in corners])
            return
        balls = artefact.spheres
        self.centres = np.array([ball.centre_mm for ball in balls])
        self.radius = balls[0].radius_mm
        up = np.deg2rad(np.arange(0.0, 90.0, 15.0))
        around = np.deg2rad(np.arange(0.0, 360.0, 30.0))
        u, a = (x.ravel() for x in np.meshgrid(up, around))
        cap = np.column_stack([np.sin(u) * np.cos(a), np.sin(u) * np.sin(a), np.cos(u)])
        self.normals = np.concatenate([cap] * len(balls))
        self.points = np.concatenate([c + self.radius * cap for c in self.centres])
        self.extent = self.centres

    def inside(self, pose: Pose, half: Array) -> bool:
        """Return whether it lies in the volume, what is below a ball's middle left out."""
        reach = np.abs(pose.to_world(self.extent)) + self.radius * np.array([1.0, 1.0, 0.0])
        top = pose.to_world(self.extent)[:, 2] + self.radius
        return bool(np.all(reach <= half * (1.0 + 1e-9)) and np.all(top <= half[2] * (1.0 + 1e-9)))

    def seen(self, rig: Rig, place: Pose, pose: Pose) -> bool:
        """Return whether both devices see what is fitted, well inside their pictures."""
        world = _in_world(place, pose)
        points = world.to_world(self.points)
        # A ball's cap is that towards the volume's z, however it is turned.
        turn = world.rotation if self.plate else place.rotation
        normals = product(self.normals, turn.T)
        if not self.plate:
            middles = np.repeat(world.to_world(self.centres), len(points) // len(self.centres), 0)
            points = middles + self.radius * normals
        seen = facing(rig, points, normals, MAX_INCIDENCE)
        if np.mean(seen) < (1.0 if self.plate else _LEAST_SEEN):
            return False
        return all(_well_inside(d, points[seen]) for d in (rig.camera, rig.projector))


def _well_inside(device: Device, points: Array) -> bool:
    pixels = device.project(points)
    size = np.array([device.width, device.height])
    border = _BORDER * size
    with np.errstate(invalid="ignore"):
        return bool(np.all((pixels >= border) & (pixels <= size - 1.0 - border)))


def _candidates(standard: Standard, half: Array, body: _Body) -> list[Pose]:
    """Return poses in the volume's frame that lie in the volume."""
    turns: list[Array] = [np.eye(3)]
    if standard.kind == "ball_bar":
        turns = [
            Rotation.from_euler("zy", (turn, rise), degrees=True).as_matrix()
            for turn, rise in itertools.product(_TURNS, _RISES)
        ]
    elif standard.kind == "plane":
        across = 90.0 * (standard.size_mm != _along(standard, half))
        quarter = Rotation.from_euler("z", across, degrees=True)
        turns = [
            (
                Rotation.from_rotvec(
                    np.deg2rad(tilt)
                    * np.array([np.cos(np.deg2rad(about)), np.sin(np.deg2rad(about)), 0.0])
                )
                * quarter
            ).as_matrix()
            for tilt, about in itertools.product(_TILTS, _ABOUT)
            if tilt or not about
        ]
    found = []
    for turn in turns:
        # As far as it reaches from its middle, so that the grid fills what is left.
        out = np.abs(Pose(turn, np.zeros(3)).to_world(body.extent)).max(axis=0) + body.radius
        low = np.where([0, 0, 1], out - body.radius, out)
        room = np.stack((-(half - low), half - out))
        if np.any(room[1] < room[0] - 1e-9):
            continue
        axes = [np.unique(np.linspace(a, b, _GRID[standard.kind])) for a, b in room.T]
        found += [Pose(turn, np.array(position)) for position in itertools.product(*axes)]
    return [pose for pose in found if body.inside(pose, half)]


def _along(standard: Standard, half: Array) -> tuple[float, float]:
    """Return a plate's sides in the order of the volume's."""
    short, long = sorted(standard.size_mm or (0.0, 0.0))
    return (short, long) if half[0] <= half[1] else (long, short)


def _apart(poses: list[Pose], count: int, diagonal: float, standard: Standard) -> list[Pose]:
    """Return poses that are far apart, each the furthest from those before it."""
    places = np.array([pose.position for pose in poses]) / diagonal
    axis = 2 if standard.kind == "plane" else 0
    turns = _TURN_WEIGHT * np.array([pose.rotation[:, axis] for pose in poses])

    def distance(k: int) -> Array:
        turned = np.linalg.norm(turns - turns[k], axis=1)
        if standard.kind == "ball_bar":  # the same from either end
            turned = np.minimum(turned, np.linalg.norm(turns + turns[k], axis=1))
        if standard.kind == "sphere":
            turned = np.zeros(len(poses))
        return np.asarray(np.hypot(np.linalg.norm(places - places[k], axis=1), turned))

    chosen = [int(np.argmin(np.linalg.norm(places, axis=1)))]
    nearest = distance(chosen[0])
    while len(chosen) < count:
        # Rounding does not decide between corners that are equally far.
        chosen.append(int(np.argmax(np.round(nearest, 9))))
        nearest = np.minimum(nearest, distance(chosen[-1]))
    return [poses[k] for k in chosen]
