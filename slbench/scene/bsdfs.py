"""How surfaces scatter light: models of reflection, with what the renderer makes of them.

A BSDF is the model of its parameters and says itself what it is in Mitsuba's words: a plain
dictionary, so that nothing here imports Mitsuba.  The rough ones are microfacet models with the
GGX distribution (Walter et al., "Microfacet models for refraction through rough surfaces", EGSR
2007).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any

from slbench.core.registry import Registry
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Fraction, Interval, Measure, NotNegative
from slbench.scene.textures import ShareMap, Texture, spectrum


class Bsdf(Parameters):
    """Base of the models; fields are the keys of ``[materials.NAME]`` in a scene file."""

    @abstractmethod
    def mitsuba(self) -> dict[str, Any]:
        """Return the BSDF of one side of a face as a dictionary for ``mitsuba.load_dict``.

        Pictures in it may be arrays; the renderer takes them in.
        """

    @property
    def textures(self) -> dict[str, Texture]:
        """The parameters that vary over the surface, by name."""
        found = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: value for name, value in found.items() if isinstance(value, Texture)}

    @classmethod
    def takes_texture(cls, key: str) -> bool:
        """Return whether a parameter may be a texture."""
        field = cls.model_fields.get(key)
        return field is not None and "Texture" in repr(field.annotation)


#: BSDFs by name.  To add one, write its class and name it here; outside slbench the entry-point
#: group ``slbench.bsdfs``, or a module that a scene names.
bsdfs: Registry[type[Bsdf]] = Registry(
    "BSDF",
    "slbench.bsdfs",
    {
        "diffuse": "slbench.scene.bsdfs:Diffuse",
        "rough_plastic": "slbench.scene.bsdfs:RoughPlastic",
        "rough_conductor": "slbench.scene.bsdfs:RoughConductor",
    },
    base="slbench.scene.bsdfs:Bsdf",
)
#: What a table is that names none.
DEFAULT = "diffuse"


def grey(value: float) -> dict[str, Any]:
    """Return a spectrum that is the same at all wavelengths."""
    return {"type": "uniform", "value": float(value)}


class Diffuse(Bsdf):
    """Lambertian.

    Parameters
    ----------
    albedo : float or Texture
        Diffuse reflectance.
    """

    albedo: ShareMap = 0.7

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``diffuse``."""
        return {"type": "diffuse", "reflectance": spectrum(self.albedo)}


class RoughPlastic(Bsdf):
    """A diffuse base under a rough dielectric coat.

    Parameters
    ----------
    albedo : float or Texture
        Diffuse reflectance of the base.
    roughness : float
        GGX ``alpha``, about the RMS slope of the microfacets.
    eta : float
        Refractive index of the coat.
    """

    albedo: ShareMap = 0.7
    roughness: Fraction = 0.3
    eta: Annotated[float, Interval(gt=1.0, le=1e9)] = 1.5

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``roughplastic``."""
        return {
            "type": "roughplastic",
            "distribution": "ggx",
            "alpha": self.roughness,
            "int_ior": self.eta,
            "diffuse_reflectance": spectrum(self.albedo),
        }


class RoughConductor(Bsdf):
    """A rough metal; the default is iron.

    Parameters
    ----------
    albedo : float or Texture
        Factor on the specular reflectance.
    roughness : float
        GGX ``alpha``, about the RMS slope of the microfacets.
    eta, k : float
        Real and imaginary part of the refractive index.
    """

    albedo: ShareMap = 0.7
    roughness: Fraction = 0.3
    eta: Measure = 2.95
    k: NotNegative = 2.93

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``roughconductor``."""
        return {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": self.roughness,
            "eta": grey(self.eta),
            "k": grey(self.k),
            "specular_reflectance": spectrum(self.albedo),
        }
