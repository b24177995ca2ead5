"""Step blocks measured with calibrated rigs: what is steady, and that it is the calibration."""

import functools

import numpy as np
import pytest

from slbench.thesis.calibrated import experiment
from slbench.thesis.calibrated.findings import rms, steady_finding
from slbench.thesis.calibrated.results import SteadyErrors


def errors(scale_um, *, calibrations=8, noise_um=0.5, seed=0):
    """Return errors of a size that every calibration has of its own."""
    rng = np.random.default_rng(seed)
    nominal = np.array([2.5, 5.0, 10.0])
    own = rng.normal(0.0, scale_um, (calibrations, 1, 3))
    noise = rng.normal(0.0, noise_um, (1, 5, 3))
    return SteadyErrors(
        chapter="ch7",
        nominal_mm=nominal,
        thesis_mm=nominal + 1e-3 * np.array([-40.0, -110.0, -80.0]),
        calibrated_mm=nominal + 1e-3 * (own + noise),
        exact_mm=nominal + 1e-3 * noise[0],
        points_um=np.full(calibrations, scale_um),
    )


def test_steady_errors_are_means_of_repeats() -> None:
    found = errors(50.0)
    # Noise of five repeats, 0.5 um each.
    assert rms(found.exact_um) < 1.0
    assert rms(found.steady_um) == pytest.approx(50.0, rel=0.4)
    assert found.thesis_um == pytest.approx([-40.0, -110.0, -80.0])


@pytest.mark.parametrize(
    ("scale_um", "verdict"),
    [(80.0, "reproduced"), (2.0, "not reproduced"), (0.0, "not reproduced")],
)
def test_errors_as_large_as_the_thesis_s_are_reproduced(scale_um, verdict) -> None:
    finding = steady_finding(errors(scale_um, calibrations=40), 0)
    assert finding.verdict == verdict
    assert finding.interval[0] <= finding.ours <= finding.interval[1]


@functools.cache
def outcome():
    return experiment.run_calibrated(preview=True, seed=0)


@pytest.mark.slow
def test_a_preview_calibrates_and_measures() -> None:
    (finding,), (table,) = outcome().findings, outcome().tables
    exact = rms(np.array([row[2] for row in table.rows]))
    # What noise leaves of two scans' means is below what a calibration of five poses adds.
    assert 0.0 < exact < finding.ours < 20.0
    assert [row[0] for row in table.rows] == list(experiment.thesis.BLOCK_20_MM)
    assert set(outcome().pictures) == {"ch7-steps"}
