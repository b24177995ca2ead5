"""A scaled V6 engine block: two banks of three bores in flat decks, webs and a crank tunnel.

The thesis measures a 3-D printed scaled model of one (thesis fig. 17); the edges of its six
cylinders are where patterns differ most (thesis fig. 22c).  Deep bores that light hardly
reaches, inclined flats, and steep outer walls make it the hardest of the macro objects.

The block is a profile drawn out along the crank axis: a crankcase with vertical walls, two
banks inclined by half the bank angle to either side, and a flat valley between them.  Bores
run square to the decks into three crankcase bays, open below; the webs between the bays
carry the crank tunnel.  The banks are staggered, as two rods share a crank pin.

Object frame: y along the crank axis, the origin in the middle of the valley floor, which is
the reference face at z = 0; z up.
"""

import math
from dataclasses import dataclass
from typing import Annotated

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
from slbench.objects.mesh.solids import prism
from slbench.objects.registry import ArtefactKind

#: Bores in a bank of a V6.
_BORES = 3


class EngineBlockParameters(Parameters):
    """Size of an engine block.

    Parameters
    ----------
    bank_angle_deg : float
        Angle between the banks' bore axes.
    bore_diameter_mm : float
        Diameter of the bores.
    bore_spacing_mm : float
        Distance of neighbouring bores' axes in a bank.
    stagger_mm : float
        Offset of the right bank (+x) along the crank from the left one.
    deck_distance_mm : float
        Distance of the decks from the crank axis.
    deck_width_mm : float
        Width of a deck, square to the crank axis.
    valley_width_mm : float
        Width of the flat floor between the banks.
    crankcase_width_mm : float
        Distance of the crankcase's outer walls.
    skirt_mm : float
        Depth of the crankcase below the crank axis.
    tunnel_diameter_mm : float
        Diameter of the crank tunnel.
    wall_mm : float
        Thickness of the webs and the crankcase's walls, and the least around the bores and
        under the valley.
    margin_fraction : float
        Distance of the reference's interior from the floor's edges, as a share of its width.
    max_form_error_um : float
        Largest distance of bores and tunnel from true cylinders.
    """

    bank_angle_deg: Annotated[float, Interval(ge=40.0, le=120.0)]
    bore_diameter_mm: Length
    bore_spacing_mm: Length
    stagger_mm: Annotated[float, Interval(ge=0.0, le=1e4)]
    deck_distance_mm: Length
    deck_width_mm: Length
    valley_width_mm: Length
    crankcase_width_mm: Length
    skirt_mm: Length
    tunnel_diameter_mm: Length
    wall_mm: Length
    margin_fraction: Annotated[float, Interval(ge=0.0, le=0.45)] = 0.15
    max_form_error_um: FormError = 0.5


def build_engine_block(parameters: EngineBlockParameters, name: str, where: str) -> Artefact:
    """Build an engine block.

    Parameters
    ----------
    parameters : EngineBlockParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        Of the parts ``casting``, ``decks`` and ``bores`` (as cast, milled and honed), with
        the feature ``reference``, the valley's floor.  Certified are the bores' diameter
        and spacing, the bank angle and the length of the block.

    Raises
    ------
    InputError
        If the parts of the block do not leave each other a wall.
    """
    p = parameters
    section = _Section.of(p)
    _check(p, section, where)
    length = _BORES * p.bore_spacing_mm + p.wall_mm
    past = 0.5 * length + 1.0

    casting = to_solid(prism(section.profile, length))
    bay = _bay(p, section)
    tunnel = cylinder(p.tunnel_diameter_mm / 2, -past, past, p.max_form_error_um)
    # The crank axis lies along y; the reference is as far above it as the valley.
    line_bored = tunnel.rotate([90.0, 0.0, 0.0]).translate([0.0, 0.0, -section.valley])
    bore = cylinder(p.bore_diameter_mm / 2, 0.0, p.deck_distance_mm + 1.0, p.max_form_error_um)
    half_angle = p.bank_angle_deg / 2
    places = p.bore_spacing_mm * (np.arange(_BORES) - (_BORES - 1) / 2)
    cuts = [line_bored] + [bay.translate([0.0, y, 0.0]) for y in places]
    for side in (-1.0, 1.0):
        inclined = bore.rotate([0.0, side * half_angle, 0.0])
        offset = 0.5 * side * p.stagger_mm
        cuts += [inclined.translate([0.0, y + offset, -section.valley]) for y in places]
    solid = casting - manifold3d.Manifold.batch_boolean(cuts, manifold3d.OpType.Add)
    owners = {body.original_id(): "casting" for body in (casting, bay, tunnel)}
    mesh, parts = to_mesh(solid, {**owners, bore.original_id(): "bores"})
    decks = _deck_faces(mesh, parts["casting"], section)
    parts = {
        "casting": np.setdiff1d(parts["casting"], decks),
        "decks": decks,
        "bores": parts["bores"],
    }

    margin = p.margin_fraction * p.valley_width_mm
    across, along = p.valley_width_mm / 2 - margin, length / 2 - margin
    return Artefact(
        name=name,
        kind="engine_block",
        parameters=p.model_dump(),
        mesh=mesh,
        certified={
            "bore_diameter_mm": p.bore_diameter_mm,
            "bore_spacing_mm": p.bore_spacing_mm,
            "bank_angle_deg": p.bank_angle_deg,
            "size_y_mm": length,
            "reference_flatness_um": 0.0,
        },
        features=(PlaneFeature(REFERENCE, 0.0, 0.0, (-across, across), (-along, along)),),
        parts=parts,
    )


def measure_engine_block(artefact: Artefact) -> dict[str, float]:
    """Measure an engine block's dimensions back from its mesh.

    Parameters
    ----------
    artefact : Artefact
        The block; its parts say which faces are decks and bores.

    Returns
    -------
    dict of str to float
        ``bank_angle_deg``, the angle between the decks' normals, which is that between the
        bores' axes as they are square to the decks; ``bore_diameter_mm``, the mean over the
        rims in the decks, each the diameter of the circle of its area;
        ``bore_spacing_mm``, the mean distance of neighbouring rims' centroids.
    """
    mesh = artefact.mesh
    decks, bores = artefact.parts["decks"], artefact.parts["bores"]
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[decks]], 1, 0)
    areas = np.cross(b - a, c - a)
    right = areas[:, 0] > 0.0
    normals = [areas[on].sum(axis=0) for on in (right, ~right)]
    normals = [normal / np.linalg.norm(normal) for normal in normals]
    sine, cosine = np.linalg.norm(np.cross(*normals)), np.dot(*normals)

    diameters: list[float] = []
    distances: list[float] = []
    for on, normal in zip((right, ~right), normals, strict=True):
        # In the deck: y, and the direction square to it.
        frame = np.column_stack([np.cross([0.0, 1.0, 0.0], normal), [0.0, 1.0, 0.0]])
        rims = [
            measure_circle(mesh.vertices[rim] @ frame)
            for rim in _rims(mesh.faces[decks[on]], mesh.faces[bores])
        ]
        diameters += [diameter for _, diameter in rims]
        centres = np.array(sorted((centre for centre, _ in rims), key=lambda centre: centre[1]))
        distances += list(np.linalg.norm(np.diff(centres, axis=0), axis=1))
    return {
        "bore_diameter_mm": float(np.mean(diameters)),
        "bore_spacing_mm": float(np.mean(distances)),
        "bank_angle_deg": math.degrees(math.atan2(sine, cosine)),
    }


@dataclass(frozen=True)
class _Section:
    """The block's cross-section in (x, z), and what follows from it, mm.

    ``profile`` has its z from the valley floor; the others are from the crank axis:
    ``valley`` and ``ceiling`` the heights of the valley's floor and of the bays,
    ``inner`` and ``outer`` the right deck's edges, ``shoulder`` the height at which the right
    bank meets the crankcase's wall.
    """

    profile: list[tuple[float, float]]
    valley: float
    ceiling: float
    inner: tuple[float, float]
    outer: tuple[float, float]
    shoulder: float

    @classmethod
    def of(cls, p: EngineBlockParameters) -> "_Section":
        sine, cosine = _half_angle(p)
        centre = p.deck_distance_mm * sine, p.deck_distance_mm * cosine
        half = p.deck_width_mm / 2
        inner = centre[0] - half * cosine, centre[1] + half * sine
        outer = centre[0] + half * cosine, centre[1] - half * sine
        case, floor = p.crankcase_width_mm / 2, p.valley_width_mm / 2
        # Both sides of a bank run along its axis, dx : dz = sine : cosine.
        shoulder = outer[1] - (outer[0] - case) * cosine / sine
        valley = inner[1] - (inner[0] - floor) * cosine / sine
        right = [
            (case, -p.skirt_mm - valley),
            (case, shoulder - valley),
            (outer[0], outer[1] - valley),
            (inner[0], inner[1] - valley),
            (floor, 0.0),
        ]
        profile = right + [(-x, z) for x, z in reversed(right)]
        return cls(profile, valley, valley - p.wall_mm, inner, outer, shoulder)


def _half_angle(p: EngineBlockParameters) -> tuple[float, float]:
    half = math.radians(p.bank_angle_deg / 2)
    return math.sin(half), math.cos(half)


def _check(p: EngineBlockParameters, section: _Section, where: str) -> None:
    """Refuse blocks whose cavities meet where there should be a wall."""
    sine, cosine = _half_angle(p)
    bore, case, wall = p.bore_diameter_mm / 2, p.crankcase_width_mm / 2, p.wall_mm
    tunnel, ceiling = p.tunnel_diameter_mm / 2, section.ceiling
    # A wall above the bays' corners.  (Bores meet below the bays' ceiling wherever a deck is
    # wide enough for them: the valley is at (deck_width/2 + valley_width/2 cosine) / sine.)
    nearest = (case - wall) * sine + ceiling * cosine + wall
    deck, skirt = 2 * (bore + wall), tunnel + wall
    limits: list[tuple[str, bool, str]] = [
        ("deck_width_mm", _reaches(p.deck_width_mm, deck), f"at least {deck:g}"),
        (
            "bore_spacing_mm",
            p.bore_spacing_mm > 2 * bore + p.stagger_mm + wall,
            f"more than {2 * bore + p.stagger_mm + wall:g}, the bore, stagger and wall",
        ),
        (
            "valley_width_mm",
            p.valley_width_mm / 2 < section.inner[0],
            f"less than {2 * section.inner[0]:.4g}, the decks' distance",
        ),
        (
            "crankcase_width_mm",
            case < section.outer[0] and -p.skirt_mm < section.shoulder,
            f"less than {2 * section.outer[0]:.4g}, the block's width, and more than where "
            "the banks come down to the skirt",
        ),
        (
            "crankcase_width_mm",
            case - wall > max(bore * cosine, tunnel),
            f"more than {2 * (max(bore * cosine, tunnel) + wall):.4g}, for bores and tunnel",
        ),
        ("skirt_mm", _reaches(p.skirt_mm, skirt), f"at least {skirt:g}, tunnel and wall"),
        (
            "tunnel_diameter_mm",
            tunnel < ceiling,
            f"less than {2 * ceiling:.4g}, for a roof over the crank",
        ),
        (
            "deck_distance_mm",
            _reaches(p.deck_distance_mm, nearest),
            f"at least {nearest:.4g}, for walls",
        ),
    ]
    for key, holds, expected in limits:
        if not holds:
            raise InputError(f"{where}.{key}", expected, getattr(p, key))


def _reaches(length: float, least: float) -> bool:
    """Return whether a length is at least another; a scaled block's may be off by rounding."""
    return length >= least * (1.0 - 1e-12)


def _bay(p: EngineBlockParameters, section: _Section) -> manifold3d.Manifold:
    """Cavity between two webs, about y = 0; it goes clear through the bottom."""
    half = p.crankcase_width_mm / 2 - p.wall_mm
    bottom = -p.skirt_mm - section.valley - 1.0
    top = section.ceiling - section.valley
    profile = [(-half, bottom), (half, bottom), (half, top), (-half, top)]
    return to_solid(prism(profile, p.bore_spacing_mm - p.wall_mm))


def _deck_faces(mesh: Mesh, casting: NDArray[np.int64], section: _Section) -> NDArray[np.int64]:
    """Faces of the casting whose corners all lie on the line between a deck's edges."""
    (x0, z0), (x1, z1) = section.inner, section.outer
    x = np.abs(mesh.vertices[:, 0]) - x0
    z = mesh.vertices[:, 2] - (z0 - section.valley)
    off = (x * (z1 - z0) - z * (x1 - x0)) / math.hypot(x1 - x0, z1 - z0)
    return casting[(np.abs(off) < 1e-6)[mesh.faces[casting]].all(axis=1)]


def _rims(deck: NDArray[np.int64], bores: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Vertices of each closed line in which a deck meets a bore."""
    here, there = (
        {tuple(edge) for edge in np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)).tolist()}
        for f in (deck, bores)
    )
    edges = np.array(sorted(here & there))
    vertices, local = np.unique(edges, return_inverse=True)
    local = local.reshape(edges.shape)
    graph = coo_array((np.ones(len(edges)), tuple(local.T)), shape=(len(vertices),) * 2)
    count, label = connected_components(graph, directed=False)
    return [vertices[label == i] for i in range(count)]


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(EngineBlockParameters, build_engine_block, measure_engine_block)
