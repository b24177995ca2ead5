"""A double-helical (herringbone) gear: two mirrored helical halves of one profile.

The transverse profile is :mod:`slbench.objects.gears.involute`'s; the module and the pressure angle
are those of the transverse plane.  Layers of it stand turned by exactly
``tan(helix angle) / reference radius`` a millimetre, right-handed above the middle and
left-handed below, so that the lead is ``2 pi r / tan(helix angle)``.  The thesis measures a
printed double-helical gear (thesis ch. 7, fig. 17) without stating its size; this one is ours.

The mesh keeps its form error as the sum of three: a quarter for chords across the teeth, a
quarter for chords along them, and a half for the diagonals of the patches between.  A patch
of sides a and b whose chords err by ``a^2 / 8 rho`` and ``b^2 / 8 r`` is out of plane by at
most ``a b / 4 r``, which is twice their geometric mean where the flank's radius of curvature
rho does not exceed the radius r.

Object frame: that of :mod:`slbench.objects.gears.gear`, z = 0 on the upper face of the toothed
body; the middle of a tooth is on +x at half the face width, where the halves meet.
"""

import math
from typing import Annotated

import numpy as np

from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import Artefact
from slbench.objects.gears.gear import (
    FormError,
    ToothedParameters,
    certified_body,
    certified_toothing,
    close_with_bore,
    gear_features,
    measure_gear,
    toothing_in,
    toothing_of,
    turned,
)
from slbench.objects.gears.gearmeasure import measure_leads
from slbench.objects.mesh.shell import Shell
from slbench.objects.registry import ArtefactKind


class HelicalGearParameters(ToothedParameters):
    """A double-helical gear.

    Parameters
    ----------
    face_width_mm : float
        Thickness of the toothed body, both halves.
    helix_angle_deg : float
        Between tooth and axis, at the reference circle.
    max_form_error_um : float
        Largest distance of the mesh from the true surface.
    """

    face_width_mm: Length
    helix_angle_deg: Annotated[float, Interval(ge=1.0, le=45.0)] = 30.0
    max_form_error_um: FormError = 1.0


def build_helical_gear(parameters: HelicalGearParameters, name: str, where: str) -> Artefact:
    """Build a double-helical gear.

    Parameters
    ----------
    parameters : HelicalGearParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features of :func:`slbench.objects.gears.gear.build_gear`; certified are the
        dimensions of :func:`measure_helical_gear`.

    Raises
    ------
    InputError
        If the toothing cannot be made, or bore, hub and root circle do not fit each other.
    """
    toothing = toothing_of(parameters, where)
    error = 1e-3 * parameters.max_form_error_um
    outline = toothing.outline(error / 4.0)
    width = parameters.face_width_mm
    slope = math.tan(math.radians(parameters.helix_angle_deg)) / toothing.reference_radius_mm
    # Sag of a helix at the tip circle, seen along the axis: r (turn of a layer)^2 / 8.
    layer_turn = math.sqrt(8.0 * (error / 4.0) / toothing.tip_radius_mm)
    layers = math.ceil(slope * width / 2.0 / layer_turn)

    shell = Shell()
    heights = np.linspace(-width, 0.0, 2 * layers + 1)
    turns = slope * np.abs(heights + width / 2.0)
    loops = [shell.loop(turned(outline, turn), z) for turn, z in zip(turns, heights, strict=True)]
    for layer in range(2 * layers):
        # One half is the mirror image of the other, down to the diagonals.
        shell.wall(loops[layer], loops[layer + 1], mirrored=layer < layers)
    close_with_bore(shell, loops[0], loops[-1], parameters, error)
    lead = 2.0 * math.pi / slope
    return Artefact(
        name=name,
        kind="double_helical_gear",
        parameters=parameters.model_dump(),
        mesh=shell.mesh(),
        certified={
            **certified_toothing(toothing),
            **certified_body(parameters),
            "face_width_mm": width,
            "lower_lead_mm": -lead,
            "upper_lead_mm": lead,
        },
        features=gear_features(parameters, toothing.root_radius_mm),
    )


def measure_helical_gear(artefact: Artefact) -> dict[str, float]:
    """Measure a double-helical gear on its mesh.

    Parameters
    ----------
    artefact : Artefact
        The gear.

    Returns
    -------
    dict of str to float
        As :func:`slbench.objects.gears.gear.measure_gear`, in the transverse plane where the halves
        meet; ``lower_lead_mm`` and ``upper_lead_mm``, right-handed positive.
    """
    lower, upper = measure_leads(artefact.mesh, toothing_in(artefact).reference_radius_mm)
    return {**measure_gear(artefact), "lower_lead_mm": lower, "upper_lead_mm": upper}


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(HelicalGearParameters, build_helical_gear, measure_helical_gear)
