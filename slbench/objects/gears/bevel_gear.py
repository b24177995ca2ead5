"""A curved, bevel-like gear: small teeth on a convex crown, about a concave dish.

The counterpart of the "curved gear with both convex and concave regions and small teeth" that
the thesis measures (thesis 6.2.4, fig. 14c) without stating its size.  Every section across the
axis is the same involute profile (:mod:`slbench.objects.gears.involute`), scaled so that its
reference circle follows a circular arc, the *crown*, which leans from `lower_cone_angle_deg`
to `upper_cone_angle_deg` towards the axis.  It is an artefact to look at, not a bevel gear to
run: those have their profile on the back cone.

Above, a flat rim (the reference) surrounds a spherical dish; out of it rises a hub with a
rounded edge.  Patches between neighbouring sections are plane, so that the form error is the
sum of two chords, half of it each.

Object frame: that of :mod:`slbench.objects.gears.gear`, z = 0 on the rim; the teeth are largest at
the lower face, ``z = -face_width_mm``, and the module is the one there.
"""

import itertools
import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import REFERENCE, Artefact, Mesh
from slbench.objects.gears.gear import (
    FormError,
    ToothedParameters,
    certified_body,
    certified_toothing,
    ring_feature,
    toothing_in,
    toothing_of,
)
from slbench.objects.gears.gearmeasure import fit_circle, measure_bore, measure_toothing, section
from slbench.objects.gears.involute import Toothing, circle
from slbench.objects.mesh.shell import Loop, Shell
from slbench.objects.registry import ArtefactKind

ConeAngle = Annotated[float, Interval(ge=0.0, le=75.0)]


class CurvedGearParameters(ToothedParameters):
    """A curved gear.

    Parameters
    ----------
    face_width_mm : float
        Extent of the teeth along the axis.
    lower_cone_angle_deg, upper_cone_angle_deg : float
        Between the crown and the axis, at the lower face and at the rim.
    rim_width_mm : float
        Of the flat ring between the root circle of the upper end and the dish.
    dish_radius_mm : float
        Radius of the sphere that hollows the upper face.
    hub_diameter_mm : float
        Diameter of the hub.
    hub_height_mm : float
        Height of the hub above the rim.
    hub_rounding_mm : float
        Radius of the hub's upper edge.
    max_form_error_um : float
        Largest distance of the mesh from the true surface.
    """

    face_width_mm: Length
    lower_cone_angle_deg: ConeAngle = 10.0
    upper_cone_angle_deg: ConeAngle = 50.0
    rim_width_mm: Length
    dish_radius_mm: Length
    hub_diameter_mm: Length
    hub_height_mm: Length
    hub_rounding_mm: Length
    max_form_error_um: FormError = 1.0


def build_curved_gear(parameters: CurvedGearParameters, name: str, where: str) -> Artefact:
    """Build a curved gear.

    Parameters
    ----------
    parameters : CurvedGearParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features ``reference`` (a rectangle of the rim, on the +x side) and ``hub``;
        certified are the dimensions of :func:`measure_curved_gear`.

    Raises
    ------
    InputError
        If the toothing cannot be made, or its parts do not fit each other.
    """
    toothing = toothing_of(parameters, where)
    error = 1e-3 * parameters.max_form_error_um
    crown_radius, scales, heights = _crown(parameters, toothing, where)
    upper_root = scales[-1] * toothing.root_radius_mm
    hub = parameters.hub_diameter_mm / 2.0
    rim = upper_root - parameters.rim_width_mm
    room = upper_root - hub - 0.1 * parameters.module_mm
    if parameters.rim_width_mm > room:
        expected = f"at most {room:.4g}, which leaves a dish between rim and hub"
        raise InputError(f"{where}.rim_width_mm", expected, parameters.rim_width_mm)

    shell = Shell()
    outline = toothing.outline(error / 2.0)
    loops = [shell.loop(s * outline, z) for s, z in zip(scales, heights, strict=True)]
    for below, above in itertools.pairwise(loops):
        shell.wall(below, above)
    # All rings about the axis have the corners of the rim's, and the smaller ones less error.
    unit = circle(1.0, error / 2.0 / rim)
    dish = _dish(parameters, unit, rim, where)
    rings = [shell.loop(radius * unit, z) for radius, z in dish]
    shell.ring(loops[-1], rings[0], up=True)
    rings += [shell.loop(radius * unit, z) for radius, z in _hub(parameters, where)]
    for first, second in itertools.pairwise(rings):
        shell.wall(first, second)
    _close(shell, loops[0], rings[-1], parameters, unit)

    reference = ring_feature(REFERENCE, 0.0, rim, upper_root)
    edge = hub - parameters.hub_rounding_mm
    hub_face = ring_feature(
        "hub", parameters.hub_height_mm, parameters.bore_diameter_mm / 2.0, edge
    )
    return Artefact(
        name=name,
        kind="curved_gear",
        parameters=parameters.model_dump(),
        mesh=shell.mesh(),
        certified={
            **certified_toothing(toothing),
            **certified_body(parameters),
            "upper_tip_diameter_mm": 2.0 * float(scales[-1]) * toothing.tip_radius_mm,
            "crown_radius_mm": crown_radius,
            "dish_radius_mm": parameters.dish_radius_mm,
            "face_width_mm": parameters.face_width_mm,
        },
        features=(reference, hub_face),
    )


def measure_curved_gear(artefact: Artefact) -> dict[str, float]:
    """Measure a curved gear on its mesh.

    Parameters
    ----------
    artefact : Artefact
        The gear; its features and parameters say where to measure.

    Returns
    -------
    dict of str to float
        As :func:`slbench.objects.gears.gear.measure_gear`, at the lower face; besides
        ``upper_tip_diameter_mm`` at the rim, ``crown_radius_mm`` of the arc that the points
        of a flank follow which are on the reference circle below, and ``dish_radius_mm``.
    """
    toothing, mesh = toothing_in(artefact), artefact.mesh
    radius = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    z = mesh.vertices[:, 2]
    rim = artefact.planes[0]
    # The rim's rectangle lies between the dish and the teeth.
    toothed = radius > rim.x_mm[1]
    top = z[toothed].max()
    bottom = float(mesh.bounds[0, 2])
    loops = section(mesh, bottom)
    hub = float(artefact.parameters["hub_diameter_mm"]) / 2.0
    in_dish = (radius > (1.0 + 1e-3) * hub) & (radius < rim.x_mm[0]) & (z > bottom) & (z < top)
    dish = np.column_stack([radius, z])[in_dish]
    return {
        **measure_toothing(loops[0], toothing.reference_radius_mm, toothing.calliper_teeth),
        "bore_diameter_mm": measure_bore(loops[-1]),
        "upper_tip_diameter_mm": 2.0 * float(radius[toothed & (z == top)].max()),
        "crown_radius_mm": fit_circle(_column(mesh, toothed, toothing.reference_radius_mm)),
        # A circle about the axis is symmetric about it.
        "dish_radius_mm": fit_circle(np.concatenate([dish, dish * [-1.0, 1.0]])),
        "face_width_mm": float(top) - bottom,
    }


def _crown(
    parameters: CurvedGearParameters, toothing: Toothing, where: str
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Radius of the crown, and scale and height of the sections."""
    width = parameters.face_width_mm
    lower = math.radians(parameters.lower_cone_angle_deg)
    upper = math.radians(parameters.upper_cone_angle_deg)
    if upper - lower < math.radians(1.0):
        expected = f"at least {parameters.lower_cone_angle_deg + 1.0:g}, one degree over the lower"
        raise InputError(f"{where}.upper_cone_angle_deg", expected, parameters.upper_cone_angle_deg)
    reference = toothing.reference_radius_mm
    radius = width / (math.sin(upper) - math.sin(lower))
    # The tips follow an arc that is stretched across the axis.
    stretched = radius * toothing.tip_radius_mm / reference
    step = math.sqrt(8.0 * (0.5e-3 * parameters.max_form_error_um) / stretched)
    lean = np.linspace(lower, upper, max(4, math.ceil((upper - lower) / step)) + 1)
    heights = radius * (np.sin(lean) - math.sin(upper))
    heights[0], heights[-1] = -width, 0.0  # to the last bit
    scales = 1.0 + radius * (np.cos(lean) - math.cos(lower)) / reference
    needed = parameters.hub_diameter_mm / 2.0 + 0.1 * parameters.module_mm
    if scales[-1] * toothing.root_radius_mm <= needed:
        least = 2.0 * needed
        expected = f"a smaller one: the hub needs a root circle of {least:.4g} mm at the top"
        raise InputError(f"{where}.face_width_mm", expected, width)
    return radius, scales, heights


def _dish(
    parameters: CurvedGearParameters, unit: NDArray[np.float64], rim_mm: float, where: str
) -> list[tuple[float, float]]:
    """Radius and height of the dish's rings, from the rim to the foot of the hub."""
    sphere = parameters.dish_radius_mm
    # Corners are on the sphere; they stand out of a ring's circle by this factor.
    corner = float(np.hypot(*unit[0]))
    if corner * rim_mm >= sphere:
        expected = f"more than the rim's inner radius of {rim_mm:.4g}"
        raise InputError(f"{where}.dish_radius_mm", expected, sphere)
    outer = math.asin(corner * rim_mm / sphere)
    inner = math.asin(corner * parameters.hub_diameter_mm / 2.0 / sphere)
    depth = sphere * (math.cos(inner) - math.cos(outer))
    if depth > 0.8 * parameters.face_width_mm:
        expected = f"a larger one: the dish of {depth:.4g} mm meets the lower face"
        raise InputError(f"{where}.dish_radius_mm", expected, sphere)
    step = math.sqrt(8.0 * (0.5e-3 * parameters.max_form_error_um) / sphere)
    polar = np.linspace(outer, inner, max(4, math.ceil((outer - inner) / step)) + 1)
    radii = sphere * np.sin(polar) / corner
    heights = sphere * (math.cos(outer) - np.cos(polar))
    heights[0] = 0.0
    return [(float(radius), float(z)) for radius, z in zip(radii, heights, strict=True)]


def _hub(parameters: CurvedGearParameters, where: str) -> list[tuple[float, float]]:
    """Radius and height of the rings of the hub's rounded edge."""
    rounding = parameters.hub_rounding_mm
    hub, top = parameters.hub_diameter_mm / 2.0, parameters.hub_height_mm
    flat = hub - parameters.bore_diameter_mm / 2.0
    most = min(top, flat - 0.05 * parameters.module_mm)
    if rounding > most:
        expected = f"at most {most:.4g}, within the hub's height and face"
        raise InputError(f"{where}.hub_rounding_mm", expected, rounding)
    step = math.sqrt(8.0 * (0.5e-3 * parameters.max_form_error_um) / rounding)
    angles = np.linspace(0.0, math.pi / 2.0, max(4, math.ceil(0.5 * math.pi / step)) + 1)
    radii = hub - rounding * (1.0 - np.cos(angles))
    heights = top - rounding * (1.0 - np.sin(angles))
    return [(float(radius), float(z)) for radius, z in zip(radii, heights, strict=True)]


def _close(
    shell: Shell,
    lower: Loop,
    hub: Loop,
    parameters: CurvedGearParameters,
    unit: NDArray[np.float64],
) -> None:
    """Close the hub's face, the bore and the lower face."""
    bore = parameters.bore_diameter_mm / 2.0 * unit
    upper_edge = shell.loop(bore, parameters.hub_height_mm)
    lower_edge = shell.loop(bore, -parameters.face_width_mm)
    shell.wall(hub, upper_edge)
    shell.wall(upper_edge, lower_edge)
    shell.ring(lower, lower_edge, up=False)


def _column(
    mesh: Mesh, toothed: NDArray[np.bool_], reference_radius_mm: float
) -> NDArray[np.float64]:
    """Radius and height of the points above one that is on the reference circle below."""
    x, y, z = mesh.vertices[toothed].T
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    on_circle = (z == z.min()) & (np.abs(radius - reference_radius_mm) < 1e-9 * radius)
    if not on_circle.any():
        return np.empty((0, 2))
    # Scaling keeps the angle, and a flank meets each angle once.
    above = np.abs(angle - angle[np.argmax(on_circle)]) < 1e-9
    return np.column_stack([radius, z])[above]


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(CurvedGearParameters, build_curved_gear, measure_curved_gear)
