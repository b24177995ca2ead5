"""Find the features that a part's file declares on its mesh, or say what is wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.geometry import Element
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.objects.declared.edges import edge_circle
from slbench.objects.declared.nominal import nominal, sampled
from slbench.objects.declared.regions import Ball, Box, Everywhere, Region, Tube, grown
from slbench.objects.declared.surface import SurfaceFeature, extent_along, patch_of, towards
from slbench.objects.declared.tables import FeatureTable
from slbench.objects.triangles import Mesh

Array = NDArray[np.float64]
Groups = Callable[[], Mapping[str, NDArray[np.int64]]]

#: Margin where none is stated, as a share of the root of the feature's area (of a circle's radius).
_MARGIN, _EDGE_MARGIN = 0.05, 0.2
#: The least share of the area of named faces that must lie on the element.
_SHARE = 0.5
_FORBIDDEN = "[]/*"


def declare_features(
    tables: Sequence[FeatureTable],
    mesh: Mesh,
    groups: Groups,
    taken: Sequence[str],
    where: str,
) -> tuple[SurfaceFeature, ...]:
    """Find the declared features on a mesh.

    Parameters
    ----------
    tables : sequence of FeatureTable
    mesh : Mesh
    groups : callable
        Returns the named faces of the mesh, where a table asks for them.
    taken : sequence of str
        Names that other features of the artefact have.
    where : str
        The file, for messages.

    Raises
    ------
    InputError
        For a name that is taken, a region without faces of the kind, faces that there are not, a
        margin that leaves nothing.
    """
    names = list(taken)
    found = []
    for index, table in enumerate(tables):
        place = f"{where}: features[{index}] {table.name!r}"
        check_name(table.name, names, place)
        names.append(table.name)
        found.append(_feature(table, mesh, groups, place))
    return tuple(found)


def check_name(name: str, taken: Sequence[str], place: str) -> None:
    """Refuse a name that another has, or that a claim could not select by."""
    if name in taken:
        raise InputError(f"{place}: name", "a name of its own", f"{name!r} again")
    if any(letter in name for letter in _FORBIDDEN) or name != name.strip():
        raise InputError(f"{place}: name", f"a name without {_FORBIDDEN} and outer blanks", name)


def _feature(table: FeatureTable, mesh: Mesh, groups: Groups, place: str) -> SurfaceFeature:
    region = _region(table, mesh, place)
    faces = _faces(table, mesh, groups, place)
    if table.type == "circle":
        return _circle(table, mesh, region, faces, place)
    samples = sampled(mesh, faces, region)
    if not len(samples):
        low, high = (", ".join(f"{x:g}" for x in corner) for corner in mesh.bounds)
        expected = f"a region that meets the mesh ({low} to {high} mm)"
        raise InputError(place, expected, "one without faces: another unit, or another frame?")
    result = nominal(table.type, samples)
    if result is None:
        raise InputError(place, f"faces that form a {table.type} in its region", "none")
    element, on = result
    share = float(samples.areas[on].sum() / samples.areas.sum())
    if table.faces is not None and share < _SHARE:
        got = f"ones of which {100.0 * share:.0f} % of the area does"
        raise InputError(place, f"faces that form a {table.type}", got)
    own = samples.of(on)
    length, middle = extent_along(element, own.points)
    element = element.at(middle)
    outward = np.einsum("ij,ij->i", element.normals(own.points), own.normals)
    sign = 1.0 if float(outward @ own.areas) >= 0.0 else -1.0
    if table.type == "plane":
        element, sign = element.facing(np.average(own.normals, axis=0, weights=own.areas)), 1.0
    if table.type == "cylinder":  # either way along the axis; always the same one
        element = element.facing(np.eye(3)[np.argmax(np.abs(element.direction).round(6))])
    element = towards(element, np.average(own.points - element.point, axis=0, weights=own.areas))
    element = _stated(element, table)
    chosen = np.unique(own.faces)
    # A face belongs with all of it that lies in the region.
    chosen = chosen[~np.isin(chosen, samples.faces[~on])]
    if not len(chosen):
        raise InputError(place, f"faces that form a {table.type} in its region", "parts of faces")
    area = float(own.areas.sum())
    margin = table.margin_mm if table.margin_mm is not None else _MARGIN * float(np.sqrt(area))
    patch = patch_of(element, mesh, chosen, margin)
    if patch is not None and patch.is_empty:
        expected = "less than half the width of its faces"
        raise InputError(f"{place}: margin_mm", expected, f"{margin:.4g}")
    return SurfaceFeature(
        table.name,
        element,
        sign,
        region,
        patch,
        margin,
        table.reach_mm if table.reach_mm is not None else margin,
        length,
        float(np.abs(element.distances(own.points)).max()),
    )


def _circle(
    table: FeatureTable, mesh: Mesh, region: Region, faces: NDArray[np.int64], place: str
) -> SurfaceFeature:
    found = edge_circle(mesh, faces, region)
    if found is None:
        expected = "a region that holds one circular edge of a flat face, and no other edges"
        raise InputError(place, expected, "none or several")
    circle, sign, sag = found
    element = _stated(circle, table)
    margin = table.margin_mm if table.margin_mm is not None else _EDGE_MARGIN * element.radius
    if margin >= element.radius:
        raise InputError(
            f"{place}: margin_mm", f"less than the radius {element.radius:.4g}", margin
        )
    reach = table.reach_mm if table.reach_mm is not None else 0.5 * margin
    return SurfaceFeature(table.name, element, sign, region, None, margin, reach, 0.0, sag)


def _stated(element: Element, table: FeatureTable) -> Element:
    """Return the element with what the table states otherwise."""
    given = table.nominal
    if given is None:
        return element
    half_angle = element.half_angle
    if given.half_angle_deg is not None:
        half_angle = float(np.deg2rad(given.half_angle_deg))
    return type(element)(
        np.array(given.point_mm) if given.point_mm is not None else element.point,
        np.array(given.direction) if given.direction is not None else element.direction,
        given.radius_mm if given.radius_mm is not None else element.radius,
        half_angle,
    )


def _region(table: FeatureTable, mesh: Mesh, place: str) -> Region:
    given = [key for key in ("box_mm", "sphere", "cylinder") if getattr(table, key) is not None]
    if len(given) > 1:
        raise InputError(place, "one of box_mm, sphere, cylinder", " and ".join(given))
    if not given and table.faces is None and table.grow is None:
        raise InputError(place, "one of box_mm, sphere, cylinder, faces, grow", "none")
    if table.faces is not None and table.grow is not None:
        raise InputError(place, "one of faces, grow", "both")
    if table.box_mm is not None:
        bounds = np.array(table.box_mm)
        if (bounds[0] >= bounds[1]).any():
            expected = "the lowest corner and the highest"
            raise InputError(f"{place}: box_mm", expected, bounds.tolist())
        return Box(bounds)
    if table.sphere is not None:
        return Ball(np.array(table.sphere.centre_mm), table.sphere.radius_mm)
    if table.cylinder is not None:
        start, end = np.array(table.cylinder.from_mm), np.array(table.cylinder.to_mm)
        if np.array_equal(start, end):
            raise InputError(f"{place}: cylinder", "two different ends", start.tolist())
        return Tube(start, end, table.cylinder.radius_mm)
    return Everywhere(np.array(mesh.bounds))


def _faces(table: FeatureTable, mesh: Mesh, groups: Groups, place: str) -> NDArray[np.int64]:
    if table.grow is not None:
        return grown(mesh, np.array(table.grow.from_mm), table.grow.within_deg)
    if table.faces is None:
        return np.arange(len(mesh.faces))
    named = groups()
    wanted = table.faces if isinstance(table.faces, tuple) else (table.faces,)
    if not named:
        expected = "faces by a region or by grow: this file names none"
        raise InputError(f"{place}: faces", expected, list(wanted))
    chosen = []
    for one in wanted:
        if str(one) not in named:
            known = list(named)
            few = ", ".join(known[:8]) + (f", ... ({len(known)} in all)" if len(known) > 8 else "")
            raise InputError(f"{place}: faces", f"some of {few}", quoted(str(one), known))
        chosen.append(named[str(one)])
    return np.unique(np.concatenate(chosen))
