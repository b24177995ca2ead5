"""What a calibration by boards found: a rig, boards and what is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slbench.calibration.bundle.adjustment.adjust import Adjusted, plain_residuals, right_jacobian
from slbench.calibration.bundle.adjustment.uncertainty import (
    Uncertainty,
    normal_spread_deg,
    reach_of,
)
from slbench.calibration.bundle.agreement import Agreement
from slbench.calibration.bundle.views import BoardView
from slbench.calibration.bundle.volume import coded_axis, point_covariance, volume_points
from slbench.core.show.display import brief
from slbench.patterns import Axis
from slbench.rig import Pose, Rig
from slbench.rig.parameters import POSE, ROLES, SHIFT, ParameterCovariance, optics_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class BoardCalibration:
    """A calibrated rig, k views of a board and what is known.

    Parameters
    ----------
    views : tuple of BoardView
    rig : Rig
        In the world's frame.
    poses : tuple of Pose
        Of the boards in the world.
    kept : tuple of (n,) bool
        Which points of each view were not left out.
    known : Uncertainty
    models : dict of str to str
        Model of each device.
    fixed : dict of str to float
        Parameters that were fixed, those that are conventions with them.
    world : str
        How it was placed.
    strangers : tuple of str
        Names of the views of which most points do not fit the others: left out whole.
    converged : bool
        Whether the adjustment came to rest.
    agreement : dict of str to Agreement
        How well the views agree with each device, where these were known before.
    roles : tuple of str
        The devices that were calibrated: both, or ``"camera"`` alone, beside which the rig has a
        projector that means nothing.
    """

    views: tuple[BoardView, ...]
    rig: Rig
    poses: tuple[Pose, ...]
    kept: tuple[NDArray[np.bool_], ...]
    known: Uncertainty
    models: Mapping[str, str]
    fixed: Mapping[str, float]
    world: str
    strangers: tuple[str, ...] = ()
    converged: bool = True
    agreement: Mapping[str, Agreement] = field(default_factory=dict)
    roles: tuple[str, ...] = ROLES

    __repr__ = brief

    @property
    def covariance(self) -> ParameterCovariance:
        """Covariance of the rig's parameters, relative to the camera."""
        return self.known.covariance

    @cached_property
    def residuals(self) -> tuple[tuple[Array, Array], ...]:
        """What camera and panel are off in each view, (n, 2) each, px, of all points."""
        return tuple(
            plain_residuals(self.rig, pose, view)
            for pose, view in zip(self.poses, self.views, strict=True)
        )

    def rms_px(self, device: int, view: int | None = None) -> float:
        """Root mean square distance of a device's points (0 camera, 1 panel) that are kept, px."""
        which = range(len(self.views)) if view is None else (view,)
        off = np.concatenate([self.residuals[k][device][self.kept[k]] for k in which])
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) if len(off) else float("nan")

    @property
    def left_out(self) -> tuple[tuple[str, Array, Array], ...]:
        """The points left out: their names, and what camera and panel are off, px."""
        return tuple(
            (view.label(int(j)), camera[j], panel[j])
            for view, (camera, panel), mask in zip(
                self.views, self.residuals, self.kept, strict=True
            )
            for j in np.flatnonzero(~mask)
        )

    @property
    def board_points(self) -> Array:
        """The points kept of all boards in the world, (n, 3), mm."""
        return np.concatenate(
            [
                pose.to_world(view.points_mm[mask])
                for pose, view, mask in zip(self.poses, self.views, self.kept, strict=True)
            ]
        )

    @cached_property
    def axis(self) -> Axis:
        """The panel axis that tells depth."""
        return coded_axis(self.rig, self.board_points)

    @cached_property
    def predicted(self) -> tuple[Array, Array, Array]:
        """Points through the boards' volume and their deviations along x, y, z, (n, 3) each, mm.

        The deviations of their places, and those of what is left after a rigid motion of all.
        """
        points = self.board_points
        grid = volume_points(points.min(axis=0), points.max(axis=0))
        found = (
            point_covariance(self.rig, self.covariance, grid, self.axis, aligned=aligned)
            for aligned in (False, True)
        )
        with np.errstate(invalid="ignore"):
            place, shape = (np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in found)
        return grid, place, shape

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Values and deviations by full name; zero deviation where fixed or not in the model.

        The projector's turn and shift are its rotation vector and position in the camera's frame.
        """
        camera = self.rig.camera.pose
        table: dict[str, tuple[float, float]] = {}
        std = self.covariance.std | self._pose_std
        for role in self.roles:
            device = getattr(self.rig, role)
            values = optics_of(device)
            if role == "projector":
                turn = Rotation.from_matrix(camera.rotation.T @ device.pose.rotation).as_rotvec()
                place = camera.to_local(device.pose.position)
                values |= dict(zip(POSE, (*turn, *place), strict=True))
            table |= {
                name: (float(value), 0.0 if name in self.fixed else std.get(name, 0.0))
                for name, value in ((f"{role}.{own}", value) for own, value in values.items())
            }
        return table

    @property
    def _pose_std(self) -> dict[str, float]:
        """Deviations of the projector's rotation vector and position in the camera's frame."""
        rotation = self.rig.camera.pose.rotation.T @ self.rig.projector.pose.rotation
        names = [f"projector.{name}" for name in POSE]
        # The covariance is of a turn about the projector's own axes, and of a shift along them.
        change = np.zeros((6, 6))
        vector = Rotation.from_matrix(rotation).as_rotvec()
        change[:3, :3] = np.linalg.inv(right_jacobian(vector))
        change[3:, 3:] = rotation
        variance = np.diag(change @ self.covariance.part(names) @ change.T)
        return dict(zip(names, np.sqrt(np.maximum(variance, 0.0)).tolist(), strict=True))

    @property
    def baseline_mm(self) -> tuple[float, float]:
        """Distance of the two lenses and its deviation, mm; from a telecentric camera's axis."""
        offset = self.rig.baseline
        length = float(np.linalg.norm(offset))
        along = self.rig.projector.pose.rotation.T @ offset / length
        part = self.covariance.part([f"projector.{name}" for name in SHIFT])
        return length, float(np.sqrt(along @ part @ along))

    @property
    def pixel_um(self) -> tuple[float, float] | None:
        """Size of a telecentric camera's pixel on the object, across, and its deviation, um."""
        camera = self.rig.camera
        if camera.lens.kind != "telecentric":
            return None
        focal = float(camera.matrix[0, 0])
        size = 1e3 * camera.lens.focus_distance_mm / focal
        return size, size * self.covariance.std.get("camera.fx_px", 0.0) / focal

    def to_dict(self) -> dict[str, Any]:
        """Return the outcome as plain values for JSON."""
        pixel = self.pixel_um
        both = (
            {}
            if self.roles != ROLES
            else {
                "baseline_mm": dict(zip(("value", "std"), self.baseline_mm, strict=True)),
                "predicted_std_um": self._predicted_um(),
            }
        )
        return both | {
            "views": len(self.views),
            "points": int(sum(mask.sum() for mask in self.kept)),
            "rms_px": {role: self.rms_px(k) for k, role in enumerate(self.roles)},
            "chi_square": self.known.chi_square,
            "pose_factor": self.known.pose_factor,
            "models": dict(self.models),
            "fixed": dict(self.fixed),
            "world": self.world,
            "parameters": {
                name: {"value": value, "std": std} for name, (value, std) in self.parameters.items()
            },
            "pixel_um": pixel and dict(zip(("value", "std"), pixel, strict=True)),
            "converged": self.converged,
            "undetermined": self.known.undetermined,
            "distortion_std_px": {
                role: {"seen": one.seen_px, "picture": one.picture_px, "together": one.together}
                for role, one in self.known.distortion.items()
            },
            "agreement": {
                role: {**asdict(one), "most": one.most} for role, one in self.agreement.items()
            },
            "normal_spread_deg": normal_spread_deg(self._adjusted),
            "reach": {role: reach_of(self.views, self._adjusted, role) for role in self.roles},
            "poses": [
                {
                    "name": view.name,
                    "points": len(view),
                    "left_out": int(np.count_nonzero(~mask)),
                    **{f"{role}_rms_px": self.rms_px(n, k) for n, role in enumerate(self.roles)},
                    "rotation": pose.rotation,
                    "position_mm": pose.position,
                }
                for k, (view, pose, mask) in enumerate(
                    zip(self.views, self.poses, self.kept, strict=True)
                )
            ],
            "strangers": list(self.strangers),
            "left_out": [
                {"point": name}
                | {f"{role}_px": off for role, off in zip(self.roles, both_off, strict=False)}
                for name, *both_off in self.left_out
            ],
        }

    def _predicted_um(self) -> dict[str, Any]:
        _, *deviations = self.predicted
        seen = np.isfinite(deviations[0][:, 2])
        return {
            "axis": self.axis,
            "points": int(seen.sum()),
            **{
                name: {
                    "median": 1e3 * np.median(one[seen], axis=0),
                    "largest": 1e3 * np.max(one[seen], axis=0),
                }
                for name, one in zip(("place", "shape"), deviations, strict=True)
                if seen.any()
            },
        }

    @property
    def _adjusted(self) -> Adjusted:
        return Adjusted(
            rig=self.rig, poses=self.poses, kept=self.kept, scales=np.ones((len(self.views), 2))
        )
