"""Baselines in closed form: what textbooks do, without learning.

- ``depth-1``: Fourier-transform profilometry (M. Takeda and K. Mutoh, "Fourier transform
  profilometry for the automatic measurement of 3-D object shapes", Appl. Opt. 22(24), 1983): the
  carrier's side band, unwrapped by neighbourhoods; its whole number of fringes is the one that is
  nearest to the stage, which stands in all scenes.
- ``depth-6``, ``completion``: slbench's decoder, triangulated; for completion a pixel without depth
  has that of the nearest one with it.
- ``orders``: the order that the single fringe predicts (thesis eq. 26).
- ``phase``: three-step arctangent.

All leave out pixels of a modulation below 3 DN.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import scipy.ndimage

from slbench.leaderboard.scenes import COARSE, FRINGES, SHIFTS, TURN, Array, Scene, depth_of
from slbench.patterns.decode import MIN_MODULATION_DN
from slbench.patterns.phase import relative_phase, unwrap, unwrap_spatially
from slbench.rig import Rig

#: Height of the stage in world coordinates, mm.
STAGE_MM = -8.0
#: A function a task, from a scene to what it predicts, (V, U); NaN: no prediction.
Baseline = Mapping[str, Callable[[Scene], Array]]


def phase(scene: Scene) -> Array:
    """Return the phase of frames 3 to 5, rad."""
    _, modulation, _ = relative_phase(scene.frames[SHIFTS:])
    return np.where(modulation >= MIN_MODULATION_DN, scene.phase, np.nan)


def orders(scene: Scene) -> Array:
    """Return fringe orders by the phase of frames 0 to 2."""
    coarse, _, _ = relative_phase(scene.frames[:SHIFTS])
    fine = phase(scene)
    return np.asarray((unwrap(fine, FRINGES, coarse, COARSE) - fine) / TURN)


def decoded(scene: Scene) -> Array:
    """Return the depth of decoded frames, mm."""
    return scene.decoded_depth


def completed(scene: Scene) -> Array:
    """Return depth everywhere, of the nearest pixel that has one."""
    return filled(scene.decoded_depth)


def filled(values: Array) -> Array:
    """Return a map (V, U) whose NaN are what the nearest pixel has that is none."""
    missing = np.isnan(values)
    if missing.all():
        return values
    nearest = scipy.ndimage.distance_transform_edt(
        missing, return_distances=False, return_indices=True
    )
    return np.asarray(values[tuple(nearest)])


def depth_of_one(scene: Scene) -> Array:
    """Return the depth of one picture by Fourier-transform profilometry, mm."""
    return depth_of(scene.rig, turns_of_one(scene) * (scene.panel_width / FRINGES) - 0.5)


def turns_of_one(scene: Scene) -> Array:
    """Return the absolute phase of one picture by Fourier-transform profilometry, turns."""
    expected = reference_turns(scene.rig, scene.shape, scene.panel_width)
    analytic = side_band(scene.frames[SHIFTS].astype(np.float64), expected)
    mask = np.abs(analytic) >= MIN_MODULATION_DN
    if not mask.any():
        return np.full(scene.shape, np.nan)
    turns = unwrap_spatially(np.angle(analytic), mask) / TURN
    return np.asarray(turns + np.rint(np.nanmedian(expected - turns)))


def side_band(frame: Array, expected: Array) -> Array:
    """Return the analytic signal of a picture's fringes, (V, U) complex; its modulus is theirs.

    Parameters
    ----------
    frame : (V, U) float
    expected : (V, U) float
        About their phase in turns: it gives carrier and direction.

    Notes
    -----
    The window of the side band is a raised cosine around the carrier that ends halfway to zero
    frequency; the picture is continued by its mirror image on either side.
    """
    columns = frame.shape[1]
    carrier = float(np.median(np.diff(expected, axis=1)))
    mirrored = np.pad(frame - frame.mean(), ((0, 0), (columns // 2, columns // 2)), "reflect")
    frequencies = np.fft.fftfreq(mirrored.shape[1])
    distance = np.abs(frequencies - carrier) / (0.75 * abs(carrier))
    window = np.where(distance < 1.0, 0.5 + 0.5 * np.cos(np.pi * distance), 0.0)
    filtered = np.fft.ifft(2.0 * window * np.fft.fft(mirrored, axis=1), axis=1)
    return np.asarray(filtered[:, columns // 2 : columns // 2 + columns])


def reference_turns(rig: Rig, shape: tuple[int, int], width: int) -> Array:
    """Return the phase in turns, (V, U), that the stage alone would have."""
    v, u = np.indices(shape)
    origins, directions = rig.camera.unproject(np.column_stack((u.ravel(), v.ravel())))
    points = origins + directions * ((STAGE_MM - origins[:, 2:]) / directions[:, 2:])
    columns = rig.projector.project(points)[:, 0].reshape(shape)
    return np.asarray((columns + 0.5) * (FRINGES / width))


CLOSED_FORM: Baseline = {
    "depth-1": depth_of_one,
    "depth-6": decoded,
    "orders": orders,
    "phase": phase,
    "completion": completed,
}
#: By the name that the command line knows.
BASELINES: dict[str, Baseline] = {"closed-form": CLOSED_FORM}
