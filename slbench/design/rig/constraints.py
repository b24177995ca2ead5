"""Whether a rig can be built and works: the six constraints g1..g6 of thesis 3.2.2.

==  ==========================================================================
g1  camera and projector stand in front of the reference plane (eq. 14)
g2  both within the working distances of their lenses (eq. 15)
g3  the measurement volume lies inside both in-focus volumes (eq. 16)
g4  the camera's body is outside the projector's frustum (eq. 17)
g5  the projector's body is outside the camera's frustum (eq. 18)
g6  the bodies are apart (eq. 19)
==  ==========================================================================

**Sign.** The thesis has g = -1 where a constraint holds and 1 elsewhere; here each is a
*margin* in mm, **positive where it holds**: how far the rig is from violating it.  A rig is
feasible where all six margins are positive.  Of barrels in several parts g4..g6 have the
nearest, or the most overlapping, pair of parts.

An in-focus volume is cut out by planes: four through the lens and the panel's edges, and two
where the circle of confusion reaches its limit, ``|n . X - 1| = rho Z`` with ``n`` of
:attr:`slbench.rig.Device.focus_plane` and ``rho = circle / (2 a c)`` (``rho s`` on the right
for a telecentric lens): planes, too, whether or not the sensor is tilted.  A viewing frustum
reaches from the lens to the far end of the measurement volume, as what is behind it is in
nobody's way.  Both go through the four corners of the panel: with distortion, the slight
curvature of the edges between them is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.show.display import brief
from slbench.design.rig.hardware import VARIABLES, Hardware, Placement, are_angles
from slbench.design.rig.kernels import margins as kernel
from slbench.rig import DesignVariables, Device, Lens
from slbench.rig.optics.distortion import tilt_rotation
from slbench.rig.optics.spread import Spread

Array = NDArray[np.float64]

#: Names of the constraints, in the order of the margins' columns.
CONSTRAINTS = ("g1", "g2", "g3", "g4", "g5", "g6")

#: What each part of the margins says where it is negative, and its constraint.
PARTS = (
    ("g1", "the camera is not in front of the reference plane"),
    ("g1", "the projector is not in front of the reference plane"),
    ("g2", "the camera is nearer than its shortest working distance"),
    ("g2", "the camera is farther than its longest working distance"),
    ("g2", "the projector is nearer than its shortest working distance"),
    ("g2", "the projector is farther than its longest working distance"),
    ("g3", "the volume leaves the camera's field of view"),
    ("g3", "the volume leaves the camera's depth of field"),
    ("g3", "the volume leaves the projector's field of view"),
    ("g3", "the volume leaves the projector's depth of field"),
    ("g4", "the camera's body is in the projector's frustum"),
    ("g5", "the projector's body is in the camera's frustum"),
    ("g6", "the bodies of camera and projector overlap"),
)
#: The first part of each constraint.
_FIRST = [[name for name, _ in PARTS].index(name) for name in CONSTRAINTS]

_NO_OPTICS = np.empty((1, 0))
#: Rounds of :func:`diagnose`'s refinement, and by how much each one narrows the search.
_ROUNDS, _NARROWER = 40, 0.8
_PER_ROUND = 64


def margins(hardware: Hardware, configurations: ArrayLike | Sequence[DesignVariables]) -> Array:
    """Return the signed margins of g1..g6.

    Parameters
    ----------
    hardware : Hardware
    configurations : (n, 6) float or list of DesignVariables
        In mm and rad.

    Returns
    -------
    (n, 6) float
        In mm, positive where the constraint holds; -inf where a configuration is no rig at
        all (the projector's axis never meets the reference plane).

    Raises
    ------
    InputError
        If the configurations are not numbers, six each.
    """
    return placed_margins(hardware, hardware.place(configurations))


def placed_margins(hardware: Hardware, placement: Placement) -> Array:
    """As :func:`margins`, of devices already placed."""
    return Constraints(hardware).margins(placement)


def explain(hardware: Hardware, configuration: ArrayLike | DesignVariables) -> list[str]:
    """Explain in sentences what is wrong with a configuration.

    Returns
    -------
    list of str
        One for each part of a constraint that is violated, with the amount, worst first;
        empty where the configuration is feasible.
    """
    placement = hardware.place([*np.atleast_2d(_row(configuration))])
    parts = Constraints(hardware).parts(placement)[0]
    if np.isneginf(parts[0]):
        return ["g1: the projector's axis does not meet the reference plane"]
    order = np.argsort(parts)
    return [f"{PARTS[i][0]}: {PARTS[i][1]} by {-parts[i]:.4g} mm" for i in order if parts[i] <= 0]


def focus_slacks(
    hardware: Hardware,
    configurations: ArrayLike | Sequence[DesignVariables],
    points: ArrayLike,
) -> Array:
    """Return the signed distances of world points to the planes around both in-focus volumes.

    Parameters
    ----------
    hardware : Hardware
    configurations : (n, 6 + m) float or list of DesignVariables
    points : (m, 3) float
        World coordinates, mm.

    Returns
    -------
    (n, m, 2 (4 + 2 s)) float
        mm, positive inside; for each device four sides of its view and, for each of the s settings
        of the sweep, two limits of its depth of field (infinite for a pinhole).
    """
    placement = hardware.place(configurations)
    world = np.ascontiguousarray(points, dtype=np.float64)
    focuses = hardware.focuses(placement)
    out = np.empty((2, len(placement.valid), len(world), 4 + 2 * focuses.shape[2]))
    for device, rotation, position, focus, into in zip(
        _constants(hardware, placement.optics), *_placed(placement)[:2], focuses, out, strict=True
    ):
        kernel.slacks(device, rotation, position, focus, world, into)
    return np.concatenate(tuple(out), axis=2)


@dataclass(frozen=True)
class Diagnosis:
    """What :func:`diagnose` found out.

    Parameters
    ----------
    feasible_share : float
        Share of the sampled configurations that are feasible.
    configuration : (6,) float
        The best found: the one whose smallest margin is largest, mm and rad.
    margins : (6,) float
        Its margins, mm.
    highest : (6,) float
        Of each constraint, the largest margin found anywhere, mm.
    reasons : tuple of str
        What is wrong with the configuration (:func:`explain`); empty if it is feasible.
    variables : tuple of str
        Names of the configuration's values.
    """

    feasible_share: float
    configuration: Array
    margins: Array
    highest: Array
    reasons: tuple[str, ...]
    variables: tuple[str, ...] = VARIABLES

    __repr__ = brief

    @property
    def feasible(self) -> bool:
        """Whether any feasible configuration was found."""
        return bool(np.all(self.margins > 0))

    def __str__(self) -> str:
        own = self.configuration
        values = np.where(are_angles(self.variables), np.rad2deg(own), own)
        where = ", ".join(f"{n} {v:.5g}" for n, v in zip(self.variables, values, strict=True))
        if self.feasible:
            return f"feasible, with {self.margins.min():.3g} mm to spare at {where}"
        alone = [n for n, most in zip(CONSTRAINTS, self.highest, strict=True) if most <= 0]
        never = f" ({', '.join(alone)} holds nowhere in the ranges)" if alone else ""
        return f"nothing feasible found{never}; nearest: {'; '.join(self.reasons)}, at {where}"


def diagnose(hardware: Hardware, n: int = 4096, seed: int = 0) -> Diagnosis:
    """Find the least infeasible configuration and say what is wrong with it.

    The ranges are sampled evenly, then ever more narrowly around the best so far.

    Parameters
    ----------
    hardware : Hardware
    n : int
        Configurations to start with.
    seed : int

    Raises
    ------
    InputError
        If `n` is not positive.
    """
    if n < 1:
        raise InputError("number of configurations", "at least 1", n)
    rng = generator(seed)
    low, high = hardware.bounds
    rows = low + (high - low) * rng.random((n, len(low)))
    values = margins(hardware, rows)
    share = float(np.mean(np.all(values > 0, axis=1)))
    highest = values.max(axis=0)
    best = int(np.argmax(values.min(axis=1)))
    row, value = rows[best], values[best]
    reach = 0.25 * (high - low)
    for _ in range(_ROUNDS):
        rows = np.clip(row + reach * rng.uniform(-1, 1, (_PER_ROUND, len(low))), low, high)
        values = margins(hardware, rows)
        highest = np.maximum(highest, values.max(axis=0))
        best = int(np.argmax(values.min(axis=1)))
        if values[best].min() > value.min():
            row, value = rows[best], values[best]
        else:
            reach *= _NARROWER
    reasons = tuple(explain(hardware, row))
    return Diagnosis(share, row, value, highest, reasons, hardware.variables)


def feasible_sample(hardware: Hardware, n: int, seed: int = 0) -> Array:
    """Draw feasible configurations evenly from the ranges of the design variables.

    Parameters
    ----------
    hardware : Hardware
    n : int
    seed : int

    Returns
    -------
    (n, 6) float
        In mm and rad.

    Raises
    ------
    InputError
        If `n` is not positive, or fewer than `n` of 2^17 points are feasible.
    """
    if n < 1:
        raise InputError("number of configurations", "at least 1", n)
    rng = generator(seed)
    low, high = hardware.bounds
    found = np.empty((0, len(low)))
    for _ in range(32):
        rows = low + (high - low) * rng.random((4096, len(low)))
        found = np.vstack((found, rows[np.all(margins(hardware, rows) > 0, axis=1)]))
        if len(found) >= n:
            return found[:n]
    got = str(len(found)) if len(found) else f"none; {diagnose(hardware)}"
    raise InputError("hardware", f"{n} feasible configurations among 131072 drawn", got)


def _row(configuration: ArrayLike | DesignVariables) -> Array:
    if isinstance(configuration, DesignVariables):
        v = configuration
        return np.array([v.z_ref, v.w, v.h, v.l, v.alpha_p, v.beta_p])
    return np.asarray(configuration, dtype=np.float64)


class Constraints:
    """The constraints of one hardware; what does not depend on the configuration is kept.

    Parameters
    ----------
    hardware : Hardware
    """

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self._devices = None if hardware.optics else _constants(hardware, _NO_OPTICS)
        self._ranges = np.array([hardware.camera_distance_mm, hardware.projector_distance_mm])
        self._corners = hardware.volume_corners

    def parts(self, placement: Placement, *, exact: bool = True) -> Array:
        """Return the margins of all parts of the constraints, (n, 13), in the order of PARTS.

        Unless `exact`, those of g4..g6 may be less than they are where they are positive.
        """
        out = np.empty((len(placement.valid), len(PARTS)))
        devices = self._devices or _constants(self._hardware, placement.optics)
        rotations, positions, distances = _placed(placement)
        focuses = self._hardware.focuses(placement, swept=False)[..., 0]
        kernel.parts(
            self._ranges,
            devices,
            rotations,
            positions,
            distances,
            (focuses[0], focuses[1]),
            placement.valid,
            self._corners,
            exact,
            out,
        )
        return out

    def margins(self, placement: Placement, *, exact: bool = True) -> Array:
        """Return the margins of the constraints, (n, 6); see :func:`margins` and `parts`."""
        return np.minimum.reduceat(self.parts(placement, exact=exact), _FIRST, axis=1)


def _placed(p: Placement) -> tuple[tuple[Array, Array], tuple[Array, Array], tuple[Array, Array]]:
    """Return rotations, positions and distances of camera and projector."""
    return (
        (p.camera_rotation, p.projector_rotation),
        (p.camera_position, p.projector_position),
        (p.camera_distance, p.projector_distance),
    )


def _constants(hardware: Hardware, optics: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Return camera and projector as the kernels take them, for variables of the lenses (n, m).

    What depends on a lens is stacked: n of them, or one where the hardware has no variables.
    """
    camera, projector = (_constant(hardware, role, optics) for role in ("camera", "projector"))
    return camera, projector


def _constant(hardware: Hardware, role: str, optics: Array) -> tuple[Array, ...]:
    own: Device = getattr(hardware, role)
    moves = hardware.refocused[role == "projector"]
    apertures, _, tilts = hardware.device_optics(role, optics if hardware.optics else _NO_OPTICS)
    each = zip(apertures.tolist(), tilts.tolist(), strict=True)
    stacked = [_lens(own, radius, tuple(tilt), hardware.circle_px, moves) for radius, tilt in each]
    lenses, normals, sides, fields = (np.stack(part) for part in zip(*stacked, strict=True))
    return lenses, normals, sides, fields, *_body(own)


def _lens(
    device: Device, aperture: float, tilt: tuple[float, float], circle_px: float, moves: bool
) -> tuple[Array, Array, Array, Array]:
    lens = device.lens
    if aperture != lens.aperture_radius_mm:
        lens = _with_aperture(lens, aperture)
    spread = Spread(lens.diffraction_mm / device.pitch_mm[0], device.blur_px)
    telecentric = lens.kind == "telecentric"
    numbers = np.array(
        [
            lens.focal_length_mm,
            lens.defocusing_radius_mm,
            lens.focus_distance_mm,
            spread.circle(circle_px) * device.pitch_mm[0],
            moves,
            telecentric,
        ],
        dtype=np.float64,
    )
    field = _field(device, tilt)
    if telecentric:
        edges = np.roll(field, -1, axis=0) - field
        sides = np.c_[-edges[:, 1], edges[:, 0], np.zeros(4)]
        offsets = -np.sum(sides[:, :2] * field, axis=1)
    else:
        rays = np.c_[field, np.ones(4)]
        sides, offsets = np.cross(rays, np.roll(rays, -1, axis=0)), np.zeros(4)
    planes = np.c_[sides, offsets] / np.linalg.norm(sides, axis=1)[:, np.newaxis]
    return numbers, tilt_rotation(*tilt)[2], planes, field


@lru_cache(maxsize=64)
def _with_aperture(lens: Lens, aperture: float) -> Lens:
    return replace(lens, aperture_radius_mm=aperture)


def _body(device: Device) -> tuple[Array, Array]:
    """Return a box's corners (8, 3) or a barrel's profile (m, 2); the other one is empty."""
    if device.barrel_mm is not None:
        return np.empty((0, 3)), np.array(device.barrel_mm)
    assert device.body_mm is not None  # by Hardware
    x, y, depth = device.body_mm
    face = 0.5 * np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    body = np.concatenate((np.c_[face, np.full(4, -depth)], np.c_[face, np.zeros(4)]))
    return body, np.empty((0, 2))


def _field(device: Device, tilt: tuple[float, float]) -> Array:
    """Return a tilted panel's four corners in normalised coordinates, (4, 2).

    Clockwise in the image; for a telecentric lens, in mm across the axis.
    """
    right, bottom = device.width - 0.5, device.height - 0.5
    corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    scale = device.lens.focus_distance_mm if device.lens.kind == "telecentric" else 1.0
    return device.normalise(corners, tilt) * scale
