"""A scene of the leaderboard: what entrants are given, and the truth.

Frames are those of the pattern set {1, 32} of three shifts each: numbers 0 to 2 have one fringe
across the panel, 3 to 5 have 32.  Of a panel coordinate u (pixel centres at integers) on a panel
of width W, the fringes' absolute phase is ``2 pi 32 (u + 1/2) / W``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.cloud.triangulation import meet
from slbench.datasets.read.stored import Sample
from slbench.patterns.phase import relative_phase
from slbench.rig import Rig
from slbench.scene.truth import GroundTruth

Array = NDArray[np.float64]
#: Fringes of frames 3 to 5, and of frames 0 to 2.
FRINGES, COARSE = 32, 1
SHIFTS = 3
TURN = 2.0 * np.pi
#: Name of the stored capture.
CAPTURE = "p0r0"


@dataclass(frozen=True)
class Scene:
    """One scene; every part is computed on first use.

    Parameters
    ----------
    sample : Sample
        Of the leaderboard's data set.
    """

    sample: Sample

    @property
    def key(self) -> str:
        """Its number in six digits: the name of predictions."""
        return str(self.sample.row["key"])

    @cached_property
    def shots(self) -> Capture:
        """Its six frames."""
        return self.sample.stored(CAPTURE)

    @property
    def frames(self) -> NDArray[np.uint8]:
        """Frames, (6, V, U)."""
        return np.asarray(self.shots.frames)

    @property
    def shape(self) -> tuple[int, int]:
        """Size of its maps, (V, U)."""
        return self.frames.shape[1], self.frames.shape[2]

    @property
    def rig(self) -> Rig:
        """Camera and projector, as they are."""
        return self.sample.rig

    @property
    def panel_width(self) -> int:
        """Width of the panel, px."""
        return self.rig.projector.width

    @property
    def truth(self) -> GroundTruth:
        """Ground truth."""
        return self.sample.truth

    @cached_property
    def phase(self) -> Array:
        """Phase of frames 3 to 5 by least squares, rad in [0, 2 pi), (V, U)."""
        return relative_phase(self.frames[SHIFTS:])[0]

    @cached_property
    def decoded_depth(self) -> Array:
        """Depth by slbench's decoder from all frames, mm, NaN where it measures none, (V, U)."""
        return depth_of(self.rig, self.shots.decode().coordinate["u"])


def depth_of(rig: Rig, coordinate: Array) -> Array:
    """Return the depth along the camera's axis, mm, of panel columns, px; NaN where there is none.

    Parameters
    ----------
    rig : Rig
    coordinate : (V, U) float
    """
    v, u = np.nonzero(np.isfinite(coordinate))
    panel = coordinate[v, u][:, np.newaxis]
    points, _ = meet(rig, np.column_stack((u, v)), ("u",), panel, np.ones_like(panel))
    depth = np.full(coordinate.shape, np.nan)
    depth[v, u] = rig.camera.pose.to_local(points)[:, 2]
    return depth
