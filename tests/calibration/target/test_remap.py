"""Re-mapping to the panel against the thesis's own system of equations, and its deviations."""

import numpy as np
import pytest

from slbench.calibration.target.remap import remap
from slbench.core.errors import InputError
from slbench.patterns import PhaseMap


def phase_map(u: np.ndarray, v: np.ndarray | None = None, sigma: float = 0.1) -> PhaseMap:
    axes = {"u": u} if v is None else {"u": u, "v": v}
    mask = np.isfinite(u)
    return PhaseMap(
        coordinate=dict(axes),
        sigma={axis: np.where(mask, sigma, np.nan) for axis in axes},
        modulation=np.ones(u.shape),
        mean=np.ones(u.shape),
        mask=mask,
        relative={},
    )


def plane(shape: tuple[int, int], a: float, b: float, c: float = 0.0) -> np.ndarray:
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    return a * u + b * v + c * u * v + 7.0


def test_the_thesis_equations():
    rng = np.random.default_rng(0)
    u, v = rng.uniform(100, 900, (2, 40, 50))
    sigma = rng.uniform(0.05, 0.2, (40, 50))
    phase = phase_map(u, v)
    phase.sigma["u"][:] = sigma
    centres = rng.uniform(0.0, 39.0, (30, 2))
    points = remap(centres, phase)
    assert points.axes == ("u", "v")
    for k, (x, y) in enumerate(centres):
        i, j = np.meshgrid(np.floor([x, x + 1]).astype(int), np.floor([y, y + 1]).astype(int))
        i, j = i.ravel(), j.ravel()
        matrix = np.stack((np.ones(4), i, j, i * j), axis=1)  # thesis eq. 35
        terms = np.array([1.0, x, y, x * y])
        for axis, image in enumerate((u, v)):
            expected = terms @ np.linalg.solve(matrix, image[j, i])
            # The system's condition is 1e7 here, ours is 1.
            assert points.coordinates[k, axis] == pytest.approx(expected, abs=1e-7)
        row = terms @ np.linalg.inv(matrix)
        assert points.sd[k, 0] == pytest.approx(np.hypot.reduce(row * sigma[j, i]), abs=1e-7)


def test_on_pixels_borders_and_masks():
    u = plane((6, 8), 2.0, 0.5)
    phase = phase_map(u)
    corners = [[0.0, 0.0], [7.0, 5.0], [7.0, 2.5], [3.0, 4.0]]
    np.testing.assert_allclose(
        remap(corners, phase).coordinates[:, 0], [7.0, 23.5, 22.25, 15.0], atol=1e-12
    )
    outside = remap([[-0.1, 2.0], [7.1, 2.0], [2.0, 5.2]], phase)
    assert np.isnan(outside.coordinates).all()
    assert np.isnan(outside.sd).all()
    u[2, 3] = np.nan
    beside = remap([[2.5, 1.5], [3.5, 2.5], [1.5, 1.5]], phase_map(u)).coordinates[:, 0]
    assert np.isnan(beside).tolist() == [True, True, False]


def test_deviation_of_the_centre_counts_by_the_gradient():
    phase = phase_map(plane((20, 20), 3.0, 4.0), sigma=1e-9)
    for options in ({}, {"window": 5}):
        sd = remap([[9.3, 9.6]], phase, centre_sd=0.02, **options).sd
        assert sd[0, 0] == pytest.approx(5.0 * 0.02, rel=1e-6)


@pytest.mark.parametrize("options", [{}, {"window": 6}, {"window": 8, "order": 1}])
def test_predicted_deviations_are_those_observed(options):
    rng = np.random.default_rng(1)
    truth = plane((41, 41), 1.1, 0.2)
    centre = np.array([[20.3, 19.8]])
    exact = 7.0 + 1.1 * 20.3 + 0.2 * 19.8
    repeats = 300
    errors = np.empty(repeats)
    predicted = np.empty(repeats)
    for k in range(repeats):
        phase = phase_map(truth + rng.normal(0.0, 0.1, truth.shape))
        points = remap(centre, phase, **options)
        errors[k], predicted[k] = points.coordinates[0, 0] - exact, points.sd[0, 0]
    # A deviation from 300 repeats is good to 4 %, a mean to 6 % of one: four times that.
    # Robust weights cost 5 %, which the prediction leaves out.
    assert errors.std() == pytest.approx(predicted.mean(), rel=0.2)
    assert abs(errors.mean()) < 4.0 * errors.std() / np.sqrt(repeats)


def test_window_beats_interpolation_in_a_noisy_dot():
    """The phase of a dark dot is ten times as noisy, and biased at its rim."""
    rng = np.random.default_rng(2)
    v, u = np.mgrid[:61, :61].astype(float)
    truth = 0.4 * u + 0.1 * v + 2e-4 * (u - 30.0) ** 2
    distance = np.hypot(u - 30.2, v - 29.7)
    sigma = np.where(distance < 11.0, 0.5, 0.05)
    centre = np.array([[30.2, 29.7]])
    exact = 0.4 * 30.2 + 0.1 * 29.7 + 2e-4 * 0.2**2
    results = {"pixels": [], "window": [], "outside": []}
    for _ in range(100):
        noisy = truth + sigma * rng.standard_normal(truth.shape)
        # A rim that pulls the phase towards its bright side by up to 0.3 px.
        noisy += 0.3 * np.exp(-(((distance - 11.0) / 1.5) ** 2)) * (u - 30.2) / 11.0
        noisy[(v > 25) & (v < 28) & (u > 40)] += 20.0  # an order unwrapped wrongly
        phase = phase_map(noisy)
        phase.sigma["u"][:] = sigma
        options = {
            "pixels": {},
            "window": {"window": 8},
            "outside": {"window": 24, "exclude_px": 14.0},
        }
        for name, chosen in options.items():
            results[name].append(remap(centre, phase, **chosen).coordinates[0, 0] - exact)
    rms = {name: float(np.sqrt(np.mean(np.square(e)))) for name, e in results.items()}
    # Four pixels of 0.5: 0.5 sqrt(0.355) = 0.30 px here; a quadratic of the 200 px inside has
    # 0.5 / sqrt(200 / 4) = 0.07; one of the 1190 px outside, extrapolated inwards, 0.006.
    # Factors of 1.5 for the randomness of 100 and for robust weights.
    assert 0.2 < rms["pixels"] < 0.45
    assert rms["window"] < 0.11
    assert rms["outside"] < 0.015


def test_window_without_data():
    u = plane((30, 30), 1.0, 0.0)
    u[:, 12:] = np.nan
    points = remap([[20.0, 15.0], [5.0, 15.0]], phase_map(u), window=6)
    assert np.isnan(points.coordinates[:, 0]).tolist() == [True, False]
    line = np.full((30, 30), np.nan)
    line[15] = np.arange(30.0)
    assert np.isnan(remap([[15.0, 15.0]], phase_map(line), window=14, order=1).sd).all()


@pytest.mark.parametrize(
    ("centres", "options", "word"),
    [
        (np.zeros((0, 2)), {}, "(n, 2)"),
        (np.zeros(2), {}, "(n, 2)"),
        ([[np.nan, 1.0]], {}, "finite"),
        ([[1.0, 1.0]], {"centre_sd": -1.0}, "centre_sd"),
        ([[1.0, 1.0]], {"centre_sd": [0.1, 0.2]}, "centre_sd"),
        ([[1.0, 1.0]], {"window": 0}, "window"),
        ([[1.0, 1.0]], {"window": 2.5}, "window"),
        ([[1.0, 1.0]], {"window": 3, "order": 3}, "order"),
        ([[1.0, 1.0]], {"exclude_px": 2.0}, "window"),
    ],
)
def test_bad_input(centres, options, word):
    with pytest.raises(InputError, match=r"^remap") as error:
        remap(centres, phase_map(plane((9, 9), 1.0, 0.0)), **options)
    assert word in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("window", [None, 6])
def test_gradient_of_the_coordinates(window):
    v, u = np.mgrid[:40, :50].astype(np.float64)
    phase = PhaseMap(
        {"u": 2.0 * u - 0.5 * v, "v": 0.25 * u + 3.0 * v},
        {"u": np.full(u.shape, 0.1), "v": np.full(u.shape, 0.1)},
        np.ones(u.shape, np.float32),
        np.ones(u.shape, np.float32),
        np.ones(u.shape, np.bool_),
    )
    found = remap([[20.3, 17.6]], phase, window=window)
    # Planes: exact but for rounding.
    np.testing.assert_allclose(found.gradient[0], [[2.0, -0.5], [0.25, 3.0]], atol=1e-9)
