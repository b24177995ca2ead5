"""Elements fitted to exact, noisy, cut and polluted points, against independent fits and draws."""

import numpy as np
import pytest
import trimesh.nsphere
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from skimage.measure import CircleModel, ransac

from slbench.cloud.fits import Circle, Cone, Cylinder, Plane, Sphere, elements, fit_element
from slbench.core.errors import InputError

TURN = Rotation.from_euler("xyz", (40, -70, 20), degrees=True).as_matrix()
PLACE = np.array([10.0, -200.0, 33.0])
#: Where the axis meets z = 0 of the part, and its direction.
AXIS = TURN[:, 2]
TRUE = {
    "plane": Plane(PLACE, AXIS),
    "sphere": Sphere(PLACE, radius=5.0),
    "cylinder": Cylinder(PLACE, AXIS, 5.0),
    "cone": Cone(PLACE, AXIS, 6.0, np.deg2rad(25.0)),
    "circle": Circle(PLACE, AXIS, 5.0),
}
WHOLE, QUARTER = 2.0 * np.pi, 0.5 * np.pi


def points_on(kind, count, rng, arc=WHOLE):
    """Return points (N, 3) on an element over an arc (of a sphere, a cap), and their normals."""
    angle, along = rng.uniform(0.0, arc, count), rng.uniform(-6.0, 6.0, count)
    cos, sin, zero = np.cos(angle), np.sin(angle), np.zeros(count)
    ring = np.column_stack((cos, sin, zero))
    if kind == "plane":
        local = np.column_stack((along, rng.uniform(-3.0, 3.0, count), zero))
        normal = np.broadcast_to([0.0, 0.0, 1.0], local.shape)
    elif kind == "sphere":
        up = rng.uniform(0.8 if arc < WHOLE else -1.0, 1.0, count)
        azimuth = rng.uniform(0.0, WHOLE, count)
        flat = np.sqrt(1.0 - up**2)
        normal = np.column_stack((flat * np.cos(azimuth), flat * np.sin(azimuth), up))
        local = 5.0 * normal
    elif kind == "cone":
        half = np.deg2rad(25.0)
        local = (6.0 + along * np.tan(half))[:, None] * ring + along[:, None] * [0.0, 0.0, 1.0]
        normal = np.cos(half) * ring - np.array([0.0, 0.0, np.sin(half)])
    else:
        along = along if kind == "cylinder" else zero
        local = 5.0 * ring + along[:, None] * [0.0, 0.0, 1.0]
        normal = ring
    return local @ TURN.T + PLACE, normal @ TURN.T


def assert_near(found, true, tolerance):
    """Compare elements that may have their points anywhere along themselves."""
    found = found.at(true.point)
    assert found.point == pytest.approx(true.point, abs=tolerance)
    assert found.radius == pytest.approx(true.radius, abs=tolerance)
    assert found.half_angle == pytest.approx(true.half_angle, abs=tolerance)
    if true.tilts:
        assert np.abs(found.direction @ true.direction) == pytest.approx(1.0, abs=tolerance)


@pytest.mark.parametrize("arc", [WHOLE, QUARTER])
@pytest.mark.parametrize("kind", elements)
def test_exact_points_give_the_element_in_any_pose(kind, arc):
    points, _ = points_on(kind, 400, np.random.default_rng(3), arc)
    fit = fit_element(kind, points)
    # Coordinates of 200 mm carry 3e-14; a quarter's radius has a hundred times its points' errors.
    assert_near(fit.element, TRUE[kind], 1e-9)
    assert fit.inliers.all()
    assert np.abs(fit.residuals).max() < 1e-9
    assert np.sqrt(np.diag(fit.covariance)).max() < 1e-9


@pytest.mark.parametrize("kind", elements)
def test_derivatives_are_those_of_the_distances(kind):
    """By central differences about points that lie a little off the element."""
    rng = np.random.default_rng(5)
    points, _ = points_on(kind, 50, rng)
    points += rng.normal(0.0, 0.2, points.shape)
    element = TRUE[kind]
    _, jacobian = element.linearised(points)
    small = 1e-6
    for k in range(element.parameters()):
        step = small * np.eye(element.parameters())[k]

        # The frame turns about the axis with the element: a circle's residuals do not.
        ahead, _ = element.moved(step).linearised(points)
        behind, _ = element.moved(-step).linearised(points)
        # Second derivatives of 1/mm times 1e-6 mm, squared away by the central difference.
        assert jacobian[..., k] == pytest.approx((ahead - behind) / (2.0 * small), abs=1e-6)


@pytest.mark.parametrize("kind", elements)
def test_normals_point_away_from_the_axis(kind):
    points, normals = points_on(kind, 50, np.random.default_rng(6))
    assert TRUE[kind].normals(points) == pytest.approx(normals, abs=1e-12)


# -- noisy and cut data, against other programs --------------------------------------------------


def noisy(kind, seed=11, count=1500, noise=0.01):
    rng = np.random.default_rng(seed)
    points, normals = points_on(kind, count, rng, QUARTER)
    return points + rng.normal(0.0, noise, (count, 1)) * normals


def turned(angles):
    """Return a direction by two angles, about a pole that the tests' axis is far from."""
    return Rotation.from_euler("xy", angles).as_matrix()[:, 2]


def angles_of(direction):
    return np.array([-np.arcsin(direction[1]), np.arctan2(direction[0], direction[2])])


def test_a_quarter_of_a_cylinder_as_scipy_fits_it():
    points = noisy("cylinder")

    def residuals(x):
        return np.linalg.norm(np.cross(points - x[:3], turned(x[3:5])), axis=1) - x[5]

    # One coordinate too many: the minimum is the same.
    start = np.concatenate((PLACE + 0.3, angles_of(AXIS) + 0.02, [4.5]))
    other = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    fit = fit_element("cylinder", points, start=TRUE["cylinder"])
    # Both minima to rounding of the cost: 1e-8 of a parameter's curvature.
    assert np.sum(fit.residuals**2) == pytest.approx(2.0 * other.cost, rel=1e-9)
    assert fit.element.radius == pytest.approx(other.x[5], abs=1e-6)
    assert abs(fit.element.direction @ turned(other.x[3:5])) == pytest.approx(1.0, abs=1e-9)
    assert fit.residuals == pytest.approx(residuals(other.x), abs=1e-6)


def test_a_quarter_of_a_cone_as_scipy_fits_it():
    points = noisy("cone")

    def residuals(x):
        """Distances from the side by the angle seen from the apex."""
        away = points - x[:3]
        length = np.linalg.norm(away, axis=1)
        angle = np.arccos(away @ turned(x[3:5]) / length)
        return length * np.sin(angle - x[5])

    start = np.concatenate((TRUE["cone"].apex + 0.1, angles_of(AXIS) + 0.01, [0.4]))
    other = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    fit = fit_element("cone", points)
    assert np.sum(fit.residuals**2) == pytest.approx(2.0 * other.cost, rel=1e-9)
    assert fit.element.half_angle == pytest.approx(other.x[5], abs=1e-6)
    assert fit.element.apex == pytest.approx(other.x[:3], abs=1e-5)


def test_a_cap_of_a_sphere_as_scipy_and_trimesh_fit_it():
    points = noisy("sphere")

    def residuals(x):
        return np.linalg.norm(points - x[:3], axis=1) - x[3]

    start = np.append(PLACE + 0.2, 4.0)
    other = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    fit = fit_element("sphere", points)
    assert np.sum(fit.residuals**2) == pytest.approx(2.0 * other.cost, rel=1e-9)
    assert fit.element.point == pytest.approx(other.x[:3], abs=1e-6)
    assert fit.element.radius == pytest.approx(other.x[3], abs=1e-6)
    # trimesh fits squared radii: another estimate, within the two's uncertainty.
    centre, radius, _ = trimesh.nsphere.fit_nsphere(points)
    u = np.sqrt(np.diag(fit.covariance))
    assert (np.abs(fit.element.point - centre) < 2.0 * u[:3]).all()
    assert abs(fit.element.radius - radius) < 2.0 * u[6]


def test_a_plane_as_the_smallest_singular_vector_has_it():
    points = noisy("plane")
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    fit = fit_element("plane", points)
    assert abs(fit.element.direction @ normal) == pytest.approx(1.0, abs=1e-12)
    assert (middle - fit.element.point) @ normal == pytest.approx(0.0, abs=1e-10)


def test_an_arc_with_outliers_as_scikit_image_fits_it():
    """A flat arc: the circle in its plane is that of two dimensions."""
    rng = np.random.default_rng(8)
    points, normals = points_on("circle", 600, rng, QUARTER)
    points += rng.normal(0.0, 0.01, (600, 1)) * normals
    points[:120] += rng.uniform(0.5, 5.0, (120, 1)) * normals[:120]
    flat = ((points - PLACE) @ TURN)[:, :2]
    model, inside = ransac(
        flat, CircleModel, 3, residual_threshold=0.04, max_trials=500, rng=np.random.default_rng(1)
    )
    fit = fit_element("circle", points)
    assert not fit.inliers[:120].any()
    assert np.count_nonzero(inside & fit.inliers) > 470  # of 480
    # Algebraic there, geometric here: another estimate, within the two's uncertainty.
    assert abs(fit.element.radius - model.radius) < 2.0 * np.sqrt(fit.covariance[6, 6])


@pytest.mark.parametrize("arc", [WHOLE, QUARTER])
@pytest.mark.parametrize("kind", elements)
def test_a_fifth_of_gross_outliers_changes_little(kind, arc):
    rng = np.random.default_rng(21)
    points, normals = points_on(kind, 1500, rng, arc)
    points += rng.normal(0.0, 0.01, (1500, 1)) * normals
    polluted = points.copy()
    polluted[:300] += (
        rng.choice((-1.0, 1.0), (300, 1)) * rng.uniform(0.3, 5.0, (300, 1)) * normals[:300]
    )
    clean = fit_element(kind, points[300:])
    fit = fit_element(kind, polluted, at=clean.element.point)
    # Outliers of 30 sigma and more that cross the element elsewhere may be taken for inliers.
    assert np.count_nonzero(fit.inliers[:300]) <= 30
    u = np.sqrt(np.diag(clean.covariance)) + 1e-12
    found, true = fit.element.facing(clean.element.direction), clean.element
    # What crosses moves the element by less than its own uncertainty.
    assert (np.abs(values_of(found) - values_of(true)) < u).all()


# -- covariance ---------------------------------------------------------------------------------


def values_of(element):
    return np.array([*element.point, *element.direction, element.radius, element.half_angle])


def drawn(kind, draws, errors, lines=None):
    """Return the changes (draws, 8) of what was fitted, and the predicted variances (draws, 8)."""
    rng = np.random.default_rng(31)
    points, normals = points_on(kind, 200, rng, QUARTER)
    lines = None if lines is None else lines(points)
    changes, predicted = [], []
    for _ in range(draws):
        moved = points + errors(rng)[:, None] * normals
        if kind == "circle":
            moved += rng.normal(0.0, 0.01, (200, 1)) * AXIS
        fit = fit_element(kind, moved, start=TRUE[kind], at=PLACE, lines=lines)
        changes.append(values_of(fit.element) - values_of(TRUE[kind]))
        predicted.append(np.diag(fit.covariance))
    return np.array(changes), np.array(predicted)


@pytest.mark.parametrize("kind", elements)
def test_covariance_is_that_of_300_draws(kind):
    changes, predicted = drawn(kind, 300, lambda rng: rng.normal(0.0, 0.01, 200))
    predicted = predicted.mean(axis=0)
    told = predicted > 1e-12
    ratio = np.sqrt(changes[:, told].var(axis=0) / predicted[told])
    # A standard deviation of 300 draws is good to 4.1 %; eight of them stay within four such.
    assert (np.abs(ratio - 1.0) < 0.165).all()
    assert np.abs(changes[:, ~told]).max(initial=0.0) < 1e-3


def test_covariance_allows_for_errors_that_go_together_along_lines():
    """Half of an error's variance is one for a line of eight points."""

    def lines(points):
        return np.floor(2.0 * ((points - PLACE) @ AXIS) + 12.0).astype(int)

    own = lines(points_on("cylinder", 200, np.random.default_rng(31), QUARTER)[0])

    def errors(rng):
        return rng.normal(0.0, 0.01, 24)[own] + rng.normal(0.0, 0.01, 200)

    changes, predicted = drawn("cylinder", 300, errors, lines)
    _, naive = drawn("cylinder", 300, errors)
    told = naive.mean(axis=0) > 1e-12
    scatter = changes[:, told].var(axis=0)
    # Student's t of three frequencies widens by 1.62 what 24 lines tell, on average.
    ratio = np.sqrt(predicted[:, told].mean(axis=0) / scatter)
    assert (ratio > 0.9).all()
    assert (ratio < 2.1).all()
    # Taken as independent, the radius would look better than it is by nearly a half.
    assert np.sqrt(naive[:, told].mean(axis=0) / scatter).min() < 0.7


# -- what is refused ---------------------------------------------------------------------------


def test_what_no_element_is_fitted_to_is_refused():
    cloud = np.random.default_rng(0).normal(size=(50, 3))
    for kind, points, message in [
        ("cylnder", cloud, "'cylnder'.*cylinder"),
        ("cylinder", cloud[:5], "at least 6 points, got 5"),
        ("plane", cloud[:, :2], r"finite points \(N, 3\)"),
        ("plane", np.full((9, 3), np.nan), "finite"),
        ("circle", np.zeros((9, 3)), "none goes through"),
    ]:
        with pytest.raises(InputError, match=message):
            fit_element(kind, points)
