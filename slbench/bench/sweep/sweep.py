"""Sweeps: what quantities of a scene do while its keys go through values.

Every combination of the values is a scene of its own, changed by :mod:`slbench.scene.changes` and
measured by scans, or by comparisons where a quantity is one of a pattern set.  Light is traced
once for all combinations that share it (:mod:`slbench.simulate.lights`), and repeats of a
combination are seen in the same light; repeat i has the same noise seed in all of them, so that
what differs between two is what the keys do.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.claims.quantities import (
    check_set,
    claim_quantities,
    family,
    pattern_set,
    quantities_of,
    resolve,
    score_values,
    set_value,
    unit,
)
from slbench.bench.compare.compare import compare, own_shifts
from slbench.bench.compare.sets import pattern_sets
from slbench.bench.sweep.axes import Axis, read_axes
from slbench.core import resources
from slbench.core.errors import InputError, located, warn_user
from slbench.core.io import OutputFolder, write_json, write_table
from slbench.core.random import tagged_seed
from slbench.core.show.display import brief
from slbench.core.show.document import Table
from slbench.core.show.drawing import figure, write_figure
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.scene.changes import listed
from slbench.scene.file import load_scene
from slbench.scene.model import Scene
from slbench.simulate.lights import Lights, light_key
from slbench.simulate.scan import samples_doubt, scan, score_scan

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

SWEEP_FOLDER = OutputFolder("sweep", ("sweep.csv", "sweep.json", "sweep.png"))

#: What is measured where nothing is asked for, as far as a scene has it.
_USUAL = ("median_abs_mm", "p95_abs_mm", "completeness")
_USUAL_OF_KIND = {"step": "error_mm", "plane": "flatness_mm", "sphere": "form_mm"}


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep measured.

    Parameters
    ----------
    scene : str
    axes : tuple of Axis
    quantities : tuple of str
    mean, std : (points, quantities) float
        Over the repeats; of comparisons their own value, without deviation.  Points are all
        combinations, the last axis fastest; NaN where nothing was measured.
    repeats, seed : int
    traces : int
        How often light was traced.
    parameters : mapping
        For the provenance.
    """

    scene: str
    axes: tuple[Axis, ...]
    quantities: tuple[str, ...]
    mean: Array
    std: Array
    repeats: int
    seed: int
    traces: int
    parameters: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = brief

    @property
    def points(self) -> list[tuple[Any, ...]]:
        """The values of each combination."""
        return list(itertools.product(*(axis.values for axis in self.axes)))

    def table(self) -> Table:
        """Lay out the combinations, one a row."""
        labels = list(itertools.product(*(axis.labels for axis in self.axes)))
        rows = [
            (*names, *(_with_spread(m, s) for m, s in zip(mean, std, strict=True)))
            for names, mean, std in zip(labels, self.mean, self.std, strict=True)
        ]
        columns = (*(axis.key for axis in self.axes), *self.quantities)
        once = "once" if self.traces == 1 else f"{self.traces} times"
        note = f"{self.repeats} repeats a row; light traced {once}"
        return Table(f"{self.scene}, swept", columns, tuple(rows), note)

    def plot(self) -> Any:
        """Return a matplotlib figure: a curve of each quantity."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        rows = [
            {
                "values": dict(zip((axis.key for axis in self.axes), point, strict=True)),
                "mean": dict(zip(self.quantities, mean, strict=True)),
                "std": dict(zip(self.quantities, std, strict=True)),
            }
            for point, mean, std in zip(self.points, self.mean, self.std, strict=True)
        ]
        return {
            "scene": self.scene,
            "repeats": self.repeats,
            "seed": self.seed,
            "traces": self.traces,
            "quantities": {name: unit(name) for name in self.quantities},
            "points": rows,
        }


@checked
def sweep(
    scene: str | Path,
    changes: Sequence[str] | Mapping[str, Any],
    *,
    quantities: Sequence[str] = (),
    repeats: types.Count = 1,
    seed: types.Seed = 0,
    preview: bool = False,
    allow_modules: bool = False,
    where: str = "changes",
    on_progress: Progress | None = None,
) -> Sweep:
    """Measure a scene while keys of it go through values.

    Parameters
    ----------
    scene : str or Path
        A file, or the name of a shipped scene.
    changes : sequence of str, or mapping
        Keys and values (:func:`read_axes`): ``["camera.f_number=4:16:5"]``,
        ``{"camera.f_number": [4, 8, 16]}``.  Several keys with several values are a grid; a key
        with one value is changed in all of it.
    quantities : sequence of str
        As claims name them: of a scan (``rms_mm``, ``step[2.5].error_mm``) or of a pattern set
        (``set[1,10,50].std_median_mm``).  By default a few that the scene has.
    repeats : int
        Scans of each combination; comparisons have 2 at least.
    seed : int
        Of light and noise; the first repeat is the scan of that seed.
    preview : bool
        Few pixels and samples.
    allow_modules : bool
        Run the Python modules that the scene names: code of its author.
    where : str
        What gave the changes, for messages.
    on_progress : callable, optional
        Called with the stage and the finished fraction.

    Returns
    -------
    Sweep

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        For changes, scenes and quantities that cannot be, before anything is measured.

    Warns
    -----
    InputWarning
        If a combination cannot be measured, or more samples would change what is.
    """
    fixed, axes = read_axes(changes, where)
    points = list(itertools.product(*(axis.changes for axis in axes)))
    path = resources.find("scenes", scene)
    loaded, own_name = [], ""
    for point in points:
        one = load_scene(
            path, preview=preview, allow_modules=allow_modules, changes=(*fixed, *point)
        )
        own_name = one.name
        name = ", ".join([own_name, *(f"{c.key}={listed([c])[c.key]}" for c in point)])
        loaded.append(replace(one, name=name))
    chosen = tuple(quantities) or _usual(loaded[0])
    for name in chosen:
        for one in loaded:
            _check(name, one)
    mean = np.full((len(points), len(chosen)), np.nan)
    std = np.full(mean.shape, np.nan)
    # Those of the same light one after another, so that one light at a time is held.
    keys = [light_key(one) for one in loaded]
    order = sorted(range(len(points)), key=lambda k: keys.index(keys[k]))
    lights = Lights(seed, kept=2)
    doubts: list[tuple[str, str]] = []
    for done, k in enumerate(order):
        try:
            mean[k], std[k], doubt = _measured(loaded[k], chosen, repeats, seed, lights)
        except InputError as error:
            warn_user(f"scene {loaded[k].name}", f"not measured: {error}")
            doubt = None
        if doubt:
            doubts.append((loaded[k].name, doubt))
        if on_progress:
            on_progress("sweep", (done + 1) / len(points))
    if doubts:
        name, doubt = doubts[0]
        more = f"; so in {len(doubts) - 1} more combinations" if len(doubts) > 1 else ""
        warn_user(f"scene {name}", doubt + more)
    return Sweep(
        scene=own_name,
        axes=axes,
        quantities=chosen,
        mean=mean,
        std=std,
        repeats=repeats,
        seed=seed,
        traces=lights.traces,
        parameters={
            "scene": loaded[0].specification,  # of the first combination
            "sweep": {axis.key: list(axis.values) for axis in axes},
            "quantities": list(chosen),
            "repeats": repeats,
            "preview": preview,
        },
    )


def _usual(scene: Scene) -> tuple[str, ...]:
    """Return quantities that say in general what a scene measures."""
    known = quantities_of(scene)
    kinds = {kind for kind in _USUAL_OF_KIND if any(q.startswith(f"{kind}[") for q in known)}
    # Steps lie between planes: of these it is enough.
    kinds -= {"plane"} if "step" in kinds else set()
    features = [f"{kind}[*].{name}" for kind, name in _USUAL_OF_KIND.items() if kind in kinds]
    return (*(name for name in _USUAL if name in known), *features)


def _check(quantity: str, scene: Scene) -> None:
    where = f"scene {scene.name}: quantity"
    if family(quantity) == "speed":
        raise InputError(where, "one of scans or pattern sets", repr(quantity))
    if family(quantity) == "set":
        text, _ = pattern_set(quantity, where)
        with located(where):
            pattern_sets([text], scene, shifts=own_shifts(scene))
        check_set(quantity, scene, where)
    else:
        resolve(quantity, scene, where)


def _measured(
    scene: Scene, quantities: Sequence[str], repeats: int, seed: int, lights: Lights
) -> tuple[Array, Array, str | None]:
    """Return means and standard deviations of a scene's quantities, and a doubt about samples."""
    mean = np.full(len(quantities), np.nan)
    std = np.full(len(quantities), np.nan)
    of_scans = [k for k, name in enumerate(quantities) if family(name) == "score"]
    of_sets = [k for k, name in enumerate(quantities) if family(name) == "set"]
    doubt = None
    if of_scans:
        names = [resolve(quantities[k], scene, "quantity") for k in of_scans]
        further = {name for one in names for name in one if name in claim_quantities}
        values = np.empty((repeats, len(of_scans)))
        for r in range(repeats):
            own = seed if r == 0 else tagged_seed(seed, r)
            # Scored here: of all combinations together it is told where sampling is seen.
            made = score_scan(scan(scene, seed=own, score=False, lights=lights))
            row = score_values(made, further)
            values[r] = [max((row[name] for name in one), key=_largest) for one in names]
            doubt = doubt or samples_doubt(made)
        mean[of_scans] = values.mean(axis=0)
        if repeats > 1:
            std[of_scans] = values.std(axis=0, ddof=1)
    if of_sets:
        texts = {k: pattern_set(quantities[k], "quantity") for k in of_sets}
        sets = list(dict.fromkeys(text for text, _ in texts.values()))
        read = pattern_sets(sets, scene, shifts=own_shifts(scene))
        read = tuple(replace(one, name=text) for one, text in zip(read, sets, strict=True))
        along = tuple(dict.fromkeys(a for one in read for a in one.sequence.variations))
        found = compare(
            scene,
            read,
            repeats=max(repeats, 2),
            seed=seed,
            transports=lights.traced(scene, along),
            truth=lights.truth(scene),
            question=False,
        )
        results = {one.name: one for one in found.sets}
        for k, (text, name) in texts.items():
            mean[k] = set_value(results[text], name)
    return mean, std, doubt


def _largest(value: float) -> float:
    """Order values so that one that was not measured is the largest."""
    return math.inf if math.isnan(value) else value


def _with_spread(mean: float, std: float) -> str | float:
    return float(mean) if math.isnan(std) or math.isnan(mean) else f"{mean:.4g} ± {std:.1g}"


def write_sweep(result: Sweep, folder: str | Path) -> None:
    """Write ``sweep.csv``, ``sweep.json``, ``sweep.png`` and the provenance to a folder.

    The table has a column of each key, and of each quantity the mean and, where there are repeats,
    the standard deviation over them (``NAME.std``).
    """
    with SWEEP_FOLDER.writing(folder, result.parameters, result.seed) as temporary:
        columns = [axis.key for axis in result.axes]
        spread = result.repeats > 1
        for name in result.quantities:
            columns += [name, f"{name}.std"] if spread else [name]
        labels = itertools.product(*(axis.values for axis in result.axes))
        rows = []
        for point, mean, std in zip(labels, result.mean, result.std, strict=True):
            cells = [v if isinstance(v, float | int) else str(v) for v in point]
            for m, s in zip(mean, std, strict=True):
                cells += [m, s] if spread else [m]
            rows.append(cells)
        write_table(temporary / "sweep.csv", columns, rows)
        write_json(temporary / "sweep.json", result.to_dict())
        write_figure(result, temporary / "sweep.png")
