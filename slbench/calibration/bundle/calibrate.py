"""Calibrate camera and projector from views of a board: start, adjust, judge, place the world."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.bundle.adjustment.adjust import adjust
from slbench.calibration.bundle.adjustment.models import (
    FOCAL,
    TELECENTRIC,
    free_parameters,
    start_values,
)
from slbench.calibration.bundle.adjustment.prior import Prior
from slbench.calibration.bundle.adjustment.start import fits_homography, start
from slbench.calibration.bundle.adjustment.telecentric import (
    conventional,
    conventional_covariance,
    start_telecentric,
    without_perspective,
)
from slbench.calibration.bundle.adjustment.uncertainty import uncertainty
from slbench.calibration.bundle.result import BoardCalibration
from slbench.calibration.bundle.views import BoardView
from slbench.calibration.bundle.world import placed
from slbench.calibration.target.free import LEAST_POINTS
from slbench.core.errors import InputError, warn_user
from slbench.rig import Pose, Rig

Mask = NDArray[np.bool_]

#: Poses that tell a pinhole's focal length and centre: two constraints each (Zhang, 2000).
LEAST_VIEWS = 3
#: A pose whose points are left out beyond this share is another board, or moved.
_MOST_LEFT_OUT = 0.5


def calibrate_boards(
    views: Sequence[BoardView],
    *,
    camera_model: str = "brown",
    projector_model: str = "radial",
    fixed: Mapping[str, float | None] | None = None,
    world: str | None = None,
) -> BoardCalibration:
    """Calibrate camera and projector from views of a board in free poses.

    Parameters
    ----------
    views : sequence of BoardView
        Three at least.
    camera_model, projector_model : str
        Of :data:`~slbench.calibration.bundle.adjustment.models.CAMERA_MODELS` and
        :data:`~slbench.calibration.bundle.adjustment.models.DEVICE_MODELS`.
    fixed : mapping of str to float or None
        Parameters by full name that stay at a value, or where they start.
    world : str, optional
        Name of the view whose board is the world's frame.  By default the origin is where the
        two optical axes come closest, with x to the camera's right and z towards the camera.

    Returns
    -------
    BoardCalibration
        Views of which most points do not fit are left out of it (``views`` has the others).

    Raises
    ------
    InputError
        With too few views, views of other sizes, no such world, poses that do not determine a
        focal length, or a value for what a telecentric camera has in units of its distance.

    Warns
    -----
    InputWarning
        If the board that is the world looks the same when it is turned, or is seen in part, and if
        a camera of another model looks telecentric.
    """
    check_sizes(views)
    sizes = {"camera": views[0].camera_size, "projector": views[0].panel_size}
    values = start_values(fixed or {}, sizes, camera_model)
    begin = start_telecentric if camera_model == TELECENTRIC else start
    free = free_parameters(camera_model, projector_model, tuple(values))
    if camera_model != TELECENTRIC and without_perspective(views):
        warn_user("camera model", "tilted boards show no perspective: is the lens telecentric?")
    return calibrated(
        views,
        lambda some, masks: begin(some, masks, values),
        free,
        least=LEAST_VIEWS,
        models={"camera": camera_model, "projector": projector_model},
        fixed=values,
        world=world,
    )


def calibrated(
    views: Sequence[BoardView],
    begin: Callable[[Sequence[BoardView], Sequence[Mask]], tuple[Rig, list[Pose]]],
    free: Sequence[str],
    *,
    least: int,
    models: Mapping[str, str],
    fixed: Mapping[str, float],
    world: str | None,
    prior: Prior | None = None,
) -> BoardCalibration:
    """Adjust a rig to views, without those that do not fit, and place it in the world.

    Parameters
    ----------
    views : sequence of BoardView
    begin : callable
        Returns rig and poses to start from, of some views and masks of their points.
    free : sequence of str
        Parameters that are fitted.
    least : int
        Views that it takes.
    models, fixed, world
        As of :class:`BoardCalibration` and :func:`calibrate_boards`.
    prior : Prior, optional
        What was known of the parameters before; by default nothing.

    Raises
    ------
    InputError
        As :func:`calibrate_boards`.
    """
    names = [view.name for view in views]
    if world is not None and world not in names:
        raise InputError("world", f"one of the views: {', '.join(names)[:80]}", world)
    views = list(views)
    strangers: list[str] = []
    while True:
        if len(views) < least:
            got = f"{len(views)}; {', '.join(strangers)} do not fit"
            poses = "poses that fit together" if least > 1 else "pose that fits"
            raise InputError("boards", f"{least} {poses}, at least", got)
        masks = [fits_homography(view) for view in views]
        rig, places = begin(views, masks)
        found = adjust(views, rig, places, free, masks, prior)
        alien = [
            k
            for k, mask in enumerate(found.kept)
            if np.mean(mask) < 1.0 - _MOST_LEFT_OUT or np.count_nonzero(mask) < LEAST_POINTS
        ]
        if not alien:
            break
        strangers += [views[k].name for k in alien]
        views = [view for k, view in enumerate(views) if k not in alien]
    known = uncertainty(views, found, free, prior)
    if models["camera"] == TELECENTRIC:
        depth = float(rig.projector.pose.position[2])
        found = conventional(found, depth)
        fixed = {**fixed, "projector.tz_mm": depth}
        known = replace(known, covariance=conventional_covariance(found.rig, known.covariance))
    lost = [name for name in known.undetermined if name.partition(".")[2] in FOCAL]
    if lost:
        expected = f"poses that determine {lost[0]}"
        raise InputError("boards", expected, known.undetermined[lost[0]])
    if world is not None and world not in [view.name for view in views]:
        raise InputError("world", "a view that fits the others", world)
    there = placed(found, views, world)
    if world is not None and not views[[view.name for view in views].index(world)].placed:
        warn_user(world, "which of its points are in view cannot be told: the world may be turned")
    return BoardCalibration(
        views=tuple(views),
        rig=there.rig,
        poses=there.poses,
        kept=there.kept,
        known=known,
        models=models,
        fixed=fixed,
        world="working distance" if world is None else f"board {world}",
        strangers=tuple(strangers),
        converged=found.converged,
    )


def check_sizes(views: Sequence[BoardView]) -> None:
    """Refuse too few views, and those of other sizes."""
    if len(views) < LEAST_VIEWS:
        raise InputError("boards", f"views of {LEAST_VIEWS} poses at least", len(views))
    for view in views[1:]:
        for what in ("camera_size", "panel_size"):
            first, own = getattr(views[0], what), getattr(view, what)
            if first != own:
                name = what.removesuffix("_size")
                expected = f"a {name} of {first[0]} x {first[1]} px, as {views[0].name}"
                raise InputError(view.name, expected, f"{own[0]} x {own[1]} px")
