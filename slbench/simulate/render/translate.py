"""A scene in Mitsuba's words: geometry, materials, and the whole as a Mitsuba dictionary.

:func:`geometry` is what the light transport tracer and the ground truth look at: shapes only.
:func:`mitsuba_dict` is the complete scene with camera, projector and a pattern, for rendering
with Mitsuba's own integrators; it uses stock plugins wherever they can express the device and
ours elsewhere, and :func:`export_xml` writes it for other Mitsuba users where they all can.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.io import files_beside, write_exr
from slbench.core.io.atomic import native_writing
from slbench.rig import Camera, Device, Pose, Projector
from slbench.scene.bsdfs import grey
from slbench.scene.materials import Material
from slbench.scene.model import Light, Scene, SceneObject
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.optics import properties_from_device
from slbench.simulate.render.plugins.register import register


def bsdf_dict(material: Material) -> dict[str, Any]:
    """Return a material as a Mitsuba BSDF; both sides of every face scatter."""
    return {"type": "twosided", "bsdf": material.bsdf.mitsuba()}


@dataclass(frozen=True, eq=False)
class Shape:
    """One part of one object as Mitsuba sees it: triangles of one material.

    Parameters
    ----------
    name : str
    object_id : int
        Index of the object in the scene.
    vertices : (n, 3) float
        World coordinates, mm; those of the whole object.
    faces : (m, 3) int
    material : Material
    """

    name: str
    object_id: int
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: Material

    def corners(self, faces: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the corners (k, 3, 3) of the triangles of the given indices (k,)."""
        return self.vertices[self.faces[faces]]

    def mesh(self) -> Any:
        """Return the shape as a Mitsuba mesh, in single precision."""
        props = mi.Properties()
        props["bsdf"] = mi.load_dict(bsdf_dict(self.material))
        used, faces = np.unique(self.faces, return_inverse=True)
        # No vertex normals: artefacts have sharp edges, and their facets are the truth.
        result = mi.Mesh(self.name, len(used), len(self.faces), props=props)
        params = mi.traverse(result)
        params["vertex_positions"] = mi.Float(self.vertices[used].astype(np.float32).ravel())
        params["faces"] = mi.UInt32(faces.ravel().astype(np.uint32))
        params.update()
        return result


def shapes(objects: Iterable[SceneObject]) -> list[Shape]:
    """Return the shapes of a scene in Mitsuba's order: objects in turn, each part by part."""
    found: list[Shape] = []
    for k, item in enumerate(objects):
        mesh = item.artefact.mesh.transformed(item.pose.rotation, item.pose.position)
        for part, faces in item.artefact.parts.items():
            found.append(
                Shape(
                    f"object{k:03d}_{len(found):03d}",
                    k,
                    mesh.vertices,
                    mesh.faces[faces],
                    item.materials.get(part, item.material),
                )
            )
    return found


def geometry(objects: tuple[SceneObject, ...]) -> Any:
    """Return a Mitsuba scene of the objects' :func:`shapes` alone.

    The last one is kept: truth, light and every setting of a focus stack see the same objects,
    and building their meshes and trees takes as long as tracing a small picture.
    """
    return _geometry(objects, mi.variant())


@lru_cache(maxsize=1)  # objects are equal only if they are the same
def _geometry(objects: tuple[SceneObject, ...], variant: str) -> Any:
    register()
    meshes = {shape.name: shape.mesh() for shape in shapes(objects)}
    return mi.load_dict({"type": "scene", **meshes}, parallel=False, optimize=False)


def shape_indices(geometry_scene: Any) -> dict[int, int]:
    """Return the index into :func:`shapes` of each shape, by Dr.Jit's instance id."""
    return {
        int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]): k
        for k, shape in enumerate(geometry_scene.shapes())
    }


def pose_matrix(pose: Pose) -> NDArray[np.float64]:
    """Return a pose as a (4, 4) matrix from device to world coordinates."""
    matrix = np.eye(4)
    matrix[:3, :3] = pose.rotation
    matrix[:3, 3] = pose.position
    return matrix


def _to_world(pose: Pose) -> Any:
    # Mitsuba's devices have x left and y up, ours x right and y down.
    return mi.ScalarTransform4f((pose_matrix(pose) @ np.diag([-1.0, -1.0, 1.0, 1.0])).tolist())


def _fov_deg(device: Device) -> float:
    width = device.width * device.pitch_mm[0]
    return float(np.rad2deg(2.0 * np.arctan(width / (2.0 * device.lens.focal_length_mm))))


def beyond_stock(device: Device) -> list[str]:
    """List what a device has that Mitsuba's stock plugins cannot express."""
    projector = hasattr(device, "flux_w")
    centre = ((device.width - 1) / 2.0, (device.height - 1) / 2.0)
    spread = device.spread
    findings = {
        "lens distortion": any(device.distortion),
        "sensor tilt": any(device.tilt_rad),
        "a telecentric lens": device.lens.kind == "telecentric",
        "pixels that are not square": device.pitch_mm[0] != device.pitch_mm[1],
        "a principal point off centre": device.centre != centre,
        "an aperture": projector and device.lens.defocusing_radius_mm > 0,
        "diffraction": spread.diffraction_px > 0,
        "blur": spread.blur_px > 0,
        "natural vignetting": projector and device.lens.natural_vignetting,
    }
    return [name for name, present in findings.items() if present]


def camera_dict(camera: Camera, samples: int, seen: Any = None) -> dict[str, Any]:
    """Return a camera as a Mitsuba sensor; `seen` is the :func:`geometry` that it looks at."""
    sensor: dict[str, Any] = {
        "to_world": _to_world(camera.pose),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": samples},
    }
    if beyond_stock(camera):
        if seen is not None and camera.spread.diffraction_px > 0:
            sensor["geometry"] = seen
        return {"type": "slbench_camera", **properties_from_device(camera), **sensor}
    sensor |= {"fov": _fov_deg(camera), "near_clip": 0.1, "far_clip": 1e5}
    if camera.lens.defocusing_radius_mm == 0:
        return {"type": "perspective", **sensor}
    return {
        "type": "thinlens",
        "aperture_radius": camera.lens.aperture_radius_mm,
        "focus_distance": min(camera.lens.focus_distance_mm, 1e6),
        **sensor,
    }


def projector_dict(projector: Projector, picture: dict[str, Any]) -> dict[str, Any]:
    """Return a projector as a Mitsuba emitter that shows a texture."""
    emitter: dict[str, Any] = {"to_world": _to_world(projector.pose), "irradiance": picture}
    if beyond_stock(projector):
        return {
            "type": "thinlens_projector",
            **properties_from_device(projector),
            "scale": projector.axial_intensity,
            **emitter,
        }
    # Mitsuba's projector multiplies by pi.
    return {
        "type": "projector",
        "fov": _fov_deg(projector),
        "scale": projector.axial_intensity / np.pi,
        **emitter,
    }


def _picture(projector: Projector, pattern: ArrayLike) -> NDArray[np.float32]:
    panel = np.asarray(pattern, dtype=np.float32)
    expected = (projector.height, projector.width)
    if panel.shape != expected or not np.all(np.isfinite(panel)):
        raise InputError("pattern", f"a finite picture of shape {expected}", panel.shape)
    return panel


def mitsuba_dict(scene: Scene, pattern: ArrayLike, samples: int | None = None) -> dict[str, Any]:
    """Return the scene as a dictionary for ``mitsuba.load_dict``.

    Parameters
    ----------
    scene : Scene
    pattern : (H, W) float
        Radiance of the panel relative to white (after the panel's response).
    samples : int, optional
        Samples a pixel; the scene's if not given.

    Returns
    -------
    dict
        With integrator ``path`` of the scene's number of bounces.
    """
    register()
    picture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(_picture(scene.rig.projector, pattern)[..., None]),
        # A DMD pixel is a square of one value.
        "raw": True,
        "filter_type": "nearest",
        "wrap_mode": "clamp",
        "accel": False,
    }
    result: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2 + scene.light.bounces, "rr_depth": 1000},
        "camera": camera_dict(scene.rig.camera, samples or scene.samples, geometry(scene.objects)),
        "projector": projector_dict(scene.rig.projector, picture),
    }
    result |= {shape.name: shape.mesh() for shape in shapes(scene.objects)}
    if scene.light.ambient_w_per_mm2 > 0:
        result["ambient"] = _ambient(scene.light)
    return result


def _ambient(light: Light) -> dict[str, Any]:
    return {"type": "constant", "radiance": grey(light.ambient_w_per_mm2 / np.pi)}


def export_xml(scene: Scene, path: str | Path, pattern: ArrayLike) -> list[Path]:
    """Write the scene for Mitsuba's own command line: XML, meshes (PLY) and the panel (EXR).

    Parameters
    ----------
    scene : Scene
    path : path of the XML file; the other files stand beside it, named after it
    pattern : (H, W) float
        As for :func:`mitsuba_dict`.

    Returns
    -------
    list of Path
        The files written, the XML first.

    Raises
    ------
    InputError
        If a device needs a plugin that stock Mitsuba does not have, naming the reason.
    """
    register()
    for device, name in ((scene.rig.camera, "camera"), (scene.rig.projector, "projector")):
        reasons = beyond_stock(device)
        if reasons:
            raise InputError(
                f"scene {scene.name}: {name}",
                "a device that Mitsuba's stock plugins can express",
                " and ".join(reasons),
            )
    target, panel = Path(path), _picture(scene.rig.projector, pattern)
    panel_name = f"{target.stem}-panel.exr"
    names = [target.name, panel_name]
    picture = {
        "type": "bitmap",
        "filename": panel_name,
        "raw": True,
        "filter_type": "nearest",
        "wrap_mode": "clamp",
    }
    content: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2 + scene.light.bounces, "rr_depth": 1000},
        "camera": camera_dict(scene.rig.camera, scene.samples),
        "projector": projector_dict(scene.rig.projector, picture),
    }
    if scene.light.ambient_w_per_mm2 > 0:
        content["ambient"] = _ambient(scene.light)
    output, parameters = files_beside("export", target), {"scene": scene.specification}
    with output.writing(target.parent, parameters, None) as temporary:
        write_exr(temporary / panel_name, {"Y": panel})
        for shape in shapes(scene.objects):
            mesh_name = f"{target.stem}-{shape.name}.ply"
            with native_writing(temporary / mesh_name):
                shape.mesh().write_ply(str(temporary / mesh_name))
            names.append(mesh_name)
            content[shape.name] = {
                "type": "ply",
                "filename": mesh_name,
                "face_normals": True,
                "bsdf": bsdf_dict(shape.material),
            }
        state = mi.parser.parse_dict(mi.parser.ParserConfig(mi.variant()), content)
        mi.parser.write_file(state, str(temporary / target.name), add_section_headers=True)
    return [target.with_name(name) for name in [*names, output.provenance]]
