"""The acceptance of a scanner: its tests, what explains their errors, and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from slbench.bench.accept.definitions import STANDARDS, StandardKind
from slbench.bench.accept.evaluate import Measured, Place, PlaceError
from slbench.bench.accept.plan import plan, with_views
from slbench.bench.accept.registering import Register
from slbench.bench.accept.signatures import Explanation, alike, calibration_draws, explain
from slbench.bench.accept.standards import Standard, usual_standard
from slbench.bench.accept.verdict import (
    Limit,
    Outcome,
    Tested,
    Worse,
    judged_tests,
    overall,
)
from slbench.cloud.triangulation import Axis
from slbench.core.errors import InputError, warn_user
from slbench.core.random import tagged_seed
from slbench.core.show.display import block
from slbench.core.show.document import Table
from slbench.core.show.drawing import figure
from slbench.core.units import UM
from slbench.rig import Rig
from slbench.rig.parameters import ParameterCovariance
from slbench.scene.model import Scene
from slbench.simulate.lights import Lights

Progress = Callable[[str, float], None]
#: Share of a size's variance that more samples would take away, beyond which it is said.
_MOST_BY_SAMPLES = 0.5

#: Of a test that an earlier acceptance holds the instrument to.
UNMEASURED = "held, and not measured"

NOTE = (
    "u: standard uncertainty of the test (certificate, expansion, temperature, fit, sampling). "
    "Pass and fail by ISO 14253-1 with 95 %: a guard band of 1.645 u, a signed error within both "
    "limits. By the definitions of VDI/VDE 2634 parts 2 and 3 and ISO 10360-13:2021; no accredited "
    "procedure."
)
#: Beside it where it is so.
TOO_FEW = "In fewer places than VDI/VDE 2634-2 asks for nothing passes."


@dataclass(frozen=True, eq=False, kw_only=True)
class Acceptance:
    """What an acceptance found.

    Parameters
    ----------
    name : str
        Of the scene or the folder.
    tests : tuple of Tested
    places : tuple of Measured
    views : int
        Registered views of each place.
    explanations : tuple of Explanation
        Parameters of the rig that explain the errors, best first; empty where nothing failed, or
        no rig is known.
    rig : Rig or None
        That measured.
    traces : int
        How often light was traced.
    seed : int
    worse : tuple of Worse
        Tests that are worse than an earlier acceptance holds the instrument to.
    unmeasured : tuple of str
        Tests that it holds the instrument to, and this one has not.
    parameters : mapping
        For the provenance.
    """

    name: str
    tests: tuple[Tested, ...]
    places: tuple[Measured, ...]
    views: int = 1
    explanations: tuple[Explanation, ...] = ()
    rig: Rig | None = None
    traces: int = 0
    seed: int = 0
    worse: tuple[Worse, ...] = ()
    unmeasured: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Tested:
        """Return a test by its name."""
        return next(one for one in self.tests if one.test.name == name)

    @property
    def outcome(self) -> Outcome:
        """Fail if one test fails or is worse than it was, else undecided if one is, else pass.

        A test that is held and was not measured is undecided.
        """
        held: list[Outcome] = ["fail" for _ in self.worse]
        held += ["undecided" for _ in self.unmeasured]
        return overall([*held, *(one.outcome for one in self.tests)])

    @property
    def status(self) -> int:
        """Exit status: 0 pass or no limits, 1 fail, 3 undecided."""
        return {"pass": 0, "no limit": 0, "fail": 1, "undecided": 3}[self.outcome]

    def __repr__(self) -> str:
        lines = [
            f"{one.test.words}: {UM * one.worst.value.error_mm:.3g} µm, {one.outcome}"
            for one in self.tests
        ]
        return block(f"Acceptance of {self.name}: {self.outcome}", *lines)

    def table(self) -> Table:
        """Lay out the tests: the worst place of each beside its limit."""
        rows = []
        for one in self.tests:
            worst = one.worst
            limit = None if worst.limit_mm is None else UM * worst.limit_mm
            rows.append(
                (
                    f"{one.test.symbol} {one.test.words}".strip(),
                    one.places,
                    worst.value.place,
                    UM * worst.value.error_mm,
                    UM * worst.value.u_test_mm,
                    limit,
                    one.outcome,
                )
            )
        columns = ("test", "places", "worst", "error / µm", "u / µm", "limit / µm", "verdict")
        return Table(f"Acceptance of {self.name}", columns, tuple(rows), self.note())

    def note(self) -> str:
        """Say what the numbers are, and where there are too few places."""
        return f"{NOTE} {TOO_FEW}" if any(one.too_few for one in self.tests) else NOTE

    def why(self) -> str:
        """Say which parameter of the rig explains the errors best; empty where none is asked."""
        if not self.explanations:
            return ""
        best, *others = alike(self.explanations)
        words = f"explained best by {best.text()}"
        if others:
            words += "; as well by " + ", ".join(one.text() for one in others)
        return words

    def against(self) -> tuple[str, ...]:
        """Return what an earlier acceptance makes of this one, a line each."""
        lacking = (f"{name}: {UNMEASURED}" for name in self.unmeasured)
        return (*(one.text() for one in self.worse), *lacking)

    def plot(self) -> Any:
        """Return a matplotlib figure: the places in the volume, and the errors beside limits."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "name": self.name,
            "outcome": self.outcome,
            "views": self.views,
            "traces": self.traces,
            "seed": self.seed,
            "tests": [_plain(one, self.views) for one in self.tests],
            "points": [
                {"place": one.place.name, "points": one.count, "left_out": one.left_out}
                for one in self.places
            ],
            "explanations": [vars(one) for one in self.explanations],
            "worse": [vars(one) for one in self.worse],
            "unmeasured": list(self.unmeasured),
            "note": self.note(),
        }


def _plain(result: Tested, views: int) -> dict[str, Any]:
    return {
        "test": result.test.name,
        "symbols": result.test.label(views),
        "outcome": result.outcome,
        "note": f"{result.places} places" if result.too_few else "",
        "limit_um": None if result.limit is None else str(result.limit),
        "worst_place": result.worst.value.place,
        "error_mm": result.worst.value.error_mm,
        "u_mm": result.worst.value.u_test_mm,
        "places": [
            {
                "place": one.value.place,
                "error_mm": one.value.error_mm,
                "measured_mm": one.value.measured_mm,
                "certified_mm": one.value.certified_mm,
                "u_test_mm": one.value.u_test_mm,
                "u_mm": dict(one.value.u_mm),
                "u_calibration_mm": one.value.u_calibration_mm,
                "interval_mm": list(one.value.interval_mm),
                "limit_mm": one.limit_mm,
                "outcome": one.outcome,
            }
            for one in result.judged
        ],
    }


def planned(
    scene: Scene,
    standards: Mapping[StandardKind, Standard] | None = None,
    *,
    kinds: Sequence[StandardKind] = STANDARDS,
    counts: Mapping[StandardKind, int] | None = None,
    views: int = 1,
) -> list[Place]:
    """Place standards in the measurement volume of a scene's rig.

    Parameters
    ----------
    scene : Scene
    standards : mapping of kind to Standard, optional
        With their certificates; by default of the sizes that fit the volume.
    kinds : sequence of {"sphere", "ball_bar", "plane"}
        Which are measured.
    counts : mapping of kind to int, optional
        How many places; by default as few as VDI/VDE 2634-2 allows.
    views : int
        Of each place.

    Raises
    ------
    InputError
        If the devices do not see enough places.
    """
    found: list[Place] = []
    for kind in kinds:
        standard = (standards or {}).get(kind) or usual_standard(kind, scene.rig.volume_mm)
        own = plan(scene.rig, scene.place, standard, (counts or {}).get(kind))
        found += own if views == 1 else with_views(scene.rig, scene.place, own, views)
    return found


def accept(
    scene: Scene,
    places: Sequence[Place] | None = None,
    *,
    limits: Mapping[str, Limit] | None = None,
    covariance: ParameterCovariance | None = None,
    register: Register = "poses",
    seed: int = 0,
    noise: bool = True,
    lights: Lights | None = None,
    on_progress: Progress | None = None,
) -> Acceptance:
    """Accept a virtual scanner: measure standards in many places, and judge the errors.

    Definitions are those of :mod:`slbench.bench.accept.definitions`, VDI/VDE 2634 parts 2 and 3
    and ISO 10360-13:2021; this is no accredited procedure.

    Parameters
    ----------
    scene : Scene
        Rig, detector and patterns; its objects are left out, but the material of the first is
        that of the standards.  What it is measured with may be another rig (``measured_with``).
    places : sequence of Place, optional
        By default those of :func:`planned`.
    limits : mapping of str to Limit, optional
        Maximum permissible errors by name of the test.
    covariance : ParameterCovariance, optional
        Of the measuring rig's parameters; by default the scene's calibration's, or what stands
        beside the rig that it measures with.
    register : {"poses", "spheres"}
        How several views of a place are registered.
    seed : int
        Of samples and noise.
    noise : bool
    lights : Lights, optional
        Light that is at hand.
    on_progress : callable, optional

    Returns
    -------
    Acceptance

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        If places are not seen, or too little of a standard was measured.

    Warns
    -----
    InputWarning
        If the renderer's samples make most of the uncertainty of a size, or of a form that is
        undecided.
    """
    from slbench.bench.accept.virtual import light_of, measure

    places = planned(scene) if places is None else places
    if not places:
        raise InputError("places", "at least one", "none")
    light = lights or Lights(seed, kept=1)
    before, made = light.traces, scene.calibration
    rig: Rig | None = scene.rig if made is None else made.rig_for(scene.rig, seed)
    if made is not None and made.model is not None:
        rig = None
    known = covariance
    if known is None and made is not None:
        known = made.covariance or made.beside
    measured: list[Measured] = []
    for k, place in enumerate(places):

        def progress(part: float, done: int = k, of: int = len(places)) -> None:
            if on_progress:
                on_progress("places", (done + part) / of)

        stored = light_of(scene, place, light, progress)
        measured.append(
            measure(stored, seed=tagged_seed(seed, k), noise=noise, rig=rig, register=register)
        )
        progress(1.0)
    found = assembled(
        scene.name,
        measured,
        limits=limits,
        rig=rig,
        axes=scene.sequence.axes,
        covariance=known,
        traces=light.traces - before,
        seed=seed,
        parameters={
            "scene": scene.specification,
            "patterns": scene.sequence.to_dict(),
            "register": register,
        },
    )
    if doubt := _samples_doubt(found):
        warn_user(f"scene {scene.name}", doubt)
    return found


def _samples_doubt(found: Acceptance) -> str | None:
    """Say where the renderer's samples make most of a test's uncertainty; None where nowhere."""
    for one in found.tests:
        value = one.worst.value
        sampling = value.u_mm["sampling"]
        # Of a form the samples leave much at preview size, which matters where it decides.
        matters = one.test.signed or (one.outcome == "undecided" and not one.too_few)
        if matters and sampling**2 > _MOST_BY_SAMPLES * value.u_test_mm**2:
            return (
                f"sampling makes {UM * sampling:.3g} of the {UM * value.u_test_mm:.3g} µm "
                f"uncertainty of {one.test.words}: more samples would change it (--spp)"
            )
    return None


def assembled(
    name: str,
    measured: Sequence[Measured],
    *,
    limits: Mapping[str, Limit] | None = None,
    rig: Rig | None = None,
    axes: Sequence[Axis] = ("u",),
    covariance: ParameterCovariance | None = None,
    traces: int = 0,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
) -> Acceptance:
    """Judge measured places.

    Parameters
    ----------
    name : str
    measured : sequence of Measured
    limits : mapping of str to Limit, optional
    rig : Rig, optional
        That measured; without one nothing explains the errors.
    axes : sequence of {"u", "v"}
        Coded axes.
    covariance : ParameterCovariance, optional
        Of the rig's parameters.
    traces, seed : int
    parameters : mapping, optional
        For the provenance.

    Raises
    ------
    InputError
        For no places.
    """
    if not measured:
        raise InputError("places", "at least one", "none")
    values: list[PlaceError] = []
    for place in measured:
        draws = []
        if rig is not None and covariance is not None:
            draws = calibration_draws(rig, place, axes, covariance)
        values += place.values(draws)
    tests = judged_tests(with_sampling(values), limits or {})
    explanations: tuple[Explanation, ...] = ()
    if rig is not None and any(one.outcome == "fail" for one in tests):
        explanations = explain(rig, measured, axes)
    return Acceptance(
        name=name,
        tests=tests,
        places=tuple(measured),
        views=max(place.views for place in measured),
        explanations=explanations,
        rig=rig,
        traces=traces,
        seed=seed,
        parameters=parameters or {},
    )


def with_sampling(values: Sequence[PlaceError]) -> list[PlaceError]:
    """Return values whose part of sampling is pooled over places: a draw each says little."""
    pooled = {
        name: float(np.sqrt(np.mean([v.u_mm["sampling"] ** 2 for v in values if v.test == name])))
        for name in {value.test for value in values}
    }
    return [replace(v, u_mm={**v.u_mm, "sampling": pooled[v.test]}) for v in values]
