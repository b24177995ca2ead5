"""Propellers have the blades, holes, twist and volume that their parameters say."""

import math

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from macro_artefacts import (
    check_refused,
    check_repeatable,
    check_shipped,
    check_solid,
    fresh,
    solid,
)

from slbench import objects

PROPELLER = {
    "blades": 4,
    "tip_diameter_mm": 58.0,
    "hub_diameter_mm": 14.0,
    "hub_height_mm": 9.0,
    "bore_diameter_mm": 5.0,
    "pitch_mm": 40.0,
    "root_chord_mm": 8.0,
    "tip_chord_mm": 6.0,
    "root_thickness_mm": 2.0,
    "tip_thickness_mm": 1.0,
    "section": "airfoil",
    "holes_along": 5,
    "holes_across": 1,
    "hole_diameter_mm": 1.0,
}


@settings(max_examples=8)
@given(
    blades=st.integers(2, 5),
    scale=st.floats(0.05, 5.0),
    pitch=st.floats(15.0, 45.0),
    section=st.sampled_from(["airfoil", "plate"]),
    along=st.integers(0, 6),
    across=st.integers(1, 2),
)
def test_any_propeller_is_one_solid_with_its_holes(blades, scale, pitch, section, along, across):
    lengths = {key: value * scale for key, value in PROPELLER.items() if key.endswith("_mm")}
    propeller = fresh(
        "propeller",
        {
            **PROPELLER,
            **lengths,
            "blades": blades,
            "pitch_mm": pitch * scale,
            "section": section,
            "holes_along": along,
            "holes_across": across,
            "max_form_error_um": 2.0 * scale,
        },
    )
    # A handle for the bore and one for every hole.
    check_solid(propeller.mesh, genus=1 + blades * along * across)
    measured = objects.measure(propeller)
    assert set(propeller.certified) <= set(measured)
    for key, value in propeller.certified.items():
        assert measured[key] == pytest.approx(value, rel=1e-12, abs=1e-9), key

    body = solid(propeller.mesh)
    # Blades, counted by an independent kernel: pieces that a cylinder leaves standing.
    inside = manifold3d.Manifold.cylinder(90 * scale, 26 * scale, 26 * scale, 64, center=True)
    assert len((body - inside).decompose()) == blades
    # Bore: the hole in a cross-section of the hub alone, kept on a grid of about 1e-8.
    low, high = propeller.mesh.bounds[:, 2]
    assert (low, high) == (-propeller.parameters["hub_height_mm"], 0.0)
    loops = [np.asarray(loop) for loop in body.slice(-1e-3 * scale).to_polygons()]
    areas = sorted(area(loop) for loop in loops)
    assert 2 * math.sqrt(-areas[0] / math.pi) == pytest.approx(5.0 * scale, abs=1e-6)
    assert 2 * math.sqrt(areas[1] / math.pi) == pytest.approx(14.0 * scale, abs=1e-6)
    assert len(areas) == 2


def area(loop):
    x, y = loop.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@pytest.mark.parametrize("section", ["airfoil", "plate"])
def test_volume_is_the_integral_of_the_sections(section):
    # Wrapping a section around its cylinder keeps its area, so a blade's volume is the
    # integral of A(r) dr from the hub's surface to the tip.
    propeller = fresh("propeller", {**PROPELLER, "section": section, "holes_along": 0})
    r = np.linspace(7.0, 29.0, 2001)
    chord, thickness = np.interp(r, [7, 29], [8, 6]), np.interp(r, [7, 29], [2, 1])
    if section == "plate":
        areas = (chord - thickness) * thickness + math.pi / 4 * thickness**2
    else:
        terms = [0.2969 / 1.5, -0.1260 / 2, -0.3516 / 3, 0.2843 / 4, -0.1036 / 5]
        areas = 10.0 * sum(terms) * chord * thickness
    blade = np.trapezoid(areas, r)
    hub = math.pi * 9.0 * (7.0**2 - 2.5**2)
    # 27 stations inscribe the section: about (pi/27)^2 / 2 = 0.7 % of its area is lost.
    lost = (hub + 4 * blade - propeller.mesh.volume) / (4 * blade)
    assert 0.0 < lost < 0.01


def test_blades_twist_like_a_helicoid():
    propeller = fresh("propeller", {**PROPELLER, "holes_along": 0})
    vertices = propeller.mesh.vertices
    radius, angle = np.hypot(*vertices.T[:2]), np.arctan2(vertices[:, 1], vertices[:, 0])
    blade = (radius > 7.1) & (np.abs(angle) < math.pi / 4)
    stations = np.unique(np.round(radius[blade], 9))
    assert len(stations) == 47
    for r in stations[[5, 20, 46]]:
        ring = blade & (np.abs(radius - r) < 1e-8)
        unrolled = np.column_stack([r * angle[ring], vertices[ring, 2] + 4.5])
        assert len(unrolled) == 54
        # The section is symmetric about its chord, which is a principal axis therefore.
        direction = np.linalg.svd(unrolled)[2][0]
        slope = direction[1] / direction[0]
        assert slope == pytest.approx(40.0 / (2 * math.pi * r), rel=1e-7)


def test_holes_are_evenly_distributed_and_go_through():
    propeller = fresh("propeller", {**PROPELLER, "holes_across": 2, "holes_along": 4})
    vertices = propeller.mesh.vertices
    for turn in 2 * math.pi * np.arange(4) / 4:
        for r in 7.0 + 22.0 * np.array([0.125, 0.375, 0.625, 0.875]):
            seen = np.interp(r, [7, 29], [8, 6]) * math.cos(math.atan(40 / (2 * math.pi * r)))
            for offset in (-0.25, 0.25):
                around = turn + offset * seen / r
                centre = r * np.array([math.cos(around), math.sin(around)])
                distance = np.linalg.norm(vertices[:, :2] - centre, axis=1)
                # Nothing within the hole but its own rims: within half a micrometre of it.
                assert distance.min() == pytest.approx(0.5, abs=0.5e-3)
                rim = distance < 0.5005
                assert np.ptp(vertices[rim, 2]) > 0.5
                assert np.isnan(objects.surface_height(propeller.mesh, [centre])).all()


def test_parts_and_reference():
    propeller = fresh("propeller", PROPELLER)
    assert list(propeller.parts) == ["hub", "blades"]
    mesh = propeller.mesh
    blades = mesh.vertices[mesh.faces[propeller.parts["blades"]]]
    # The hub's polygon of equal area comes in by no more than the form error.
    assert np.hypot(blades[..., 0], blades[..., 1]).min() > 7.0 - 0.5e-3
    hub = mesh.vertices[mesh.faces[propeller.parts["hub"]]]
    assert np.hypot(hub[..., 0], hub[..., 1]).max() < 7.0 + 0.5e-3
    face = propeller.reference
    places = np.random.default_rng(5).uniform(*np.transpose([face.x_mm, face.y_mm]), (200, 2))
    assert (objects.surface_height(mesh, places) == 0.0).all()


@pytest.mark.parametrize("name", ["propeller-3", "propeller-4"])
def test_shipped_propellers(name):
    propeller = check_shipped(name)
    p = propeller.parameters
    holes = p["blades"] * p["holes_along"] * p["holes_across"]
    check_solid(propeller.mesh, genus=1 + holes)
    check_repeatable("propeller", p)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"blades": 12}, "at most 7 blades"),
        ({"bore_diameter_mm": 14.0}, "bore_diameter_mm"),
        ({"tip_diameter_mm": 14.0}, "tip_diameter_mm"),
        ({"hub_height_mm": 5.0}, "hub_height_mm"),
        ({"root_thickness_mm": 8.0}, "root_thickness_mm"),
        ({"tip_thickness_mm": 6.5}, "tip_thickness_mm"),
        ({"holes_along": 50}, "hole_diameter_mm"),
        ({"hole_diameter_mm": 5.0}, "hole_diameter_mm"),
    ],
)
def test_refused_propellers(change, key):
    check_refused("propeller", PROPELLER, change, key)
