"""Fringe sets taken one at a time from stored light, with exposures and masks of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import tagged_seed
from slbench.core.show.display import brief
from slbench.core.validation.types import Share
from slbench.patterns import MIN_MODULATION_DN, Fringes, NoiseModel, PatternSequence
from slbench.patterns.base import FloatArray
from slbench.scene.model import Scene
from slbench.simulate.expose import Shutter, capture, lighting, shutter_for
from slbench.simulate.transport import LightTransport

#: Frames of every set; a set that comes again has shifts between those before.
SHIFTS = 3
#: Starts of the shifts of a set that comes again, shares of their distance.
_STARTS = (0.0, 0.5, 0.25, 0.75)


@dataclass(frozen=True, repr=False)
class DimmedFringes(Fringes):
    """Fringes under a mask that dims columns of the panel.

    Parameters
    ----------
    mask : tuple of float
        Factor of every column; empty for none.
    """

    kind: ClassVar[str] = "fringes"
    mask: tuple[Share, ...] = ()

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        shown = super().profile(k, size)
        return shown * np.array(self.mask) if self.mask else shown


@dataclass(frozen=True, eq=False)
class Shot:
    """A fringe set that is to be taken.

    Parameters
    ----------
    count : int
        Fringes across the panel.
    exposure : float
        Over that of the scene.
    mask : (W,) float or None
        By which columns of the panel are dimmed.
    """

    count: int
    exposure: float = 1.0
    mask: FloatArray | None = None

    __repr__ = brief

    @property
    def light(self) -> float:
        """Exposure of all its frames, in exposures of the scene."""
        return SHIFTS * self.exposure


@dataclass(frozen=True, eq=False)
class Taken:
    """What a set says of P pixels, in DN at the exposure of the scene and without mask.

    Parameters
    ----------
    shot : Shot
    wave : (P,) complex
        Modulation times exp(i phase).
    variance : (P,) float
        Of each of its two components.
    mean : (P,) float
        Above the black level, as it was seen under the mask.
    usable : (P,) bool
        Neither saturated nor too faint nor at an edge of the mask.
    saturated : (P,) bool
    """

    shot: Shot
    wave: NDArray[np.complex128]
    variance: FloatArray
    mean: FloatArray
    usable: NDArray[np.bool_]
    saturated: NDArray[np.bool_]

    __repr__ = brief


class Instrument:
    """A scene whose light is at hand, for sets of fringes.

    Parameters
    ----------
    scene : Scene
    transport : LightTransport
        With the marginal "u".
    seed : int
        Of temporal noise and vibration.
    noise : bool
        False leaves both out.

    Raises
    ------
    InputError
        For a scene in colour, with focus settings, frame errors, several exposures, or a projector
        whose response is not linear.
    """

    def __init__(
        self, scene: Scene, transport: LightTransport, *, seed: int = 0, noise: bool = True
    ) -> None:
        check_adaptable(scene)
        self._scene, self._transport = scene, transport
        self._seed, self._noise_on = seed, noise
        with lighting(scene):
            found = shutter_for(transport, scene.rig.camera, scene.detector, scene.exposure)
        self.shutter: Shutter = found.times(*scene.exposure.bracket)
        self.noise: NoiseModel = scene.detector.noise_model()
        self.top_dn: float = scene.detector.saturation_dn
        self.width: int = scene.sequence.panel[0]
        self.shape = transport.shape
        bits = scene.rig.projector.bit_depth
        self.steps = None if bits is None else 2**bits - 1
        self._taken = 0
        self._times: dict[int, int] = {}

    @property
    def room_dn(self) -> float:
        """Digital numbers between the black level and saturation."""
        return self.top_dn - self.noise.offset_dn

    def rounding(self, modulation: FloatArray, level: FloatArray) -> FloatArray:
        """Return the variance of a frame that a dimmed panel's fewer grey levels add, DN^2.

        A panel of B bits shows its own light to 1 / (2^B - 1), and the dimmed one no finer: of the
        light of white, 2 b / m, that is a uniform error.  What it is without a mask is no part.

        Parameters
        ----------
        modulation : (P,) float
            As it is seen under the mask, b.
        level : (P,) float
            Factor of the mask, m; 0 where it has none.
        """
        if self.steps is None:
            return np.zeros(np.shape(modulation))
        step = 2.0 * modulation / (np.maximum(level, 1e-6) * self.steps)
        return np.asarray(step**2 / 12.0 * (1.0 - np.minimum(level, 1.0) ** 2))

    def take(self, shot: Shot, level: FloatArray | None = None) -> Taken:
        """Take a set.

        Parameters
        ----------
        shot : Shot
        level : (P,) float, optional
            The mask's factor at every pixel; NaN where it is not the same all over what a pixel
            sees.
        """
        times = self._times.get(shot.count, 0)
        start = 360.0 / SHIFTS * _STARTS[times % len(_STARTS)]
        degrees = tuple(start + 360.0 / SHIFTS * k for k in range(SHIFTS))
        mask = () if shot.mask is None else tuple(shot.mask.tolist())
        code = DimmedFringes(shot.count, axis="u", shifts_deg=degrees, mask=mask)
        sequence = PatternSequence(self._scene.sequence.panel, (code,))
        shots = capture(
            *(self._transport, sequence, self._scene.rig, self._scene.detector),
            self._scene.exposure.single(),
            seed=tagged_seed(self._seed, self._taken),
            noise=self._noise_on,
            shutter=self.shutter.times(shot.exposure),
        )
        self._taken += 1
        self._times[shot.count] = times + 1
        phase, modulation, mean = code.relative_phase(shots.frames, sequence.panel)
        phase, modulation, mean = phase.ravel(), modulation.ravel(), mean.ravel()
        saturated = (shots.frames >= self.top_dn).any(axis=0).ravel()
        factor = shot.exposure if level is None else shot.exposure * np.nan_to_num(level)
        scale = 1.0 / np.maximum(factor, 1e-12)
        # Three shifts leave a third harmonic of shot noise.
        third = (
            0.5 * self.noise.gain_dn_per_e * modulation * np.cos(3.0 * (phase - np.radians(start)))
        )
        variance = self.noise.variance(mean) - third
        if level is not None:
            variance += self.rounding(modulation, np.nan_to_num(level))
        return Taken(
            shot=shot,
            wave=modulation * scale * np.exp(1j * phase),
            variance=2.0 / SHIFTS * variance * scale**2,
            mean=(mean - self.noise.offset_dn) / shot.exposure,
            usable=~saturated & (modulation >= MIN_MODULATION_DN) & (np.asarray(factor) > 0.0),
            saturated=saturated,
        )


def check_adaptable(scene: Scene) -> None:
    """Check that fringes can be chosen for a scene while it is measured.

    Raises
    ------
    InputError
        As of :class:`Instrument`.
    """
    given = {
        "in colour": scene.colour is not None,
        "with focus settings": scene.focus is not None,
        "with bit planes, lost triggers or drift": scene.exposure.has_frame_errors,
        "that moves": scene.moves,
        "of several exposures": len(scene.exposure.bracket) > 1,
        "whose projector's response is not linear": not scene.rig.projector.response.linear,
    }
    for what, here in given.items():
        if here:
            expected = "one band, one focus setting, one exposure, and a projector without fault"
            raise InputError(f"scene {scene.name}", expected, f"one {what}")
