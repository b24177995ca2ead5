"""An involute spur gear with bore and, if wanted, a hub.

The profile is :mod:`slbench.objects.gears.involute`'s; bore and hub are regular polygons with the
area of their circle.  The thesis's gears are printed parts without published dimensions;
those here are ours.

Object frame: the axis is z, the middle of a tooth is on +x.  z = 0 on the upper face of the
toothed body (the reference), its lower face at ``-face_width_mm``; the hub stands up from the
reference to ``hub_height_mm``.
"""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length, NotNegative, Share
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature
from slbench.objects.gears.gearmeasure import (
    layer_below,
    measure_bore,
    measure_face_width,
    measure_toothing,
    section,
)
from slbench.objects.gears.involute import Toothing, circle
from slbench.objects.mesh.shell import Loop, Shell
from slbench.objects.registry import ArtefactKind

#: Largest distance of a mesh from the true surface, um.
FormError = Annotated[float, Interval(ge=1e-3, le=1e3)]


class ToothedParameters(Parameters):
    """Toothing, bore and hub, for every kind of gear.

    Parameters
    ----------
    module_mm : float
        Reference (pitch) diameter over number of teeth, in the transverse plane.
    teeth : int
        Number of teeth.
    pressure_angle_deg : float
        At the reference circle, in the transverse plane.
    profile_shift : float
        Distance of the generating rack from the reference circle, in modules.
    backlash_mm : float
        What is taken off the teeth's thickness, as an arc of the reference circle.
    root_fillet : float
        Tip radius of the generating rack, in modules; it makes the root fillet.
    bore_diameter_mm : float
        Diameter of the bore, all through.
    hub_diameter_mm : float
        Diameter of the hub; without effect if its height is zero.
    hub_height_mm : float
        Height of the hub above the toothed body; zero: no hub.
    max_form_error_um : float
        Largest distance of the mesh from the true surface; at most a fiftieth of the module.
    """

    module_mm: Length
    teeth: Annotated[int, Interval(ge=5, le=500)]
    pressure_angle_deg: Annotated[float, Interval(ge=10.0, le=35.0)] = 20.0
    profile_shift: Annotated[float, Interval(ge=-0.8, le=0.8)] = 0.0
    backlash_mm: NotNegative = 0.0
    root_fillet: Share = 0.38
    bore_diameter_mm: Length
    hub_diameter_mm: Length | None = None
    hub_height_mm: Annotated[float, Interval(ge=0.0, le=1e4)] = 0.0
    max_form_error_um: FormError = 0.5


class GearParameters(ToothedParameters):
    """A spur gear.

    Parameters
    ----------
    face_width_mm : float
        Thickness of the toothed body.
    """

    face_width_mm: Length


def build_gear(parameters: GearParameters, name: str, where: str) -> Artefact:
    """Build a spur gear.

    Parameters
    ----------
    parameters : GearParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features ``reference`` (a rectangle of the upper face, between hub and root
        circle, on the +x side) and, with a hub, ``hub`` (of its face); certified are the
        dimensions of :func:`measure_gear`.

    Raises
    ------
    InputError
        If the toothing cannot be made, or bore, hub and root circle do not fit each other.
    """
    toothing = toothing_of(parameters, where)
    error = 1e-3 * parameters.max_form_error_um
    outline = toothing.outline(error)
    shell = Shell()
    lower = shell.loop(outline, -parameters.face_width_mm)
    upper = shell.loop(outline, 0.0)
    shell.wall(lower, upper)
    close_with_bore(shell, lower, upper, parameters, error)
    return Artefact(
        name=name,
        kind="gear",
        parameters=parameters.model_dump(),
        mesh=shell.mesh(),
        certified={
            **certified_toothing(toothing),
            **certified_body(parameters),
            "face_width_mm": parameters.face_width_mm,
        },
        features=gear_features(parameters, toothing.root_radius_mm),
    )


def measure_gear(artefact: Artefact) -> dict[str, float]:
    """Measure a gear's toothing, bore and width on its mesh.

    Parameters
    ----------
    artefact : Artefact
        A gear of constant transverse profile; its parameters say at which circle its teeth
        are measured, and over how many.

    Returns
    -------
    dict of str to float
        ``tip_diameter_mm, root_diameter_mm, chordal_tooth_thickness_mm`` (at the reference
        circle), ``base_tangent_over_K_teeth_mm`` and ``bore_diameter_mm``, of the section
        through the layer of vertices next below half the face width; ``face_width_mm``.
    """
    toothing = toothing_in(artefact)
    mesh = artefact.mesh
    width = measure_face_width(mesh, toothing.reference_radius_mm)
    # Between layers of vertices the section is one of chords.
    loops = section(mesh, layer_below(mesh, float(mesh.bounds[0, 2]) + width / 2.0))
    return {
        **measure_toothing(loops[0], toothing.reference_radius_mm, toothing.calliper_teeth),
        "bore_diameter_mm": measure_bore(loops[-1]),
        "face_width_mm": width,
    }


def toothing_of(parameters: ToothedParameters, where: str) -> Toothing:
    """Return the toothing that parameters describe, checked against bore and hub.

    Raises
    ------
    InputError
        If it cannot be made, bore, hub and root circle leave less than 0.1 modules, or the
        form error is coarse enough to join them.
    """
    if parameters.max_form_error_um > 20.0 * parameters.module_mm:
        expected = f"at most {20.0 * parameters.module_mm:.4g}, a fiftieth of the module"
        raise InputError(f"{where}.max_form_error_um", expected, parameters.max_form_error_um)
    toothing = Toothing(
        module_mm=parameters.module_mm,
        teeth=parameters.teeth,
        pressure_angle=math.radians(parameters.pressure_angle_deg),
        profile_shift=parameters.profile_shift,
        backlash_mm=parameters.backlash_mm,
        root_fillet=parameters.root_fillet,
        where=where,
    )
    if 0.0 < parameters.hub_height_mm < 1e-3:
        raise InputError(f"{where}.hub_height_mm", "0 or at least 0.001", parameters.hub_height_mm)
    wall = 0.1 * parameters.module_mm
    room = 2.0 * (toothing.root_radius_mm - wall)
    outer = f"the root circle of {2.0 * toothing.root_radius_mm:.6g} mm"
    if parameters.hub_height_mm > 0.0:
        hub = parameters.hub_diameter_mm
        if hub is None or hub > room:
            expected = f"at most {room:.6g} mm, within {outer}"
            raise InputError(f"{where}.hub_diameter_mm", expected, hub or "none")
        room, outer = hub - 2.0 * wall, f"the hub of {hub:.6g} mm"
    if parameters.bore_diameter_mm > room:
        expected = f"at most {room:.6g} mm, within {outer}"
        raise InputError(f"{where}.bore_diameter_mm", expected, parameters.bore_diameter_mm)
    return toothing


def close_with_bore(
    shell: Shell, lower: Loop, upper: Loop, parameters: ToothedParameters, error_mm: float
) -> None:
    """Close a toothed body at its lower end and at z = 0, with its bore and hub."""
    bore = circle(parameters.bore_diameter_mm / 2.0, error_mm)
    face = upper
    if parameters.hub_height_mm > 0.0 and parameters.hub_diameter_mm is not None:
        hub = circle(parameters.hub_diameter_mm / 2.0, error_mm)
        foot = shell.loop(hub, 0.0)
        shell.ring(upper, foot, up=True)
        face = shell.loop(hub, parameters.hub_height_mm)
        shell.wall(foot, face)
    bore_top = shell.loop(bore, parameters.hub_height_mm)
    bore_bottom = shell.loop(bore, shell.height(lower))
    shell.ring(face, bore_top, up=True)
    shell.wall(bore_top, bore_bottom)
    shell.ring(lower, bore_bottom, up=False)


def certified_toothing(toothing: Toothing) -> dict[str, float]:
    """Return the nominal dimensions of a toothing, by the keys that it is measured under."""
    certified = {
        "tip_diameter_mm": 2.0 * toothing.tip_radius_mm,
        "root_diameter_mm": 2.0 * toothing.root_radius_mm,
        "chordal_tooth_thickness_mm": toothing.chordal_thickness_mm,
    }
    teeth = toothing.calliper_teeth
    if teeth is not None:
        certified[f"base_tangent_over_{teeth}_teeth_mm"] = toothing.base_tangent_mm(teeth)
    return certified


def certified_body(parameters: ToothedParameters) -> dict[str, float]:
    """Return the nominal dimensions of bore and hub."""
    certified = {"bore_diameter_mm": parameters.bore_diameter_mm}
    if parameters.hub_height_mm > 0.0:
        certified["hub_height_mm"] = parameters.hub_height_mm
    return certified


def gear_features(parameters: ToothedParameters, rim_radius_mm: float) -> tuple[PlaneFeature, ...]:
    """Return the flat faces of a gear: ``reference``, and ``hub`` where there is one."""
    bore = parameters.bore_diameter_mm / 2.0
    if parameters.hub_height_mm == 0.0 or parameters.hub_diameter_mm is None:
        return (ring_feature(REFERENCE, 0.0, bore, rim_radius_mm),)
    hub = parameters.hub_diameter_mm / 2.0
    return (
        ring_feature(REFERENCE, 0.0, hub, rim_radius_mm),
        ring_feature("hub", parameters.hub_height_mm, bore, hub),
    )


def ring_feature(
    name: str, height_mm: float, inner_radius_mm: float, outer_radius_mm: float
) -> PlaneFeature:
    """Return a rectangle of a flat ring about the axis, on its +x side.

    Its corners stay 15 % of the ring's width away from both circles, for the reason given in
    :mod:`slbench.objects.shapes.stepblock`.
    """
    width = outer_radius_mm - inner_radius_mm
    near, far, half = inner_radius_mm + 0.15 * width, outer_radius_mm - 0.15 * width, width / 4.0
    x = (near, math.sqrt(far**2 - half**2))
    return PlaneFeature(name, height_mm, height_mm, x, (-half, half))


def turned(outline_mm: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Return an outline, (n, 2), turned about the axis."""
    c, s = math.cos(angle), math.sin(angle)
    return outline_mm @ np.array([[c, s], [-s, c]])


def toothing_in(artefact: Artefact) -> Toothing:
    """Return the toothing that an artefact was built with."""
    known = ToothedParameters.model_fields
    values = {key: value for key, value in artefact.parameters.items() if key in known}
    return toothing_of(ToothedParameters.model_validate(values), artefact.name)


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(GearParameters, build_gear, measure_gear)
