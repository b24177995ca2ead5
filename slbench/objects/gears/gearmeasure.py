"""Gear metrology on a mesh: sections, and what a gear calliper and a micrometer find there.

Nothing here knows an involute: a section is cut from the mesh, and its polygon is measured as
one measures a gear: the gap between a calliper's jaws, the chord of a circle within a tooth
(DIN 3960; ISO 21771).  Lengths are in millimetres.
"""

import numpy as np
import trimesh.nsphere
from numpy.typing import NDArray

from slbench.objects.artefact import Mesh


def section(mesh: Mesh, z_mm: float) -> list[NDArray[np.float64]]:
    """Cut a closed mesh with a plane across z, in double precision.

    A vertex on the plane counts as below it, so that a plane through a layer of vertices
    passes through those vertices and through nothing that ends there from below.

    Parameters
    ----------
    mesh : Mesh
        A watertight mesh.
    z_mm : float
        Height of the plane.

    Returns
    -------
    list of (n, 2) ndarray of float64
        The closed loops, largest area first; counter-clockwise around material, clockwise
        around holes.
    """
    above = mesh.vertices[:, 2] > z_mm
    faces = mesh.faces[np.isin(above[mesh.faces].sum(axis=1), (1, 2))]
    if len(faces) == 0:
        return []
    # Turn each face so that its first corner is alone on its side of the plane.
    sides = above[faces]
    alone = np.argmax(sides == (sides.sum(axis=1, keepdims=True) == 1), axis=1)
    rows = np.arange(len(faces))
    apex, second, third = (faces[rows, (alone + i) % 3] for i in range(3))
    # Seen from outside, with +z up, a face's section runs from its right edge to its left.
    up = above[apex]
    start = np.where(up[:, None], np.stack([apex, second], 1), np.stack([apex, third], 1))
    end = np.where(up[:, None], np.stack([apex, third], 1), np.stack([apex, second], 1))
    count = len(mesh.vertices)
    start_key, end_key = (e.min(axis=1) * count + e.max(axis=1) for e in (start, end))
    a, b = mesh.vertices[start.min(axis=1)], mesh.vertices[start.max(axis=1)]
    share = ((z_mm - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
    points = a[:, :2] + share * (b[:, :2] - a[:, :2])

    order = np.argsort(start_key)
    following = order[np.searchsorted(start_key, end_key, sorter=order)]
    loops = []
    left = np.ones(len(faces), dtype=bool)
    for first in range(len(faces)):
        if left[first]:
            chain = [first]
            left[first] = False
            while left[following[chain[-1]]]:
                chain.append(int(following[chain[-1]]))
                left[chain[-1]] = False
            loop = points[chain]
            # A face that touches the plane with a corner only contributes that corner again.
            loops.append(loop[np.any(loop != np.roll(loop, 1, axis=0), axis=1)])
    return sorted(loops, key=lambda loop: -abs(area(loop)))


def area(loop: NDArray[np.float64]) -> float:
    """Return the area within a polygon, mm^2; negative if it runs clockwise."""
    x, y = (loop - loop[0]).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def layer_below(mesh: Mesh, z_mm: float) -> float:
    """Return the height of the highest layer of vertices not above a height, mm."""
    slack = 1e-9 * float(np.ptp(mesh.bounds[:, 2]))
    levels = mesh.vertices[:, 2]
    return float(levels[levels <= z_mm + slack].max())


def measure_bore(loop: NDArray[np.float64]) -> float:
    """Return the diameter of the circle with the area of a section's hole, mm."""
    return float(2.0 * np.sqrt(abs(area(loop)) / np.pi))


def fit_circle(points: NDArray[np.float64]) -> float:
    """Return the radius of the circle through points in a plane by least squares, mm.

    Algebraic fit (Kasa): exact for points that are on a circle.

    Parameters
    ----------
    points : (n, 2) ndarray of float
        The points; NaN is returned for fewer than three.
    """
    if len(points) < 3:
        return float("nan")
    return float(trimesh.nsphere.fit_nsphere(points)[1])


def measure_face_width(mesh: Mesh, reference_radius_mm: float) -> float:
    """Return the extent along z of what reaches out to a circle about the axis, mm."""
    reach = np.linalg.norm(mesh.vertices[:, :2], axis=1) >= reference_radius_mm
    return float(np.ptp(mesh.vertices[reach, 2])) if reach.any() else float("nan")


def measure_leads(mesh: Mesh, reference_radius_mm: float) -> tuple[float, float]:
    """Measure the leads of the two halves of a double-helical gear.

    Parameters
    ----------
    mesh : Mesh
        The gear, with points of all flanks on the reference circle in every layer.
    reference_radius_mm : float
        That circle.

    Returns
    -------
    lower_mm, upper_mm : float
        Rise of the tooth spiral in one turn; right-handed positive.  NaN where the mesh has
        no two layers of teeth in a half.
    """
    x, y, z = mesh.vertices.T
    on_circle = np.abs(np.hypot(x, y) - reference_radius_mm) < 1e-9 * reference_radius_mm
    levels, layer, flanks = np.unique(z[on_circle], return_inverse=True, return_counts=True)
    if len(levels) < 3 or np.any(flanks != flanks[0]):
        return float("nan"), float("nan")
    # Two flanks a tooth, about half a pitch apart: in twice as many turns they are in phase,
    # and the angle of their sum follows the teeth without telling them apart.
    phase = np.exp(1j * flanks[0] * np.arctan2(y, x)[on_circle])
    sums = np.bincount(layer, phase.real) + 1j * np.bincount(layer, phase.imag)
    turn = np.unwrap(np.angle(sums)) / flanks[0]
    middle = 0.5 * (levels[0] + levels[-1])
    slack = 1e-9 * (levels[-1] - levels[0])
    halves = levels <= middle + slack, levels >= middle - slack
    lower, upper = (
        float(2.0 * np.pi / np.polyfit(levels[half], turn[half], 1)[0])
        if half.sum() > 1
        else float("nan")
        for half in halves
    )
    return lower, upper


def measure_toothing(
    loop: NDArray[np.float64], reference_radius_mm: float, calliper_teeth: int | None
) -> dict[str, float]:
    """Measure the teeth of a section.

    Parameters
    ----------
    loop : (n, 2) ndarray of float
        The outer outline, counter-clockwise about the axis at the origin.
    reference_radius_mm : float
        Circle on which the tooth thickness is measured.
    calliper_teeth : int or None
        Number of teeth between the jaws; None: no base tangent length.

    Returns
    -------
    dict of str to float
        ``tip_diameter_mm, root_diameter_mm``, of the circles about and within all corners;
        ``chordal_tooth_thickness_mm`` and ``base_tangent_over_K_teeth_mm``, means over all
        teeth.  NaN where the circle does not cut out teeth.
    """
    radius = np.linalg.norm(loop, axis=1)
    measured = {
        "tip_diameter_mm": 2.0 * float(radius.max()),
        "root_diameter_mm": 2.0 * float(radius.min()),
    }
    rising, falling = _crossings(loop, reference_radius_mm)
    cut = len(rising) == len(falling) > 0
    chords = np.linalg.norm(falling - rising, axis=1) if cut else np.array([np.nan])
    measured["chordal_tooth_thickness_mm"] = float(chords.mean())
    if calliper_teeth is not None:
        gaps = _gaps(loop, radius, rising, falling, calliper_teeth) if cut else [np.nan]
        measured[f"base_tangent_over_{calliper_teeth}_teeth_mm"] = float(np.mean(gaps))
    return measured


def _crossings(
    loop: NDArray[np.float64], radius_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where an outline leaves and re-enters a circle, tooth by tooth, (z, 2) each."""
    following = np.roll(loop, -1, axis=0)
    outside = np.linalg.norm(loop, axis=1) >= radius_mm
    cut = np.flatnonzero(outside != np.roll(outside, -1))
    a, step = loop[cut], (following - loop)[cut]
    # |a + t step| = radius has one solution on a side that crosses the circle.
    half_b = np.einsum("ij,ij->i", a, step)
    square = np.einsum("ij,ij->i", step, step)
    rest = np.einsum("ij,ij->i", a, a) - radius_mm**2
    root = np.sqrt(np.maximum(half_b**2 - square * rest, 0.0))
    t = (-half_b + np.where(outside[cut], -root, root)) / square
    points = a + t[:, None] * step
    leaving = ~outside[cut]
    rising, falling = points[leaving], points[~leaving]
    if len(leaving) and not leaving[0]:
        falling = np.roll(falling, -1, axis=0)
    return rising, falling


def _gaps(
    loop: NDArray[np.float64],
    radius: NDArray[np.float64],
    rising: NDArray[np.float64],
    falling: NDArray[np.float64],
    teeth: int,
) -> list[float]:
    """Gap of a calliper closed on `teeth` teeth, for each of the teeth it can start on."""
    # The jaws reach a third of the way into the tooth spaces; fillets are out of reach.
    reached = loop[radius > radius.min() + 0.35 * np.ptp(radius)]
    angle = np.arctan2(reached[:, 1], reached[:, 0])
    start = np.arctan2(rising[:, 1], rising[:, 0])
    end = np.arctan2(falling[:, 1], falling[:, 0])
    half_pitch = np.pi / len(rising)
    gaps = []
    for first in range(len(rising)):
        span = (end[(first + teeth - 1) % len(end)] - start[first]) % (2.0 * np.pi)
        middle = start[first] + span / 2.0
        off = (angle - middle + np.pi) % (2.0 * np.pi) - np.pi
        # From the middle of one tooth space to the middle of another.
        held = reached[np.abs(off) < teeth * half_pitch]
        across = held @ np.array([-np.sin(middle), np.cos(middle)])
        gaps.append(float(np.ptp(across)))
    return gaps
