"""Views of a standard put into one frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slbench.bench.accept.evaluate import Place
from slbench.bench.accept.surfaces import Points, fit_ball
from slbench.core.errors import InputError
from slbench.rig import Pose

Register = Literal["poses", "spheres"]


def in_one_order(
    place: Place, views: Sequence[Sequence[Points]], register: Register
) -> list[list[Points]]:
    """Return the views' balls in the order of the first view: two balls of a bar look alike.

    By the poses of the standard each ball is the nearest one in the first view.  Without them the
    bar turned by less than a right angle between the views.

    Parameters
    ----------
    place, views, register
        As in :func:`registered`; the views in the instrument's frame.
    """
    found = [list(view) for view in views]
    if len(found[0]) < 2:
        return found
    middles = [np.array([part.points.mean(axis=0) for part in view]) for view in found]
    for k in range(1, len(found)):
        own, first = middles[k], middles[0]
        if register == "poses":
            rotation, shift = _to_first(place.poses[0], place.poses[k])
            own = own @ rotation.T + shift
            gaps = [np.linalg.norm(one - first, axis=1).sum() for one in (own, own[::-1])]
            crossed = gaps[1] < gaps[0]
        else:
            crossed = (own[1] - own[0]) @ (first[1] - first[0]) < 0.0
        if crossed:
            found[k].reverse()
    return found


def registered(
    place: Place, views: Sequence[Sequence[Points]], register: Register
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
