"""Thesis chapter 3 by its own model: table 4's configurations against feasible rigs at random.

Nothing is rendered: error, coverage and dispersion are those of 3.2
(:mod:`slbench.design.rig.evaluate`), with pixel centres.  Rigs at random are uniform in table
3's ranges; those that satisfy the six constraints are kept, as the thesis drew its feasible one.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slbench.bench.statistics import Interval
from slbench.core.random import generator, tagged_seed
from slbench.core.show.document import Picture, Table
from slbench.design.rig.evaluate import THESIS_STRIDE, Evaluation, evaluate
from slbench.design.rig.hardware import Hardware, load_hardware, thesis_configurations
from slbench.thesis import published as thesis
from slbench.thesis.ch3.findings import (
    better_finding,
    dominated,
    optimal_finding,
    ratio_finding,
    table_finding,
)
from slbench.thesis.ch3.results import RigTable
from slbench.thesis.outcome import Outcome
from slbench.thesis.pictures import new_figure, picture

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Hardware of chapter 6, which the thesis optimised.
HARDWARE = "hardware/macro-ch6"
#: Rigs drawn, feasible or not: one in seven is.
_FULL, _PREVIEW = 40_000, 4_000
_RIGS, _CHANCE, _PAIRS, _RANKS = range(4)


def run_ch3(*, preview: bool, seed: int, on_progress: Progress | None = None) -> Outcome:
    """Judge what thesis chapter 3 says of its optimiser.

    Parameters
    ----------
    preview : bool
        A tenth of the random rigs.
    seed : int
    on_progress : callable, optional

    Returns
    -------
    Outcome
    """
    begin = time.perf_counter()
    report = on_progress or (lambda stage, fraction: None)
    hardware = load_hardware(HARDWARE)
    configurations = thesis_configurations(hardware)
    assert configurations is not None, HARDWARE
    optimal = evaluate(hardware, configurations)
    report("rigs", 0.0)
    count = _PREVIEW if preview else _FULL
    random = random_rigs(hardware, count, tagged_seed(seed, _RIGS))
    report("rigs", 1.0)
    rigs = RigTable(optimal.objectives, random.objectives)
    ratio = error_ratio(hardware, configurations[4])
    findings = (
        optimal_finding(rigs, tagged_seed(seed, _CHANCE)),
        better_finding(rigs, tagged_seed(seed, _PAIRS)),
        ratio_finding(ratio),
        table_finding(optimal.mu_mm, tagged_seed(seed, _RANKS)),
    )
    return Outcome(
        "ch3",
        "Chapter 3: the optimiser's configurations",
        findings,
        (_table(optimal, rigs),),
        {"front": _picture(rigs)},
        (),
        {"hardware": HARDWARE, "drawn": count, "feasible": len(random)},
        seed,
        {"total": time.perf_counter() - begin},
        preview,
    )


def random_rigs(hardware: Hardware, count: int, seed: int) -> Evaluation:
    """Evaluate the feasible ones of `count` rigs, uniform in the hardware's ranges."""
    low, high = np.array(hardware.lower), np.array(hardware.upper)
    drawn = low + (high - low) * generator(seed).random((count, len(low)))
    feasible = evaluate(hardware, drawn).feasible
    return evaluate(hardware, drawn[feasible])


def error_ratio(hardware: Hardware, optimal: Array) -> Interval:
    """Return the ratio of mean errors of a rig and the feasible one of 6.2.

    The limits are the least and the largest ratio as the sampling of the sensor is changed by a
    column or a row: the thesis does not state where its samples lie.
    """
    feasible = np.array(thesis.FEASIBLE)
    feasible[4:] = np.deg2rad(feasible[4:])
    pair = np.stack((optimal, feasible))

    def of(stride: tuple[int, int]) -> float:
        mu = evaluate(hardware, pair, stride=stride).mu_mm
        return float(mu[0] / mu[1])

    u, v = THESIS_STRIDE
    found = [of((u + du, v + dv)) for du in (-1, 0, 1) for dv in (-1, 0, 1)]
    return Interval(of(THESIS_STRIDE), min(found), max(found))


def _table(optimal: Evaluation, rigs: RigTable) -> Table:
    beaten = dominated(rigs.random, rigs.optimal)
    rows = tuple(
        (
            k + 1,
            thesis.TABLE_5[k][0],
            float(optimal.mu_mm[k]),
            thesis.TABLE_5[k][1],
            float(optimal.sigma_mm[k]),
            float(100 * np.mean(rigs.optimal[k, 0] < rigs.random[:, 0])),
            "yes" if beaten[k] else "",
        )
        for k in range(len(optimal))
    )
    columns = (
        "configuration",
        "mu: table 5 / mm",
        "ours / mm",
        "sigma: table 5 / mm",
        "ours / mm ",
        "less mu sigma than random rigs / %",
        "a random rig is better in all",
    )
    return Table("Tables 4 and 5, beside feasible rigs at random", columns, rows)


def _picture(rigs: RigTable) -> Picture:
    figure = new_figure(6.0, 4.0)
    axes = figure.subplots()
    for values, label, size, colour in (
        (rigs.random, "feasible, at random", 3.0, "0.6"),
        (rigs.optimal, "table 4", 24.0, "C3"),
    ):
        axes.scatter(-values[:, 1], values[:, 0], s=size, c=colour, label=label)
    axes.set_yscale("log")
    axes.set_xlabel("eta N_s (points in view)")
    axes.set_ylabel("mu sigma / mm²")
    axes.legend()
    return picture("Objectives of eq. 20", figure, "Lower and further right is better.")
