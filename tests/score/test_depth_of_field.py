"""Where fringes are inside the depth of field of a lens with its whole spread."""

from types import SimpleNamespace

import numpy as np
import pytest

from slbench.rig.optics.spread import Spread
from slbench.score.fusion import KEPT, _share, largest_circle

FREQUENCIES = np.array([0.001, 0.004, 0.015, 0.03])


def test_without_diffraction_and_blur_it_is_four_tenths_of_a_period():
    # 2 J1(x) / x with x = 0.4 pi is 0.81516; the digits that it is cut at move the circle by 1e-5.
    np.testing.assert_allclose(largest_circle(Spread(), FREQUENCIES) * FREQUENCIES, 0.4, rtol=3e-4)


@pytest.mark.parametrize(
    "spread", [Spread(20.0), Spread(0.0, 3.0), Spread(14.0, 2.0), Spread(40.0, 1.0)]
)
def test_at_the_largest_circle_the_contrast_is_the_share_of_that_in_focus(spread):
    circle = largest_circle(spread, FREQUENCIES)
    kept = spread.contrast(FREQUENCIES, circle) / spread.contrast(FREQUENCIES)
    # Between nodes a third of an octave apart the circle is interpolated.
    np.testing.assert_allclose(kept, KEPT, atol=2e-3)
    # A Gaussian is the same in focus and out of it; diffraction forgives some defocus.
    geometric = 0.4 / FREQUENCIES
    if spread.diffraction_px == 0.0:
        np.testing.assert_allclose(circle, geometric, rtol=2e-3)
    else:
        assert np.all(circle > geometric)


def test_what_a_lens_does_not_pass_is_nowhere_inside():
    # lambda / NA of 26.7 px passes up to 0.075 cycles a pixel.
    limits = largest_circle(Spread(26.7), np.array([0.02, 0.07, 0.08, 0.3, np.nan, 0.0]))
    assert np.all(limits[:2] > 0.4 / np.array([0.02, 0.07]))
    assert limits[2] == limits[3] == 1e-12
    assert np.isnan(limits[4])
    assert limits[5] > 1e3


def test_both_devices_count_together():
    # A camera that sees two panel pixels a pixel: its frequency is twice the panel's.
    v, u = np.mgrid[:4, :50].astype(float)
    panel = np.stack([2.0 * u, v], axis=-1)
    coc = np.full(v.shape, 3.0)
    truth = SimpleNamespace(panel=panel, camera_coc=coc, projector_coc=2.0 * coc)
    none = Spread()
    share = _share(truth, "u", 0.02, none, none)
    np.testing.assert_allclose(share, np.hypot(0.02 * 6.0, 0.04 * 3.0) / 0.4, rtol=3e-4)
    sharp = _share(truth, "u", 0.02, Spread(20.0), Spread(20.0))
    assert np.all(sharp < share)  # some of the defocus is hidden by diffraction
    assert np.all(_share(truth, "u", 0.02, Spread(60.0), none) > 1e6)  # beyond the cut-off
