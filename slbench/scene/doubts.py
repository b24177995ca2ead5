"""Doubts about a scene: units and places that leave nothing to measure.

A scene whose objects the projector does not light is refused; :func:`unlit` says why, in numbers.
What can be rendered and was probably meant otherwise is questioned by :func:`scene_doubts`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slbench.core import resources
from slbench.core.show.display import length
from slbench.core.units import MILLIMETRES
from slbench.detector import Detector
from slbench.objects import Mesh
from slbench.rig import Rig
from slbench.rig.device import Camera, Device
from slbench.rig.doubts import focal_length_doubt, rig_doubts
from slbench.scene.devices.datasheet import format_diagonal_mm
from slbench.scene.devices.optics import CameraOptics
from slbench.scene.model import Scene, SceneObject
from slbench.scene.tables import SceneTables

Array = NDArray[np.float64]

#: Sizes of an object, as shares of the smaller side of the camera's field, that one would measure.
_FITS = (0.03, 1.2)
#: Sizes beyond which an object that is not lit may be in another unit.
_SMALL, _LARGE = 0.02, 1.5
#: Pixels of the camera that an object covers which can be measured at all.
_SPECK_PX = 2.0
#: Paths of light inside a material, in pixels, that a picture does not tell from none.
_OPAQUE = 0.02
#: Share of full well that a converter counts: gains of cameras use a tenth of it and more.
_COUNTED = (0.1, 10.0)
#: Diagonals of sensors of one format, over the nominal one.
_FORMAT_TOLERANCE = 1.05
#: Objects that a refusal describes.
_MOST = 3
#: Units in the order in which they are tried, with the words for them.
_UNITS = {
    "m": "metres",
    "mm": "millimetres",
    "inch": "inches",
    "um": "µm",
    "cm": "centimetres",
}


def scene_doubts(scene: Scene, tables: SceneTables) -> Iterator[tuple[str, str]]:
    """Return what is odd about a scene as its file states it: (what, sentence)."""
    rig = scene.rig
    if tables.rig.file is None:  # that of a file was questioned as it was read
        yield from rig_doubts(rig)
        yield from _lens_doubts(rig, tables)
    for name, projector in rig.projectors.items():
        table = tables.projectors.get(name, tables.projector)
        if table is not None and table.response and projector.gamma != 1.0:
            why = 'not used beside a response (to take that out: response = "")'
            yield f"{tables.key(name, 'projector')}.gamma", why
    detectors = {"": scene.detector} | {f"cameras.{n}.": d for n, d in scene.detectors.items()}
    for where, one in detectors.items():
        if isinstance(one, Detector) and (doubt := converter_doubt(one)):
            yield f"{where}detector.gain_e_per_dn", doubt
    for key, doubt in scene.colour.doubts() if scene.colour else ():
        yield f"colour.{key}", doubt
    first = rig.pair(rig.pairs[0])
    for index, item in enumerate(scene.objects):
        for doubt in filter(None, (speck_doubt(item, first), turbidity_doubt(item, first))):
            yield f"objects[{index}]", doubt


def _lens_doubts(rig: Rig, tables: SceneTables) -> Iterator[tuple[str, str]]:
    for name, table in (tables.optics("camera") | tables.optics("projector")).items():
        key = tables.key(name)
        # Who states an f-number describes a lens that can be bought.
        if table.f_number and table.focal_length_mm:
            focus = rig.devices[name].lens.focus_distance_mm
            if doubt := focal_length_doubt(table.focal_length_mm, focus):
                yield f"{key}.focal_length_mm", f"{doubt}: lens_mm states the focal length"
        made_for = table.lens_format if isinstance(table, CameraOptics) else None
        if made_for and (doubt := image_circle_doubt(made_for, rig.cameras[name])):
            yield f"{key}.lens_format", doubt


def image_circle_doubt(lens_format: str, camera: Camera) -> str | None:
    """Question a lens whose picture is smaller than the sensor behind it."""
    circle = format_diagonal_mm(lens_format)
    (pu, pv) = camera.pitch_mm
    diagonal = math.hypot(pu * camera.width, pv * camera.height)
    if diagonal <= _FORMAT_TOLERANCE * circle:
        return None
    return (
        f"a lens for {lens_format} makes a picture of {length(circle)} across, and the sensor's "
        f"diagonal is {length(diagonal)}: its corners may be dark, which is not simulated"
    )


def converter_doubt(detector: Detector) -> str | None:
    """Question a gain with which the converter's range ends far from full well."""
    counted = (detector.top_dn - detector.black_dn) * detector.e_per_dn
    share = counted / detector.full_well_e
    if _COUNTED[0] <= share <= _COUNTED[1]:
        return None
    fits = detector.full_well_e / (detector.top_dn - detector.black_dn)
    return (
        f"{detector.e_per_dn:.4g} e/DN at {detector.bit_depth} bits count {counted:.4g} e of a "
        f"full well of {detector.full_well_e:.4g} e; {fits:.4g} e/DN would count all of it"
    )


def speck_doubt(item: SceneObject, rig: Rig) -> str | None:
    """Question a mesh that is smaller than two pixels of the camera and fits in another unit."""
    size = float(_sizes(item).max())
    camera = rig.camera
    pixel = _field(camera, _depth(camera, item.middle))[0] / camera.width
    if not 0 < size < _SPECK_PX * pixel:
        return None
    other = fitting_unit(item, rig)
    if other is None:
        return None
    said = f"{item.artefact.name} is {length(size)} long, a pixel of the camera is {length(pixel)}"
    return f"{said} there; {other}"


def turbidity_doubt(item: SceneObject, rig: Rig) -> str | None:
    """Question a translucent material that the object's size makes clear, or opaque."""
    depth = _depth(rig.camera, item.middle)
    media = (item.material_of(part).bsdf.interior for part in item.artefact.parts)
    medium = next((one for one in media if one is not None and not one.clear), None)
    if medium is None or depth <= 0:
        return None
    pixel = _field(rig.camera, depth)[0] / rig.camera.width
    path, size = medium.transport_path_mm, float(_sizes(item).max())
    said = f"light goes {length(path)} through {item.artefact.name} before it is turned or taken up"
    if path > size:
        return f"{said}, which is {length(size)} long: nearly clear. Is scattering stated in 1/µm?"
    if path < _OPAQUE * pixel:
        return (
            f"{said}, and a pixel of the camera is {length(pixel)} there: as good as opaque, and a "
            "diffuse material is traced far sooner. Is scattering stated in 1/m?"
        )
    return None


def fitting_unit(item: SceneObject, rig: Rig) -> str | None:
    """Say in which unit a mesh would fill the camera's field; None where none or no mesh file."""
    parameters = item.artefact.parameters
    if item.artefact.kind != "mesh" or "unit" not in parameters:
        return None
    field = _reference_field(item, rig)
    if field is None:
        return None
    for unit, word in _UNITS.items():
        sizes = _sizes(item) * (MILLIMETRES[unit] / MILLIMETRES[parameters["unit"]])
        fits = _FITS[0] * field <= sizes.max() <= _FITS[1] * field
        if fits and unit != parameters["unit"]:
            return f'in {word} (unit = "{unit}") it would be {_by(sizes)} mm'
    return None


def unlit(scene: Scene) -> str:
    """Say why the projector lights no object of a scene that the camera sees.

    Returns
    -------
    str
        The command that draws the scene, sizes, distances and fields of view, and the likely
        cause; one line.
    """
    rig = scene.rig
    # The command first: a long line is cut off at its end.
    name = scene.name if scene.name in resources.names("scenes") else "SCENE"
    parts = [f"draw it with `slbench scene show {name} --out rig.png`"]
    parts += [f"{what}: {doubt}" for what, doubt in rig_doubts(rig)]
    parts += [_described(item, rig) for item in scene.objects[:_MOST]]
    if len(scene.objects) > _MOST:
        parts.append(f"and {len(scene.objects) - _MOST} more objects")
    return "; ".join(parts)


def _described(item: SceneObject, rig: Rig) -> str:
    middle = item.middle
    views = []
    for name, device in (("camera", rig.camera), ("projector", rig.projector)):
        depth = _depth(device, middle)
        if depth <= 0:
            views.append(f"{length(-depth)} behind the {name}'s lens")
            continue
        seen = _by(_field(device, depth))
        views.append(f"{length(depth)} from the {name}, whose field there is {seen} mm")
    size = f"{_by(_sizes(item))} mm about ({_by(middle, ', ')}) mm"
    return f"{item.artefact.name} is {size}, {' and '.join(views)}: {likely_cause(item, rig)}"


def likely_cause(item: SceneObject, rig: Rig) -> str:
    """Say why an object is not lit where the camera sees it: the first cause that holds."""
    field = _reference_field(item, rig)
    share = float(_sizes(item).max()) / (field or np.inf)
    other = fitting_unit(item, rig) if not _SMALL < share < _LARGE else None
    if other is not None:
        return other
    vertices = item.pose.to_world(item.artefact.mesh.vertices)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    devices = {"camera": rig.camera, "projector": rig.projector}
    for name, device in devices.items():
        if np.all((low < device.pose.position) & (device.pose.position < high)):
            return f"the {name}'s lens lies within the box about it"
    for name, device in devices.items():
        if device.in_body(vertices).any():
            return f"it reaches into the {name}'s housing"
    for name, device in devices.items():
        if np.all(device.pose.to_local(vertices)[:, 2] <= 0):
            return f"it lies behind the {name}'s lens"
    for name, device in devices.items():
        if (outside := _outside(device, vertices)) is not None:
            return f"it lies outside the {name}'s field, {outside}"
    if not _in_both(rig, item.artefact.mesh, vertices):
        return "no part of it lies in the fields of both, which overlap elsewhere"
    return "it lies in both fields, turned away or in the shadow of something"


def _by(lengths: Array, between: str = " x ") -> str:
    """Return lengths in words that never have an exponent."""
    texts = (
        f"{x:.0f}" if abs(x) >= 1e3 else f"{x:.3g}" if abs(x) >= 1e-3 else "0" for x in lengths
    )
    return between.join(texts)


def _outside(device: Device, vertices: Array) -> str | None:
    """Return where an object is on a panel that it misses; None where it may meet it."""
    pixels = device.project(vertices)
    if not np.all(np.isfinite(pixels)):
        return None
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    size = (device.width, device.height)
    if np.all((high > -0.5) & (low < np.array(size) - 0.5)):
        return None
    place = ", ".join(
        f"{axis} {a:.0f} to {b:.0f}" for axis, a, b in zip("uv", low, high, strict=True)
    )
    return f"at {place} of {size[0]} x {size[1]} px"


def _in_both(rig: Rig, mesh: Mesh, vertices: Array) -> bool:
    centres = vertices[mesh.faces].mean(axis=1)
    points = np.concatenate((vertices, centres))
    seen = [device.contains(device.project(points)) for device in (rig.camera, rig.projector)]
    return bool(np.any(seen[0] & seen[1]))


def _sizes(item: SceneObject) -> Array:
    """Return the sides of the box about an object, along its own axes, (3,), mm."""
    vertices = item.artefact.mesh.vertices
    return np.asarray(vertices.max(axis=0) - vertices.min(axis=0))


def _depth(device: Device, point: Array) -> float:
    return float(device.pose.to_local(point)[2])


def _field(device: Device, depth: float) -> Array:
    """Return width and height of a device's field at a depth, mm, without distortion."""
    at = device.lens.focus_distance_mm if device.lens.kind == "telecentric" else depth
    panel = np.array([device.width, device.height]) * np.array(device.pitch_mm)
    return np.asarray(panel * (at / device.lens.focal_length_mm))


def _reference_field(item: SceneObject, rig: Rig) -> float | None:
    """Return the smaller side of the camera's field where one would measure an object, mm.

    That is at the origin, in focus where the origin is no place before the camera, or at the
    object.
    """
    camera = rig.camera
    focus = camera.lens.focus_distance_mm
    depths = (_depth(camera, np.zeros(3)), focus, _depth(camera, item.middle))
    depth = next((d for d in depths if 0 < d < np.inf), None)
    return None if depth is None else float(_field(camera, depth).min())
