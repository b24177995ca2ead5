"""Time of the pattern designer: the closed form beside the thesis's simulation, within one run.

The thesis's case of 7.1.3: 12 candidates, 72 x 72 noise levels, and for the simulation 20
captures of 400 pixels at each.
"""

import time

import pytest

from slbench.design.fringes.design import candidates, thesis_sequence
from slbench.design.fringes.noise import PhaseNoise

COUNTS = candidates(400)
NOISE = PhaseNoise.constant(0.036, COUNTS)


def design(method):
    return thesis_sequence(
        400, NOISE, COUNTS, noise_step=0.001, phase_model="thesis", method=method, repeats=20
    )


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    for method in ("exact", "monte-carlo"):
        thesis_sequence(20, PhaseNoise.constant(0.1, [1, 2, 4]), noise_step=0.05, method=method)


def test_closed_form_time(benchmark):
    found = benchmark.pedantic(design, ("exact",), rounds=5)
    assert found.fringes == (1, 10, 50)


@pytest.mark.slow
def test_simulation_takes_several_times_as_long(benchmark):
    exact_s, sampled_s = [], []

    def timed(method, times):
        start = time.perf_counter()
        found = design(method)
        times.append(time.perf_counter() - start)
        assert found.fringes == (1, 10, 50)  # the same work

    for _ in range(3):
        timed("exact", exact_s)
    benchmark.pedantic(timed, ("monte-carlo", sampled_s), rounds=1)
    ratio = min(sampled_s) / min(exact_s)
    print(
        f"\nclosed form {1e3 * min(exact_s):.0f} ms, "
        f"simulation {1e3 * min(sampled_s):.0f} ms, ratio {ratio:.0f}"
    )
    # The limits of 0.2 s and 10 s are a ratio of 50; about 100 on two cores, and 20 is left when
    # one of them is busy with other work.
    assert ratio > 20.0
