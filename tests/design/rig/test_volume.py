"""The largest box in focus, and what it does to a microscope's rig."""

import numpy as np
import pytest
from scipy.optimize import minimize

from slbench.core import resources
from slbench.design.rig.constraints import focus_slacks
from slbench.design.rig.hardware import load_hardware, read_configurations
from slbench.design.rig.optimise import optimise
from slbench.design.rig.volume import largest_box

MACRO = load_hardware("hardware/macro-ch6")
TABLE_4 = read_configurations(
    resources.find("scenes", "hardware/macro-ch6").with_name("table4.csv")
)


def test_largest_box_against_a_general_solver():
    boxes = largest_box(MACRO, TABLE_4)
    axes = np.vstack((np.zeros(3), np.eye(3)))
    for row, box in zip(TABLE_4, boxes, strict=True):
        slack = focus_slacks(MACRO, row, axes)[0]
        room, slope = slack[0], np.abs(slack[1:] - slack[:1]).T
        found = minimize(
            lambda h: -np.log(h).sum(),
            np.full(3, 1.0),
            constraints=[{"type": "ineq", "fun": lambda h, a=slope, b=room: b - a @ h}],
            bounds=[(1e-6, None)] * 3,
            options={"ftol": 1e-12, "maxiter": 500},
        )
        # What the docstring promises.
        assert np.prod(box) == pytest.approx(8.0 * np.prod(found.x), rel=1e-3)


def test_the_box_is_in_focus_and_fills_the_region():
    boxes = largest_box(MACRO, TABLE_4)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T / 2.0
    for row, box in zip(TABLE_4, boxes, strict=True):
        slack = focus_slacks(MACRO, row, signs * box)
        assert slack.min() == pytest.approx(0.0, abs=1e-6 * box.max())


def test_no_rig_has_no_box():
    assert np.all(largest_box(MACRO, [500.0, 0, 0, 100, -np.pi / 2, 0.2]) == 0)


@pytest.mark.slow
def test_a_microscope_rig_closes_up_until_the_bodies_touch():
    """Thesis 5.2: maximising the volume minimises the angle between the axes."""
    hardware = load_hardware("hardware/micro-ch8")
    found = optimise(hardware, micro=True, max_evaluations=500, seed=0)
    member = found.member()
    margins = found.evaluation.margins[member]
    feasible = np.delete(margins, 2)  # g3 has become the objective
    assert np.all(feasible > 0)
    # Touching to a hundredth of the bodies' width; the boxes' corners meet there.
    assert margins[5] < 0.34
    assert 70.0 < found.evaluation.angle_deg[member] < 90.0
    assert np.prod(largest_box(hardware, found.front.x)) == pytest.approx(
        -(found.front.f[0, 0] ** 3)
    )
