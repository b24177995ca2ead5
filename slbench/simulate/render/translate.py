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

from slbench.core.errors import InputError, warn_user
from slbench.core.io import files_beside, write_exr
from slbench.core.io.atomic import native_writing
from slbench.objects import Mesh
from slbench.rig import Camera, Device, Pose, Projector
from slbench.scene.model import Light, Scene, SceneObject
from slbench.scene.surfaces.bsdfs import grey
from slbench.scene.surfaces.materials import Material
from slbench.scene.surfaces.textures import VERTEX_ALBEDO, OfVertices
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.optics import properties_from_device
from slbench.simulate.render.plugins.register import register


def bsdf_dict(material: Material) -> dict[str, Any]:
    """Return a material as a Mitsuba BSDF; both sides of every face scatter, unless it is clear."""
    found = _taken_in(material.bsdf.scattering())
    interior = material.bsdf.interior
    if interior is not None and interior.clear:
        return dict(found)
    return {"type": "twosided", "bsdf": found}


def _taken_in(item: Any) -> Any:
    """Return a dictionary whose arrays are Mitsuba's pictures and transforms."""
    if isinstance(item, dict):
        return {key: _taken_in(value) for key, value in item.items()}
    if isinstance(item, np.ndarray):
        if item.shape == (3, 3):
            return mi.ScalarTransform3f(item.tolist())
        return mi.Bitmap(np.ascontiguousarray(item, dtype=np.float32))
    return item


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
    uv : (m, 3, 2) float, optional
        Texture coordinates at the corners of the faces, v downwards as in a picture.
    albedo : (m, 3) float, optional
        Values at the corners.
    normals : (m, 3, 3) float, optional
        Shading normals at the corners, in the world.
    """

    name: str
    object_id: int
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: Material
    uv: NDArray[np.float64] | None = None
    albedo: NDArray[np.float64] | None = None
    normals: NDArray[np.float64] | None = None

    def corners(self, faces: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the corners (k, 3, 3) of the triangles of the given indices (k,)."""
        return self.vertices[self.faces[faces]]

    def looks(self) -> dict[str, dict[str, Any]]:
        """Return BSDF and medium for Mitsuba's own integrators; a medium's boundary is none."""
        interior = self.material.bsdf.interior
        if interior is None or interior.clear:
            return {"bsdf": bsdf_dict(self.material)}
        return {"bsdf": {"type": "null"}, "interior": interior.mitsuba()}

    def mesh(self, media: bool = False) -> Any:
        """Return the shape as a Mitsuba mesh, in single precision.

        Parameters
        ----------
        media : bool
            As :meth:`looks`, instead of what the surface alone reflects.
        """
        props = mi.Properties()
        for name, item in (self.looks() if media else {"bsdf": bsdf_dict(self.material)}).items():
            props[name] = mi.load_dict(item)
        # Without vertex normals as a rule: artefacts have sharp edges, and facets are the truth.
        used, faces, (uv, albedo, normals) = self._split()
        textured, smooth = uv is not None, normals is not None
        result = mi.Mesh(
            *(self.name, len(used), len(self.faces)),
            props=props,
            has_vertex_normals=smooth,
            has_vertex_texcoords=textured,
        )
        if albedo is not None:
            result.add_attribute(VERTEX_ALBEDO, 1, albedo.astype(np.float32).ravel())
        params = mi.traverse(result)
        params["vertex_positions"] = mi.Float(self.vertices[used].astype(np.float32).ravel())
        params["faces"] = mi.UInt32(faces.ravel().astype(np.uint32))
        if textured:
            params["vertex_texcoords"] = mi.Float(uv.astype(np.float32).ravel())
        if smooth:
            params["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
        params.update()
        return result

    def _split(self) -> tuple[NDArray[np.int64], NDArray[np.int64], list[Any]]:
        """Return vertices, faces of them, and what stands at each; seams have several a place."""
        values = (self.uv, self.albedo, self.normals)
        if all(one is None for one in values):
            used, faces = np.unique(self.faces, return_inverse=True)
            return used, faces, [None, None, None]
        corner = self.faces.reshape(-1, 1).astype(np.float64)
        flat = [None if one is None else one.reshape(len(corner), -1) for one in values]
        rows = np.concatenate([corner, *(one for one in flat if one is not None)], axis=1)
        order = np.lexsort(rows.T)
        is_new = np.concatenate([[True], (np.diff(rows[order], axis=0) != 0).any(axis=1)])
        faces = np.empty(len(rows), dtype=np.int64)
        faces[order] = np.cumsum(is_new) - 1
        first = order[is_new]
        kept = [None if one is None else one[first] for one in flat]
        return self.faces.ravel()[first], faces, kept


def shapes(objects: Iterable[SceneObject]) -> list[Shape]:
    """Return the shapes of a scene in Mitsuba's order: objects in turn, each part by part."""
    found: list[Shape] = []
    for k, item in enumerate(objects):
        mesh = item.artefact.mesh.transformed(item.pose.rotation, item.pose.position)
        for part, faces in item.artefact.parts.items():
            material = item.material_of(part)
            found.append(
                Shape(
                    f"object{k:03d}_{len(found):03d}",
                    k,
                    mesh.vertices,
                    mesh.faces[faces],
                    material,
                    _coordinates(item.artefact.mesh, faces, material),
                    _known(_at_vertices(mesh, material), faces),
                    _known(mesh.normals, faces),
                )
            )
    return found


def _at_vertices(mesh: Mesh, material: Material) -> NDArray[np.float64] | None:
    """Return the values at the corners of a mesh's faces (m, 3) that a material has, if any."""
    for texture in material.bsdf.textures.values():
        if isinstance(texture, OfVertices):
            if texture.band is None or mesh.colours is None:
                return mesh.albedo
            return mesh.colours[..., texture.band]
    return None


def _known(
    corners: NDArray[np.float64] | None, faces: NDArray[np.int64]
) -> NDArray[np.float64] | None:
    """Return values at the corners of faces; None where they have none."""
    found = None if corners is None else corners[faces]
    return found if found is not None and np.isfinite(found).all() else None


def _coordinates(
    mesh: Mesh, faces: NDArray[np.int64], material: Material
) -> NDArray[np.float64] | None:
    """Return the texture coordinates that a material needs on faces, v downwards."""
    if not material.bsdf.mappings:
        return None
    if "uv" in material.bsdf.mappings:
        assert mesh.uv is not None  # by Material.on
        return np.stack([mesh.uv[faces][..., 0], 1.0 - mesh.uv[faces][..., 1]], axis=-1)
    corners = mesh.vertices[mesh.faces[faces]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Seen from outside, u to the right and v down; a rounding must not tip a face over.
    size = np.abs(normal)
    axis = np.argmax(size > 0.999 * size.max(axis=1, keepdims=True), axis=1)
    u, v = np.array([[1, 2], [0, 2], [0, 1]])[axis].T
    rows = np.arange(len(corners))
    along = np.stack([corners[rows, :, u], -corners[rows, :, v]], axis=-1)
    # x, y and z as they are where the face looks to +x, -y or +z; mirrored from behind.
    mirrored = (normal[rows, axis] < 0) != (axis == 1)
    along[mirrored, :, 0] *= -1.0
    return along


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
        With integrator ``path`` of the scene's number of bounces; where objects are translucent,
        ``volpath`` without end.

    Raises
    ------
    InputError
        For a translucent material that refracts.
    """
    parts = shapes(scene.objects)
    integrator = _integrator(scene, parts)
    register()
    _check_one_band(scene)
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
        "integrator": integrator,
        "camera": camera_dict(scene.rig.camera, samples or scene.samples, geometry(scene.objects)),
        "projector": projector_dict(scene.rig.projector, picture),
    }
    result |= {shape.name: shape.mesh(media=True) for shape in parts}
    if scene.light.has_surroundings:
        result["ambient"] = surroundings_dict(scene.light)
    return result


def _integrator(scene: Scene, parts: Iterable[Shape]) -> dict[str, Any]:
    """Return Mitsuba's integrator for a scene."""
    insides = [i for shape in parts if (i := shape.material.bsdf.interior) is not None]
    scattering = [inside for inside in insides if not inside.clear]
    if any(inside.eta != 1.0 for inside in scattering):
        expected = (
            "eta = 1 for translucent materials: Mitsuba's projector cannot be reached through"
        )
        raise InputError(f"scene {scene.name}", expected + " a boundary that refracts", "others")
    if len(insides) > len(scattering):
        why = "Mitsuba's projector lights nothing behind it, and its faces count as bounces"
        warn_user(f"scene {scene.name}: glass", why)
    if scattering:
        return {"type": "volpath", "max_depth": -1, "rr_depth": 1000}
    return {"type": "path", "max_depth": 2 + scene.light.bounces, "rr_depth": 1000}


#: From the axes of Mitsuba's maps (left, up, ahead) to ours (ahead, left, up).
_MAP_AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def surroundings_dict(light: Light) -> dict[str, Any]:
    """Return the light that comes from around as one Mitsuba emitter."""
    uniform, environment = light.ambient_w_per_mm2 / np.pi, light.environment
    if environment is None:
        return {"type": "constant", "radiance": grey(uniform)}
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(environment.axes) @ _MAP_AXES
    radiance = environment.radiance.values + np.float32(uniform)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(radiance[..., np.newaxis]),
        "to_world": mi.ScalarTransform4f(matrix.tolist()),
    }


def _check_one_band(scene: Scene) -> None:
    if scene.colour is not None:
        expected = 'one band of light: scene.in_band("green"), or a file without [colour]'
        raise InputError(f"scene {scene.name}: colour", expected, "three")


def _written(item: Any, folder: Path, stem: str, names: list[str]) -> Any:
    """Return a BSDF whose pictures are EXR files in a folder, and add their names."""
    if not isinstance(item, dict):
        return item
    item = {key: _written(value, folder, stem, names) for key, value in item.items()}
    if "bitmap" in item:
        values = np.atleast_3d(np.array(item.pop("bitmap")))
        name = f"{stem}-{len(names)}.exr"
        channels = ("Y",) if values.shape[2] == 1 else ("R", "G", "B")
        write_exr(folder / name, {c: values[..., k] for k, c in enumerate(channels)})
        names.append(name)
        item["filename"] = name
    return item


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
        If a device needs a plugin that stock Mitsuba does not have, naming the reason; for a
        translucent material that refracts.
    """
    register()
    _check_one_band(scene)
    for device, name in ((scene.rig.camera, "camera"), (scene.rig.projector, "projector")):
        reasons = beyond_stock(device)
        if reasons:
            raise InputError(
                f"scene {scene.name}: {name}",
                "a device that Mitsuba's stock plugins can express",
                " and ".join(reasons),
            )
    parts = shapes(scene.objects)
    integrator = _integrator(scene, parts)
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
        "integrator": integrator,
        "camera": camera_dict(scene.rig.camera, scene.samples),
        "projector": projector_dict(scene.rig.projector, picture),
    }
    output, parameters = files_beside("export", target), {"scene": scene.specification}
    with output.writing(target.parent, parameters, None) as temporary:
        if scene.light.has_surroundings:
            around = surroundings_dict(scene.light)
            content["ambient"] = _written(around, temporary, f"{target.stem}-around", names)
        write_exr(temporary / panel_name, {"Y": panel})
        for shape in parts:
            mesh_name = f"{target.stem}-{shape.name}.ply"
            with native_writing(temporary / mesh_name):
                shape.mesh().write_ply(str(temporary / mesh_name))
            names.append(mesh_name)
            content[shape.name] = {
                "type": "ply",
                "filename": mesh_name,
                "face_normals": shape.normals is None,
                **_written(shape.looks(), temporary, mesh_name[:-4], names),
            }
        state = mi.parser.parse_dict(mi.parser.ParserConfig(mi.variant()), content)
        mi.parser.write_file(state, str(temporary / target.name), add_section_headers=True)
    return [target.with_name(name) for name in [*names, output.provenance]]
