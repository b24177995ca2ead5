"""Where the adjustment starts: homographies, then one device at a time by OpenCV.

A board's points, as one device sees them, are a homography of the board but for distortion.  That
with the least median of squares (P. J. Rousseeuw, 1984) tells points that are grossly off, up to
half of a board: corners numbered wrongly, wrong fringe orders.  Each device is then calibrated
without them by Zhang's method (IEEE PAMI 22, 2000, ``cv2.calibrateCamera``), the projector as an
inverse camera [42]; and of the poses of the projector that single boards give, the one that suits
all of them best is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.calibration.bundle.views import BoardView
from slbench.calibration.scales import GROSS, NORMAL_MAD
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.parameters import TILT

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOMINAL_PITCH_MM = 0.005
#: Points off a homography by less are not gross, px, or this share of the board's size in view:
#: distortion bends it.
_LEAST_GROSS_PX, _BENT = 2.0, 0.02
#: Focal lengths that Zhang's start may find, in widths of the panel, and what is taken otherwise.
_FOCAL_WIDTHS, _NOMINAL_WIDTHS = (0.2, 100.0), 3.0


def fits_homography(view: BoardView) -> Mask:
    """Return which points of a view fit a homography of the board, on camera and panel, (n,)."""
    plane = view.points_mm[:, :2]
    own = _consistent(plane, view.pixels)
    return own & _consistent(plane, view.panel) if view.lit else own


def _consistent(plane: Array, seen: Array) -> Mask:
    homography, _ = cv2.findHomography(plane, seen, cv2.LMEDS)
    if homography is None:
        return np.ones(len(plane), dtype=np.bool_)
    off = np.ones(len(plane), dtype=np.bool_)
    for _ in range(2):  # once more without what is grossly off
        mapped = cv2.perspectiveTransform(plane[None], homography)[0]
        distance = np.linalg.norm(mapped - seen, axis=1)
        scale = float(np.median(distance)) / NORMAL_MAD
        size = float(np.linalg.norm(np.ptp(np.percentile(seen, (5, 95), axis=0), axis=0)))
        off = distance > max(GROSS * scale, _LEAST_GROSS_PX, _BENT * size)
        again, _ = cv2.findHomography(plane[~off], seen[~off])
        if again is None:
            break
        homography = again
    return ~off


def start(
    views: Sequence[BoardView], masks: Sequence[Mask], fixed: Mapping[str, float]
) -> tuple[Rig, list[Pose]]:
    """Return a rig and the poses of the boards to start from.

    Parameters
    ----------
    views : sequence of BoardView
    masks : sequence of (n,) bool
        Which points of each.
    fixed : mapping of str to float
        Values of parameters by full names.

    Returns
    -------
    rig : Rig
        The camera's frame is the world.
    poses : list of Pose
        Of the boards in the world.
    """
    boards = [view.points_mm[mask] for view, mask in zip(views, masks, strict=True)]
    seen = [view.pixels[mask] for view, mask in zip(views, masks, strict=True)]
    lit = [view.panel[mask] for view, mask in zip(views, masks, strict=True)]
    camera, poses = device_start(boards, seen, views[0].camera_size, "camera", fixed)
    projector, other = device_start(boards, lit, views[0].panel_size, "projector", fixed)
    device = related(Projector(*views[0].panel_size, **projector), boards, lit, poses, other)
    points = np.concatenate([p.to_world(b) for p, b in zip(poses, boards, strict=True)])
    extent = np.maximum(np.ptp(points, axis=0), 1e-3)
    volume = (float(extent[0]), float(extent[1]), float(extent[2]))
    return Rig(Camera(*views[0].camera_size, **camera), device, volume), poses


def related(
    projector: Projector,
    boards: Sequence[Array],
    lit: Sequence[Array],
    poses: Sequence[Pose],
    other: Sequence[Pose],
) -> Projector:
    """Return the projector in the camera's frame, where it suits all boards best.

    Parameters
    ----------
    projector : Projector
    boards : sequence of (n, 3) float
        Points of each board.
    lit : sequence of (n, 2) float
        Where the panel has them.
    poses, other : sequence of Pose
        Of the boards, in the camera's and in the projector's frame.
    """
    best, least = projector.posed(Pose()), np.inf
    for own, theirs in zip(poses, other, strict=True):
        rotation = own.rotation @ theirs.rotation.T
        candidate = Pose(_nearest(rotation), own.position - rotation @ theirs.position)
        placed = projector.posed(candidate)
        misses = [
            np.linalg.norm(placed.project(pose.to_world(board)) - panel, axis=1)
            for pose, board, panel in zip(poses, boards, lit, strict=True)
        ]
        size = float(np.median(np.nan_to_num(np.concatenate(misses), nan=np.inf)))
        if size < least:
            best, least = placed, size
    return best


def device_start(
    boards: Sequence[Array],
    seen: Sequence[Array],
    size: tuple[int, int],
    role: str,
    fixed: Mapping[str, float],
) -> tuple[dict[str, Any], list[Pose]]:
    """Calibrate one device by Zhang's method.

    Parameters
    ----------
    boards : sequence of (n, 3) float
        Points of each board in its own frame, mm.
    seen : sequence of (n, 2) float
        Where the device has them, px.
    size : (int, int)
        Of its panel, px.
    role : str
    fixed : mapping of str to float

    Returns
    -------
    arguments : dict of str to Any
        Of its class.
    poses : list of Pose
        Of the boards in its frame.
    """
    width = float(size[0])
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    nominal = np.array(
        [
            [_NOMINAL_WIDTHS * width, 0.0, 0.5 * (size[0] - 1)],
            [0.0, _NOMINAL_WIDTHS * width, 0.5 * (size[1] - 1)],
            [0.0, 0.0, 1.0],
        ]
    )
    matrix = rotations = offsets = None
    # Zhang's own start; with square pixels and a central axis where boards tell too little.
    tries = (
        (None, flags),
        (
            nominal,
            flags
            | cv2.CALIB_USE_INTRINSIC_GUESS
            | cv2.CALIB_FIX_ASPECT_RATIO
            | cv2.CALIB_FIX_PRINCIPAL_POINT,
        ),
        (
            nominal,
            flags
            | cv2.CALIB_USE_INTRINSIC_GUESS
            | cv2.CALIB_FIX_FOCAL_LENGTH
            | cv2.CALIB_FIX_PRINCIPAL_POINT,
        ),
    )
    for guess, how in tries:
        try:
            _, matrix, _, rotations, offsets = cv2.calibrateCamera(
                [board.astype(np.float32) for board in boards],
                [points.astype(np.float32) for points in seen],
                size,
                None if guess is None else guess.copy(),
                np.zeros(5),
                flags=how,
            )
        except cv2.error:
            continue
        if np.all(np.isfinite(matrix)) and np.all(
            (np.diag(matrix)[:2] > _FOCAL_WIDTHS[0] * width)
            & (np.diag(matrix)[:2] < _FOCAL_WIDTHS[1] * width)
        ):
            break
    assert matrix is not None  # the last try has one
    assert rotations is not None
    assert offsets is not None
    fx, fy, cx, cy = (
        fixed.get(f"{role}.{name}", float(value))
        for name, value in (
            ("fx_px", matrix[0, 0]),
            ("fy_px", matrix[1, 1]),
            ("cx_px", matrix[0, 2]),
            ("cy_px", matrix[1, 2]),
        )
    )
    focal = fx * NOMINAL_PITCH_MM
    arguments = {
        "pitch_mm": (NOMINAL_PITCH_MM, focal / fy),
        "lens": Lens(focal),
        "principal_point": (cx, cy),
        "distortion": tuple(fixed.get(f"{role}.{k}", 0.0) for k in COEFFICIENTS),
        "tilt_rad": tuple(fixed.get(f"{role}.{tau}", 0.0) for tau in TILT),
    }
    poses = [
        Pose(_nearest(cv2.Rodrigues(rotation)[0]), np.asarray(offset, dtype=np.float64).ravel())
        for rotation, offset in zip(rotations, offsets, strict=True)
    ]
    return arguments, poses


def _nearest(rotation: Array) -> Array:
    """Return the rotation nearest to a matrix (3, 3)."""
    u, _, v = np.linalg.svd(np.asarray(rotation, dtype=np.float64))
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)
