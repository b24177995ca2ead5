"""Uniform motion: velocity and rotation of something between the frames of a scan.

*Time.*  Zero is the middle of the pictures that decide the coordinates
(:attr:`slbench.patterns.PatternSequence.middle_picture`), in the picture's middle row: the time of
which a scan's points are.  What is said to stand somewhere stands there then.

A motion at velocity v and angular velocity w about a centre c moves a point X to

    X(t) = R(w t) (X - c) + c + v t,

so that the centre moves along and the axis keeps its direction (L. Euler's rotation vector; the
matrix is O. Rodrigues').
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.show.display import numbers
from slbench.core.validation.types import NotNegative, Positive, Vector
from slbench.core.validation.values import Value
from slbench.rig.pose import Pose

Array = NDArray[np.float64]
#: Where something is by its motion at a time, s: ``to_world`` takes points of time zero there.
Moving = Callable[[float], Pose]

#: Whether motion is taken out of frames: not, that which is known, or what they tell of it.
Compensation = Literal["none", "known", "estimated"]
COMPENSATIONS: tuple[Compensation, ...] = ("none", "known", "estimated")


@dataclass(frozen=True, kw_only=True)
class Motion(Value):
    """A uniform motion in the world.

    Parameters
    ----------
    velocity_mm_per_s : (3,) float
        Along x, y and z.
    rotation_deg_per_s : (3,) float
        Angular velocity: its direction is the axis, by the right hand.
    centre_mm : (3,) float or None
        A point of the axis at time zero; None for the middle of what moves.
    """

    velocity_mm_per_s: Vector = (0.0, 0.0, 0.0)
    rotation_deg_per_s: Vector = (0.0, 0.0, 0.0)
    centre_mm: Vector | None = None

    def __str__(self) -> str:
        text = f"{numbers(self.velocity_mm_per_s)} mm/s"
        if not any(self.rotation_deg_per_s):
            return text
        about = "its middle" if self.centre_mm is None else f"({numbers(self.centre_mm)}) mm"
        return f"{text}, {numbers(self.rotation_deg_per_s)} deg/s about {about}"

    @property
    def is_rest(self) -> bool:
        """Whether nothing moves."""
        return not any((*self.velocity_mm_per_s, *self.rotation_deg_per_s))

    def at(self, time_s: float, middle: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
        """Return where points of time zero are at a time: its ``to_world``.

        Parameters
        ----------
        time_s : float
        middle : (3,) float
            The centre, where none is stated, mm.
        """
        centre = np.asarray(middle if self.centre_mm is None else self.centre_mm, np.float64)
        turned = cv2.Rodrigues(np.deg2rad(self.rotation_deg_per_s) * time_s)[0]
        travel = np.multiply(self.velocity_mm_per_s, time_s)
        return Pose(turned, centre + travel - turned @ centre)


def followed(pose: Pose, by: Pose) -> Pose:
    """Return a pose after a motion."""
    return Pose(by.rotation @ pose.rotation, by.to_world(pose.position))


def seen_from(moving: Pose, observer: Pose) -> Pose:
    """Return a motion as an observer sees it who has moved himself: observer^-1 moving."""
    back = observer.rotation.T
    return Pose(back @ moving.rotation, back @ (moving.position - observer.position))


@dataclass(frozen=True, kw_only=True)
class FrameTiming(Value):
    """When the pictures of a scan are taken.

    Parameters
    ----------
    period_s : float
        From a picture to the next.
    rolling_s : float
        How much later the last row of a picture is exposed than its first; zero for all at once.
    """

    period_s: Positive
    rolling_s: NotNegative = 0.0

    def middles(self, pictures: int, zero: float) -> Array:
        """Return the time of the middle row of each picture, (pictures,), s.

        Parameters
        ----------
        pictures : int
        zero : float
            The picture whose time is zero, or a place between two.
        """
        return np.asarray((np.arange(pictures) - zero) * self.period_s, np.float64)

    def delays(self, rows: int) -> Array:
        """Return how much later than the middle row each is exposed, (rows,), s."""
        if rows == 1:
            return np.zeros(1)
        return np.asarray((np.arange(rows, dtype=np.float64) / (rows - 1) - 0.5) * self.rolling_s)
