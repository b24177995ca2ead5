"""A micro-scale gear as in a wrist watch: fine teeth, bore, hub, and a rough upper face.

After the gear of thesis ch. 8 (fig. 36 and 37), of which the thesis shows "the discontinuous
small teeth, the defined edge profile of the teeth, the curvature of the interior diameter of
the hub, and the surface roughness", without dimensions: these are ours.  Watch gears have
cycloidal teeth as a rule (NIHS 20-25); this one has the involutes of
:mod:`slbench.objects.gears.involute`, whose dimensions can be certified in closed form.

The faces that look up carry the height field of :mod:`slbench.objects.parts.roughness`, out to
their edges, on a grid of a quarter of its correlation length.  Mean and Ra are
integrals over the mesh: every face has its mean at its nominal height and exactly the Ra
asked for.

Object frame: that of :mod:`slbench.objects.gears.gear`.
"""

import math
from typing import Annotated

import numpy as np
import shapely
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import Interval, Length, NotNegative, Whole
from slbench.objects.artefact import Artefact, Mesh
from slbench.objects.gears.gear import (
    FormError,
    ToothedParameters,
    certified_body,
    certified_toothing,
    gear_features,
    toothing_in,
    toothing_of,
)
from slbench.objects.gears.gearmeasure import measure_bore, measure_toothing, section
from slbench.objects.gears.involute import Toothing, circle
from slbench.objects.mesh.planar import triangulated
from slbench.objects.mesh.shell import Loop, Shell
from slbench.objects.parts.roughness import mean_and_ra, rough_height
from slbench.objects.registry import ArtefactKind

#: Sides of the rough faces' grid in a correlation length: a Gaussian autocovariance then
#: leaves 5 % of the standard deviation (rms) between field and mesh, at the middle of a
#: square's diagonal, and less elsewhere.
_SIDES_PER_LENGTH = 4.0
#: Triangles of a rough face, at the most: 10 s to build.
_MOST_TRIANGLES = 3e6


class WatchGearParameters(ToothedParameters):
    """A watch gear.

    Parameters
    ----------
    face_width_mm : float
        Thickness of the toothed body.
    bore_rounding_mm : float
        Radius of the bore's upper edge.
    ra_um : float
        Arithmetic mean deviation of the faces that look up.
    correlation_length_um : float
        Distance at which their autocovariance has fallen to 1/e.
    seed : int
        Another seed, another surface.
    max_form_error_um : float
        Largest distance of the mesh from the smooth surface.
    """

    face_width_mm: Length
    bore_rounding_mm: Length
    ra_um: NotNegative = 0.8
    correlation_length_um: Annotated[float, Interval(ge=0.1, le=1e5)] = 20.0
    seed: Whole = 0
    max_form_error_um: FormError = 0.05


def build_watch_gear(parameters: WatchGearParameters, name: str, where: str) -> Artefact:
    """Build a watch gear.

    Parameters
    ----------
    parameters : WatchGearParameters
        Its size and roughness.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features of :func:`slbench.objects.gears.gear.build_gear`, whose planes are the
        means of rough faces; certified are the dimensions of :func:`measure_watch_gear`.

    Raises
    ------
    InputError
        If the toothing cannot be made, its parts do not fit each other, or the roughness is
        too fine or too high for the gear.
    """
    toothing = toothing_of(parameters, where)
    _check(parameters, toothing, where)
    limits = (1e-3 * parameters.max_form_error_um, _spacing_mm(parameters))
    outline = toothing.outline(*limits)
    rounding, top = parameters.bore_rounding_mm, parameters.hub_height_mm
    bore = parameters.bore_diameter_mm / 2.0
    opening = circle(bore + rounding, *limits)

    shell = Shell()
    lower = shell.loop(outline, -parameters.face_width_mm)
    if top > 0.0 and parameters.hub_diameter_mm is not None:
        hub = circle(parameters.hub_diameter_mm / 2.0, *limits)
        upper, foot = _rough_ring(shell, outline, hub, 0.0, parameters)
        hub_edge, mouth = _rough_ring(shell, hub, opening, top, parameters)
        shell.wall(foot, hub_edge)
    else:
        upper, mouth = _rough_ring(shell, outline, opening, 0.0, parameters)
    shell.wall(lower, upper)

    # Every ring of the rounding has the corners of the first.
    unit = opening / (bore + rounding)
    steps = max(4, math.ceil(0.5 * math.pi / math.sqrt(8.0 * limits[0] / rounding)))
    ring = mouth
    for angle in np.linspace(0.0, math.pi / 2.0, steps + 1)[1:]:
        radius = bore + rounding * (1.0 - math.sin(angle))
        following = shell.loop(radius * unit, top - rounding * (1.0 - math.cos(angle)))
        shell.wall(ring, following)
        ring = following
    bottom = shell.loop(bore * unit, -parameters.face_width_mm)
    shell.wall(ring, bottom)
    shell.ring(lower, bottom, up=False)

    features = gear_features(
        parameters.model_copy(update={"bore_diameter_mm": 2.0 * (bore + rounding)}),
        toothing.root_radius_mm,
    )
    return Artefact(
        name=name,
        kind="watch_gear",
        parameters=parameters.model_dump(),
        mesh=shell.mesh(),
        certified={
            **certified_toothing(toothing),
            **certified_body(parameters),
            "face_width_mm": parameters.face_width_mm,
            **{f"{face.name}_ra_um": parameters.ra_um for face in features},
        },
        features=features,
    )


def measure_watch_gear(artefact: Artefact) -> dict[str, float]:
    """Measure a watch gear on its mesh.

    Parameters
    ----------
    artefact : Artefact
        The gear; its parameters say where its faces end.

    Returns
    -------
    dict of str to float
        As :func:`slbench.objects.gears.gear.measure_gear`, at the lower face, with
        ``face_width_mm`` and ``hub_height_mm`` between mean planes; ``reference_ra_um`` and
        ``hub_ra_um`` about those planes.
    """
    toothing, mesh = toothing_in(artefact), artefact.mesh
    bottom = float(mesh.bounds[0, 2])
    loops = section(mesh, bottom)
    measured = {
        **measure_toothing(loops[0], toothing.reference_radius_mm, toothing.calliper_teeth),
        "bore_diameter_mm": measure_bore(loops[-1]),
    }
    levels = {}
    for plane, faces in _upward_faces(artefact).items():
        levels[plane], _ = mean_and_ra(mesh.vertices, faces)
        shifted = mesh.vertices - [0.0, 0.0, levels[plane]]
        measured[f"{plane}_ra_um"] = mean_and_ra(shifted, faces)[1]
    measured["face_width_mm"] = levels["reference"] - bottom
    if "hub" in levels:
        measured["hub_height_mm"] = levels["hub"] - levels["reference"]
    return measured


def _spacing_mm(parameters: WatchGearParameters) -> float:
    return 1e-3 * parameters.correlation_length_um / _SIDES_PER_LENGTH


def _check(parameters: WatchGearParameters, toothing: Toothing, where: str) -> None:
    """Refuse a roughness that the gear cannot carry, and a rounding without room."""
    rounding = parameters.bore_rounding_mm
    hub = parameters.hub_height_mm > 0.0
    depth = min([parameters.face_width_mm] + [parameters.hub_height_mm] * hub)
    if parameters.ra_um > 50.0 * depth:
        expected = f"at most {50.0 * depth:.4g}, a twentieth of the body's or the hub's height"
        raise InputError(f"{where}.ra_um", expected, parameters.ra_um)
    # Two triangles a square of the grid, over the whole tip circle.
    finest = math.sqrt(2.0 * math.pi * toothing.tip_radius_mm**2 / _MOST_TRIANGLES)
    if _spacing_mm(parameters) < finest:
        expected = f"at least {1e3 * finest * _SIDES_PER_LENGTH:.3g} for a gear of this size"
        raise InputError(
            f"{where}.correlation_length_um", expected, parameters.correlation_length_um
        )
    outer = 2.0 * toothing.root_radius_mm
    if hub and parameters.hub_diameter_mm is not None:
        outer = parameters.hub_diameter_mm
    room = (outer - parameters.bore_diameter_mm) / 2.0 - 0.1 * parameters.module_mm
    most = min(room, 0.5 * parameters.face_width_mm)
    if rounding > most:
        expected = f"at most {most:.4g}, within the face and half the thickness"
        raise InputError(f"{where}.bore_rounding_mm", expected, rounding)


def _rough_ring(
    shell: Shell,
    outer: NDArray[np.float64],
    inner: NDArray[np.float64],
    level_mm: float,
    parameters: WatchGearParameters,
) -> tuple[Loop, Loop]:
    """Add a rough face between two outlines and return its borders."""
    region = shapely.Polygon(outer, [inner])
    places, triangles, _ = triangulated([outer, inner], [region], _spacing_mm(parameters))
    z = np.zeros(len(places))
    if parameters.ra_um > 0.0:
        x, y = places.T
        z = rough_height(x, y, parameters.ra_um, parameters.correlation_length_um, parameters.seed)
        # Of its points so far; of the mesh from here on.
        z -= mean_and_ra(np.column_stack([places, z]), triangles)[0]
        z *= parameters.ra_um / mean_and_ra(np.column_stack([places, z]), triangles)[1]
    numbers = shell.vertices(np.column_stack([places, level_mm + z]))
    shell.faces(numbers[triangles])
    return numbers[: len(outer)], numbers[len(outer) : len(outer) + len(inner)]


def _upward_faces(artefact: Artefact) -> dict[str, NDArray[np.int64]]:
    """Faces of the reference, and of the hub where there is one."""
    mesh, parameters = artefact.mesh, artefact.parameters
    upward = mesh.faces[_looks_up(mesh)]
    corners = mesh.vertices[upward]
    radius = np.hypot(corners[:, :, 0], corners[:, :, 1]).mean(axis=1)
    # The rounding of the bore looks up, too; it begins within this circle.
    bore = float(parameters["bore_diameter_mm"]) / 2.0 + float(parameters["bore_rounding_mm"])
    flat = (radius > bore) & (corners[:, :, 2].min(axis=1) > -parameters["face_width_mm"] / 2.0)
    if parameters["hub_height_mm"] == 0.0:
        return {"reference": upward[flat]}
    high = corners[:, :, 2].mean(axis=1) > parameters["hub_height_mm"] / 2.0
    return {"reference": upward[flat & ~high], "hub": upward[flat & high]}


def _looks_up(mesh: Mesh) -> NDArray[np.bool_]:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces][:, :, :2], 1, 0)
    first, second = b - a, c - a
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return area > 1e-9 * area.max()


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(WatchGearParameters, build_watch_gear, measure_watch_gear)
