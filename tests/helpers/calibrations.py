"""A calibration of a camera and a projector, and what OpenCV makes of points by it.

The formats of other programs are written from it by hand, in their own conventions.
"""

import cv2
import numpy as np

K_CAMERA = np.array([[2010.5, 0.0, 640.25], [0.0, 2015.0, 505.5], [0.0, 0.0, 1.0]])
K_PROJECTOR = np.array([[1820.0, 0.0, 598.0], [0.0, 1815.5, 790.75], [0.0, 0.0, 1.0]])
DIST_CAMERA = np.array([-0.11, 0.2, 0.001, -0.0007, -0.3])
DIST_PROJECTOR = np.array([0.03, -0.1, -0.0005, 0.0012, 0.02])
#: The same lenses by all that OpenCV has: rational, with a thin prism, on a tilted panel.
_RATIONAL, _PRISM = (0.2, -0.15, 0.4), (1e-3, -2e-3, -5e-4, 3e-3)
FULL_CAMERA = np.array([*DIST_CAMERA, *_RATIONAL, *_PRISM, 0.02, -0.01])
FULL_PROJECTOR = np.array([*DIST_PROJECTOR, *_RATIONAL[::-1], *_PRISM[::-1], -0.03, 0.01])
SIZE_CAMERA, SIZE_PROJECTOR = (1280, 1024), (1280, 800)
TURN = np.array([0.05, -0.3, 0.04])
R = cv2.Rodrigues(TURN)[0]
#: mm, from the camera to the projector.
T = np.array([130.0, -12.0, 25.0])

#: Before both devices, in the camera's frame, mm.
POINTS = np.random.default_rng(7).uniform((-120.0, -90.0, 450.0), (120.0, 90.0, 600.0), (300, 3))


def pixels(dist_camera=DIST_CAMERA, dist_projector=DIST_PROJECTOR):
    """Return where OpenCV projects the points, (N, 2) of the camera and of the projector."""
    camera, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K_CAMERA, dist_camera)
    projector, _ = cv2.projectPoints(POINTS, TURN, T, K_PROJECTOR, dist_projector)
    return camera[:, 0], projector[:, 0]


def assert_projects(rig, expected=None, atol=1e-6):
    """Compare a rig's pixels with OpenCV's; its world is the camera's frame."""
    for device, theirs in zip(
        (rig.camera, rig.projector), pixels() if expected is None else expected, strict=True
    ):
        np.testing.assert_allclose(device.project(POINTS), theirs, rtol=0.0, atol=atol)
    assert (rig.camera.width, rig.camera.height) == SIZE_CAMERA
    assert (rig.projector.width, rig.projector.height) == SIZE_PROJECTOR


def storage(path, **values):
    """Write entries as OpenCV does: YAML, or XML by the name."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        if isinstance(value, np.ndarray) and value.ndim == 1:
            value = value[None]
        file.write(name, value)
    file.release()
    return path
