r"""Light inside objects: random walks in translucent ones, straight ways through clear ones.

**Translucent.**  A camera's ray is refracted into the object and walks: free paths, scattering and
reflection at the boundary from inside, until it is refracted out.  Where it is scattered it is
connected to the projector through the face that lies straight towards it, by Snell's and Fresnel's
laws as if that face were a plane and the light there parallel: the projector is a point, which no
sampled direction meets behind a boundary that refracts.  At a refractive index of 1 this is exact
(Mitsuba's ``volpath`` with a ``null`` boundary); at others as far as a face is flat over some mean
free paths and the projector far away.  Of a walk's connections one is kept, drawn by its weight and
carrying that of all (weighted reservoir sampling, M. T. Chao, Biometrika 69, 1982), so that a walk
is one sample of the light transport matrix.

**Clear.**  A camera's ray is reflected or refracted, whichever is drawn.  The projector's light
passes straight, and each face takes the share that Fresnel's equations reflect.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from slbench.core.errors import warn_user
from slbench.rig import Projector
from slbench.scene.model import SceneObject
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.optics import PanelOptics, opaque, opaque_transform
from slbench.simulate.render.strata import Strata
from slbench.simulate.render.translate import pose_matrix, shape_indices, shapes

#: Free paths of a walk, and faces of clear objects on a way: what is left by then is dropped.
_MOST_STEPS, _MOST_FACES = 1 << 14, 32
_FLAGS = mi.RayFlags.Minimal
#: Steps of a walk before the first that have ended are left aside.
_FIRST_STEPS = 16
#: Distance from a surface that is none, as a share of coordinates: 32 roundings.
_OFF_SURFACE = 4e-6
#: Boxes that are nearer than this touch, mm.
_TOUCHING_MM = 1e-3
#: What has less weight than this goes on with one chance in two, and twice the weight.
_FAINT = 0.25


class Inside(NamedTuple):
    """What is inside the shapes that rays have met."""

    scatters: Any  #: whether it is translucent
    clear: Any  #: whether it is glass; neither: opaque
    eta: Any
    extinction: Any
    albedo: Any
    g: Any
    outward: Any  #: 1, or -1 where faces look inwards


class Walk(NamedTuple):
    """What became of walks, and how the projector's light came to them."""

    entered: Any  #: whether there was one
    reflected: Any  #: the share that does not get in
    weight: Any  #: radiance towards the camera, unless something is in the light's way
    point: Any  #: what lies in its line, as far behind the face as the light has gone
    place: Any  #: of the lens, on the unit disc
    start: Any  #: on the face
    ray: Any  #: where it goes on
    kept: Any  #: with how much of its weight; 0: it has not come out


class _Led(NamedTuple):
    """The projector's light at a place inside."""

    value: Any
    point: Any
    place: Any
    start: Any
    enclosed: Any  #: whether it is inside at all


class Lamp:
    """The projector in the world.

    Parameters
    ----------
    projector : Projector
    """

    def __init__(self, projector: Projector) -> None:
        self.optics = PanelOptics(projector)
        matrix = pose_matrix(projector.pose)
        self.to_world = opaque_transform(matrix)
        self.to_local = opaque_transform(np.linalg.inv(matrix))
        self.intensity = opaque(projector.axial_intensity)

    def source(self, point: Any, place: Any) -> tuple[Any, Any, Any]:
        """Return where on the lens a point's light comes from, how strong it is, and whether it is.

        Parameters
        ----------
        point : in the world
        place : of the lens, on the unit disc
        """
        origin, fall_off, valid = self.optics.source(self.to_local @ point, place)
        return self.to_world @ origin, fall_off, valid


class Interiors:
    """What is inside the objects of a scene.

    Parameters
    ----------
    objects : tuple of SceneObject
    geometry : mi.Scene
        Their shapes.
    """

    def __init__(self, objects: tuple[SceneObject, ...], geometry: Any) -> None:
        parts = shapes(objects)
        index = shape_indices(geometry)
        table = np.zeros((max(index) + 1, 7), np.float32)
        table[:, 2:4] = 1.0
        owners = set()
        for identifier, k in index.items():
            owner = parts[k].object_id
            table[identifier, 6] = np.sign(objects[owner].artefact.mesh.volume)
            inside = parts[k].material.bsdf.interior
            if inside is None:
                continue
            table[identifier, :3] = not inside.clear, inside.clear, inside.eta
            if not inside.clear:
                table[identifier, 3:6] = inside.extinction_per_mm, inside.albedo, inside.g
                owners.add(owner)
        self.table = mi.Float(table.ravel())
        self.geometry = geometry
        self.has_clear = bool(table[:, 1].any())
        bodies = {
            f"shape{k}": shape
            for k, shape in enumerate(geometry.shapes())
            if parts[k].object_id in owners
        }
        question_contact([objects[k] for k in sorted(owners)])
        # Alone, so that a body that stands on a table has its own bottom.
        self.bodies: Any = None
        if bodies:
            content = {"type": "scene", **bodies}
            self.bodies = mi.load_dict(content, parallel=False, optimize=False)

    @classmethod
    def of(cls, objects: tuple[SceneObject, ...], geometry: Any) -> Interiors | None:
        """Return the interiors of a scene; None where everything is opaque."""
        materials = (item.material_of(p) for item in objects for p in item.artefact.parts)
        if all(material.bsdf.interior is None for material in materials):
            return None
        return cls(objects, geometry)

    def at(self, shape: Any, active: Any) -> Inside:
        """Return what is inside shapes."""
        start = dr.reinterpret_array(mi.UInt32, shape) * 7
        values = [dr.gather(mi.Float, self.table, start + k, active) for k in range(7)]
        return Inside(active & (values[0] > 0), active & (values[1] > 0), *values[2:])

    def through_glass(self, ray: Any, throughput: Any, sampler: Strata, active: Any) -> Any:
        """Follow rays until they meet something that is not clear, or nothing.

        Returns
        -------
        ray, throughput, met
            The last part of each way, what is left of the weight, and whether there was glass.
        """
        first, noise = sampler.next_1d(), sampler.stream()
        origin, direction = mi.Point3f(ray.o), mi.Vector3f(ray.d)
        faces = dr.zeros(mi.UInt32, dr.width(throughput))

        def step(  # type: ignore[no-untyped-def]
            origin, direction, throughput, faces, noise, going
        ):  # fmt: skip
            si = self.geometry.ray_intersect(mi.Ray3f(origin, direction), going)
            inside = self.at(si.shape, going & si.is_valid())
            going &= inside.clear
            normal = si.n * inside.outward
            cosine = -dr.dot(direction, normal)
            reflected, cosine_in, _, ratio = mi.fresnel(cosine, inside.eta)
            draw = dr.select(faces == 0, first, noise.next_float32(going))
            back = draw < reflected
            bent = mi.Vector3f(ratio * direction + normal * (ratio * cosine + cosine_in))
            mirrored = mi.Vector3f(direction + 2.0 * cosine * normal)
            bent = dr.normalize(dr.select(back, mirrored, bent))
            origin = dr.select(going, _beside(si, bent), origin)
            direction = dr.select(going, bent, direction)
            # Radiance grows as the cone of its rays gets narrower.
            throughput = dr.select(going & ~back, throughput * ratio * ratio, throughput)
            faces += dr.select(going, mi.UInt32(1), 0)
            going &= faces < _MOST_FACES
            return origin, direction, throughput, faces, noise, going

        state = (origin, direction, mi.Float(throughput), faces, noise, mi.Bool(active))
        origin, direction, throughput, faces, *_ = dr.while_loop(
            state, lambda *s: s[-1], step, label="through glass"
        )
        return mi.RayDifferential3f(mi.Ray3f(origin, direction)), throughput, faces > 0

    def passed(self, ray: Any, active: Any) -> Any:
        """Return the share of light that goes straight along a ray, as far as it reaches."""
        target = ray(ray.maxt)

        def step(origin, share, faces, going):  # type: ignore[no-untyped-def]
            onward = mi.Vector3f(target - origin)
            distance = dr.norm(onward)
            direction = onward / distance
            si = self.geometry.ray_intersect(_ray(origin, direction, distance), going)
            going &= si.is_valid()
            inside = self.at(si.shape, going)
            cosine = -dr.dot(direction, si.n) * inside.outward
            factor = 1.0 - mi.fresnel(dr.abs(cosine), inside.eta)[0]
            # Inside a medium that is matched to the air: it was entered where the ray began last.
            matched = inside.scatters & (inside.eta == 1.0)
            crossed = dr.select(cosine < 0, dr.exp(-inside.extinction * si.t), 1.0)
            factor = dr.select(matched, crossed, dr.select(inside.clear, factor, 0.0))
            share = dr.select(going, share * factor, share)
            origin = dr.select(going, _beside(si, direction), origin)
            faces += 1
            share = dr.select(going & (faces >= _MOST_FACES), 0.0, share)
            going &= share > 0
            return origin, share, faces, going

        width = dr.width(active)
        counter = dr.zeros(mi.UInt32, width)
        state = (mi.Point3f(ray.o), dr.ones(mi.Float, width), counter, mi.Bool(active))
        result = dr.while_loop(state, lambda *s: s[-1], step, label="straight through")
        return result[1]

    def walk(self, si: Any, ray: Any, lamp: Lamp, sampler: Strata, active: Any) -> Walk:
        """Walk from where rays meet translucent objects.

        Parameters
        ----------
        si : where rays meet the objects
        ray : those rays
        lamp : the projector's :class:`Lamp`
        sampler : Strata
        active : lanes
        """
        inside = self.at(si.shape, active)
        normal = si.n * inside.outward
        cosine = -dr.dot(ray.d, normal)
        active = inside.scatters & (cosine > 0)
        reflected, cosine_in, _, ratio = mi.fresnel(cosine, inside.eta)
        direction = mi.Vector3f(ratio * ray.d + normal * (ratio * cosine + cosine_in))
        enters = 1.0 - reflected
        first = -dr.log(1.0 - sampler.next_1d()) / inside.extinction
        width = dr.width(active)
        media = inside[2:6]
        state = (
            _beside(si, direction),
            dr.normalize(direction),
            first,
            dr.ones(mi.Float, width),
            dr.zeros(mi.UInt32, width),
            sampler.stream(),
            dr.zeros(mi.Float, width),
            dr.zeros(mi.Point3f, width),
            dr.zeros(mi.Point2f, width),
            dr.zeros(mi.Point3f, width),
            dr.zeros(mi.Bool, width),
            mi.Bool(active),
        )
        dr.eval(state, media)
        # Walks are of very different lengths: now and then those that go on are drawn together, or
        # lanes would wait for the longest of their neighbours.
        reach, lanes = _FIRST_STEPS, dr.compress(active)
        while dr.width(lanes) and reach <= _MOST_STEPS:
            here = [dr.gather(type(one), one, lanes) for one in media]
            part = tuple(dr.gather(type(one), one, lanes) for one in state)
            limit = dr.opaque(mi.UInt32, reach)
            part = dr.while_loop(
                part,
                lambda *s, limit=limit: s[-1] & (s[4] < limit),
                lambda *s, here=here: self._step(lamp, here, *s),
                label="walk",
            )
            for one, changed in zip(state, part, strict=True):
                dr.scatter(one, changed, lanes)
            dr.eval(state)
            lanes = dr.gather(mi.UInt32, lanes, dr.compress(part[-1]))
            reach *= 2
        origin, direction, _, weight, _, _, total, point, place, start, out, _ = state
        onward = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        weight = dr.select(out, weight, 0.0)
        return Walk(active, reflected, total * enters, point, place, start, onward, weight)

    def _step(  # type: ignore[no-untyped-def]
        self, lamp, media, origin, direction, free, weight, steps, noise,
        total, point, place, start, out, going,
    ):  # fmt: skip
        """Take a free path: to where light is scattered, or to the boundary."""
        eta, extinction, albedo, g = media
        met = self.bodies.ray_intersect(_ray(origin, direction, free), _FLAGS, False, going)
        scattered, crossing = going & ~met.is_valid(), going & met.is_valid()

        # At the boundary: back inside, or out.
        there = self.at(met.shape, crossing)
        n = met.n * there.outward
        cosine = -dr.dot(direction, n)  # below 0 from inside
        share, cosine_out, _, ratio = mi.fresnel(cosine, eta)
        crossing &= there.scatters & (cosine < 0)
        back = crossing & (noise.next_float32(going) < share)
        mirrored = mi.Vector3f(direction + 2.0 * cosine * n)
        bent = mi.Vector3f(ratio * direction + n * (ratio * cosine + cosine_out))
        turned = dr.normalize(dr.select(back, mirrored, bent))
        out |= crossing & ~back

        # Where it is scattered: the projector's light.
        event = mi.Point3f(origin + direction * free)
        weight = dr.select(scattered, weight * albedo, weight)
        lens = mi.Point2f(0.5)
        if lamp.optics.aperture is not None:
            lens = mi.Point2f(noise.next_float32(going), noise.next_float32(going))
        led = self._led(lamp, media, event, direction, lamp.optics.disk(lens), scattered)
        value = weight * led.value
        total += value
        chosen = noise.next_float32(going) * total < value
        point = dr.select(chosen, led.point, point)
        place = dr.select(chosen, led.place, place)
        start = dr.select(chosen, led.start, start)

        # On: after the event, or from inside the boundary.
        onward = _scatter(g, direction, noise, going)
        direction = dr.select(scattered, onward, dr.select(crossing, turned, direction))
        origin = dr.select(scattered, event, dr.select(crossing, _beside(met, turned), origin))
        free = -dr.log(1.0 - noise.next_float32(going)) / extinction
        # What has a face turned away before it has left through a crack.
        going = (scattered & led.enclosed) | back
        faint = going & (weight < _FAINT)
        dies = noise.next_float32(going) < 0.5
        weight = dr.select(faint & ~dies, weight * 2.0, weight)
        steps += 1
        going &= ~(faint & dies)
        return (
            *(origin, direction, free, weight, steps, noise),
            *(total, point, place, start, out, going),
        )

    def _led(
        self, lamp: Lamp, media: Any, event: Any, direction: Any, place: Any, active: Any
    ) -> _Led:
        """Return the light that comes to where it is scattered, by the face towards the projector.

        Parallel light before a plane: what it lights inside is as much narrower or wider as its
        cosines to the normal say, and its radiance is counted as seen from outside.
        """
        eta, extinction, _, g = media
        source, fall_off, valid = lamp.source(event, place)
        straight = mi.Vector3f(source - event)
        distance = dr.norm(straight)
        straight /= distance
        face = self.bodies.ray_intersect(_ray(event, straight, distance), _FLAGS, False, active)
        there = self.at(face.shape, active & face.is_valid())
        normal = face.n * there.outward
        height = dr.dot(face.p - event, normal)
        enclosed = active & face.is_valid() & (height > 0)
        start = _beside(face, straight)
        for _ in range(2):  # the second time from where the first has ended
            outer = dr.dot(straight, normal)
            inner = dr.safe_sqrt(1.0 - (1.0 - outer * outer) / (eta * eta))
            inward = mi.Vector3f((straight - normal * outer) / eta + normal * inner)
            gap = height / inner
            top = mi.Point3f(event + inward * gap)
            straight = mi.Vector3f(dr.normalize(source - top))
        value = (1.0 - mi.fresnel(outer, eta)[0]) * outer / (inner * eta * eta)
        value *= dr.exp(-extinction * gap) * fall_off * _phase(g, dr.dot(direction, inward))
        value = dr.select(enclosed & there.scatters & valid & (outer > 0), value, 0.0)
        return _Led(value, mi.Point3f(top - straight * gap), place, start, enclosed)


def question_contact(bodies: Sequence[SceneObject]) -> None:
    """Question translucent objects whose boxes touch: light does not go from one into the other.

    Warns
    -----
    InputWarning
    """
    boxes = []
    for body in bodies:
        corners = body.pose.to_world(body.artefact.mesh.vertices)
        boxes.append((body.artefact.name, corners.min(axis=0), corners.max(axis=0)))
    for (a, low, high), (b, lower, higher) in itertools.combinations(boxes, 2):
        gap = _TOUCHING_MM
        if np.all(low <= higher + gap) and np.all(lower <= high + gap):
            why = "where they touch, light that reaches the common face is lost: keep them apart"
            warn_user(f"translucent objects {a} and {b}", why)


def _ray(origin: Any, direction: Any, reach: Any) -> Any:
    """Return rays that end."""
    ray = mi.Ray3f(origin, direction)
    ray.maxt = reach
    return ray


def _beside(si: Any, direction: Any) -> Any:
    """Return where rays leave a surface: off it by more than it is rounded, and little more.

    Mitsuba's own distance is twenty times this, as much as a tenth of a mean free path.
    """
    size = dr.maximum(dr.maximum(dr.abs(si.p.x), dr.abs(si.p.y)), dr.abs(si.p.z))
    gap = (1.0 + size) * _OFF_SURFACE
    return mi.Point3f(si.p + si.n * dr.select(dr.dot(si.n, direction) > 0, gap, -gap))


def _phase(g: Any, cosine: Any) -> Any:
    """Return Henyey and Greenstein's density of a scattering angle, 1/sr."""
    square = 1.0 + g * g - 2.0 * g * cosine
    return (1.0 - g * g) / (4.0 * np.pi * square * dr.sqrt(square))


def _scatter(g: Any, direction: Any, noise: Any, active: Any) -> Any:
    """Draw directions of that density about others."""
    u = noise.next_float32(active)
    even = dr.abs(g) < 1e-3
    root = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
    cosine = (1.0 + g * g - root * root) / dr.select(even, 1.0, 2.0 * g)
    cosine = dr.clip(dr.select(even, 1.0 - 2.0 * u, cosine), -1.0, 1.0)
    sine, angle = dr.safe_sqrt(1.0 - cosine * cosine), 2.0 * np.pi * noise.next_float32(active)
    s, c = dr.sincos(angle)
    return mi.Frame3f(direction).to_world(mi.Vector3f(sine * c, sine * s, cosine))
