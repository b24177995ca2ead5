"""What a rig is designed from: optics, bodies, working distances, ranges of the variables.

A :class:`Hardware` is thesis tables 2 and 3 in one value: camera and projector without a
place, the measurement volume, the working distances of the lenses and the ranges of the six
design variables.  :meth:`Hardware.place` puts both devices where many configurations say, all
at once (thesis 3.1.2); constraints and evaluator start from there.

Files: the ``[camera]``, ``[projector]`` and ``[rig]`` tables of a scene, and ``[design]``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slbench.core import resources
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import read_table
from slbench.core.show.display import brief
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Coordinate, Measure, Pair, Size
from slbench.core.validation.values import Value, validated
from slbench.detector.base import DetectorModel
from slbench.detector.emva1288 import Detector
from slbench.rig import (
    Camera,
    DesignVariables,
    Device,
    Projector,
    Rig,
    box_corners,
    rotation_yx,
)
from slbench.scene.changes import Changes, apply_changes, naming_changes, read_changes
from slbench.scene.devices.detector import read_detector
from slbench.scene.devices.optics import CameraOptics, ProjectorOptics
from slbench.scene.file import read_merged

Array = NDArray[np.float64]
#: Panel axes that are coded: named, or how many.
CodedAxes = Literal[1, 2, "u", "v", "uv"]
AnyDevice = TypeVar("AnyDevice", bound=Device)

#: Names of the six design variables, as in files.
VARIABLES = ("z_ref_mm", "w_mm", "h_mm", "l_mm", "alpha_p_deg", "beta_p_deg")

_FLIP = np.array([1.0, -1.0, -1.0])  # world axes in the design frame
#: A projector's axis closer to parallel to the reference plane than this never meets it.
_GRAZING = 1e-9
#: A camera this close to the point it aims at (mm) has no direction.
_COINCIDENT_MM = 1e-6


@dataclass(frozen=True)
class Placement:
    """Devices placed by n configurations, in the world frame.

    Parameters
    ----------
    camera_rotation, projector_rotation : (n, 3, 3) float
        Columns are the device's axes.
    camera_position, projector_position : (n, 3) float
        Nodal points, mm.
    camera_distance, projector_distance : (n,) float
        From the nodal points to the world's origin, mm.
    angle : (n,) float
        Triangulation angle, rad.
    valid : (n,) bool
        False where the projector's axis does not meet the reference plane in front of it, or
        the camera stands on the point it aims at; everything else is NaN there.
    """

    camera_rotation: Array
    camera_position: Array
    projector_rotation: Array
    projector_position: Array
    camera_distance: Array
    projector_distance: Array
    angle: Array
    valid: NDArray[np.bool_]

    __repr__ = brief

    def of(self, rows: Sequence[int]) -> Placement:
        """Return the placement of some of the configurations."""
        return Placement(*(getattr(self, each.name)[rows] for each in fields(self)))


@dataclass(frozen=True)
class Hardware(Value):
    """Hardware to design a rig from (thesis tables 2 and 3).

    Parameters
    ----------
    camera : Camera
    projector : Projector
        With bodies; their poses have no meaning here.
    camera_distance_mm, projector_distance_mm : (float, float)
        Shortest and longest working distance.
    lower, upper : six floats
        Ranges of z_ref, w, h, l (mm) and alpha_P, beta_P (rad).
    volume_mm : (float, float, float)
        Measurement volume along the world's axes, centred on the origin.
    coded_axes : {1, 2, "u", "v", "uv"}
        Panel axes that the patterns encode: columns (u), rows (v) or both (uv, which is 2).  1 is
        one of them, for each configuration the one of the smaller predicted error: that along
        the baseline.
    circle_px : float
        Acceptable circle of confusion, pixels of the device's own panel.
    detector : DetectorModel
        Of the camera; the evaluator's geometry does without.
    refocused : (bool, bool)
        Whether camera and projector are focused on the world's origin wherever they stand;
        otherwise their lenses stay at ``focus_distance_mm``.
    """

    camera: Camera
    projector: Projector
    camera_distance_mm: tuple[Measure, Measure]
    projector_distance_mm: tuple[Measure, Measure]
    lower: tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]
    upper: tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]
    volume_mm: Size = (60.0, 70.0, 30.0)
    coded_axes: CodedAxes = 1
    circle_px: Measure = 1.0
    refocused: tuple[bool, bool] = (True, True)
    detector: DetectorModel = field(default_factory=Detector)

    __repr__ = brief

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("camera", "projector"):
            near, far = getattr(self, f"{name}_distance_mm")
            if not near < far:
                raise InputError(
                    f"{name} working distance", "shortest < longest (mm)", f"{near}, {far}"
                )
            device: Device = getattr(self, name)
            if not device.has_body:
                expected = "the size of the housing (mm), or barrel_mm"
                raise InputError(f"{name} body_mm", expected, "none")
            refocused = self.refocused[("camera", "projector").index(name)]
            if refocused and device.lens.kind == "telecentric" and any(device.distortion):
                raise InputError(
                    f"{name} focus_distance_mm",
                    "a fixed distance with a distorted telecentric lens",
                    "none",
                )
            if not refocused and not np.isfinite(device.lens.focus_distance_mm):
                raise InputError(f"{name} focus_distance_mm", "a finite distance", "infinity")
        for name, low, high in zip(VARIABLES, self.lower, self.upper, strict=True):
            if not low <= high:
                raise InputError(f"range of {name}", "lowest <= highest", f"{low}, {high}")
            if name.endswith("deg") and max(abs(low), abs(high)) > np.pi / 2 + 1e-9:
                raise InputError(f"range of {name}", "angles within 90 deg", f"{low}, {high} rad")
        if self.lower[0] <= 0:
            raise InputError("range of z_ref_mm", "positive distances", self.lower[0])

    @property
    def volume_corners(self) -> Array:
        """The eight corners of the measurement volume, (8, 3), world frame."""
        half = np.array(self.volume_mm) / 2.0
        return box_corners(-half, half)

    def focused(self, device: AnyDevice, distance: float) -> AnyDevice:
        """Return `device` focused at `distance` (mm), unless the hardware fixes its focus."""
        if not self.refocused[0 if isinstance(device, Camera) else 1]:
            return device
        lens = device.lens
        if lens.kind == "telecentric":
            # Magnification and cone of rays stay: both lengths go with the distance.
            return replace(device, lens=lens.refocused(distance))
        return replace(device, lens=replace(lens, focus_distance_mm=distance))

    def rig(self, variables: DesignVariables | ArrayLike) -> Rig:
        """Return the rig that one configuration describes, in focus.

        Raises
        ------
        InputError
            If the configuration is not a rig; see :class:`~slbench.rig.DesignVariables`.
        """
        if not isinstance(variables, DesignVariables):
            variables = DesignVariables(*(float(x) for x in as_configurations(variables)[0]))
        rig = Rig.from_design(variables, self.camera, self.projector, self.volume_mm)
        return rig.having(
            camera=self.focused(rig.camera, rig.camera_distance),
            projector=self.focused(rig.projector, rig.projector_distance),
        )

    def place(self, configurations: ArrayLike | Sequence[DesignVariables]) -> Placement:
        """Place both devices by many configurations (thesis eq. 3 and section 3.1.2).

        Parameters
        ----------
        configurations : (n, 6) float or list of DesignVariables
            In mm and rad.

        Raises
        ------
        InputError
            If they are not numbers, six each.
        """
        rows = as_configurations(configurations)
        z_ref, alpha, beta = rows[:, 0], rows[:, 4], rows[:, 5]
        projector = rotation_yx(alpha, beta)
        axis = projector[:, :, 2]
        meets = (z_ref > 0) & (axis[:, 2] > _GRAZING)
        target = axis * (z_ref / np.where(meets, axis[:, 2], np.nan))[:, None]
        view = target - rows[:, 1:4]
        valid = meets & (np.linalg.norm(view, axis=1) > _COINCIDENT_MM)
        view[~valid] = np.nan
        target[~valid] = np.nan
        camera = rotation_yx(
            np.arctan2(view[:, 0], view[:, 2]),
            np.arctan2(-view[:, 1], np.hypot(view[:, 0], view[:, 2])),
        )
        near, far = -view * _FLIP, -target * _FLIP
        near_length, far_length = np.linalg.norm(near, axis=1), np.linalg.norm(far, axis=1)
        cosine = np.sum(near * far, axis=1) / (near_length * far_length)
        return Placement(
            camera * _FLIP[:, None],
            near,
            projector * _FLIP[:, None],
            far,
            near_length,
            far_length,
            np.arccos(np.clip(cosine, -1.0, 1.0)),
            valid,
        )


def as_configurations(values: ArrayLike | Sequence[DesignVariables]) -> Array:
    """Return configurations as (n, 6) float, mm and rad; one row may stand alone.

    Raises
    ------
    InputError
        If they are not finite numbers, six each.
    """
    if isinstance(values, DesignVariables):
        values = [values]
    if isinstance(values, Sequence) and values and isinstance(values[0], DesignVariables):
        values = [(v.z_ref, v.w, v.h, v.l, v.alpha_p, v.beta_p) for v in values]  # type: ignore[union-attr]
    expected = "(n, 6) finite numbers: z_ref w h l (mm), alpha_P beta_P (rad)"
    try:
        rows = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("configurations", expected, error) from None
    if rows.shape == (6,):
        rows = rows[np.newaxis]
    if rows.ndim != 2 or rows.shape[1] != 6:
        raise InputError("configurations", expected, f"shape {rows.shape}")
    bad = np.flatnonzero(~np.all(np.isfinite(rows), axis=1))
    if bad.size:
        raise InputError(f"configurations[{bad[0]}]", expected, rows[bad[0]].tolist())
    return rows


def read_configurations(path: str | Path) -> Array:
    """Read configurations from a CSV file with the columns of :data:`VARIABLES`.

    Parameters
    ----------
    path : str or Path
        The columns may stand in any order; the angles are in degrees.

    Returns
    -------
    (n, 6) float
        In mm and rad.

    Raises
    ------
    InputError
        If the file is missing or empty, a column is missing or unknown, or a cell is not a
        finite number, with its line.
    """
    result = read_table(path, VARIABLES)
    result[:, 4:] = np.deg2rad(result[:, 4:])
    return result


class _Design(Parameters):
    camera_working_distance_mm: tuple[Measure, Measure]
    projector_working_distance_mm: tuple[Measure, Measure]
    z_ref_mm: Pair
    w_mm: Pair
    h_mm: Pair
    l_mm: Pair
    alpha_p_deg: Pair
    beta_p_deg: Pair
    coded_axes: CodedAxes | None = None
    circle_of_confusion_px: Measure = 1.0


class _Volume(Parameters):
    volume_mm: Size


class _HardwareFile(Parameters):
    camera: CameraOptics
    projector: ProjectorOptics
    rig: dict[str, Any]
    design: _Design
    detector: dict[str, Any] = Field(default_factory=dict)
    # What else a scene may hold: it is no concern of the design.
    name: Any = None
    description: Any = None
    modules: Any = None
    objects: Any = None
    materials: Any = None
    light: Any = None
    exposure: Any = None
    patterns: Any = None
    focus: Any = None
    calibration: Any = None
    render: Any = None
    preview: Any = None


def load_hardware(
    name_or_path: str | Path, *, allow_modules: bool = False, changes: Changes = ()
) -> Hardware:
    """Load hardware from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A file, or the name of a shipped one such as ``"hardware/macro-ch6"``.  A scene that
        extends hardware is hardware, too.
    allow_modules : bool
        Run the Python modules that the file names: code of its author.
    changes : sequence of str, or mapping
        Of the file's keys (:mod:`slbench.scene.changes`).

    Returns
    -------
    Hardware

    Raises
    ------
    InputError
        Naming the file and key of the first thing that cannot be used.

    Warns
    -----
    InputWarning
        If a lens is shifted so far that its axis leaves the panel.
    """
    path = resources.find("scenes", name_or_path)
    made = read_changes(changes)
    content = apply_changes(read_merged(path, allow_modules), made)
    if "design" not in content:
        raise InputError(f"{path.name}: design", "a table of working distances and ranges", "none")
    with naming_changes(path.name, made):
        hardware = _hardware(content, path)
    for name, device in (("camera", hardware.camera), ("projector", hardware.projector)):
        if not device.contains(device.centre):
            u, v = device.centre
            beside = f"({u:.4g}, {v:.4g}) is beside {device.width} x {device.height} px"
            why = "a design turns the optical axis to the volume, of which this panel sees a part"
            warn_user(f"{path.name}: {name}.principal_point_px", f"{beside}; {why} or nothing")
    return hardware


def _hardware(content: Mapping[str, Any], path: Path) -> Hardware:
    file = validated(_HardwareFile, content, path.name, separator=": ")
    region = {key: file.rig[key] for key in ("volume_mm",) if key in file.rig}
    volume = validated(_Volume, region, f"{path.name}: rig").volume_mm
    design = file.design
    ranges = np.array([getattr(design, name) for name in VARIABLES])
    ranges[4:] = np.deg2rad(ranges[4:])
    cameras, projectors = design.camera_working_distance_mm, design.projector_working_distance_mm
    with located(path.name):
        # A lens focused on the origin gets its true distance once it has a place.
        camera = Camera(**file.camera.arguments(max(cameras)))
        projector = Projector(**file.projector.arguments(max(projectors)))
        lower, upper = (tuple(float(x) for x in column) for column in ranges.T)
        return Hardware(
            camera,
            projector,
            cameras,
            projectors,
            lower,  # type: ignore[arg-type]
            upper,  # type: ignore[arg-type]
            volume,
            design.coded_axes or _coded_by(file.patterns),
            design.circle_of_confusion_px,
            (file.camera.focus_distance_mm is None, file.projector.focus_distance_mm is None),
            read_detector(file.detector, f"{path.name}: detector"),
        )


def _coded_by(patterns: Any) -> CodedAxes:
    """Return the axes that a file's ``[patterns]`` state; 1 where they state none."""
    stated = patterns.get("axes") if isinstance(patterns, Mapping) else None
    known: dict[Any, CodedAxes] = {"u": "u", "v": "v", "uv": "uv", "vu": "uv"}
    return known.get(stated, 1) if isinstance(stated, str) else 1


def thesis_configurations(hardware: Hardware) -> Array | None:
    """Return the 18 configurations of thesis table 4, where the hardware is the thesis's.

    Returns
    -------
    (18, 6) float or None
        None where optics, panels, bodies or measurement volume are others.
    """
    path = resources.find("scenes", "hardware/macro-ch6")
    theirs = load_hardware(path)
    same = hardware.volume_mm == theirs.volume_mm
    for name in ("camera", "projector"):
        ours, other = getattr(hardware, name), getattr(theirs, name)
        same &= replace(ours, pose=other.pose) == other
    return read_configurations(path.with_name("table4.csv")) if same else None


def own_configuration(content: dict[str, Any]) -> Array | None:
    """Return the rig that a hardware file has itself, which a search starts from in thought.

    Parameters
    ----------
    content : dict
        Of the file, what it extends merged in.

    Returns
    -------
    (1, 6) float or None
        In mm and rad; None where the file states poses, or no rig.
    """
    rig = content.get("rig", {})
    if not all(isinstance(rig.get(name), int | float) for name in VARIABLES):
        return None
    values = np.array([[float(rig[name]) for name in VARIABLES]])
    values[:, 4:] = np.deg2rad(values[:, 4:])
    return values
