"""Materials that light gets into: translucent ones and clear glass."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import field_validator

from slbench.core.validation.types import FINITE, Fraction, Interval
from slbench.scene.surfaces.bsdfs import Bsdf, grey
from slbench.scene.surfaces.interiors import Interior
from slbench.scene.surfaces.textures import Normals

#: Coefficients of media: mean free paths from 1 um to 10 m.
Scattering = Annotated[float, FINITE, Interval(ge=1e-4, le=1e3)]
Absorption = Annotated[float, FINITE, Interval(ge=0.0, le=1e3)]


class Translucent(Bsdf):
    """Marble, wax, plastic, skin: light enters, is scattered about inside and comes out elsewhere.

    The surface reflects as a rough dielectric; what it lets in is refracted by the faces, as at a
    smooth one, and followed by a random walk.  The object must be closed.

    Parameters
    ----------
    scattering_per_mm : float
        Scattering coefficient.  Tables often give the reduced one, which goes with ``g = 0``.
    absorption_per_mm : float
        Absorption coefficient.
    g : float
        Mean cosine of the scattering angle: 0 is isotropic, above 0 forward.
    eta : float
        Refractive index; at 1 nothing is reflected or refracted at the boundary.
    roughness : float
        GGX ``alpha`` of the surface's gloss.
    """

    scattering_per_mm: Scattering = 2.0
    absorption_per_mm: Absorption = 0.01
    g: Annotated[float, FINITE, Interval(gt=-1.0, lt=1.0)] = 0.0
    eta: Annotated[float, FINITE, Interval(ge=1.0, le=4.0)] = 1.5
    roughness: Fraction = 0.3

    @property
    def interior(self) -> Interior:
        """The medium inside."""
        return Interior(self.eta, self.scattering_per_mm, self.absorption_per_mm, self.g)

    def mitsuba(self) -> dict[str, Any]:
        """Return what the surface itself reflects: Mitsuba's ``roughplastic`` of a black base."""
        if self.eta == 1.0:
            return {"type": "diffuse", "reflectance": grey(0.0)}
        return {
            "type": "roughplastic",
            "distribution": "ggx",
            "alpha": self.roughness,
            "int_ior": self.eta,
            "diffuse_reflectance": grey(0.0),
        }


class Dielectric(Bsdf):
    """Clear glass: a mirror by Fresnel's equations, and what lies behind, refracted.

    The projector's light passes it straight, each face taking its reflectance.  It is refracted by
    the mesh's faces, whatever normals these are shaded with.  The object must be closed.

    Parameters
    ----------
    eta : float
        Refractive index.
    """

    eta: Annotated[float, FINITE, Interval(gt=1.0, le=4.0)] = 1.5

    @field_validator("normal_map")
    @classmethod
    def _by_faces(cls, given: Normals) -> Normals:
        if given is not None:
            raise ValueError("none: faces refract glass, relief is in the mesh")
        return given

    @property
    def interior(self) -> Interior:
        """The glass."""
        return Interior(self.eta)

    def mitsuba(self) -> dict[str, Any]:
        """Return Mitsuba's ``dielectric``."""
        return {"type": "dielectric", "int_ior": self.eta, "ext_ior": 1.0}
