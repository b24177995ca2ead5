"""How fast configurations are evaluated: against plain NumPy within one run.

The targets, 1 ms for a thesis-sampled evaluation in a batch and 40 ms for
the whole sensor on two cores, are printed beside what was measured, never gated.
"""

import time

import numpy as np
import pytest
from reference_evaluator import reference

from slbench.core import resources
from slbench.design.rig.evaluate import evaluate
from slbench.design.rig.hardware import load_hardware, read_configurations
from slbench.rig import DesignVariables

MACRO = load_hardware("hardware/macro-ch6")
TABLE_4 = read_configurations(resources.find("scenes", "hardware/macro-ch6").parent / "table4.csv")
BATCH = np.tile(TABLE_4, (20, 1))
#: Targets, on two cores.
TARGET_MS = {(20, 24): 1.0, (1, 1): 40.0}


def best_of(function, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def test_batch_time(benchmark):
    result = benchmark(evaluate, MACRO, BATCH)
    assert result.feasible.all()


def test_whole_sensor_time(benchmark):
    result = benchmark(evaluate, MACRO, TABLE_4[4], stride=(1, 1))
    assert result.n_points[0] > 100_000


@pytest.mark.slow
@pytest.mark.parametrize("stride", [(20, 24), (1, 1)])
def test_many_times_faster_than_numpy(stride):
    rows = BATCH if stride == (20, 24) else TABLE_4[[4]]
    # NumPy takes seconds a plane where the whole sensor is sampled: one plane compares.
    planes = [-15.0, -7.5, 0.0, 7.5, 15.0] if stride == (20, 24) else [0.0]
    options = {"stride": stride, "planes_mm": planes}
    ours = evaluate(MACRO, rows, **options)  # compiles, too
    variables = DesignVariables(*TABLE_4[4])
    start = time.perf_counter()
    plain = reference(MACRO, variables, **options)
    plain_s = time.perf_counter() - start
    # Both must do the same work for their times to compare.
    assert ours.mu_mm[4 % len(rows)] == pytest.approx(plain[0], rel=1e-9)
    ours_s = best_of(lambda: evaluate(MACRO, rows, **options), 7) / len(rows)
    full_s = best_of(lambda: evaluate(MACRO, rows, stride=stride), 5) / len(rows)
    print(
        f"\nevery {stride[0]} x {stride[1]}th pixel, five planes: {1e3 * full_s:.3f} ms a "
        f"configuration (target {TARGET_MS[stride]} ms); {len(planes)} plane(s): "
        f"{1e3 * ours_s:.3f} ms, NumPy {1e3 * plain_s:.0f} ms, ratio {plain_s / ours_s:.0f}"
    )
    # Several hundred on two cores: 40 is left when the machine is busy with other work.
    assert plain_s / ours_s > 40
