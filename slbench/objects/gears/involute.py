"""The transverse profile of an involute gear, as the basic rack of ISO 53 generates it.

The flank is the involute of the base circle.  With the tooth's middle on the real axis, the
point whose roll angle is ``phi = tan(alpha_r)`` is, as a complex number,

    flank(phi) = r_b (1 + i phi) exp(i (psi_b - phi)),

where ``psi_b = s / (2 r) + inv(alpha)`` is half the angle of the tooth at its base and
``inv(alpha) = tan(alpha) - alpha``.  The root fillet is the exact envelope of the rack's
rounded tip (a trochoid, which undercuts the involute where the teeth are few), not an arc in
its stead.  Litvin & Fuentes, *Gear Geometry and Applied Theory* (2nd ed.), ch. 6 and 10.

Points stand on the curves themselves, so that chords, and nothing else, separate the polygon
from the profile.  Two circles always carry a point of every flank: the reference circle, and
the one where a gear calliper over :attr:`Toothing.calliper_teeth` teeth touches.  The tooth
thickness and the base tangent length of the polygon are therefore exact.

Lengths are in millimetres, angles in radians.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from slbench.core.errors import InputError

#: Addendum and dedendum in modules, profile A of ISO 53.
ADDENDUM = 1.0
DEDENDUM = 1.25

#: Samples of a curve between two breakpoints from which its points are placed.
_SAMPLES = 1025

ComplexCurve = Callable[[NDArray[np.float64]], NDArray[np.complex128]]


def involute(angle: float) -> float:
    """Return the involute function ``tan(angle) - angle``."""
    return math.tan(angle) - angle


@dataclasses.dataclass(frozen=True)
class Toothing:
    """An involute toothing in its transverse plane.

    Parameters
    ----------
    module_mm : float
        Reference diameter over number of teeth.
    teeth : int
        Number of teeth.
    pressure_angle : float
        At the reference circle, rad.
    profile_shift : float
        Distance of the rack from the reference circle, in modules, outwards positive.
    backlash_mm : float
        What is taken off the tooth's thickness, as an arc of the reference circle.
    root_fillet : float
        Tip radius of the generating rack, in modules.
    where : str
        Where these were read, for error messages.

    Raises
    ------
    InputError
        If the rack has no room for its tip radius, or the teeth come out pointed, cut
        through, or without an involute at the reference circle.
    """

    module_mm: float
    teeth: int
    pressure_angle: float
    profile_shift: float = 0.0
    backlash_mm: float = 0.0
    root_fillet: float = 0.38
    where: str = "toothing"

    def __post_init__(self) -> None:
        m = self.module_mm
        if self.tooth_thickness_mm < 0.2 * m:
            most = self.tooth_thickness_mm + self.backlash_mm - 0.2 * m
            expected = f"at most {most:.4g} mm, which leaves teeth of 0.2 modules"
            raise InputError(f"{self.where}.backlash_mm", expected, self.backlash_mm)
        if self._rack_tip_mm < 0.01 * m or self._rack_depth_mm <= 0.0:
            expected = "a tip radius that the rack has room for (0.38 by ISO 53)"
            raise InputError(f"{self.where}.root_fillet", expected, self.root_fillet)
        waist = float(self._fillet(np.linspace(0.0, self._junction[0], 257)).imag.min())
        if self.form_radius_mm > self.reference_radius_mm or waist < 0.1 * m:
            expected = "more teeth, or more profile_shift: these are undercut too far"
            raise InputError(f"{self.where}.teeth", expected, self.teeth)
        if self.tip_radius_mm * self.half_angle(self.tip_radius_mm) < 0.02 * m:
            expected = "less profile_shift, backlash or pressure angle: the teeth are pointed"
            raise InputError(f"{self.where}.profile_shift", expected, self.profile_shift)

    @property
    def reference_radius_mm(self) -> float:
        """Radius of the reference circle (pitch circle)."""
        return self.module_mm * self.teeth / 2.0

    @property
    def base_radius_mm(self) -> float:
        """Radius of the circle that the involutes unwind from."""
        return self.reference_radius_mm * math.cos(self.pressure_angle)

    @property
    def tip_radius_mm(self) -> float:
        """Radius of the tip circle."""
        return self.reference_radius_mm + self.module_mm * (ADDENDUM + self.profile_shift)

    @property
    def root_radius_mm(self) -> float:
        """Radius of the root circle."""
        return self.reference_radius_mm - self.module_mm * (DEDENDUM - self.profile_shift)

    @property
    def form_radius_mm(self) -> float:
        """Radius where the fillet ends and the involute begins."""
        return self.base_radius_mm * math.hypot(1.0, self._junction[1])

    @property
    def tooth_thickness_mm(self) -> float:
        """Arc of the reference circle within a tooth."""
        slope = 2.0 * self.profile_shift * math.tan(self.pressure_angle)
        return self.module_mm * (math.pi / 2.0 + slope) - self.backlash_mm

    @property
    def chordal_thickness_mm(self) -> float:
        """Chord of the reference circle within a tooth."""
        r = self.reference_radius_mm
        return 2.0 * r * math.sin(self.tooth_thickness_mm / (2.0 * r))

    def half_angle(self, radius_mm: float) -> float:
        """Return half the angle of a tooth at a radius on the involute, rad."""
        at_radius = math.acos(min(1.0, self.base_radius_mm / radius_mm))
        return self._half_base_angle - involute(at_radius)

    def base_tangent_mm(self, teeth: int) -> float:
        """Return the base tangent length over some teeth.

        ``W_k = m cos(a) (pi (k - 1/2) + z inv(a)) + 2 x m sin(a) - j cos(a)`` (DIN 3960),
        with `j` the backlash taken off each tooth.
        """
        m, a = self.module_mm, self.pressure_angle
        plain = m * math.cos(a) * (math.pi * (teeth - 0.5) + self.teeth * involute(a))
        shift = 2.0 * self.profile_shift * m * math.sin(a)
        return plain + shift - self.backlash_mm * math.cos(a)

    def contact_radius_mm(self, teeth: int) -> float:
        """Return the radius where a calliper over some teeth touches their flanks."""
        return math.hypot(self.base_radius_mm, self.base_tangent_mm(teeth) / 2.0)

    @cached_property
    def calliper_teeth(self) -> int | None:
        """Number of teeth over which a calliper touches nearest to mid-flank, or None."""
        middle = self.reference_radius_mm + self.profile_shift * self.module_mm
        on_flank = [
            k
            for k in range(1, self.teeth // 2 + 1)
            if self.form_radius_mm < self.contact_radius_mm(k) < self.tip_radius_mm
        ]
        return min(on_flank, key=lambda k: abs(self.contact_radius_mm(k) - middle), default=None)

    def outline(self, max_error_mm: float, max_spacing_mm: float = math.inf) -> NDArray[np.float64]:
        """Return the profile of the whole gear as a polygon.

        Parameters
        ----------
        max_error_mm : float
            Largest distance between a chord and the profile.
        max_spacing_mm : float
            Largest distance between neighbouring points.

        Returns
        -------
        (n, 2) ndarray of float64
            Counter-clockwise, the same points for every tooth; a tooth's middle is on +x.
        """
        limits = (max_error_mm, max_spacing_mm)
        fillet_end, form_roll = self._junction
        marks = [self.reference_radius_mm, self.tip_radius_mm]
        if self.calliper_teeth is not None:
            marks.append(self.contact_radius_mm(self.calliper_teeth))
        rolls = [form_roll]
        for radius in sorted(marks):
            roll = math.sqrt((radius / self.base_radius_mm) ** 2 - 1.0)
            # The calliper may touch at the reference circle: one point will do.
            if roll - rolls[-1] > 1e-9:
                rolls.append(roll)
        fillet = points_on(self._fillet, [0.0, fillet_end], *limits)
        flank = points_on(self._flank, rolls, *limits)
        left = np.concatenate([fillet[:-1], flank])[::-1]

        tip, pitch = self.half_angle(self.tip_radius_mm), 2.0 * math.pi / self.teeth
        space = self._rack_tip_mm / self.reference_radius_mm
        land = points_on(_arc(self.tip_radius_mm), [-tip, tip], *limits)
        root = points_on(_arc(self.root_radius_mm), [-space, space], *limits)
        root = root * np.exp(0.5j * pitch)
        tooth = np.concatenate([left[::-1].conj(), land[1:-1], left, root[1:-1]])
        turns = np.exp(1j * pitch * np.arange(self.teeth))
        return _real(np.outer(turns, tooth).ravel())

    @property
    def _half_base_angle(self) -> float:
        """Half the angle of a tooth at the base circle, its flanks continued to there."""
        half = self.tooth_thickness_mm / (2.0 * self.reference_radius_mm)
        return half + involute(self.pressure_angle)

    @property
    def _rack_depth_mm(self) -> float:
        """Distance of the rack's tip centre below the reference circle's tangent."""
        return self.module_mm * (DEDENDUM - self.root_fillet - self.profile_shift)

    @property
    def _rack_tip_mm(self) -> float:
        """Distance of the rack's tip centre from the middle of the rack's tooth."""
        m, a = self.module_mm, self.pressure_angle
        at_centre = math.pi / 4.0 - (DEDENDUM - self.root_fillet) * math.tan(a)
        return m * (at_centre - self.root_fillet / math.cos(a)) + self.backlash_mm / 2.0

    def _flank(self, roll: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Left flank (counter-clockwise side of the tooth) at roll angles."""
        turn = np.exp(1j * (self._half_base_angle - roll))
        return self.base_radius_mm * (1.0 + 1j * roll) * turn

    def _fillet(self, offset: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Left fillet where the rack's tip centre stands `offset` beside the pitch point.

        The common normal of rack and gear passes through the pitch point, so that the rack's
        tip circle touches the gear in line with its centre.
        """
        r, depth = self.reference_radius_mm, self._rack_depth_mm
        # Real axis: the middle of the tooth space; imaginary: towards the flank.
        centre = -depth + 1j * offset
        touching = r + centre * (1.0 + self.module_mm * self.root_fillet / np.abs(centre))
        rolled = touching * np.exp(-1j * (offset - self._rack_tip_mm) / r)
        return rolled.conj() * np.exp(1j * math.pi / self.teeth)

    @cached_property
    def _junction(self) -> tuple[float, float]:
        """Where fillet and involute meet: the fillet's offset and the involute's roll angle."""
        a, base = self.pressure_angle, self.base_radius_mm
        last = self._rack_depth_mm / math.tan(a)
        below = self._rack_depth_mm + self.module_mm * self.root_fillet * math.sin(a)
        roll = math.tan(a) - below / (base * math.sin(a))
        if roll >= 0.0:
            return last, roll

        def overlap(offset: NDArray[np.float64]) -> NDArray[np.float64]:
            # Angle by which the fillet lies outside the involute; undercut is negative.
            points = self._fillet(offset)
            at = np.arccos(np.minimum(1.0, base / np.abs(points)))
            return np.angle(points) - (self._half_base_angle - (np.tan(at) - at))

        offsets = np.linspace(0.0, last, _SAMPLES)
        outside = overlap(offsets) * (np.abs(self._fillet(offsets)) >= base)
        lowest = int(np.argmin(outside))
        if outside[lowest] >= 0.0:
            # Undercut too slight to be seen: at the base circle both meet within rounding.
            return last, 0.0
        crossing = scipy.optimize.brentq(
            lambda c: float(overlap(np.array(c))), offsets[lowest], last, xtol=1e-15 * base
        )
        radius = float(np.abs(self._fillet(np.array(crossing))))
        return crossing, math.sqrt(max(0.0, (radius / base) ** 2 - 1.0))


def points_on(
    curve: ComplexCurve,
    breakpoints: Sequence[float],
    max_error_mm: float,
    max_spacing_mm: float = math.inf,
) -> NDArray[np.complex128]:
    """Choose points on a smooth plane curve so that chords stay close to it.

    A chord of length L whose curve turns by theta lies within L theta / 8 of it; points are
    spread evenly in the integral of sqrt(curvature), by which all chords do equally well.

    Parameters
    ----------
    curve : callable
        From an array of parameters to complex points, x + i y.
    breakpoints : sequence of float
        Ascending parameters that become points whatever the error.
    max_error_mm, max_spacing_mm : float
        Bounds on the error of a chord, and on its length.

    Returns
    -------
    (n,) ndarray of complex128
        Points on the curve, first and last breakpoint included.
    """
    parameters = [np.array(breakpoints[:1], dtype=np.float64)]
    for low, high in itertools.pairwise(breakpoints):
        fine = np.linspace(low, high, _SAMPLES)
        steps = np.diff(curve(fine))
        turns = np.abs(np.angle(steps[1:] / steps[:-1]))
        turn = 0.5 * (np.concatenate([turns[:1], turns]) + np.concatenate([turns, turns[-1:]]))
        length = np.abs(steps)
        # 2 %: for the higher orders of the sag.
        demand = 1.02 * np.sqrt(turn * length / (8.0 * max_error_mm))
        demand = np.cumsum(np.maximum(demand, length / max_spacing_mm))
        count = max(1, math.ceil(demand[-1] * (1.0 + 1e-9)))
        places = np.arange(1, count) / count * demand[-1]
        inner = np.interp(places, np.concatenate([[0.0], demand]), fine)
        parameters.append(np.append(inner, high))
    return curve(np.concatenate(parameters))


def circle(
    radius_mm: float, max_error_mm: float, max_spacing_mm: float = math.inf
) -> NDArray[np.float64]:
    """Return a regular polygon with the area of a circle.

    As for :mod:`slbench.objects.shapes.sphere`: corners stand out by twice what the sides fall
    short, and a least-squares circle through points all along the sides has the radius.

    Parameters
    ----------
    radius_mm : float
        Radius of the circle.
    max_error_mm, max_spacing_mm : float
        Bounds on the distance from the circle, and on the length of a side.

    Returns
    -------
    (n, 2) ndarray of float64
        Counter-clockwise from +x, n >= 24.
    """
    for_error = math.pi * math.sqrt(radius_mm / (3.0 * max_error_mm))
    count = max(24, math.ceil(1.01 * max(for_error, 2.0 * math.pi * radius_mm / max_spacing_mm)))
    step = 2.0 * math.pi / count
    corner = radius_mm * math.sqrt(step / math.sin(step))
    return _real(corner * np.exp(1j * step * np.arange(count)))


def _arc(radius_mm: float) -> ComplexCurve:
    return lambda angle: radius_mm * np.exp(1j * angle)


def _real(points: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.column_stack([points.real, points.imag])
