r"""The two-term law of repeatability, and vibration, which explains its second term.

Noise of the detector moves the phase of every fringe set alike; n fringes divide what is left in
the panel coordinate by n.  What moves the picture itself, from frame to frame or from scan to
scan, moves the *coordinate*, whatever the fringes.  Independent, they add as variances::

    sigma_n^2 = (c / n)^2 + s_0^2

With s_0 = 0 fifty fringes are 12.5 times as good as four; with it, the more fringes the less they
gain.

*Vibration.*  A frame shifted by d (pixels, standard deviation v along each axis) shows the phase
of its neighbour: with N shifts the error of the phase is ``2/N sum_k g_k sin^2(phi - 2 pi k/N)``
with ``g_k = n grad(phi_1) . d_k``; as the mean of sin^4 is 3/8, the coordinate p has

    s_0 = sqrt(3 / (2 N)) |grad p| v                                        [panel px]

without n: the fringe count cancels.  Brightness that varies with the place (texture, shading) is
left out; it adds a term of the first kind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from slbench.cloud.triangulation import intersect_axis
from slbench.core.errors import InputError
from slbench.detector.emva1288 import Detector
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.repeats import plate_scene
from slbench.simulate.stack import capture_stack, traced

Array = NDArray[np.float64]

#: Full wells between which a detector with a given phase noise is looked for, electrons.
_WELLS = (60.0, 1e7)
#: A law without a constant falls exactly as 1/n, but for rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class TwoTerm:
    """The law ``sigma_n^2 = (c / n)^2 + s_0^2``.

    Parameters
    ----------
    c, s_0 : float
        Any one unit.
    """

    c: float
    s_0: float

    @classmethod
    def through(cls, few: tuple[int, float], many: tuple[int, float]) -> TwoTerm:
        """Return the law through two points (n, sigma); `many` has the more fringes.

        Raises
        ------
        InputError
            Where sigma falls faster than 1/n, which no such law does, or does not fall.
        """
        (n, a), (m, b) = few, many
        if not (0 < n < m and 0 < b < a <= b * m / n * (1.0 + _ROUNDING)):
            expected = "0 < n < m, and sigma that falls, no faster than 1/n"
            raise InputError("two-term law", expected, f"{few}, {many}")
        c = math.sqrt((a**2 - b**2) / (n**-2 - m**-2))
        return cls(c, math.sqrt(max(b**2 - (c / m) ** 2, 0.0)))

    def sigma(self, n: float) -> float:
        """Return sigma of n fringes."""
        return math.hypot(self.c / n, self.s_0)


def exponent(fringes: tuple[int, ...], sigma: tuple[float, ...]) -> float:
    """Return the power of n that sigma follows: -1 for detector noise, 0 for vibration.

    Slope of a least-squares line through the logarithms; NaN where a sigma is not positive.
    """
    if min(sigma) <= 0.0 or not np.isfinite(sigma).all():
        return float("nan")
    return float(np.polyfit(np.log(fringes), np.log(sigma), 1)[0])


def constant_for_ratio(few: float, many: float, ratio: float) -> float:
    """Return the constant s_0 that, added to both, makes their ratio what is wanted.

    Parameters
    ----------
    few, many : float
        Standard deviations of few and of many fringes without it.
    ratio : float
        Of the first to the second, wanted: between 1 and ``few / many``.
    """
    if not 1.0 < ratio <= few / many:
        raise InputError("ratio", f"above 1, at most {few / many:.4g}", ratio)
    return math.sqrt((few**2 - ratio**2 * many**2) / (ratio**2 - 1.0))


def vibration_std_mm(
    scene: Scene, truth: GroundTruth, shifts: int = 3, *, height: bool = False
) -> Array:
    """Predict the deviation that one pixel of vibration causes, at every smooth pixel.

    Parameters
    ----------
    scene : Scene
    truth : GroundTruth
    shifts : int
        Of the finest fringe set.
    height : bool
        Of the height; otherwise of the point.

    Returns
    -------
    (P,) float
        mm a pixel of vibration along each image axis, pixels of ``truth.smooth()``.
    """
    smooth = truth.smooth()
    dv, du = np.gradient(truth.panel[..., 0])
    slope = np.hypot(du, dv)[smooth]
    return math.sqrt(1.5 / shifts) * slope * sensitivity_mm(scene, truth, height=height)


def sensitivity_mm(scene: Scene, truth: GroundTruth, *, height: bool = False) -> Array:
    """Return how far the point (or its height) moves a panel pixel, (P,) mm/px, smooth pixels."""
    v, u = np.nonzero(truth.smooth())
    origins, directions = scene.rig.camera.unproject(np.column_stack((u, v)))
    panel = truth.panel[v, u, 0]
    _, moved = intersect_axis(scene.rig.projector, origins, directions, panel, "u")
    return np.abs(moved[:, 2]) if height else np.linalg.norm(moved, axis=1)


def noisy_detector(scene: Scene, noise_rad: float, seed: int) -> Detector:
    """Return the scene's detector with so little light that a plate has a given phase noise.

    Full well shrinks and the gain follows, as with a short exposure at a high gain: read noise
    stays.  The plate stands in the middle of the volume, under one fringe (thesis 7.1.2).

    Parameters
    ----------
    scene : Scene
        Its first object's material is the plate's.
    noise_rad : float
        Median over the plate's pixels, three shifts.
    seed : int
    """
    from slbench.simulate.render.groundtruth import ground_truth

    plate = plate_scene(scene, 0.0).with_patterns("1")
    light, smooth = traced(plate, seed=seed), ground_truth(plate.objects, plate.rig).smooth()
    turn = 2.0 * math.pi / plate.rig.projector.width

    def excess(log_well: float) -> float:
        detector = _with_well(detector_of(scene), math.exp(log_well))
        stack = capture_stack(replace(plate, detector=detector), light, seed=seed)
        sigma = stack.fuse().decode(min_modulation=0.0).sigma["u"]
        return math.log(float(np.nanmedian(sigma[smooth])) * turn / noise_rad)

    low, high = (math.log(well) for well in _WELLS)
    if not excess(low) > 0.0 > excess(high):
        raise InputError("phase noise", "what a detector of this kind can have", noise_rad)
    return _with_well(detector_of(scene), math.exp(brentq(excess, low, high, xtol=1e-3)))


def detector_of(scene: Scene) -> Detector:
    """Return a scene's detector: those of the thesis's scenes follow EMVA 1288."""
    return cast(Detector, scene.detector)


def _with_well(detector: Detector, full_well_e: float) -> Detector:
    return replace(detector, full_well_e=full_well_e, gain_e_per_dn=None)
