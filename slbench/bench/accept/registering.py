"""Views of a standard put into one frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slbench.bench.accept.evaluate import Place
from slbench.bench.accept.surfaces import Points, fit_ball
from slbench.core.errors import InputError
from slbench.rig import Pose


def registered(
    place: Place, views: Sequence[Sequence[Points]], register: str
) -> list[list[Points]]:
    """Put the points of several views into one frame, that of the first view.

    Parameters
    ----------
    place : Place
    views : sequence of sequences of Points
        Of each view, those of each ball or of the plate.
    register : {"poses", "spheres"}
        By the poses of the standard in each view, or by best fit of its balls' centres: two balls
        leave a turn about their line open, which no tested value depends on.

    Raises
    ------
    InputError
        For spheres of a standard that has none.
    """
    if len(views) == 1:
        return [list(views[0])]
    if register == "poses":
        return [
            [part.moved(*_to_first(place.poses[0], pose)) for part in view]
            for pose, view in zip(place.poses, views, strict=True)
        ]
    if place.standard.balls < 2:
        expected = "poses of the views, or a standard of at least two balls"
        raise InputError(f"{place.name}: registration", expected, place.standard.kind)
    centres = [[fit_ball(part, place.name).values[:3] for part in view] for view in views]
    found = [list(views[0])]
    for own, view in zip(centres[1:], views[1:], strict=True):
        motion = _along_one_line(np.array(own), np.array(centres[0]))
        found.append([part.moved(motion.rotation, motion.position) for part in view])
    return found


def _to_first(first: Pose, pose: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rotation and the shift from a view to where the standard is in the first."""
    rotation = first.rotation @ pose.rotation.T
    return rotation, first.position - rotation @ pose.position


def _along_one_line(own: NDArray[np.float64], to: NDArray[np.float64]) -> Pose:
    """Return the least turn that puts two centres (2, 3) on the line of two others, middles met."""
    turn, _ = Rotation.align_vectors([to[1] - to[0]], [own[1] - own[0]])
    rotation = turn.as_matrix()
    return Pose(rotation, to.mean(axis=0) - rotation @ own.mean(axis=0))
