"""The error budget of pattern sets: every source of error switched on alone.

A scan without any: devices with pinholes (and so without defocus, diffraction and blur), panel
values that are neither quantised nor bent, a detector without noise whose grey levels are so fine
that rounding does not matter, no other light, nothing that moves.  What is left then is the
*floor*: the projector's square pixels, the camera pixel's footprint and the samples of the light
transport.  To this, one source at a time is added:

- *random* sources differ from scan to scan: standard deviation over the repeats.  Lenses are among
  them too: what they take of the modulation makes noise larger, that of finer fringes more;
- *steady* ones do not: root mean square over the pixels of how far the mean height moves from
  that of the floor, and the errors of the step heights, where there are steps.

How a source's effect depends on the number n of the finest fringes tells them apart: noise goes
as 1/n, movement not at all (:mod:`slbench.thesis.ch7.twoterm`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from slbench.bench.compare.compare import compare
from slbench.bench.compare.comparison import Comparison, SetResult
from slbench.detector.emva1288 import Detector
from slbench.rig import Camera, Projector
from slbench.scene.model import Light, Scene
from slbench.scene.truth import GroundTruth, Status
from slbench.simulate.stack import traced
from slbench.simulate.transport import LightTransport
from slbench.thesis.ch7.twoterm import detector_of, exponent
from slbench.thesis.published import FINEST, SETS

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
Kind = Literal["random", "steady"]
AnyDevice = TypeVar("AnyDevice", Camera, Projector)

#: Electrons of a detector whose shot noise does not matter.
_BOTTOMLESS = 1e12
#: Gammas of a projector that is taken for a linear one: nearly corrected, and not at all.
_GAMMAS = (1.1, 2.2)
#: Ambient irradiance over that of the fully lit panel.
_AMBIENT = 0.25
#: Interreflections that are followed.
_BOUNCES = 2
#: Vibration needs more repeats: all pixels of a frame move together, so that the mean over
#: pixels does not average over movements.
_VIBRATION_REPEATS = 4


@dataclass(frozen=True)
class Variation:
    """A scene with one source of error, and the light that it is seen in."""

    name: str
    kind: Kind
    scene: Scene
    light: str = "pinhole"
    repeats: int = 1


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


def _pinhole(device: AnyDevice) -> AnyDevice:
    """Return a device whose lens spreads nothing."""
    return replace(device, lens=replace(device.lens, aperture_radius_mm=0.0), blur_px=0.0)


def ideal(scene: Scene) -> Scene:
    """Return the scene without any source of error that can be switched off."""
    still = replace(scene.exposure, vibration_px=0.0)
    camera = _pinhole(scene.rig.camera)
    projector = replace(_pinhole(scene.rig.projector), bit_depth=None, gamma=1.0)
    return replace(
        scene,
        rig=scene.rig.having(
            camera=camera, projector=replace(projector, bit_depth=None, gamma=1.0)
        ),
        focus=None,
        detector=Detector(
            bit_depth=16,
            full_well_e=_BOTTOMLESS,
            read_noise_e=0.0,
            dark_current_e_per_s=0.0,
            quantum_efficiency=detector_of(scene).quantum_efficiency,
            prnu=0.0,
            dsnu_e=0.0,
            seed=detector_of(scene).seed,
        ),
        exposure=still,
        light=Light(),
    )


def variations(
    scene: Scene, transport: LightTransport, *, vibration_px: float, repeats: int
) -> list[Variation]:
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
    scale = _BOTTOMLESS / real.saturation_e
    fine = detector_of(base)

    def seen(**changes: Any) -> Scene:
        return replace(base, detector=replace(fine, **changes))

    def shown(**changes: Any) -> Scene:
        projector = replace(base.rig.projector, **changes)
        return replace(base, rig=base.rig.having(projector=projector))

    shot = seen(full_well_e=real.saturation_e)
    still = replace(base.exposure, vibration_px=vibration_px)
    linear = replace(scene.rig.projector, bit_depth=None, gamma=1.0)
    lenses = scene.rig.having(projector=linear)
    albedo = scene.objects[0].material.bsdf.model_dump()["albedo"]  # of a diffuse spray
    white = float(np.median(transport.white()[transport.white() > 0]))
    ambient = Light(ambient_w_per_mm2=_AMBIENT * math.pi * white / albedo)
    bits = scene.rig.projector.bit_depth
    many = repeats * _VIBRATION_REPEATS
    return [
        Variation("floor: footprint, square panel pixels, samples", "steady", base),
        Variation("other samples of the light", "steady", base, "other samples"),
        Variation(
            "lenses (defocus, diffraction, blur)", "steady", replace(base, rig=lenses), "lenses"
        ),
        Variation(f"panel of {bits} bit", "steady", shown(bit_depth=bits)),
        *(Variation(f"projector gamma {g}", "steady", shown(gamma=g)) for g in _GAMMAS),
        Variation(f"quantisation, {real.bit_depth} bit", "steady", seen(bit_depth=real.bit_depth)),
        Variation(
            "fixed pattern (PRNU, DSNU)",
            "steady",
            seen(prnu=real.prnu, dsnu_e=real.dsnu_e * scale),
        ),
        Variation(
            f"interreflections, {_BOUNCES} bounces",
            "steady",
            replace(base, light=Light(bounces=_BOUNCES)),
            "bounces",
        ),
        Variation("shot noise", "random", shot, repeats=repeats),
        # What lenses take of the modulation, finer fringes lose more of.
        Variation(
            "shot noise, modulation lost by lenses",
            "random",
            replace(shot, rig=lenses),
            "lenses",
            repeats,
        ),
        Variation(
            "read noise", "random", seen(read_noise_e=real.read_noise_e * scale), repeats=repeats
        ),
        Variation(
            f"shot noise under ambient light, {_AMBIENT:g} of white",
            "random",
            replace(shot, light=ambient),
            "ambient",
            repeats,
        ),
        Variation(
            f"vibration, {vibration_px:g} px",
            "random",
            replace(base, exposure=still),
            repeats=many,
        ),
        Variation("everything in the scene", "random", scene, "lenses", repeats),
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
    lights: dict[str, tuple[LightTransport, ...]] = {"lenses": (transport,)}
    rows: list[Row] = []
    floor: Comparison | None = None
    for k, one in enumerate(chosen):
        if one.light not in lights:
            own = seed + 1 if one.light == "other samples" else seed
            lights[one.light] = traced(one.scene, ("u",), seed=own)
        found = compare(
            one.scene,
            SETS,
            # Two scans of a steady source are the same scan, twice.
            repeats=max(2, one.repeats),
            seed=seed,
            transports=lights[one.light],
            truth=truth,
        )
        floor = floor or found
        rows.append(_row(one, found, None if found is floor else floor))
        if on_progress:
            on_progress("budget", (k + 1) / len(chosen))
    return Budget(tuple(rows), {"vibration_px": vibration_px})


def heights_rms_mm(result: SetResult) -> float:
    """Return the RMS error of a set's mean step heights, mm; NaN without steps."""
    if not result.steps:
        return float("nan")
    errors = [step.deviation_mm for step in result.steps]
    return math.sqrt(float(np.mean(np.square(errors))))


def _row(one: Variation, found: Comparison, floor: Comparison | None) -> Row:
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
