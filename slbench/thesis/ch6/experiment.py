"""Thesis chapter 6 in simulation: the optimal rig against a feasible one, and complex objects.

Three experiments of 6.2.3 and 6.2.4, all with the patterns of 6.2.2 (one and five fringes,
three shifts):

1. a plane through 6 mm of depth in steps of 0.1 mm, RMS depth error (fig. 12);
2. the step block of 1.0, 2.5 and 5.0 mm (table 6), placed anew for every repeat, as steady
   errors depend on where the block meets the grids of pixels;
3. brick, propeller and gear with the optimal rig (fig. 14).

The optimal rig is configuration 5 of table 4, the feasible one that of 6.2; lenses, detector and
exposure are the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.triangulation import triangulate
from slbench.core.random import generator, tagged_seed
from slbench.core.show.document import Cloud
from slbench.design.rig.hardware import load_hardware
from slbench.rig import Pose, Rig
from slbench.scene.file import load_scene
from slbench.scene.model import Scene
from slbench.score.points import point_errors, score
from slbench.simulate.repeats import plate_scene
from slbench.simulate.scan import scan
from slbench.simulate.stack import capture_stack, traced
from slbench.thesis import published as thesis
from slbench.thesis.ch6.findings import object_finding, plane_finding, steps_finding
from slbench.thesis.ch6.report import (
    block_picture,
    block_table,
    gap_table,
    objects_picture,
    objects_table,
    plane_picture,
    plane_table,
)
from slbench.thesis.ch6.results import ObjectScan, PlaneSweep, StepHeights
from slbench.thesis.outcome import Outcome

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Patterns of thesis 6.2.2.
PATTERNS = "1,5"
OBJECTS = ("ch6-brick", "ch6-propeller", "ch6-gear")
#: A block is put down to this, mm; grids of pixels repeat within it.
_PLACEMENT_MM = 0.5
#: Points of a cloud in the report.
_CLOUD_POINTS = 40_000
_PLANE, _STEPS = range(2)


@dataclass(frozen=True)
class _Size:
    """How much is computed."""

    divisor: int
    samples: int
    positions: int
    repeats: int


_FULL = _Size(1, 64, 61, 15)
_PREVIEW = _Size(4, 16, 7, 6)


def run_ch6(*, preview: bool, seed: int, on_progress: Progress | None = None) -> Outcome:
    """Run the experiments of thesis chapter 6.

    Parameters
    ----------
    preview : bool
        Few pixels, samples, positions and repeats.
    seed : int
    on_progress : callable, optional

    Returns
    -------
    Outcome
    """
    begin = time.perf_counter()
    size = _PREVIEW if preview else _FULL
    report = on_progress or (lambda stage, fraction: None)
    scene = _scene("step-block", size)
    rigs = (scene.rig, _feasible(size))
    sweep = plane_sweep(scene, rigs, size.positions, seed, report)
    steps = step_heights(scene, rigs, size.repeats, seed, report)
    block = object_scan(scene, seed)
    scans = []
    for k, name in enumerate(OBJECTS):
        report("objects", k / len(OBJECTS))
        scans.append(object_scan(_scene(name, size), seed))
    report("objects", 1.0)
    findings = (
        plane_finding(sweep, seed),
        steps_finding(steps, seed),
        *(object_finding(s) for s in scans),
    )
    tables = (
        plane_table(sweep, thesis.PLANE_MM),
        gap_table(sweep, thesis.PLANE_MM),
        block_table(steps, thesis.BLOCK_5_MM, thesis.BLOCK_5_MEASURED_MM),
        objects_table(scans),
    )
    pictures = {
        "fig12-plane": plane_picture(sweep, thesis.PLANE_MM),
        "fig13-step-block": block_picture(block),
        "fig14-objects": objects_picture(scans),
    }
    parameters = {
        "scenes": ["step-block", *OBJECTS],
        "feasible": thesis.FEASIBLE,
        "patterns": PATTERNS,
        "camera_px": [scene.rig.camera.width, scene.rig.camera.height],
        "samples": size.samples,
        "positions": size.positions,
        "repeats": size.repeats,
    }
    return Outcome(
        "ch6",
        "Chapter 6: the optimal rig against a feasible one",
        findings,
        tables,
        pictures,
        tuple(_cloud(s, seed) for s in (block, *scans)),
        parameters,
        seed,
        {"total": time.perf_counter() - begin},
        preview,
    )


def plane_sweep(
    scene: Scene, rigs: tuple[Rig, Rig], positions: int, seed: int, report: Progress
) -> PlaneSweep:
    """Measure a plane through 6 mm about the middle of the volume with either rig.

    Parameters
    ----------
    scene : Scene
        Its patterns, detector, light and first material.
    rigs : (Rig, Rig)
    positions : int
        61 are 0.1 mm apart.
    seed : int
        Every position has light and noise of its own.
    report : callable
    """
    from slbench.simulate.render.groundtruth import ground_truth

    heights = np.linspace(-3.0, 3.0, positions)
    result = np.empty((2, len(rigs), positions))
    noise_rad = np.empty((len(rigs), positions))
    finest = max(scene.sequence.fringe_counts("u"))
    for i, rig in enumerate(rigs):
        for k, height in enumerate(heights):
            plate = plate_scene(replace(scene, rig=rig), float(height))
            own = tagged_seed(seed, _PLANE, i, k)
            transports, truth = traced(plate, seed=own), ground_truth(plate.objects, rig)
            smooth = truth.smooth()
            for j, noise in enumerate((True, False)):
                stack = capture_stack(plate, transports, seed=own, noise=noise)
                cloud = triangulate(rig, stack.fuse().decode())
                on = smooth[cloud.pixels[:, 1], cloud.pixels[:, 0]]
                result[j, i, k] = np.sqrt(np.mean(point_errors(cloud, truth)[on, 2] ** 2))
                if noise:
                    turns = np.median(cloud.sigma_px[on, 0]) / rig.projector.width
                    noise_rad[i, k] = 2.0 * np.pi * finest * turns
            report("plane", (i + (k + 1) / positions) / len(rigs))
    return PlaneSweep(heights, result[0], result[1], noise_rad.mean(axis=1))


def step_heights(
    scene: Scene, rigs: tuple[Rig, Rig], repeats: int, seed: int, report: Progress
) -> StepHeights:
    """Measure the step block, placed anew each time, with either rig.

    Parameters
    ----------
    scene : Scene
        Of the block.
    rigs : (Rig, Rig)
    repeats, seed : int
        Both rigs meet the block at the same places.
    report : callable
    """
    heights = np.empty((len(rigs), repeats, len(thesis.BLOCK_5_MM)))
    for k in range(repeats):
        own = tagged_seed(seed, _STEPS, k)
        shift = generator(own).uniform(-_PLACEMENT_MM, _PLACEMENT_MM, 3)
        moved = tuple(
            replace(o, pose=Pose(o.pose.rotation, o.pose.position + shift)) for o in scene.objects
        )
        for i, rig in enumerate(rigs):
            placed = replace(scene, rig=rig, objects=moved)
            one = scan(placed, seed=own, score=False)
            found = score(one.cloud, one.truth, one.phase, placed.objects, rig)
            measured = {s.nominal_mm: s.measured_mm for s in found.steps}
            heights[i, k] = [measured[nominal] for nominal in thesis.BLOCK_5_MM]
            report("steps", (k + (i + 1) / len(rigs)) / repeats)
    return StepHeights(heights)


def _scene(name: str, size: _Size) -> Scene:
    scene = load_scene(name).with_patterns(PATTERNS)
    return scene.coarser(size.divisor, size.samples)


def _feasible(size: _Size) -> Rig:
    """Return the feasible rig, focused on the origin as the optimal one is."""
    values = np.array(thesis.FEASIBLE)
    values[4:] = np.deg2rad(values[4:])
    rig = load_hardware("hardware/macro-ch6").rig(values)
    return replace(load_scene("step-block"), rig=rig).coarser(size.divisor, 1).rig


def object_scan(scene: Scene, seed: int) -> ObjectScan:
    """Scan a scene and keep what lies on its first object."""
    result = scan(scene, seed=seed, score=False)
    cloud, truth = result.cloud, result.truth
    rows, columns = cloud.pixels[:, 1], cloud.pixels[:, 0]
    wanted = truth.lit & (truth.object_id == 0)
    on = wanted[rows, columns]
    error = point_errors(cloud, truth)[on]
    distance = np.linalg.norm(error, axis=1)
    smooth = truth.smooth()[rows, columns][on]
    return ObjectScan(
        scene.name,
        float(on.sum() / wanted.sum()),
        float(np.sqrt(np.mean(distance[smooth] ** 2))),
        float(np.percentile(distance, 95.0)),
        cloud.points[on],
        error[:, 2],
        truth.normal[rows, columns][on],
    )


def _cloud(result: ObjectScan, seed: int) -> Cloud:
    count = len(result.points)
    chosen = generator(seed).permutation(count)[:_CLOUD_POINTS]
    return Cloud(
        result.name,
        result.points[chosen],
        {"height error / µm": 1e3 * result.error_z_mm[chosen]},
        caption=f"{len(chosen)} of {count} points, optimal rig, patterns {{{PATTERNS}}}.",
    )
