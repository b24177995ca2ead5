"""A propeller: twisted slender blades with small holes around a hub with a bore.

The thesis measures one of four slender blades with evenly distributed small holes (thesis
fig. 14b) and one of three (thesis fig. 17); both are thin, curved, and full of edges.

A blade's sections lie on cylinders about the axis, as a marine propeller is drawn: at radius
r a section of chord c is inclined by the pitch angle ``atan(P / 2 pi r)`` of a helicoid of
constant pitch P and wrapped around the cylinder.  Chord and thickness taper linearly from
the hub to the tip.  The section is a symmetric airfoil (Abbott and von Doenhoff, *Theory of
Wing Sections*, eq. 6.2, the last coefficient -0.1036 so that the trailing edge closes), or a
plate with rounded edges.

Object frame: z along the axis, the hub's top face, which is the reference face, at z = 0
and its bottom at z = -hub_height_mm; the first blade points along +x.
"""

import math
from typing import Annotated, Literal

import manifold3d
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length
from slbench.objects.artefact import REFERENCE, Artefact, Mesh, PlaneFeature
from slbench.objects.mesh.booleans import cylinder, to_mesh, to_solid
from slbench.objects.mesh.circles import FormError, measure_circle
from slbench.objects.registry import ArtefactKind

Array = NDArray[np.float64]

#: Sections along a blade, and stations along a chord: facets of about half a millimetre on
#: a blade of 25 mm, with a normal that turns by less than 2 degrees from one to the next.
_SECTIONS = 49
_STATIONS = 27

#: Share of the spacing of the holes that a hole may take; the rest is wall.
_HOLE_SHARE = 0.8


class PropellerParameters(Parameters):
    """Size of a propeller.

    Parameters
    ----------
    blades : int
        Number of blades.
    tip_diameter_mm : float
        Diameter of the cylinder that the tips end on.
    hub_diameter_mm, hub_height_mm, bore_diameter_mm : float
        The hub, and the hole along its axis.
    pitch_mm : float
        Advance of the helicoid in a turn: what twists the blades.
    root_chord_mm, tip_chord_mm : float
        Width of a blade at the hub and at the tip.
    root_thickness_mm, tip_thickness_mm : float
        Thickness of a blade at the hub and at the tip.
    section : str
        ``"airfoil"`` or ``"plate"``.
    holes_along, holes_across : int
        Holes through each blade along its span and its chord, at equal spacing.
    hole_diameter_mm : float
        Their diameter; they are drilled parallel to the axis.
    max_form_error_um : float
        Largest distance of hub, bore and holes from true cylinders.
    """

    blades: Annotated[int, Interval(ge=2, le=24)]
    tip_diameter_mm: Length
    hub_diameter_mm: Length
    hub_height_mm: Length
    bore_diameter_mm: Length
    pitch_mm: Length
    root_chord_mm: Length
    tip_chord_mm: Length
    root_thickness_mm: Length
    tip_thickness_mm: Length
    section: Literal["airfoil", "plate"] = "airfoil"
    holes_along: Annotated[int, Interval(ge=0, le=50)] = 6
    holes_across: Annotated[int, Interval(ge=1, le=10)] = 1
    hole_diameter_mm: Length = 1.0
    max_form_error_um: FormError = 0.5


def build_propeller(parameters: PropellerParameters, name: str, where: str) -> Artefact:
    """Build a propeller.

    Parameters
    ----------
    parameters : PropellerParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        Of the parts ``hub`` and ``blades``, with the feature ``reference``, a patch of the
        hub's top face; certified are the diameters of tips and bore, the height of the hub
        and the number of blades.

    Raises
    ------
    InputError
        If the bore leaves no hub, the blades no tip, or they stand out above or below the
        hub, meet at its surface, are thicker than wide or too small for the holes.
    """
    p = parameters
    _check_hub(p, where)
    blade = _blade(p, where)
    hub = cylinder(p.hub_diameter_mm / 2, -p.hub_height_mm, 0.0, p.max_form_error_um)
    bore = _through(p, p.bore_diameter_mm)
    shape = to_solid(blade)
    drill = _through(p, p.hole_diameter_mm)
    owners = {body.original_id(): "hub" for body in (hub, bore)}
    owners |= {body.original_id(): "blades" for body in (shape, drill)}

    centres = _hole_centres(p, where)
    if len(centres):
        holes = [drill.translate([x, y, 0.0]) for x, y in centres]
        shape = shape - manifold3d.Manifold.batch_boolean(holes, manifold3d.OpType.Add)
    turns = [shape.rotate([0.0, 0.0, 360.0 * k / p.blades]) for k in range(p.blades)]
    solid = manifold3d.Manifold.batch_boolean([hub, *turns], manifold3d.OpType.Add) - bore
    mesh, parts = to_mesh(solid, owners)
    return Artefact(
        name=name,
        kind="propeller",
        parameters=p.model_dump(),
        mesh=mesh,
        certified={
            "tip_diameter_mm": p.tip_diameter_mm,
            "hub_height_mm": p.hub_height_mm,
            "bore_diameter_mm": p.bore_diameter_mm,
            "blade_count": float(p.blades),
            "reference_flatness_um": 0.0,
        },
        features=(_reference(p),),
        parts=parts,
    )


def measure_propeller(artefact: Artefact) -> dict[str, float]:
    """Measure a propeller's dimensions back from its mesh.

    Parameters
    ----------
    artefact : Artefact
        The propeller.

    Returns
    -------
    dict of str to float
        ``tip_diameter_mm``, of the smallest cylinder about the axis that holds it;
        ``bore_diameter_mm``, of the circle with the area of the rim in the top face;
        ``hub_height_mm``, between the faces with that rim; ``blade_count``, the separate
        end faces on the tip cylinder.
    """
    mesh = artefact.mesh
    radius = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    low, high = mesh.bounds[:, 2]
    on_top = mesh.vertices[:, 2] == high
    bore = on_top & (radius < radius[on_top].mean())
    at_tip = radius > radius.max() - 1e-6
    ends = mesh.faces[at_tip[mesh.faces].all(axis=1)]
    edges = np.concatenate([ends[:, [0, 1]], ends[:, [1, 2]]])
    shape = (len(radius), len(radius))
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=shape)
    _, label = connected_components(graph, directed=False)
    return {
        "tip_diameter_mm": 2.0 * float(radius.max()),
        "bore_diameter_mm": measure_circle(mesh.vertices[bore, :2])[1],
        "hub_height_mm": float(high - low),
        "blade_count": float(len(np.unique(label[at_tip]))),
    }


def _check_hub(p: PropellerParameters, where: str) -> None:
    if p.hub_diameter_mm < p.bore_diameter_mm + 2e-3:
        expected = f"less than the hub's {p.hub_diameter_mm:g}"
        raise InputError(f"{where}.bore_diameter_mm", expected, p.bore_diameter_mm)
    if p.tip_diameter_mm < p.hub_diameter_mm + 2e-3:
        expected = f"more than the hub's {p.hub_diameter_mm:g}"
        raise InputError(f"{where}.tip_diameter_mm", expected, p.tip_diameter_mm)
    for end in ("root", "tip"):
        chord, thickness = getattr(p, f"{end}_chord_mm"), getattr(p, f"{end}_thickness_mm")
        if thickness >= chord:
            expected = f"less than the chord's {chord:g}"
            raise InputError(f"{where}.{end}_thickness_mm", expected, thickness)


def _through(p: PropellerParameters, diameter: float) -> manifold3d.Manifold:
    """Cylinder about the axis that goes clear through the hub."""
    past = 0.5 * p.hub_height_mm
    return cylinder(diameter / 2, -p.hub_height_mm - past, past, p.max_form_error_um)


def _taper(p: PropellerParameters, radius: Array) -> tuple[Array, Array, Array]:
    """Chord, thickness and pitch angle at some radii; the root's size holds inside the hub."""
    hub, tip = p.hub_diameter_mm / 2, p.tip_diameter_mm / 2
    share = np.clip((radius - hub) / (tip - hub), 0.0, 1.0)
    chord = p.root_chord_mm + share * (p.tip_chord_mm - p.root_chord_mm)
    thickness = p.root_thickness_mm + share * (p.tip_thickness_mm - p.root_thickness_mm)
    return chord, thickness, np.arctan(p.pitch_mm / (2.0 * math.pi * radius))


def _half_section(section: str, chord: Array, thickness: Array) -> tuple[Array, Array]:
    """Stations from one edge to the other and half thicknesses there, (sections, n), mm."""
    if section == "airfoil":
        x = 0.5 - 0.5 * np.cos(math.pi * np.linspace(0.0, 1.0, _STATIONS + 1))
        polynomial = x * (-0.1260 + x * (-0.3516 + x * (0.2843 - 0.1036 * x)))
        half = 5.0 * (0.2969 * np.sqrt(x) + polynomial)
        half[-1] = 0.0  # the coefficients add up to 0 but for rounding
        return (x - 0.5) * chord[:, None], half * thickness[:, None]
    # A third of the stations on each rounded edge, the others on the flats between.
    third = _STATIONS // 3
    turn = 0.5 * math.pi * np.arange(third + 1) / third
    edge = 0.5 * thickness[:, None] * (1.0 - np.cos(turn)) - 0.5 * chord[:, None]
    flat = (0.5 * (chord - thickness))[:, None] * np.linspace(-1.0, 1.0, third + 1)[1:-1]
    rise = np.concatenate([np.sin(turn), np.ones(third - 1), np.sin(turn)[::-1]])
    stations = np.concatenate([edge, flat, -edge[:, ::-1]], axis=1)
    rise[[0, -1]] = 0.0
    return stations, 0.5 * thickness[:, None] * rise


def _blade(p: PropellerParameters, where: str) -> Mesh:
    """Loft the blade along +x, its root buried in the hub."""
    hub, tip = p.hub_diameter_mm / 2, p.tip_diameter_mm / 2
    root = 0.5 * (hub + p.bore_diameter_mm / 2)
    # The hub's surface falls between two sections: one within the polygon's form error of
    # it would cut slivers.
    inset = 0.5 * min((tip - hub) / _SECTIONS, hub - root)
    radius = np.concatenate([[root], np.linspace(hub - inset, tip, _SECTIONS - 1)])
    chord, thickness, angle = _taper(p, radius)
    along, half = _half_section(p.section, chord, thickness)
    # Once around: the upper side from one edge to the other, the lower side back.
    s = np.concatenate([along, along[:, -2:0:-1]], axis=1)
    t = np.concatenate([half, -half[:, -2:0:-1]], axis=1)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    around = (s * cosine - t * sine) / radius[:, None]
    height = s * sine + t * cosine
    if np.abs(height).max() >= 0.5 * p.hub_height_mm:
        expected = f"more than {2.0 * np.abs(height).max():.4g}, for the blades to end on the hub"
        raise InputError(f"{where}.hub_height_mm", expected, p.hub_height_mm)
    widest = float(np.ptp(around[1:], axis=1).max())
    if widest >= 2.0 * math.pi / p.blades:
        expected = f"at most {int(2.0 * math.pi / widest)} blades of this chord around the hub"
        raise InputError(f"{where}.blades", expected, p.blades)
    z = height - 0.5 * p.hub_height_mm
    x, y = radius[:, None] * np.cos(around), radius[:, None] * np.sin(around)
    return _loft(np.stack([x, y, z], axis=-1))


def _loft(rings: NDArray[np.float64]) -> Mesh:
    """Skin rings of points, (sections, 2 n, 3); the ends are strips from edge to edge."""
    count, size = rings.shape[:2]
    index = np.arange(count * size).reshape(count, size)
    a, b = index[:-1], np.roll(index[:-1], -1, axis=1)
    c, d = index[1:], np.roll(index[1:], -1, axis=1)
    # Seen from the tip a ring runs clockwise, over the upper side first.
    skin = np.stack([a, d, b, a, c, d], axis=-1).reshape(-1, 3)
    half = size // 2
    i = np.arange(1, half - 1)
    strip = np.concatenate(
        [
            [[0, 1, size - 1], [half - 1, half, half + 1]],
            np.stack([i, i + 1, size - i], axis=1),
            np.stack([i + 1, size - i - 1, size - i], axis=1),
        ]
    )
    faces = np.concatenate([skin, strip, strip[:, ::-1] + index[-1, 0]])
    return Mesh(rings.reshape(-1, 3), faces)


def _hole_centres(p: PropellerParameters, where: str) -> NDArray[np.float64]:
    """Centres (x, y) of the holes of the first blade, (n, 2), mm."""
    if p.holes_along == 0:
        return np.empty((0, 2))
    hub, tip = p.hub_diameter_mm / 2, p.tip_diameter_mm / 2
    radius = hub + (tip - hub) * (np.arange(p.holes_along) + 0.5) / p.holes_along
    chord, _, angle = _taper(p, radius)
    seen = chord * np.cos(angle)  # the width of the blade from above
    spacing = min((tip - hub) / p.holes_along, float(seen.min()) / p.holes_across)
    if p.hole_diameter_mm > _HOLE_SHARE * spacing:
        expected = f"at most {_HOLE_SHARE * spacing:.4g}, for walls between {p.holes_along} x "
        expected += f"{p.holes_across} holes in a blade"
        raise InputError(f"{where}.hole_diameter_mm", expected, p.hole_diameter_mm)
    offset = (np.arange(p.holes_across) + 0.5) / p.holes_across - 0.5
    around = offset * seen[:, None] / radius[:, None]
    x, y = radius[:, None] * np.cos(around), radius[:, None] * np.sin(around)
    return np.stack([x, y], axis=-1).reshape(-1, 2)


def _reference(p: PropellerParameters) -> PlaneFeature:
    """Rectangle within the ring of the hub's top face, beside the bore on +x."""
    inner, outer = p.bore_diameter_mm / 2, p.hub_diameter_mm / 2
    ring = outer - inner
    far = inner + 0.7 * ring
    side = math.sqrt((outer - 0.15 * ring) ** 2 - far**2)
    return PlaneFeature(REFERENCE, 0.0, 0.0, (inner + 0.15 * ring, far), (-side, side))


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(PropellerParameters, build_propeller, measure_propeller)
