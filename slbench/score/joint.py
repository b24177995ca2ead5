"""Scores of points that several cameras and projectors measured together.

A point stands on the centre ray of a pixel of one camera (:mod:`slbench.cloud.joint`), and is
compared with what that ray truly meets, as a single camera's is.  Completeness is over places of
the surface that any projector lights and any camera sees, each once
(:class:`slbench.scene.lit.LitSurface`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.joint import JointCloud
from slbench.core.show.display import block, share
from slbench.rig import Pair
from slbench.scene.lit import LitSurface
from slbench.scene.model import SceneObject
from slbench.scene.truth import GroundTruth
from slbench.score.points import Score, by_kind, error_numbers, features_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class JointTruth:
    """What is true of a scene before several cameras and projectors.

    Parameters
    ----------
    truths : mapping of Pair to GroundTruth
    surface : LitSurface
    """

    truths: Mapping[Pair, GroundTruth]
    surface: LitSurface

    def __repr__(self) -> str:
        return block(f"JointTruth of {len(self.truths)} pairs", repr(self.surface))

    def lit(self, camera: str) -> Mask:
        """Return the pixels of a camera that see a point which any projector lights, (V, U)."""
        return np.logical_or.reduce([truth.lit for truth in self._of(camera)])

    def smooth(self, camera: str) -> Mask:
        """Return the pixels of a camera on smooth surface that one projector lights, (V, U)."""
        return np.logical_or.reduce([truth.smooth() for truth in self._of(camera)])

    def one(self, camera: str) -> GroundTruth:
        """Return the truth of a camera and any projector, for what the camera alone decides."""
        return self._of(camera)[0]

    def _of(self, camera: str) -> list[GroundTruth]:
        return [truth for pair, truth in self.truths.items() if pair.camera == camera]


@dataclass(frozen=True)
class JointScore:
    """Errors of points that several cameras and projectors measured together.

    Parameters
    ----------
    points : Score
        ``completeness`` is over places of the lit surface; of panel coordinates it says nothing.
    alone : dict of str to float
        Share of these places that the points of each pair alone measure, by its name.
    visible : dict of str to float
        Share of them that each camera sees.
    rays : dict of int to int
        Number of points by the number of devices whose rays meet in them.
    chi_square : float
        Mean reduced chi-square of points of more than two devices; NaN where there are none.
    """

    points: Score
    alone: dict[str, float]
    visible: dict[str, float]
    rays: dict[int, int]
    chi_square: float

    def __repr__(self) -> str:
        of = ", ".join(f"{name} {share(value)}" for name, value in self.alone.items())
        return block(repr(self.points), f"places measured by {of} alone")

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers as they are shown, (quantity, value)."""
        of_places = [
            (name, value.replace("lit pixels", "lit places") if name == "completeness" else value)
            for name, value in self.points.rows()
        ]
        alone = [(f"completeness of {n} alone", f"{100 * s:.2f} %") for n, s in self.alone.items()]
        counts = ", ".join(f"{count} of {rays}" for rays, count in self.rays.items())
        chi = "" if np.isnan(self.chi_square) else f", reduced χ² {self.chi_square:.2f}"
        return [*of_places, *alone, ("points by rays", f"{counts}{chi}")]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return self.points.to_dict() | {
            "completeness_alone": self.alone,
            "visible": self.visible,
            "rays": {str(rays): count for rays, count in self.rays.items()},
            "chi_square": self.chi_square,
        }


def joint_errors(cloud: JointCloud, truth: JointTruth) -> Array:
    """Return measured minus true point, (N, 3), mm; NaN where no projector lights the true one."""
    error = np.full((len(cloud), 3), np.nan)
    for k, camera in enumerate(cloud.shapes):
        own = cloud.camera == k
        columns, rows = cloud.pixels[own].T
        error[own] = cloud.points[own] - truth.one(camera).point[rows, columns]
        error[np.flatnonzero(own)[~truth.lit(camera)[rows, columns]]] = np.nan
    return error


def measured_pixels(cloud: JointCloud) -> dict[str, Mask]:
    """Return the pixels of each camera in which it has or shares a point, (V, U)."""
    found = {camera: np.zeros(shape, np.bool_) for camera, shape in cloud.shapes.items()}
    for k, mask in enumerate(found.values()):
        place = cloud.places[:, k]
        u, v = np.rint(place[np.isfinite(place[:, 0])]).astype(np.intp).T
        mask[v, u] = True
    return found


def score_jointly(
    cloud: JointCloud,
    truth: JointTruth,
    masks: Mapping[Pair, Mask],
    objects: Sequence[SceneObject] = (),
) -> JointScore:
    """Score points of several cameras and projectors against exact truth.

    Parameters
    ----------
    cloud : JointCloud
    truth : JointTruth
    masks : mapping of Pair to (V, U) bool
        Pixels at which each pair has a point of its own.
    objects : sequence of SceneObject
        Whose features are fitted.
    """
    error = joint_errors(cloud, truth)
    in_smooth = np.zeros(len(cloud), np.bool_)
    owner, line = np.full(len(cloud), -1, np.int32), np.zeros(len(cloud), np.int32)
    lines = max(max(shape) for shape in cloud.shapes.values())
    for k, camera in enumerate(cloud.shapes):
        own = cloud.camera == k
        columns, rows = cloud.pixels[own].T
        in_smooth[own] = truth.smooth(camera)[rows, columns]
        ids = truth.one(camera).object_id[rows, columns]
        owner[own] = np.where(truth.lit(camera)[rows, columns], ids, -1)
        # What a projector does to the phase is the same along the camera line that follows it.
        line[own] = k * lines + (columns if "u" in cloud.axes else rows)
    surface, lit = truth.surface, {camera: truth.lit(camera) for camera in cloud.shapes}
    measured = {camera: mask & lit[camera] for camera, mask in measured_pixels(cloud).items()}
    alone = {
        "-".join(pair): _share(surface.measured({pair.camera: mask & lit[pair.camera]}))
        for pair, mask in masks.items()
    }
    features = features_of(cloud, owner, in_smooth, line, objects, None, False)
    rays, counts = np.unique(cloud.rays, return_counts=True)
    known = cloud.chi_square[np.isfinite(cloud.chi_square)]
    return JointScore(
        points=Score(
            completeness=_share(surface.measured(measured)),
            **error_numbers(cloud, error, in_smooth),
            smooth_bias_px={},
            smooth_rms_px={},
            **by_kind(features),
        ),
        alone=alone,
        visible={camera: _share(surface.seen_by([camera])) for camera in cloud.shapes},
        rays={int(n): int(count) for n, count in zip(rays, counts, strict=True)},
        chi_square=float(known.mean()) if len(known) else float("nan"),
    )


def _share(chosen: Mask) -> float:
    return float(chosen.mean()) if chosen.size else float("nan")
