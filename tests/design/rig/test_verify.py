"""Plane scans with rigs of the design space: what the evaluator predicts is what is measured."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.design.rig.hardware import load_hardware, read_configurations
from slbench.design.rig.verify import draw, rendered_errors, verify

HARDWARE = load_hardware("hardware/macro-ch6")
TABLE_4 = read_configurations(
    resources.find("scenes", "hardware/macro-ch6").with_name("table4.csv")
)
#: The feasible configuration of thesis 6.2.
FEASIBLE = np.array([810.99, -413.97, -162.56, 159.65, np.deg2rad(-25.58), np.deg2rad(10.89)])
#: The same field of view on 160 x 120 pixels: a sixteenth of the work.
_COARSE = {"width": 160, "height": 120, "pitch_mm": (0.0296, 0.0296), "principal_point": None}
SMALL = replace(HARDWARE, camera=replace(HARDWARE.camera, **_COARSE))


def test_the_optimal_rig_beats_the_feasible_one_as_in_the_thesis():
    """Thesis 6.2.3: mean RMS errors 0.1924 and 0.2701 mm, a ratio of 0.71."""
    optimal = rendered_errors(HARDWARE, TABLE_4[4], samples=9, heights_mm=[0.0])
    feasible = rendered_errors(HARDWARE, FEASIBLE, samples=9, heights_mm=[0.0])
    # Geometry alone gives 0.62 to 0.76 (docs/explanation/rig-design.md); noise and sampling move
    # the ratio of two RMS values over 10,000 points by less than 2 %.
    assert 0.60 < optimal[0] / feasible[0] < 0.78


def test_noise_is_most_of_the_error_of_coarse_fringes():
    noisy = rendered_errors(HARDWARE, TABLE_4[4], samples=9, heights_mm=[0.0])
    clean = rendered_errors(HARDWARE, TABLE_4[4], samples=9, heights_mm=[0.0], noise=False)
    assert clean[0] < 0.7 * noisy[0]
    assert noisy[1] <= noisy[0]


def test_ranks_and_picture(tmp_path):
    result = verify(HARDWARE, TABLE_4[[0, 12, 17]], samples=4)
    assert result.rank_correlation == pytest.approx(1.0)
    assert len(result.rendered_mm) == len(result.predicted) == 3
    draw(result, tmp_path / "verify.png")
    assert (tmp_path / "verify.png").stat().st_size > 5000
    # The same patterns from a file.
    (tmp_path / "mine.toml").write_text('[patterns]\nsequence = "1,5"\n')
    same = verify(HARDWARE, TABLE_4[[0, 12, 17]], samples=4, patterns=tmp_path / "mine.toml")
    np.testing.assert_array_equal(same.rendered_mm, result.rendered_mm)


def test_too_few_configurations():
    with pytest.raises(InputError, match="at least 3"):
        verify(HARDWARE, TABLE_4[:2])


def test_the_noise_is_that_of_the_hardwares_detector():
    """The mean square error is linear in the read noise's variance, as the phase's variance is."""
    squares = [
        verify(
            replace(SMALL, detector=replace(SMALL.detector, read_noise_e=noise)),
            TABLE_4[[0, 4, 12]],
            samples=4,
        ).rendered_mm
        ** 2
        for noise in (0.0, 80.0, 160.0)
    ]
    assert np.all(squares[2] > 1.5 * squares[0])
    # Twice the noise adds four times as much.  What the draws have in common with the other
    # errors, by chance, is left: at most 3.4 % over nine rigs and seeds.
    slope = (squares[2] - squares[0]) / (squares[1] - squares[0])
    np.testing.assert_allclose(slope, 4.0, rtol=0.05)


@pytest.mark.slow
def test_the_model_ranks_rigs_as_rendered_scans_do():
    """18 configurations of table 4: the figure that says whether the model can be trusted."""
    result = verify(HARDWARE, TABLE_4)
    # 0.89 was measured; chance alone exceeds 0.8 among 18 with a probability below 1e-4.
    assert result.rank_correlation > 0.8
