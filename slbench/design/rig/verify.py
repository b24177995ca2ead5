"""Is the evaluator's model right?  Plane scans of the same rigs through the whole pipeline.

The evaluator (thesis 3.1) knows geometry and the grids of pixels.  A rendered scan adds what
it leaves out: fringes that interpolate between panel pixels, the detector's noise and rounding,
defocus, light that falls off.  :func:`rendered_errors` measures a plate in each configuration;
:func:`verify` ranks configurations by prediction and by measurement.

The patterns code exactly the axes that the prediction is for.  With both, points are those nearest
to both rays (``triangulate(..., meeting="nearest")``), which is what the evaluator predicts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy.stats import spearmanr

from slbench import objects
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError, warn_user
from slbench.core.io import atomic_path
from slbench.core.show.display import brief
from slbench.design.rig.evaluate import Evaluation, evaluate
from slbench.design.rig.hardware import Hardware, as_configurations
from slbench.patterns import PatternSource, read_patterns
from slbench.patterns.sequence import PatternSequence
from slbench.rig import Pose, Rig
from slbench.scene.model import Scene, SceneObject
from slbench.score.points import point_errors
from slbench.simulate.scan import scan

Array = NDArray[np.float64]

#: Heights of the plate as shares of the volume's half depth.
_HEIGHTS = (-0.8, 0.0, 0.8)


@dataclass(frozen=True, eq=False)
class Verification:
    """Predicted and rendered errors of n configurations.

    Parameters
    ----------
    predicted : Evaluation
        Its ``axes`` are those that were rendered.
    rendered_mm : (n,) float
        RMS distance of measured from true points on smooth surface, mm.
    rendered_z_mm : (n,) float
        The same along the world's z axis.
    rank_correlation : float
        Spearman's, of predicted mean error and ``rendered_mm``.
    """

    predicted: Evaluation
    rendered_mm: Array
    rendered_z_mm: Array
    rank_correlation: float

    __repr__ = brief


def rendered_errors(
    hardware: Hardware,
    configuration: ArrayLike,
    *,
    patterns: PatternSource = "1,5",
    samples: int = 16,
    seed: int = 0,
    noise: bool = True,
    heights_mm: Sequence[float] | None = None,
    allow_modules: bool = False,
) -> tuple[float, float]:
    """Scan a plate of the volume's size and return the RMS errors over its heights, mm.

    Parameters
    ----------
    hardware : Hardware
    configuration : (6,) float
        Design variables, mm and rad.
    patterns : str and whatever else is a pattern set
        Of three shifts (:func:`slbench.patterns.read_patterns`); thesis 6.2.2 projects one fringe
        and five.  Along the axes that the hardware codes (of 1, the better one), unless the set
        states its own.
    samples : int
        Monte Carlo samples a pixel.
    seed : int
    noise : bool
    heights_mm : sequence of float, optional
        Heights of the plate; three through the volume by default.
    allow_modules : bool
        Run the Python modules that the patterns name: code of their authors.

    Returns
    -------
    distance, height : float
        RMS of the distance from the true point and of its z component, over smooth lit
        surface of all heights; NaN where nothing was measured.
    """
    hardware = _coding(hardware, patterns, allow_modules)
    axes = str(evaluate(hardware, configuration).axes[0])
    sequence = _sequence(hardware, patterns, axes, allow_modules)
    options = (samples, seed, noise, heights_mm)
    return plate_errors(hardware, hardware.rig(configuration), sequence, *options)


def plate_errors(
    hardware: Hardware,
    rig: Rig,
    sequence: PatternSequence,
    samples: int = 16,
    seed: int = 0,
    noise: bool = True,
    heights_mm: Sequence[float] | None = None,
) -> tuple[float, float]:
    """As :func:`rendered_errors`, of a rig in any pose and a pattern sequence.

    Parameters
    ----------
    hardware : Hardware
        Its volume and detector count.
    rig : Rig
    sequence : PatternSequence
    samples, seed, noise, heights_mm
        As for :func:`rendered_errors`.

    Returns
    -------
    distance, height : float
        mm.
    """
    size = hardware.volume_mm
    plate = objects.build_artefact(
        "plane", {"size_mm": [size[0], size[1]], "thickness_mm": 0.1 * min(size[:2])}
    )
    squares: list[Array] = []
    heights = [h * size[2] / 2 for h in _HEIGHTS] if heights_mm is None else heights_mm
    for k, height in enumerate(heights):
        scene = Scene(
            "plate",
            rig,
            (SceneObject(plate, Pose(np.eye(3), np.array([0.0, 0.0, height]))),),
            sequence,
            hardware.detector,
            samples=samples,
        )
        result = scan(scene, seed=seed + k, noise=noise, score=False)
        cloud, truth = result.cloud, result.truth
        if len(sequence.axes) == 2:
            cloud = triangulate(rig, result.phase, "nearest")
        error = point_errors(cloud, truth)[truth.smooth()[cloud.pixels[:, 1], cloud.pixels[:, 0]]]
        squares.append(error**2)
    everything = np.concatenate(squares)
    if not len(everything):
        return float("nan"), float("nan")
    mean = everything.mean(axis=0)
    return float(np.sqrt(mean.sum())), float(np.sqrt(mean[2]))


def verify(
    hardware: Hardware,
    configurations: ArrayLike,
    *,
    patterns: PatternSource = "1,5",
    samples: int = 16,
    seed: int = 0,
    allow_modules: bool = False,
    on_progress: Callable[[str, float], None] | None = None,
) -> Verification:
    """Predict and render many configurations and compare their ranks.

    Parameters
    ----------
    hardware : Hardware
    configurations : (n, 6) float
        At least three, mm and rad.
    patterns, samples, seed, allow_modules
        As for :func:`rendered_errors`.
    on_progress : callable, optional

    Raises
    ------
    InputError
        For fewer than three configurations.

    Warns
    -----
    InputWarning
        If the coded axis runs along the epipolar lines of a configuration, or the patterns state
        other axes than the hardware: theirs are predicted and rendered.
    """
    rows = as_configurations(configurations, len(hardware.variables))
    if len(rows) < 3:
        raise InputError("configurations", "at least 3, to compare ranks", len(rows))
    errors = np.empty((len(rows), 2))
    hardware = _coding(hardware, patterns, allow_modules)
    predicted = evaluate(hardware, rows)
    sequences = {
        axes: _sequence(hardware, patterns, axes, allow_modules)
        for axes in np.unique(predicted.axes).tolist()
    }
    for i, row in enumerate(rows):
        rig, sequence = hardware.rig(row), sequences[str(predicted.axes[i])]
        errors[i] = plate_errors(hardware, rig, sequence, samples, seed + 100 * i)
        if on_progress:
            on_progress("render", (i + 1) / len(rows))
    both = np.isfinite(errors[:, 0]) & np.isfinite(predicted.mu_mm)
    rank = float(spearmanr(predicted.mu_mm[both], errors[both, 0]).statistic)
    return Verification(predicted, errors[:, 0], errors[:, 1], rank)


def _sequence(
    hardware: Hardware, patterns: PatternSource, axes: str, allow_modules: bool
) -> PatternSequence:
    panel = hardware.projector.width, hardware.projector.height
    return read_patterns(patterns, panel, axes=axes, allow_modules=allow_modules).sequence


def _coding(hardware: Hardware, patterns: PatternSource, allow_modules: bool) -> Hardware:
    """Return the hardware, coding the axes of a pattern set that states its own."""
    told = [_sequence(hardware, patterns, axes, allow_modules).axes for axes in ("u", "v")]
    if told[0] != told[1]:
        return hardware
    own: Any = "".join(sorted(told[0]))
    stated = "uv" if hardware.coded_axes == 2 else hardware.coded_axes
    if stated not in (1, own):
        doubt = f"the patterns code {own}, coded_axes of the hardware is {stated}"
        warn_user("patterns", f"{doubt}; {own} is predicted and rendered", stacklevel=4)
    return replace(hardware, coded_axes=own)


def draw(result: Verification, path: str | Path) -> None:
    """Draw rendered against predicted errors, each configuration with its number."""
    figure = Figure(figsize=(6.4, 5.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    x, y = 1e3 * result.predicted.mu_mm, 1e3 * result.rendered_mm
    axes.loglog(x, y, "o", markersize=4)
    for k, (a, b) in enumerate(zip(x, y, strict=True)):
        axes.annotate(str(k + 1), (a, b), textcoords="offset points", xytext=(4, 3), fontsize=8)
    axes.set_xlabel("predicted mean error μ / µm")
    axes.set_ylabel("rendered RMS error of a plate / µm")
    axes.set_title(f"Spearman's rank correlation {result.rank_correlation:.2f}")
    axes.grid(visible=True, which="both", alpha=0.3)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")
