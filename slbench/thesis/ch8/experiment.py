"""Chapter 8 of the thesis re-run: the microscope's noise, patterns, calibration, measurements.

0. the rig that the hardware leads to (8.1.2);
1. phase noise through the volume (fig. 25) and the sequence it leads to (8.2);
2. the calibration at 66 positions of the stage (8.3), for stages that are exact and off;
3. a plane at 44 positions (8.4.1, fig. 33);
4. coin "3", coin "N" and watch gear from 5, 12 and 7 registered views (8.4.2, figs. 35, 37).

The camera's pixels are put together (*binned*), by different factors for each part: models fitted
on coarse pixels serve finer ones by the affine map between their centres.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.model import CalibrationModel
from slbench.capture.focus import Focus
from slbench.cloud.registration import STAGE_SIGMA_MM
from slbench.core.random import tagged_seed
from slbench.core.show.document import Cloud, Picture, Table
from slbench.design.fringes.noise import PhaseNoise
from slbench.design.fringes.trial import noise_of_scene
from slbench.scene.file import load_scene
from slbench.scene.model import Scene
from slbench.thesis.ch8 import findings as judge
from slbench.thesis.ch8 import plane
from slbench.thesis.ch8 import report as pages
from slbench.thesis.ch8.models import STAGES, calibrations
from slbench.thesis.ch8.noise import THESIS_SEQUENCE
from slbench.thesis.ch8.results import Calibrations, Merged, Stage
from slbench.thesis.ch8.rig import HARDWARE, micro_rigs
from slbench.thesis.ch8.views import measure_object
from slbench.thesis.outcome import Finding, Outcome
from slbench.twin.experiment import Y_STEP_MM, run_experiment, stage_positions

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Tags of the random streams.
_NOISE, _CALIBRATION, _DRAWS, _PLANES, _ERRORS, _OBJECTS, _RIG = range(7)
#: Nominal stage positions of the objects' views, mm (x, y): along x, a grid, a ring.
_STEP = 0.15
VIEWS: dict[str, tuple[tuple[float, float], ...]] = {
    "coin-3": tuple((_STEP * k, 0.0) for k in (-2, -1, 0, 1, 2)),
    "coin-n": tuple((_STEP * (k - 1.5), 0.2 * j) for j in (-1, 0, 1) for k in range(4)),
    "watch-gear": (
        (0.0, 0.0),
        *((0.2 * np.cos(a), 0.2 * np.sin(a)) for a in np.deg2rad(60.0 * np.arange(6))),
    ),
}


@dataclass(frozen=True)
class Size:
    """How large the experiments are; divisors are of the camera's 2048 x 2048 pixels.

    Parameters
    ----------
    settings : int
        Focus settings of a stack.
    noise_divisor, noise_samples, noise_heights, noise_repeats, noise_fringes : int
        Noise of one picture; the last is the largest count.  Of samples, washed-out fringes need
        many.
    fused_heights, fused_repeats : int
        Noise of fused stacks, at twice the divisor.
    calibration_divisor, z_steps, y_steps, draws : int
        Stage positions; draws of the stage's errors.
    plane_divisor, plane_z, plane_y : int
    view_divisors : dict of str to int
        By object.
    samples, view_samples : int
        Monte Carlo samples a pixel.
    objects_stage : {"exact", "all axes", "moved axes"}
        Whose first calibration the objects are measured with.  A preview's few positions do
        not average the errors of a stage that is off: the views' frames would be bent by more
        than registration is to mend.
    """

    settings: int
    noise_divisor: int
    noise_samples: int
    noise_heights: int
    noise_repeats: int
    noise_fringes: int
    fused_heights: int
    fused_repeats: int
    calibration_divisor: int
    z_steps: int
    y_steps: int
    draws: int
    plane_divisor: int
    plane_z: int
    plane_y: int
    view_divisors: dict[str, int]
    samples: int
    view_samples: int
    objects_stage: Stage


FULL = Size(
    settings=7,
    noise_divisor=8,
    noise_samples=256,
    noise_heights=11,
    noise_repeats=8,
    noise_fringes=128,
    fused_heights=11,
    fused_repeats=4,
    calibration_divisor=4,
    z_steps=11,
    y_steps=6,
    draws=40,
    plane_divisor=16,
    plane_z=11,
    plane_y=4,
    view_divisors={"coin-3": 2, "coin-n": 3, "watch-gear": 2},
    samples=16,
    view_samples=9,
    objects_stage="all axes",
)
PREVIEW = Size(
    settings=2,
    noise_divisor=16,
    noise_samples=9,
    noise_heights=5,
    noise_repeats=4,
    noise_fringes=32,
    fused_heights=3,
    fused_repeats=2,
    calibration_divisor=8,
    z_steps=5,
    y_steps=3,
    draws=8,
    plane_divisor=16,
    plane_z=5,
    plane_y=2,
    view_divisors={"coin-3": 8, "coin-n": 8, "watch-gear": 8},
    samples=9,
    view_samples=4,
    objects_stage="exact",
)


def run_ch8(*, preview: bool, seed: int, on_progress: Progress | None = None) -> Outcome:
    """Run the experiments of chapter 8.

    Parameters
    ----------
    preview : bool
        Few pixels, positions and repeats: less than a minute on two idle cores; the full run
        takes some 20 minutes and 1.4 GiB.
    seed : int
    on_progress : callable, optional

    Returns
    -------
    Outcome
    """
    size = PREVIEW if preview else FULL
    report = on_progress or (lambda stage, fraction: None)
    seconds: dict[str, float] = {}
    findings: list[Finding] = []
    tables: list[Table] = []
    pictures: dict[str, Picture] = {}
    clouds: list[Cloud] = []

    start = time.perf_counter()
    report("rig", 0.0)
    rigs = micro_rigs(tagged_seed(seed, _RIG))
    findings.append(judge.rig_finding(*rigs))
    tables.append(pages.rig_table(*rigs))
    seconds["rig"] = time.perf_counter() - start

    start = time.perf_counter()
    found = measure_noise(size, tagged_seed(seed, _NOISE), report)
    width = load_scene("ch8-stack").rig.projector.width
    findings += judge.noise_findings(found)
    findings.append(judge.sequence_finding(found["single"], width))
    tables.append(pages.noise_table(found))
    pictures["noise"] = pages.noise_picture(found)
    seconds["noise"] = time.perf_counter() - start

    start = time.perf_counter()
    calibrated = calibrate(size, seed, report)
    findings += judge.model_findings(calibrated)
    tables.append(pages.model_table(calibrated))
    pictures["models"] = pages.model_picture(calibrated)
    seconds["calibration"] = time.perf_counter() - start

    start = time.perf_counter()
    parts = planes(size, calibrated, seed, report)
    findings += parts[0]
    tables.append(parts[1])
    pictures["plane"] = parts[2]
    seconds["plane"] = time.perf_counter() - start

    start = time.perf_counter()
    model = calibrated[size.objects_stage].models[0]
    shares = []
    results = []
    for name in VIEWS:
        results.append(measured_object(name, size, model, seed, report))
        pictures[name] = pages.object_picture(results[-1])
        clouds.append(pages.object_cloud(results[-1], seed))
        shares.append((FULL.view_divisors[name] / size.view_divisors[name]) ** 2)
    for pair in zip(results, shares, strict=True):
        findings += judge.object_findings(*pair)
    findings.append(judge.registration_finding(results))
    tables.append(pages.objects_table(results))
    seconds["objects"] = time.perf_counter() - start
    return Outcome(
        "ch8",
        "Chapter 8: measurements at the micro-scale",
        tuple(findings),
        tuple(tables),
        pictures,
        tuple(clouds),
        _parameters(size),
        seed,
        seconds,
        preview,
    )


#: Squares of the texture that fusion may go by, mm: four camera pixels of the coarser camera.
_TEXTURE_MM = 0.02


def measure_noise(size: Size, seed: int, report: Progress) -> dict[str, PhaseNoise]:
    """Measure sigma(n, z) of one picture, of stacks fused in two ways, and of their controls.

    A control has as many pictures, and so as much light, all at the middle's focus.
    """
    stack = load_scene("ch8-stack")
    half = 0.5 * stack.rig.volume_mm[2]
    counts = [2**k for k in range(size.noise_fringes.bit_length())]
    few = [n for n in counts if n in (1, 4, 16, 32)]
    single = replace(stack.coarser(size.noise_divisor, size.noise_samples), focus=None)
    coarse = stacked(stack, size.settings).coarser(2 * size.noise_divisor, size.noise_samples)
    still = replace(coarse, focus=Focus.sweep(coarse.rig, [0.0] * size.settings))
    fused = (few, size.fused_heights, size.fused_repeats)
    ways: dict[str, tuple[Scene, Any, float | None, list[int], int, int]] = {
        "single": (single, "lit", None, counts, size.noise_heights, size.noise_repeats),
        "fused-lit": (coarse, "lit", None, *fused),
        "fused-modulation": (coarse, "modulation", None, *fused),
        "averaged": (still, "lit", None, *fused),
        "textured-fused-lit": (coarse, "lit", _TEXTURE_MM, *fused),
        "textured-averaged": (still, "lit", _TEXTURE_MM, *fused),
    }
    found = {}
    for k, (name, (scene, weights, texture, fringes, heights, repeats)) in enumerate(ways.items()):

        def progress(stage: str, done: float, k: int = k) -> None:
            report("noise", (k + done) / len(ways))

        found[name] = noise_of_scene(
            scene,
            fringes,
            z_mm=np.linspace(-half, half, heights).tolist(),
            repeats=repeats,
            seed=seed,
            weights=weights,
            texture_mm=texture,
            on_progress=progress,
        )
    return found


def calibrate(size: Size, seed: int, report: Progress) -> dict[Stage, Calibrations]:
    """Run the calibration experiment once, and calibrate with all stages."""
    grid = stacked(load_scene("ch8-grid-stack"), size.settings)
    grid = grid.coarser(size.calibration_divisor, size.samples).with_patterns(
        ",".join(map(str, THESIS_SEQUENCE))
    )
    experiment = run_experiment(
        grid,
        stage_positions(grid, size.z_steps, size.y_steps),
        seed=tagged_seed(seed, _CALIBRATION),
        on_progress=lambda stage, done: report("calibration", done),
    )
    own = tagged_seed(seed, _DRAWS)
    return {stage: calibrations(experiment, stage, size.draws, own) for stage in STAGES}


def planes(
    size: Size,
    calibrated: dict[Stage, Calibrations],
    seed: int,
    report: Progress,
) -> tuple[tuple[Finding, Finding], Table, Picture]:
    """Measure the plate at all positions and judge fig. 33."""
    plate = stacked(load_scene("ch8-stack"), size.settings)
    plate = plate.coarser(size.plane_divisor, size.samples)
    scanned = plane.scan_planes(
        plate,
        stage_positions(plate, size.plane_z, size.plane_y, Y_STEP_MM),
        seed=tagged_seed(seed, _PLANES),
        on_progress=lambda done: report("plane", done),
    )
    to_model = rebinned(size.plane_divisor, size.calibration_divisor)
    own = tagged_seed(seed, _ERRORS)
    errors = {}
    for way in plane.WAYS:
        for stage, sigma in (("exact", 0.0), ("all axes", STAGE_SIGMA_MM)):
            models = calibrated[stage].models  # type: ignore[index]
            errors[f"{way}, stage {'off' if sigma else 'exact'}"] = plane.position_errors(
                scanned, models, way, to_model, sigma_mm=sigma, seed=own
            )
    z = np.array([position.stage_mm[2] for position in scanned])
    # The thesis fuses by the lit frames.
    off, exact = errors["lit, stage off"], errors["lit, stage exact"]
    return (
        judge.plane_findings(z, off, exact),
        pages.plane_table(z, errors),
        pages.plane_picture(z, off, exact),
    )


def measured_object(
    name: str, size: Size, model: CalibrationModel, seed: int, report: Progress
) -> Merged:
    """Measure, register and score one object."""
    divisor = size.view_divisors[name]
    scene = stacked(load_scene(f"ch8-{name}"), size.settings).coarser(divisor, size.view_samples)
    positions = np.column_stack((np.array(VIEWS[name]), np.zeros(len(VIEWS[name]))))
    return measure_object(
        name,
        scene,
        positions,
        model,
        rebinned(divisor, size.calibration_divisor),
        stage_sigma_mm=STAGE_SIGMA_MM,
        seed=tagged_seed(seed, _OBJECTS, list(VIEWS).index(name)),
        on_progress=lambda done: report(name, done),
    )


def stacked(scene: Scene, settings: int) -> Scene:
    """Return the scene with focus settings in the middles of slices of its volume."""
    slices = (np.arange(settings) + 0.5) / settings - 0.5
    heights = (scene.rig.volume_mm[2] * slices).tolist()
    return replace(scene, focus=Focus.sweep(scene.rig, heights))


def rebinned(divisor: int, other: int) -> Callable[[Array], Array]:
    """Return the map of pixel centres from a camera binned by `divisor` to one by `other`.

    The panel's corner, half a pixel from the first centre, is common to both.
    """

    def to_other(pixels: Array) -> Array:
        return (pixels + 0.5) * (divisor / other) - 0.5

    return to_other


def _parameters(size: Size) -> dict[str, Any]:
    return asdict(size) | {
        "scenes": ["ch8-stack", "ch8-grid-stack", *(f"ch8-{name}" for name in VIEWS)],
        "camera_px": {name: 2048 // divisor for name, divisor in size.view_divisors.items()},
        "views_mm": {name: np.array(places).tolist() for name, places in VIEWS.items()},
        "stage_sigma_mm": STAGE_SIGMA_MM,
        "fusion_of_objects": "modulation",
        "hardware": HARDWARE,
    }
