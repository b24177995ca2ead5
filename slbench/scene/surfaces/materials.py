"""Materials: how surfaces scatter light, and named presets with the sources of their numbers.

Optical constants of metals are measured ones at 549 nm.  Albedo and roughness of a coat or a
finish vary from part to part: those numbers are typical values of ours unless a source is
named, and a scene can override each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.values import validated
from slbench.core.validation.wording import shown
from slbench.objects import Artefact
from slbench.objects.surface import Pixels, Surface
from slbench.scene.surfaces.bsdfs import (
    DEFAULT,
    Bsdf,
    Diffuse,
    Principled,
    RoughConductor,
    RoughPlastic,
    bsdfs,
)
from slbench.scene.surfaces.textures import (
    LEAST_ROUGHNESS,
    NormalMap,
    OfMesh,
    OfVertices,
    Picture,
    Texture,
    Tint,
    read_texture,
)
from slbench.scene.surfaces.translucent import Dielectric, Translucent


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
    def from_table(
        cls, table: Mapping[str, Any], where: str, folder: Path | None = None
    ) -> Material:
        """Return the material of a table ``[materials.NAME]``: ``bsdf`` and its parameters.

        Pictures that it names are in `folder` or below; None takes paths as they are.

        Raises
        ------
        InputError
            Naming the key at fault.
        """
        if not isinstance(table, Mapping):
            raise InputError(where, "a table with bsdf and its parameters", shown(table))
        values = dict(table)
        kind = bsdfs.get(values.pop("bsdf", DEFAULT), f"{where}.bsdf")
        for key in filter(kind.takes_texture, values):
            values[key] = read_texture(values[key], f"{where}.{key}", folder, key)
        return cls(validated(kind, values, where))

    def on(self, artefact: Artefact, part: str) -> Material:
        """Return the material on a part of an artefact: with the colours of its mesh, if it asks.

        Pictures that are still files are read.

        Raises
        ------
        InputError
            If it asks for colours or texture coordinates that the mesh does not have.
        """
        found = self.bsdf.textures
        if not found and not self.bsdf.mappings:
            return self
        where = f"{artefact.name}: part {part}"
        own: dict[str, float | Texture] = {}
        for name, texture in found.items():
            if type(texture) is OfMesh:
                if name != "albedo":
                    raise InputError(where, 'texture = "mesh" for albedo alone', name)
                own[name] = of_surface(artefact.surfaces.get(part), texture, where)
            elif isinstance(texture, Picture) and texture.pixels is None:
                own[name] = texture.read()
        bsdf = self.bsdf.model_copy(update=own)
        if len(bsdf.mappings) > 1:
            raise InputError(where, "one mapping for all textures of a material", "uv and box")
        if "uv" in bsdf.mappings and not _has_uv(artefact, part):
            expected = 'a mesh with texture coordinates, or textures with mapping = "box"'
            raise InputError(where, expected, "a mesh without")
        return replace(self, bsdf=bsdf)

    def in_band(self, k: int) -> Material:
        """Return the material in a band of light, of red (0), green (1) or blue (2).

        It stands on a part already (:meth:`on`); a grey one is itself.
        """
        bsdf = self.bsdf.in_band(k)
        return self if bsdf is self.bsdf else replace(self, bsdf=bsdf)


def of_surface(surface: Surface | None, texture: OfMesh, where: str) -> float | Texture:
    """Return the base colour of a part's surface, times the texture's factor."""
    if surface is None:
        raise InputError(where, "a mesh that brings colours", "one without")
    if surface.corners:
        return OfVertices(scale=texture.scale)
    if surface.picture is not None:
        return Picture(path="mesh", pixels=surface.picture, scale=texture.scale)
    if surface.colour is not None and np.ptp(surface.colour) > 0.0:
        return Tint(values=surface.colour, scale=texture.scale)
    return surface.albedo * texture.scale


def _has_uv(artefact: Artefact, part: str) -> bool:
    """Return whether all corners of a part have texture coordinates."""
    uv = artefact.mesh.uv
    return uv is not None and bool(np.isfinite(uv[artefact.parts[part]]).all())


def _map_or(value: float | Pixels | None, default: float, least: float) -> float | Texture:
    """Return what a file states of a share, as a number or a texture."""
    if isinstance(value, Pixels):
        return Picture(path="mesh", pixels=value)
    return float(np.clip(default if value is None else value, least, 1.0))


def own_materials(artefact: Artefact) -> dict[str, Material]:
    """Return materials of what an artefact's mesh file states of its parts, by part.

    Lambertian where it states colours alone.  With metalness or roughness it is ``principled``;
    of these two what is missing is a dielectric's 0 and a matt surface's 1.
    """
    found = {}
    for part, surface in artefact.surfaces.items():
        normals = None
        if surface.normals is not None:
            normals = NormalMap(path="mesh", pixels=surface.normals)
        bsdf: Bsdf = Diffuse(albedo=OfMesh(), normal_map=normals)
        if surface.metallic is not None or surface.roughness is not None:
            bsdf = Principled(
                albedo=OfMesh(),
                metallic=_map_or(surface.metallic, 0.0, 0.0),
                roughness=_map_or(surface.roughness, 1.0, LEAST_ROUGHNESS**0.5),
                normal_map=normals,
            )
        found[part] = Material(bsdf, "the mesh file")
    return found


_TRANSITION_METALS = "n, k at 549 nm: Johnson and Christy, Phys. Rev. B 9, 5056 (1974), "
_NOBLE_METALS = "n, k at 549 nm: Johnson and Christy, Phys. Rev. B 6, 4370 (1972), "

_JENSEN = (
    "green of the table of Jensen et al., SIGGRAPH 2001, of reduced scattering; "
    "roughness: not confirmed"
)
_OURS = "typical values of ours, not confirmed; n: "

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
    "brushed-aluminium": Material(
        Principled(albedo=0.92, metallic=1.0, roughness=0.5, anisotropy=0.8),
        "reflectance of aluminium at 549 nm, 0.92; roughness, anisotropy: typical",
    ),
    "marble": Material(
        Translucent(scattering_per_mm=2.62, absorption_per_mm=0.0041, eta=1.5, roughness=0.2),
        _JENSEN,
    ),
    "skin": Material(
        Translucent(scattering_per_mm=1.59, absorption_per_mm=0.070, eta=1.3, roughness=0.4),
        _JENSEN + "; its skin2",
    ),
    "skim-milk": Material(
        Translucent(scattering_per_mm=1.22, absorption_per_mm=0.0025, eta=1.3, roughness=0.05),
        _JENSEN,
    ),
    "wax": Material(
        Translucent(scattering_per_mm=1.5, absorption_per_mm=0.002, eta=1.44, roughness=0.3),
        _OURS + "paraffin",
    ),
    "pa12": Material(
        Translucent(scattering_per_mm=6.0, absorption_per_mm=0.01, eta=1.52, roughness=0.6),
        _OURS + "polyamide; a sintered part as it is built",
    ),
    "pom": Material(
        Translucent(scattering_per_mm=3.0, absorption_per_mm=0.003, eta=1.48, roughness=0.3),
        _OURS + "polyoxymethylene, natural white",
    ),
    "glass": Material(Dielectric(eta=1.519), "n at 546 nm of Schott's N-BK7"),
    "dark-stage": Material(Diffuse(albedo=0.3), "Lambertian grey of ours"),
}
