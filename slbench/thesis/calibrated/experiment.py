"""Step blocks of chapters 6 and 7, measured with rigs that rendered boards calibrated.

A chequerboard is rendered in twelve free poses before the chapter's rig and captured anew, with
noise of its own, for every calibration (``slbench calibrate board``).  The same scans of the step
block are then triangulated with each calibrated rig, whose world is joined to the scene's over the
whole volume, as a calibration's world is where its boards lay, and scored.  What repeats do not
average out is steady.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slbench.calibration.bundle.calibrate import calibrate_boards
from slbench.calibration.bundle.result import BoardCalibration
from slbench.calibration.bundle.views import view_board
from slbench.calibration.target.free import FreeBoard
from slbench.core.random import generator, tagged_seed
from slbench.core.show.document import Picture, Table
from slbench.patterns import PatternSequence
from slbench.rig import Pose, Rig
from slbench.scene.calibration import Calibration
from slbench.scene.file import load_scene
from slbench.scene.model import Scene
from slbench.score.points import score
from slbench.simulate.expose import capture
from slbench.simulate.reconstruct import reconstruct
from slbench.simulate.stack import capture_stack, traced
from slbench.simulate.transport import LightTransport
from slbench.thesis import published as thesis
from slbench.thesis.calibrated.findings import steady_finding
from slbench.thesis.calibrated.results import SteadyErrors
from slbench.thesis.outcome import Outcome
from slbench.thesis.pictures import new_figure, picture

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: The scene of each chapter's step block, its patterns, certified and measured heights, mm.
BLOCKS = {
    "ch6": ("step-block", "1,5", thesis.BLOCK_5_MM, thesis.BLOCK_5_MEASURED_MM["optimal"]),
    "ch7": (
        thesis.STEP_BLOCK,
        thesis.OURS,
        thesis.BLOCK_20_MM,
        thesis.BLOCK_20_MEASURED_MM[thesis.OURS],
    ),
}
#: Scene of the board, its patterns and the board as a calibration is told.
_BOARD_SCENE, _BOARD_PATTERNS = "chequerboard", "1,8,40@4"
BOARD = FreeBoard(kind="chequerboard", columns=9, rows=7, pitch_mm=8.0)
#: Free poses: tilt, degrees, and shift about the middle of the volume, mm.
_TILT_DEG, _SHIFT_MM = 28.0, (14.0, 10.0, 25.0)
_POSES, _TRACES, _BOARDS, _SCANS, _DRAWS = range(5)


@dataclass(frozen=True)
class _Size:
    """How much is computed."""

    divisor: int
    samples: int
    poses: int
    calibrations: int
    repeats: int
    chapters: tuple[str, ...]


_FULL = _Size(1, 64, 12, 8, 5, tuple(BLOCKS))
_PREVIEW = _Size(2, 64, 5, 2, 2, ("ch7",))


def run_calibrated(*, preview: bool, seed: int, on_progress: Progress | None = None) -> Outcome:
    """Measure the step blocks of chapters 6 and 7 with rigs that boards calibrated.

    Parameters
    ----------
    preview : bool
        Chapter 7 alone, of few pixels, poses and calibrations.
    seed : int
    on_progress : callable, optional

    Returns
    -------
    Outcome
    """
    begin = time.perf_counter()
    size = _PREVIEW if preview else _FULL
    report = on_progress or (lambda stage, fraction: None)
    found = [steady_errors(name, size, seed, report) for name in size.chapters]
    findings = tuple(steady_finding(one, tagged_seed(seed, _DRAWS)) for one in found)
    return Outcome(
        "calibrated",
        "Chapters 6 and 7 with calibrated rigs",
        findings,
        tuple(_table(one) for one in found),
        {f"{one.chapter}-steps": _picture(one) for one in found},
        (),
        {
            "scenes": [BLOCKS[name][0] for name in size.chapters],
            "board": BOARD.name,
            "board patterns": _BOARD_PATTERNS,
            "poses": size.poses,
            "calibrations": size.calibrations,
            "repeats": size.repeats,
            "samples": size.samples,
            "divisor": size.divisor,
        },
        seed,
        {"total": time.perf_counter() - begin},
        preview,
    )


def steady_errors(chapter: str, size: _Size, seed: int, report: Progress) -> SteadyErrors:
    """Measure a chapter's block with each of several calibrations of its rig."""
    name, patterns, nominal, measured = BLOCKS[chapter]
    scene = load_scene(name).with_patterns(patterns).coarser(size.divisor, 16)
    report(f"{chapter} boards", 0.0)
    boards = board_scenes(scene.rig, size, seed)
    lights = []
    for k, board in enumerate(boards):
        lights.append(traced(board, seed=tagged_seed(seed, _TRACES, k))[0])
        report(f"{chapter} boards", (k + 1) / len(boards))
    calibrations = []
    for k in range(size.calibrations):
        calibrations.append(calibrated(boards, lights, tagged_seed(seed, _BOARDS, k)))
        report(f"{chapter} calibrations", (k + 1) / size.calibrations)
    rigs = [None, *(one.rig for one in calibrations)]
    heights = step_heights(scene, rigs, len(nominal), size.repeats, seed)
    report(f"{chapter} scans", 1.0)
    return SteadyErrors(
        chapter=chapter,
        nominal_mm=np.array(nominal),
        thesis_mm=np.array(measured),
        calibrated_mm=heights[1:],
        exact_mm=heights[0],
        points_um=np.array([_shape_um(one) for one in calibrations]),
    )


def board_scenes(rig: Rig, size: _Size, seed: int) -> list[Scene]:
    """Return scenes of the board in free poses before a rig."""
    base = load_scene(_BOARD_SCENE).coarser(size.divisor, size.samples)
    panel = replace(base, rig=rig, sequence=_coded(rig))
    rng = generator(tagged_seed(seed, _POSES))
    found = []
    for k in range(size.poses):
        around = 2.0 * np.pi * k / size.poses
        tilt = np.radians(_TILT_DEG) * np.array([np.cos(around), np.sin(around), 0.0])
        turn = Rotation.from_euler("z", rng.uniform(-30.0, 30.0), degrees=True)
        rotation = (Rotation.from_rotvec(tilt) * turn).as_matrix()
        pose = Pose(rotation, rng.uniform(-1.0, 1.0, 3) * _SHIFT_MM)
        found.append(replace(panel, objects=(replace(base.objects[0], pose=pose),)))
    return found


def _coded(rig: Rig) -> PatternSequence:
    panel = (rig.projector.width, rig.projector.height)
    return PatternSequence.parse(_BOARD_PATTERNS, panel, axes="uv")


def calibrated(
    boards: Sequence[Scene], lights: Sequence[LightTransport], seed: int
) -> BoardCalibration:
    """Capture boards with noise of a seed, and calibrate."""
    views = []
    for k, (scene, light) in enumerate(zip(boards, lights, strict=True)):
        shots = capture(
            *(light, scene.sequence, scene.rig, scene.detector, scene.exposure),
            seed=tagged_seed(seed, k),
        )
        views.append(view_board(shots, BOARD, f"pose {k + 1}"))
    return calibrate_boards(views)


def step_heights(
    scene: Scene, rigs: Sequence[Rig | None], steps: int, repeats: int, seed: int
) -> Array:
    """Measure steps with each of several rigs in the same scans, (rigs, repeats, steps) mm.

    Parameters
    ----------
    scene : Scene
    rigs : sequence of Rig or None
        None for the scene's own.
    steps, repeats, seed : int
    """
    from slbench.simulate.render.groundtruth import ground_truth

    transports, truth = traced(scene, seed=seed), ground_truth(scene.objects, scene.rig)
    heights = np.full((len(rigs), repeats, steps), np.nan)
    for r in range(repeats):
        stack = capture_stack(scene, transports, seed=tagged_seed(seed, _SCANS, r))
        phase = stack.fuse().decode()
        for k, rig in enumerate(rigs):
            made = replace(scene, calibration=Calibration(rig=rig, align=True))
            cloud = reconstruct(made, phase).cloud
            scored = score(cloud, truth, phase, scene.objects, scene.rig)
            heights[k, r] = [step.measured_mm for step in scored.steps]
    return heights


def _shape_um(found: BoardCalibration) -> float:
    """Return the RMS deviation of points that a calibration predicts, of shape alone, µm."""
    _, _, shape = found.predicted
    return 1e3 * float(np.sqrt(np.nanmean(np.sum(shape**2, axis=-1))))


def _table(found: SteadyErrors) -> Table:
    steady = found.steady_um
    rows = tuple(
        (
            float(nominal),
            float(found.thesis_um[k]),
            float(found.exact_um[k]),
            float(steady[:, k].mean()),
            float(steady[:, k].std(ddof=1)),
            float(np.sqrt(np.mean(steady[:, k] ** 2))),
        )
        for k, nominal in enumerate(found.nominal_mm)
    )
    columns = (
        "height / mm",
        "thesis's error / µm",
        "exact rig / µm",
        "calibrated, mean / µm",
        "deviation over calibrations / µm",
        "RMS / µm",
    )
    title = {"ch6": "Table 6, optimal rig", "ch7": "Table 7, {1,10,50}"}[found.chapter]
    note = (
        f"Mean errors of {found.calibrated_mm.shape[1]} scans. The calibrations predict a "
        f"deviation of a point, of shape, of {found.points_um.mean():.3g} µm."
    )
    return Table(f"{title}: steady errors of step heights", columns, rows, note)


def _picture(found: SteadyErrors) -> Picture:
    figure = new_figure(6.0, 4.0)
    axes = figure.subplots()
    axes.plot(found.nominal_mm, found.steady_um.T, "-", color="C0", linewidth=0.8)
    axes.plot([], [], "-", color="C0", label="calibrated by boards")
    axes.plot(found.nominal_mm, found.exact_um, "k.-", label="rig that is rendered")
    axes.plot(found.nominal_mm, found.thesis_um, "C3o", label="thesis")
    axes.set_xlabel("height of the step / mm")
    axes.set_ylabel("steady error / µm")
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
    return picture("Steady errors of step heights", figure, "A line a calibration.")
