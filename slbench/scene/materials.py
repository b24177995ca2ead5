"""How surfaces scatter light, and named presets with the sources of their numbers.

Optical constants of metals are measured ones at 549 nm.  Albedo and roughness of a coat or a
finish vary from part to part: those numbers are typical values of ours unless a source is
named, and a scene can override each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from slbench.core.errors import InputError

Bsdf = Literal["diffuse", "rough_plastic", "rough_conductor"]


@dataclass(frozen=True)
class Material:
    """How a surface scatters light.

    Parameters
    ----------
    bsdf : {"diffuse", "rough_plastic", "rough_conductor"}
        Lambertian; a diffuse base under a rough dielectric coat; a rough metal (both
        microfacet models with the GGX distribution: Walter et al., EGSR 2007).
    albedo : float
        Diffuse reflectance; for a conductor a factor on its specular reflectance.
    roughness : float
        GGX ``alpha``, about the RMS slope of the microfacets; not used by ``diffuse``.
    eta : float or None
        Refractive index of the coat (default 1.5), or its real part for a metal (default:
        iron).
    k : float
        Imaginary part of a metal's refractive index.
    source : str
        Where the numbers come from.
    """

    bsdf: Bsdf = "diffuse"
    albedo: float = 0.7
    roughness: float = 0.3
    eta: float | None = None
    k: float = 2.93
    source: str = ""

    def __post_init__(self) -> None:
        if self.bsdf not in get_args(Bsdf):
            raise InputError("material bsdf", " or ".join(get_args(Bsdf)), self.bsdf)
        if not 0 <= self.albedo <= 1:
            raise InputError("material albedo", "a number in [0, 1]", self.albedo)
        if not 0 < self.roughness <= 1:
            raise InputError("material roughness", "a number in (0, 1]", self.roughness)
        if self.eta is None:
            default = 2.95 if self.bsdf == "rough_conductor" else 1.5
            object.__setattr__(self, "eta", default)
        least = 1.0 if self.bsdf == "rough_plastic" else 0.0
        if not (self.eta or 0) > least or not self.k >= 0:
            expected = f"eta > {least:g} and k >= 0"
            raise InputError("material eta, k", expected, f"{self.eta}, {self.k}")


_TRANSITION_METALS = "n, k at 549 nm: Johnson and Christy, Phys. Rev. B 9, 5056 (1974), "
_NOBLE_METALS = "n, k at 549 nm: Johnson and Christy, Phys. Rev. B 6, 4370 (1972), "

#: Materials that a scene can name without defining them.
PRESETS: dict[str, Material] = {
    "matt-white-spray": Material(
        "diffuse", 0.85, source="Lambertian scanning spray; albedo: typical of a TiO2 coat"
    ),
    "grey-plastic": Material(
        "rough_plastic", 0.35, 0.3, 1.53, source="ABS: n = 1.53; albedo, roughness: typical"
    ),
    "printed-resin": Material(
        "rough_plastic",
        0.5,
        0.4,
        1.51,
        source="acrylic resin: n = 1.51; albedo, roughness: typical",
    ),
    "brushed-steel": Material(
        "rough_conductor",
        1.0,
        0.3,
        2.95,
        2.93,
        source=_TRANSITION_METALS + "iron; roughness: typical, isotropic",
    ),
    "chrome": Material(
        "rough_conductor",
        1.0,
        0.03,
        3.18,
        3.33,
        source=_TRANSITION_METALS + "chromium; roughness: typical of a sputtered film",
    ),
    "opal-glass": Material(
        "diffuse", 0.9, source="Lambertian; albedo: typical of a flashed opal surface"
    ),
    "gold": Material(
        "rough_conductor",
        1.0,
        0.25,
        0.43,
        2.455,
        source=_NOBLE_METALS + "gold; roughness: typical of a struck coin",
    ),
    "dark-stage": Material("diffuse", 0.3, source="Lambertian grey of ours"),
}
