"""Measures of focus against values known in closed form and a plain version."""

import numpy as np
import pytest
import reference_fusion

from slbench.capture.fusion import focus_measure, focus_measures
from slbench.core.errors import InputError


@pytest.mark.parametrize("measure", focus_measures.names())
@pytest.mark.parametrize("window", [3, 9, 31])
@pytest.mark.parametrize("shape", [(40, 50), (5, 7), (1, 12), (1, 1)])
def test_agrees_with_scipy(measure, window, shape):
    image = np.random.default_rng(0).random(shape)
    found = focus_measure(image, measure, window)
    # Float32 input: squares of differences are good to 1e-6 of the largest.
    expected = reference_fusion.measure(image, window, measure)
    np.testing.assert_allclose(found, expected, atol=1e-6 + 2e-6 * expected.max())


def test_closed_forms():
    """A ramp of slope a has squared gradient a^2; of a chequer +/- c the variance is c^2 - .

    In a window of w^2 pixels, w odd, a chequer's mean is +/- c / w^2.
    """
    v, u = np.indices((30, 30))
    inner = np.s_[10:-10, 10:-10]
    ramp = 0.01 * u + 0.02 * v
    np.testing.assert_allclose(focus_measure(ramp, "gradient")[inner], 5e-4, rtol=1e-4)
    np.testing.assert_allclose(focus_measure(ramp, "laplacian")[inner], 0.0, atol=1e-6)
    chequer = 0.3 * (1 - 2 * ((u + v) % 2))
    expected = (0.3 * (1 - 1 / 81)) ** 2
    np.testing.assert_allclose(focus_measure(chequer)[inner], expected, rtol=1e-5)
    # Second differences of a chequer are 4 c along each axis.
    np.testing.assert_allclose(focus_measure(chequer, "laplacian")[inner], 2.4, rtol=1e-5)


@pytest.mark.parametrize("measure", focus_measures.names())
@pytest.mark.parametrize("level", [0.1, 1 / 3, 65535.0])
def test_flat_is_exactly_zero(measure, level):
    assert np.all(focus_measure(np.full((20, 20), level), measure) == 0.0)


def test_bad_input():
    for image, word in [(np.zeros((2, 2, 2)), "image"), (np.full((3, 3), np.nan), "finite")]:
        with pytest.raises(InputError, match=word):
            focus_measure(image)
    with pytest.raises(InputError, match="window"):
        focus_measure(np.zeros((9, 9)), window=4)
    with pytest.raises(InputError, match="measure"):
        focus_measure(np.zeros((9, 9)), "contrast")
