"""A plan of views: candidates predicted, a choice among them, and what it covers."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError, warn_user
from slbench.core.show.display import block, share
from slbench.core.show.drawing import figure
from slbench.design.rig.constraints import CONSTRAINTS, placed_margins
from slbench.design.rig.hardware import Hardware, Placement
from slbench.design.views.candidates import Candidate, Staging, candidates, uniform_turntables
from slbench.design.views.clear import Clearance
from slbench.design.views.cover import Rows, Solution, greedy, integer
from slbench.design.views.predict import Predictor
from slbench.rig import Rig
from slbench.scene.model import Scene
from slbench.simulate.viewpoints.samples import SurfaceSamples, patches_of, sample_surface
from slbench.simulate.viewpoints.views import (
    MOST_VIEWS,
    Counting,
    Viewpoint,
    Viewpoints,
    alone,
    names_of,
)

Array = NDArray[np.float64]

#: Patches of the surface that integer programming has for rows: it has half a minute.
PATCHES = 1500
#: Times that a coverage by patches is asked for again where that by samples falls short.
_ROUNDS = 3
_ROUNDING = 1e-9
GREEDY, INTEGER, UNIFORM = "greedy", "integer programming", "uniform turntable"


@dataclass(frozen=True, eq=False, kw_only=True)
class ViewPlan:
    """Chosen views, and all that they were chosen from.

    Parameters
    ----------
    scene : Scene
        With the part alone.
    object : int
        Index of the part in the scene that was planned for.
    staging : Staging
    counting : Counting
    candidates : tuple of Candidate
        Those that can be taken up, V of them.
    refused : mapping of str to int
        Why others cannot, and how many.
    samples : SurfaceSamples
        N of them.
    rows : Rows
        Samples by candidates.
    patches : Rows
        Patches by candidates: what integer programming chose by.
    sigma_mm : (N, V) float32
        Predicted standard deviations; NaN where nothing is measured.
    choices : mapping of str to tuple of int
        What each way chose, by its name.
    by : str
        The way whose choice it is.
    solution : Solution
        What the solver says.
    wanted : float or None
        Coverage that was wanted and can be reached.
    margins_mm : mapping of str to float, or None
        Of the rig's constraints g1..g6; None where the scene states no ``[design]``.
    seconds : mapping of str to float
    """

    scene: Scene
    object: int
    staging: Staging
    counting: Counting
    candidates: tuple[Candidate, ...]
    refused: Mapping[str, int]
    samples: SurfaceSamples
    rows: Rows
    patches: Rows
    sigma_mm: NDArray[np.float32]
    choices: Mapping[str, tuple[int, ...]]
    by: str
    solution: Solution
    wanted: float | None
    margins_mm: Mapping[str, float] | None
    seconds: Mapping[str, float]

    @property
    def chosen(self) -> tuple[int, ...]:
        """Numbers of the chosen candidates, in the order in which they add most."""
        return self.choices[self.by]

    @property
    def coverage(self) -> float:
        """Share of the surface that the chosen views are expected to measure."""
        return self.rows.coverage(self.chosen)

    @property
    def reachable(self) -> float:
        """Share of the surface that all candidates together measure often enough."""
        return float(self.rows.weights[self.rows.reachable].sum())

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of chosen views that measure each sample, (N,)."""
        return np.asarray(self.rows.measured[:, list(self.chosen)].sum(axis=1))

    def curve(self, way: str) -> list[float]:
        """Return the coverage by the first 1, 2, ... views of a way's choice."""
        views = self.choices[way]
        return [self.rows.coverage(views[: k + 1]) for k in range(len(views))]

    def uniform(self, most: int) -> dict[int, float]:
        """Return the coverage by uniform turntables of up to so many views; of a turntable only."""
        if self.staging.stage != "rotary":
            return {}
        turns = uniform_turntables(self.candidates, most)
        return {count: self.rows.coverage(views) for count, views in turns.items()}

    def viewpoints(self) -> Viewpoints:
        """Return the chosen views."""
        views = tuple(
            Viewpoint(name, self.candidates[k].pose, self.candidates[k].description)
            for name, k in zip(names_of(len(self.chosen)), self.chosen, strict=True)
        )
        return Viewpoints(
            views,
            self.counting,
            self.object,
            self.scene.name,
            self.scene.objects[0].artefact.name,
            self.coverage,
        )

    def __repr__(self) -> str:
        part = self.scene.objects[0].artefact.name
        return block(
            f"ViewPlan of {part}: {len(self.chosen)} of {len(self.candidates)} views by {self.by}",
            f"{share(self.coverage)} of the surface, {share(self.reachable)} can be reached",
        )

    def plot(self) -> Any:
        """Return a matplotlib figure: the part by number of measurements, from six sides."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        solved = self.solution
        return {
            "scene": self.scene.name,
            "part": self.scene.objects[0].artefact.name,
            "views": len(self.chosen),
            "by": self.by,
            "coverage": self.coverage,
            "reachable": self.reachable,
            "candidates": len(self.candidates),
            "refused": dict(self.refused),
            "greedy": {
                "views": len(self.choices[GREEDY]),
                "coverage": self.rows.coverage(self.choices[GREEDY]),
                "coverage_of_patches": self.patches.coverage(self.choices[GREEDY]),
            },
            "integer_programming": {
                "views": None if solved.views is None else len(solved.views),
                "coverage": None if solved.views is None else self.rows.coverage(solved.views),
                "coverage_of_patches": None
                if solved.views is None
                else self.patches.coverage(solved.views),
                "value": solved.value,
                "bound": solved.bound,
                "gap": solved.gap,
                "optimal": solved.optimal,
                "status": solved.status,
                "nodes": solved.nodes,
                "rows": solved.rows,
                "patches": len(self.patches.weights),
                "seconds": solved.seconds,
            },
            "margins_mm": None if self.margins_mm is None else dict(self.margins_mm),
            "seconds": dict(self.seconds),
        }


def plan_views(
    scene: Scene,
    max_views: int,
    *,
    part: int = 0,
    staging: Staging | None = None,
    counting: Counting | None = None,
    coverage: float | None = None,
    clearance_mm: float = 5.0,
    time_limit_s: float = 30.0,
    hardware: Hardware | None = None,
    on_progress: Callable[[str, float], None] | None = None,
) -> ViewPlan:
    """Choose the views of a part.

    Parameters
    ----------
    scene : Scene
        Of one camera and one projector, in grey light.
    max_views : int
        Views, at most.
    part : int
        Which of the scene's objects is measured; the others are left out.
    staging : Staging, optional
        Which poses there are to choose from.
    counting : Counting, optional
        What counts as measured.
    coverage : float, optional
        Share of the surface to be reached with as few views as possible; by default `max_views`
        cover as much as they can.
    clearance_mm : float
        Between devices' bodies and the part.
    time_limit_s : float
        Of integer programming.
    hardware : Hardware, optional
        Of the rig, for the constraints g1..g6.
    on_progress : callable, optional
        Called with the name of the stage and its finished fraction.

    Returns
    -------
    ViewPlan

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        For a scene that cannot be planned for, and where no candidate measures anything.

    Warns
    -----
    InputWarning
        For a coverage that cannot be reached, a rig that violates a constraint, and devices
        without bodies.
    """
    staging, counting = staging or Staging(), counting or Counting()
    report = on_progress or (lambda stage, fraction: None)
    if not 1 <= max_views <= MOST_VIEWS:
        raise InputError("views", f"from 1 to {MOST_VIEWS}", max_views)
    begin = time.perf_counter()
    scene = alone(scene, part)
    where = f"scene {scene.name}"
    scene.rig.only  # noqa: B018 - which refuses several
    if scene.focus is not None:
        scene = scene.all_in_focus()
    margins = None if hardware is None else _margins(hardware, scene.rig)
    _question(scene, margins, where)
    mesh = scene.objects[0].artefact.mesh
    samples = sample_surface(mesh, counting.samples)
    clear = Clearance(scene.rig, mesh, clearance_mm, staging.stage == "robot")
    found, refused = [], Counter[str]()
    for candidate in candidates(scene, staging):
        reason = clear.reason(candidate)
        if reason is None:
            found.append(candidate)
        else:
            refused[reason] += 1
    if not found:
        why = ", ".join(f"{count} {reason}" for reason, count in refused.items())
        raise InputError(where, "a pose of the part that the rig can see it in", why)
    predictor = Predictor(scene, samples, counting)
    sigma = np.empty((len(samples), len(found)), np.float32)
    for k, candidate in enumerate(found):
        sigma[:, k] = predictor.predict(candidate.pose).sigma_mm
        report("predict", (k + 1) / len(found))
    with np.errstate(invalid="ignore"):
        measured = np.isfinite(sigma) & (sigma <= counting.max_std_mm)
    seconds = {"predict": time.perf_counter() - begin}
    weights = np.full(len(samples), 1.0 / len(samples))
    rows = Rows(measured, weights, counting.min_measurements)
    reachable = float(weights[rows.reachable].sum())
    if reachable == 0.0:
        raise InputError(where, "a view that measures some of the part as asked for", "none")
    if coverage is not None and coverage > reachable + _ROUNDING:
        expected = f"all views together reach {100 * reachable:.2f} %, not {100 * coverage:.4g} %"
        warn_user(where, f"{expected}: as much as can be is covered by {max_views} views")
        coverage = None
    begin = time.perf_counter()
    report("choose", 0.0)
    patches = rows.patched(patches_of(samples, PATCHES))
    turns = uniform_turntables(found, max_views) if staging.stage == "rotary" else {}
    choices, solution = choose(
        rows, patches, max_views, coverage, turns.values(), time_limit_s=time_limit_s
    )
    report("choose", 1.0)
    seconds["choose"] = time.perf_counter() - begin
    return ViewPlan(
        scene=scene,
        object=part,
        staging=staging,
        counting=counting,
        candidates=tuple(found),
        refused=dict(refused),
        samples=samples,
        rows=rows,
        patches=patches,
        sigma_mm=sigma,
        choices=choices,
        by=best_of(rows, choices, coverage),
        solution=solution,
        wanted=coverage,
        margins_mm=margins,
        seconds=seconds,
    )


def choose(
    rows: Rows,
    patches: Rows,
    most: int,
    coverage: float | None = None,
    turntables: Iterable[Sequence[int]] = (),
    *,
    time_limit_s: float = 30.0,
) -> tuple[dict[str, tuple[int, ...]], Solution]:
    """Choose views in every way there is.

    Parameters
    ----------
    rows : Rows
        Samples by views.
    patches : Rows
        Patches by views, for integer programming.
    most : int
        Views, at most.
    coverage : float, optional
        To be reached by as few as possible.
    turntables : iterable of sequence of int
        Uniform ones, which a choice must not fall behind.
    time_limit_s : float

    Returns
    -------
    choices : dict of str to tuple of int
        By the name of the way; without integer programming where the solver found nothing.
    solution : Solution
        What the solver says.
    """
    choices = {GREEDY: tuple(greedy(rows, most, coverage))}
    solution = _solved(rows, patches, most, coverage, time_limit_s)
    if solution.views:
        choices[INTEGER] = solution.views
    known = [tuple(views) for views in turntables]
    if known:
        choices[UNIFORM] = min(known, key=lambda views: _worth(rows, views, coverage))
    return choices, solution


def best_of(rows: Rows, choices: Mapping[str, Sequence[int]], coverage: float | None = None) -> str:
    """Return the way whose choice covers most, or reaches a coverage with the fewest views."""
    return min(choices, key=lambda way: _worth(rows, choices[way], coverage))


def _solved(
    rows: Rows, patches: Rows, most: int, coverage: float | None, time_limit_s: float
) -> Solution:
    """Solve by patches; a coverage that is wanted is one of samples, which may fall short of it."""
    begin, asked = time.perf_counter(), coverage
    found = integer(patches, most, asked, time_limit_s=time_limit_s)
    if coverage is None:
        return found
    for _ in range(_ROUNDS):
        left = time_limit_s - (time.perf_counter() - begin)
        short = 0.0 if found.views is None else coverage - rows.coverage(found.views)
        if short <= _ROUNDING or left <= 0.0 or asked is None:
            break
        asked = min(asked + short, 1.0)
        again = integer(patches, most, asked, time_limit_s=left)
        if again.views is None:
            break
        found = again
    return found


def _worth(rows: Rows, views: Sequence[int], coverage: float | None) -> tuple[float, float]:
    """Return what is smaller for a better choice."""
    reached = rows.coverage(views)
    if coverage is None:
        return -reached, len(views)
    short = max(coverage - reached - _ROUNDING, 0.0)
    return short, len(views)


def _margins(hardware: Hardware, rig: Rig) -> dict[str, float]:
    """Return the margins of g1..g6 of a rig in its place, mm."""
    camera, projector = rig.camera.pose, rig.projector.pose
    placement = Placement(
        *(camera.rotation[np.newaxis], camera.position[np.newaxis]),
        *(projector.rotation[np.newaxis], projector.position[np.newaxis]),
        *(np.array([rig.camera_distance]), np.array([rig.projector_distance])),
        np.array([rig.angle]),
        np.array([True]),
    )
    values = placed_margins(hardware, placement)[0]
    return dict(zip(CONSTRAINTS, values.tolist(), strict=True))


def _question(scene: Scene, margins: Mapping[str, float] | None, where: str) -> None:
    """Warn of a rig that violates its constraints, and of bodies that are not stated."""
    bad = [f"{name} by {-value:.4g} mm" for name, value in (margins or {}).items() if value <= 0.0]
    if bad:
        doubt = "views are planned with it all the same, as they do not change it"
        warn_user(where, f"the rig violates {', '.join(bad)}: {doubt} (slbench design rig)")
    bare = [name for name, one in scene.rig.devices.items() if not one.has_body]
    if bare:
        warn_user(where, f"no body_mm of {' and '.join(bare)}: collisions are not looked for")
