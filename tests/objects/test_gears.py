"""Gears have involute flanks and generated fillets, and their dimensions can be measured back."""

import functools
import math

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench import objects
from slbench.core import io, resources
from slbench.core.errors import InputError
from slbench.objects import Mesh
from slbench.objects.gears.gearmeasure import fit_circle, section
from slbench.objects.gears.involute import Toothing, circle, points_on

SPUR = {"module_mm": 1.5, "teeth": 24, "bore_diameter_mm": 8.0, "face_width_mm": 8.0}
HUB = {"hub_diameter_mm": 14.0, "hub_height_mm": 4.0}
HELICAL = {**SPUR, **HUB, "helix_angle_deg": 25.0, "max_form_error_um": 10.0}
CURVED = {
    **SPUR,
    **HUB,
    "rim_width_mm": 1.0,
    "dish_radius_mm": 15.0,
    "hub_rounding_mm": 1.0,
    "max_form_error_um": 10.0,
}
WATCH = {
    "module_mm": 0.08,
    "teeth": 20,
    "bore_diameter_mm": 0.3,
    "bore_rounding_mm": 0.04,
    "hub_diameter_mm": 0.7,
    "hub_height_mm": 0.1,
    "face_width_mm": 0.2,
    "correlation_length_um": 60.0,
    "max_form_error_um": 0.2,
}
KINDS = {
    "gear": {**SPUR, **HUB, "max_form_error_um": 10.0},
    "double_helical_gear": HELICAL,
    "curved_gear": CURVED,
    "watch_gear": WATCH,
}
SHIPPED = ["spur-gear", "double-helical-gear", "curved-gear", "watch-gear"]

toothings = st.fixed_dictionaries(
    {
        "module_mm": st.floats(0.05, 5.0),
        "teeth": st.integers(17, 60),
        "pressure_angle_deg": st.floats(18.0, 25.0),
        "profile_shift": st.floats(-0.2, 0.35),
        "root_fillet": st.floats(0.0, 0.28),
    }
)


@functools.cache
def shipped(name):
    return objects.load_artefact(name)


def rebuilt(kind, parameters):
    """Build without the cache."""
    checked = objects.artefacts.get(kind).parameters.model_validate(parameters)
    return objects.artefacts.get(kind).build(checked, kind, "parameters")


def check_pierced_solid(mesh):
    """Closed, every edge once in each direction, outward, no face without area, one hole."""
    edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    code = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    twin = edges[:, 1] * len(mesh.vertices) + edges[:, 0]
    assert len(np.unique(code)) == len(code)
    assert np.array_equal(np.sort(code), np.sort(twin))
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert mesh.face_areas.min() > 1e-9 * mesh.face_areas.max()
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    # Euler's formula: one piece with one hole, the bore.
    assert len(mesh.vertices) - len(edges) // 2 + len(mesh.faces) == 0


def inv(angle):
    return math.tan(angle) - angle


def base_tangent(p, teeth):
    """Closed form of DIN 3960, from the parameters of a gear."""
    m, z, x = p["module_mm"], p["teeth"], p.get("profile_shift", 0.0)
    a, j = math.radians(p.get("pressure_angle_deg", 20.0)), p.get("backlash_mm", 0.0)
    plain = m * math.cos(a) * (math.pi * (teeth - 0.5) + z * inv(a))
    return plain + 2 * x * m * math.sin(a) - j * math.cos(a)


def outer_polygon(mesh, z):
    """Section of a mesh by trimesh, an implementation of its own."""
    cut = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).section([0, 0, 1], [0, 0, z])
    loops = [shapely.Polygon(loop[:, :2]) for loop in cut.discrete]
    return max(loops, key=lambda polygon: polygon.area)


# --- the involute -------------------------------------------------------------------------


@settings(max_examples=15)
@given(toothings, st.floats(0.0, 0.1), st.floats(0.0, 2 * math.pi))
def test_every_tangent_of_the_base_circle_cuts_off_base_tangent_lengths(p, backlash, turn):
    # The defining property of involutes, anywhere on the flanks: a line that touches the base
    # circle crosses the flanks square, and those of opposite hand W_k apart.
    m = p["module_mm"]
    p = {**p, "backlash_mm": backlash * m, "face_width_mm": m, "bore_diameter_mm": m}
    error = 1e-3 * m
    gear = rebuilt("gear", {**p, "max_form_error_um": max(1e-3, 1e3 * error)})
    outline = shapely.affinity.rotate(
        outer_polygon(gear.mesh, -0.3 * m), turn, origin=(0, 0), use_radians=True
    )
    a = math.radians(p["pressure_angle_deg"])
    base, tip = m * p["teeth"] / 2 * math.cos(a), np.hypot(*outline.exterior.xy).max()
    line = shapely.LineString([(base, -tip), (base, tip)])
    # The working flank of ISO 53 reaches one module below the reference line, less undercut.
    least = m * (p["teeth"] / 2 + p["profile_shift"] - 0.5)
    places = [
        y
        for part in shapely.get_parts(outline.intersection(line))
        for y in np.asarray(part.coords)[:, 1]
        if least < math.hypot(base, y) < tip - 2 * error
    ]
    inside = [outline.contains(shapely.Point(base, y - 1e-6 * m)) for y in places]
    left = [y for y, within in zip(places, inside, strict=True) if within and y > 0]
    right = [y for y, within in zip(places, inside, strict=True) if not within and y < 0]
    pitch = math.pi * m * math.cos(a)
    for upper in left:
        for lower in right:
            k = round((upper - lower - base_tangent(p, 1)) / pitch) + 1
            # Each end is on a chord, within the form error of the involute.
            assert upper - lower == pytest.approx(base_tangent(p, k), abs=2 * error)
    assert len(left) + len(right) > 0


@settings(max_examples=15)
@given(toothings, st.floats(-0.4, 0.4))
def test_teeth_have_the_thickness_of_an_involute_at_any_circle(p, level):
    m, z = p["module_mm"], p["teeth"]
    error = 1e-4 * m
    toothing = Toothing(
        m, z, math.radians(p["pressure_angle_deg"]), p["profile_shift"], 0.0, p["root_fillet"]
    )
    ring = shapely.LinearRing(toothing.outline(error))
    radius = m * (z / 2 + p["profile_shift"] + level)
    a = math.radians(p["pressure_angle_deg"])
    at_radius = math.acos(m * z / 2 * math.cos(a) / radius)
    half = (math.pi / 2 + 2 * p["profile_shift"] * math.tan(a)) / z + inv(a) - inv(at_radius)
    # A chord of the circle through both flanks of the tooth on +x, which is symmetric.
    flank = radius * np.array([math.cos(half), math.sin(half)])
    assert ring.distance(shapely.Point(flank)) < error
    assert ring.distance(shapely.Point(flank * [1, -1])) < error
    # The next tooth, too.
    c, s = math.cos(2 * math.pi / z), math.sin(2 * math.pi / z)
    assert ring.distance(shapely.Point(flank @ [[c, s], [-s, c]])) < error


@pytest.mark.parametrize(
    ("teeth", "shift", "fillet"),
    [(24, 0.0, 0.38), (9, 0.0, 0.38), (12, 0.5, 0.25), (60, -0.3, 0.2), (14, 0.0, 0.0)],
)
def test_a_rolling_rack_cuts_the_same_tooth_space(teeth, shift, fillet):
    # Generate the space by what the rack leaves of the blank, in small steps: fillet, flank
    # and undercut (9 teeth: 17 would be free of it) with none of the builder's formulas.
    a, r = math.radians(20.0), teeth / 2
    toothing = Toothing(1.0, teeth, a, shift, 0.0, fillet)
    tip = math.pi / 4 - 1.25 * math.tan(a)
    corner = shapely.Polygon(
        [
            (-1.25, -tip),
            (1.0, -math.pi / 4 - math.tan(a)),
            (1.0, math.pi / 4 + math.tan(a)),
            (-1.25, tip),
        ]
    )
    # Opening with a disc rounds the corners at the tip; the other end is outside the blank.
    rack = corner.buffer(-fillet).buffer(fillet, quad_segs=400) if fillet else corner
    rack = shapely.union(rack, corner.intersection(shapely.box(0.0, -9, 9, 9)))
    swept = []
    for turn in np.linspace(-5.0, 5.0, 2001) / r:
        # The rack's reference line stands `shift` outside the pitch line.
        placed = shapely.affinity.translate(rack, r + shift, r * turn)
        swept.append(shapely.affinity.rotate(placed, -turn, origin=(0, 0), use_radians=True))
    pitch = math.pi / teeth
    blank = shapely.Point(0, 0).buffer(r + 1 + shift, quad_segs=4000)
    sector = shapely.Polygon(
        [(0, 0), *(2 * r * np.exp(1j * np.array([-pitch, pitch])).view(float).reshape(2, 2))]
    )
    left_over = blank.intersection(sector).difference(shapely.union_all(swept))
    outline = shapely.Polygon(toothing.outline(1e-4))
    ours = shapely.affinity.rotate(outline, pitch, origin=(0, 0), use_radians=True)
    difference = shapely.symmetric_difference(left_over, ours.intersection(sector))
    # Steps of 0.005 leave ridges of step^2 / 8 over the curvature radius, 0.1 of a module
    # at the least; a sharp rack's corner leaves its steps.  Erosion takes away what is thinner.
    assert difference.buffer(-2e-4).is_empty
    assert difference.area < 5e-4


@pytest.mark.parametrize("error", [1e-2, 1e-3, 1e-4])
def test_chords_stay_within_the_form_error_and_no_finer_than_needed(error):
    toothing = Toothing(1.5, 11, math.radians(20.0), 0.1)
    fine = toothing.outline(1e-6)
    ring = shapely.LinearRing(toothing.outline(error))
    worst = shapely.distance(ring, shapely.points(fine)).max()
    assert 0.5 * error < worst <= error
    spaced = toothing.outline(error, 0.01)
    assert np.linalg.norm(np.diff(spaced, axis=0), axis=1).max() <= 0.01 * (1 + 1e-9)


def test_points_on_a_curve_are_on_it():
    points = points_on(lambda t: t + 1j * t**2, [0.0, 0.3, 1.0], 1e-4)
    assert np.array_equal(points.imag, points.real**2)
    assert 0.3 in points.real


@given(st.floats(1e-2, 50.0), st.floats(1e-5, 1e-3))
def test_circles_have_their_area_and_keep_their_error(radius, relative_error):
    polygon = circle(radius, relative_error * radius)
    assert shapely.Polygon(polygon).area == pytest.approx(math.pi * radius**2, rel=1e-12)
    corner = np.linalg.norm(polygon, axis=1)
    middle = np.linalg.norm(polygon + np.roll(polygon, 1, axis=0), axis=1) / 2
    assert corner.max() - radius < relative_error * radius
    assert radius - middle.min() < relative_error * radius


# --- gears --------------------------------------------------------------------------------


@settings(max_examples=12)
@given(
    st.sampled_from(["gear", "double_helical_gear"]),
    toothings,
    st.floats(0.5, 10.0),
    st.floats(0.1, 0.5),
    st.sampled_from([0.0, 0.03, 1.0, 5.0]),
)
def test_any_gear_is_an_exact_solid(kind, p, width, bore, hub_height):
    m, z = p["module_mm"], p["teeth"]
    root = m * (z - 2.5 + 2 * p["profile_shift"])
    p = {
        **p,
        "face_width_mm": m * width,
        "bore_diameter_mm": bore * root,
        "hub_diameter_mm": (bore + 0.3) * root,
        "hub_height_mm": m * hub_height,
        "max_form_error_um": 10.0 * m,
    }
    gear = rebuilt(kind, p)
    check_pierced_solid(gear.mesh)
    # Between root and tip cylinder; the hub is exact.
    hub = math.pi / 4 * ((bore + 0.3) ** 2 - bore**2) * root**2 * p["hub_height_mm"]
    body = gear.mesh.volume - hub
    tip = m * (z + 2 + 2 * p["profile_shift"])
    assert math.pi / 4 * (root**2 - (bore * root) ** 2) * m * width < body
    assert body < math.pi / 4 * (tip**2 - (bore * root) ** 2) * m * width
    low, high = gear.mesh.bounds
    assert (low[2], high[2]) == (-m * width, p["hub_height_mm"])
    assert 0.98 * tip < high[0] - low[0] <= tip * (1 + 1e-12)

    measured = objects.measure(gear)
    assert set(gear.certified) <= set(measured)
    # Rounding only: the mesh has vertices where these are measured.
    assert measured["tip_diameter_mm"] == pytest.approx(tip, rel=1e-12)
    assert measured["root_diameter_mm"] == pytest.approx(root, rel=1e-12)
    assert measured["bore_diameter_mm"] == pytest.approx(bore * root, rel=1e-11)
    assert measured["face_width_mm"] == pytest.approx(m * width, rel=1e-12)
    slope = 2 * p["profile_shift"] * math.tan(math.radians(p["pressure_angle_deg"]))
    chord = m * z * math.sin((math.pi / 2 + slope) / z)
    assert measured["chordal_tooth_thickness_mm"] == pytest.approx(chord, rel=1e-10)
    tangents = [key for key in gear.certified if key.startswith("base_tangent")]
    assert len(tangents) == 1
    k = int(tangents[0].split("_")[3])
    assert measured[tangents[0]] == pytest.approx(base_tangent(p, k), rel=1e-11)


@settings(max_examples=8)
@given(st.integers(24, 60), st.floats(5.0, 30.0), st.floats(10.0, 40.0), st.floats(1.1, 4.0))
def test_any_curved_gear_is_an_exact_solid(teeth, lower, lean, dish):
    p = {**CURVED, "teeth": teeth, "bore_diameter_mm": 5.0, "hub_diameter_mm": 8.0}
    p |= {"lower_cone_angle_deg": lower, "upper_cone_angle_deg": lower + lean}
    # A sphere of radius R is h^2 / 2 R deep under a rim of radius h < 0.75 z: 2.2 mm at most.
    p |= {
        "face_width_mm": 3.0,
        "rim_width_mm": 0.8,
        "dish_radius_mm": dish * (0.75 * teeth) ** 2 / 4.8,
    }
    gear = rebuilt("curved_gear", p)
    check_pierced_solid(gear.mesh)
    measured = objects.measure(gear)
    for key, value in gear.certified.items():
        assert measured[key] == pytest.approx(value, rel=1e-8), key
    # Section by section the same profile, scaled: tip over root is constant.
    for z in (-2.0, -1.0, -0.2):
        radius = np.hypot(*outer_polygon(gear.mesh, z).exterior.xy)
        ratio = (teeth + 2) / (teeth - 2.5)
        assert radius.max() / radius.min() == pytest.approx(ratio, rel=2e-3)


@settings(max_examples=6)
@given(st.integers(0, 2**31), st.floats(0.05, 2.0), st.booleans())
def test_any_watch_gear_is_a_solid_of_the_ra_asked_for(seed, ra, hub):
    p = {**WATCH, "seed": seed, "ra_um": ra}
    if not hub:
        p |= {"hub_height_mm": 0.0}
    gear = rebuilt("watch_gear", p)
    check_pierced_solid(gear.mesh)
    measured = objects.measure(gear)
    for key, value in gear.certified.items():
        assert measured[key] == pytest.approx(value, rel=1e-9), key


def test_roughness_is_on_the_whole_upper_face_and_nowhere_else():
    gear = rebuilt("watch_gear", {**WATCH, "ra_um": 0.7})
    vertices, faces = gear.mesh.vertices, gear.mesh.faces
    corners = vertices[faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    projected = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    upper = (projected > 1e-12) & (np.abs(corners[:, :, 2]).max(axis=1) < 0.02)
    rng = np.random.default_rng(5)
    chosen = rng.choice(len(faces), 100_000, p=projected * upper / (projected * upper).sum())
    weights = rng.dirichlet([1, 1, 1], 100_000)
    z = 1e3 * np.einsum("kc,kc->k", weights, corners[chosen][:, :, 2])
    # |z| has a standard deviation of 0.76 of its mean, z one of 1.25; 1e5 samples, five
    # sigma: a false alarm of 6e-7.
    assert np.abs(z).mean() == pytest.approx(0.7, rel=5 * 0.76 / math.sqrt(1e5))
    assert abs(z.mean()) < 5 * 1.25 * 0.7 / math.sqrt(1e5)
    # Up to the tips; the lower face is flat.
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    rim = vertices[(radius > 0.88 - 1e-9) & (vertices[:, 2] > -0.1), 2]
    assert 0.2 < 1e3 * rim.std() < 3.0
    assert set(vertices[(vertices[:, 2] < -0.1), 2]) == {-0.2}
    smooth = rebuilt("watch_gear", {**WATCH, "ra_um": 0.0})
    assert objects.measure(smooth)["reference_flatness_um"] == 0.0
    # What is added has no volume: the means of both faces are at their heights.
    assert gear.mesh.volume == pytest.approx(smooth.mesh.volume, rel=1e-4)


def test_a_double_helical_gear_keeps_its_form_error_and_lead():
    gear = rebuilt("double_helical_gear", HELICAL)
    r, width, error = 18.0, 8.0, 10.0e-3
    slope = math.tan(math.radians(25.0)) / r
    profile = shapely.LinearRing(Toothing(1.5, 24, math.radians(20.0)).outline(1e-6))
    # Points all over the teeth, turned back by the helix, are on one profile.
    corners = gear.mesh.vertices[gear.mesh.faces]
    corners = corners[(np.hypot(corners[..., 0], corners[..., 1]) > 10.0).all(axis=1)]
    corners = corners[np.ptp(corners[:, :, 2], axis=1) > 0]
    rng = np.random.default_rng(2)
    weights = rng.dirichlet([1, 1, 1], 5000)
    corners = corners[rng.choice(len(corners), 5000)]
    x, y, z = np.einsum("mc,mcd->dm", weights, corners)
    back = (x + 1j * y) * np.exp(-1j * slope * np.abs(z + width / 2))
    distance = shapely.distance(profile, shapely.points(back.real, back.imag))
    assert 0.4 * error < distance.max() < error
    # A right-handed spiral above, a left-handed one below.
    measured = objects.measure(gear)
    lead = 2 * math.pi * r / math.tan(math.radians(25.0))
    assert measured["upper_lead_mm"] == pytest.approx(lead, rel=1e-11)
    assert measured["lower_lead_mm"] == pytest.approx(-lead, rel=1e-11)
    # The halves are mirror images.
    mirrored = gear.mesh.vertices * [1, 1, -1] - [0, 0, width]
    teeth = np.hypot(*gear.mesh.vertices[:, :2].T) > 10.0
    ours = np.round(gear.mesh.vertices[teeth], 9) + 0.0
    theirs = np.round(mirrored[teeth], 9) + 0.0
    assert {tuple(v) for v in ours} == {tuple(v) for v in theirs}


def test_a_curved_gear_has_a_convex_crown_and_a_concave_dish():
    gear = rebuilt("curved_gear", {**CURVED, "max_form_error_um": 2.0})
    corners = gear.mesh.vertices[gear.mesh.faces]
    centre = corners.mean(axis=1)
    radius = np.hypot(centre[:, 0], centre[:, 1])
    scale = np.hypot(*outer_polygon(gear.mesh, -1e-6).exterior.xy).max() / 19.5
    rim = 16.125 * scale - 1.0
    dish = (radius > 7.05) & (radius < rim - 0.05) & (centre[:, 2] > -7.9) & (centre[:, 2] < 0)
    # Facets of the dish are within the form error of a sphere of 15 mm about the axis.
    z_centre = math.sqrt(15.0**2 - rim**2)
    places = np.concatenate([corners[dish], centre[dish][:, None]], axis=1)
    from_centre = np.linalg.norm(places - [0, 0, z_centre], axis=2)
    assert np.abs(from_centre - 15.0).max() < 2e-3
    assert dish.sum() > 1000
    # The tips follow a convex arc: above the chord between their ends.
    tips = [np.hypot(*outer_polygon(gear.mesh, z).exterior.xy).max() for z in (-7.9, -4.0, -0.1)]
    assert tips[1] > (tips[0] + tips[2]) / 2 + 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_same_parameters_same_bytes(kind):
    first, second = rebuilt(kind, KINDS[kind]).mesh, rebuilt(kind, KINDS[kind]).mesh
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_gears_are_what_they_certify(name):
    gear = shipped(name)
    stated = io.read_toml(resources.find("objects", name))["certified"]
    assert stated == gear.certified
    measured = objects.measure(gear)
    for key, value in stated.items():
        # Stated to a nanometre; the mesh is better.
        assert measured[key] == pytest.approx(value, abs=1e-9), key
    size = np.ptp(gear.mesh.bounds, axis=0)
    assert (size < ([2.0, 2.0, 1.0] if name == "watch-gear" else [60.0, 70.0, 30.0])).all()
    check_pierced_solid(gear.mesh)


@pytest.mark.parametrize("name", SHIPPED)
def test_features_lie_on_their_faces(name):
    gear = shipped(name)
    assert [face.name for face in gear.planes] == ["reference", "hub"]
    rng = np.random.default_rng(1)
    for face in gear.planes:
        places = rng.uniform(*np.transpose([face.x_mm, face.y_mm]), (10, 2))
        heights = objects.surface_height(gear.mesh, places)
        # Ra of 0.8 um on the watch gear: no height beyond six of its sigma.
        assert np.abs(heights - face.z_mm).max() < (6e-3 if name == "watch-gear" else 1e-12)


# --- measurement --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_measurement_reads_the_mesh_and_not_the_parameters(kind):
    gear = rebuilt(kind, KINDS[kind])
    before = objects.measure(gear)
    stretched = Mesh(gear.mesh.vertices * [1.0, 1.0, 1.01], gear.mesh.faces)
    copy = objects.Artefact("a", kind, gear.parameters, stretched, {}, gear.features)
    after = objects.measure(copy)
    along = {"face_width_mm", "lower_lead_mm", "upper_lead_mm", "hub_height_mm"}
    along |= {"reference_ra_um", "hub_ra_um"}
    for key in gear.certified:
        if key not in {"crown_radius_mm", "dish_radius_mm"}:
            factor = 1.01 if key in along else 1.0
            assert after[key] == pytest.approx(factor * before[key], rel=1e-9), key
    # Wider by 1e-4: diameters grow, and so do the teeth between a calliper's jaws.
    wider = Mesh(gear.mesh.vertices * [1.0001, 1.0001, 1.0], gear.mesh.faces)
    copy = objects.Artefact("a", kind, gear.parameters, wider, {}, gear.features)
    after = objects.measure(copy)
    for key in gear.certified:
        if "diameter" in key or "base_tangent" in key:
            assert after[key] == pytest.approx(1.0001 * before[key], rel=1e-9), key


@pytest.mark.parametrize("z", [-7.9, -5.0, -3.3, -0.001, 1.0])
def test_sections_agree_with_trimesh(z):
    mesh = rebuilt("curved_gear", CURVED).mesh
    ours = section(mesh, z)
    cut = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).section([0, 0, 1], [0, 0, z])
    theirs = [shapely.Polygon(loop[:, :2]) for loop in cut.discrete]
    theirs.sort(key=lambda polygon: -polygon.area)
    assert len(ours) == len(theirs)
    for loop, polygon in zip(ours, theirs, strict=True):
        assert shapely.Polygon(loop).area == pytest.approx(polygon.area, rel=1e-6)
    assert shapely.LinearRing(ours[0]).is_ccw
    assert not shapely.LinearRing(ours[-1]).is_ccw


def test_no_section_beside_the_mesh_and_no_circle_through_two_points():
    mesh = rebuilt("gear", KINDS["gear"]).mesh
    assert section(mesh, 100.0) == []
    assert math.isnan(fit_circle(np.zeros((2, 2))))
    points = 3.0 * np.exp(1j * np.array([0.1, 0.2, 0.4, 0.5]))
    assert fit_circle(np.column_stack([points.real + 7, points.imag])) == pytest.approx(3.0)


# --- nonsense -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "change", "key"),
    [
        ("gear", {"teeth": 6, "profile_shift": -0.5, "bore_diameter_mm": 1.0}, "teeth"),
        ("gear", {"teeth": 10, "profile_shift": 0.8, "bore_diameter_mm": 1.0}, "profile_shift"),
        ("gear", {"backlash_mm": 3.0}, "backlash_mm"),
        ("gear", {"root_fillet": 0.6}, "root_fillet"),
        ("gear", {"bore_diameter_mm": 40.0}, "bore_diameter_mm"),
        ("gear", {"bore_diameter_mm": 14.0}, "bore_diameter_mm"),
        ("gear", {"bore_diameter_mm": 32.2, "hub_height_mm": 0.0}, "bore_diameter_mm"),
        ("gear", {"hub_diameter_mm": 33.0}, "hub_diameter_mm"),
        ("gear", {"hub_diameter_mm": None}, "hub_diameter_mm"),
        ("gear", {"hub_height_mm": 1e-9}, "hub_height_mm"),
        ("gear", {"max_form_error_um": 31.0}, "max_form_error_um"),
        ("curved_gear", {"upper_cone_angle_deg": 5.0}, "upper_cone_angle_deg"),
        ("curved_gear", {"rim_width_mm": 9.0}, "rim_width_mm"),
        ("curved_gear", {"face_width_mm": 30.0}, "face_width_mm"),
        ("curved_gear", {"dish_radius_mm": 5.0}, "dish_radius_mm"),
        ("curved_gear", {"hub_rounding_mm": 5.0}, "hub_rounding_mm"),
        ("watch_gear", {"ra_um": 50.0}, "ra_um"),
        ("watch_gear", {"correlation_length_um": 0.5}, "correlation_length_um"),
        ("watch_gear", {"bore_rounding_mm": 0.3}, "bore_rounding_mm"),
        (
            "watch_gear",
            {"hub_height_mm": 0.0, "bore_rounding_mm": 0.56, "face_width_mm": 2.0},
            "bore_rounding_mm",
        ),
    ],
)
def test_nonsense_is_refused_in_one_line(kind, change, key):
    with pytest.raises(InputError, match=key) as caught:
        objects.build_artefact(kind, {**KINDS[kind], **change}, "scene.toml: object")
    assert str(caught.value).startswith("scene.toml: object")
    assert "\n" not in str(caught.value)
