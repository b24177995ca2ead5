"""``thinlens_projector``: a Mitsuba emitter that projects a picture through a real lens.

Mitsuba's own ``projector`` is a pinhole and cannot defocus.  This one has an aperture, a
focus distance, OpenCV's distortion, a tilted panel (Scheimpflug) and a telecentric mode,
and works in any Mitsuba scene and under any stock integrator::

    {
        "type": "thinlens_projector",
        "irradiance": {"type": "bitmap", "bitmap": ..., "raw": True, "filter_type": "nearest"},
        "to_world": ...,          # as for Mitsuba's projector: x left, y up, z forward
        "fov": 20.0,              # horizontal, degrees; or focal_length and pixel_pitch
        "aperture_radius": 2.0,   # scene units; 0 is a pinhole
        "focus_distance": 800.0,
        "scale": 1.0,             # radiant intensity on the axis of a white panel
    }

Further parameters: ``pixel_pitch_y``, ``principal_point_u``, ``principal_point_v`` (pixels,
OpenCV convention), ``k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4``, ``tilt_x tilt_y`` (rad),
``telecentric``, ``natural_vignetting`` (cos^4; default true), ``diffraction_wavelength`` (nm with
millimetres as scene units; 0: geometric optics), ``blur`` (standard deviation, pixels),
``all_in_focus``.

**Radiometry.**  The lens is small: seen from a surface point it is one direction, and each
sample of its area carries the radiance of one panel position.  With natural vignetting a
surface facing the light at distance ``r`` receives ``scale cos(theta) / r^2``; without it the
irradiance on planes that face the projector is uniform, as for Mitsuba's ``projector``, which
differs by a factor of pi: its ``scale`` is ours over pi.

A DMD pixel is a square, hence ``filter_type = nearest``.
"""

from __future__ import annotations

from typing import Any

from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.optics import (
    PanelOptics,
    device_from_properties,
    device_to_world,
    opaque,
)


class ThinLensProjector(mi.Emitter):
    """See the module's text."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.irradiance = props.get_emissive_texture("irradiance", 1.0)
        self.scale = opaque(props.get("scale", 1.0))
        size = self.irradiance.resolution()
        self.optics = PanelOptics(device_from_properties(props, [size.x, size.y]))
        self.to_world = device_to_world(props)
        # The lens cannot be hit by a BSDF sample.  Without this flag multiple-importance
        # weights lose energy; Mitsuba wants a plain int.
        self.m_flags = int(mi.EmitterFlags.DeltaPosition)
        self.m_needs_sample_3 = self.optics.needs_lens_sample

    def traverse(self, callback: Any) -> None:
        """Expose scale and picture to ``mi.traverse``."""
        super().traverse(callback)
        callback.put("scale", self.scale, mi.ParamFlags.Differentiable)
        callback.put("irradiance", self.irradiance, mi.ParamFlags.Differentiable)

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: Any = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample the lens and look the picture up where the light comes from."""
        point = self.to_world.inverse() @ it.p
        place = self.optics.disk(sample)
        origin, falloff, valid = self.optics.source(point, place)
        pixel = self.optics.panel(point, place)
        pixel += self.optics.spread_beyond(place, self.optics.circle(point))
        active &= valid & self.optics.inside(pixel)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = self.to_world @ origin
        ds.n = self.to_world @ mi.Vector3f(0, 0, 1)
        ds.uv = mi.Point2f((pixel + 0.5) / self.optics.size)
        ds.time = it.time
        ds.pdf = dr.select(active, 1.0, 0.0)
        ds.delta = mi.Bool(True)
        ds.emitter = mi.EmitterPtr(self)
        ds.d = ds.p - it.p
        ds.dist = dr.norm(ds.d)
        ds.d /= ds.dist
        return ds, self._value(it, ds.uv, active) * falloff & active

    def _value(self, it: mi.Interaction3f, uv: mi.Point2f, active: Any) -> mi.Spectrum:
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.uv = uv
        si.wavelengths = it.wavelengths
        return self.irradiance.eval(si, active) * self.scale

    def eval_direction(
        self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: Any = True
    ) -> mi.Spectrum:
        """Return the radiance over the (unit) density of a sampled direction."""
        point = self.to_world.inverse() @ it.p
        toward = mi.Vector3f(point - self.to_world.inverse() @ ds.p)
        if self.optics.telecentric:
            falloff = dr.norm(toward) / toward.z / dr.square(self.optics.focus_distance)
        elif self.optics.device.lens.natural_vignetting:
            falloff = toward.z * dr.rcp(dr.norm(toward) * dr.squared_norm(toward))
        else:
            falloff = dr.norm(toward) * dr.rcp(dr.square(toward.z) * toward.z)
        return self._value(it, ds.uv, active) * falloff & active

    def pdf_direction(
        self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: Any = True
    ) -> mi.Float:
        """Zero: no other strategy can sample the lens."""
        return mi.Float(0.0)

    def eval(self, si: mi.SurfaceInteraction3f, active: Any = True) -> mi.Spectrum:
        """Zero: rays do not meet the lens."""
        return mi.Spectrum(0.0)

    def sample_ray(
        self,
        time: mi.Float,
        wavelength_sample: mi.Float,
        spatial_sample: mi.Point2f,
        direction_sample: mi.Point2f,
        active: Any = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Emit a ray (for particle tracers): panel position uniform, lens uniform."""
        pixel = mi.Point2f(direction_sample * self.optics.size - 0.5)
        origin, direction = self.optics.ray(pixel, self.optics.disk(spatial_sample))
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.uv = mi.Point2f(direction_sample)
        wavelengths, weight = self.sample_wavelengths(si, wavelength_sample, active)
        # Uniform over the panel: flux is intensity times the panel's area at unit distance.
        weight *= self.optics.area(pixel) * self.optics.size.x * self.optics.size.y
        if self.optics.device.lens.natural_vignetting and not self.optics.telecentric:
            weight *= dr.square(dr.square(direction.z))
        ray = mi.Ray3f(self.to_world @ origin, self.to_world @ direction, time, wavelengths)
        return ray, weight & active

    def sample_wavelengths(
        self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: Any = True
    ) -> tuple[Any, mi.Spectrum]:
        """Sample wavelengths by the picture's spectrum at `si.uv`."""
        shifted = mi.sample_shifted(sample) if mi.is_spectral else mi.Color0f()
        wavelengths, weight = self.irradiance.sample_spectrum(si, shifted, active)
        return wavelengths, weight * self.scale

    def sample_position(
        self, time: mi.Float, sample: mi.Point2f, active: Any = True
    ) -> tuple[mi.PositionSample3f, mi.Float]:
        """Return the lens centre."""
        ps = dr.zeros(mi.PositionSample3f)
        ps.p = self.to_world @ mi.Point3f(0, 0, 0)
        ps.n = self.to_world @ mi.Normal3f(0, 0, 1)
        ps.uv = mi.Point2f(0.5)
        ps.time = time
        ps.pdf = 1.0
        ps.delta = mi.Bool(True)
        return ps, mi.Float(1.0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        """Return an invalid box: the lens occupies no region of space."""
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        """Describe the projector."""
        return f"ThinLensProjector[{self.optics.device}]"
