r"""Combine a camera and a projector that were calibrated apart, from a few views of a board.

Where a camera is replaced, its lens is calibrated once and the projector's is known: six parameters
of where they stand are left, which one pose of a board tells.  Both devices come with the
covariance of their parameters, a :class:`~slbench.calibration.bundle.adjustment.prior.Prior` of the
adjustment: lenses give way to the views by as much as they are uncertain, and the rig's covariance
has what was known of them, what the views add, and what both have in common.

A device that is no longer what it was (focused again, or with another lens) is questioned:
:mod:`~slbench.calibration.bundle.agreement`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.calibration.bundle.adjustment.prior import Prior, marginal
from slbench.calibration.bundle.adjustment.start import related
from slbench.calibration.bundle.agreement import agreements
from slbench.calibration.bundle.calibrate import calibrated
from slbench.calibration.bundle.result import BoardCalibration
from slbench.calibration.bundle.views import BoardView
from slbench.core.errors import InputError, warn_user
from slbench.rig import Pose, Rig
from slbench.rig.device import Device
from slbench.rig.opencv import read_camera, read_rig
from slbench.rig.parameters import (
    POSE,
    ROLES,
    ParameterCovariance,
    covariance_beside,
    optics_of,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def read_devices(
    camera: str | Path, projector: str | Path
) -> tuple[Rig, ParameterCovariance | None]:
    """Read the camera of one file and the projector of another, with what is known.

    Parameters
    ----------
    camera : path
        Of a rig, or of a camera that was calibrated alone, with its covariance beside.
    projector : path
        Of a rig; both may be the same.

    Returns
    -------
    rig : Rig
        Of both, each where its own rig has it.
    covariance : ParameterCovariance or None
        Of their lenses and panels.  Devices of different files are independent.

    Raises
    ------
    InputError
        As :func:`~slbench.rig.opencv.read_rig`.

    Warns
    -----
    InputWarning
        If no covariance stands beside a device.
    """
    paths = dict(zip(ROLES, (camera, projector), strict=True))
    own, rig = read_camera(camera), read_rig(projector)
    beside = {role: covariance_beside(path) for role, path in paths.items()}
    known = []
    for role, covariance in beside.items():
        part = None if covariance is None else marginal(covariance, (role,))
        if part is None:
            doubt = f"no covariance of the {role} stands beside it: taken as exact"
            warn_user(paths[role], doubt)
        else:
            known.append(part)
    rig = rig.having(**{rig.only.camera: own})
    whole = beside["camera"]
    if whole is not None and Path(camera).resolve() == Path(projector).resolve():
        return rig, marginal(whole)
    return rig, _independent(known) if known else None


def _independent(parts: Sequence[ParameterCovariance]) -> ParameterCovariance:
    """Return the covariance of parameters that are known apart."""
    from scipy.linalg import block_diag

    names = tuple(name for part in parts for name in part.names)
    return ParameterCovariance(names, block_diag(*(part.matrix for part in parts)))


def combine_devices(
    views: Sequence[BoardView],
    rig: Rig,
    covariance: ParameterCovariance | None = None,
    *,
    world: str | None = None,
) -> BoardCalibration:
    """Find where a camera and a projector stand that were calibrated apart.

    Parameters
    ----------
    views : sequence of BoardView
        One at least.
    rig : Rig
        Has the devices.  Where they stand in it does not matter.
    covariance : ParameterCovariance, optional
        Of their lenses and panels: what is not in it is exact.  That of poses does not matter.
    world : str, optional
        As of :func:`~slbench.calibration.bundle.calibrate.calibrate_boards`.

    Returns
    -------
    BoardCalibration
        Its ``agreement`` says whether the views fit the devices.

    Raises
    ------
    InputError
        Without views, for pictures of another size than the devices', a telecentric device, no
        such world, and where no pose is found.
    """
    _check(views, rig)
    known = None if covariance is None else marginal(covariance)
    prior = None if known is None else Prior(rig, known)
    names = () if known is None else known.names
    exact = {
        f"{role}.{name}": value
        for role in ROLES
        for name, value in optics_of(getattr(rig, role)).items()
        if f"{role}.{name}" not in names and value
    }
    found = calibrated(
        views,
        lambda some, masks: _start(some, masks, rig),
        (*names, *(f"projector.{name}" for name in POSE)),
        least=1,
        models=dict.fromkeys(ROLES, "as stated"),
        fixed=exact,
        world=world,
        prior=prior,
    )
    # What their own calibrations did not tell of lenses is no matter of these views.
    undetermined = {
        name: why
        for name, why in found.known.undetermined.items()
        if name.partition(".")[2] in POSE
    }
    return replace(
        found,
        known=replace(found.known, undetermined=undetermined),
        agreement=agreements(found.views, found.rig, found.poses, found.kept, prior),
    )


def _check(views: Sequence[BoardView], rig: Rig) -> None:
    if not views:
        raise InputError("boards", "a view of one pose at least", "none")
    for role in ROLES:
        device = getattr(rig, role)
        if device.lens.kind != "perspective":
            raise InputError(f"the {role}", "a lens in perspective", device.lens.kind)
        size = (device.width, device.height)
        for view in views:
            own = view.camera_size if role == "camera" else view.panel_size
            if own != size:
                expected = f"a {role} of {size[0]} x {size[1]} px, as the one that is combined"
                raise InputError(view.name, expected, f"{own[0]} x {own[1]} px")


def _start(views: Sequence[BoardView], masks: Sequence[Mask], rig: Rig) -> tuple[Rig, list[Pose]]:
    """Return a rig and boards' poses to start from, in the camera's frame."""
    boards = [view.points_mm[mask] for view, mask in zip(views, masks, strict=True)]
    lit = [view.panel[mask] for view, mask in zip(views, masks, strict=True)]
    poses, other = (
        [
            _board_pose(device, board, seen, f"{view.name}: {role}")
            for board, seen, view in zip(boards, places, views, strict=True)
        ]
        for role, device, places in (
            (
                "camera",
                rig.camera,
                [view.pixels[mask] for view, mask in zip(views, masks, strict=True)],
            ),
            ("projector", rig.projector, lit),
        )
    )
    camera = rig.camera.posed(Pose())
    projector = related(rig.projector, boards, lit, poses, other)
    return Rig(camera, projector, rig.volume_mm), poses


def _board_pose(device: Device, board: Array, seen: Array, where: str) -> Pose:
    """Return a board's pose in a device's frame.

    Of the two poses from which a plane looks nearly the same the better one is taken
    (T. Collins, A. Bartoli, IJCV 109, 2014: ``cv2.SOLVEPNP_IPPE``).
    """
    rays = device.normalise(seen)
    good = np.isfinite(rays).all(axis=1)
    if np.count_nonzero(good) >= 4:
        found, turns, shifts, _ = cv2.solvePnPGeneric(
            board[good], rays[good], np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
        )
        if found:
            return Pose(cv2.Rodrigues(turns[0])[0], shifts[0].ravel())
    raise InputError(where, "points of a board that the lens can see", "none: another lens?")
