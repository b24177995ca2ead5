"""Rigs as OpenCV YAML: ``cv2.FileStorage`` reads what we write, and the reverse.

Keys: ``K_camera``, ``dist_camera``, ``size_camera`` (width, height) and the same for the
projector; ``R``, ``T`` from camera to projector coordinates (the convention of
``cv2.stereoCalibrate`` with the camera first); ``R_world``, ``T_world`` from world to camera
coordinates (default: identity, the world is the camera's frame).  OpenCV has no word for
apertures, so these are keys of our own, all optional: ``pitch_um_*`` (2 numbers),
``aperture_radius_mm_*``, ``focus_distance_mm_*``, ``lens_*``, ``natural_vignetting_*``,
``wavelength_nm_*``, ``blur_px_*``, ``body_mm_*`` (3 numbers), ``barrel_mm_*`` (pairs), ``name_*``,
``fill_factor_camera``, ``shading_camera``, ``flux_w``,
``bit_depth_projector``, ``gamma_projector``, ``response_projector`` (rows of value and radiance, in
the place of gamma), ``volume_mm``.  Where the parameters' covariance is
known, ``covariance_names`` and ``covariance`` have it (:mod:`slbench.rig.parameters`).  Other
entries are left alone, unless they are almost one of these.  ``docs/reference/rig-files.md`` has
units and defaults.

Files of other programs come as the same entries (:mod:`slbench.rig.files`), so that one reader
checks and builds every rig.

A rig of several devices names them: ``cameras: "left right"``, ``projectors: "main"`` (none where
cameras measure without a calibrated projector).  Their names take the place of ``camera`` and
``projector`` in all entries, ``flux_w_main`` included, and each stands where ``R_left``,
``T_left`` say, from world to device coordinates (default for the first: the world is its frame).

A camera that was calibrated alone has a file with its own entries and ``device: camera``
(:func:`write_camera`), which is no rig.

A lens with an aperture and no focus distance is in focus where its axis comes closest to the
world's origin, as in a scene file; at infinity where the origin is not before both devices, which
it is not where the world is the camera's frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError, warn_user
from slbench.core.io import OtherEntry, write_opencv_yaml
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.device import Camera, Projector
from slbench.rig.doubts import principal_point_doubt, rig_doubts
from slbench.rig.files.entries import DEVICE, Entries, Stated, rig_entries
from slbench.rig.files.source import Source
from slbench.rig.optics.lens import Lens
from slbench.rig.optics.shading import COUNTS
from slbench.rig.parameters import ParameterCovariance
from slbench.rig.pose import Pose, checked_rotation
from slbench.rig.rig import ALONE, LEAST_DEPTH_MM, VOLUME_MM, Pair, Rig

#: Pitch taken for a calibration that states none.  Only irradiance and lengths on the panel
#: depend on it; rays do not.
_NOMINAL_PITCH_UM = 5.0

#: Entries that a file may have, without the name of a device; those of one device alone.
_OF_DEVICES = (
    *("K", "dist", "size", "pitch_um", "aperture_radius_mm", "focus_distance_mm", "lens"),
    *("natural_vignetting", "wavelength_nm", "blur_px", "body_mm", "barrel_mm", "name"),
)
_ENTRIES = (
    *(f"{stem}_{name}" for stem in _OF_DEVICES for name in ALONE),
    *("R", "T", "R_world", "T_world", "fill_factor_camera", "shading_camera"),
    *("flux_w", "bit_depth_projector"),
    *("gamma_projector", "response_projector", "volume_mm", "covariance_names", "covariance"),
)
#: Entries of the devices of a rig of several, without their names; and those of the rig.
_OF_SEVERAL = (*(stem for stem in _OF_DEVICES if stem != "name"), "R", "T")
_OF_ROLES = {
    "cameras": ("fill_factor", "shading"),
    "projectors": ("flux_w", "bit_depth", "gamma", "response"),
}
_RIG_OF_SEVERAL = ("cameras", "projectors", "volume_mm")
#: Letters of an entry, and its likeness to one of ours, from which it is a slip of it; and its
#: likeness where the device's name is misspelt.
_LEAST_LETTERS, _LIKE, _ALMOST = 4, 0.72, 0.93
#: The likeness of whole entries of a rig of several devices; and names that entries can have.
_LIKE_NAMED = 0.85
_NAME = re.compile(r"[A-Za-z0-9_-]+")

#: Keys by the last word of the place that an error of the rig's own classes names.
_KEYS = {
    "focal_length_mm": "pitch_um_{}",
    "pitch_mm": "pitch_um_{}",
    "aperture_radius_mm": "aperture_radius_mm_{}",
    "focus_distance_mm": "focus_distance_mm_{}",
    "kind": "lens_{}",
    "wavelength_nm": "wavelength_nm_{}",
    "blur_px": "blur_px_{}",
    "principal_point": "K_{}",
    "distortion": "dist_{}",
    "tilt_rad": "dist_{}",
    "width": "size_{}",
    "height": "size_{}",
    "fill_factor": "fill_factor_{}",
    "shading": "shading_{}",
    "flux_w": "flux_w",
    "bit_depth": "bit_depth_{}",
    "gamma": "gamma_{}",
    "value": "response_{}",
    "radiance": "response_{}",
    "volume": "volume_mm",
    "body_mm": "body_mm_{}",
    "barrel_mm": "barrel_mm_{}",
    "devices": "name_{}",
}


@contextmanager
def _blaming_the_file(values: _Values, name: str) -> Iterator[None]:
    """Turn errors of the rig's own classes into errors that name the file and the key."""
    try:
        yield
    except InputError as error:
        field = error.where.split()[-1].partition("[")[0]
        key = _KEYS.get(field, field).format(name)
        raise InputError(values.place(key), error.expected, error.got) from None


def write_rig(path: str | Path, rig: Rig, covariance: ParameterCovariance | None = None) -> None:
    """Write `rig` as OpenCV YAML.

    Parameters
    ----------
    path : path of the file to write (``.yaml`` or ``.yml``)
    rig : Rig
        Of several devices too, whose names become parts of entries.
    covariance : ParameterCovariance, optional
        Of its parameters; :func:`~slbench.rig.parameters.read_covariance` reads it back.

    Raises
    ------
    InputError
        For the covariance of a rig of several devices, which has no names yet, and for names that
        no entry can have.
    """
    if len(rig.pairs) != 1:
        if covariance is not None:
            got = f"{len(rig.devices)} devices"
            raise InputError("covariance", "one camera and one projector", got)
        write_opencv_yaml(path, _several_entries(rig))
        return
    camera, projector = rig.camera, rig.projector
    relative = projector.pose.rotation.T @ camera.pose.rotation
    offset = projector.pose.to_local(camera.pose.position)
    values: dict[str, Any] = {}
    for name, device in (("camera", camera), ("projector", projector)):
        values |= _device_entries(name, device)
    for role, own in rig.only._asdict().items():
        if own != role:
            values[f"name_{role}"] = own
    values |= {
        "R": relative,
        "T": offset,
        "R_world": camera.pose.rotation.T,
        "T_world": camera.pose.to_local(np.zeros(3)),
        "fill_factor_camera": float(camera.fill_factor),
        "flux_w": float(projector.flux_w),
        "bit_depth_projector": int(projector.bit_depth or 0),
        "gamma_projector": float(projector.gamma),
        "volume_mm": np.array(rig.volume_mm, dtype=np.float64),
    }
    if camera.shading:
        values["shading_camera"] = np.array(camera.shading)
    if projector.curve is not None:
        values["response_projector"] = np.array(projector.curve)
    if covariance is not None:
        values["covariance_names"] = " ".join(covariance.names)
        values["covariance"] = covariance.matrix
    write_opencv_yaml(path, values)


def _several_entries(rig: Rig) -> dict[str, Any]:
    """Return the entries of a rig of several devices."""
    for name in rig.devices:
        if not _NAME.fullmatch(name):
            raise InputError("rig devices", "names of letters, digits, _ and -", repr(name))
    values: dict[str, Any] = {"cameras": " ".join(rig.cameras)}
    if rig.projectors:
        values["projectors"] = " ".join(rig.projectors)
    for name, device in rig.devices.items():
        values |= _device_entries(name, device)
        values[f"R_{name}"] = device.pose.rotation.T
        values[f"T_{name}"] = device.pose.to_local(np.zeros(3))
    for name, camera in rig.cameras.items():
        values[f"fill_factor_{name}"] = float(camera.fill_factor)
        if camera.shading:
            values[f"shading_{name}"] = np.array(camera.shading)
    for name, projector in rig.projectors.items():
        values[f"flux_w_{name}"] = float(projector.flux_w)
        values[f"bit_depth_{name}"] = int(projector.bit_depth or 0)
        values[f"gamma_{name}"] = float(projector.gamma)
        if projector.curve is not None:
            values[f"response_{name}"] = np.array(projector.curve)
    values["volume_mm"] = np.array(rig.volume_mm, dtype=np.float64)
    return values


def _device_entries(name: str, device: Camera | Projector) -> dict[str, Any]:
    """Return the entries of a device's lens and panel."""
    values: dict[str, Any] = {
        f"K_{name}": device.matrix,
        f"dist_{name}": device.opencv_distortion,
        f"size_{name}": np.array([device.width, device.height], dtype=np.float64),
        f"pitch_um_{name}": np.array(device.pitch_mm) * 1e3,
        f"aperture_radius_mm_{name}": float(device.lens.aperture_radius_mm),
    }
    if np.isfinite(device.lens.focus_distance_mm) or device.lens.aperture_radius_mm:
        values[f"focus_distance_mm_{name}"] = float(device.lens.focus_distance_mm)
    values[f"lens_{name}"] = device.lens.kind
    values[f"wavelength_nm_{name}"] = float(device.lens.wavelength_nm)
    values[f"blur_px_{name}"] = float(device.blur_px)
    if device.body_mm is not None:
        values[f"body_mm_{name}"] = np.array(device.body_mm, dtype=np.float64)
    if device.barrel_mm is not None:
        values[f"barrel_mm_{name}"] = np.array(device.barrel_mm, dtype=np.float64)
    values[f"natural_vignetting_{name}"] = int(device.lens.natural_vignetting)
    return values


def write_camera(path: str | Path, camera: Camera, covariance: ParameterCovariance) -> None:
    """Write a camera alone, wherever it stands, as OpenCV YAML.

    Parameters
    ----------
    path : path of the file to write (``.yaml`` or ``.yml``)
    camera : Camera
    covariance : ParameterCovariance
        Of its parameters; :func:`~slbench.rig.parameters.read_covariance` reads it back.
    """
    entries = {DEVICE: "camera"} | _device_entries("camera", camera)
    entries["covariance_names"] = " ".join(covariance.names)
    entries["covariance"] = covariance.matrix
    write_opencv_yaml(path, entries)


def read_camera(path: str | Path) -> Camera:
    """Read the camera of a file: of a camera alone, or of a rig.

    Raises
    ------
    InputError
        As :func:`read_rig`.
    """
    storage = Source(path).storage
    if DEVICE not in storage:
        return read_rig(path).camera
    values = _Values(Entries(path=Path(path), values=storage))
    if values.text(DEVICE, "") != "camera":
        raise InputError(values.place(DEVICE), "'camera'", repr(storage[DEVICE]))
    arguments = _device_arguments(values, "camera", None)
    with _blaming_the_file(values, "camera"):
        camera = Camera(**arguments)
    if doubt := principal_point_doubt(camera):
        warn_user(f"{values.path}: principal point of the camera", doubt)
    return camera


class _Values:
    """Checked access to a file's entries; every failure names the file and the key."""

    def __init__(self, entries: Entries) -> None:
        self.path = entries.path
        self.values = entries.values
        self.place = entries.place

    def array(self, key: str, shapes: tuple[int, ...], default: Any = None) -> np.ndarray:
        """Return a finite float vector whose length is one of `shapes`."""
        value = self.values.get(key, default)
        if value is None:
            raise InputError(self.place(key), "this key to be present", "nothing")
        try:
            flat = np.asarray(value, dtype=np.float64).ravel()
        except (TypeError, ValueError):
            raise InputError(self.place(key), "numbers", repr(value)) from None
        if flat.size not in shapes or not np.all(np.isfinite(flat)):
            sizes = " or ".join(map(str, shapes))
            raise InputError(self.place(key), f"{sizes} finite numbers", f"{flat.tolist()}")
        return flat

    def text(self, key: str, default: str) -> str:
        value = self.values.get(key, default)
        if isinstance(value, OtherEntry):
            raise InputError(self.place(key), "a text", repr(value))
        return str(value)

    def number(self, key: str, default: float) -> float:
        return float(self.array(key, (1,), default)[0])

    def pairs(self, key: str) -> tuple[tuple[float, float], ...] | None:
        if self.values.get(key) is None:
            return None
        count = np.size(self.values[key])
        rows = self.array(key, (max(count + count % 2, 4),)).reshape(-1, 2)
        return tuple((float(a), float(b)) for a, b in rows)

    def whole(self, key: str, default: int) -> int:
        value = self.number(key, default)
        if not value.is_integer():
            raise InputError(self.place(key), "a whole number", value)
        return int(value)

    def pose(self, rotation: str, translation: str, default: Pose | None = None) -> Pose:
        """Return the pose of the frame that ``X' = R X + T`` maps *from* the parent."""
        if default is not None and not {rotation, translation} & self.values.keys():
            return default
        matrix = self.array(rotation, (9,)).reshape(3, 3)
        offset = self.array(translation, (3,))
        matrix = checked_rotation(matrix, self.place(rotation))
        return Pose(matrix.T, -matrix.T @ offset)


def _question_entries(values: _Values) -> None:
    """Question entries that are almost one of ours; what else a program writes is its own."""
    missing = [entry for entry in _ENTRIES if entry not in values.values]
    for key in sorted(values.values.keys() - set(_ENTRIES)):
        if missing and len(_parts(key)[0]) >= _LEAST_LETTERS:
            entry = max(missing, key=lambda one: _likeness(key, one))
            if _likeness(key, entry) >= _LIKE:
                doubt = f"not an entry of a rig; did you mean {entry!r}?"
                warn_user(f"{values.path}: {key}", doubt)


def _likeness(key: str, entry: str) -> float:
    """Return how much a key looks like an entry of ours, 0 to 1."""
    (stem, device), (own, of) = _parts(key), _parts(entry)
    if device == of:
        return SequenceMatcher(None, stem, own).ratio()
    if stem == own and "_" in stem:  # of the wrong device, or of none
        return 1.0
    whole = SequenceMatcher(None, key.lower(), entry).ratio()
    return whole if whole >= _ALMOST else 0.0


def _parts(key: str) -> tuple[str, str]:
    """Return an entry's name without that of its device, and the device's ("" if none)."""
    stem, _, device = key.lower().rpartition("_")
    return (stem, device) if device in ALONE else (key.lower(), "")


def _focus(values: _Values, name: str, aperture_mm: float, depth_mm: float | None) -> float:
    """Return a focus distance as stated, or the depth of the world's origin, None if not before."""
    key = f"focus_distance_mm_{name}"
    stated = values.values.get(key)
    if isinstance(stated, float) and stated == np.inf:
        return np.inf
    if stated is not None:
        return values.number(key, 0.0)
    # The rays of a telecentric lens depend on it, and a pinhole has none.
    if aperture_mm <= 0.0 or values.text(f"lens_{name}", "perspective") == "telecentric":
        return np.inf
    if depth_mm is None:
        why = "none is stated and the world's origin is not before both devices"
        warn_user(values.place(key), f"{why}: the {name} is in focus at infinity")
        return np.inf
    return depth_mm


def _device_arguments(values: _Values, name: str, depth_mm: float | None) -> dict[str, Any]:
    matrix = values.array(f"K_{name}", (9,)).reshape(3, 3)
    fixed = matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]
    if np.any(fixed != [0.0, 0.0, 0.0, 0.0, 1.0]) or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise InputError(
            values.place(f"K_{name}"),
            "fx 0 cx, 0 fy cy, 0 0 1 with positive focal lengths and no skew",
            matrix.tolist(),
        )
    pitch = values.array(f"pitch_um_{name}", (2,), [_NOMINAL_PITCH_UM] * 2) * 1e-3
    focal = matrix[0, 0] * pitch[0]
    # OpenCV's fx and fy may differ; the pixel's height takes up the difference.
    pitch[1] = focal / matrix[1, 1]
    distortion = values.array(f"dist_{name}", (4, 5, 8, 12, 14), np.zeros(5))
    width, height = values.array(f"size_{name}", (2,))
    if not (width.is_integer() and height.is_integer()):
        raise InputError(values.place(f"size_{name}"), "whole numbers", f"{width} x {height}")
    kind = values.text(f"lens_{name}", "perspective")
    aperture = values.number(f"aperture_radius_mm_{name}", 0.0)
    focus = _focus(values, name, aperture, depth_mm)
    vignetting = values.number(f"natural_vignetting_{name}", 1)
    if vignetting not in (0, 1):
        raise InputError(values.place(f"natural_vignetting_{name}"), "0 or 1", vignetting)
    with _blaming_the_file(values, name):
        lens = Lens(
            float(focal),
            aperture,
            focus,
            kind,  # type: ignore[arg-type]
            bool(vignetting),
            values.number(f"wavelength_nm_{name}", 0.0),
        )
    body = None
    if f"body_mm_{name}" in values.values:
        body = tuple(float(size) for size in values.array(f"body_mm_{name}", (3,)))
    return {
        "body_mm": body,
        "barrel_mm": values.pairs(f"barrel_mm_{name}"),
        "width": int(width),
        "height": int(height),
        "pitch_mm": (float(pitch[0]), float(pitch[1])),
        "lens": lens,
        "principal_point": (float(matrix[0, 2]), float(matrix[1, 2])),
        "distortion": tuple(float(x) for x in distortion[: len(COEFFICIENTS)]),
        "tilt_rad": tuple(float(x) for x in distortion[len(COEFFICIENTS) :]) or (0.0, 0.0),
        "blur_px": values.number(f"blur_px_{name}", 0.0),
    }


def read_rig(
    paths: str | Path | Sequence[str | Path], names: Pair = ALONE, stated: Stated | None = None
) -> Rig:
    """Read a rig: ours, with the entries above, or a calibration that another program wrote.

    Parameters
    ----------
    paths : path, or sequence of paths
        More than one where a program writes several (:mod:`slbench.rig.files`).
    names : Pair
        Of devices that the file does not name.
    stated : Stated, optional
        What another program's file does not say: a unit, sizes, which device is which.

    Raises
    ------
    InputError
        Naming the file and key that is missing or unusable.

    Warns
    -----
    InputWarning
        If lengths are a thousand times off, the principal point is that of other frames, or an
        aperture has no focus distance and nothing to be focused on.
    """
    return rig_of(rig_entries(paths, stated), names)


def rig_of(
    entries: Entries, names: Pair = ALONE, looked_at: NDArray[np.float64] | None = None
) -> Rig:
    """Return the rig of a file's entries; see :func:`read_rig`.

    Parameters
    ----------
    entries : Entries
    names : Pair
    looked_at : (3,) float, optional
        What lenses that state no focus are in focus at where the world's origin is not before
        both devices, mm in the world.
    """
    values = _Values(entries)
    if isinstance(entries.values.get("cameras"), str):
        return _rig_of_several(values, looked_at)
    if entries.format == "slbench":
        _question_entries(values)
    camera_pose = values.pose("R_world", "T_world", Pose())
    relative = values.pose("R", "T")  # projector in the camera's frame
    projector_pose = Pose(
        camera_pose.rotation @ relative.rotation, camera_pose.to_world(relative.position)
    )
    volume = values.array("volume_mm", (3,), VOLUME_MM)
    depths = (camera_pose.origin_depth, projector_pose.origin_depth)
    if min(depths) <= LEAST_DEPTH_MM and looked_at is not None:
        camera_depth, projector_depth = (
            float(pose.to_local(looked_at)[2]) for pose in (camera_pose, projector_pose)
        )
        depths = (camera_depth, projector_depth)
    before = depths if min(depths) > LEAST_DEPTH_MM else (None, None)
    camera_arguments = _camera_arguments(values, "camera", before[0])
    projector_arguments = _projector_arguments(values, "projector", before[1], "flux_w")
    with _blaming_the_file(values, "camera"):
        camera = Camera(**camera_arguments, pose=camera_pose)
    with _blaming_the_file(values, "projector"):
        projector = Projector(**projector_arguments, pose=projector_pose)
        own = Pair(*(values.text(f"name_{role}", name) for role, name in names._asdict().items()))
        size = (float(volume[0]), float(volume[1]), float(volume[2]))
        rig = Rig({own.camera: camera}, {own.projector: projector}, size)
    for what, doubt in rig_doubts(rig):
        warn_user(f"{values.path}: {what}", doubt)
    return rig


def _camera_arguments(values: _Values, name: str, depth_mm: float | None) -> dict[str, Any]:
    return _device_arguments(values, name, depth_mm) | {
        "fill_factor": values.number(f"fill_factor_{name}", 1.0),
        "shading": tuple(values.array(f"shading_{name}", COUNTS, ()).tolist()),
    }


def _projector_arguments(
    values: _Values, name: str, depth_mm: float | None, flux: str
) -> dict[str, Any]:
    return _device_arguments(values, name, depth_mm) | {
        "flux_w": values.number(flux, 1.0),
        "bit_depth": values.whole(f"bit_depth_{name}", 8) or None,
        "gamma": values.number(f"gamma_{name}", 1.0),
        "curve": values.pairs(f"response_{name}"),
    }


def _rig_of_several(values: _Values, looked_at: NDArray[np.float64] | None) -> Rig:
    """Return the rig of a file that names its devices."""
    names = {role: values.text(role, "").split() for role in _OF_ROLES}
    _question_entries_of_several(values, names)
    devices: dict[str, dict[str, Any]] = {}
    first = True
    for role, own in names.items():
        devices[role] = {}
        if len(set(own)) != len(own):
            raise InputError(values.place(role), "each name once", " ".join(own))
        for name in own:
            pose = values.pose(f"R_{name}", f"T_{name}", Pose() if first else None)
            first = False
            depth = pose.origin_depth
            if depth <= LEAST_DEPTH_MM and looked_at is not None:
                depth = float(pose.to_local(looked_at)[2])
            before = depth if depth > LEAST_DEPTH_MM else None
            with _blaming_the_file(values, name):
                if role == "cameras":
                    arguments = _camera_arguments(values, name, before)
                    devices[role][name] = Camera(**arguments, pose=pose)
                else:
                    arguments = _projector_arguments(values, name, before, f"flux_w_{name}")
                    devices[role][name] = Projector(**arguments, pose=pose)
    volume = values.array("volume_mm", (3,), VOLUME_MM)
    size = (float(volume[0]), float(volume[1]), float(volume[2]))
    try:
        rig = Rig(devices["cameras"], devices["projectors"], size)
    except InputError as error:
        key = "volume_mm" if "volume" in error.where else "cameras"
        raise InputError(values.place(key), error.expected, error.got) from None
    for what, doubt in rig_doubts(rig):
        warn_user(f"{values.path}: {what}", doubt)
    return rig


def _question_entries_of_several(values: _Values, names: Mapping[str, Sequence[str]]) -> None:
    """Question entries that are almost one of a rig of several devices."""
    known = list(_RIG_OF_SEVERAL)
    for role, own in names.items():
        known += [f"{stem}_{name}" for name in own for stem in (*_OF_SEVERAL, *_OF_ROLES[role])]
    missing = [entry for entry in known if entry not in values.values]
    for key in sorted(values.values.keys() - set(known)):
        entry = max(missing, key=lambda one: SequenceMatcher(None, key, one).ratio(), default="")
        if len(key) >= _LEAST_LETTERS and SequenceMatcher(None, key, entry).ratio() >= _LIKE_NAMED:
            doubt = f"not an entry of a rig; did you mean {entry!r}?"
            warn_user(f"{values.path}: {key}", doubt)
