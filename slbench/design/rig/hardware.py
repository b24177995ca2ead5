"""What a rig is designed from: optics, bodies, working distances, ranges of the variables.

A :class:`Hardware` is thesis tables 2 and 3 in one value: camera and projector without a
place, the measurement volume, the working distances of the lenses and the ranges of the six
design variables.  :meth:`Hardware.place` puts both devices where many configurations say, all
at once (thesis 3.1.2); constraints and evaluator start from there.

For a microscope (thesis 5.2) there may be a :class:`Sweep` of focus settings, and more variables:
aperture, focus and tilt of the sensor of either device (:data:`OPTICS`).

Files: the ``[camera]``, ``[projector]`` and ``[rig]`` tables of a scene, ``[focus]`` and
``[design]``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slbench.capture.focus import MAX_SETTINGS, Focus
from slbench.core import resources
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import read_table
from slbench.core.show.display import brief
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Coordinate, MaxLen, Measure, MinLen, Pair, Size
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
from slbench.scene.tables import FocusTable

Array = NDArray[np.float64]
#: Panel axes that are coded: named, or how many.
CodedAxes = Literal[1, 2, "u", "v", "uv"]
AnyDevice = TypeVar("AnyDevice", bound=Device)

#: Names of the six design variables, as in files.
VARIABLES = ("z_ref_mm", "w_mm", "h_mm", "l_mm", "alpha_p_deg", "beta_p_deg")
#: Names of the optional variables of the lenses: radius of the aperture; how far beyond the
#: reference point the lens is focused; tilt of the sensor about its two axes.
OPTICS = tuple(
    f"{device}_{name}"
    for device in ("camera", "projector")
    for name in ("aperture_radius_mm", "focus_mm", "tilt_x_deg", "tilt_y_deg")
)
#: Steps of an aperture's range that are told apart: what diffraction makes of each is computed.
_STOPS = 24

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
    optics : (n, m) float
        Variables of the lenses, mm and rad, in the hardware's order; (1, 0) are none, so that a
        lens is as the hardware has it.
    """

    camera_rotation: Array
    camera_position: Array
    projector_rotation: Array
    projector_position: Array
    camera_distance: Array
    projector_distance: Array
    angle: Array
    valid: NDArray[np.bool_]
    optics: Array = field(default_factory=lambda: np.empty((1, 0)))

    __repr__ = brief

    def of(self, rows: Sequence[int]) -> Placement:
        """Return the placement of some of the configurations."""
        return Placement(*(getattr(self, each.name)[rows] for each in fields(self)))


@dataclass(frozen=True)
class Sweep(Value):
    """Focus settings that are taken one after the other (thesis 5.2).

    Parameters
    ----------
    heights_mm : sequence of float
        Heights of the points on the world's z axis that the settings focus on.
    move : {"both", "camera", "projector"}
        What is refocused.
    apart : bool
        Each setting of the camera with each of the projector; together otherwise.
    """

    heights_mm: Annotated[tuple[Coordinate, ...], MinLen(1), MaxLen(MAX_SETTINGS)]
    move: Literal["both", "camera", "projector"] = "both"
    apart: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        # From the nearest to the furthest setting of devices that look down.
        object.__setattr__(self, "heights_mm", tuple(sorted(self.heights_mm, reverse=True)))
        if self.apart and self.move != "both":
            raise InputError("sweep: apart", "only where both devices move", self.move)


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
    sweep : Sweep or None
        Focus settings of a microscope; None is one, the lenses' own.
    optics : mapping of str to (float, float)
        Ranges of optional variables (:data:`OPTICS`), mm and rad, which follow the six.
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
    sweep: Sweep | None = None
    optics: dict[str, Pair] = field(default_factory=dict)

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
        for name, (low, high) in self.optics.items():
            self._check_optics(name, low, high)

    def _check_optics(self, name: str, low: float, high: float) -> None:
        where = f"range of {name}"
        if name not in OPTICS:
            raise InputError("optics", f"names among {', '.join(OPTICS)}", name)
        if not low <= high:
            raise InputError(where, "lowest <= highest", f"{low}, {high}")
        role, _, quantity = name.partition("_")
        device: Device = getattr(self, role)
        if quantity.endswith("deg") and max(abs(low), abs(high)) >= np.pi / 3:
            raise InputError(where, "angles within 60 deg", f"{low}, {high} rad")
        if quantity.startswith("aperture"):
            if device.lens.kind == "telecentric":
                raise InputError(where, "a perspective lens", device.lens.kind)
            if low <= 0:
                raise InputError(where, "positive radii (mm)", low)
        if quantity.startswith("focus") and not self.refocused[role == "projector"]:
            expected = f"a {role} without focus_distance_mm, which fixes its focus"
            raise InputError(where, expected, device.lens.focus_distance_mm)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables of a configuration: the six, and those of the lenses."""
        return (*VARIABLES, *self.optics)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest values of the variables, mm and rad."""
        low, high = (np.array([pair[end] for pair in self.optics.values()]) for end in (0, 1))
        return np.append(np.array(self.lower), low), np.append(np.array(self.upper), high)

    def device_optics(self, role: str, optics: Array) -> tuple[Array, Array, Array]:
        """Return what variables of the lenses make of a device.

        Parameters
        ----------
        role : {"camera", "projector"}
        optics : (n, m) float
            As in :class:`Placement`.

        Returns
        -------
        aperture : (n,) float
            Radius, mm, in steps of 1/24 of its range.
        focus : (n,) float
            What is added to the distances in focus, mm.
        tilt : (n, 2) float
            rad.
        """
        device: Device = getattr(self, role)
        names, count = list(self.optics)[: optics.shape[1]], len(optics)

        def of(name: str, own: float) -> Array:
            key = f"{role}_{name}"
            return optics[:, names.index(key)] if key in names else np.full(count, own)

        aperture = of("aperture_radius_mm", device.lens.aperture_radius_mm)
        low, high = self.optics.get(f"{role}_aperture_radius_mm", (0.0, 0.0))
        if high > low:
            aperture = (
                low + (high - low) * np.round((aperture - low) / (high - low) * _STOPS) / _STOPS
            )
        tilts = of("tilt_x_deg", device.tilt_rad[0]), of("tilt_y_deg", device.tilt_rad[1])
        return aperture, of("focus_mm", 0.0), np.stack(tilts, axis=1)

    def devices(self, role: str, optics: Array) -> list[Device]:
        """Return the camera or the projector with n lenses as variables (n, m) say."""
        apertures, _, tilts = self.device_optics(role, optics)
        own: Device = getattr(self, role)
        found = []
        for aperture, (tilt_x, tilt_y) in zip(apertures, tilts, strict=True):
            lens = own.lens
            if aperture != lens.aperture_radius_mm:
                lens = replace(lens, aperture_radius_mm=float(aperture))
            found.append(replace(own, lens=lens, tilt_rad=(float(tilt_x), float(tilt_y))))
        return found

    def variant(self, optics: Array) -> Hardware:
        """Return the hardware whose lenses are as variables (m,) say, and no longer vary.

        A shift of the focus is not part of it: it belongs to a rig.
        """
        (camera,), (projector,) = (
            self.devices(role, optics[np.newaxis]) for role in ("camera", "projector")
        )
        assert isinstance(camera, Camera)  # by their roles
        assert isinstance(projector, Projector)
        return replace(self, camera=camera, projector=projector, optics={})

    def focuses(self, placement: Placement, *, swept: bool = True) -> Array:
        """Return where both devices are focused at the settings of the sweep, (2, n, s), mm.

        From the nearest to the furthest; the camera's first.  Unless `swept`, at the one setting
        of a picture without a sweep.
        """
        sweep = self.sweep if swept else None
        heights = np.array((0.0,) if sweep is None else sweep.heights_mm)
        found = []
        for k, (role, rotation, distance) in enumerate(
            (
                ("camera", placement.camera_rotation, placement.camera_distance),
                ("projector", placement.projector_rotation, placement.projector_distance),
            )
        ):
            device: Device = getattr(self, role)
            moves = sweep is not None and sweep.move in ("both", role)
            fixed = not (self.refocused[k] or moves)
            focus = np.full(len(distance), device.lens.focus_distance_mm) if fixed else distance
            offset = self.device_optics(role, placement.optics)[1]
            depth = rotation[:, 2, 2, None] * heights if moves else np.zeros_like(heights)
            found.append((focus + offset)[:, None] + depth)
        return np.stack(found)

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
        optics = np.empty((1, 0))
        if not isinstance(variables, DesignVariables):
            row = as_configurations(variables, len(self.variables))[0]
            variables, optics = DesignVariables(*(float(x) for x in row[:6])), row[np.newaxis, 6:]
        own = self.variant(optics[0]) if self.optics else self
        rig = Rig.from_design(variables, own.camera, own.projector, self.volume_mm)
        further = [
            float(self.device_optics(role, optics)[1][0]) for role in ("camera", "projector")
        ]
        return rig.having(
            camera=self.focused(rig.camera, rig.camera_distance + further[0]),
            projector=self.focused(rig.projector, rig.projector_distance + further[1]),
        )

    def settings(self, configuration: ArrayLike) -> Focus:
        """Return the settings of the sweep for one configuration, as distances in focus."""
        focuses = self.focuses(self.place(configuration))[:, 0]
        if self.sweep is not None and self.sweep.apart:
            pairs = itertools.product(*focuses.tolist())
            focuses = np.array(list(pairs)).T
        names = ("camera", "projector")
        return Focus(dict(zip(names, (tuple(each) for each in focuses.tolist()), strict=True)))

    def place(self, configurations: ArrayLike | Sequence[DesignVariables]) -> Placement:
        """Place both devices by many configurations (thesis eq. 3 and section 3.1.2).

        Parameters
        ----------
        configurations : (n, 6 + m) float or list of DesignVariables
            In mm and rad; with the m optional variables of the hardware.

        Raises
        ------
        InputError
            If they are not numbers, one a variable.
        """
        rows = as_configurations(configurations, len(self.variables))
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
            rows[:, 6:],
        )


def as_configurations(values: ArrayLike | Sequence[DesignVariables], count: int = 6) -> Array:
    """Return configurations as (n, count) float, mm and rad; one row may stand alone.

    Raises
    ------
    InputError
        If they are not finite numbers, `count` each.
    """
    if isinstance(values, DesignVariables):
        values = [values]
    if isinstance(values, Sequence) and values and isinstance(values[0], DesignVariables):
        values = [(v.z_ref, v.w, v.h, v.l, v.alpha_p, v.beta_p) for v in values]  # type: ignore[union-attr]
    expected = "(n, 6) finite numbers: z_ref w h l (mm), alpha_P beta_P (rad)"
    if count > 6:
        expected = f"(n, {count}) finite numbers: the six, and those of the lenses (mm, rad)"
    try:
        rows = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("configurations", expected, error) from None
    if rows.shape == (count,):
        rows = rows[np.newaxis]
    if rows.ndim != 2 or rows.shape[1] != count:
        raise InputError("configurations", expected, f"shape {rows.shape}")
    bad = np.flatnonzero(~np.all(np.isfinite(rows), axis=1))
    if bad.size:
        raise InputError(f"configurations[{bad[0]}]", expected, rows[bad[0]].tolist())
    return rows


def read_configurations(path: str | Path, variables: Sequence[str] = VARIABLES) -> Array:
    """Read configurations from a CSV file with a column a variable.

    Parameters
    ----------
    path : str or Path
        The columns may stand in any order; the angles are in degrees.
    variables : sequence of str
        Their names, those of :attr:`Hardware.variables`.

    Returns
    -------
    (n, 6 + m) float
        In mm and rad.

    Raises
    ------
    InputError
        If the file is missing or empty, a column is missing or unknown, or a cell is not a
        finite number, with its line.
    """
    result = read_table(path, variables)
    angles = are_angles(variables)
    result[:, angles] = np.deg2rad(result[:, angles])
    return result


def are_angles(variables: Sequence[str]) -> NDArray[np.bool_]:
    """Return a mask of variables that files have in degrees."""
    return np.array([name.endswith("_deg") for name in variables])


class _Design(Parameters):
    camera_working_distance_mm: tuple[Measure, Measure]
    projector_working_distance_mm: tuple[Measure, Measure]
    z_ref_mm: Pair
    w_mm: Pair
    h_mm: Pair
    l_mm: Pair
    alpha_p_deg: Pair
    beta_p_deg: Pair
    camera_aperture_radius_mm: Pair | None = None
    camera_focus_mm: Pair | None = None
    camera_tilt_x_deg: Pair | None = None
    camera_tilt_y_deg: Pair | None = None
    projector_aperture_radius_mm: Pair | None = None
    projector_focus_mm: Pair | None = None
    projector_tilt_x_deg: Pair | None = None
    projector_tilt_y_deg: Pair | None = None
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
    focus: FocusTable | None = None
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
    if content.get("focus") and hardware.sweep is None:
        got = "distances, which belong to one rig: one setting is taken"
        warn_user(f"{path.name}: focus", f"a design sweeps by heights_mm or settings; {got}")
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
            _sweep(file.focus, volume[2]),
            {name: _range_of(design, name) for name in OPTICS if getattr(design, name) is not None},
        )


def _range_of(design: _Design, name: str) -> tuple[float, float]:
    low, high = getattr(design, name)
    turn = np.pi / 180.0 if name.endswith("_deg") else 1.0
    return turn * low, turn * high


def _sweep(focus: FocusTable | None, depth_mm: float) -> Sweep | None:
    """Return a file's sweep; distances in focus, which belong to one rig, are none."""
    heights = None if focus is None else focus.heights(depth_mm)
    return None if focus is None or heights is None else Sweep(heights, focus.move, focus.apart)


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


def stated_optics(hardware: Hardware, configuration: Array) -> dict[str, dict[str, Any]]:
    """Return the keys of a scene's devices that a configuration's variables of the lenses set.

    Parameters
    ----------
    hardware : Hardware
    configuration : (6 + m,) float

    Returns
    -------
    dict of str to dict
        Of ``camera`` and ``projector``; None is a key that makes way for another one.
    """
    found: dict[str, dict[str, Any]] = {"camera": {}, "projector": {}}
    optics = configuration[np.newaxis, 6:]
    rig = hardware.rig(configuration)
    for role, keys in found.items():
        aperture, _, tilt = hardware.device_optics(role, optics)
        if f"{role}_aperture_radius_mm" in hardware.optics:
            keys |= {"f_number": None, "lens_f_number": None}
            keys["aperture_radius_mm"] = float(aperture[0])
        if any(f"{role}_tilt_{axis}_deg" in hardware.optics for axis in "xy"):
            keys["tilt_deg"] = [float(angle) for angle in np.rad2deg(tilt[0])]
        if f"{role}_focus_mm" in hardware.optics:
            keys["focus_distance_mm"] = float(rig.devices[role].lens.focus_distance_mm)
    return found


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
