"""Cameras and projectors: one optical model for both.

A projector is an inverse camera, so :class:`Camera` and :class:`Projector` share
:class:`Device`: a panel of pixels (sensor or DMD) behind a lens, somewhere in the world.

Device frame: OpenCV's, x right, y down, z forward along the optical axis.  Pixels: integer
coordinates are pixel centres.  Lengths in mm, angles in rad.

**One formula for two lenses.**  With principal distance ``c`` and focus distance ``s`` a
perspective lens maps ``(X, Y, Z)`` to ``x = X / Z``; an object-space telecentric lens of
magnification ``m`` to ``x = X / s`` with ``c = m s``.  Everything after that (distortion,
tilt, pixel pitch) is common, and so is the plane in focus: a thin lens with its sensor turned
by ``R`` images sharply the plane ``n . X = 1`` with
``n = (-R31 / (c R33), -R32 / (c R33), 1 / s)`` (Scheimpflug), which follows from
``1/z + 1/z' = const`` along each chief ray.

``focal_length_mm`` is the principal distance, what a calibration sees (``fx * pitch``);
focusing does not change it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import length, numbers
from slbench.core.validation.types import (
    MAX_PIXELS,
    Angle,
    Barrel,
    Blur,
    Count,
    Distortion,
    Fraction,
    Measure,
    Pair,
    PanelBits,
    Pixels,
    Shading,
    Size,
)
from slbench.core.validation.values import Value, checked
from slbench.rig.coefficients import COEFFICIENTS, fewest
from slbench.rig.optics.distortion import (
    apply_homography,
    distort,
    fold_radius,
    tilt_matrix,
    tilt_rotation,
    undistort,
)
from slbench.rig.optics.lens import Lens
from slbench.rig.optics.response import Response, ResponseCurve
from slbench.rig.optics.shading import least_shading, shading
from slbench.rig.optics.spread import Spread
from slbench.rig.pose import Pose, box_corners, product

if TYPE_CHECKING:
    from slbench.rig.kernels import Optics

Array = NDArray[np.float64]

#: Points around a barrel's rim, for pictures.
_RIM = 48


@dataclass(frozen=True)
class Device(Value):
    """A panel of pixels behind a lens; see :class:`Camera` and :class:`Projector`.

    Parameters
    ----------
    width, height : int
        Pixels along u (right) and v (down).
    pitch_mm : (float, float)
        Pixel pitch along u and v.
    lens : Lens
    principal_point : (float, float) or None
        Pixel where the optical axis meets the panel; None is the panel's centre.
    distortion : (4,), (5,), (8,) or (12,) float
        OpenCV's ``k1, k2, p1, p2``, ``k3``, ``k4, k5, k6``, ``s1, s2, s3, s4``
        (:mod:`~slbench.rig.coefficients`); kept as 5, 8 or 12 numbers, the fewest that hold
        it.
    tilt_rad : (float, float)
        OpenCV's ``tauX, tauY``.
    blur_px : float
        Standard deviation of a Gaussian for what the lens blurs beyond defocus and
        diffraction, in pixels along u.
    pose : Pose
    body_mm : (float, float, float) or None
        Size of the housing along x, y, z, a box behind the nodal point with the optical axis
        through the middle of its front face; None is a device without a body.
    barrel_mm : sequence of (float, float) or None
        In the place of the box, a barrel turned about the optical axis: distances behind the
        nodal point, rising, with the radius there.  Between two it is the frustum of a cone.
    """

    width: Pixels
    height: Pixels
    pitch_mm: tuple[Measure, Measure]
    lens: Lens
    principal_point: Pair | None = None
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    tilt_rad: tuple[Angle, Angle] = (0.0, 0.0)
    pose: Pose = field(default_factory=Pose)
    body_mm: Size | None = None
    blur_px: Blur = 0.0
    barrel_mm: Barrel | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width * self.height > MAX_PIXELS:
            got = f"{self.width} x {self.height}"
            raise InputError("device: width, height", f"at most {MAX_PIXELS} pixels in all", got)
        if self.principal_point is None:
            centre = ((self.width - 1) / 2.0, (self.height - 1) / 2.0)
            object.__setattr__(self, "principal_point", centre)
        object.__setattr__(self, "distortion", fewest(self.distortion))
        if self.barrel_mm is not None:
            behind = [place for place, _ in self.barrel_mm]
            if any(a >= b for a, b in pairwise(behind)):
                raise InputError("device: barrel_mm", "distances that rise (mm)", behind)

    def __repr__(self) -> str:
        lens, pitch = self.lens, f"{1e3 * self.pitch_mm[0]:.4g}"
        if self.pitch_mm[1] != self.pitch_mm[0]:
            pitch += f" x {1e3 * self.pitch_mm[1]:.4g}"
        kind = "" if lens.kind == "perspective" else f"{lens.kind} "
        light = f" in {lens.wavelength_nm:g} nm" if lens.wavelength_nm else ""
        blur = f", blur {self.blur_px:.3g} px" if self.blur_px else ""
        return (
            f"<{type(self).__name__} {self.width} x {self.height} px of {pitch} µm, {kind}lens "
            f"{length(lens.focal_length_mm)} f/{lens.f_number:.3g}{light} in focus at "
            f"{length(lens.focus_distance_mm)}{blur}, at ({numbers(self.pose.position)}) mm>"
        )

    # -- the panel ---------------------------------------------------------------------

    @property
    def centre(self) -> tuple[float, float]:
        """Principal point (u, v) in pixels."""
        assert self.principal_point is not None  # set in __post_init__
        return self.principal_point

    @property
    def matrix(self) -> Array:
        """OpenCV's camera matrix K, (3, 3)."""
        c = self.lens.focal_length_mm
        (pu, pv), (u0, v0) = self.pitch_mm, self.centre
        return np.array([[c / pu, 0.0, u0], [0.0, c / pv, v0], [0.0, 0.0, 1.0]])

    @property
    def opencv_distortion(self) -> Array:
        """OpenCV's coefficient vector: 5, 8 or 12 numbers, or 14 where the sensor is tilted."""
        if not any(self.tilt_rad):
            return np.array(self.distortion)
        none = np.zeros(len(COEFFICIENTS) - len(self.distortion))
        return np.concatenate((self.distortion, none, self.tilt_rad))

    @property
    def tilt_homography(self) -> Array:
        """Homography from lens to sensor coordinates, (3, 3); identity without tilt."""
        return tilt_matrix(*self.tilt_rad, parallel=self.lens.kind == "telecentric")

    def pixel_grid(self) -> Array:
        """Return the pixel centres as (height, width, 2) float, ``[..., 0]`` being u."""
        v, u = np.mgrid[0 : self.height, 0 : self.width].astype(np.float64)
        return np.stack((u, v), axis=-1)

    def contains(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask of pixel coordinates (..., 2) on the panel, whose edges are at -1/2."""
        p = np.asarray(pixels, dtype=np.float64)
        inside = np.all(p >= -0.5, axis=-1)
        return inside & (p[..., 0] < self.width - 0.5) & (p[..., 1] < self.height - 0.5)

    def posed(self, pose: Pose) -> Self:
        """Return the same device elsewhere."""
        return replace(self, pose=pose)

    # -- geometry ----------------------------------------------------------------------

    @property
    def optics(self) -> Optics:
        """What compiled loops are told of the device (:mod:`slbench.rig.kernels`)."""
        from slbench.rig.kernels import Optics

        tilt = self.tilt_homography
        return Optics(
            centre=np.array(self.centre),
            per_unit=self.lens.focal_length_mm / np.array(self.pitch_mm),
            distortion=np.array(self.distortion),
            fold2=fold_radius(self.distortion) ** 2,
            tilt=tilt,
            untilt=np.linalg.inv(tilt).astype(np.float64),
            distorted=any(self.distortion),
            tilted=any(self.tilt_rad),
            telecentric=self.lens.kind == "telecentric",
            focus=float(self.lens.focus_distance_mm),
            rotation=np.ascontiguousarray(self.pose.rotation),
            position=np.ascontiguousarray(self.pose.position),
        )

    def project(self, points: ArrayLike) -> Array:
        """Project world points to pixels.

        Parameters
        ----------
        points : (..., 3) float
            World coordinates, mm.

        Returns
        -------
        (..., 2) float
            Pixels (u, v); NaN for points that are not in front of the device.
        """
        return self._project(points, want_jacobian=False)[0]

    def project_with_jacobian(self, points: ArrayLike) -> tuple[Array, Array]:
        """Project world points and differentiate.

        Returns
        -------
        pixels : (..., 2) float
        jacobian : (..., 2, 3) float
            Derivative of the pixel by the world point, px/mm.
        """
        pixels, jacobian = self._project(points, want_jacobian=True)
        assert jacobian is not None
        return pixels, jacobian

    def _project(self, points: ArrayLike, want_jacobian: bool) -> tuple[Array, Array | None]:
        local = self.pose.to_local(points)
        z = local[..., 2]
        telecentric = self.lens.kind == "telecentric"
        depth = np.full_like(z, self.lens.focus_distance_mm) if telecentric else z
        scale = 1.0 / np.where(z > 0, depth, np.nan)
        xy = local[..., :2] * scale[..., None]
        jacobian = None
        if want_jacobian:
            jacobian = np.zeros((*z.shape, 2, 3))
            jacobian[..., 0, 0] = jacobian[..., 1, 1] = scale
            if not telecentric:
                jacobian[..., :, 2] = -xy * scale[..., None]
        if any(self.distortion):
            xy, step = distort(xy, np.array(self.distortion))
            jacobian = None if jacobian is None else step @ jacobian
        if any(self.tilt_rad):
            xy, step = apply_homography(xy, self.tilt_homography)
            jacobian = None if jacobian is None else step @ jacobian
        per_unit = self.lens.focal_length_mm / np.array(self.pitch_mm)
        if jacobian is not None:
            jacobian = product(jacobian * per_unit[:, None], self.pose.rotation.T)
        return xy * per_unit + self.centre, jacobian

    def normalise(self, pixels: ArrayLike, tilt_rad: tuple[float, float] | None = None) -> Array:
        """Map pixels (..., 2) to undistorted, untilted normalised coordinates (..., 2).

        With `tilt_rad`, those of a sensor with that tilt in the place of its own.
        """
        per_unit = self.lens.focal_length_mm / np.array(self.pitch_mm)
        xy = (np.asarray(pixels, dtype=np.float64) - self.centre) / per_unit
        tilt = self.tilt_rad if tilt_rad is None else tilt_rad
        if any(tilt):
            homography = tilt_matrix(*tilt, parallel=self.lens.kind == "telecentric")
            xy, _ = apply_homography(xy, np.linalg.inv(homography).astype(np.float64))
        return undistort(xy, np.array(self.distortion))

    def unproject(self, pixels: ArrayLike) -> tuple[Array, Array]:
        """Return each pixel's chief ray.

        Parameters
        ----------
        pixels : (..., 2) float

        Returns
        -------
        origins : (..., 3) float
            World coordinates, mm: the nodal point, or for a telecentric lens the point of
            the chief ray in the plane of the nodal point.
        directions : (..., 3) float
            Unit vectors, away from the device.
        """
        xy = self.normalise(pixels)
        local = np.zeros((*xy.shape[:-1], 3))
        direction = np.zeros_like(local)
        direction[..., 2] = 1.0
        if self.lens.kind == "telecentric":
            local[..., :2] = xy * self.lens.focus_distance_mm
        else:
            direction[..., :2] = xy
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return self.pose.to_world(local), product(direction, self.pose.rotation.T)

    def chief_origin(self, points: ArrayLike) -> Array:
        """Return where the chief rays to world points (..., 3) pass the lens, (..., 3).

        The nodal point; for a telecentric lens the foot of the point on the plane of it.
        """
        local = self.pose.to_local(points)
        local[..., 2] = 0.0
        if self.lens.kind != "telecentric":
            local[..., :2] = 0.0
        return self.pose.to_world(local)

    # -- focus -------------------------------------------------------------------------

    @property
    def focus_plane(self) -> Array:
        """The plane in focus in the device frame: ``n`` with ``n . X = 1``, (3,), 1/mm."""
        r31, r32, r33 = tilt_rotation(*self.tilt_rad)[2]
        c = self.lens.focal_length_mm
        return np.array([-r31 / (c * r33), -r32 / (c * r33), 1.0 / self.lens.focus_distance_mm])

    @property
    def spread(self) -> Spread:
        """What the lens makes of a point, in pixels along u; the depth adds the circle."""
        return Spread(self.lens.diffraction_mm / self.pitch_mm[0], self.blur_px)

    def circle_of_confusion(self, points: ArrayLike) -> Array:
        """Return the diameter of the blur disc of world points, in pixels along u.

        Geometric optics of a thin lens: ``2 a c |n . X - 1| / Z``, which is the familiar
        ``2 a c |1/s - 1/Z|`` for an untilted sensor; a telecentric lens has ``s`` for ``Z``.
        The slight ellipticity on a tilted sensor is left out.

        Parameters
        ----------
        points : (..., 3) float
            World coordinates, mm.

        Returns
        -------
        (...) float
        """
        local = self.pose.to_local(points)
        depth = self.lens.focus_distance_mm if self.lens.kind == "telecentric" else local[..., 2]
        # n . X - 1 = Z (1/s - 1/Z) + tilt terms
        offset = np.abs((product(local, self.focus_plane) - 1.0) / depth)
        blur = 2.0 * self.lens.defocusing_radius_mm * self.lens.focal_length_mm * offset
        return blur / self.pitch_mm[0]

    def depth_of_field(self, circle_px: float = 1.0) -> tuple[float, float]:
        """Return the near and far limit of the depth of field on the axis.

        Parameters
        ----------
        circle_px : float
            Acceptable circle of confusion in pixels, of a lens without diffraction and blur; see
            :meth:`slbench.rig.optics.spread.Spread.circle`.

        Returns
        -------
        near, far : float
            Distances from the nodal point, mm; `far` is infinite beyond the hyperfocal
            distance, both are trivial (0, inf) for a pinhole.
        """
        a, c, s = (
            self.lens.defocusing_radius_mm,
            self.lens.focal_length_mm,
            self.lens.focus_distance_mm,
        )
        if a == 0:
            return 0.0, np.inf
        reach = self.spread.circle(circle_px) * self.pitch_mm[0] / (2.0 * a * c)
        if self.lens.kind == "telecentric":
            return max(0.0, s - reach * s * s), s + reach * s * s
        near = 1.0 / (1.0 / s + reach)
        return near, (1.0 / (1.0 / s - reach) if 1.0 / s > reach else np.inf)

    def frustum(self, near: float, far: float) -> Array:
        """Return the viewing frustum's corners (8, 3) in world coordinates.

        The four corners at depth `near`, then the four at `far`, each clockwise from the
        top left; the panel's edge is half a pixel outside the outermost pixel centres.
        """
        right, bottom = self.width - 0.5, self.height - 0.5
        corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
        xy = self.normalise(corners)
        if self.lens.kind == "telecentric":
            flat = xy * self.lens.focus_distance_mm
            local = [np.column_stack((flat, np.full(4, z))) for z in (near, far)]
        else:
            local = [np.column_stack((xy, np.ones(4))) * z for z in (near, far)]
        return self.pose.to_world(np.concatenate(local))

    @property
    def has_body(self) -> bool:
        """Whether the device has a housing: a box or a barrel."""
        return self.body_mm is not None or self.barrel_mm is not None

    @property
    def body_corners(self) -> Array:
        """The eight corners of the housing in the world, (8, 3); (0, 3) without a body.

        Of a barrel points around its rims, (m, 3), for pictures.
        """
        parts = self.body_parts
        return np.concatenate(parts) if parts else np.empty((0, 3))

    @property
    def body_parts(self) -> tuple[Array, ...]:
        """The housing's convex parts in the world, as points of their rims, (m, 3) each."""
        if self.barrel_mm is None and self.body_mm is not None:
            x, y, z = self.body_mm
            corners = box_corners((-x / 2, -y / 2, -z), (x / 2, y / 2, 0.0))
            return (self.pose.to_world(corners),)
        turn = 2.0 * np.pi * np.arange(_RIM) / _RIM
        rims = [
            np.column_stack((r * np.cos(turn), r * np.sin(turn), np.full(_RIM, -z)))
            for z, r in self.barrel_mm or ()
        ]
        return tuple(self.pose.to_world(np.concatenate(ends)) for ends in pairwise(rims))

    def in_body(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask of world points (..., 3) inside the housing."""
        local = self.pose.to_local(points)
        behind = -local[..., 2]
        if self.barrel_mm is None and self.body_mm is not None:
            x, y, z = self.body_mm
            inside = (np.abs(local[..., 0]) < x / 2) & (np.abs(local[..., 1]) < y / 2)
            return np.asarray(inside & (behind > 0) & (behind < z))
        if self.barrel_mm is None:
            return np.zeros(behind.shape, dtype=bool)
        places, radii = np.transpose(self.barrel_mm)
        radius = np.interp(behind, places, radii, left=0.0, right=0.0)
        return np.asarray(np.hypot(local[..., 0], local[..., 1]) < radius)

    def relative_illumination(self, pixels: ArrayLike) -> Array:
        """Return the lens's fall-off at pixels (..., 2): cos^4 of the field angle, or 1.

        NaN where pixels see nothing: beyond the fold of the distortion.
        """
        xy = self.normalise(pixels)
        if self.lens.kind == "telecentric" or not self.lens.natural_vignetting:
            return np.where(np.isnan(xy[..., 0]), np.nan, 1.0)
        return (1.0 + np.sum(xy * xy, axis=-1)) ** -2


@dataclass(frozen=True, repr=False)
class Camera(Device):
    """A camera; see :class:`Device`.

    Parameters
    ----------
    fill_factor : float
        Photosensitive share of a pixel's area, in (0, 1].
    shading : (m,) float
        Brightness over the picture beyond the lens's natural fall-off: coefficients of a polynomial
        of a degree up to 4, so 0, 2, 5, 9 or 14 of them (:mod:`slbench.rig.optics.shading`).

    Raises
    ------
    InputError
        For shading that is not positive all over the picture, or values outside their range.
    """

    fill_factor: Fraction = 1.0
    shading: Shading = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if (least := least_shading(self.shading)) <= 0.0:
            expected = "a brightness above 0 all over the picture"
            raise InputError("camera: shading", expected, f"{least:.3g} at its darkest")

    def relative_illumination(self, pixels: ArrayLike) -> Array:
        """Return the lens's fall-off at pixels (..., 2), its shading included."""
        own = super().relative_illumination(pixels)
        return own * shading(self.shading, pixels, (self.width, self.height))

    @property
    def etendue_mm2_sr(self) -> float:
        """Photon-collecting power of one pixel on the axis, mm^2 sr.

        Irradiance on the sensor is ``pi L / (4 N^2)`` for scene radiance ``L`` and image-side
        f-number ``N``; times the pixel's photosensitive area.

        Raises
        ------
        InputError
            For a pinhole, which lets no light through.
        """
        number = self.lens.f_number
        if not np.isfinite(number):
            raise InputError(
                "camera aperture",
                "an aperture (f_number) for an absolute exposure",
                "a pinhole",
            )
        area = np.pi / (4.0 * number**2) * self.pitch_mm[0] * self.pitch_mm[1]
        return float(area * self.fill_factor)

    @checked
    def coarser(self, divisor: Count) -> Self:
        """Return the camera with pixels of `divisor` times the pitch, the same instrument.

        A pixel keeps its electrons: of its area as much is photosensitive as before, so that its
        exposure, its noise and what it saturates at are the same.  Blur keeps its length.
        """
        u, v = self.centre
        return replace(
            self,
            width=max(self.width // divisor, 1),
            height=max(self.height // divisor, 1),
            pitch_mm=(self.pitch_mm[0] * divisor, self.pitch_mm[1] * divisor),
            # The panel's corner stays where it is; it is half a pixel from the first centre.
            principal_point=((u + 0.5) / divisor - 0.5, (v + 0.5) / divisor - 0.5),
            blur_px=self.blur_px / divisor,
            fill_factor=self.fill_factor / divisor**2,
        )


@dataclass(frozen=True, repr=False)
class Projector(Device):
    """A projector: an inverse camera with a light source.

    Parameters
    ----------
    flux_w : float
        Radiant flux of the fully lit panel, W.
    bit_depth : int or None
        Grey levels of the panel, 2^bit_depth; None is a continuous panel.
    gamma : float
        Radiance is ``value ** gamma``; 1 is linear, as a DMD is.
    curve : tuple of (value, radiance), optional
        Measured, in the place of gamma (:class:`~slbench.rig.optics.response.Response`).
    """

    flux_w: Measure = 1.0
    bit_depth: PanelBits | None = 8
    gamma: Measure = 1.0
    curve: ResponseCurve | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.response  # which checks the curve

    @property
    def response(self) -> Response:
        """What light the panel makes of a value: the curve, or gamma where there is none."""
        return Response(self.gamma, self.curve)

    def linear(self) -> Self:
        """Return the projector with a panel of continuous values and a linear response."""
        return replace(self, bit_depth=None, gamma=1.0, curve=None)

    @property
    def axial_intensity(self) -> float:
        """Radiant intensity on the axis of the fully lit panel, W/sr.

        The flux spread over the panel's field: a surface facing the lens on the axis at
        distance ``z`` receives ``axial_intensity / z^2``.  For a telecentric projector this
        is the irradiance in the field (W/mm^2) times the focus distance squared.
        """
        # Sum over 64 x 64 cells of the panel; the midpoint rule leaves an error below 1e-5.
        cells = 64
        u = (np.arange(cells) + 0.5) / cells * self.width - 0.5
        v = (np.arange(cells) + 0.5) / cells * self.height - 0.5
        grid = np.stack(np.meshgrid(u, v), axis=-1)
        half_u, half_v = np.array([0.5, 0.0]), np.array([0.0, 0.5])
        right = self.normalise(grid + half_u) - self.normalise(grid - half_u)
        down = self.normalise(grid + half_v) - self.normalise(grid - half_v)
        # Area of a pixel in the plane at unit distance: distortion and tilt change it.
        area = np.abs(right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0])
        light = np.nansum(self.relative_illumination(grid) * area)
        return self.flux_w / float(light * self.width * self.height / cells**2)
