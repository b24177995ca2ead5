"""Sources of error, each a scene in which it is switched on alone.

:func:`ideal` is a scene without any: panel values that are neither quantised nor bent, a detector
without noise whose grey levels are so fine that rounding does not matter, no other light, nothing
that moves.  What is left then is the *floor*: the projector's square pixels, the camera pixel's
footprint and the samples of the light.  To this, one source at a time is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np

from slbench.bench.compare.compare import compare
from slbench.bench.compare.comparison import Comparison
from slbench.bench.compare.sets import PatternSet
from slbench.detector.emva1288 import Detector
from slbench.patterns import PatternSource
from slbench.rig import Camera, Projector
from slbench.scene.model import Exposure, Light, Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.expose import NothingLit, lighting, shutter_for
from slbench.simulate.lights import Lights
from slbench.simulate.moving import still
from slbench.simulate.transport import LightTransport, Marginal

Progress = Callable[[str, float], None]
Kind = Literal["random", "steady"]
AnyDevice = TypeVar("AnyDevice", Camera, Projector)

#: Electrons of a detector whose shot noise does not matter.
BOTTOMLESS_E = 1e12
#: Vibration needs more repeats: all pixels of a frame move together, so that the mean over
#: pixels does not average over movements.
VIBRATION_REPEATS = 4


@dataclass(frozen=True)
class Source:
    """A scene with one source of error.

    Parameters
    ----------
    name : str
    kind : {"random", "steady"}
        Whether it differs from scan to scan, where it is alone.
    scene : Scene
    repeats : int
        Scans; two of a steady source are the same scan, twice.
    counted : bool
        False for what is part of another source, and shown to explain it.
    other_samples : bool
        Whether its light has samples of its own.
    dithered : bool
        Whether the noise of the whole scene makes a steady source random: rounding, of noise that
        is more than half a step.
    beyond : str
        Name of the source that a steady one is measured from; the floor by default.
    """

    name: str
    kind: Kind
    scene: Scene
    repeats: int = 2
    counted: bool = True
    other_samples: bool = False
    dithered: bool = False
    beyond: str = ""

    @property
    def adds_to(self) -> Kind:
        """What it is a part of in the whole scene."""
        return "random" if self.dithered else self.kind


def pinhole(device: AnyDevice) -> AnyDevice:
    """Return a device whose lens spreads nothing."""
    return replace(device, lens=replace(device.lens, aperture_radius_mm=0.0), blur_px=0.0)


def ideal(scene: Scene, *, lenses: bool = False) -> Scene:
    """Return the scene without any source of error that can be switched off.

    Parameters
    ----------
    scene : Scene
    lenses : bool
        Whether the lenses stay as they are, with defocus, diffraction and blur; otherwise they are
        pinholes, in focus everywhere.
    """
    camera, projector = scene.rig.camera, scene.rig.projector
    if not lenses:
        camera, projector = pinhole(camera), pinhole(projector)
    real = scene.detector if isinstance(scene.detector, Detector) else Detector()
    scene = still(scene)
    return replace(
        scene,
        rig=scene.rig.having(camera=camera, projector=projector.linear()),
        focus=scene.focus if lenses else None,
        detector=Detector(
            bit_depth=16,
            full_well_e=BOTTOMLESS_E,
            read_noise_e=0.0,
            dark_current_e_per_s=0.0,
            quantum_efficiency=real.quantum_efficiency,
            prnu=0.0,
            dsnu_e=0.0,
            seed=real.seed,
        ),
        exposure=replace(scene.exposure.without_frame_errors(), vibration_px=0.0),
        light=Light(),
        calibration=None,
    )


def seen(base: Scene, real: Detector, *parts: str, further_e2: float = 0.0) -> Scene:
    """Return an ideal scene with parts of a real detector.

    Parameters
    ----------
    base : Scene
    real : Detector
    parts : str
        Of ``"shot"``, ``"read"``, ``"pattern"`` (PRNU and DSNU) and ``"rounding"``.  Charges are
        scaled with full well, so that each is as large a share of it as with the real detector.
    further_e2 : float
        Variance to add to that of read noise, electrons squared.
    """
    scale = BOTTOMLESS_E / real.saturation_e
    changes: dict[str, Any] = {}
    if "shot" in parts:
        scale = 1.0
        changes["full_well_e"] = real.saturation_e
    if "read" in parts:
        changes["read_noise_e"] = math.sqrt(real.read_noise_e**2 + further_e2) * scale
    if "pattern" in parts:
        changes |= {"prnu": real.prnu, "dsnu_e": real.dsnu_e * scale}
    if "rounding" in parts:
        changes["bit_depth"] = real.bit_depth
    assert isinstance(base.detector, Detector)  # an ideal scene's
    return replace(base, detector=replace(base.detector, **changes))


def shown(base: Scene, **changes: Any) -> Scene:
    """Return an ideal scene with another panel: ``bit_depth``, ``gamma``, ``curve``."""
    projector = replace(base.rig.projector, **changes)
    return replace(base, rig=base.rig.having(projector=projector))


def moving(base: Scene, vibration_px: float) -> Scene:
    """Return an ideal scene that vibrates."""
    return _exposed(base, vibration_px=vibration_px)


def in_motion(base: Scene, scene: Scene, time_s: float) -> Scene:
    """Return an ideal scene with the motion of another, whose exposure lasts `time_s`."""
    own = scene.exposure
    return _exposed(
        replace(base, objects=scene.objects, rig_motion=scene.rig_motion),
        frame_period_s=own.timing(time_s).period_s,
        rolling_shutter_s=own.rolling_shutter_s,
        pulse_s=own.open_s(time_s),
    )


def metered(scene: Scene, transport: LightTransport) -> tuple[Scene, float]:
    """Return a scene with its exposure as a share of saturation, and its exposure time, s.

    An absolute exposure means another share with another detector, and none with a pinhole.
    """
    exposure, camera = scene.exposure, scene.rig.camera
    with lighting(scene):
        shutter = shutter_for(transport, camera, scene.detector, exposure)
    if exposure.time_s is None:
        return scene, shutter.time_s
    seen = [(white.astype(np.float64), white > dark) for white, dark in transport.whites()]
    # The brightest channel decides, as in an automatic exposure.
    full = [scene.detector.exposure_scale(one[lit], 1.0) for one, lit in seen if lit.any()]
    if not full:
        raise NothingLit("scene", "an object that the projector lights", "none")
    shortest = min(exposure.bracket)  # whose level is a share of saturation
    level = min(shortest * shutter.photons / min(full), 1.0)
    multiples = tuple(factor / shortest for factor in exposure.bracket)
    shares = replace(exposure, time_s=None, white_level=level, bracket=multiples)
    return replace(scene, exposure=shares), shortest * shutter.time_s


def sources_of(scene: Scene, time_s: float, repeats: int) -> list[Source]:
    """Return what a scene has of sources of error, the floor first.

    Lenses are as they are in all of them: what they take of the modulation makes noise larger, and
    what they blur of the panel's pixels makes the floor smaller.  Noise is that of the scene's own
    light: its panel, ambient light and interreflections included.

    Parameters
    ----------
    scene : Scene
        Its exposure is a share of saturation (:func:`metered`).
    time_s : float
        Exposure of a frame, for dark current.
    repeats : int
        Scans of random sources.
    """
    base, sharp = ideal(scene, lenses=True), ideal(scene)
    projector, camera, real = scene.rig.projector, scene.rig.camera, scene.detector
    bending = {"gamma": projector.gamma, "curve": projector.curve}
    panel = {"bit_depth": projector.bit_depth} | bending
    lit, sharply_lit = (shown(replace(b, light=scene.light), **panel) for b in (base, sharp))
    found = [
        Source("floor: footprint, square panel pixels", "steady", base),
        Source(
            "samples of the light (part of the floor)",
            "steady",
            base,
            counted=False,
            other_samples=True,
        ),
    ]
    spreading = any(d.lens.aperture_radius_mm > 0.0 or d.blur_px > 0.0 for d in (camera, projector))
    if spreading:
        name = "lenses: change of the floor by defocus, diffraction, blur"
        found.append(Source(name, "steady", sharp, counted=False))
    coarse, rounding = base, ""
    if projector.bit_depth is not None:
        coarse = shown(base, bit_depth=projector.bit_depth)
        rounding = f"panel of {projector.bit_depth} bit"
        found.append(Source(rounding, "steady", coarse))
    if not projector.response.linear:
        words = f"gamma {projector.gamma:g}" if projector.curve is None else "a measured curve"
        found.append(Source(f"response, {words}", "steady", shown(base, **bending)))
    if scene.light.bounces:
        name = f"interreflections, {scene.light.bounces} bounces"
        lone = replace(base, light=Light(bounces=scene.light.bounces))
        found.append(Source(name, "steady", lone))
    if scene.calibration is not None:
        own = replace(base, calibration=scene.calibration)
        kind: Kind = "random" if scene.calibration.redraw else "steady"
        many = repeats if scene.calibration.redraw else 2
        words = scene.calibration.source or "aligned"
        found.append(Source(f"calibration ({words})", kind, own, many))
    if isinstance(real, Detector):
        grey_e = 0.5 * scene.exposure.white_level * real.saturation_e
        noisy = math.sqrt(grey_e + real.read_noise_e**2) > 0.5 * real.e_per_dn
        name = f"quantisation, {real.bit_depth} bit" + ", made random by noise" * noisy
        rounded = seen(base, real, "rounding")
        found.append(Source(name, "steady", rounded, dithered=noisy))
        if real.prnu or real.dsnu_e:
            name = "fixed pattern (PRNU, DSNU)"
            found.append(Source(name, "steady", seen(base, real, "pattern")))
        found.append(Source("shot noise", "random", seen(lit, real, "shot"), repeats))
        if scene.light.has_surroundings:
            dark = replace(lit, light=Light(bounces=scene.light.bounces))
            name = "shot noise without ambient light"
            found.append(Source(name, "random", seen(dark, real, "shot"), repeats, counted=False))
        if spreading:
            name = "shot noise through ideal lenses"
            through = seen(sharply_lit, real, "shot")
            found.append(Source(name, "random", through, repeats, counted=False))
        dark_e = real.dark_current_e_per_s * time_s
        if real.read_noise_e or dark_e:
            read = seen(lit, real, "read", further_e2=dark_e)
            found.append(Source("read noise and dark current", "random", read, repeats))
    else:
        whole = replace(lit, detector=real)
        found.append(Source(f"detector {type(real).__name__}", "random", whole, repeats))
    if scene.exposure.vibration_px > 0.0:
        name = f"vibration, {scene.exposure.vibration_px:g} px"
        shaken = moving(lit, scene.exposure.vibration_px)
        found.append(Source(name, "random", shaken, repeats * VIBRATION_REPEATS))
    if scene.moves:
        found.append(Source("motion", "steady", in_motion(base, scene, time_s)))
    return [*found, *_frame_errors(scene.exposure, time_s, (base, coarse, lit), rounding, repeats)]


def _frame_errors(
    exposure: Exposure,
    time_s: float,
    scenes: tuple[Scene, Scene, Scene],
    rounding: str,
    repeats: int,
) -> Iterator[Source]:
    """Yield the frame errors of an exposure, each alone.

    Scenes are the ideal one, that with the panel's `rounding` (a source), and the lit one.  What is
    random is of the scene's own light, as noise is; steady ones would hold its steady errors too.
    """
    base, coarse, lit = scenes
    planes, trigger, drift = exposure.bit_planes, exposure.trigger, exposure.drift
    if planes is not None:
        # As many as in the scene, whose exposure is not that of a bottomless detector.
        planes = replace(planes, period_s=None, periods=planes.lasting(time_s))
        name = "grey levels by bit planes"
        if planes.free_running:
            yield Source(name, "random", _exposed(lit, bit_planes=planes), repeats)
        else:
            yield Source(name, "steady", _exposed(coarse, bit_planes=planes), beyond=rounding)
    if trigger is not None:
        if trigger.rate > 0.0:
            by_chance = _exposed(lit, trigger=replace(trigger, lost=()))
            yield Source("lost triggers", "random", by_chance, repeats)
        if trigger.lost or trigger.rate == 0.0:
            name = "lost triggers" if trigger.rate == 0.0 else "lost triggers that are stated"
            stated = _exposed(base, trigger=replace(trigger, rate=0.0))
            yield Source(name, "steady", stated)
    if drift is not None:
        yield Source("brightness drift", "steady", _exposed(base, drift=drift))


def _exposed(base: Scene, **changes: Any) -> Scene:
    """Return an ideal scene with another exposure."""
    return replace(base, exposure=replace(base.exposure, **changes))


def measure_sources(
    sources: Sequence[Source],
    sets: Sequence[PatternSource | PatternSet],
    axes: tuple[Marginal, ...],
    *,
    seed: int,
    truth: GroundTruth | None = None,
    lights: Lights | None = None,
    on_progress: Progress | None = None,
) -> list[Comparison]:
    """Scan each source's scene repeatedly with pattern sets.

    Parameters
    ----------
    sources : sequence of Source
    sets : sequence of pattern sets
    axes : tuple of {"u", "v", "uv"}
        What they vary along.
    seed : int
    truth : GroundTruth, optional
        Of the pixels to compare; all of the first source's by default.
    lights : Lights, optional
        With light that is at hand.
    on_progress : callable, optional

    Returns
    -------
    list of Comparison
        One a source.
    """
    usual = lights or Lights(seed, kept=len(sources))
    others = Lights(seed + 1)
    if truth is None:
        truth = usual.truth(sources[0].scene)
    found = []
    for k, one in enumerate(sources):
        found.append(
            compare(
                one.scene,
                sets,
                repeats=max(2, one.repeats),
                seed=seed,
                transports=(others if one.other_samples else usual).traced(one.scene, axes),
                truth=truth,
                question=False,
            )
        )
        if on_progress:
            on_progress("budget", (k + 1) / len(sources))
    return found
