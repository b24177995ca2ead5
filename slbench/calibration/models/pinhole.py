"""The baseline of macro-scale systems: a pinhole camera and a projector as inverse camera [42].

Zhang & Huang's method needs views of a target in several orientations.  A target on a stage
keeps its orientation, and parallel planes leave the focal length undetermined (Zhang, 2000,
section 3.2); but the stage's positions are known, so all markings together are one target
with depth.  Camera and projector are then each calibrated from it by ``cv2.calibrateCamera``,
started from the direct linear transformation (Hartley & Zisserman, *Multiple View Geometry*,
7.1), and points are triangulated as everywhere else in the package.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import rq

from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import Axes, checked_inputs
from slbench.cloud.triangulation import intersect_axis, nearest_points
from slbench.core.errors import InputError
from slbench.rig import Camera, Lens, Pose, Projector, Rig

Array = NDArray[np.float64]

#: Unknowns of a projection matrix are 11; each point gives two equations.
_LEAST_POINTS = 6
_NOMINAL_PITCH_MM = 0.005


class PinholeModel:
    """Camera and projector as pinholes with radial distortion of two terms.

    Parameters
    ----------
    camera_size, panel_size : (int, int)
        Width and height, px.
    axes : {"u", "uv"}
        Panel axes to triangulate with; the calibration uses both.
    distortion : bool
        Whether to fit k1 and k2.

    Attributes
    ----------
    rig_ : Rig
        World as of the points.
    reprojection_rms_px_ : (float, float)
        Of camera and projector.
    """

    def __init__(
        self,
        camera_size: tuple[int, int],
        panel_size: tuple[int, int],
        axes: Axes = "u",
        distortion: bool = True,
    ) -> None:
        self.camera_size = camera_size
        self.panel_size = panel_size
        self.axes = axes
        self.distortion = distortion

    def fit(self, points: CalibrationPoints) -> PinholeModel:
        """Calibrate both devices.

        Raises
        ------
        InputError
            With too few points, or points in one plane.
        """
        pixels, world = points.inputs("uv"), points.world
        first, camera_rms = self._device(world, pixels[:, :2], self.camera_size, "camera")
        second, panel_rms = self._device(world, pixels[:, 2:], self.panel_size, "projector")
        camera = Camera(*self.camera_size, **first)
        projector = Projector(*self.panel_size, **second)
        size = np.ptp(world, axis=0)
        self.rig_ = Rig(camera, projector, (float(size[0]), float(size[1]), float(size[2])))
        self.reprojection_rms_px_ = (camera_rms, panel_rms)
        return self

    def _device(
        self, world: Array, pixels: Array, size: tuple[int, int], who: str
    ) -> tuple[dict, float]:
        """Calibrate one device; return the arguments of its class and the RMS in px."""
        matrix, pose = resection(world, pixels, f"calibration points of the {who}")
        # The start must lie within the image, which that of a long lens may miss.
        matrix[:2, 2] = np.clip(matrix[:2, 2], 0.1 * np.array(size), 0.9 * np.array(size))
        # OpenCV takes single precision: coordinates about the middle keep the most of it.
        middle = world.mean(axis=0)
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
        if not self.distortion:
            flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
        try:
            error, matrix, distortion, rotations, offsets = cv2.calibrateCamera(
                [(world - middle).astype(np.float32)],
                [pixels.astype(np.float32)],
                size,
                matrix,
                np.zeros(5),
                flags=flags,
            )
        except cv2.error as failure:
            expected = "points that fit a pinhole"
            raise InputError(f"calibration of the {who}", expected, failure.err) from None
        rotation = cv2.Rodrigues(rotations[0])[0]
        pose = Pose(rotation.T, middle - rotation.T @ offsets[0].ravel())
        focal = float(matrix[0, 0] * _NOMINAL_PITCH_MM)
        arguments = {
            "pitch_mm": (_NOMINAL_PITCH_MM, focal / float(matrix[1, 1])),
            "lens": Lens(focal),
            "principal_point": (float(matrix[0, 2]), float(matrix[1, 2])),
            "distortion": tuple(float(k) for k in np.ravel(distortion)[:5]),
            "pose": pose,
        }
        return arguments, float(error)

    def predict(self, points: ArrayLike) -> Array:
        """Return world points (n, 3), mm, NaN where the rays do not meet."""
        inputs = checked_inputs(points, 3 if self.axes == "u" else 4)
        origins, directions = self.rig_.camera.unproject(inputs[:, :2])
        if self.axes == "u":
            return intersect_axis(self.rig_.projector, origins, directions, inputs[:, 2], "u")[0]
        return nearest_points(self.rig_.projector, origins, directions, inputs[:, 2:])[0]


def resection(world: Array, pixels: Array, where: str = "points") -> tuple[Array, Pose]:
    """Find a pinhole from points by the direct linear transformation.

    Parameters
    ----------
    world : (n, 3) float
        Not in one plane, mm.
    pixels : (n, 2) float
    where : str
        What to call the points in an error.

    Returns
    -------
    matrix : (3, 3) float
        Camera matrix without skew.
    pose : Pose

    Raises
    ------
    InputError
        With fewer than six points, or points in one plane.
    """
    if len(world) < _LEAST_POINTS:
        raise InputError(where, f"at least {_LEAST_POINTS}", len(world))
    middle, spread = world.mean(axis=0), world.std()
    flatness = np.linalg.svd(world - middle, compute_uv=False)
    if flatness[2] < 1e-6 * flatness[0]:
        raise InputError(where, "points that are not all in one plane", "points in one plane")
    centre, scale = pixels.mean(axis=0), pixels.std()
    homogeneous = np.column_stack(((world - middle) / spread, np.ones(len(world))))
    u, v = ((pixels - centre) / scale).T
    zero = np.zeros_like(homogeneous)
    rows = np.concatenate(
        (
            np.hstack((homogeneous, zero, -u[:, None] * homogeneous)),
            np.hstack((zero, homogeneous, -v[:, None] * homogeneous)),
        )
    )
    # The right singular vectors of the triangle are those of the tall matrix.
    p = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2][-1].reshape(3, 4)
    to_pixels = np.array([[scale, 0, centre[0]], [0, scale, centre[1]], [0, 0, 1.0]])
    to_unit = np.eye(4)
    to_unit[:3, :3] /= spread
    to_unit[:3, 3] = -middle / spread
    p = to_pixels @ p @ to_unit
    if np.linalg.det(p[:, :3]) < 0:
        p = -p
    matrix, rotation = rq(p[:, :3])
    signs = np.diag(np.sign(np.diag(matrix)))
    matrix, rotation = matrix @ signs, signs @ rotation
    position = -np.linalg.solve(p[:, :3], p[:, 3])
    matrix = matrix / matrix[2, 2]
    matrix[0, 1] = 0.0
    return matrix, Pose(rotation.T, position)
