"""The calibration experiment (thesis 5.4, 8.3): a grid of dots on a stage, rendered.

At every position of the stage the target is captured (as a focus stack where the scene has
focus settings), its dots are detected in the lit frame, numbered, and re-mapped to the panel.
A position that shows no dots (blurred away, or out of view) is left out and counted: the others
have cost too much to lose.
World coordinates are those of the stage and of the certified grid, as in the laboratory; the
detections are scored besides against the exact projections of the true centres, which only a
simulation has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from slbench.calibration.models.points import CalibrationPoints, joined
from slbench.calibration.target.detect import detect_dots
from slbench.calibration.target.stage import Remapping, stage_view
from slbench.capture.stack import FocusStack, WeightSource
from slbench.core.errors import InputError
from slbench.core.random import Word, derived_seed, generator
from slbench.core.show.display import brief
from slbench.patterns import Flat
from slbench.rig import Pose
from slbench.scene.model import Scene
from slbench.simulate.floors import halves, more_samples
from slbench.simulate.stack import capture_stack, traced, with_lit_frame

Array = NDArray[np.float64]

#: Farthest from where it is that a dot may be seen.  Light, blur and noise move one by a third of
#: a pixel in the shipped experiment (results/calibration); a wrong number by a pitch, many pixels.
_FARTHEST_PX = 1.0
#: Stage positions of the thesis: heights through the volume, lateral shifts, mm.
Z_STEPS, Y_STEPS, Y_STEP_MM = 11, 6, 0.020


@dataclass(frozen=True, eq=False)
class Experiment:
    """What the experiment found.

    Parameters
    ----------
    points : CalibrationPoints
        n dots of all positions, with nominal world coordinates.
    position : (n,) int
        Stage position of each.
    positions_mm : (m, 3) float
        Nominal stage positions.
    detection_px : (n, 2) float
        Detected less projected true centres, px.
    sampling_px : float
        The Monte Carlo part of the distance between the two, RMS, px, at the height in the middle.
    """

    points: CalibrationPoints
    position: NDArray[np.intp]
    positions_mm: Array
    detection_px: Array
    sampling_px: float = float("nan")

    __repr__ = brief

    @property
    def without_dots(self) -> NDArray[np.intp]:
        """Return the stage positions that no point is from."""
        return np.setdiff1d(np.arange(len(self.positions_mm)), self.position)


def stage_positions(
    scene: Scene,
    z_steps: int = Z_STEPS,
    y_steps: int = Y_STEPS,
    y_step_mm: float = Y_STEP_MM,
) -> Array:
    """Return stage positions: all heights for each shift along y, as thesis 5.4.1.

    Parameters
    ----------
    scene : Scene
        Its volume's height is swept.
    z_steps, y_steps : int
    y_step_mm : float

    Returns
    -------
    (z_steps y_steps, 3) float
        mm, centred on the origin.
    """
    if z_steps < 2 or y_steps < 1:
        raise InputError("stage", "two heights and one shift at least", f"{z_steps}, {y_steps}")
    half = 0.5 * scene.rig.volume_mm[2]
    y, z = np.meshgrid(
        y_step_mm * (np.arange(y_steps) - 0.5 * (y_steps - 1)),
        np.linspace(-half, half, z_steps),
        indexing="ij",
    )
    return np.column_stack((np.zeros(y.size), y.ravel(), z.ravel()))


def run_experiment(
    scene: Scene,
    positions_mm: Array,
    *,
    stage_sigma_mm: float = 0.0,
    remapping: Remapping = "ring",
    weights: WeightSource = "lit",
    seed: int = 0,
    keep: Callable[[int, FocusStack], None] | None = None,
    on_progress: Callable[[str, float], None] | None = None,
) -> Experiment:
    """Capture, detect, number and re-map the dots of a grid at every stage position.

    Parameters
    ----------
    scene : Scene
        Its first object is a grid of dots (``calibration-grid`` or ``circle-grid``), level
        and unturned; its patterns code the axes that the models are to have.
    positions_mm : (m, 3) float
        Displacements of the stage from the object's position in the scene.
    stage_sigma_mm : float
        Standard deviation of the true position about the nominal one, each axis.
    remapping : {"ring", "bilinear"}
        As for :func:`~slbench.calibration.target.stage.stage_view`.
    weights : {"lit", "modulation"}
        Of the fusion, where the scene has focus settings.
    seed : int
    keep : callable, optional
        Called with the number of a position and what was captured there.
    on_progress : callable, optional

    Returns
    -------
    Experiment

    Raises
    ------
    InputError
        If the first object has no dots, no position shows any, nothing can be captured, or dots
        are seen more than a pixel from where they are.
    """
    grid = scene.objects[0]
    dots = grid.artefact.targets
    if dots is None or "dots" not in grid.artefact.parts:
        raise InputError(f"scene {scene.name}: objects[0]", "a grid of dots", grid.artefact.name)
    if not 0 <= stage_sigma_mm < np.inf:
        raise InputError("stage sigma", "zero or a positive length (mm)", stage_sigma_mm)
    camera = scene.rig.camera
    errors = generator(seed, Word.STAGE).normal(0.0, stage_sigma_mm or 0.0, positions_mm.shape)
    found: list[CalibrationPoints] = []
    detection = []
    problems, captured = [], False
    middle, sampling = int(np.argmin(np.abs(positions_mm[:, 2]))), float("nan")
    for k, (nominal, error) in enumerate(zip(positions_mm, errors, strict=True)):
        nominal_pose = Pose(grid.pose.rotation, grid.pose.position + nominal)
        moved = replace(grid, pose=Pose(grid.pose.rotation, nominal_pose.position + error))
        placed = replace(scene, objects=(moved, *scene.objects[1:]))
        own = derived_seed(seed, Word.POSITION, k)
        try:
            shots = _captured(placed, own)
            captured = True
            if keep is not None:
                keep(k, shots)
            fused = shots.fuse(weights)
            world = nominal_pose.to_world(dots)
            view = stage_view(
                fused.capture,
                dots,
                expected=camera.project(world),
                remapping=remapping,
                phase=fused.decode(),
            )
            if k == middle:
                sampling = _sampling_px(placed, own)
        except InputError as problem:
            where = f"stage position {k + 1}: {problem.where}"
            problems.append(InputError(where, problem.expected, problem.got))
            # A scene that cannot be captured at all fails at once, before others are rendered.
            if not captured:
                raise problems[0] from None
            continue
        finally:
            if on_progress:
                on_progress("positions", (k + 1) / len(positions_mm))
        true = camera.project(moved.pose.to_world(dots))
        seen, where = view.pixels[:, :2], f"scene {scene.name}: stage position {k + 1}"
        _check_detections(seen, view.numbers, true, where)
        found.append(view.points(world, k))
        detection.append(seen - true[view.numbers])
    if not sum(map(len, found)):
        nothing = InputError("stage positions", "dots that can be numbered and decoded", "none")
        raise problems[0] if problems else nothing
    points = joined(found)
    assert points.position is not None  # of every view
    return Experiment(points, points.position, positions_mm, np.concatenate(detection), sampling)


def _check_detections(centres: Array, which: NDArray[np.intp], true: Array, where: str) -> None:
    """Refuse dots that are not where they truly are: points with wrong numbers fit no model.

    Parameters
    ----------
    centres : (n, 2) float
        Detected, px.
    which : (n,) int
        Which of the grid's dots each is, -1 for none.
    true : (k, 2) float
        Where the camera truly sees the grid's dots, px.
    where : str
        For the message.
    """
    seen = which >= 0
    own = np.linalg.norm(centres[seen] - true[which[seen]], axis=1)
    off = np.where(np.isnan(own), np.inf, own)  # beyond the fold of the lens's distortion
    if np.all(off <= _FARTHEST_PX):
        return
    nearest, _ = KDTree(true[np.all(np.isfinite(true), axis=1)]).query(centres[seen])
    if np.any(nearest < off - _FARTHEST_PX):
        cause = "numbered wrongly: is the plate or the stage half a cell off?"
    else:
        cause = "blurred, or of too few samples a pixel?"
    wrong = f"{np.count_nonzero(off > _FARTHEST_PX)} of {len(off)} up to {off.max():.3g} px off"
    expected = f"dots seen within {_FARTHEST_PX:g} px of where they are"
    raise InputError(where, expected, f"{wrong} ({cause})")


def sampling_doubt(experiment: Experiment, samples: int) -> str | None:
    """Question a number of samples whose Monte Carlo error is seen in where dots are found."""
    errors = np.linalg.norm(experiment.detection_px, axis=1)
    whole, sampling = float(np.median(errors)), experiment.sampling_px
    more = more_samples(samples, whole, sampling)
    if more is None:
        return None
    return (
        f"sampling puts dots {sampling:.3f} px off, of {whole:.3f} px in the middle of all: {more} "
        f"samples a pixel instead of {samples} would change it (--spp, render.samples)"
    )


def _sampling_px(scene: Scene, seed: int) -> float:
    """Return by how much dots move where half of the samples show them, RMS, px.

    That is one draw of the Monte Carlo error of all samples, as of any transport's half.
    """
    lit = replace(scene, sequence=replace(scene.sequence, parts=(Flat(1.0),)))
    transports = traced(lit, seed=seed)
    half = halves(transports)
    if half is None:
        return float("nan")
    whole, other = (
        detect_dots(capture_stack(lit, shown, seed=seed, noise=False).fuse("lit").capture.frames[0])
        for shown in (transports, half)
    )
    distance, _ = KDTree(other.centres).query(whole.centres)
    same = distance < whole.radii
    return float(np.sqrt(np.mean(distance[same] ** 2))) if same.any() else float("nan")


def _captured(scene: Scene, seed: int) -> FocusStack:
    """Capture a scene with a lit frame, at all its focus settings."""
    return capture_stack(replace(scene, sequence=with_lit_frame(scene.sequence)), seed=seed)
