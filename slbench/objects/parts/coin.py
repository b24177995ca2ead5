"""A coin: a rough field, raised characters with bevelled flanks, and a rim.

The thesis measures the "3" and the "N" of a dime, for the height of the relief and the
roughness of the flat area (thesis 8.4, figures 34 and 35).

The outlines of the font (:mod:`slbench.objects.parts.glyphs`) are the feet of the relief.  Its
edges at the top are the outlines moved inwards by the width of the flanks
(:mod:`slbench.objects.parts.bevel`), which makes these planes of the stated angle along straight
strokes, with mitred corners; along curves the width keeps to 1 %.  Tops and rim are smooth
and level.  The field is rough (:mod:`slbench.objects.parts.roughness`): its mean over area is z = 0
and its Ra, taken over the triangles of the mesh, is the stated one; the feet of the flanks
are points of it.

Parts: ``field``, ``relief`` (tops and flanks of the characters) and ``rim`` (with its flank,
the wall and the back).  Object frame: origin at the centre, z = 0 on the mean of the field,
text upright along +y; the back is at z = -thickness.
"""

import math
from typing import Annotated

import numpy as np
import shapely
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Interval, Length, MaxLen, MinLen
from slbench.objects.artefact import REFERENCE, Artefact, PlaneFeature, surface_height
from slbench.objects.mesh.heightfield import close_below
from slbench.objects.mesh.planar import largest_rectangle, triangulated
from slbench.objects.parts.bevel import bevelled
from slbench.objects.parts.glyphs import Ring, polygon_of, text_outlines
from slbench.objects.parts.roughness import mean_and_ra, rough_height
from slbench.objects.registry import ArtefactKind


class CoinParameters(Parameters):
    """Size of a coin.

    Parameters
    ----------
    text : str
        What stands on it, on one line, in DejaVu Sans Bold.
    diameter_mm, thickness_mm : float
        Of the disc; the thickness from the field to the back.
    text_height_mm : float
        Height of the outline of the text.
    relief_height_mm : float
        Of the characters' tops above the mean of the field.
    rim_height_mm, rim_width_mm : float
        Height of the rim above the mean of the field, and width of its top.
    flank_angle_deg : float
        Of the flanks to the field.
    field_ra_um, correlation_length_um : float
        Roughness of the field.
    seed : int
        Which rough surface it is.
    spacing_um : float
        Of the points of the field and along the outlines; at most half the correlation
        length where the field is rough, and the width of the narrower flank.
    """

    text: Annotated[str, MinLen(1), MaxLen(20)]
    diameter_mm: Length = 1.6
    thickness_mm: Length = 0.3
    text_height_mm: Length = 0.9
    relief_height_mm: Length = 0.06
    rim_height_mm: Length = 0.08
    rim_width_mm: Length = 0.1
    flank_angle_deg: Annotated[float, Interval(ge=10.0, le=85.0)] = 65.0
    field_ra_um: Annotated[float, Interval(ge=0.0, le=100.0)] = 0.25
    correlation_length_um: Annotated[float, Interval(ge=0.1, le=1e4)] = 20.0
    seed: Annotated[int, Interval(ge=0, le=2**63)] = 1
    spacing_um: Annotated[float, Interval(ge=0.1, le=1e3)] = 5.0


#: Points of the field at most; 4 million triangles.
_MOST_POINTS = 2_000_000


def build_coin(parameters: CoinParameters, name: str, where: str) -> Artefact:
    """Build a coin.

    Parameters
    ----------
    parameters : CoinParameters
        Its size.
    name : str
        What to call it.
    where : str
        Where the parameters were read, for error messages.

    Returns
    -------
    Artefact
        With the features ``reference`` (the largest rectangle of the field), ``rim`` and,
        for every character whose top is wide enough for a rectangle, ``character_1``,
        ``character_2``, ... in the order of the text, blanks not counted.  Certified are
        diameter, rim height, the characters' heights and the field's Ra.

    Raises
    ------
    InputError
        If the text has no outline, does not fit inside the rim or is too fine for its
        flanks, or the spacing is too coarse.
    """
    p = parameters
    spacing = 1e-3 * p.spacing_um
    slope = math.tan(math.radians(p.flank_angle_deg))
    flank = p.relief_height_mm / slope
    rim_radii = (0.5 * p.diameter_mm - p.rim_width_mm, 0.5 * p.diameter_mm)
    field_radius = rim_radii[0] - p.rim_height_mm / slope
    _check_spacing(p, field_radius, min(flank, p.rim_height_mm / slope), where)

    count = 4 * math.ceil(0.5 * math.pi * field_radius / spacing)
    angle = 2.0 * math.pi / count * np.arange(count)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    feet = text_outlines(p.text, p.text_height_mm, spacing, f"{where}.text")
    characters = [polygon_of(rings) for rings in feet]
    disc = shapely.Polygon(field_radius * circle)
    _check_fit(characters, feet, disc, f"{where}.text_height_mm")
    foot_rings = [ring for rings in feet for ring in rings]
    bevel = bevelled(characters, foot_rings, flank, spacing)
    for character, top in zip(characters, bevel.tops, strict=True):
        if shapely.get_num_geometries(character) != len(shapely.get_parts(top)):
            expected = f"characters with strokes wider than two flanks of {1e3 * flank:.4g} um"
            raise InputError(f"{where}.relief_height_mm", expected, p.relief_height_mm)
    ink, level = shapely.union_all(characters), shapely.union_all(bevel.tops)
    field = shapely.difference(disc, ink)
    # The outlines' points come first in the triangulation, in the order given.
    outlines = [field_radius * circle, *foot_rings, *bevel.rings_mm, bevel.mitres_mm]
    heights = np.concatenate(
        [
            np.zeros(count + sum(map(len, foot_rings))),
            np.full(sum(map(len, bevel.rings_mm)), p.relief_height_mm),
            bevel.shares * p.relief_height_mm,
        ]
    )
    try:
        places, faces, kinds = triangulated(
            outlines, [field, shapely.difference(ink, level), level], spacing
        )
    except InputError as error:
        expected = "a spacing finer than the gaps between outlines"
        raise InputError(f"{where}.spacing_um", expected, p.spacing_um) from error
    vertices = np.column_stack([places, np.zeros(len(places))])
    vertices[: len(heights), 2] = heights
    _roughen(vertices, faces[kinds == 0], p)

    rim = [np.column_stack([r * circle, np.full(count, p.rim_height_mm)]) for r in rim_radii]
    i = np.arange(count)
    j = np.roll(i, -1)
    strips = [
        np.column_stack([inner + i, outer + i, outer + j, inner + i, outer + j, inner + j])
        for inner, outer in [(0, len(places)), (len(places), len(places) + count)]
    ]
    mesh = close_below(
        np.concatenate([vertices, *rim]),
        np.concatenate([faces, *(strip.reshape(-1, 3) for strip in strips)]),
        len(places) + count + i,
        -p.thickness_mm,
    )
    kinds = np.concatenate([kinds, np.full(len(mesh.faces) - len(faces), 3)])
    features = _features(field, bevel.tops, flank, p)
    return Artefact(
        name=name,
        kind="coin",
        parameters=p.model_dump(),
        mesh=mesh,
        certified={"diameter_mm": p.diameter_mm, "field_ra_um": p.field_ra_um}
        | {f"{f.name}_height_mm": f.height_mm for f in features if f.name != REFERENCE},
        features=features,
        parts={
            "field": np.flatnonzero(kinds == 0),
            "relief": np.flatnonzero((kinds == 1) | (kinds == 2)),
            "rim": np.flatnonzero(kinds == 3),
        },
    )


def measure_coin(artefact: Artefact) -> dict[str, float]:
    """Measure a coin from its mesh; heights are above the mean of all of the field.

    Parameters
    ----------
    artefact : Artefact
        A coin.

    Returns
    -------
    dict of str to float
        ``diameter_mm``, that of the smallest circle about the outermost points;
        ``field_ra_um``; ``rim_height_mm`` and ``character_N_height_mm`` for every flat top
        among the features, the mean height of the level faces over its rectangle.
    """
    mesh, features = artefact.mesh, artefact.steps
    field = mesh.faces[artefact.parts["field"]]
    mean, _ = mean_and_ra(mesh.vertices, field)
    ra = mean_and_ra(mesh.vertices - [0.0, 0.0, mean], field)[1]
    middles = [(np.mean(feature.x_mm), np.mean(feature.y_mm)) for feature in features]
    heights = surface_height(mesh, np.reshape(middles, (-1, 2))) - mean
    return {
        "diameter_mm": 2.0 * float(np.hypot(*mesh.vertices[:, :2].T).max()),
        "field_ra_um": ra,
    } | {f"{f.name}_height_mm": float(h) for f, h in zip(features, heights, strict=True)}


def _check_spacing(p: CoinParameters, field_radius: float, flank: float, where: str) -> None:
    """Refuse a spacing that cannot show the roughness or a flank, or needs too many points."""
    if field_radius <= 0.1 * p.diameter_mm:
        expected = f"less than {0.4 * p.diameter_mm:g} together with the flank of the rim"
        raise InputError(f"{where}.rim_width_mm", expected, p.rim_width_mm)
    most = 1e3 * flank
    if p.field_ra_um > 0.0:
        most = min(most, 0.5 * p.correlation_length_um)
    least = 1e3 * field_radius * math.sqrt(math.pi / _MOST_POINTS)
    if not least <= p.spacing_um <= most:
        expected = f"{least:.3g} to {most:.4g} (half a correlation length, the flanks' width)"
        raise InputError(f"{where}.spacing_um", expected, p.spacing_um)


def _check_fit(
    characters: list[shapely.Geometry], rings: list[list[Ring]], disc: shapely.Polygon, where: str
) -> None:
    """Refuse text that reaches the rim, and outlines that cross, which the font has a few of."""
    if not all(disc.contains(character) for character in characters):
        reach = max(float(np.hypot(*ring.T).max()) for pieces in rings for ring in pieces)
        radius = float(np.hypot(*disc.exterior.coords[0]))
        expected = f"text within {radius:.4g} mm of the centre, inside the rim"
        raise InputError(where, expected, f"{reach:.4g} mm")
    signed = sum(_signed_area(ring) for pieces in rings for ring in pieces)
    simple = all(shapely.LinearRing(ring).is_simple for pieces in rings for ring in pieces)
    if not simple or abs(shapely.union_all(characters).area / signed - 1.0) > 1e-9:
        raise InputError(where, "characters whose outlines do not cross", "some that do")


def _signed_area(ring: Ring) -> float:
    x, y = ring.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _roughen(vertices: NDArray[np.float64], faces: NDArray[np.int64], p: CoinParameters) -> None:
    """Raise and lower the points of the field: mean 0 and the stated Ra, over its faces."""
    points = np.unique(faces)
    x, y, _ = vertices[points].T
    vertices[points, 2] = rough_height(x, y, p.field_ra_um, p.correlation_length_um, p.seed)
    vertices[points, 2] -= mean_and_ra(vertices, faces)[0]
    if p.field_ra_um > 0.0:
        vertices[points, 2] *= p.field_ra_um / mean_and_ra(vertices, faces)[1]


def _features(
    field: shapely.Geometry, tops: list[shapely.Geometry], flank: float, p: CoinParameters
) -> tuple[PlaneFeature, ...]:
    """Rectangles a flank's width away from the edges of field, rim and characters."""
    features = []
    place = largest_rectangle(field, flank)
    if place is not None:
        features.append(PlaneFeature(REFERENCE, 0.0, 0.0, *place))
    # On the rim at +x: as high as the rim is wide, and in the middle of its width.
    outer, width = 0.5 * p.diameter_mm, p.rim_width_mm
    far = math.sqrt((outer - 0.15 * width) ** 2 - (0.5 * width) ** 2)
    side = (outer - 0.85 * width, far)
    if side[0] < far:
        level = p.rim_height_mm
        features.append(PlaneFeature("rim", level, level, side, (-0.5 * width, 0.5 * width)))
    for number, top in enumerate(tops, start=1):
        place = largest_rectangle(top, flank)
        if place is not None:
            level = p.relief_height_mm
            features.append(PlaneFeature(f"character_{number}", level, level, *place))
    return tuple(features)


#: The row of :mod:`slbench.objects.registry`.
KIND = ArtefactKind(CoinParameters, build_coin, measure_coin)
