"""Declared features of the plate, measured on synthetic points whose errors are known."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slbench import objects
from slbench.cloud.files.measured import MeasuredCloud
from slbench.objects import Dimension
from slbench.objects.declared.declare import declare_features
from slbench.objects.declared.tables import FeatureTable, GrowTable
from slbench.rig import Pose
from slbench.score.clouds.against_part import score_against_part
from slbench.score.features import fit_features

PLATE = objects.load_artefact("feature-plate")
POSE = Pose(
    Rotation.from_euler("XYZ", (-40, 10, 25), degrees=True).as_matrix(), np.array([3.0, -7.0, 11.0])
)
#: True sizes and places, object frame: what the plate's file is built from.
BORES, PIN, CONE, BALL = [(-25.6, -15.0), (-25.6, 15.0)], (9.6, 0.0), (27.2, -15.0), (27.2, 15.0, 2)


def plate_points(rng, count=2000, noise=0.0, **changed):
    """Return points on the true surfaces seen from one side, object frame.

    `changed` moves or resizes what is measured: pin_radius, pin_tilt, pin_top, bore_shift,
    half_angle, ball_radius.
    """
    found = []

    def add(points, normals):
        found.append(points + noise * rng.normal(size=(len(points), 1)) * normals)

    def wall(centre, radius, low, high, tilt=0.0, sign=1.0):
        angle = rng.uniform(-1.0, 2.0, count)
        ring = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(count)))
        height = rng.uniform(low, high, count)
        points = radius * ring + height[:, None] * [tilt, 0.0, 1.0] + [*centre, 0.0]
        add(points, sign * ring)

    up = np.array([0.0, 0.0, 1.0])
    top = np.column_stack(
        (rng.uniform(-16, 2.5, count), rng.uniform(-28, 28, count), np.zeros(count))
    )
    add(top, up)
    shift = changed.get("bore_shift", 0.0)
    wall(BORES[0], 8.0, -8.0, 0.0)
    wall((BORES[1][0], BORES[1][1] + shift), 8.0, -8.0, 0.0)
    wall(PIN, changed.get("pin_radius", 6.0), 0.0, 8.0, changed.get("pin_tilt", 0.0))
    disc = 5.9 * np.sqrt(rng.uniform(0, 1, count))
    angle = rng.uniform(0, 2 * np.pi, count)
    level = np.full(count, changed.get("pin_top", 8.0))
    add(np.column_stack((PIN[0] + disc * np.cos(angle), disc * np.sin(angle), level)), up)
    half = changed.get("half_angle", np.arctan2(6.0, 9.0))
    height, angle = rng.uniform(0.0, 9.0, count), rng.uniform(-1.0, 2.0, count)
    radius = (13.5 - height) * np.tan(half)
    ring = np.column_stack((np.cos(angle), np.sin(angle)))
    add(
        np.column_stack((radius[:, None] * ring + CONE, height)),
        np.column_stack((np.cos(half) * ring, np.full(count, np.sin(half)))),
    )
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    direction[:, 2] = np.abs(direction[:, 2])
    add(changed.get("ball_radius", 8.0) * direction + BALL, direction)
    return np.concatenate(found)


def scores(points, artefact=PLATE, lines=None, pose=POSE):
    found = fit_features(pose.to_world(points), artefact, pose, lines)
    return {(type(f).__name__.removesuffix("Score"), f.name): f for f in found}


def test_exact_points_give_the_nominal_values_in_any_pose():
    found = scores(plate_points(np.random.default_rng(1)))
    # The nominal values are those of the mesh's facets, to 2e-6 mm of the true ones that were
    # drawn; the points' own rounding is far below.
    for name, diameter in (("bore-1", 16.0), ("bore-2", 16.0), ("pin", 12.0)):
        cylinder = found["Cylinder", name]
        assert cylinder.diameter_mm == pytest.approx(diameter, abs=1e-8)
        assert cylinder.diameter_error_mm < 5e-6
        assert cylinder.axis_offset_mm < 1e-5
        assert cylinder.form_mm < 1e-8
    assert found["Cone", "cone"].angle_deg == pytest.approx(
        2 * np.rad2deg(np.arctan2(6, 9)), abs=1e-8
    )
    assert found["Sphere", "ball"].radius_mm == pytest.approx(8.0, abs=1e-8)
    for name, value in (
        ("bore distance", 30.0),
        ("bore 1", 16.0),
        ("pin", 12.0),
        ("pin height", 8.0),
        ("ball", 16.0),
        ("ball to pin", np.hypot(17.6, 15.0)),
        ("squareness of the pin", 0.0),
        ("parallelism of the pin's top", 0.0),
        ("flatness", 0.0),
    ):
        assert found["Dimension", name].measured == pytest.approx(value, abs=1e-6), name
        assert found["Dimension", name].verdict == "within"
    assert found["Dimension", "place of bore 2"].measured < 5e-5
    assert all(one.verdict == "within" for key, one in found.items() if key[0] == "Dimension")


def test_a_part_that_is_otherwise_shows_by_how_much():
    """The pin 40 um thick, leaning by 0.1 mm in 8, 30 um high; a bore 0.2 mm away; a wider cone."""
    other = {"pin_radius": 6.02, "pin_tilt": 0.0125, "pin_top": 8.03, "bore_shift": 0.2}
    other |= {"half_angle": np.arctan2(6.0, 9.0) + 0.004, "ball_radius": 7.99}
    found = scores(plate_points(np.random.default_rng(2), **other))
    lengths = {
        "pin": 0.04,
        "pin height": 0.03,
        "bore distance": 0.2,
        "ball": -0.02,
        # At the bore's middle, 4 mm below the plate's face, the pin's axis is 50 um nearer.
        "place of bore 2": 2.0 * np.hypot(0.2, np.hypot(35.15, 15.2) - np.hypot(35.2, 15.0)),
    }
    for name, deviation in lengths.items():
        # A leaning wall is an ellipse in the plate's plane: its axis and diameter are its own, by
        # tilt^2 / 2 of the radius, 5e-4 mm.
        assert found["Dimension", name].deviation_mm == pytest.approx(deviation, abs=2e-3), name
    # The declared height of the pin is 8 mm; its axis leans by atan(0.0125).
    squareness = found["Dimension", "squareness of the pin"]
    assert squareness.measured == pytest.approx(8.0 * np.sin(np.arctan(0.0125)), abs=1e-3)
    assert found["Dimension", "cone angle"].deviation_deg == pytest.approx(
        np.rad2deg(0.008), abs=1e-4
    )
    names = ("pin", "pin height", "bore distance", "place of bore 2", "cone angle")
    verdicts = [found["Dimension", name].verdict for name in names]
    assert verdicts == ["within", "outside", "outside", "outside", "outside"]


def test_a_fifth_of_gross_errors_changes_little():
    rng = np.random.default_rng(3)
    points = plate_points(rng, noise=0.01)
    clean = scores(points)
    wrong = rng.random(len(points)) < 0.2
    points[wrong] += rng.uniform(-1.0, 1.0, (np.count_nonzero(wrong), 3))
    found = scores(points)
    for key, one in clean.items():
        if key[0] == "Dimension" and one.type in ("distance", "diameter", "height", "angle"):
            # Less points, and a few errors within four deviations: no more than their uncertainty.
            assert abs(found[key].measured - one.measured) < 2.0 * one.uncertainty, key


def test_uncertainties_are_those_of_100_draws():
    rng = np.random.default_rng(4)
    names = ("bore distance", "bore 1", "pin", "pin height", "cone angle", "ball", "ball to pin")
    drawn, told = [], []
    for _ in range(100):
        found = scores(plate_points(rng, 200, noise=0.01))
        own = [found["Dimension", name] for name in names]
        drawn.append([one.measured for one in own])
        told.append([one.uncertainty for one in own])
    ratio = np.std(drawn, axis=0) / np.sqrt(np.mean(np.square(told), axis=0))
    # A deviation of 100 draws is good to 7 %; seven of them stay within four such.
    assert (np.abs(ratio - 1.0) < 0.28).all()
    off = (np.mean(drawn, axis=0) - [30.0, 16.0, 12.0, 8.0, 67.380135, 16.0, 23.124878]) / ratio
    assert (np.abs(off) < 4.0 * np.std(drawn, axis=0) / np.sqrt(100.0) + 1e-5).all()


def with_dimension(**keys):
    base = {"name": "d", "type": "diameter", "of": ("pin",), "nominal": 12.0}
    return dataclasses.replace(PLATE, dimensions=(Dimension(**base | keys),))


@pytest.mark.parametrize(
    ("keys", "verdict"),
    [
        ({}, ""),
        ({"lower": -0.05, "upper": 0.05}, "within"),
        ({"lower": -0.05, "upper": 0.0}, "undecided"),
        ({"upper": -0.05}, "outside"),
        ({"lower": 0.05}, "outside"),
        ({"lower": -0.05, "upper": 0.05, "uncertainty": 0.03}, "undecided"),
        ({"nominal": 12.2, "lower": -0.1, "upper": 0.1}, "outside"),
    ],
)
def test_verdicts_follow_from_deviation_and_both_uncertainties(keys, verdict):
    """A pin as nominal; the fit leaves some micrometres, so that 50 um are far."""
    rng = np.random.default_rng(5)
    found = scores(plate_points(rng, 1000, noise=0.01), with_dimension(**keys))
    assert found["Dimension", "d"].uncertainty < 0.01
    assert found["Dimension", "d"].verdict == verdict


def test_noise_widens_a_form_by_what_is_said_of_it():
    rng = np.random.default_rng(6)
    flat = with_dimension(type="flatness", of=("top",), nominal=0.0, upper=0.02)
    points = plate_points(rng, 4000, noise=0.01)
    one = scores(points, flat)["Dimension", "d"]
    # Six deviations of Gaussian noise, less what two tilts and a height take.
    assert one.measured == pytest.approx(0.0585, rel=0.1)
    assert one.noise == pytest.approx(one.measured, rel=0.15)
    assert one.verdict == "undecided"
    bent = points.copy()
    top = np.abs(points[:, 2]) < 0.1
    bent[top, 2] += 0.4 * (points[top, 1] / 28.0) ** 2
    one = scores(bent, flat)["Dimension", "d"]
    assert one.measured - one.noise < 0.4 < one.measured + 0.06
    assert one.verdict == "outside"


def test_noise_widens_a_parallelism_as_it_does_a_form():
    keys = {"type": "parallelism", "of": ("pin top", "top"), "nominal": 0.0, "upper": 0.02}
    points = plate_points(np.random.default_rng(6), 4000, noise=0.01)
    one = scores(points, with_dimension(**keys))["Dimension", "d"]
    # The faces are parallel: all of the width is noise's.
    assert one.measured > 0.04
    assert one.verdict == "undecided"


def test_a_cloud_of_any_origin_is_measured_alike():
    rng = np.random.default_rng(10)
    points = plate_points(rng, 3000, noise=0.005)
    cloud = MeasuredCloud(points, scalars={"u": np.full(len(points), 0.005)})
    result = score_against_part(cloud, PLATE, placed=True)
    measured = {one.name: one for one in result.score.dimensions}
    assert measured["bore distance"].measured == pytest.approx(30.0, abs=0.005)
    assert {one.name for one in result.score.cylinders} == {"bore-1", "bore-2", "pin"}
    told = dict(zip(*(np.array(result.verdicts().rows, object).T[k] for k in (0, -1)), strict=True))
    assert told["pin height"] == "within"
    assert any(row[0] == "diameter pin" for row in result.features().rows)


def test_faces_across_any_axis_have_an_uncertainty():
    """Two ends of the plate, along x: no stripe along x parts their points."""
    tables = [
        FeatureTable(name=name, type="plane", grow=GrowTable(from_mm=(x, 0.0, -6.0)))
        for name, x in (("left", -40.0), ("right", 40.0))
    ]
    ends = declare_features(tables, PLATE.mesh, dict, [], "test")
    length = Dimension("length", "distance", ("left", "right"), 80.0)
    part = dataclasses.replace(PLATE, declared=ends, dimensions=(length,))
    rng = np.random.default_rng(12)
    off, told = [], []
    for _ in range(40):
        y, z = rng.uniform(-30.0, 30.0, 2000), rng.uniform(-12.0, 0.0, 2000)
        side = np.where(np.arange(2000) < 1000, -40.0, 40.0)
        # Errors go together over 6 mm along y, another draw for each end.
        waves = rng.normal(0.0, 0.01, (2, 10))[(side > 0.0).astype(int), (y // 6.0).astype(int) + 5]
        x = side + waves + rng.normal(0.0, 0.005, 2000)
        cloud = MeasuredCloud(np.column_stack((x, y, z)))
        one = score_against_part(cloud, part, placed=True).score.dimensions[0]
        off.append(one.deviation)
        told.append(one.uncertainty)
    assert np.isfinite(told).all()
    # A deviation of 40 draws is good to 11 %: three times that, and t of few frequencies widens.
    assert 0.7 < np.sqrt(np.mean(np.square(told))) / np.std(off) < 2.0


# -- edges -------------------------------------------------------------------------------------


def face_points(spacing, rng, regular, shift=(0.0, 0.0)):
    """Return points of the top face around the second bore, at a spacing, tilted as pixels are."""
    if regular:
        steps = np.arange(-20.0, 20.0, spacing)
        x, y = (a.ravel() for a in np.meshgrid(steps + rng.uniform(0, spacing), steps * 1.1))
        x, y = x * np.cos(0.3) - y * np.sin(0.3), x * np.sin(0.3) + y * np.cos(0.3)
    else:
        x, y = rng.uniform(-20.0, 20.0, (2, int((40.0 / spacing) ** 2 / 1.1)))
    kept = np.hypot(x, y) > 8.0
    centre = np.add(BORES[1], shift)
    flat = np.column_stack((x[kept] + centre[0], y[kept] + centre[1]))
    inside = (np.abs(flat[:, 0]) < 40.0) & (np.abs(flat[:, 1]) < 30.0)
    return np.column_stack((flat, rng.normal(0.0, 0.005, len(flat))))[inside]


@pytest.mark.parametrize("regular", [True, False])
@pytest.mark.parametrize("spacing", [0.1, 0.25])
def test_the_edge_of_a_bore_is_where_its_face_ends(spacing, regular):
    """No bias by the spacing: the innermost points would be late by half of it."""
    rng = np.random.default_rng(7)
    off, centre = [], []
    for _ in range(12):
        circle = scores(face_points(spacing, rng, regular, (0.1, -0.05)))["Circle", "rim-2"]
        off.append(circle.diameter_deviation_mm / 2.0)
        centre.append(circle.centre_error_mm)
        assert circle.diameter_uncertainty_mm >= 2.0 * 0.8 * spacing / np.sqrt(12.0)
        # Twelve of twelve within three uncertainties: one in 370 a time by chance.
        assert abs(circle.diameter_deviation_mm) < 3.0 * circle.diameter_uncertainty_mm
    assert abs(np.mean(off)) < 0.15 * spacing
    assert np.mean(centre) == pytest.approx(np.hypot(0.1, 0.05), abs=0.25 * spacing)


def test_an_edge_without_points_around_it_is_not_measured():
    rng = np.random.default_rng(8)
    points = face_points(0.2, rng, False)
    assert ("Circle", "rim-2") not in scores(points[:50])
    assert ("Circle", "rim-2") not in scores(points[points[:, 0] > -18.0])


def test_walls_that_few_points_tell_are_left_out():
    rng = np.random.default_rng(9)
    points = plate_points(rng, 500, noise=0.01)
    strip = np.hypot(points[:, 0] - PIN[0], points[:, 1]) < 6.5
    narrow = strip & (np.abs(points[:, 1]) < 0.3)
    found = scores(points[~strip | narrow])
    assert ("Cylinder", "pin") not in found
    assert ("Dimension", "pin") not in found
    assert ("Cylinder", "bore-1") in found
