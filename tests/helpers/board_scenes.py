"""Boards rendered in free poses before a macro rig with distortion, and what is truly there."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from slbench import objects
from slbench.calibration.target.free import FreeBoard
from slbench.rig import Pose
from slbench.scene.file import load_scene
from slbench.scene.model import SceneObject
from slbench.simulate import capture
from slbench.simulate.stack import traced

CAMERA_DISTORTION = (-0.15, 0.08, 6e-4, -4e-4, 0.0)
PROJECTOR_DISTORTION = (0.06, 0.0, 0.0, 0.0, 0.0)

#: An artefact's kind and parameters, its dark parts, and the board as the calibration is told.
BOARDS = {
    "chequerboard": (
        "chequerboard",
        {"columns": 9, "rows": 7, "square_mm": 8.0, "margin_mm": 8.0},
        ("black",),
        FreeBoard(kind="chequerboard", columns=9, rows=7, pitch_mm=8.0),
    ),
    "circle-grid": (
        "calibration_grid",
        {
            **{"columns": 9, "rows": 7, "pitch_um": 9000.0, "dot_diameter_um": 4000.0},
            "margin_mm": 8.0,
        },
        ("dots",),
        FreeBoard(kind="circle-grid", columns=9, rows=7, pitch_mm=9.0),
    ),
    "staggered": (
        "circle_grid",
        {"columns": 5, "rows": 9, "spacing_mm": 8.0, "dot_diameter_mm": 5.0, "margin_mm": 8.0},
        ("dots",),
        FreeBoard(kind="circle-grid", columns=5, rows=9, pitch_mm=8.0, staggered=True),
    ),
    "charuco": (
        "charuco",
        {"columns": 9, "rows": 7, "square_mm": 9.0, "marker_mm": 6.5, "margin_mm": 5.0},
        ("black", "markers"),
        FreeBoard(kind="charuco", columns=9, rows=7, pitch_mm=9.0, marker_mm=6.5),
    ),
}


@cache
def board_scene(name, divisor=1, samples=64):
    """Return a scene with a board in the middle, both axes coded, and the board."""
    kind, parameters, dark, board = BOARDS[name]
    scene = load_scene("chequerboard")
    artefact = objects.build_artefact(kind, parameters)
    first = scene.objects[0]
    rig = scene.rig.having(
        camera=replace(scene.rig.camera, distortion=CAMERA_DISTORTION),
        projector=replace(scene.rig.projector, distortion=PROJECTOR_DISTORTION),
    )
    ink, paper = first.materials["black"], first.materials["white"]
    plate = SceneObject(artefact, Pose(), paper, dict.fromkeys(dark, ink))
    return replace(scene, rig=rig, objects=(plate,)).coarser(divisor, samples), board


def free_poses(count, seed=0, tilt_deg=28.0):
    """Return poses about the world's origin, tilted about axes all around."""
    rng = np.random.default_rng(seed)
    poses = []
    for k in range(count):
        around = 2.0 * np.pi * k / count
        tilt = np.radians(tilt_deg) * np.array([np.cos(around), np.sin(around), 0.0])
        turn = Rotation.from_euler("z", rng.uniform(-30.0, 30.0), degrees=True)
        rotation = (Rotation.from_rotvec(tilt) * turn).as_matrix()
        poses.append(Pose(rotation, rng.uniform(-1.0, 1.0, 3) * [14.0, 10.0, 25.0]))
    return poses


def placed(scene, pose):
    """Return a scene whose board is elsewhere."""
    return replace(scene, objects=(replace(scene.objects[0], pose=pose),))


def light_of(scene, seed=0):
    """Trace a scene's light."""
    return traced(scene, seed=seed)[0]


def captured(scene, transport, seed):
    """Expose a scene's frames, with noise of a seed."""
    return capture(transport, scene.sequence, scene.rig, scene.detector, scene.exposure, seed=seed)


def true_parameters(rig):
    """Return a rig's parameters by full name, the projector's pose in the camera's frame."""
    camera = rig.camera.pose
    true = {}
    names = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
    for role in ("camera", "projector"):
        device = getattr(rig, role)
        matrix = device.matrix
        values = (matrix[0, 0], matrix[1, 1], *device.centre, *device.distortion)
        true |= {f"{role}.{name}": value for name, value in zip(names, values, strict=True)}
    relative = camera.rotation.T @ rig.projector.pose.rotation
    turn = Rotation.from_matrix(relative).as_rotvec()
    place = camera.to_local(rig.projector.pose.position)
    names = ("rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm")
    return true | {
        f"projector.{name}": value for name, value in zip(names, (*turn, *place), strict=True)
    }
