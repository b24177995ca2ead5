"""A rig: cameras and projectors by name around a measurement volume (thesis 3.1.2).

What follows from one camera and one projector (angle, distances, the stages of a scan) is asked
of the rig of a pair, :meth:`Rig.pair`; a rig of two devices is that of its only pair.

**Design frame** D: origin at the projector's nodal point, x right, y down, z towards the
object.  Six design variables fix the rig: the projector is turned by ``R_DP = Ry(alpha_P)
Rx(beta_P)``; its axis meets the reference plane ``z = z_ref`` at ``O_W``; the camera stands at
``(w, h, l)`` and is aimed at ``O_W`` with zero roll.

**World frame** W: origin ``O_W``, x parallel to D's x, z towards the devices: D's axes turned
by pi about x.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import block, numbers
from slbench.core.show.drawing import figure
from slbench.core.validation.types import Coordinate, Measure
from slbench.core.validation.values import Value
from slbench.rig.device import Camera, Device, Projector
from slbench.rig.optics.lens import Lens
from slbench.rig.pose import Pose, box_corners

Array = NDArray[np.float64]

#: World axes in the design frame: a turn by pi about x.
_DESIGN_TO_WORLD = np.diag([1.0, -1.0, -1.0])


def rotation_yx(alpha: ArrayLike, beta: ArrayLike) -> Array:
    """Return ``Ry(alpha) Rx(beta)``, (..., 3, 3): thesis eq. 3; columns are the turned axes.

    Parameters
    ----------
    alpha, beta : (...) float
        Angles, rad.
    """
    a, b = np.broadcast_arrays(np.asarray(alpha, np.float64), np.asarray(beta, np.float64))
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    out = np.empty((*ca.shape, 3, 3))
    rows = ((ca, sa * sb, sa * cb), (0.0, cb, -sb), (-sa, ca * sb, ca * cb))
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            out[..., i, j] = value
    return out


@dataclass(frozen=True)
class DesignVariables(Value):
    """The six design variables of thesis 3.1.2, in mm and rad."""

    z_ref: Measure
    w: Coordinate
    h: Coordinate
    l: Coordinate  # noqa: E741 - the thesis's name
    alpha_p: Coordinate
    beta_p: Coordinate

    def __post_init__(self) -> None:
        super().__post_init__()
        axis = rotation_yx(self.alpha_p, self.beta_p)[:, 2]
        if axis[2] <= 0:
            raise InputError(
                "design variables: alpha_p, beta_p",
                "a projector axis that meets the reference plane in front",
                f"{self.alpha_p}, {self.beta_p} rad",
            )

    @property
    def target(self) -> Array:
        """``O_W`` in the design frame: where the projector's axis meets the plane, (3,)."""
        axis = rotation_yx(self.alpha_p, self.beta_p)[:, 2]
        return axis * (self.z_ref / axis[2])

    def poses(self) -> tuple[Pose, Pose]:
        """Return the poses of camera and projector in the world frame.

        Raises
        ------
        InputError
            If the camera does not stand in front of the target.
        """
        target = self.target
        position = np.array([self.w, self.h, self.l])
        view = target - position
        if np.linalg.norm(view) < 1e-9:
            raise InputError("design variables", "a camera apart from the target", position)
        alpha_c = np.arctan2(view[0], view[2])
        beta_c = np.arctan2(-view[1], np.hypot(view[0], view[2]))
        camera = Pose(
            _DESIGN_TO_WORLD @ rotation_yx(alpha_c, beta_c), _DESIGN_TO_WORLD @ (position - target)
        )
        projector = Pose(
            _DESIGN_TO_WORLD @ rotation_yx(self.alpha_p, self.beta_p), _DESIGN_TO_WORLD @ -target
        )
        return camera, projector


class Pair(NamedTuple):
    """A camera and a projector by name: what a light transport, a truth and a capture are of."""

    camera: str = "camera"
    projector: str = "projector"


#: Devices that a rig's ``repr`` has lines for.
_SHOWN_DEVICES = 4

#: Nearer to a device than this the origin is not before it but in its lens, mm.
LEAST_DEPTH_MM = 1e-3

#: Size of a measurement volume that nobody states.
VOLUME_MM = (60.0, 70.0, 30.0)

#: The names of a camera and a projector that have no others beside them.
ALONE = Pair()


@dataclass(frozen=True, init=False)
class Rig:
    """Cameras, projectors and measurement volume, posed in the world; devices have names.

    Parameters
    ----------
    cameras : Camera or mapping of str to Camera
        One camera goes by the name "camera".
    projectors : Projector or mapping of str to Projector
        One projector goes by the name "projector"; none where cameras alone are calibrated.
    volume_mm : (float, float, float)
        Size of the measurement volume along the world's axes, centred on the origin.

    Attributes
    ----------
    cameras, projectors : mapping of str to Camera or Projector
        At least one of each, or two cameras; a name belongs to one device.
    """

    cameras: Mapping[str, Camera]
    projectors: Mapping[str, Projector]
    volume_mm: tuple[float, float, float]

    def __init__(
        self,
        cameras: Camera | Mapping[str, Camera],
        projectors: Projector | Mapping[str, Projector],
        volume_mm: tuple[float, float, float] = VOLUME_MM,
    ) -> None:
        if not isinstance(cameras, Mapping):
            cameras = {ALONE.camera: cameras}
        if not isinstance(projectors, Mapping):
            projectors = {ALONE.projector: projectors}
        for name, value in (
            ("cameras", dict(cameras)),
            ("projectors", dict(projectors)),
            ("volume_mm", volume_mm),
        ):
            object.__setattr__(self, name, value)
        alone = len(cameras) + len(projectors) < 2  # two cameras measure without a projector
        if not cameras or alone or set(cameras) & set(projectors):
            expected = "cameras and projectors, each with a name of its own"
            raise InputError("rig devices", expected, [*cameras, *projectors])
        if len(volume_mm) != 3 or not all(0 < size < np.inf for size in volume_mm):
            raise InputError("rig volume", "three positive lengths (mm)", volume_mm)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Each camera with each projector, by name."""
        return tuple(Pair(*names) for names in product(self.cameras, self.projectors))

    def pair(self, pair: Pair) -> Self:
        """Return the rig of one camera and one projector, which keep their names.

        Raises
        ------
        InputError
            If the rig has no such device.
        """
        if pair not in self.pairs:
            names = ["-".join(one) for one in self.pairs]
            expected = f"a pair of {', '.join(names) or 'a camera and a projector'}"
            raise InputError("rig devices", expected, "-".join(pair))
        camera, projector = self.cameras[pair.camera], self.projectors[pair.projector]
        return type(self)({pair.camera: camera}, {pair.projector: projector}, self.volume_mm)

    @property
    def only(self) -> Pair:
        """Names of the only camera and the only projector.

        Raises
        ------
        InputError
            If there are more: a stage that is for one pair takes ``rig.pair(...)``.
        """
        return Pair(_only(self.cameras), _only(self.projectors))

    @property
    def camera(self) -> Camera:
        """The only camera; refused where there are more."""
        return self.cameras[_only(self.cameras)]

    @property
    def projector(self) -> Projector:
        """The only projector; refused where there are more."""
        return self.projectors[_only(self.projectors)]

    @property
    def devices(self) -> Mapping[str, Camera | Projector]:
        """All devices by name, cameras first."""
        return {**self.cameras, **self.projectors}

    def having(self, **devices: Camera | Projector) -> Self:
        """Return the rig with other devices under names that it has.

        Examples
        --------
        ``rig.having(camera=replace(rig.camera, width=320))``
        """
        self._check_names(devices)
        new: dict[str, Any] = {**self.devices, **devices}
        return type(self)(
            {name: new[name] for name in self.cameras},
            {name: new[name] for name in self.projectors},
            self.volume_mm,
        )

    def focused(self, distances_mm: Mapping[str, float]) -> Self:
        """Return the rig with devices, by name, focused at other distances.

        Raises
        ------
        InputError
            If the rig has no such device.
        """
        self._check_names(distances_mm)
        return self._with_lenses(
            {name: self.devices[name].lens.refocused(d) for name, d in distances_mm.items()}
        )

    def all_in_focus(self) -> Self:
        """Return the rig with lenses that are sharp at every distance, diffraction included."""
        return self._with_lenses(
            {name: replace(d.lens, all_in_focus=True) for name, d in self.devices.items()}
        )

    def _check_names(self, names: Iterable[str]) -> None:
        for name in names:
            if name not in self.devices:
                raise InputError("rig devices", f"one of {', '.join(self.devices)}", name)

    def _with_lenses(self, lenses: Mapping[str, Lens]) -> Self:
        devices = {name: replace(self.devices[name], lens=lens) for name, lens in lenses.items()}
        return self.having(**devices)

    @classmethod
    def from_design(
        cls,
        design: DesignVariables,
        camera: Camera,
        projector: Projector,
        volume_mm: tuple[float, float, float] = VOLUME_MM,
    ) -> Self:
        """Place `camera` and `projector` (their poses are replaced) by the design variables."""
        camera_pose, projector_pose = design.poses()
        return cls(camera.posed(camera_pose), projector.posed(projector_pose), volume_mm)

    def __repr__(self) -> str:
        size = numbers(self.volume_mm, " x ")
        one = len(self.pairs) == 1
        known = one and np.isfinite(self.angle)
        angle = f", triangulation angle {np.rad2deg(self.angle):.1f}°" if known else ""
        names = list(self.devices)
        more = f"and {len(names) - _SHOWN_DEVICES} more" if len(names) > _SHOWN_DEVICES else ""
        return block(
            f"Rig with a volume of {size} mm{angle}",
            *(f"{name}: {self.devices[name]!r}" for name in names[:_SHOWN_DEVICES]),
            more,
        )

    def plot(self) -> Any:
        """Return a matplotlib figure: devices and volume to scale, from the front and the side."""
        return figure(self)

    @property
    def camera_distance(self) -> float:
        """Distance from the camera's nodal point to the world's origin, mm."""
        return float(np.linalg.norm(self.camera.pose.position))

    @property
    def projector_distance(self) -> float:
        """Distance from the projector's nodal point to the world's origin, mm."""
        return float(np.linalg.norm(self.projector.pose.position))

    @property
    def baseline(self) -> Array:
        """From the camera's nodal point to the projector's, (3,), mm.

        From its axis where the camera is telecentric, whose place along it does not matter.
        """
        offset = self.camera.pose.to_local(self.projector.pose.position)
        if self.camera.lens.kind == "telecentric":
            offset[2] = 0.0
        return self.camera.pose.rotation @ offset

    @property
    def angle(self) -> float:
        """Triangulation angle: between the two lines from the origin to the devices, rad.

        NaN where a device is at the origin.
        """
        if not (self.camera_distance and self.projector_distance):
            return np.nan
        cosine = (self.camera.pose.position @ self.projector.pose.position) / (
            self.camera_distance * self.projector_distance
        )
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))

    @property
    def faces_origin(self) -> bool:
        """Whether the world's origin, the middle of the volume, is before every device.

        It is not where the world is the frame of a device, as in a file of ``cv2.stereoCalibrate``.
        """
        return all(one.pose.origin_depth > LEAST_DEPTH_MM for one in self.devices.values())

    @property
    def volume_corners(self) -> Array:
        """The eight corners of the measurement volume, (8, 3), world frame."""
        half = np.array(self.volume_mm) / 2.0
        return box_corners(-half, half)


def _only(devices: Mapping[str, Device]) -> str:
    if len(devices) != 1:
        expected = "one camera and one projector (those of a pair)"
        raise InputError("rig devices", expected, ", ".join(devices) or "no projector")
    return next(iter(devices))
