"""A telecentric camera beside a central projector: where its adjustment starts; its conventions.

**Start.**  A telecentric camera sees a board by an affine map ``c = m S x + b``, where S is the
upper left block of the board's rotation R.  The larger singular value of S is one, which tells the
magnification m, px/mm, along each axis from boards in different poses.  S tells the rest of R but
for a sign: a board that is tilted to the other side looks the same.  The projector is central and
has each board's rotation by Zhang's method.  The rotation from projector to camera is the same for
all boards, which tells the signs (B. Li and S. Zhang, Opt. Express 23(20), 2015, calibrate the
camera by the projector too).

**Conventions.**  No picture tells how far along its axis a telecentric camera is, nor where the
axis is.  Here it goes through the panel's middle; the camera is as far from the boards as the
projector, their distance s in the median; and normalised coordinates are ``x = X / s``.  The
covariance is of rigs whose projector keeps its depth in the camera's frame: any other is one of
these, shifted along the camera's axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from slbench.calibration.bundle.adjustment.adjust import Adjusted
from slbench.calibration.bundle.adjustment.start import NOMINAL_PITCH_MM, device_start
from slbench.calibration.bundle.views import BoardView
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.parameters import ROLES, SHIFT, TILT, ParameterCovariance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Weight of pixels being square, where boards tell nothing else.
_SQUARE = 1e-3
#: An affine map fits like a homography where it leaves less than this times as much, and this more:
#: a homography takes up a part of the distortion too.
_ALIKE, _BENT_PX = 1.5, 0.3
#: A board is tilted where one direction is foreshortened to this: by 15 degrees and more.
_TILTED = 0.966


def start_telecentric(
    views: Sequence[BoardView], masks: Sequence[Mask], fixed: Mapping[str, float]
) -> tuple[Rig, list[Pose]]:
    """Return a rig with a telecentric camera and the poses of the boards to start from.

    Parameters and returns are those of
    :func:`~slbench.calibration.bundle.adjustment.start.start`; the camera's centre is among what is
    fixed.
    """
    boards = [view.points_mm[mask] for view, mask in zip(views, masks, strict=True)]
    lit = [view.panel[mask] for view, mask in zip(views, masks, strict=True)]
    maps = [
        _affine(board[:, :2], view.pixels[mask])
        for board, view, mask in zip(boards, views, masks, strict=True)
    ]
    per_mm = _magnification([matrix for matrix, _ in maps])
    arguments, theirs = device_start(boards, lit, views[0].panel_size, "projector", fixed)
    both = [_rotations(matrix / per_mm[:, None]) for matrix, _ in maps]
    turn, rotations = _turn(both, [pose.rotation for pose in theirs])

    centre = np.array([fixed["camera.cx_px"], fixed["camera.cy_px"]])
    across = np.array([(offset - centre) / per_mm for _, offset in maps])
    places = np.array([turn @ pose.position for pose in theirs])
    distance = float(np.median([np.linalg.norm(pose.position) for pose in theirs]))
    aside = np.median(across - places[:, :2], axis=0)
    shift = np.array([*aside, distance - np.median(places[:, 2])])
    poses = [
        Pose(rotation, np.array([*xy, place[2] + shift[2]]))
        for rotation, xy, place in zip(rotations, across, places, strict=True)
    ]
    width, height = views[0].camera_size
    camera = Camera(
        width,
        height,
        (NOMINAL_PITCH_MM, NOMINAL_PITCH_MM * float(per_mm[0] / per_mm[1])),
        Lens.telecentric(float(per_mm[0]) * NOMINAL_PITCH_MM, 0.0, distance),
        principal_point=(float(centre[0]), float(centre[1])),
        distortion=tuple(fixed.get(f"camera.{k}", 0.0) for k in COEFFICIENTS),
        tilt_rad=(fixed.get(f"camera.{TILT[0]}", 0.0), fixed.get(f"camera.{TILT[1]}", 0.0)),
    )
    projector = Projector(*views[0].panel_size, **arguments, pose=Pose(turn, shift))
    return Rig(camera, projector), poses


def without_perspective(views: Sequence[BoardView]) -> bool:
    """Return whether boards, tilted ones among them, are seen by affine maps as by homographies."""
    tilts = []
    for view in views:
        plane = view.points_mm[:, :2]
        homography, _ = cv2.findHomography(plane, view.pixels, cv2.LMEDS)
        if homography is None:
            return False
        mapped = cv2.perspectiveTransform(plane[None], homography)[0]
        matrix, offset = _affine(plane, view.pixels)
        central, parallel = (
            float(np.median(np.linalg.norm(found - view.pixels, axis=1)))
            for found in (mapped, plane @ matrix.T + offset)
        )
        if parallel > _ALIKE * central + _BENT_PX:
            return False
        larger, smaller = np.linalg.svd(matrix)[1]
        tilts.append(smaller / larger)
    return min(tilts) < _TILTED


def _affine(plane: Array, seen: Array) -> tuple[Array, Array]:
    """Return matrix (2, 2) and offset (2,) of the affine map from a plane to a picture."""
    design = np.column_stack((plane, np.ones(len(plane))))
    solution = np.asarray(np.linalg.lstsq(design, seen, rcond=None)[0], dtype=np.float64)
    return solution[:2].T, solution[2]


def _magnification(matrices: Sequence[Array]) -> Array:
    """Return the magnification along u and v, px/mm, of which maps (2, 2) are blocks of rotations.

    A block S of a rotation has a singular value of one, so ``det(1 - S^T S) = 0``.
    """
    square = float(np.median([np.linalg.svd(matrix)[1][0] for matrix in matrices]))
    scaled = np.array(matrices) / square

    def off(logarithms: Array) -> Array:
        blocks = scaled / np.exp(logarithms)[:, None]
        defects = np.linalg.det(np.eye(2) - blocks.transpose(0, 2, 1) @ blocks)
        return np.append(defects, _SQUARE * (logarithms[0] - logarithms[1]))

    found = least_squares(off, np.zeros(2), loss="soft_l1", f_scale=0.01)
    return np.asarray(square * np.exp(found.x))


def _rotations(block: Array) -> tuple[Array, Array]:
    """Return the two rotations (3, 3) with an upper left block (2, 2), but for its errors."""
    u, (_, cosine), vt = np.linalg.svd(block)
    cosine = min(float(cosine), 1.0)
    sine = float(np.sqrt(1.0 - cosine**2))
    left, right = np.eye(3), np.eye(3)
    left[:2, :2], left[2, 2] = u, np.linalg.det(u)
    right[:2, :2], right[2, 2] = vt, np.linalg.det(vt)
    one, other = (
        left @ np.array([[1.0, 0.0, 0.0], [0.0, cosine, -s], [0.0, s, cosine]]) @ right
        for s in (sine, -sine)
    )
    return one, other


def _turn(
    both: Sequence[tuple[Array, Array]], theirs: Sequence[Array]
) -> tuple[Array, list[Array]]:
    """Return the turn from projector to camera that boards agree on, and the boards' rotations.

    Parameters
    ----------
    both : sequence of ((3, 3) float, (3, 3) float)
        Rotations of each board in the camera's frame, of which one is right.
    theirs : sequence of (3, 3) float
        In the projector's frame.
    """
    candidates = [mine @ its.T for pair, its in zip(both, theirs, strict=True) for mine in pair]
    off = np.array(
        [
            [
                [np.linalg.norm(mine - turn @ its) for mine in pair]
                for pair, its in zip(both, theirs, strict=True)
            ]
            for turn in candidates
        ]
    )
    best = int(np.argmin(np.median(off.min(axis=2), axis=1)))
    signs = off[best].argmin(axis=1)
    return candidates[best], [pair[sign] for pair, sign in zip(both, signs, strict=True)]


def conventional(found: Adjusted, depth: float) -> Adjusted:
    """Return what was found, shifted along the camera's axis to a depth of the projector, mm."""
    projector = found.rig.projector
    shift = np.array([0.0, 0.0, depth - projector.pose.position[2]])

    def shifted(pose: Pose) -> Pose:
        return Pose(pose.rotation, pose.position + shift)

    rig = found.rig.having(projector=projector.posed(shifted(projector.pose)))
    return replace(found, rig=rig, poses=tuple(shifted(pose) for pose in found.poses))


def conventional_covariance(rig: Rig, known: ParameterCovariance) -> ParameterCovariance:
    """Return a covariance by which the projector keeps its depth in the camera's frame.

    Parameters
    ----------
    rig : Rig
        The camera's frame is the world.
    known : ParameterCovariance
        Without the projector's shift along one of its axes.
    """
    names = (*known.names, *(n for n in _PLACE if n not in known.names))
    matrix = np.zeros((len(names), len(names)))
    matrix[: len(known.names), : len(known.names)] = known.matrix
    rotation = rig.projector.pose.rotation
    change = np.eye(len(names))
    place = [names.index(name) for name in _PLACE]
    change[np.ix_(place, place)] = rotation.T @ np.diag([1.0, 1.0, 0.0]) @ rotation
    return ParameterCovariance(names, change @ matrix @ change.T)


_PLACE = tuple(f"{ROLES[1]}.{name}" for name in SHIFT)
