r"""What a decoder would be given of points of a surface: the values of all frames, point by point.

A pixel that looks at a point of radiance :math:`L` (fully lit) where the panel shows the pattern
:math:`p` sees :math:`L\,\bar p(u) + L_a` in each frame, with ambient light's :math:`L_a` and the
pattern :math:`\bar p` as blurred as projector, camera and the pixel's footprint make it.  The
contrast that the finest fringes keep is the product of the transfer functions

.. math::
    M = M_P(f)\, M_C(f\,|\nabla u|)\, \mathrm{sinc}(f u_x)\, \mathrm{sinc}(f u_y)

with the fringes' frequency :math:`f` in cycles a panel pixel and the derivatives of the panel
coordinate by the camera's pixel; the panel's pixels are squares beside it.  All patterns are
blurred by the Gaussian that takes as much from the finest fringes.  Frames go through the detector,
noise included, and the scan's own decoder says what becomes of them: it knows what noise,
saturation, too little modulation and fringe orders in doubt mean for any code.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from slbench.core.errors import InputError
from slbench.core.random import Word, generator
from slbench.patterns import Axis, PatternSequence, PhaseMap, decode, panel_response
from slbench.rig import Rig
from slbench.scene.model import Scene
from slbench.simulate.expose import Shutter

Array = NDArray[np.float64]

#: Standard deviations of the blurred patterns that are at hand, panel px: between them a pattern
#: is interpolated, which misses a fringe's contrast by less than 1 % of it at these steps.
_BLURS = np.concatenate(([0.0], 0.25 * 2.0 ** (0.5 * np.arange(21))))
#: Places of a table a panel pixel, between which it is interpolated.
_FINER = 4
#: Of the detector's noise, which is the same in every plan.
_SEED = 0
#: Least contrast: fringes that defocus reverses have no Gaussian.
_LEAST_CONTRAST = 1e-4


class Frames:
    """The frames of a scene's patterns, at single places of the panel.

    Parameters
    ----------
    scene : Scene
        In grey, of one camera and one projector.

    Raises
    ------
    InputError
        For patterns in colour, patterns that vary along both axes, and those that are decoded by
        neighbouring pixels.
    """

    def __init__(self, scene: Scene) -> None:
        sequence = scene.sequence
        where = f"scene {scene.name}: patterns"
        if scene.colour is not None or sequence.crosstalk is not None:
            raise InputError(where, "grey light and patterns, to plan views", "colour")
        if "uv" in sequence.variations or sequence.spatial:
            expected = "patterns along one axis each that are decoded pixel by pixel, to plan views"
            raise InputError(where, expected, sequence.name)
        sequence.runs()
        self.scene, self.sequence = scene, sequence
        projector = scene.rig.projector
        self._tables = []
        for axis in (one for one in sequence.variations if one != "uv"):
            indices, shown = sequence.profiles(axis)
            light = panel_response(shown, projector.bit_depth, projector.gamma, projector.curve)
            fine = np.repeat(light, _FINER, axis=1)
            blurred = [
                fine if s == 0.0 else gaussian_filter1d(fine, _FINER * s, axis=1, mode="nearest")
                for s in _BLURS
            ]
            self._tables.append((axis, indices, np.array(blurred)))

    def decoded(
        self, panel: Array, blur_px: Array, radiance: Array, ambient: Array, shutter: Shutter
    ) -> PhaseMap:
        """Return what the decoder makes of points, as an image of one row.

        Parameters
        ----------
        panel : (n, 2) float
            Panel coordinates of the points.
        blur_px : (n, 2) float
            Standard deviation of the blur along u and v, panel px.
        radiance, ambient : (n,) float
            By the fully lit panel, and by all other light, W / (mm^2 sr).
        shutter : Shutter
        """
        detector = self.scene.detector
        shown = np.empty((self.sequence.n_frames, len(panel)))
        for axis, indices, table in self._tables:
            k = "uv".index(axis)
            shown[indices] = _interpolated(table, panel[:, k], blur_px[:, k])
        light = (radiance * shown + ambient)[:, np.newaxis, :]
        frames = detector.expose(
            light, shutter.time_s, generator(_SEED, Word.NOISE), True, shutter.photons
        )
        return decode(
            frames,
            self.sequence,
            noise=detector.noise_model(),
            saturation=detector.saturation_dn,
        )

    def blur(self, rig: Rig, points: Array, by_pixel: Array) -> Array:
        """Return the standard deviation of the blur at points, (n, 2), panel px.

        Parameters
        ----------
        rig : Rig
        points : (n, 3) float
            In the world.
        by_pixel : (n, 2, 2) float
            Derivatives of the panel coordinates (u, v) by the camera's pixel (x, y).
        """
        camera, projector = rig.camera, rig.projector
        circles = camera.circle_of_confusion(points), projector.circle_of_confusion(points)
        return np.stack(
            [
                self._blur_along(k, rig, by_pixel[:, k], circles)
                if axis in self.sequence.variations
                else np.zeros(len(points))
                for k, axis in enumerate("uv")
            ],
            axis=1,
        )

    def _blur_along(self, k: int, rig: Rig, slope: Array, circles: tuple[Array, Array]) -> Array:
        frequency = _finest(self.sequence, k)
        aspect = rig.projector.pitch_mm[0] / rig.projector.pitch_mm[1] if k else 1.0
        at_camera = frequency * np.linalg.norm(slope, axis=1)
        contrast = rig.projector.spread.contrast(frequency * aspect, circles[1])
        contrast = contrast * rig.camera.spread.contrast(at_camera, circles[0])
        contrast *= np.prod(np.sinc(frequency * slope), axis=1)
        kept = np.maximum(contrast, _LEAST_CONTRAST)
        return np.sqrt(-2.0 * np.log(np.minimum(kept, 1.0))) / (2.0 * np.pi * frequency)


def _finest(sequence: PatternSequence, k: int) -> float:
    """Return the frequency of the finest fringes along an axis, or of a period of 16 px."""
    axis: Axis = "v" if k else "u"
    finest = sequence.finest(axis)
    if finest is None:
        return 1.0 / 16.0
    return finest.code.periods(sequence.panel) / sequence.size(axis)


def _interpolated(table: Array, place: Array, blur: Array) -> Array:
    """Return values of a table (blurs, frames, places) between its entries, (frames, n)."""
    size = table.shape[2]
    place = np.clip(_FINER * (place + 0.5) - 0.5, 0.0, size - 1.0)
    left = np.minimum(place.astype(np.int64), max(size - 2, 0))
    right = np.minimum(left + 1, size - 1)
    along = place - left
    level = np.clip(np.searchsorted(_BLURS, blur, side="right") - 1, 0, len(_BLURS) - 2)
    weight = np.clip((blur - _BLURS[level]) / (_BLURS[level + 1] - _BLURS[level]), 0.0, 1.0)
    rows = [
        table[one, :, left].T * (1.0 - along) + table[one, :, right].T * along
        for one in (level, level + 1)
    ]
    return rows[0] * (1.0 - weight) + rows[1] * weight
