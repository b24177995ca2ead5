"""Materials: how surfaces scatter light, and named presets with the sources of their numbers.

Optical constants of metals are measured ones at 549 nm.  Albedo and roughness of a coat or a
finish vary from part to part: those numbers are typical values of ours unless a source is
named, and a scene can override each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from slbench.core.errors import InputError
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.scene.bsdfs import DEFAULT, Bsdf, Diffuse, RoughConductor, RoughPlastic, bsdfs


@dataclass(frozen=True)
class Material:
    """How a surface scatters light, and where its numbers come from.

    Parameters
    ----------
    bsdf : Bsdf
        Of both sides of every face.
    source : str
        Where the numbers come from.
    """

    bsdf: Bsdf = field(default_factory=Diffuse)
    source: str = ""

    @classmethod
    def from_table(cls, table: Mapping[str, Any], where: str) -> Material:
        """Return the material of a table ``[materials.NAME]``: ``bsdf`` and its parameters.

        Raises
        ------
        InputError
            Naming the key at fault.
        """
        if not isinstance(table, Mapping):
            raise InputError(where, "a table with bsdf and its parameters", shown(table))
        values = dict(table)
        kind = bsdfs.get(values.pop("bsdf", DEFAULT), f"{where}.bsdf")
        return cls(validated(kind, values, where))


_TRANSITION_METALS = "n, k at 549 nm: Johnson and Christy, Phys. Rev. B 9, 5056 (1974), "
_NOBLE_METALS = "n, k at 549 nm: Johnson and Christy, Phys. Rev. B 6, 4370 (1972), "

#: Materials that a scene can name without defining them.
PRESETS: dict[str, Material] = {
    "matt-white-spray": Material(
        Diffuse(albedo=0.85), "Lambertian scanning spray; albedo: typical of a TiO2 coat"
    ),
    "grey-plastic": Material(
        RoughPlastic(albedo=0.35, roughness=0.3, eta=1.53),
        "ABS: n = 1.53; albedo, roughness: typical",
    ),
    "printed-resin": Material(
        RoughPlastic(albedo=0.5, roughness=0.4, eta=1.51),
        "acrylic resin: n = 1.51; albedo, roughness: typical",
    ),
    "brushed-steel": Material(
        RoughConductor(albedo=1.0, roughness=0.3, eta=2.95, k=2.93),
        _TRANSITION_METALS + "iron; roughness: typical, isotropic",
    ),
    "chrome": Material(
        RoughConductor(albedo=1.0, roughness=0.03, eta=3.18, k=3.33),
        _TRANSITION_METALS + "chromium; roughness: typical of a sputtered film",
    ),
    "opal-glass": Material(
        Diffuse(albedo=0.9), "Lambertian; albedo: typical of a flashed opal surface"
    ),
    "gold": Material(
        RoughConductor(albedo=1.0, roughness=0.25, eta=0.43, k=2.455),
        _NOBLE_METALS + "gold; roughness: typical of a struck coin",
    ),
    "dark-stage": Material(Diffuse(albedo=0.3), "Lambertian grey of ours"),
}
