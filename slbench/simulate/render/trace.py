r"""Trace a scene once into its light transport matrix.

For a camera pixel ``p`` the radiance under a panel ``q`` is an integral over the pixel, the
camera's aperture, the projector's aperture and, for interreflections, the hemisphere.  Each
Monte Carlo sample of it has a *weight* (everything but the pattern) and the panel position it
looks up.  Keeping both instead of their product with one pattern gives the matrix

    T[p, j] = 1/n  sum over samples s of p with panel pixel j of  weight_s .

It is next-event estimation as in a path tracer with the projector as only light, but for the
lookup; bounces append samples to the same row.  One Dr.Jit kernel makes a pass of samples,
pixel-major; Numba merges them into sparse rows.  Passes bound the memory.

Few samples suffice (:mod:`slbench.simulate.render.strata`); all frames of a scan share them, so
that Monte Carlo noise cannot masquerade as phase noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import zip_longest
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.core.random import derived_seed
from slbench.core.validation.types import Samples, Seed
from slbench.core.validation.values import checked
from slbench.rig import Projector, Rig
from slbench.rig.optics.spread import Spread
from slbench.scene.model import Light, SceneObject
from slbench.simulate.footprints import Levels
from slbench.simulate.render.bands import Bands
from slbench.simulate.render.interiors import Interiors, Lamp, Walk
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.camera import seen_circle, spread_ray
from slbench.simulate.render.plugins.optics import PanelOptics, opaque_transform
from slbench.simulate.render.strata import Strata
from slbench.simulate.render.translate import geometry, pose_matrix, surroundings_dict
from slbench.simulate.rows import LineRows, PointRows, SampleBlock
from slbench.simulate.transport import LightTransport, Marginal

#: Samples of one pass.  2 million lanes take about 50 MB and amortise the launch.
_LANES_PER_PASS = 1 << 21

#: Bits of a weight's mantissa: 1.5e-5 of it, when a step of 16 bit frames is as much of the whole
#: range and sampling alone errs by 1e-3.
_BITS = 15

#: Numbers of a sample's place on the panel: two each of chief, shift and circles.
_PARTS = 6

#: Radius of a disc, px, beyond which all discs are alike.
_LARGEST_PX = 1e5

Axes = tuple[Literal["u", "v", "uv"], ...]


@checked
def trace(
    objects: tuple[SceneObject, ...],
    rig: Rig,
    light: Light,
    marginals: Axes,
    *,
    samples: Samples,
    seed: Seed = 0,
    on_progress: Callable[[float], None] | None = None,
) -> LightTransport:
    """Trace the light transport from a projector over the objects of a scene to a camera.

    Parameters
    ----------
    objects : tuple of SceneObject
    rig : Rig
        One camera and one projector.
    light : Light
    marginals : tuple of {"u", "v", "uv"}
        What to keep: sums over panel columns, over rows, or the full matrix.
    samples : int
        Monte Carlo samples a pixel; rounded up to a power of two, at least 4.
    seed : int
    on_progress : callable, optional
        Called with the finished fraction after each pass.

    Returns
    -------
    LightTransport
        Radiance in W / (mm^2 sr) for a panel value of 1; the camera's fall-off included.

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    """
    return _summed(_Tracer(objects, rig, light, samples, seed), rig, marginals, on_progress)[0]


@checked
def trace_bands(
    objects: tuple[tuple[SceneObject, ...], ...],
    rig: Rig,
    light: Light,
    marginals: Axes,
    *,
    samples: Samples,
    seed: Seed = 0,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[LightTransport, ...]:
    """Trace the light transport in several bands of light along the same rays.

    Parameters
    ----------
    objects : tuple of tuple of SceneObject
        The objects in each band, which may share rays
        (:func:`slbench.simulate.render.bands.together`).
    rig, light, marginals, samples, seed, on_progress
        As for :func:`trace`, which gives the same to rounding, band by band.

    Returns
    -------
    tuple of LightTransport
        One a band.
    """
    tracer = _Tracer(objects[0], rig, light, samples, seed)
    tracer.bands = Bands(objects, tracer.geometry)
    return _summed(tracer, rig, marginals, on_progress, len(objects))


def _summed(
    tracer: _Tracer,
    rig: Rig,
    marginals: Axes,
    on_progress: Callable[[float], None] | None,
    n_bands: int = 1,
) -> tuple[LightTransport, ...]:
    """Add samples up, pass by pass."""
    camera, projector = rig.camera, rig.projector
    # Pixels that strong distortion folds away see nothing.
    fall_off = np.nan_to_num(camera.relative_illumination(camera.pixel_grid()).ravel())
    builders: list[dict[Marginal, LineRows | PointRows]] = [
        {name: _rows(projector, name) for name in marginals} for _ in range(n_bands)
    ]
    ambient = np.zeros(camera.width * camera.height, np.float32)
    passes = tracer.passes()
    launched = tracer.launch(*passes[0])
    for (first, last), following in zip_longest(passes, passes[1:]):
        wanted, escaped = launched
        if following:  # the device works while the host adds up
            launched = tracer.launch(*following)
        if escaped is not None:
            ambient[first:last] = escaped.numpy().reshape(last - first, -1).mean(axis=1)
        for own, block in zip(builders, tracer.samples_of(wanted, last - first), strict=True):
            for builder in own.values():
                builder.add(block)
        if on_progress:
            on_progress(last / ambient.size)
    shaded = np.any(fall_off != 1.0)
    if shaded:
        ambient *= fall_off.astype(np.float32)
    found = []
    for own in builders:
        rows = {name: builder.result() for name, builder in own.items()}
        if shaded:
            rows = {name: one.scaled(fall_off) for name, one in rows.items()}
        found.append(
            LightTransport(
                {name: one.rounded(_BITS) for name, one in rows.items()},
                ambient.reshape(camera.height, camera.width),
                (projector.width, projector.height),
                tracer.samples,
            )
        )
    return tuple(found)


def _rows(projector: Projector, name: Marginal) -> LineRows | PointRows:
    """Return what adds samples up to rows of a marginal."""
    spread, (width, height) = projector.spread, (projector.width, projector.height)
    aspect = projector.pitch_mm[0] / projector.pitch_mm[1]
    if name == "uv":
        return PointRows(spread, (width, height), aspect)
    along_v = Spread(spread.diffraction_px * aspect, spread.blur_px * aspect)
    axes = (Levels(spread, width), Levels(along_v, height))
    axis = "uv".index(name)
    return LineRows(axes[axis], axes[1 - axis], axis)


class _Hit(NamedTuple):
    """What samples of one bounce see of the projector."""

    weight: Any  #: radiance a unit of the panel's; negative where the lens is hidden
    chief: Any  #: panel position through the middle of the lens
    shift: Any  #: from there to the zone of the lens that was looked at
    circles: Any  #: the disc's half widths along u and v


class _Tracer:
    """The kernel and its buffers."""

    def __init__(
        self,
        objects: tuple[SceneObject, ...],
        rig: Rig,
        light: Light,
        samples: int,
        seed: int,
    ) -> None:
        self.seed = int(derived_seed(seed, 0)) & 0xFFFFFFFF
        self.bounces = light.bounces
        self.ambient = light.ambient_w_per_mm2 / np.pi
        self.around: Any = None
        if light.environment is not None:
            self.around = mi.load_dict(surroundings_dict(light))
        self.camera = PanelOptics(rig.camera)
        self.camera_to_world = opaque_transform(pose_matrix(rig.camera.pose))
        self.lamp = Lamp(rig.projector)
        self.width, self.height = rig.camera.width, rig.camera.height
        self.geometry = geometry(objects)
        self.bands: Bands | None = None
        self.shares: list[Any] = []  # of each band in the weights launched last
        self.interiors: Any = Interiors.of(objects, self.geometry)
        self.pairs = 1 << (max(1, -(-samples // 4)) - 1).bit_length()
        self.samples = 4 * self.pairs

    def passes(self) -> list[tuple[int, int]]:
        """Return the pixel ranges of the passes."""
        pixels = self.width * self.height
        hits = 2 if self.interiors is not None and self.interiors.bodies is not None else 1
        step = max(1, _LANES_PER_PASS // (self.samples * hits * (1 + self.bounces)))
        return [(first, min(first + step, pixels)) for first in range(0, pixels, step)]

    def launch(self, first: int, last: int) -> tuple[list[list[Any]], Any]:
        """Start tracing pixels `first` to `last`; return what each bounce and none will have."""
        hits, escaped = self._kernel(first, last)
        wanted = [[hit.weight, *(part[k] for part in hit[1:] for k in range(2))] for hit in hits]
        if self.bands is not None:
            wanted[0] += self.shares
        dr.eval(*wanted, escaped)
        return wanted, escaped

    def samples_of(self, wanted: list[list[Any]], pixels: int) -> list[SampleBlock]:
        """Wait for what was launched, and return its samples, those of each band."""
        weights, *parts = (
            np.concatenate([self._lanes(array, pixels) for array in arrays], axis=1)
            for arrays in zip(*wanted, strict=True)
        )
        axes = {k: (parts[k], parts[k + 2], parts[k + 4]) for k in range(2)}
        # A sample stands for as much of the lens as a pair; its place and that disc together have
        # the variance of the whole.
        whole = SampleBlock(weights, axes, 1.0 / math.sqrt(self.pairs), self.samples)
        if self.bands is None:
            return [whole]
        return [whole._replace(weights=weights * share) for share in parts[_PARTS:]]

    def _circles(self, first: int, last: int) -> Any:
        """Return the signed circle of confusion of what each pixel's centre sees, px."""
        pixel = dr.arange(mi.UInt32, last - first) + dr.opaque(mi.UInt32, first)
        row = pixel // dr.opaque(mi.UInt32, self.width)
        column = pixel - row * dr.opaque(mi.UInt32, self.width)
        centre = mi.Point2f(mi.Float(column), mi.Float(row))
        circles = seen_circle(self.camera, self.camera_to_world, self.geometry, centre)
        dr.eval(circles)
        return circles

    def _lanes(self, array: Any, pixels: int) -> NDArray[np.float32]:
        """Return what samples hold, (pixels, samples); one value stands for all."""
        values = array.numpy()
        if values.size == 1:
            return np.full((pixels, self.samples), values[0], np.float32)
        return np.asarray(values).reshape(pixels, self.samples)

    def _kernel(self, first: int, last: int) -> tuple[list[_Hit], Any]:
        """Return what each bounce sees of the projector, and radiance from outside."""
        lanes = (last - first) * self.samples
        per_pixel = dr.opaque(mi.UInt32, self.samples)
        lane = dr.arange(mi.UInt32, lanes)
        pixel = lane // per_pixel
        sample_number = lane - pixel * per_pixel
        pixel += dr.opaque(mi.UInt32, first)
        sampler = Strata(pixel, sample_number, self.pairs, self.seed)
        row = pixel // dr.opaque(mi.UInt32, self.width)
        column = pixel - row * dr.opaque(mi.UInt32, self.width)
        position = mi.Point2f(mi.Float(column), mi.Float(row)) + sampler.next_2d() - 0.5
        lens = sampler.next_2d() if self.camera.needs_lens_sample else mi.Point2f(0.5)
        circle = mi.Float(0.0)
        if self.camera.rings is not None and self.camera.aperture is not None:
            # Of the pixel's centre, as defocus hardly changes within it: one ray for all samples.
            circle = dr.gather(mi.Float, self._circles(first, last), lane // per_pixel)
        origin, direction = spread_ray(self.camera, position, self.camera.disk(lens), circle)
        ray = mi.RayDifferential3f(
            mi.Ray3f(self.camera_to_world @ origin, self.camera_to_world @ direction)
        )

        context = mi.BSDFContext()
        active = mi.Bool(True)
        throughput = mi.Float(1.0 / self.samples)
        escaped = mi.Float(0.0) if self.ambient > 0 or self.around is not None else None
        outside: Any = self.ambient  # radiance from where the ray goes
        if self.around is not None:
            outside = self._outside(ray.d)
        hits: list[_Hit] = []
        inside, walk = self.interiors, None
        for bounce in range(self.bounces + 1):
            if inside is not None:
                ray, throughput, outside = self._through(ray, throughput, outside, sampler, active)
            si = self.geometry.ray_intersect(ray, active)
            if escaped is not None:
                gone = active & ~si.is_valid()
                escaped += dr.select(gone, throughput * self.samples * outside, 0.0)
            active &= si.is_valid()
            bsdf = si.bsdf(ray)
            scattering = bsdf if self.bands is None else self.bands.at(si, active)
            hits.append(self._direct(si, scattering, context, throughput, sampler, active))
            if self.bands is not None:
                self.shares = scattering.shares
            if inside is not None and inside.bodies is not None:
                walk = inside.walk(si, ray, self.lamp, sampler, active)
                hits.append(self._led(walk, throughput))
            last_bounce = bounce == self.bounces
            if last_bounce and escaped is None:
                break
            if self.around is not None and escaped is not None:
                light = self._from_around(si, bsdf, context, sampler, active)
                escaped += throughput * self.samples * light
            sample, factor = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            factor, onward = factor.x, si.spawn_ray(si.to_world(sample.wo))
            if walk is not None:
                out = walk.entered & (sampler.next_1d() >= walk.reflected)
                factor = dr.select(walk.entered, factor / walk.reflected, factor)
                factor = dr.select(out, walk.kept, factor)
                onward.o = dr.select(out, walk.ray.o, onward.o)
                onward.d = dr.select(out, walk.ray.d, onward.d)
            throughput *= factor
            active &= throughput > 0
            ray = mi.RayDifferential3f(onward)
            if self.around is not None:
                delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
                if walk is not None:
                    delta |= out  # no map is looked at from inside
                outside = self._outside(ray.d, mi.Float(sample.pdf), delta)
            if last_bounce and escaped is not None:
                if inside is not None:
                    through = self._through(ray, throughput, outside, sampler, active)
                    ray, throughput, outside = through
                gone = active & ~self.geometry.ray_test(ray, active)
                escaped += dr.select(gone, throughput * self.samples * outside, 0.0)
        return hits, escaped

    def _through(
        self, ray: Any, throughput: Any, outside: Any, sampler: Any, active: Any
    ) -> tuple[Any, Any, Any]:
        """Follow rays through glass, and look at the map where they go then."""
        if not self.interiors.has_clear:
            return ray, throughput, outside
        ray, throughput, met = self.interiors.through_glass(ray, throughput, sampler, active)
        if self.around is not None:
            outside = dr.select(met, self._outside(ray.d), outside)
        return ray, throughput, outside

    def _outside(self, direction: Any, pdf: Any = None, delta: Any = False) -> Any:
        """Return the map's radiance along rays; weighted where the surface chose them.

        Bright parts of a map are looked at from the surface too (:meth:`_from_around`), and the
        two ways share by the power heuristic (E. Veach and L. J. Guibas, SIGGRAPH 1995).
        """
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(direction))
        si.wi = -direction
        radiance = self.around.eval(si).x
        if pdf is None:
            return radiance
        sample = dr.zeros(mi.DirectionSample3f)
        sample.d = direction
        other = self.around.pdf_direction(si, sample)
        return radiance * dr.select(delta, 1.0, _power(pdf, other))

    def _from_around(self, si: Any, bsdf: Any, context: Any, sampler: Any, active: Any) -> Any:
        """Return what the surface makes of the map's light, from where the map is bright."""
        sample, weight = self.around.sample_direction(si, sampler.next_2d(), active)
        active = active & (sample.pdf > 0)
        value, pdf = bsdf.eval_pdf(context, si, si.to_local(sample.d), active)
        light = value.x * weight.x * _power(sample.pdf, pdf)
        active = active & (light > 0)
        hidden = self.geometry.ray_test(si.spawn_ray(sample.d), active)
        return dr.select(active & ~hidden, light, 0.0)

    def _direct(
        self, si: Any, bsdf: Any, context: Any, throughput: Any, sampler: Any, active: Any
    ) -> _Hit:
        """Next-event estimation: the weight of the projector's light, and its footprint."""
        lamp = self.lamp
        lens = mi.Point2f(0.5)
        if lamp.optics.aperture is not None:
            lens = sampler.next_2d()
        place = lamp.optics.disk(lens)
        source, fall_off, valid = lamp.source(si.p, place)
        value = bsdf.eval(context, si, si.to_local(dr.normalize(source - si.p)), active & valid)
        weight = value.x * throughput * fall_off * lamp.intensity
        return self._hit(si.p, place, si.spawn_ray_to(source), weight, active & valid)

    def _led(self, walk: Walk, throughput: Any) -> _Hit:
        """Return the projector's light that came to walks."""
        source, _, valid = self.lamp.source(walk.point, walk.place)
        onward = mi.Vector3f(source - walk.start)
        distance = dr.norm(onward)
        ray = mi.Ray3f(walk.start, onward / distance)
        ray.maxt = distance
        weight = walk.weight * throughput * self.lamp.intensity
        return self._hit(walk.point, walk.place, ray, weight, walk.entered & valid)

    def _hit(self, point: Any, place: Any, ray: Any, weight: Any, active: Any) -> _Hit:
        """Return the footprint of the light of a point, or of nothing if something hides it."""
        lamp = self.lamp
        chief, along_x, along_y = lamp.optics.footprint(lamp.to_local @ point)
        active &= (weight > 0) & lamp.optics.reached(chief)
        if self.interiors is None:
            hidden = self.geometry.ray_test(ray, active)
        else:
            share = self.interiors.passed(ray, active)
            hidden = share <= 0
            weight = dr.select(hidden, weight, weight * share)
        weight = dr.select(active, dr.select(hidden, -weight, weight), 0.0)
        zone = place * math.sqrt(1.0 - 1.0 / self.pairs)
        shift = along_x * zone.x + along_y * zone.y
        # Right before the lens discs grow without end; no panel is as large as this one.
        circles = dr.minimum(dr.sqrt(along_x * along_x + along_y * along_y), _LARGEST_PX)
        # What is not lit may lie where a lens is not defined.
        return _Hit(weight, *(dr.select(active, part, 0.0) for part in (chief, shift, circles)))


def _power(own: Any, other: Any) -> Any:
    """Return the share of one of two ways to sample a direction, by their densities."""
    return dr.select(own > 0, own * own / (own * own + other * other), 0.0)
