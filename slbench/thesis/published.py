"""What the thesis reports of its experiments: the numbers that ours stand beside."""

from __future__ import annotations

#: The two rigs of 6.2, in order.
RIGS = ("optimal", "feasible")
#: The feasible configuration of 6.2: z_ref, w, h, l / mm; alpha_P, beta_P / deg.
FEASIBLE = (810.99, -413.97, -162.56, 159.65, -25.58, 10.89)
#: Least, largest and mean RMS depth error of a plane, fig. 12, mm.
PLANE_MM = {"optimal": (0.1869, 0.1992, 0.1924), "feasible": (0.2410, 0.2985, 0.2701)}
#: Table 6: certified heights and those measured with either rig, mm.
BLOCK_5_MM = (1.0, 2.5, 5.0)
BLOCK_5_MEASURED_MM = {"optimal": (1.024, 2.513, 4.918), "feasible": (1.255, 2.672, 5.216)}

#: The pattern sets of chapter 7: its own, the doubling one of as many steps, and the long one.
OURS, DOUBLING, LONG = SETS = ("1,10,50", "1,2,4", "1,2,4,8,16")
#: Numbers of their finest fringes.
FINEST = (50, 4, 16)
#: Standard deviation of the relative phase, 7.1.2, rad.
NOISE_RAD = 0.036
#: Scenes and what the thesis calls their objects.
OBJECTS = {
    "ch7-step-block": "step block",
    "ch7-propeller": "propeller",
    "ch7-gear": "gear",
    "ch7-engine-block": "V6 engine block",
}
#: The one whose deviations are those of the height (table 8); of the point for the others.
STEP_BLOCK = "ch7-step-block"
#: Medians of the standard deviation with their 95 % intervals as tables 8 and 9 print them, um,
#: in the order of the sets: (median, low, high).
STD_PRINTED_UM = {
    "ch7-step-block": ((46.86, 44.70, 49.02), (195.54, 189.63, 201.44), (64.42, 62.41, 66.42)),
    "ch7-propeller": ((32.25, 35.05, 35.45), (119.45, 108.87, 120.07), (38.98, 38.76, 39.20)),
    "ch7-gear": ((32.52, 32.34, 32.71), (119.45, 108.87, 110.12), (40.88, 40.65, 41.12)),
    "ch7-engine-block": ((44.26, 43.96, 44.57), (154.86, 153.94, 155.58), (54.26, 53.91, 54.61)),
}


def _corrected(median: float, low: float, high: float) -> float:
    """Return a printed median, or the middle of its interval where it lies outside of it.

    That happens twice, with {1,10,50} on the propeller and {1,2,4} on the gear.  The other
    medians are the middles of their intervals to 0.1 um, but for the propeller's with {1,2,4},
    whose lower limit is the gear's (docs/study/errata.md).
    """
    return median if low <= median <= high else round(0.5 * (low + high), 3)


#: The medians that ours are judged by, um: misprints corrected.
STD_UM = {
    scene: tuple(_corrected(*printed) for printed in row) for scene, row in STD_PRINTED_UM.items()
}
#: Table 7: certified heights and those measured with each set, mm.
BLOCK_20_MM = (2.5, 5.0, 10.0, 15.0, 20.0)
BLOCK_20_MEASURED_MM = {
    OURS: (2.460, 4.889, 9.922, 14.892, 19.850),
    DOUBLING: (2.560, 4.627, 9.658, 14.724, 19.347),
    LONG: (2.409, 4.885, 9.908, 14.887, 19.850),
}
#: Table 5: mu, sigma / mm, eta, N_s, d / mm of the configurations of table 4.
TABLE_5 = (
    (0.3295, 0.0647, 0.158, 443, 5.52),
    (0.3366, 0.0669, 0.162, 388, 5.57),
    (0.3430, 0.0660, 0.155, 295, 6.68),
    (0.3432, 0.0677, 0.158, 314, 6.63),
    (0.3519, 0.0781, 0.158, 826, 4.23),
    (0.3612, 0.0774, 0.156, 646, 4.82),
    (0.3640, 0.0673, 0.158, 509, 5.25),
    (0.3860, 0.0718, 0.163, 129, 8.43),
    (0.3870, 0.0707, 0.166, 139, 8.18),
    (0.4319, 0.0829, 0.156, 584, 5.07),
    (0.4422, 0.0795, 0.166, 314, 6.60),
    (0.5107, 0.1072, 0.166, 908, 4.08),
    (0.5515, 0.1205, 0.164, 527, 5.25),
    (0.5634, 0.1605, 0.098, 30, 9.71),
    (0.6553, 0.1647, 0.158, 321, 6.77),
    (0.7253, 0.1673, 0.162, 995, 3.96),
    (1.4571, 0.3878, 0.165, 1037, 3.87),
    (1.5306, 0.4023, 0.158, 238, 7.46),
)
