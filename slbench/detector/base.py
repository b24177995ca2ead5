"""What a detector is: the questions that the simulation asks one, and detectors by name.

Whatever turns light into digital numbers is a subclass of :class:`DetectorModel`, whose fields are
the keys of ``[detector]`` in a scene file (a frozen dataclass that is a
:class:`~slbench.core.validation.values.Value`, or a pydantic model).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.registry import Registry
from slbench.core.validation.types import BitDepth
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.patterns import NoiseModel

FloatArray = NDArray[np.float64]
FrameArray = NDArray[np.uint8] | NDArray[np.uint16]


class DetectorModel(ABC):
    """A camera's detector.

    Attributes
    ----------
    bit_depth : int
        Bits of a digital number; frames are uint8 for 8, else uint16.
    """

    bit_depth: BitDepth

    @property
    @abstractmethod
    def black_dn(self) -> float:
        """Black level, DN."""

    @property
    @abstractmethod
    def saturation_dn(self) -> int:
        """Digital number from which on a pixel is saturated."""

    @abstractmethod
    def photons(
        self, irradiance_w_per_mm2: ArrayLike, exposure_s: float, pixel_area_mm2: float
    ) -> FloatArray:
        """Return the mean number of photons a pixel of an irradiance of any shape."""

    @abstractmethod
    def expose(
        self,
        photons: ArrayLike,
        exposure_s: float,
        rng: np.random.Generator | None = None,
        noise: bool = True,
        scale: float = 1.0,
    ) -> FrameArray:
        """Expose frames: mean photons in, digital numbers out.

        Parameters
        ----------
        photons : (..., V, U) array_like
            Mean photons a pixel over `scale`; every leading index is one frame.
        exposure_s : float
        rng : numpy.random.Generator
            Source of the temporal noise: frames of the same generator are the same.
        noise : bool
            False gives the expectation, without fixed pattern, rounded.
        scale : float
            Photons a unit of `photons`, which may thus be a radiance.

        Returns
        -------
        (..., V, U) uint8 or uint16
        """

    @abstractmethod
    def expected_dn(self, photons: ArrayLike, exposure_s: float) -> FloatArray:
        """Return the mean digital number (..., V, U) before rounding, without fixed pattern."""

    @abstractmethod
    def noise_model(self) -> NoiseModel:
        """Return the temporal noise of the detector's frames, for the decoder."""

    @abstractmethod
    def exposure_scale(
        self, photons_white: ArrayLike, level: float = 0.8, percentile: float = 99.0
    ) -> float:
        """Return the factor on the light that exposes the fully lit image to a given level.

        Parameters
        ----------
        photons_white : array_like
            Mean photons a pixel under a fully lit panel.
        level : float
            Fraction of saturation to reach.
        percentile : float
            Percentile of the lit pixels that reaches it.
        """


#: Detectors by name.  To add one, write its class and name it here; outside slbench the
#: entry-point group ``slbench.detectors``, or a module that a scene names.
detectors: Registry[type[DetectorModel]] = Registry(
    "detector",
    "slbench.detectors",
    {"emva1288": "slbench.detector.emva1288:Detector"},
    base="slbench.detector.base:DetectorModel",
)
#: What a table is that names none.
DEFAULT = "emva1288"


def detector_of(table: Mapping[str, Any], where: str) -> DetectorModel:
    """Return the detector of a table ``[detector]``: ``kind`` and the fields of that.

    Raises
    ------
    InputError
        Naming the key at fault.
    """
    if not isinstance(table, Mapping):
        raise InputError(where, "a table of a detector", shown(table))
    values = dict(table)
    kind = detectors.get(values.pop("kind", DEFAULT), f"{where}.kind")
    return validated(kind, values, where)
