r"""Trace a scene once into its light transport matrix.

For a camera pixel ``p`` the radiance under a panel ``q`` is an integral over the pixel, the
camera's aperture, the projector's aperture and, for interreflections, the hemisphere.  Each
Monte Carlo sample of it has a *weight* (everything but the pattern) and the panel position it
looks up.  Keeping both instead of their product with one pattern gives the matrix

    T[p, j] = 1/n  sum over samples s of p with panel pixel j of  weight_s .

It is next-event estimation as in a path tracer with the projector as only light, but for the
lookup; bounces append samples to the same row.  One Dr.Jit kernel makes a pass of samples,
pixel-major; Numba merges them into sparse rows.  Passes bound the memory.

Samples are stratified within each pixel (correlated multi-jittered: A. Kensler, Pixar
Technical Memo 13-01), so that few suffice; all frames of a scan share them, so that Monte
Carlo noise cannot masquerade as phase noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.random import derived_seed
from slbench.core.validation.types import Samples, Seed
from slbench.core.validation.values import checked
from slbench.rig import Rig
from slbench.scene.model import Light, SceneObject
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.optics import PanelOptics, opaque, opaque_transform
from slbench.simulate.render.translate import geometry, pose_matrix
from slbench.simulate.transport import LightTransport, Marginal, SparseRows

#: Samples of one pass.  8 million lanes take about 150 MB and amortise the launch.
_LANES_PER_PASS = 1 << 23

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
        Monte Carlo samples a pixel; rounded up to a full grid of strata.
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
    tracer = _Tracer(objects, rig, light, marginals, samples, seed)
    camera, projector = rig.camera, rig.projector
    # Pixels that strong distortion folds away see nothing.
    fall_off = np.nan_to_num(camera.relative_illumination(camera.pixel_grid()).ravel())
    blocks: dict[Marginal, list[SparseRows]] = {name: [] for name in marginals}
    ambient = np.zeros(camera.width * camera.height, np.float32)
    for first, last in tracer.passes():
        tracer.run(first, last, blocks, ambient)
        if on_progress:
            on_progress(last / ambient.size)
    rows = {name: SparseRows.concatenate(blocks[name]) for name in marginals}
    if np.any(fall_off != 1.0):
        rows = {name: block.scaled(fall_off) for name, block in rows.items()}
        ambient *= fall_off.astype(np.float32)
    return LightTransport(
        rows,
        ambient.reshape(camera.height, camera.width),
        (projector.width, projector.height),
        tracer.samples,
    )


class _Tracer:
    """The kernel and its buffers."""

    def __init__(
        self,
        objects: tuple[SceneObject, ...],
        rig: Rig,
        light: Light,
        marginals: Axes,
        samples: int,
        seed: int,
    ) -> None:
        self.marginals = marginals
        self.seed = seed
        self.bounces = light.bounces
        self.ambient = light.ambient_w_per_mm2 / np.pi
        self.camera = PanelOptics(rig.camera)
        self.projector = PanelOptics(rig.projector)
        self.camera_to_world = opaque_transform(pose_matrix(rig.camera.pose))
        self.projector_to_world = opaque_transform(pose_matrix(rig.projector.pose))
        self.world_to_projector = opaque_transform(np.linalg.inv(pose_matrix(rig.projector.pose)))
        self.intensity = opaque(rig.projector.axial_intensity)
        self.width, self.height = rig.camera.width, rig.camera.height
        self.panel = (rig.projector.width, rig.projector.height)
        self.geometry = geometry(objects)
        self.samples = self._sampler(samples).sample_count()

    @staticmethod
    def _sampler(samples: int) -> Any:
        # Strata form a grid of near-square shape; Mitsuba rounds other counts up to one.
        columns = int(np.sqrt(samples))
        rows = -(-samples // columns)
        return mi.load_dict({"type": "multijitter", "sample_count": columns * rows})

    def passes(self) -> list[tuple[int, int]]:
        """Return the pixel ranges of the passes."""
        pixels = self.width * self.height
        step = max(1, _LANES_PER_PASS // (self.samples * (1 + self.bounces)))
        return [(first, min(first + step, pixels)) for first in range(0, pixels, step)]

    def run(
        self,
        first: int,
        last: int,
        blocks: dict[Marginal, list[SparseRows]],
        ambient: NDArray[np.float32],
    ) -> None:
        """Trace pixels `first` to `last` and append their rows to `blocks`."""
        hits, escaped = self._kernel(first, last)
        lanes = [array for hit in hits for array in hit]
        dr.eval(*lanes, *([] if escaped is None else [escaped]))
        pixels = last - first
        if escaped is not None:
            ambient[first:last] = escaped.numpy().reshape(pixels, -1).mean(axis=1)
        for k, name in enumerate(self.marginals):
            size = self._size(name)
            dtype = np.uint16 if size <= 1 << 16 else np.uint32
            columns = np.empty((pixels, len(hits) * self.samples), dtype)
            weights = np.empty(columns.shape, np.float32)
            for bounce, (weight, *panel) in enumerate(hits):
                part = np.s_[:, bounce * self.samples : (bounce + 1) * self.samples]
                columns[part] = panel[k].numpy().reshape(pixels, -1)
                weights[part] = weight.numpy().reshape(pixels, -1)
            blocks[name].append(SparseRows.from_samples(columns, weights, size))

    def _size(self, name: Marginal) -> int:
        return {"u": self.panel[0], "v": self.panel[1], "uv": self.panel[0] * self.panel[1]}[name]

    def _kernel(self, first: int, last: int) -> tuple[list[tuple[Any, ...]], Any]:
        """Return per bounce (weight, panel index per marginal), and radiance from outside."""
        lanes = (last - first) * self.samples
        sampler = self._sampler(self.samples)
        sampler.set_samples_per_wavefront(self.samples)
        state = derived_seed(self.seed, first)
        sampler.seed(int(state), lanes)

        pixel = dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, self.samples)
        pixel += dr.opaque(mi.UInt32, first)
        row = pixel // dr.opaque(mi.UInt32, self.width)
        column = pixel - row * dr.opaque(mi.UInt32, self.width)
        position = mi.Point2f(mi.Float(column), mi.Float(row)) + sampler.next_2d() - 0.5
        lens = sampler.next_2d() if self.camera.needs_lens_sample else mi.Point2f(0.5)
        origin, direction = self.camera.sample_ray(position, lens)
        ray = mi.RayDifferential3f(
            mi.Ray3f(self.camera_to_world @ origin, self.camera_to_world @ direction)
        )

        context = mi.BSDFContext()
        active = mi.Bool(True)
        throughput = mi.Float(1.0 / self.samples)
        escaped = mi.Float(0.0) if self.ambient > 0 else None
        hits: list[tuple[Any, ...]] = []
        for bounce in range(self.bounces + 1):
            si = self.geometry.ray_intersect(ray, active)
            if escaped is not None:
                gone = active & ~si.is_valid()
                escaped += dr.select(gone, throughput * self.samples * self.ambient, 0.0)
            active &= si.is_valid()
            bsdf = si.bsdf(ray)
            hits.append(self._direct(si, bsdf, context, throughput, sampler, active))
            last_bounce = bounce == self.bounces
            if last_bounce and escaped is None:
                break
            sample, factor = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            throughput *= factor.x
            active &= throughput > 0
            ray = mi.RayDifferential3f(si.spawn_ray(si.to_world(sample.wo)))
            if last_bounce and escaped is not None:
                gone = active & ~self.geometry.ray_test(ray, active)
                escaped += dr.select(gone, throughput * self.samples * self.ambient, 0.0)
        return hits, escaped

    def _direct(
        self, si: Any, bsdf: Any, context: Any, throughput: Any, sampler: Any, active: Any
    ) -> tuple[Any, ...]:
        """Next-event estimation: the weight of the projector's light, and where it starts."""
        lens = sampler.next_2d() if self.projector.needs_lens_sample else mi.Point2f(0.5)
        pixel, origin, fall_off, valid = self.projector.sample_panel(
            self.world_to_projector @ si.p, lens
        )
        active = active & valid
        source = self.projector_to_world @ origin
        shadow_ray = si.spawn_ray_to(source)
        value = bsdf.eval(context, si, si.to_local(dr.normalize(source - si.p)), active)
        weight = value.x * throughput * fall_off * self.intensity
        active &= weight > 0
        active &= ~self.geometry.ray_test(shadow_ray, active)
        weight = dr.select(active, weight, 0.0)
        # Panel pixels are squares around integers.  Rounding can push a lane on the very
        # edge out of the panel; its weight stays, one pixel in.
        u = mi.UInt32(dr.clip(dr.floor(pixel.x + 0.5), 0, self.projector.size.x - 1))
        v = mi.UInt32(dr.clip(dr.floor(pixel.y + 0.5), 0, self.projector.size.y - 1))
        index = {"u": u, "v": v, "uv": v * dr.opaque(mi.UInt32, self.panel[0]) + u}
        return weight, *(index[name] for name in self.marginals)
