"""Constraints against dense sampling, an optimiser's distance, and the thesis's tables."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from scipy.stats import ks_2samp, qmc

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.design.rig.constraints import (
    PARTS,
    _constants,
    diagnose,
    explain,
    feasible_sample,
    margins,
)
from slbench.design.rig.convex import coverage, separation
from slbench.design.rig.evaluate import evaluate
from slbench.design.rig.hardware import load_hardware, read_configurations
from slbench.design.rig.kernels.margins import frustum
from slbench.rig import Lens

MACRO = load_hardware("hardware/macro-ch6")
TABLE_4 = read_configurations(resources.find("scenes", "hardware/macro-ch6").parent / "table4.csv")
#: The randomly generated, feasible configuration of thesis 6.2.
FEASIBLE = np.array([810.99, -413.97, -162.56, 159.65, *np.deg2rad([-25.58, 10.89])])
FACE = np.array([[-1.0, -1.0], [1, -1], [1, 1], [-1, 1]])
CUBE = np.concatenate((np.c_[FACE, -np.ones(4)], np.c_[FACE, np.ones(4)]))


def sampled_rows(n, seed):
    rng = np.random.default_rng(seed)
    return MACRO.lower + rng.random((n, 6)) * (np.array(MACRO.upper) - MACRO.lower)


# -- convex shapes ------------------------------------------------------------------------


def test_separation_of_cubes_in_closed_form():
    shifts = [[3, 0, 0], [3, 3, 0], [3, 3, 3], [1.5, 0.3, 0.2], [0, 0, 0], [2, 0, 0]]
    second = CUBE + np.array(shifts)[:, np.newaxis]
    got = separation(np.tile(CUBE, (len(shifts), 1, 1)), second)
    # Face, edge and corner distances; overlaps; touching.
    np.testing.assert_allclose(got, [1, np.sqrt(2), np.sqrt(3), -0.5, -2, 0], atol=1e-12)


def hexahedron(rng):
    """A random oriented box or a frustum, its near face possibly a point."""
    corners = CUBE * rng.uniform(0.3, 2, 3)
    corners[:4, :2] *= rng.choice([1.0, 0.4, 0.0])
    return Rotation.random(random_state=rng).apply(corners) + rng.uniform(-2.5, 2.5, 3)


def distance_by_optimiser(a, b):
    """Distance of two hulls: a quadratic program over convex weights of their corners."""

    def squared(w):
        d = w[:8] @ a - w[8:] @ b
        return d @ d, np.concatenate((2 * a @ d, -2 * b @ d))

    sums = [{"type": "eq", "fun": lambda w, s=s: w[s].sum() - 1} for s in (slice(8), slice(8, 16))]
    start = np.full(16, 1 / 8)
    options = {"ftol": 1e-14, "maxiter": 500}
    found = minimize(
        squared, start, jac=True, bounds=[(0, 1)] * 16, constraints=sums, options=options
    )
    return np.sqrt(found.fun)


def test_separation_is_the_distance_of_what_is_apart():
    rng = np.random.default_rng(3)
    apart = 0
    for _ in range(60):
        a, b = hexahedron(rng), hexahedron(rng)
        got = separation([a], [b])[0]
        expected = distance_by_optimiser(a, b)
        if got > 0:
            apart += 1
            assert got == pytest.approx(expected, abs=2e-4)  # SLSQP's accuracy
        else:
            assert expected < 1e-3
    assert 15 < apart < 55  # both cases were there


def test_an_overlap_is_the_depth_of_the_origin_in_the_minkowski_difference():
    rng = np.random.default_rng(4)
    count = 0
    for _ in range(60):
        a, b = hexahedron(rng), hexahedron(rng)
        hull = ConvexHull((a[:, np.newaxis] - b).reshape(-1, 3))
        depth = np.min(-hull.equations[:, 3])  # Qhull: n . x + offset <= 0 inside, |n| = 1
        got = separation([a], [b])[0]
        assert (got <= 0) == (depth >= 0)
        if depth > 0:
            count += 1
            assert -got == pytest.approx(depth, abs=1e-9)
    assert 5 < count < 55  # both cases were there


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_separation_agrees_with_dense_samples(seed):
    rng = np.random.default_rng(seed)
    a, b = hexahedron(rng), hexahedron(rng)
    got = separation([a], [b])[0]
    assert got == pytest.approx(separation([b], [a])[0], abs=1e-9)
    weights = rng.dirichlet(np.full(8, 0.3), 400)
    difference = (weights @ a)[:, np.newaxis] - (weights @ b)
    nearest = np.sqrt(np.min(np.sum(difference**2, axis=-1)))
    # Samples are inside, so they can only be further apart than the bodies.
    assert nearest >= max(got, 0) - 1e-9
    if got <= 0:
        # Were they apart, some plane would separate all the samples as well.
        normal = a.mean(axis=0) - b.mean(axis=0)
        assert (a @ normal).min() <= (b @ normal).max() + 1e-9


def test_coverage_of_a_panel_in_closed_form():
    # The panel's edges are half a pixel outside its centres.
    square = np.array([[9.5, 9.5], [29.5, 9.5], [29.5, 29.5], [9.5, 29.5], [20.0, 20.0]])
    corner = square - [19.5, 19.5]  # three quarters hang over the corner at (-1/2, -1/2)
    beyond = square + 1000
    diamond = np.array([[20.0, 10], [30, 20], [20, 30], [10, 20], [20, 20]])
    behind = np.full((5, 2), np.nan)
    got = coverage(np.stack((square, corner, beyond, diamond, behind)), 100, 50)
    # corner: what is left spans -1/2..10 on both axes, 10.5 px.
    expected = np.array([400.0, 10.5**2, 0.0, 200.0, np.nan]) / 5000
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_refuses_wrong_shapes():
    with pytest.raises(InputError, match="hexahedra"):
        separation(np.zeros((1, 7, 3)), np.zeros((1, 8, 3)))
    with pytest.raises(InputError, match="points on the panel"):
        coverage(np.zeros((3, 2)), 4, 4)


# -- constraints --------------------------------------------------------------------------


def test_the_thesis_configurations_are_feasible():
    assert np.all(margins(MACRO, TABLE_4) > 0)
    assert np.all(margins(MACRO, FEASIBLE) > 0)
    assert explain(MACRO, TABLE_4[4]) == []


def test_the_printed_working_distance_excludes_six_of_the_eighteen():
    printed = replace(MACRO, camera_distance_mm=(300.0, 700.0))
    assert np.sum(margins(printed, TABLE_4)[:, 1] <= 0) == 6


def test_plane_and_working_distances():
    got = margins(MACRO, TABLE_4)
    for row, margin in zip(TABLE_4, got, strict=True):
        rig = MACRO.rig(row)
        camera, projector = rig.camera.pose.position, rig.projector.pose.position
        assert margin[0] == pytest.approx(min(camera[2], projector[2]))
        near, far = np.linalg.norm(camera), np.linalg.norm(projector)
        assert margin[1] == pytest.approx(min(near - 300, 850 - near, far - 575, 1000 - far))


def in_focus(hardware, rig, points):
    """Whether points are on both panels and sharp on both, (m,): from the devices' own blur."""
    inside = np.ones(len(points), dtype=bool)
    for device in (rig.camera, rig.projector):
        with np.errstate(divide="ignore", invalid="ignore"):
            inside &= device.contains(device.project(points))
            accepted = device.spread.circle(hardware.circle_px)
            inside &= device.circle_of_confusion(points) <= accepted
    return inside


VARIANTS = {
    "thin lenses": MACRO,
    "tilted": replace(MACRO, camera=replace(MACRO.camera, tilt_rad=(0.05, 0.1))),
    "telecentric": replace(
        MACRO, projector=replace(MACRO.projector, lens=Lens.telecentric(0.05, 0.004, 700.0))
    ),
    "pinhole": replace(MACRO, camera=replace(MACRO.camera, lens=Lens(16.0))),
    "fixed focus": replace(
        MACRO,
        camera=replace(MACRO.camera, lens=Lens(16.0, 2.0, 500.0)),
        refocused=(False, True),
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_the_volume_is_in_focus_where_the_devices_say_so(name):
    hardware = VARIANTS[name]
    rows = np.concatenate((TABLE_4, sampled_rows(150, 5)))
    got = margins(hardware, rows)
    seen = set()
    for row, margin in zip(rows, got, strict=True):
        if margin[0] <= 0:
            continue  # a camera behind the plane: its frustum has no image to compare with
        rig = hardware.rig(row)
        expected = bool(np.all(in_focus(hardware, rig, rig.volume_corners)))
        assert (margin[2] > 0) == expected
        seen.add(expected)
    assert seen == {True, False}


def test_the_focus_margin_is_a_distance():
    # Moved by the margin in its worst direction, and no less, a corner leaves the region.
    rng = np.random.default_rng(6)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for row in TABLE_4[::3]:
        rig, margin = MACRO.rig(row), margins(MACRO, row)[0, 2]
        cloud = rig.volume_corners[:, np.newaxis] + 0.999 * margin * directions
        assert np.all(in_focus(MACRO, rig, cloud.reshape(-1, 3)))
        cloud = rig.volume_corners[:, np.newaxis] + 1.2 * margin * directions
        assert not np.all(in_focus(MACRO, rig, cloud.reshape(-1, 3)))


def crowded_rows(n, seed):
    """Configurations whose bodies are often in the way; the camera may stand behind."""
    rng = np.random.default_rng(seed)
    low = [600.0, -200, -150, -600, -0.5, 0.0]
    high = [900.0, 0, 0, 400, 0.0, 0.25]
    return low + rng.random((n, 6)) * (np.subtract(high, low))


def body_points(device, n=9):
    """A lattice of points filling a device's body, (n^3, 3)."""
    x, y, z = device.body_mm
    axes = (np.linspace(-x / 2, x / 2, n), np.linspace(-y / 2, y / 2, n), np.linspace(-z, 0, n))
    return device.pose.to_world(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3))


def in_body(device, points):
    local = device.pose.to_local(points)
    x, y, z = device.body_mm
    sideways = (np.abs(local[:, 0]) <= x / 2) & (np.abs(local[:, 1]) <= y / 2)
    return sideways & (local[:, 2] <= 0) & (local[:, 2] >= -z)


def in_view(device, points, corners):
    """Inside the viewing pyramid, up to the depth of the volume's furthest corner."""
    depth = device.pose.to_local(points)[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return device.contains(device.project(points)) & (
            depth <= device.pose.to_local(corners)[:, 2].max()
        )


def test_obstructions_against_dense_samples():
    rows = crowded_rows(150, 7)
    got = margins(MACRO, rows)
    found = np.zeros(3, dtype=int)
    for row, margin in zip(rows, got, strict=True):
        rig = MACRO.rig(row)
        camera, projector = rig.camera, rig.projector
        corners = rig.volume_corners
        sampled = (
            np.any(in_view(projector, body_points(camera), corners)),
            np.any(in_view(camera, body_points(projector), corners)),
            np.any(in_body(projector, body_points(camera)))
            or np.any(in_body(camera, body_points(projector))),
        )
        for k, overlap in enumerate(sampled):
            if overlap:
                assert margin[3 + k] <= 0
                found[k] += 1
            else:
                # A lattice of spacing s misses an overlap at most about s deep: 25 mm along
                # the projector's 200 mm, 9 mm along the camera's 70 mm.
                assert margin[3 + k] > (-10 if k == 0 else -26)
    assert np.all(found >= 3)


def test_frusta_start_at_the_lens_and_end_behind_the_volume():
    place = MACRO.place(TABLE_4[4])
    rotation, position = place.projector_rotation[0], place.projector_position[0]
    far = ((MACRO.volume_corners - position) @ rotation)[:, 2].max()
    world = np.empty((8, 3))
    frustum(_constants(MACRO, place.optics)[1], 0, far, rotation, position, world)
    np.testing.assert_array_equal(world[:4], np.tile(position, (4, 1)))
    rig = MACRO.rig(TABLE_4[4])
    expected = [[-0.5, -0.5], [639.5, -0.5], [639.5, 479.5], [-0.5, 479.5]]
    np.testing.assert_allclose(rig.projector.project(world[4:]), expected, atol=1e-9)


def test_no_rig_at_all_has_no_margin():
    row = [500.0, 0, 0, 100, -np.pi / 2, 0.2]
    assert np.all(margins(MACRO, row) == -np.inf)
    assert explain(MACRO, row) == ["g1: the projector's axis does not meet the reference plane"]


def test_explain_names_part_and_amount():
    row = TABLE_4[4]
    close = replace(MACRO, camera_distance_mm=(500.0, 850.0))
    distance = MACRO.rig(row).camera_distance
    assert explain(close, row) == [f"{PARTS[2][0]}: {PARTS[2][1]} by {500 - distance:.4g} mm"]


# -- diagnosis ----------------------------------------------------------------------------


def test_diagnosis_of_hardware_that_works():
    found = diagnose(MACRO, n=500)
    assert found.feasible
    assert found.reasons == ()
    assert 0.05 < found.feasible_share < 0.2  # 0.106 of 20,000
    np.testing.assert_array_equal(found.margins, margins(MACRO, found.configuration)[0])
    assert str(found).startswith("feasible")
    assert str(diagnose(MACRO, n=500)) == str(found)  # same seed, same answer


@pytest.mark.parametrize(
    ("change", "constraint", "sentence"),
    [
        ({"projector_distance_mm": (3000.0, 4000.0)}, "g2", "projector is nearer than"),
        ({"camera_distance_mm": (5.0, 20.0)}, "g2", "camera is farther than"),
        ({"volume_mm": (600.0, 700.0, 300.0)}, "g3", "the volume leaves"),
        ({"circle_px": 0.01}, "g3", "depth of field"),
    ],
)
def test_diagnosis_of_hardware_that_cannot_work(change, constraint, sentence):
    found = diagnose(replace(MACRO, **change), n=500)
    assert not found.feasible
    assert found.feasible_share == 0
    assert any(r.startswith(constraint) and sentence in r for r in found.reasons)
    assert f"{constraint}: " in str(found)
    assert "\n" not in str(found)


def test_diagnosis_finds_the_least_infeasible_point():
    # Working distance of the projector beyond what z_ref and alpha_P allow without grazing:
    # the nearest point lacks what the largest distance lacks, known in closed form for fixed
    # angles.
    straight = replace(
        MACRO,
        lower=(250.0, -500.0, -500.0, 0.0, 0.0, np.deg2rad(10)),
        upper=(1000.0, 0.0, 0.0, 500.0, 0.0, np.deg2rad(10)),
        projector_distance_mm=(1200.0, 1400.0),
    )
    found = diagnose(straight, n=500)
    lacking = 1200 - 1000 / np.cos(np.deg2rad(10))
    assert found.margins.min() == pytest.approx(-lacking, rel=1e-3)
    assert "g2 holds nowhere" in str(found)


def test_diagnosis_needs_a_sample():
    with pytest.raises(InputError, match="number of configurations"):
        diagnose(MACRO, n=0)


# -- feasible configurations --------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 7, 1000])
def test_a_sample_has_as_many_rows_as_asked_and_all_are_feasible(count):
    # 1000 of 4096 points are more than one round of draws has feasible ones (0.106).
    rows = feasible_sample(MACRO, count, seed=3)
    assert rows.shape == (count, 6)
    assert np.all((rows >= MACRO.lower) & (rows <= MACRO.upper))
    found = evaluate(MACRO, rows)
    assert found.feasible.all()
    assert np.all(found.margins > 0)
    assert len(np.unique(rows, axis=0)) == count


def test_a_sample_is_its_seeds():
    first = feasible_sample(MACRO, 50, seed=1)
    np.testing.assert_array_equal(feasible_sample(MACRO, 50, seed=1), first)
    other = feasible_sample(MACRO, 50, seed=2)
    assert not np.isin(other, first).any()
    np.testing.assert_array_equal(feasible_sample(MACRO, 50), feasible_sample(MACRO, 50, seed=0))


def test_a_sample_is_even_over_what_is_feasible():
    rows = feasible_sample(MACRO, 1000, seed=4)
    # The same region from points that are even by construction, a Sobol sequence's.
    points = qmc.Sobol(6, rng=np.random.default_rng(5)).random_base2(14)
    even = qmc.scale(points, MACRO.lower, MACRO.upper)
    even = even[np.all(margins(MACRO, even) > 0, axis=1)]
    assert len(even) > 1000
    # Six Kolmogorov-Smirnov tests: a false alarm of one in a thousand altogether.
    for name, ours, theirs in zip("zwhlab", rows.T, even.T, strict=True):
        assert ks_2samp(ours, theirs).pvalue > 1e-3 / 6, name
    # And it is wide: three quarters of every range.
    assert np.all(np.ptp(rows, axis=0) > 0.75 * np.subtract(MACRO.upper, MACRO.lower))


def test_a_sample_of_hardware_that_cannot_work_is_refused_in_one_line():
    with pytest.raises(InputError) as error:
        feasible_sample(replace(MACRO, camera_distance_mm=(5.0, 20.0)), 3)
    line = str(error.value)
    assert "\n" not in line
    assert line.startswith(
        "hardware: expected 3 feasible configurations among 131072 drawn, got none"
    )
    assert "g2: the camera is farther than its longest working distance by " in line


@pytest.mark.parametrize("count", [0, -1])
def test_a_sample_needs_a_number(count):
    with pytest.raises(InputError, match="number of configurations: expected at least 1"):
        feasible_sample(MACRO, count)
