"""The lens model of :class:`slbench.rig.Device` in Dr.Jit: one model for every use.

The projector emitter, the camera plugin and the light transport tracer all use the functions
here, so they cannot disagree:

* :meth:`PanelOptics.ray`: pixel and place on the lens -> ray (a camera looks);
* :meth:`PanelOptics.panel`: surface point and place on the lens -> pixel (a projector shines):
  follow the ray from the point through the lens to the plane in focus, from there through the
  lens centre to the panel; :meth:`PanelOptics.source` says how strong that light is;
* :meth:`PanelOptics.spread_beyond`: what diffraction and blur add to a ray's end on the panel;
* :meth:`PanelOptics.footprint`: all of the panel that lights a point, instead of one ray of it.

Coordinates are the device frame's (x right, y down, z forward), pixels OpenCV's.  All numbers
are opaque to the compiler, so that another rig reuses the compiled kernel; only *which* terms
exist (distortion, tilt, aperture) is fixed when a kernel is traced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slbench.rig import Device, Lens
from slbench.rig.coefficients import COEFFICIENTS, distorted
from slbench.rig.optics.distortion import distort, fold_radius
from slbench.rig.optics.spread import RING_SOFTENING
from slbench.simulate.render.mitsuba import dr, mi

#: Newton steps of the undistortion, which is quadratic: few do for ordinary lenses, those that bend
#: both ways within the field take as many as twice that.  Two numbers, so that kernels are reused.
_FEW_STEPS, _MANY_STEPS = 6, 12
#: Places along a panel's sides where it is seen which, and what a ray may miss there.
_PLACES, _MISS = 33, 1e-6
#: The least determinant of a Jacobian that a step divides by.
_LEAST_DETERMINANT = 1e-6


def opaque(value: float) -> Any:
    """Return a Dr.Jit float that is not compiled into kernels as a constant."""
    return dr.opaque(mi.Float, float(value))


@dataclass
class PanelOptics:
    """Lens and panel of one device; see the module's text.

    Attributes are opaque Dr.Jit floats, or None for terms that do not exist.
    """

    device: Device

    def __post_init__(self) -> None:
        device, lens = self.device, self.device.lens
        c = lens.focal_length_mm
        self.telecentric = lens.kind == "telecentric"
        self.focal = mi.Vector2f(*(opaque(c / p) for p in device.pitch_mm))
        self.centre = mi.Point2f(*(opaque(x) for x in device.centre))
        self.size = mi.Vector2f(opaque(device.width), opaque(device.height))
        self.focus = mi.Vector3f(*(opaque(n) for n in device.focus_plane))
        self.focus_distance = opaque(lens.focus_distance_mm)
        self.aperture = opaque(lens.defocusing_radius_mm) if lens.defocusing_radius_mm > 0 else None
        self.distortion = [opaque(k) for k in device.distortion] if any(device.distortion) else None
        self.steps = _newton_steps(device) if any(device.distortion) else 0
        fold = fold_radius(device.distortion)
        self.fold = opaque(fold) if np.isfinite(fold) else None
        self.aspect = opaque(device.pitch_mm[0] / device.pitch_mm[1])
        self.rings: tuple[Any, int, int, Any] | None = None
        if device.spread.diffraction_px > 0 or device.spread.blur_px > 0:
            values, edge = device.spread.rings()
            self.rings = (mi.Float(values.ravel()), *values.shape, opaque(edge))
        self.tilt = self.untilt = None
        if any(device.tilt_rad):
            homography = device.tilt_homography
            self.tilt = [opaque(float(h)) for h in homography.ravel()]
            self.untilt = [opaque(float(h)) for h in np.linalg.inv(homography).ravel()]

    @property
    def needs_lens_sample(self) -> bool:
        """Whether the light of a point spreads, by the aperture or by blur."""
        return self.aperture is not None or self.rings is not None

    # -- panel <-> normalised coordinates ----------------------------------------------

    def _to_pixel(self, xy: mi.Point2f) -> mi.Point2f:
        if self.fold is not None:
            xy = dr.select(dr.squared_norm(xy) < dr.square(self.fold), xy, dr.nan)
        if self.distortion is not None:
            xy = mi.Point2f(*distorted(xy.x, xy.y, self.distortion)[:2])
        if self.tilt is not None:
            xy = _homography(xy, self.tilt)
        return mi.Point2f(self.focal * xy + self.centre)

    def _from_pixel(self, pixel: mi.Point2f) -> mi.Point2f:
        xy = mi.Point2f((pixel - self.centre) / self.focal)
        if self.untilt is not None:
            xy = _homography(xy, self.untilt)
        if self.distortion is not None:
            xy = self._undistorted(xy)
        return xy

    def _undistorted(self, target: mi.Point2f) -> mi.Point2f:
        """Invert distortion as `slbench.rig.kernels.undistorted` does, without branches."""
        xy = mi.Point2f(target)
        best, least = mi.Point2f(0.0), dr.maximum(dr.abs(target.x), dr.abs(target.y))
        for _ in range(self.steps):
            if self.fold is not None:
                far = dr.squared_norm(xy) >= dr.square(self.fold)
                half_way = 0.5 * (dr.norm(best) + self.fold) * dr.rsqrt(dr.squared_norm(xy))
                xy = dr.select(far, xy * half_way, xy)
            at_x, at_y, a, b, c, d = distorted(xy.x, xy.y, self.distortion)
            x, y = at_x - target.x, at_y - target.y
            residual = dr.maximum(dr.abs(x), dr.abs(y))
            scale = dr.rcp(dr.maximum(a * d - b * c, _LEAST_DETERMINANT))
            step = mi.Point2f(xy.x - (d * x - b * y) * scale, xy.y - (a * y - c * x) * scale)
            worse = residual > least
            step = dr.select(worse, 0.5 * (xy + best), step)
            best, least = dr.select(worse, best, xy), dr.minimum(residual, least)
            xy = step
        return xy

    def area(self, pixel: mi.Point2f) -> mi.Float:
        """Return one pixel's area in the plane at unit distance (undistorted coordinates)."""
        scale = self.focal.x * self.focal.y
        xy = self._from_pixel(pixel)
        if self.distortion is not None:
            at_x, at_y, a, b, c, d = distorted(xy.x, xy.y, self.distortion)
            xy = mi.Point2f(at_x, at_y)
            scale *= a * d - b * c
        if self.tilt is not None:
            h = self.tilt
            determinant = (
                h[0] * (h[4] * h[8] - h[5] * h[7])
                - h[1] * (h[3] * h[8] - h[5] * h[6])
                + h[2] * (h[3] * h[7] - h[4] * h[6])
            )
            scale *= determinant / (h[6] * xy.x + h[7] * xy.y + h[8]) ** 3
        return dr.rcp(scale)

    def reached(self, pixel: mi.Point2f) -> mi.Bool:
        """Return whether a position is one: it is NaN beyond the fold of the distortion."""
        return mi.Bool(True) if self.fold is None else dr.isfinite(pixel.x)

    def inside(self, pixel: mi.Point2f) -> mi.Bool:
        """Return whether a pixel position lies on the panel."""
        return (
            (pixel.x >= -0.5)
            & (pixel.y >= -0.5)
            & (pixel.x < self.size.x - 0.5)
            & (pixel.y < self.size.y - 0.5)
        )

    def disk(self, sample: mi.Point2f) -> mi.Point2f:
        """Return a point of the unit disc for a sample, uniform in [0, 1)^2."""
        return mi.warp.square_to_uniform_disk_concentric(sample)

    def _lens(self, place: mi.Point2f) -> mi.Point2f:
        """Return a point of the pupil for a place on the unit disc, mm."""
        return mi.Point2f(0.0) if self.aperture is None else place * self.aperture

    def circle(self, point: mi.Point3f) -> mi.Float:
        """Return the signed radius of the circle of confusion of a point, px along u.

        See :meth:`slbench.rig.Device.circle_of_confusion`, which is twice its magnitude.
        """
        if self.aperture is None:
            return mi.Float(0.0)
        depth = self.focus_distance if self.telecentric else point.z
        return self.aperture * self.focal.x * (1.0 - dr.dot(self.focus, point)) / depth

    def spread_beyond(self, place: mi.Point2f, circle: mi.Float) -> mi.Vector2f:
        """Return how far diffraction and blur move a ray's end on the panel, px.

        A ray through a place of the unit disc carries the share of the light within it.  With
        defocus alone it ends at that place of the circle of confusion; with diffraction and blur
        where the spread holds that share (:meth:`slbench.rig.optics.spread.Spread.rings`).  The
        difference, so that ends have the spread's density whatever the depth.

        Parameters
        ----------
        place : on the unit disc
        circle : signed radius of the circle of confusion, px along u
        """
        if self.rings is None:
            return mi.Vector2f(0.0)
        values, rows, places, edge = self.rings
        radius = dr.abs(circle)
        reach = radius + edge
        rank2 = dr.minimum(dr.squared_norm(place), 1.0)
        rank = dr.sqrt(rank2)
        row = mi.UInt32(radius / reach * (rows - 1) + 0.5)
        at = rank * (places - 1)
        left = dr.minimum(mi.UInt32(at), places - 2)
        index = row * places + left
        low, high = dr.gather(mi.Float, values, index), dr.gather(mi.Float, values, index + 1)
        ring = dr.lerp(low, high, at - mi.Float(left)) * reach / (1.0 - rank2 + RING_SOFTENING)
        step = (ring - radius * rank) / dr.maximum(rank, 1e-6)
        step = dr.select(circle < 0, -step, step)
        return mi.Vector2f(step * place.x, step * place.y * self.aspect)

    # -- the two directions --------------------------------------------------------------

    def ray(self, pixel: mi.Point2f, place: mi.Point2f) -> tuple[mi.Point3f, mi.Vector3f]:
        """Return origin and unit direction of the ray that a pixel position looks along.

        Parameters
        ----------
        pixel : position on the panel (u, v)
        place : on the unit disc, which the pupil fills
        """
        xy = self._from_pixel(pixel)
        disk = self._lens(place)
        n = self.focus
        if self.telecentric:
            chief = mi.Point2f(xy * self.focus_distance)
            depth = (1.0 - n.x * chief.x - n.y * chief.y) / n.z
            cone = mi.Vector2f(disk / self.focus_distance)
            origin = mi.Point3f(chief.x + cone.x * depth, chief.y + cone.y * depth, 0.0)
            return origin, dr.normalize(mi.Vector3f(-cone.x, -cone.y, 1.0))
        origin = mi.Point3f(disk.x, disk.y, 0.0)
        direction = mi.Vector3f(xy.x, xy.y, 1.0)
        if self.aperture is not None:
            # Through the point in focus, d / (n . d), written so that focus at infinity works.
            direction -= mi.Vector3f(origin) * dr.dot(n, direction)
        return origin, dr.normalize(direction)

    def panel(self, point: mi.Point3f, place: mi.Point2f) -> mi.Point2f:
        """Return the panel position that lights a point through a place of the lens.

        Parameters
        ----------
        point : surface point in the device frame
        place : on the unit disc, which the pupil fills
        """
        disk = self._lens(place)
        n = self.focus
        if self.telecentric:
            cone = mi.Vector3f(disk.x / self.focus_distance, disk.y / self.focus_distance, 1.0)
            step = (1.0 - dr.dot(n, point)) / dr.dot(n, cone)
            xy = mi.Point2f(
                (point.x + step * cone.x) / self.focus_distance,
                (point.y + step * cone.y) / self.focus_distance,
            )
            return self._to_pixel(xy)
        toward = mi.Vector3f(point.x - disk.x, point.y - disk.y, point.z)
        if self.aperture is None:
            focused = toward
        else:
            # The point in focus, scaled by n . toward: see `ray`.
            gap = 1.0 - n.x * disk.x - n.y * disk.y
            focused = mi.Vector3f(disk.x, disk.y, 0.0) * dr.dot(n, toward) + toward * gap
        xy = mi.Point2f(focused.x / focused.z, focused.y / focused.z)
        return self._to_pixel(xy)

    def source(self, point: mi.Point3f, place: mi.Point2f) -> tuple[mi.Point3f, mi.Float, mi.Bool]:
        """Return where on the lens the light of a point comes from, and how strong it is.

        Parameters
        ----------
        point : surface point in the device frame
        place : on the unit disc, which the pupil fills

        Returns
        -------
        origin : point on the lens (device frame) the light comes from
        falloff : irradiance on a surface that faces the light, for unit axial intensity
        valid : whether the point is in front of the lens
        """
        disk = self._lens(place)
        if self.telecentric:
            cone = mi.Vector3f(disk.x / self.focus_distance, disk.y / self.focus_distance, 1.0)
            origin = mi.Point3f(point - point.z * cone)
            # Parallel light: as strong everywhere as it is in focus on the axis.
            return origin, dr.norm(cone) / dr.square(self.focus_distance), point.z > 0
        origin = mi.Point3f(disk.x, disk.y, 0.0)
        toward = mi.Vector3f(point - origin)
        distance2 = dr.squared_norm(toward)
        cosine = toward.z * dr.rsqrt(distance2)
        if self.device.lens.natural_vignetting:
            falloff = cosine / distance2
        else:
            # Uniform irradiance on planes that face the projector, as Mitsuba's own.
            falloff = dr.rcp(dr.square(toward.z) * cosine)
        return origin, falloff, point.z > 0

    def footprint(self, point: mi.Point3f) -> tuple[mi.Point2f, mi.Vector2f, mi.Vector2f]:
        """Return what lights a point: panel position of the chief ray, and the disc around it.

        Returns
        -------
        chief : panel position through the middle of the lens
        along_x, along_y : panel vectors from there to positions through the disc's rim at (1, 0)
            and (0, 1); small discs are ellipses that these two span
        """
        chief = self.panel(point, mi.Point2f(0.0))
        if self.aperture is None:
            return chief, mi.Vector2f(0.0), mi.Vector2f(0.0)
        if self.distortion is None and self.tilt is None:
            circle = self.circle(point)
            return chief, mi.Vector2f(circle, 0.0), mi.Vector2f(0.0, circle * self.aspect)
        right = self.panel(point, mi.Point2f(1.0, 0.0))
        down = self.panel(point, mi.Point2f(0.0, 1.0))
        return chief, mi.Vector2f(right - chief), mi.Vector2f(down - chief)


def _homography(xy: mi.Point2f, h: Sequence[Any]) -> mi.Point2f:
    w = dr.rcp(h[6] * xy.x + h[7] * xy.y + h[8])
    return mi.Point2f(
        (h[0] * xy.x + h[1] * xy.y + h[2]) * w, (h[3] * xy.x + h[4] * xy.y + h[5]) * w
    )


def _newton_steps(device: Device) -> int:
    """Return how many steps of the undistortion reach single precision all over a panel."""
    sides = (np.linspace(-0.5, size - 0.5, _PLACES) for size in (device.width, device.height))
    exact = device.normalise(np.stack(np.meshgrid(*sides), axis=-1))
    exact = exact[np.isfinite(exact[..., 0])]
    target_x, target_y = distort(exact, device.distortion)[0].T
    x, y = target_x, target_y
    with np.errstate(all="ignore"):
        for _ in range(_FEW_STEPS):
            at_x, at_y, a, b, c, d = distorted(x, y, device.distortion)
            by_x, by_y = at_x - target_x, at_y - target_y
            determinant = a * d - b * c
            x = x - (d * by_x - b * by_y) / determinant
            y = y - (a * by_y - c * by_x) / determinant
        missed = np.abs(np.column_stack((x, y)) - exact) > _MISS * (1.0 + np.abs(exact))
        few = np.isfinite(x).all() and not missed.any()
    return _FEW_STEPS if few else _MANY_STEPS


def device_to_world(props: mi.Properties) -> mi.AffineTransform4f:
    """Return a plugin's transform from *our* device axes to the world.

    Mitsuba's ``to_world`` has x left and y up; ours x right and y down: a turn by pi about z.
    """
    matrix = np.eye(4)
    if "to_world" in props:
        matrix = np.array(props["to_world"].matrix, dtype=np.float64)
    return opaque_transform(matrix @ np.diag([-1.0, -1.0, 1.0, 1.0]))


def opaque_transform(matrix: np.ndarray) -> mi.AffineTransform4f:
    """Return a (4, 4) matrix as a transform that is not compiled into kernels."""
    transform = mi.AffineTransform4f(mi.Matrix4f(matrix.tolist()))
    dr.make_opaque(transform)
    return transform


def device_from_properties(props: mi.Properties, size: Sequence[int]) -> Device:
    """Read a plugin's optical parameters (see render/projector.py) into a device at rest.

    Lengths are in scene units; the pitch matters for the tilted plane in focus alone.
    """
    width, height = (int(n) for n in size)
    pitch = float(props.get("pixel_pitch", 0.01))
    if "focal_length" in props:
        focal = float(props["focal_length"])
    else:
        fov = np.deg2rad(float(props.get("fov", 45.0)))
        focal = width * pitch / (2.0 * np.tan(fov / 2.0))
    focus = float(props.get("focus_distance", np.inf))
    kind = "telecentric" if props.get("telecentric", False) else "perspective"
    lens = Lens(
        focal,
        float(props.get("aperture_radius", 0.0)),
        focus,
        kind,  # type: ignore[arg-type]  # one of the two by construction
        bool(props.get("natural_vignetting", True)),
        float(props.get("diffraction_wavelength", 0.0)),
        bool(props.get("all_in_focus", False)),
    )
    return Device(
        width=width,
        height=height,
        pitch_mm=(pitch, float(props.get("pixel_pitch_y", pitch))),
        lens=lens,
        principal_point=(
            float(props.get("principal_point_u", (width - 1) / 2.0)),
            float(props.get("principal_point_v", (height - 1) / 2.0)),
        ),
        distortion=tuple(float(props.get(name, 0.0)) for name in COEFFICIENTS),
        tilt_rad=(float(props.get("tilt_x", 0.0)), float(props.get("tilt_y", 0.0))),
        blur_px=float(props.get("blur", 0.0)),
    )


def properties_from_device(device: Device) -> dict[str, Any]:
    """Return the plugin parameters that :func:`device_from_properties` reads back."""
    lens = device.lens
    result: dict[str, Any] = {
        "focal_length": lens.focal_length_mm,
        "pixel_pitch": device.pitch_mm[0],
        "pixel_pitch_y": device.pitch_mm[1],
        "principal_point_u": device.centre[0],
        "principal_point_v": device.centre[1],
        "aperture_radius": lens.aperture_radius_mm,
        "natural_vignetting": lens.natural_vignetting,
        "telecentric": lens.kind == "telecentric",
        "all_in_focus": lens.all_in_focus,
        "diffraction_wavelength": lens.wavelength_nm,
        "blur": device.blur_px,
        "tilt_x": device.tilt_rad[0],
        "tilt_y": device.tilt_rad[1],
    }
    if np.isfinite(lens.focus_distance_mm):
        result["focus_distance"] = lens.focus_distance_mm
    return result | dict(zip(COEFFICIENTS, device.distortion, strict=False))
