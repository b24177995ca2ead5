"""The medium inside a closed surface.

Its parameters are those of radiative transfer in a homogeneous medium (A. Ishimaru, "Wave
propagation and scattering in random media", 1978): light is scattered after a free path that is
exponentially distributed, into directions by Henyey and Greenstein's phase function (Astrophys. J.
93, 70, 1941).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Interior:
    """The medium inside a closed surface.

    Parameters
    ----------
    eta : float
        Refractive index; 1: matched to the air, so that the boundary is no optical one.
    scattering_per_mm : float
        Scattering coefficient; 0: clear.
    absorption_per_mm : float
        Absorption coefficient.
    g : float
        Mean cosine of the scattering angle.
    """

    eta: float
    scattering_per_mm: float = 0.0
    absorption_per_mm: float = 0.0
    g: float = 0.0

    @property
    def clear(self) -> bool:
        """Whether light goes straight through."""
        return self.scattering_per_mm == 0.0

    @property
    def extinction_per_mm(self) -> float:
        """Inverse of the mean free path."""
        return self.scattering_per_mm + self.absorption_per_mm

    @property
    def transport_path_mm(self) -> float:
        """Mean free path to where light has lost its direction, or is absorbed."""
        return 1.0 / (self.scattering_per_mm * (1.0 - self.g) + self.absorption_per_mm)

    @property
    def albedo(self) -> float:
        """Share of the light that a scattering event keeps."""
        return self.scattering_per_mm / self.extinction_per_mm

    @property
    def diffuse_reflectance(self) -> float:
        """What a half space of it returns of the light that gets in, by the diffusion dipole.

        H. W. Jensen, S. R. Marschner, M. Levoy, P. Hanrahan, SIGGRAPH 2001, section 2.4; with
        scattering made isotropic (``g = 0``), and to some per cent where it is white.
        """
        reduced = self.scattering_per_mm * (1.0 - self.g)
        albedo = reduced / (reduced + self.absorption_per_mm)
        inner = 0.0
        if self.eta > 1.0:
            inner = -1.440 / self.eta**2 + 0.710 / self.eta + 0.668 + 0.0636 * self.eta
        root = math.sqrt(3.0 * (1.0 - albedo))
        far = math.exp(-4.0 / 3.0 * (1.0 + inner) / (1.0 - inner) * root)
        return albedo / 2.0 * (1.0 + far) * math.exp(-root)

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``homogeneous`` medium of it."""
        phase = {"type": "hg", "g": self.g} if self.g else {"type": "isotropic"}
        return {
            "type": "homogeneous",
            "sigma_t": self.extinction_per_mm,
            "albedo": self.albedo,
            "phase": phase,
        }
