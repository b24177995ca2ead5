r"""The parameters of a rig by name, their covariance, and rigs that are off by an error.

A parameter is named by its device and what it is: ``camera.fx_px``, ``projector.rx_rad``.

- ``fx_px``, ``fy_px``, ``cx_px``, ``cy_px``: OpenCV's matrix K;
- ``k1``, ``k2``, ``p1``, ``p2``, ``k3`` and, of a rational lens or one with a thin prism, ``k4``,
  ``k5``, ``k6``, ``s1``, ``s2``, ``s3``, ``s4``: OpenCV's distortion;
- ``rx_rad``, ``ry_rad``, ``rz_rad``: a turn about the device's own axes through its lens, as a
  rotation vector r: ``R' = R exp([r]_x)`` with ``X_world = R X_device + p``;
- ``tx_mm``, ``ty_mm``, ``tz_mm``: a shift along the device's own axes: ``p' = p + R t``;
- ``tau_x_rad``, ``tau_y_rad``: OpenCV's tilt of the sensor.

All of them are additive and zero for the rig as it is.  A calibration with the camera as the
world's frame has no pose of the camera among its parameters.  What a set of parameters does to
points, :func:`moved` tells: their covariance C becomes ``J C J^T`` by the derivatives J of points
by parameters.

Files: JSON with ``kind``, ``names`` and ``covariance``; or the entries ``covariance_names`` (one
text) and ``covariance`` beside a rig in OpenCV's YAML (:mod:`slbench.rig.opencv`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.io import read_json, write_json
from slbench.core.random import generator
from slbench.core.registry import quoted
from slbench.core.show.display import brief
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.device import Camera, Device, Projector
from slbench.rig.files.source import Source
from slbench.rig.pose import Pose
from slbench.rig.rig import Rig

Array = NDArray[np.float64]

ROLES = ("camera", "projector")
LENS = ("fx_px", "fy_px", "cx_px", "cy_px")
TILT = ("tau_x_rad", "tau_y_rad")
TURN = ("rx_rad", "ry_rad", "rz_rad")
SHIFT = ("tx_mm", "ty_mm", "tz_mm")
#: Parameters of a device's lens and panel, of its pose, and all of them.
OPTICS = (*LENS, *COEFFICIENTS, *TILT)
POSE = (*TURN, *SHIFT)
DEVICE_PARAMETERS = (*OPTICS, *POSE)
#: Parameters of a rig of one camera and one projector.
RIG_PARAMETERS = tuple(f"{role}.{name}" for role in ROLES for name in DEVICE_PARAMETERS)

_KIND = "slbench covariance"
_BESIDE = "covariance_names (a text) and covariance (a matrix) beside the rig"
#: Negative eigenvalues and differences across the diagonal that rounding leaves, as shares of the
#: largest variance after each parameter is scaled with its own deviation.
_ROUNDING = 1e-8


@dataclass(frozen=True, eq=False)
class ParameterCovariance:
    """What is known of parameters, by name.

    Parameters
    ----------
    names : tuple of str
        Each once.
    matrix : (k, k) float
        Covariance, in the parameters' units.
    """

    names: tuple[str, ...]
    matrix: Array

    __repr__ = brief

    def __post_init__(self) -> None:
        where = "covariance"
        matrix = np.asarray(self.matrix, dtype=np.float64)
        k = len(self.names)
        if len(set(self.names)) < k or not k:
            raise InputError(f"{where} names", "each parameter once", ", ".join(self.names)[:80])
        if matrix.shape != (k, k):
            raise InputError(where, f"{k} x {k} finite numbers", f"shape {matrix.shape}")
        if not np.isfinite(matrix).all():
            row, column = np.argwhere(~np.isfinite(matrix))[0]
            got = f"{matrix[row, column]} of {self.names[row]} and {self.names[column]}"
            raise InputError(where, f"{k} x {k} finite numbers", got)
        scale = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
        scaled = matrix / np.outer(*[np.where(scale > 0.0, scale, 1.0)] * 2)
        lowest = float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])
        if np.abs(scaled - scaled.T).max() > _ROUNDING or lowest < -_ROUNDING * k:
            expected = "a symmetric matrix without negative eigenvalues"
            raise InputError(where, expected, "another")
        object.__setattr__(self, "matrix", 0.5 * (matrix + matrix.T))

    @classmethod
    def of(cls, deviations: Mapping[str, float]) -> ParameterCovariance:
        """Return that of independent parameters with standard deviations."""
        return cls(tuple(deviations), np.diag(np.square(list(deviations.values()))))

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.matrix)).tolist(), strict=True))

    def part(self, names: Sequence[str]) -> Array:
        """Return the covariance of some parameters, (k, k); zero of those that are not in it."""
        which = [self.names.index(name) if name in self.names else -1 for name in names]
        known = np.array(which) >= 0
        return np.where(np.outer(known, known), self.matrix[np.ix_(which, which)], 0.0)

    def draw(self, seed: int) -> dict[str, float]:
        """Return an error drawn from a normal distribution, by name."""
        values, vectors = np.linalg.eigh(self.matrix)
        normal = generator(seed).standard_normal(len(self.names))
        error = vectors @ (np.sqrt(np.clip(values, 0.0, None)) * normal)
        return dict(zip(self.names, error.tolist(), strict=True))

    def save(self, path: str | Path) -> None:
        """Write names and matrix as JSON."""
        write_json(path, {"kind": _KIND, "names": self.names, "covariance": self.matrix})


def read_covariance(path: str | Path) -> ParameterCovariance:
    """Read a covariance of a rig's parameters: JSON, or what stands beside a rig in YAML.

    Raises
    ------
    InputError
        Naming the file and what is missing, not known or no covariance.
    """
    if Path(path).suffix.lower() in (".yaml", ".yml"):
        beside = covariance_beside(path)
        if beside is None:
            raise InputError(path, _BESIDE, "none")
        return beside
    values = read_json(path)
    if not isinstance(values, dict) or values.get("kind") != _KIND:
        found = "other JSON" if not isinstance(values, dict) else repr(values.get("kind"))
        raise InputError(f"{path}: kind", repr(_KIND), found)
    names = values.get("names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{path}: names", "a list of texts", repr(names)[:60])
    return _checked(path, names, values.get("covariance"))


def covariance_beside(path: str | Path) -> ParameterCovariance | None:
    """Read what stands beside a rig in YAML; None where nothing does.

    Raises
    ------
    InputError
        Naming the file and what is not known or no covariance.
    """
    values = Source(path).storage
    names, matrix = values.get("covariance_names"), values.get("covariance")
    if names is None and matrix is None:
        return None
    if not isinstance(names, str) or not isinstance(matrix, np.ndarray):
        alone = names is None or matrix is None
        raise InputError(path, _BESIDE, "one of them" if alone else "other types")
    return _checked(path, names.split(), matrix)


def _checked(path: str | Path, names: Sequence[str], matrix: Any) -> ParameterCovariance:
    for name in names:
        if name not in RIG_PARAMETERS:
            expected = f"parameters of a rig, such as {', '.join(RIG_PARAMETERS[:4])}"
            raise InputError(f"{path}: names", expected, quoted(name, RIG_PARAMETERS))
    try:
        array = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):  # rows of different lengths, texts
        array = np.empty(0)
    try:
        return ParameterCovariance(tuple(names), array)
    except InputError as error:
        raise InputError(f"{path}: {error.where}", error.expected, error.got) from None


def moved(rig: Rig, error: Mapping[str, float]) -> Rig:
    """Return a rig whose parameters are off by an error.

    Parameters
    ----------
    rig : Rig
        One camera and one projector.
    error : mapping of str to float
        By names of :data:`RIG_PARAMETERS`; what is not named stays.

    Raises
    ------
    InputError
        For another name, and for an error after which there is no such device.
    """
    for name in error:
        if name not in RIG_PARAMETERS:
            raise InputError("parameters", "those of a rig", quoted(name, RIG_PARAMETERS))
    camera, projector = (
        _moved(device, {name: error.get(f"{role}.{name}", 0.0) for name in DEVICE_PARAMETERS})
        for role, device in zip(ROLES, (rig.camera, rig.projector), strict=True)
    )
    pair = rig.only
    return rig.having(**{pair.camera: camera, pair.projector: projector})


def optics_of(device: Device) -> dict[str, float]:
    """Return the parameters of a device's lens and panel by name, without terms it has not."""
    names = (*LENS, *COEFFICIENTS[: len(device.distortion)], *TILT)
    pinhole = (*np.diag(device.matrix)[:2], *device.centre)
    values = (*pinhole, *device.distortion, *device.tilt_rad)
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _moved(device: Any, error: Mapping[str, float]) -> Camera | Projector:
    if not any(error.values()):
        return device  # type: ignore[no-any-return]
    from scipy.spatial.transform import Rotation  # a third of a second, for few scenes

    own = optics_of(device)
    fx, fy, cx, cy, *distortion = (own.get(name, 0.0) + error[name] for name in OPTICS)
    turn, shift = ([error[name] for name in names] for names in (TURN, SHIFT))
    # The pixel's width stays, its height takes up the difference, as in a file of OpenCV's.
    focal = fx * device.pitch_mm[0]
    rotation, position = device.pose.rotation, device.pose.position
    pose = Pose(rotation @ Rotation.from_rotvec(turn).as_matrix(), position + rotation @ shift)
    return replace(  # type: ignore[no-any-return]
        device,
        lens=replace(device.lens, focal_length_mm=focal),
        pitch_mm=(device.pitch_mm[0], focal / fy),
        principal_point=(cx, cy),
        distortion=tuple(distortion[: len(COEFFICIENTS)]),
        tilt_rad=tuple(distortion[len(COEFFICIENTS) :]),
        pose=pose,
    )
