"""Surfaces in several bands of light that are looked at along the same rays.

Where the projector's light is followed to its first surface alone, bands differ by what the surface
scatters towards the camera and by nothing else.  One ray then serves all: its weight is that of the
band that scatters most, and each band has its share of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slbench.scene.model import Light, SceneObject
from slbench.scene.surfaces.bsdfs import Bsdf, Diffuse, Principled, RoughConductor, RoughPlastic
from slbench.scene.surfaces.textures import OfVertices
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.translate import bsdf_dict, shape_indices, shapes

#: BSDFs that scatter at the surface, in the direction that they are asked for.
_PLAIN = (Diffuse, Principled, RoughConductor, RoughPlastic)


def together(objects: Sequence[SceneObject], light: Light) -> bool:
    """Return whether the bands of a scene may share rays."""
    if light.bounces or light.has_surroundings:
        return False
    bsdfs = [item.material_of(part).bsdf for item in objects for part in item.artefact.parts]
    return all(type(bsdf) in _PLAIN and not _at_vertices(bsdf) for bsdf in bsdfs)


def _at_vertices(bsdf: Bsdf) -> bool:
    """Return whether values stand at the vertices, of which a mesh has those of one band."""
    return any(isinstance(texture, OfVertices) for texture in bsdf.textures.values())


class Bands:
    """The BSDFs of each band.

    Parameters
    ----------
    objects : sequence of tuple of SceneObject
        Those of each band; they differ by their materials.
    geometry : mitsuba.Scene
        Of the first.
    """

    def __init__(self, objects: Sequence[tuple[SceneObject, ...]], geometry: Any) -> None:
        indices = shape_indices(geometry)
        self._kept = [
            [mi.load_dict(bsdf_dict(shape.material)) for shape in shapes(items)]
            for items in objects
        ]
        self._tables = []
        for bsdfs in self._kept:
            numbers = [_number(bsdf) for bsdf in bsdfs]
            table = np.zeros(max(indices) + 1, np.uint32)
            for shape, k in indices.items():
                table[shape] = numbers[k]
            self._tables.append(mi.UInt32(table))

    def at(self, si: Any, active: Any) -> Scattering:
        """Return what scatters at points."""
        shape = dr.reinterpret_array(mi.UInt32, si.shape)
        found = (dr.gather(mi.UInt32, table, shape, active) for table in self._tables)
        return Scattering([dr.reinterpret_array(mi.BSDFPtr, one) for one in found])


class Scattering:
    """Several BSDFs in the place of one: the largest value counts.

    Attributes
    ----------
    shares : list
        Of each in the largest value, once it was asked for.
    """

    def __init__(self, bsdfs: list[Any]) -> None:
        self._bsdfs = bsdfs
        self.shares: list[Any] = []

    def eval(self, *arguments: Any) -> Any:
        """Return the largest of the values."""
        values = [bsdf.eval(*arguments).x for bsdf in self._bsdfs]
        most = values[0]
        for value in values[1:]:
            most = dr.maximum(most, value)
        self.shares = [dr.select(most > 0, value / most, 0.0) for value in values]
        return mi.Spectrum(most)


def _number(bsdf: Any) -> int:
    """Return Dr.Jit's instance id."""
    return int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0])
