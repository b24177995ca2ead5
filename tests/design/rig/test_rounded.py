"""Signed distances of barrels, boxes and frusta: closed forms, hulls, bounds by many directions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from slbench.core.errors import InputError
from slbench.design.rig.constraints import Constraints, margins
from slbench.design.rig.convex import separation
from slbench.design.rig.hardware import load_hardware
from slbench.design.rig.kernels.rounded import signed_distance
from slbench.design.rig.optimise import footprint_mm
from slbench.rig import Camera, Lens, Pose, Rig
from slbench.rig.opencv import read_rig, write_rig

MICRO = load_hardware("hardware/micro-ch8")
BARREL = ((0.0, 10.5), (20.0, 17.0), (75.0, 17.0))
OBJECTIVES = replace(
    MICRO,
    camera=replace(MICRO.camera, barrel_mm=BARREL),
    projector=replace(MICRO.projector, barrel_mm=BARREL),
)
Z = np.array([0.0, 0.0, 1.0])
FACE = np.array([[-1.0, -1.0], [1, -1], [1, 1], [-1, 1]])
CUBE = np.concatenate((np.c_[FACE, -np.ones(4)], np.c_[FACE, np.ones(4)]))


def frustum(start, end, first, second):
    ends = np.array([start, end], dtype=float)
    axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return ends, np.array([first, second], dtype=float), axis


def polytope(corners):
    return np.asarray(corners, dtype=float), np.zeros(len(corners)), Z


def distance(first, second):
    return signed_distance(first, second, np.inf)


def test_closed_forms():
    upright = frustum((0, 0, 0), (0, 0, 4), 1, 1)
    close = pytest.approx
    # Cylinders beside, above, across each other; a cone's slope; rims at right angles.
    assert distance(upright, frustum((5, 0, 0), (5, 0, 4), 2, 2)) == close(2.0, abs=1e-7)
    assert distance(upright, frustum((0, 0, 6), (0, 0, 8), 3, 1)) == close(2.0, abs=1e-7)
    assert distance(upright, frustum((3, -9, 2), (3, 9, 2), 0.5, 0.5)) == close(1.5, abs=1e-7)
    cone = frustum((0, 0, 0), (0, 0, 4), 3, 0)
    point = polytope(np.tile([3.0, 0.0, 4.0], (8, 1)))
    assert distance(cone, point) == close(12 / 5, abs=1e-7)  # from 4 x + 3 z = 12
    # Overlaps: sideways by 1.5 of two radii 1 and 2; an axis through a large box.
    assert distance(upright, frustum((1.5, 0, -9), (1.5, 0, 9), 2, 2)) == close(-1.5, abs=1e-7)
    assert distance(upright, polytope(10.0 * CUBE + [0, 0, 9])) == close(-5.0, abs=1e-7)
    assert distance(upright, frustum((2, 0, 0), (2, 0, 4), 1, 1)) == close(0.0, abs=1e-6)


def hexahedron(rng):
    corners = CUBE * rng.uniform(0.3, 2, 3)
    corners[:4, :2] *= rng.choice([1.0, 0.4, 0.0])
    return Rotation.random(random_state=rng).apply(corners) + rng.uniform(-2.5, 2.5, 3)


def test_polytopes_have_the_distance_of_separating_axes():
    rng = np.random.default_rng(0)
    pairs = [(hexahedron(rng), hexahedron(rng)) for _ in range(500)]
    ours = [distance(polytope(a), polytope(b)) for a, b in pairs]
    theirs = separation([a for a, _ in pairs], [b for _, b in pairs])
    np.testing.assert_allclose(ours, theirs, atol=1e-7)
    assert 100 < np.count_nonzero(theirs > 0) < 450


def support(body, directions):
    points, radii, axis = body
    across = np.sqrt(np.maximum(1.0 - (directions @ axis) ** 2, 0.0))
    return np.max(directions @ points.T + radii * across[:, None], axis=1)


def rims(body, n=40):
    points, radii, axis = body
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    turn = 2 * np.pi * np.arange(n) / n
    circle = np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * np.cross(axis, u)
    return np.concatenate([p + r * circle for p, r in zip(points, radii, strict=True)])


def test_barrels_lie_between_bounds():
    """Above: the gap along any direction.  Below: the depth in hulls of points on the rims."""
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    counts = np.zeros(2, dtype=int)
    for k in range(120):
        start, along = rng.uniform(-2.5, 2.5, 3), rng.normal(size=3)
        first = frustum(start, start + along, *rng.uniform(0.05, 1.5, 2))
        start, along = rng.uniform(-2.5, 2.5, 3), rng.normal(size=3)
        second = frustum(start, start + along, *rng.uniform(0.05, 1.5, 2))
        if k % 2:
            second = polytope(hexahedron(rng))
        got = distance(first, second)
        gap = np.max(-support(first, directions) - support(second, -directions))
        a, b = rims(first), second[0] if k % 2 else rims(second)
        hull = ConvexHull((a[:, None] - b).reshape(-1, 3)).equations
        # Rims of 40 points are 1 - cos(4.5 deg) = 0.3 % of a radius of up to 1.5 too small.
        if got > 0:
            assert got >= gap - 1e-9
            # A direction is some 0.05 rad from the nearest of 4000, at bodies of such a size.
            assert got <= gap + 0.05 * (np.ptp(a, axis=0).max() + np.ptp(b, axis=0).max())
            assert np.max(hull[:, 3]) >= -1e-9 or got < 0.01
        else:
            depth = np.min(-hull[:, 3])
            assert depth - 1e-9 <= -got <= depth + 0.01
            assert -got <= -gap + 1e-9
        counts[int(got > 0)] += 1
    assert counts.min() > 12


def test_quick_margins_have_the_signs_of_exact_ones():
    rng = np.random.default_rng(1)
    low, high = OBJECTIVES.bounds
    place = OBJECTIVES.place(low + (high - low) * rng.random((400, 6)))
    constraints = Constraints(OBJECTIVES)
    exact, quick = constraints.margins(place), constraints.margins(place, exact=False)
    np.testing.assert_array_equal(exact > 0, quick > 0)
    assert (quick <= exact + 1e-7).all()
    assert {True, False} == set((exact[:, 5] > 0).tolist())


def lattice(device, n=21):
    """Return points that fill a barrel, (m, 3)."""
    places, radii = np.transpose(device.barrel_mm)
    behind = np.linspace(places[0], places[-1], 3 * n)
    u = np.linspace(-1.0, 1.0, n)
    x, y, z = (a.ravel() for a in np.meshgrid(u, u, behind, indexing="ij"))
    inside = np.hypot(x, y) <= 1.0
    radius = np.interp(z, places, radii)
    return device.pose.to_world(np.column_stack((radius * x, radius * y, -z))[inside])


def test_obstructions_of_barrels_against_dense_samples():
    rng = np.random.default_rng(3)
    low, high = OBJECTIVES.bounds
    rows = low + (high - low) * rng.random((60, 6))
    found = np.zeros(2, dtype=int)
    for row, margin in zip(rows, margins(OBJECTIVES, rows), strict=True):
        rig = OBJECTIVES.rig(row)
        overlap = rig.projector.in_body(lattice(rig.camera)).any()
        found[int(overlap)] += 1
        if overlap:
            assert margin[5] <= 0
        else:
            # Points 1.7 mm apart miss an overlap some that deep.
            assert margin[5] > -1.7
    assert found.min() > 5


def test_two_barrels_on_one_point_touch_where_their_rims_meet():
    """Fronts of radius r at distance d from the point meet at an angle of 2 atan(r / d)."""
    half = np.arctan(10.5 / 20.0)
    for turn, sign in ((1.001, 1), (0.999, -1)):
        poses = [
            Pose.looking_at(
                (20 * np.sin(s * half * turn), 0, 20 * np.cos(s * half * turn)),
                (0, 0, 0),
                (0, 1, 0),
            )
            for s in (-1, 1)
        ]
        bodies = []
        for pose in poses:
            ends = pose.to_world(np.array([[0, 0, 0], [0, 0, -20.0]]))
            bodies.append((ends, np.array([10.5, 17.0]), np.ascontiguousarray(pose.rotation[:, 2])))
        gap = distance(*bodies)
        assert np.sign(gap) == sign
        assert abs(gap) < 0.05


def test_footprint_of_barrels_is_that_of_their_points():
    rng = np.random.default_rng(2)
    low, high = OBJECTIVES.bounds
    rows = low + (high - low) * rng.random((20, 6))
    got = footprint_mm(OBJECTIVES, OBJECTIVES.place(rows))
    for row, extent in zip(rows, got, strict=True):
        rig = OBJECTIVES.rig(row)
        bodies = (rig.camera.body_corners, rig.projector.body_corners)
        points = np.concatenate((*bodies, rig.volume_corners))
        # Rims of 48 points: 1 - cos(3.75 deg) of 17 mm at either end.
        assert extent == pytest.approx(np.ptp(points[:, :2], axis=0).max(), abs=0.08)


def test_a_barrel_is_read_and_written_and_takes_the_place_of_a_box(tmp_path):
    rig = Rig(OBJECTIVES.camera, OBJECTIVES.projector)
    write_rig(tmp_path / "rig.yaml", rig)
    assert read_rig(tmp_path / "rig.yaml").camera.barrel_mm == BARREL
    camera = OBJECTIVES.camera
    assert camera.body_mm is not None
    np.testing.assert_array_equal(
        camera.in_body([[0, 0, -1], [0, 0, 1], [16.0, 0, -1], [16.0, 0, -30], [0, 0, -76]]),
        [True, False, False, True, False],
    )
    assert len(camera.body_parts) == 2


@pytest.mark.parametrize("barrel", [((0.0, 1.0), (0.0, 2.0)), ((5.0, 1.0), (1.0, 1.0))])
def test_a_barrel_goes_backwards_only(barrel):
    with pytest.raises(InputError, match="barrel_mm: expected distances that rise"):
        Camera(64, 48, (0.01, 0.01), Lens(16.0), barrel_mm=barrel)
