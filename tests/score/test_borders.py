"""Clouds end at edges and shadows, with points that are measured between two things there."""

import numpy as np
import pytest

import slbench as sl
from slbench.cloud import MeasuredCloud
from slbench.core.io import read_json
from slbench.objects import load_artefact
from slbench.score.clouds.against_part import score_against_part
from slbench.score.clouds.borders import _spacing, inner_points, surrounded
from slbench.simulate.folder import write_scan
from slbench.simulate.scan import scan

PLATE = load_artefact("feature-plate")
#: Level of the plate's top, and a shadow on it: its middle and radius.
SHADOW, RADIUS = np.array([-8.0, 5.0]), 4.0


def lattice(spacing, rng, turn=0.4):
    steps = np.arange(-40.0, 40.0, spacing)
    x, y = (a.ravel() for a in np.meshgrid(steps + rng.uniform(0, spacing), 1.3 * steps))
    return np.column_stack(
        (x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn))
    )


@pytest.mark.parametrize("regular", [True, False])
def test_points_are_told_that_have_others_on_all_sides(regular):
    """A disc with a hole: what is two spacings from both edges stays, what is beside one goes."""
    rng = np.random.default_rng(1)
    flat = lattice(0.5, rng) if regular else rng.uniform(-40.0, 40.0, (20_000, 2))
    spacing = 0.5 * np.sqrt(1.3) if regular else 80.0 / np.sqrt(20_000)
    radial = np.linalg.norm(flat, axis=1)
    flat, radial = (a[(radial > 5.0) & (radial < 20.0)] for a in (flat, radial))
    away = np.minimum(radial - 5.0, 20.0 - radial) / spacing
    fine = surrounded(flat)
    # By the window a straight edge is left out to 2.25 spacings; rows of points come one at a time.
    assert not fine[away < 1.0].any() if regular else np.mean(fine[away < 1.0]) < 0.05
    assert fine[away > 3.5].all() if regular else np.mean(fine[away > 3.5]) > 0.995


def test_single_missing_points_are_no_edge():
    rng = np.random.default_rng(2)
    flat = lattice(0.5, rng)
    flat = flat[(np.abs(flat) < 20.0).all(axis=1)]
    held = flat[rng.random(len(flat)) > 0.05]
    inside = (np.abs(held) < 17.0).all(axis=1)
    assert np.mean(surrounded(held)[inside]) > 0.995


@pytest.mark.parametrize("ratio", [2, 3, 4])
@pytest.mark.parametrize("regular", [True, False])
def test_views_that_overlap_leave_no_edge_where_they_end(ratio, regular):
    """One half is denser: both are kept, and where they meet; ends of both are not."""
    rng = np.random.default_rng(4)
    spacing = 0.3 * np.sqrt(1.3)
    coarse = spacing * np.sqrt(ratio)
    if regular:
        halves = [lattice(0.3, rng), lattice(0.3 * np.sqrt(ratio), rng, turn=1.0)]
    else:
        count = int((80.0 / spacing) ** 2)
        halves = [rng.uniform(-40.0, 40.0, (n, 2)) for n in (count, count // ratio)]
    halves = [one[(np.abs(one) < 20.0).all(axis=1)] for one in halves]
    dense, sparse = halves[0][halves[0][:, 0] < 0.0], halves[1][halves[1][:, 0] >= 0.0]
    flat = np.concatenate((dense, sparse))
    fine, away = surrounded(flat), 20.0 - np.abs(flat).max(axis=1)
    # As of one density, in spacings of the sparse half.
    inside, side = away > 3.5 * coarse, flat[:, 0] < 0.0
    for part in (side, ~side, np.abs(flat[:, 0]) < 3.0 * coarse):
        assert np.mean(fine[inside & part]) > 0.99
    assert np.mean(fine[away < spacing]) < 0.05


@pytest.mark.parametrize("side", [8, 12, 20, 60])
def test_windows_of_a_small_face_are_no_wider(side):
    """Edges have fewer neighbours, and are no sparse part: the spacing of few points is theirs."""
    steps = np.arange(side, dtype=float)
    flat = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    # Twelve neighbours of a square grid are two spacings far, by a disc of 12.5 points: 1.002; of
    # eight by eight points a fourth has all of them.
    assert _spacing(flat) == pytest.approx(1.0, rel=0.1)


def test_a_wall_all_around_has_no_edge_where_its_angle_starts_again():
    rng = np.random.default_rng(3)
    turn = 2.0 * np.pi * 6.0
    flat = np.column_stack((rng.uniform(0.0, turn, 8000) - turn / 2.0, rng.uniform(0, 20, 8000)))
    inside = np.abs(flat[:, 1] - 10.0) < 8.0
    seam = inside & (np.abs(flat[:, 0]) > turn / 2.0 - 0.3)
    assert np.mean(surrounded(flat, turn)[seam]) > 0.99
    assert np.mean(surrounded(flat)[seam]) < 0.5


def plate_cloud(rng, spacing=0.4, mixed=True, dent=0.0):
    """Return a cloud of the plate's top and the pin's, with a shadow; points beside ends mixed."""
    flat = lattice(spacing, rng)
    flat = flat[(np.abs(flat[:, 0] + 6.5) < 9.5) & (np.abs(flat[:, 1]) < 28.0)]
    pin = np.linalg.norm(flat - (9.6, 0.0), axis=1)
    into = np.linalg.norm(flat - SHADOW, axis=1) - RADIUS
    flat = flat[(into > 0.0) & (pin > 6.5)]
    away = np.minimum(into[(into > 0.0) & (pin > 6.5)], flat[:, 0] + 16.0)
    z = rng.normal(0.0, 0.01, len(flat))
    z -= dent * (np.linalg.norm(flat - (-10.0, -12.0), axis=1) < 3.0)
    top = lattice(spacing, rng)
    into_pin = 6.0 - np.linalg.norm(top - (9.6, 0.0), axis=1)
    top, into_pin = top[into_pin > 0.0], into_pin[into_pin > 0.0]
    points = np.concatenate(
        (
            np.column_stack((flat, z)),
            np.column_stack((top, 8.0 + rng.normal(0.0, 0.01, len(top)))),
        )
    )
    if mixed:
        beside = np.concatenate((away, into_pin)) < spacing
        points[beside, 2] += rng.uniform(-0.7, 0.2, np.count_nonzero(beside))
    return MeasuredCloud(points, scalars={"u": np.full(len(points), 0.01)})


def told(cloud):
    result = score_against_part(cloud, PLATE, placed=True)
    return result, {one.name: one for one in result.score.dimensions}


def test_mixed_points_at_edges_and_shadows_say_nothing_of_a_face():
    result, found = told(plate_cloud(np.random.default_rng(4)))
    clean = told(plate_cloud(np.random.default_rng(4), mixed=False))[1]
    for name in ("flatness", "parallelism of the pin's top"):
        # The same points but for some at the edges; ranges of noise, of 10 um, 0.1 mm allowed.
        assert found[name].measured == pytest.approx(clean[name].measured, abs=0.01), name
        assert found[name].verdict == "within", name
    assert result.near_edges > 0
    assert ("near edges and gaps, not in features", f"{result.near_edges}") in result.rows()


def test_a_dent_within_a_face_stays_in_its_form():
    _, found = told(plate_cloud(np.random.default_rng(5), dent=0.3))
    assert found["flatness"].measured > 0.3
    assert found["flatness"].verdict == "outside"


def test_a_feature_that_edges_eat_up_is_said_to_be_too_small():
    cloud = plate_cloud(np.random.default_rng(6), spacing=1.6)
    counts = inner_points(cloud.points, PLATE).counts["pin top"]
    assert counts[0] >= 20 > counts[0] - counts[1]  # what the test is about
    result, found = told(cloud)
    assert "pin height" not in found
    assert result.unmeasured["plane[pin top]"].startswith("too small")
    assert result.unmeasured["dimension[pin height]"] == "undecided: pin top not measured"
    assert result.unmeasured["cylinder[pin]"] == "0 points on it, 20 are needed"
    assert "pin height" in str(result.missing().rows)
    assert result.to_dict()["unmeasured"]["dimension[pin height]"].startswith("undecided")


@pytest.fixture(scope="module")
def plate_scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plate") / "scan"
    write_scan(scan(sl.load_scene("feature-plate", preview=True)), folder, picture=False)
    return folder


@pytest.mark.slow
def test_a_bare_cloud_has_the_features_of_the_scan(plate_scan):
    stored = read_json(plate_scan / "score.json")
    result = sl.score_cloud(plate_scan / "cloud.ply", artefact="feature-plate")
    for kind in ("planes", "cylinders", "cones", "circles", "dimensions"):
        found = {one.name: one for one in getattr(result.score, kind)}
        for one in stored[kind]:
            own = found[one["name"]]
            # The same points but for some hundred at edges: a fourth of a width by noise at most.
            if kind == "planes":
                assert own.flatness_mm == pytest.approx(one["flatness_mm"], rel=0.25)
            elif kind == "dimensions":
                unsure = np.hypot(own.uncertainty, one["uncertainty"])
                assert abs(own.measured - one["measured"]) <= 2.0 * unsure, one["name"]
                assert own.verdict == one["verdict"], one["name"]
            elif kind == "cones":
                unsure = np.hypot(own.angle_uncertainty_deg, one["angle_uncertainty_deg"])
                assert abs(own.angle_deg - one["angle_deg"]) <= 2.0 * unsure
            else:
                unsure = np.hypot(own.diameter_uncertainty_mm, one["diameter_uncertainty_mm"])
                assert abs(own.diameter_mm - one["diameter_mm"]) <= 2.0 * unsure
    # A perfect plate is outside of no tolerance.
    assert not any(one.verdict == "outside" for one in result.score.dimensions)
