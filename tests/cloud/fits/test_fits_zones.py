"""Minimum zones against brute force over the hull, closed forms and what no search improves."""

import itertools

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from slbench.cloud.fits import Circle, Cylinder, Plane, Sphere, fit_element, minimum_zone
from slbench.core.errors import InputError

TURN = Rotation.from_euler("xyz", (30, 20, -50), degrees=True).as_matrix()
PLACE = np.array([100.0, -30.0, 7.0])


def width_by_brute_force(points):
    """Return the least width over normals of vertex triples and common normals of edge pairs."""
    corners = points[ConvexHull(points).vertices]
    pairs = list(itertools.combinations(range(len(corners)), 2))
    edges = corners[[j for _, j in pairs]] - corners[[i for i, _ in pairs]]
    # A triple's normal is that of two of its edges: pairs of edges hold both.
    first, second = np.triu_indices(len(edges), 1)
    normals = np.cross(edges[first], edges[second])
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 1e-12 * length.max()]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return min(np.ptp(corners @ part.T, axis=0).min() for part in np.array_split(normals, 50))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("thick", [0.01, 0.5, 5.0])
def test_flatness_is_that_of_brute_force(seed, thick):
    """Slabs from thin to as thick as wide, where many directions compete."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (14, 3)) * [10.0, 6.0, thick] @ TURN.T + PLACE
    plane = fit_element("plane", points, start=Plane(PLACE, TURN[:, 2])).element
    found, width = minimum_zone(plane, points)
    # Both enumerate; coordinates of 100 mm carry 1e-14.
    assert width == pytest.approx(width_by_brute_force(points), rel=1e-9)
    heights = found.distances(points)
    assert heights.max() == pytest.approx(width / 2.0, rel=1e-9)
    assert heights.min() == pytest.approx(-width / 2.0, rel=1e-9)


def test_flatness_of_what_is_known():
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-10, 10, 21), np.linspace(-5, 5, 11)))
    plane = Plane(PLACE, TURN[:, 2])

    def placed(z):
        return np.column_stack((x, y, z)) @ TURN.T + PLACE

    # A plane, in rounding of 100 mm; a gable, whose ridge and eaves touch; a saddle.
    assert minimum_zone(plane, placed(0.3 * x - 0.1 * y))[1] < 1e-12
    assert minimum_zone(plane, placed(-0.02 * np.abs(x)))[1] == pytest.approx(0.2, rel=1e-9)
    assert minimum_zone(plane, placed(1e-3 * x * y))[1] == pytest.approx(0.1, rel=1e-9)


def test_flatness_of_many_points_is_never_above_that_of_least_squares():
    rng = np.random.default_rng(4)
    points = rng.uniform(-1.0, 1.0, (20_000, 3)) * [20.0, 10.0, 0.0]
    points[:, 2] += rng.normal(0.0, 0.005, 20_000)
    fit = fit_element("plane", points)
    found, width = minimum_zone(fit.element, points)
    assert 0.8 * np.ptp(fit.residuals) < width < np.ptp(fit.residuals)
    # No direction near it does better.
    for tilt in rng.normal(0.0, 1e-4, (200, 3)):
        normal = found.direction + tilt
        assert np.ptp(points @ normal) / np.linalg.norm(normal) > width - 1e-12


def lobed(count, lobes, depth, arc=2.0 * np.pi):
    angle = np.linspace(0.0, arc, count, endpoint=arc < 6.0)
    radius = 8.0 + 0.5 * depth * np.cos(lobes * angle)
    flat = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)))
    return flat @ TURN.T + PLACE


@pytest.mark.parametrize(("lobes", "depth"), [(3, 0.02), (5, 0.1)])
def test_roundness_of_a_lobed_circle_is_its_depth(lobes, depth):
    points = lobed(120 * lobes, lobes, depth)
    start = fit_element("circle", points).element
    found, width = minimum_zone(start, points)
    # Highest and lowest points alternate about the true centre; extremes are on the grid.
    assert width == pytest.approx(depth, rel=1e-9)
    assert found.radius == pytest.approx(8.0, rel=1e-9)
    assert found.point == pytest.approx(PLACE, abs=1e-9)


@pytest.mark.parametrize("arc", [2.0 * np.pi, 2.0])
def test_no_search_finds_a_narrower_ring(arc):
    rng = np.random.default_rng(9)
    points = lobed(300, 2, 0.05, arc) + rng.normal(0.0, 0.01, (300, 3))
    start = fit_element("circle", points).element
    _, width = minimum_zone(start, points)
    flat = start.local(points)[:, :2]

    def ring(centre):
        return np.ptp(np.linalg.norm(flat - centre, axis=1))

    options = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 5000, "maxfev": 5000}
    tries = rng.normal(0.0, 0.1, (8, 2))
    least = min(minimize(ring, c, method="Nelder-Mead", options=options).fun for c in tries)
    # A simplex in two dimensions stalls at kinks: it may end above, never below.
    assert width <= least + 1e-9
    assert width > 0.5 * least


def test_cylindricity_and_sphericity_of_what_is_known():
    angle, height = (
        a.ravel() for a in np.meshgrid(np.linspace(0, 2 * np.pi, 73)[:-1], range(-9, 10))
    )
    radius = 8.0 + 0.03 * np.cos(4 * angle)
    barrel = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), height))
    points = barrel @ TURN.T + PLACE
    found, width = minimum_zone(fit_element("cylinder", points).element, points)
    # Four lobes over the whole length allow no better axis.
    assert width == pytest.approx(0.06, rel=1e-6)
    assert found.radius == pytest.approx(8.0, abs=1e-6)
    assert isinstance(found, Cylinder)

    ball = np.random.default_rng(2).normal(size=(4000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    # The six ends of an ellipsoid's axes, two of each, decide: the centre stays.
    ball = np.vstack((ball, np.eye(3), -np.eye(3)))
    points = ball * [8.0, 8.0, 8.05] + PLACE
    found, width = minimum_zone(Sphere(PLACE + 0.01, radius=8.0), points)
    assert width == pytest.approx(0.05, rel=1e-6)


def test_a_cylinder_zone_beats_least_squares_and_no_draw_beats_it():
    rng = np.random.default_rng(12)
    angle, height = rng.uniform(0, 1.5, 3000), rng.uniform(-5, 5, 3000)
    radius = 6.0 + rng.normal(0.0, 0.005, 3000)
    points = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), height))
    fit = fit_element("cylinder", points)
    found, width = minimum_zone(fit.element, points)
    assert width < np.ptp(fit.residuals)
    for step in rng.normal(0.0, 1e-4, (300, 5)):
        assert np.ptp(found.moved(step).distances(points)) > width - 1e-9


def test_too_few_points_are_refused():
    with pytest.raises(InputError, match=r"minimum zone of a plane: expected more than 3 points"):
        minimum_zone(Plane([0, 0, 0], [0, 0, 1]), np.eye(3))
    with pytest.raises(InputError, match="circle"):
        minimum_zone(Circle([0, 0, 0], [0, 0, 1], 1.0), np.eye(3))
