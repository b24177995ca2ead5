"""``slbench_camera``: a Mitsuba sensor with aperture, distortion, sensor tilt, telecentricity.

Mitsuba's ``perspective`` and ``thinlens`` know neither distortion nor tilt.  Parameters are
those of ``thinlens_projector`` (render/projector.py) without the picture: ``fov`` or
``focal_length`` and ``pixel_pitch``, ``aperture_radius``, ``focus_distance``,
``principal_point_u/v``, OpenCV's ``k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4``, ``tilt_x tilt_y``,
``telecentric``; ``to_world`` in Mitsuba's convention (x left, y up, z forward); film and sampler as
for any sensor.

A spread by diffraction depends on the defocus of what is seen: ``geometry``, a Mitsuba scene of
the objects, tells the camera how far that is.  Without it everything diffracts as in focus.

As Mitsuba's own sensors it measures scene radiance: the lens's fall-off towards the corners
belongs to the detector's side (:meth:`slbench.rig.Device.relative_illumination`).
"""

from __future__ import annotations

from typing import Any

from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.optics import (
    PanelOptics,
    device_from_properties,
    device_to_world,
)


def seen_circle(optics: PanelOptics, to_world: Any, geometry: Any, pixel: mi.Point2f) -> mi.Float:
    """Return the signed radius of the circle of confusion of what a pixel position sees, px.

    Parameters
    ----------
    optics : PanelOptics
    to_world : transform from device to world coordinates
    geometry : mi.Scene
    pixel : position on the sensor, whose chief ray is followed
    """
    origin, direction = optics.ray(pixel, mi.Point2f(0.0))
    hit = geometry.ray_intersect_preliminary(mi.Ray3f(to_world @ origin, to_world @ direction))
    point = origin + direction * dr.select(hit.is_valid(), hit.t, 0.0)
    return dr.select(hit.is_valid(), optics.circle(point), 0.0)


def spread_ray(
    optics: PanelOptics, pixel: mi.Point2f, place: mi.Point2f, circle: mi.Float
) -> tuple[mi.Point3f, mi.Vector3f]:
    """Return the ray of a pixel position through a place of the lens, its spread included.

    Parameters
    ----------
    optics : PanelOptics
    pixel : position on the sensor
    place : on the unit disc, which the pupil fills
    circle : signed radius of the circle of confusion of what is seen, px

    Returns
    -------
    origin, direction : in device coordinates
    """
    return optics.ray(pixel + optics.spread_beyond(place, circle), place)


class SlbenchCamera(mi.Sensor):
    """See the module's text."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        size = self.film().size()
        self.optics = PanelOptics(device_from_properties(props, [size.x, size.y]))
        crop_size, crop_offset = self.film().crop_size(), self.film().crop_offset()
        self.crop_size = mi.Vector2f(crop_size.x, crop_size.y)
        self.crop_offset = mi.Vector2f(crop_offset.x, crop_offset.y)
        self.to_world = device_to_world(props)
        self.geometry = props.get("geometry", None)
        self.m_needs_sample_3 = self.optics.needs_lens_sample

    def _ray(self, position_sample: mi.Point2f, aperture_sample: mi.Point2f) -> tuple[Any, Any]:
        # Mitsuba's film has pixel corners at integers, we have centres there.
        pixel = mi.Point2f(position_sample * self.crop_size + self.crop_offset - 0.5)
        circle = mi.Float(0.0)
        if self.geometry is not None:
            circle = seen_circle(self.optics, self.to_world, self.geometry, pixel)
            # A kernel follows rays through one scene, and this is not the one that is rendered.
            dr.eval(circle)
        origin, direction = spread_ray(
            self.optics, pixel, self.optics.disk(aperture_sample), circle
        )
        return self.to_world @ origin, self.to_world @ direction

    def sample_ray(
        self,
        time: mi.Float,
        wavelength_sample: mi.Float,
        position_sample: mi.Point2f,
        aperture_sample: mi.Point2f,
        active: Any = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Sample a ray through a film position and an aperture position."""
        wavelengths, weight = self.sample_wavelengths(
            dr.zeros(mi.SurfaceInteraction3f), wavelength_sample, active
        )
        origin, direction = self._ray(position_sample, aperture_sample)
        return mi.Ray3f(origin, direction, time, wavelengths), weight

    def sample_ray_differential(
        self,
        time: mi.Float,
        wavelength_sample: mi.Float,
        position_sample: mi.Point2f,
        aperture_sample: mi.Point2f,
        active: Any = True,
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """Sample a ray and the rays one pixel right of and below it."""
        ray, weight = self.sample_ray(
            time, wavelength_sample, position_sample, aperture_sample, active
        )
        result = mi.RayDifferential3f(ray)
        step = dr.rcp(self.crop_size)
        result.o_x, result.d_x = self._ray(
            position_sample + mi.Vector2f(step.x, 0), aperture_sample
        )
        result.o_y, result.d_y = self._ray(
            position_sample + mi.Vector2f(0, step.y), aperture_sample
        )
        result.has_differentials = True
        return result, weight

    def bbox(self) -> mi.ScalarBoundingBox3f:
        """Return an invalid box: the sensor occupies no region of space."""
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        """Describe the camera."""
        return f"SlbenchCamera[{self.optics.device}]"
