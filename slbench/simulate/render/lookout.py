"""Points of a surface as the devices of a rig see and light them, without pixels.

What a view of a part would measure is asked of many rigs, one after the other
(:mod:`slbench.design.views`).  A point is seen where its way to the lens centre is free; its
radiance is what its BSDF makes of the projector's direct light, taken through the middle of the
lens.  Light that came by other surfaces, and light from inside, are left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.rig import Device, Rig
from slbench.scene.model import SceneObject
from slbench.simulate.render.interiors import Lamp
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.translate import geometry
from slbench.simulate.render.ways import columns, free_view

Array = NDArray[np.float64]

#: How far above a point the ray starts that finds its face, of its largest coordinate plus 1 mm.
_ABOVE = 1e-4
#: Directions by which the albedo is found.
_DIRECTIONS = 64


class Lookout:
    """Points of objects, ready to be looked at by one rig after the other.

    Parameters
    ----------
    objects : tuple of SceneObject
    points, normals : (N, 3) float
        On their surface, in the world, mm; the normals are those of the faces.

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    """

    def __init__(self, objects: tuple[SceneObject, ...], points: Array, normals: Array) -> None:
        self.points, self.normals = points, normals
        self._geometry = geometry(objects)
        scale = 1.0 + np.max(np.abs(points), axis=1, keepdims=True)
        start = points + _ABOVE * scale * normals
        ray = mi.RayDifferential3f(
            mi.Ray3f(mi.Point3f(columns(start)), mi.Vector3f(columns(-normals)))
        )
        self._found: Any = self._geometry.ray_intersect(ray)
        dr.eval(self._found)

    def seen_by(self, device: Device, asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask (N,) of the points asked for that the device's lens has a free view of."""
        found = asked.copy()
        points, normals = self.points[asked], self.normals[asked]
        all_of_them = np.ones(len(points), np.bool_)
        found[asked] = free_view(self._geometry, device, points, normals, all_of_them)
        return found

    def radiance(self, rig: Rig) -> Array:
        """Return the radiance of the points towards the camera under a fully lit panel, (N,).

        W / (mm^2 sr), shadows and the camera's fall-off left out.
        """
        si, lamp = self._found, Lamp(rig.projector)
        self._look(rig.camera.chief_origin(self.points))
        source, fall_off, valid = lamp.source(si.p, mi.Point2f(0.0))
        active = si.is_valid() & valid
        toward = si.to_local(dr.normalize(source - si.p))
        value = si.bsdf().eval(mi.BSDFContext(), si, toward, active)
        light = dr.select(active, value.x * fall_off * lamp.intensity, 0.0)
        return np.asarray(light.numpy(), dtype=np.float64)

    def albedo(self) -> Array:
        """Return the share of light from along the normals that the points reflect, (N,)."""
        si, context = self._found, mi.BSDFContext()
        si.wi = mi.Vector3f(0.0, 0.0, 1.0)
        total = mi.Float(0.0)
        root = int(np.sqrt(_DIRECTIONS))
        for k in range(_DIRECTIONS):
            place = mi.Point2f((k % root + 0.5) / root, (k // root + 0.5) / root)
            _, weight = si.bsdf().sample(context, si, mi.Float((k + 0.5) / _DIRECTIONS), place)
            total += weight.x
        return np.asarray((total / _DIRECTIONS).numpy(), dtype=np.float64)

    def _look(self, eye: Array) -> None:
        si = self._found
        si.wi = si.to_local(dr.normalize(mi.Point3f(columns(eye)) - si.p))
