"""How surfaces scatter light: models of reflection, with what the renderer makes of them.

A BSDF is the model of its parameters and says itself what it is in Mitsuba's words: a plain
dictionary, so that nothing here imports Mitsuba.  The rough ones are microfacet models with the
GGX distribution (Walter et al., "Microfacet models for refraction through rough surfaces", EGSR
2007).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, Literal, Self

from slbench.core.registry import Registry
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Fraction, Interval, Measure, NotNegative, Share
from slbench.scene.surfaces.interiors import Interior
from slbench.scene.surfaces.textures import (
    COLOURED,
    LEAST_ROUGHNESS,
    FractionMap,
    Normals,
    ShareMap,
    Texture,
    spectrum,
)


class Bsdf(Parameters):
    """Base of the models; fields are the keys of ``[materials.NAME]`` in a scene file.

    Parameters
    ----------
    normal_map : NormalMap, optional
        Normals that light is scattered about, instead of the surface's.  Such a surface keeps
        neither reciprocity nor energy exactly: relief is in the mesh.
    """

    normal_map: Normals = None

    @abstractmethod
    def mitsuba(self) -> dict[str, Any]:
        """Return the BSDF of one side of a face as a dictionary for ``mitsuba.load_dict``.

        Pictures in it may be arrays; the renderer takes them in.
        """

    def scattering(self) -> dict[str, Any]:
        """Return the BSDF in Mitsuba's words, about the normals of its map where it has one."""
        if self.normal_map is None:
            return self.mitsuba()
        return {
            "type": "normalmap",
            "normalmap": self.normal_map.mitsuba(),
            "use_shadowing_function": False,
            "bsdf": self.mitsuba(),
        }

    @property
    def interior(self) -> Interior | None:
        """What is inside the surface, where light gets in."""
        return None

    @property
    def mappings(self) -> set[str]:
        """By what texture coordinates it is laid on a surface: ``box``, ``uv``, or none."""
        return {one.mapping for one in self.textures.values() if one.laid}

    def in_band(self, k: int) -> Self:
        """Return the BSDF in a band of light, of red (0), green (1) or blue (2)."""
        found = {name: one.in_band(k) for name, one in self.textures.items() if name in COLOURED}
        own = self.textures
        changed = {name: value for name, value in found.items() if value is not own[name]}
        return self.model_copy(update=changed) if changed else self

    @property
    def textures(self) -> dict[str, Texture]:
        """The parameters that vary over the surface, by name."""
        found = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: value for name, value in found.items() if isinstance(value, Texture)}

    @classmethod
    def takes_texture(cls, key: str) -> bool:
        """Return whether a parameter may be a texture."""
        field = cls.model_fields.get(key)
        return field is not None and any(w in repr(field) for w in ("Texture", "NormalMap"))


#: BSDFs by name.  To add one, write its class and name it here; outside slbench the entry-point
#: group ``slbench.bsdfs``, or a module that a scene names.
bsdfs: Registry[type[Bsdf]] = Registry(
    "BSDF",
    "slbench.bsdfs",
    {
        "diffuse": "slbench.scene.surfaces.bsdfs:Diffuse",
        "rough_plastic": "slbench.scene.surfaces.bsdfs:RoughPlastic",
        "rough_conductor": "slbench.scene.surfaces.bsdfs:RoughConductor",
        "principled": "slbench.scene.surfaces.bsdfs:Principled",
        "translucent": "slbench.scene.surfaces.translucent:Translucent",
        "dielectric": "slbench.scene.surfaces.translucent:Dielectric",
    },
    base="slbench.scene.surfaces.bsdfs:Bsdf",
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
    roughness : float or Texture
        GGX ``alpha``, about the RMS slope of the microfacets.
    eta, k : float
        Real and imaginary part of the refractive index.
    """

    albedo: ShareMap = 0.7
    roughness: FractionMap = 0.3
    eta: Measure = 2.95
    k: NotNegative = 2.93

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``roughconductor``."""
        return {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": _roughness(self.roughness),
            "eta": grey(self.eta),
            "k": grey(self.k),
            "specular_reflectance": spectrum(self.albedo),
        }


class Principled(Bsdf):
    """Paint, plastic and metal in one: diffuse base, microfacets, clear coat.

    B. Burley, "Physically based shading at Disney", SIGGRAPH courses 2012, in Mitsuba's form; the
    metals and plastics of glTF are close to it.  Its diffuse and specular parts are added without
    regard for each other: a dielectric of an albedo of 0.9 reflects 0.94 of the light at right
    angles, 0.98 at 60 degrees, and more than all of it beyond 75; one of 1.0 always does.

    Parameters
    ----------
    albedo : float or Texture
        Diffuse reflectance, or a metal's reflectance at right angles.
    metallic : float or Texture
        From 0, a dielectric, to 1, a metal.
    roughness : float or Texture
        Its square is GGX ``alpha``.
    specular : float
        Reflectance of a dielectric at right angles, of 8 %: 0.5 is a refractive index of 1.5.
    clearcoat, clearcoat_gloss : float
        A smooth coat's share, and how sharply it reflects.
    anisotropy : float
        From 0 to 1, brushed: ``alpha`` along the lay is that across it times
        ``1 - 0.9 anisotropy``.
    lay : {"u", "v"}
        The way of the brush, by texture coordinates.
    lay_mapping : {"box", "uv"}
        Which: those of a texture mapped so.
    """

    albedo: ShareMap = 0.7
    metallic: ShareMap = 0.0
    roughness: FractionMap = 0.5
    specular: Share = 0.5
    clearcoat: Share = 0.0
    clearcoat_gloss: Share = 0.5
    anisotropy: Share = 0.0
    lay: Literal["u", "v"] = "u"
    lay_mapping: Literal["box", "uv"] = "box"

    @property
    def mappings(self) -> set[str]:
        """Those of the textures, and of the lay."""
        return super().mappings | ({self.lay_mapping} if self.anisotropy else set())

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``principled``."""
        # With s^2 = 1 - 0.9 a, alpha is that of the roughness over s along u and times s along v:
        # the lay is v.  With the inverse of s it is u.
        squared = 1.0 - 0.9 * self.anisotropy
        if self.lay == "u":
            squared = 1.0 / squared
        return {
            "type": "principled",
            "base_color": spectrum(self.albedo),
            "metallic": spectrum(self.metallic),
            "roughness": spectrum(self.roughness, LEAST_ROUGHNESS**0.5),
            "specular": self.specular,
            "clearcoat": self.clearcoat,
            "clearcoat_gloss": self.clearcoat_gloss,
            "anisotropic": (1.0 - squared) / 0.9,
        }


def _roughness(value: float | Texture) -> Any:
    """Return a GGX ``alpha`` in Mitsuba's words."""
    return spectrum(value, LEAST_ROUGHNESS) if isinstance(value, Texture) else value
