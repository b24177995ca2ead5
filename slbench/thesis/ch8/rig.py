"""Thesis 8.1.2: the rig of the microscope, designed by 5.2 for the largest measurement volume.

The hardware is that of 8.1.1 with the barrels of its objectives, and a sweep of focus settings
(:mod:`slbench.design.rig.optimise`).  The largest volume of rigs whose axes are ten degrees further
apart stands beside it.
"""

from __future__ import annotations

from slbench.design.rig.hardware import load_hardware
from slbench.design.rig.optimise import optimise
from slbench.design.rig.volume import largest_box
from slbench.thesis.ch8.results import MicroRig

#: Hardware that the thesis's rig follows from.
HARDWARE = "hardware/micro-ch8-objectives"
#: Further apart than the axes of the best rig, deg.
_WIDER_DEG = 10.0
#: Evaluations after the start has been found: the search ends by itself.
_EVALUATIONS = 500


def micro_rigs(seed: int) -> tuple[MicroRig, MicroRig]:
    """Return the rig of the largest volume, and that of the largest among wider ones."""
    best = _largest(seed, None)
    return best, _largest(seed, best.angle_deg + _WIDER_DEG)


def _largest(seed: int, least_deg: float | None) -> MicroRig:
    hardware = load_hardware(HARDWARE)
    found = optimise(
        hardware, micro=True, max_evaluations=_EVALUATIONS, seed=seed, min_angle_deg=least_deg
    )
    member = found.member()
    box = largest_box(hardware, found.front.x[member])[0]
    barrel = hardware.camera.barrel_mm
    assert barrel is not None  # of this hardware
    return MicroRig(
        angle_deg=float(found.evaluation.angle_deg[member]),
        gap_mm=float(found.evaluation.margins[member, 5]),
        box_mm=(float(box[0]), float(box[1]), float(box[2])),
        width_mm=2.0 * max(radius for _, radius in barrel),
    )
