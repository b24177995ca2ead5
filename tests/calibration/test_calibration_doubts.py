"""Doubts about the resolution that a model was fitted at."""

import numpy as np
import pytest

from slbench.calibration.doubts import pixel_bounds, resolution_doubt
from slbench.calibration.models.domain import Domain


class Model:
    """All that is asked of a model: its domain, of points on a grid in a box of pixels."""

    def __init__(self, low, high):
        axis = [np.linspace(a, b, 5) for a, b in zip((*low, 10.0), (*high, 90.0), strict=True)]
        points = np.stack(np.meshgrid(*axis), axis=-1).reshape(-1, 3)
        self.mean, self.scale = points.mean(axis=0), points.std(axis=0)
        self.standardisation = self
        self.domain = Domain.of((points - self.mean) / self.scale)


def test_bounds_are_those_of_the_points():
    bounds = pixel_bounds(Model((12.0, 30.0), (243.0, 220.0)))
    np.testing.assert_allclose(bounds, [[12.0, 30.0], [243.0, 220.0]], atol=1e-6)


# A target in the middle of 256 x 256 px, filling the field or half of it.
@pytest.mark.parametrize(("low", "high"), [(5, 250), (64, 191)])
def test_a_preview_s_model_on_full_frames_is_questioned(low, high):
    doubt = resolution_doubt(Model((low, low), (high, high)), (2048, 2048))
    assert f"fitted to pixels u {low} to {high}" in doubt
    assert "preview" in doubt


def test_a_full_model_on_a_preview_is_questioned():
    assert "more pixels" in resolution_doubt(Model((40, 40), (2000, 2000)), (256, 256))


@pytest.mark.parametrize(
    ("low", "high", "shape"),
    [
        ((40, 40), (2000, 2000), (2048, 2048)),  # its own
        ((800, 900), (1200, 1150), (2048, 2048)),  # a small target in the middle
        ((100, 900), (300, 1150), (2048, 2048)),  # a target at the left edge
        ((10, 10), (1130, 1130), (2048, 2048)),  # below the limit of 1.8 in size
        ((40, 40), (1200, 1200), (1000, 1000)),  # a little beyond: no other resolution
    ],
)
def test_other_domains_are_not(low, high, shape):
    assert resolution_doubt(Model(low, high), shape) is None


def test_the_limit_of_sizes():
    # Size of the fitted frames: low + high + 1.
    assert resolution_doubt(Model((100, 100), (899, 899)), (1799, 1799)) is None
    assert resolution_doubt(Model((100, 100), (899, 899)), (1801, 1801))
