"""The error budget of the sets of thesis ch. 7: every source of error switched on alone.

A use of :mod:`slbench.bench.budget`: its scenes with one source each, compared with three sets.
Here the floor has pinholes, so that lenses are a source too; what the scene has not (a bent
response, ambient light, interreflections, vibration) is tried at a size that real scanners have.

- *random* sources differ from scan to scan: standard deviation over the repeats.  Lenses are among
  them too: what they take of the modulation makes noise larger, that of finer fringes more;
- *steady* ones do not: root mean square over the pixels of how far the mean height moves from
  that of the floor, and the errors of the step heights, where there are steps.

How a source's effect depends on the number n of the finest fringes tells them apart: noise goes
as 1/n, movement not at all (:mod:`slbench.thesis.ch7.twoterm`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from slbench.bench.budget.sources import (
    VIBRATION_REPEATS,
    Kind,
    Progress,
    Source,
    ideal,
    measure_sources,
    moving,
    seen,
    shown,
)
from slbench.bench.compare.comparison import Comparison, SetResult
from slbench.scene.model import Light, Scene
from slbench.scene.truth import GroundTruth, Status
from slbench.simulate.lights import Lights
from slbench.simulate.transport import LightTransport
from slbench.thesis.ch7.twoterm import detector_of, exponent
from slbench.thesis.published import FINEST, SETS

Array = NDArray[np.float64]
#: Gammas of a projector that is taken for a linear one: nearly corrected, and not at all.
_GAMMAS = (1.1, 2.2)
#: Ambient irradiance over that of the fully lit panel.
_AMBIENT = 0.25
#: Interreflections that are followed.
_BOUNCES = 2


@dataclass(frozen=True)
class Row:
    """What a source does to each of the sets.

    ``std_mm`` is the median standard deviation of a point, ``std_z_mm`` that of its height;
    ``steady_mm`` the RMS over pixels of the mean height's change from the floor (for the floor
    itself: from the truth), ``heights_mm`` the RMS error of the step heights, NaN without steps;
    ``order_errors`` the share of wrong fringe orders.
    """

    name: str
    kind: Kind
    std_mm: tuple[float, ...]
    std_z_mm: tuple[float, ...]
    steady_mm: tuple[float, ...]
    heights_mm: tuple[float, ...]
    order_errors: tuple[float, ...]

    @property
    def ratios(self) -> tuple[float, ...]:
        """Standard deviation of every set over that of the first."""
        first = self.std_mm[0]
        return tuple(std / first if first > 0 else float("nan") for std in self.std_mm)

    @property
    def exponent(self) -> float:
        """The power of the number of fringes that the standard deviation follows."""
        return exponent(FINEST, self.std_mm)


@dataclass(frozen=True, eq=False)
class Budget:
    """Error budget of the sets of thesis ch. 7 on a scene."""

    rows: tuple[Row, ...]
    parameters: dict[str, float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Row:
        """Return the row of a source."""
        return next(row for row in self.rows if row.name == name)


def object_truth(truth: GroundTruth, index: int = 0) -> GroundTruth:
    """Return the truth with one object lit alone: a stage is no part of a comparison."""
    dark = truth.lit & (truth.object_id != index)
    return replace(truth, status=np.where(dark, np.uint8(Status.SHADOWED), truth.status))


def variations(
    scene: Scene, transport: LightTransport, *, vibration_px: float, repeats: int
) -> list[Source]:
    """Return the scene with each source alone, the floor first and everything last.

    Parameters
    ----------
    scene : Scene
        Its detector, apertures and panel say how large each source is.
    transport : LightTransport
        Of the scene, for how bright it is.
    vibration_px, repeats
        See :func:`error_budget`.
    """
    base, real = ideal(scene), detector_of(scene)
    shot = seen(base, real, "shot")
    linear = scene.rig.projector.linear()
    lenses = scene.rig.having(projector=linear)
    albedo = scene.objects[0].material.bsdf.model_dump()["albedo"]  # of a diffuse spray
    white = float(np.median(transport.white()[transport.white() > 0]))
    ambient = Light(ambient_w_per_mm2=_AMBIENT * math.pi * white / albedo)
    bits = scene.rig.projector.bit_depth
    rounded, fixed = seen(base, real, "rounding"), seen(base, real, "pattern")
    bounces = replace(base, light=Light(bounces=_BOUNCES))
    # What lenses take of the modulation, finer fringes lose more of.
    weak = replace(shot, rig=lenses)
    lit = replace(shot, light=ambient)
    moved = moving(base, vibration_px)
    return [
        Source("floor: footprint, square panel pixels, samples", "steady", base),
        Source("other samples of the light", "steady", base, other_samples=True),
        Source("lenses (defocus, diffraction, blur)", "steady", replace(base, rig=lenses)),
        Source(f"panel of {bits} bit", "steady", shown(base, bit_depth=bits)),
        *(Source(f"projector gamma {g}", "steady", shown(base, gamma=g)) for g in _GAMMAS),
        Source(f"quantisation, {real.bit_depth} bit", "steady", rounded),
        Source("fixed pattern (PRNU, DSNU)", "steady", fixed),
        Source(f"interreflections, {_BOUNCES} bounces", "steady", bounces),
        Source("shot noise", "random", shot, repeats),
        Source("shot noise, modulation lost by lenses", "random", weak, repeats),
        Source("read noise", "random", seen(base, real, "read"), repeats),
        Source(f"shot noise under ambient light, {_AMBIENT:g} of white", "random", lit, repeats),
        Source(f"vibration, {vibration_px:g} px", "random", moved, repeats * VIBRATION_REPEATS),
        Source("everything in the scene", "random", scene, repeats),
    ]


def error_budget(
    scene: Scene,
    transport: LightTransport,
    truth: GroundTruth,
    *,
    vibration_px: float,
    repeats: int = 15,
    seed: int = 0,
    on_progress: Progress | None = None,
) -> Budget:
    """Measure what every source of error does alone to the sets of thesis ch. 7.

    Parameters
    ----------
    scene : Scene
        Without focus settings.
    transport : LightTransport
        Of the scene as it is, with the marginal "u".
    truth : GroundTruth
        Of the pixels to compare (:func:`object_truth`).
    vibration_px : float
        Standard deviation of the vibration that is tried.
    repeats : int
        Scans of random sources, four times as many for vibration.
    seed : int
    on_progress : callable, optional

    Returns
    -------
    Budget
    """
    chosen = variations(scene, transport, vibration_px=vibration_px, repeats=repeats)
    lights = Lights(seed, kept=len(chosen))
    lights.put(scene, (transport,))
    found = measure_sources(
        *(chosen, SETS, ("u",)), seed=seed, truth=truth, lights=lights, on_progress=on_progress
    )
    floor = found[0]
    rows = [
        _row(one, each, None if each is floor else floor)
        for one, each in zip(chosen, found, strict=True)
    ]
    return Budget(tuple(rows), {"vibration_px": vibration_px})


def heights_rms_mm(result: SetResult) -> float:
    """Return the RMS error of a set's mean step heights, mm; NaN without steps."""
    if not result.steps:
        return float("nan")
    errors = [step.deviation_mm for step in result.steps]
    return math.sqrt(float(np.mean(np.square(errors))))


def _row(one: Source, found: Comparison, floor: Comparison | None) -> Row:
    steady = []
    for k, result in enumerate(found.sets):
        moved = result.error_mm if floor is None else result.error_mm - floor.sets[k].error_mm
        steady.append(math.sqrt(float(np.nanmean(moved**2))))
    return Row(
        one.name,
        one.kind,
        tuple(r.std_median_mm for r in found.sets),
        tuple(r.std_z_median_mm for r in found.sets),
        tuple(steady),
        tuple(heights_rms_mm(r) for r in found.sets),
        tuple(r.order_error_rate for r in found.sets),
    )
