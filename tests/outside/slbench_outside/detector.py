from dataclasses import dataclass

import numpy as np

from slbench.core.validation.types import BitDepth, NotNegative, Positive
from slbench.core.validation.values import Value
from slbench.detector import DetectorModel
from slbench.patterns import NoiseModel


@dataclass(frozen=True)
class Ideal(Value, DetectorModel):
    """A linear detector with Gaussian noise and nothing else."""

    bit_depth: BitDepth = 8
    noise_dn: NotNegative = 0.5
    photons_per_dn: Positive = 100.0

    @property
    def black_dn(self):
        return 0.0

    @property
    def saturation_dn(self):
        return 2**self.bit_depth - 1

    def photons(self, irradiance_w_per_mm2, exposure_s, pixel_area_mm2):
        joules_per_photon = 3.6e-19  # at 550 nm
        light = np.asarray(irradiance_w_per_mm2, dtype=np.float64)
        return light * (exposure_s * pixel_area_mm2 / joules_per_photon)

    def expected_dn(self, photons, exposure_s):
        return np.minimum(np.asarray(photons) / self.photons_per_dn, self.saturation_dn)

    def expose(self, photons, exposure_s, rng=None, noise=True, scale=1.0):
        values = self.expected_dn(np.asarray(photons, dtype=np.float64) * scale, exposure_s)
        if noise:
            values = values + self.noise_dn * rng.standard_normal(values.shape)
        dtype = np.uint8 if self.bit_depth == 8 else np.uint16
        return np.clip(np.rint(values), 0, self.saturation_dn).astype(dtype)

    def noise_model(self):
        return NoiseModel(read_dn=self.noise_dn)

    def exposure_scale(self, photons_white, level=0.8, percentile=99.0):
        bright = np.percentile(photons_white, percentile)
        return level * self.saturation_dn * self.photons_per_dn / bright
