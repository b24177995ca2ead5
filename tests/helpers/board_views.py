"""Views of a board made by exact projection: what a detector and a decoder would have found."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from slbench.calibration.bundle.views import BoardView
from slbench.calibration.target.free import FreeBoard
from slbench.rig import Camera, Lens, Pose, Projector, Rig

BOARD = FreeBoard(kind="chequerboard", columns=9, rows=7, pitch_mm=5.0)


def macro_rig(
    camera: Sequence[float] = (-0.12, 0.2, 1e-3, -6e-4, 0.0),
    projector: Sequence[float] = (0.05, 0.0, 0.0, 0.0, 0.0),
) -> Rig:
    """Return a rig of two devices 12 deg apart, half a metre away; the camera is the world."""
    turn = cv2.Rodrigues(np.radians([1.0, -12.0, 0.6]))[0]
    place = np.array([105.0, 4.0, 6.0])
    return Rig(
        Camera(
            640,
            480,
            (0.0075, 0.0075),
            Lens(25.0),
            principal_point=(327.0, 233.0),
            distortion=tuple(camera),  # type: ignore[arg-type]
        ),
        Projector(
            912,
            1140,
            (0.0106, 0.0053),
            Lens(18.0),
            principal_point=(450.0, 640.0),
            distortion=tuple(projector),  # type: ignore[arg-type]
            pose=Pose(turn, place),
        ),
        (60.0, 60.0, 60.0),
    )


def free_poses(count: int, seed: int = 0, distance: float = 500.0, tilt_deg: float = 35.0):
    """Return poses of a board before the camera: it faces it but for tilts, turns and shifts."""
    rng = np.random.default_rng(seed)
    poses = []
    for k in range(count):
        around = 2.0 * np.pi * k / count
        tilt = np.radians(tilt_deg) * np.array([np.cos(around), np.sin(around), 0.0])
        turn = np.array([0.0, 0.0, np.radians(rng.uniform(-40.0, 40.0))])
        rotation = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(turn)[0] @ np.diag([1.0, -1.0, -1.0])
        place = np.array([*rng.uniform(-22.0, 22.0, 2), distance + rng.uniform(-40.0, 40.0)])
        poses.append(Pose(rotation, place))
    return poses


def projected_view(
    rig: Rig,
    pose: Pose,
    name: str,
    *,
    board: FreeBoard = BOARD,
    pixel_sd: float = 0.03,
    phase_sd: float = 0.02,
    rng: np.random.Generator | None = None,
) -> BoardView:
    """Return what is seen of a board; with a generator, errors are drawn from the deviations.

    The panel is found at the place in the picture where the point is detected, errors included.
    """
    world = pose.to_world(board.points_mm)
    pixels, panel = rig.camera.project(world), rig.projector.project(world)
    seen = rig.camera.contains(pixels) & rig.projector.contains(panel)
    world, pixels, panel = world[seen], pixels[seen], panel[seen]
    # The plane's own map from camera to panel.
    along = pose.rotation[:, :2]
    camera = rig.camera.project_with_jacobian(world)[1] @ along
    gradient = rig.projector.project_with_jacobian(world)[1] @ along @ np.linalg.inv(camera)
    n = len(pixels)
    if rng is not None:
        error = pixel_sd * rng.standard_normal((n, 2))
        pixels = pixels + error
        panel = panel + np.einsum("nij,nj->ni", gradient, error)
        panel = panel + phase_sd * rng.standard_normal((n, 2))
    return BoardView(
        name=name,
        board=board,
        numbers=np.flatnonzero(seen),
        pixels=pixels,
        pixel_sd=np.full(n, pixel_sd),
        panel=panel,
        panel_sd=np.full((n, 2), phase_sd),
        gradient=gradient,
        camera_size=(rig.camera.width, rig.camera.height),
        panel_size=(rig.projector.width, rig.projector.height),
    )


def projected_views(rig: Rig, count: int = 12, seed: int | None = None, **options):
    """Return views of a board in free poses, without errors or with those of a seed."""
    rng = None if seed is None else np.random.default_rng(seed)
    return [
        projected_view(rig, pose, f"pose{k:02d}", rng=rng, **options)
        for k, pose in enumerate(free_poses(count))
    ]


#: A lens of 110 degrees across that is nearly equidistant (``r = atan(R)``), and beyond Brown.
WIDE = (0.8943, 0.1549, 4e-4, -3e-4, 0.0027, 1.2276, 0.3644, 0.0205)
WIDE_BOARD = FreeBoard(kind="chequerboard", columns=7, rows=6, pitch_mm=45.0)


def wide_rig(camera: Sequence[float] = WIDE) -> Rig:
    """Return the macro rig with lenses of a wide angle, of which the camera's is distorted."""
    rig = macro_rig(camera)
    return rig.having(
        camera=replace(rig.camera, lens=Lens(3.2)),
        projector=replace(rig.projector, lens=Lens(4.0), distortion=(0.0,) * 5),
    )


def wide_views(rig: Rig, count: int = 10, seed: int | None = None) -> list[BoardView]:
    """Return views of a board in poses all over a wide picture, without errors or with a seed's."""
    rng = None if seed is None else np.random.default_rng(seed)
    across = np.random.default_rng(0).uniform(-1.0, 1.0, (count, 2)) * [420.0, 290.0]
    return [
        projected_view(
            rig,
            Pose(pose.rotation, np.array([*place, pose.position[2]])),
            f"pose{k:02d}",
            board=WIDE_BOARD,
            rng=rng,
        )
        for k, (pose, place) in enumerate(zip(free_poses(count), across, strict=True))
    ]
