"""Export in the layout of the BOP benchmark, with the projector as an extension.

The format is that of ``docs/bop_datasets_format.md`` of the BOP toolkit (Hodan et al., "BOP:
Benchmark for 6D Object Pose Estimation", ECCV 2018)::

    OUT/camera.json                       of the first image
    OUT/models/obj_000001.ply             mm, origin at the middle of the bounding box
    OUT/models/models_info.json           diameter, box; name and kind, origin_mm (extension)
    OUT/train/000000/scene_camera.json    cam_K, depth_scale, cam_R_w2c, cam_t_w2c
    OUT/train/000000/scene_gt.json        cam_R_m2c, cam_t_m2c, obj_id
    OUT/train/000000/scene_gt_info.json   boxes and pixel counts of silhouettes
    OUT/train/000000/gray/000000.png      the scene fully lit by the projector
    OUT/train/000000/depth/000000.png     16 bit; times depth_scale: mm along z
    OUT/train/000000/mask/000000_000000.png, mask_visib/000000_000000.png

A sample is an image, a thousand of them a scene folder.  The extension, which other readers
do not see::

    OUT/train/000000/scene_projector.json    for every image: proj_K, proj_dist, proj_size,
                                             R_c2p, t_c2p (x_p = R x_c + t, mm), patterns,
                                             frames, sample
    OUT/train/000000/frames/000000_000.png   the pattern frames, in order

``mask`` is the object's silhouette with nothing before it, ``mask_visib`` what the camera
sees of it, from the ground truth's object ids (the toolkit estimates it from depth).  Distractors
are in the pictures alone.

BOP's camera is a pinhole.  Where a lens distorts or the sensor is tilted, pictures are undistorted
onto the pinhole of ``cam_K`` (``cv2.initUndistortRectifyMap``, linear interpolation), and depth and
masks are those of the meshes seen by that pinhole; what the sensor does not see is 0 in all of
them.  ``camera_dist`` of the extension tells the coefficients that were taken out.  Telecentric
lenses are refused.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

from slbench.core.errors import InputError
from slbench.core.io import write_json, write_ply, write_png
from slbench.datasets.export.frames import depth_scale, scaled_depth, write_index
from slbench.datasets.export.raster import depth_of_mesh
from slbench.datasets.export.registry import Exporter
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.read.stored import Sample
from slbench.objects import Artefact
from slbench.rig import Camera
from slbench.scene.model import SceneObject

#: Images a scene folder, as in BOP's rendered training sets.
_PER_SCENE = 1000
_NOTHING = [-1, -1, -1, -1]
#: Rows of the distance matrix at a time.
_BLOCK = 512


@dataclass
class _Models:
    """Models written so far; equal meshes are one model."""

    folder: Path
    ids: dict[str, int] = field(default_factory=dict)
    info: dict[str, Any] = field(default_factory=dict)

    def add(self, artefact: Artefact) -> tuple[int, NDArray[np.float64]]:
        """Return an artefact's object id, and the model's origin in the object frame."""
        mesh = artefact.mesh
        origin = mesh.bounds.mean(axis=0)
        digest = hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()
        if digest not in self.ids:
            number = self.ids[digest] = len(self.ids) + 1
            normals = dict(zip(("nx", "ny", "nz"), mesh.as_trimesh.vertex_normals.T, strict=True))
            path = self.folder / f"obj_{number:06d}.ply"
            write_ply(path, mesh.vertices - origin, normals, mesh.faces)
            low, high = mesh.bounds - origin
            self.info[str(number)] = {
                "diameter": diameter(mesh.vertices),
                **{f"min_{axis}": low[k] for k, axis in enumerate("xyz")},
                **{f"size_{axis}": high[k] - low[k] for k, axis in enumerate("xyz")},
                "name": artefact.name,
                "kind": artefact.kind,
                "origin_mm": origin,
            }
        return self.ids[digest], origin


def write_bop(data: Dataset, recipe: Recipe, folder: Path) -> Iterator[int]:
    """Write a selection as a BOP data set.

    Parameters
    ----------
    data : Dataset
    recipe : Recipe
        Of the pattern frames.
    folder : Path
        An empty one.

    Yields
    ------
    int
        Samples written so far.

    Raises
    ------
    InputError
        For a telecentric camera.
    """
    models = _Models(folder / "models")
    write_index(folder / "index.csv", data)
    for first in range(0, len(data), _PER_SCENE):
        scene = folder / "train" / f"{first // _PER_SCENE:06d}"
        files: dict[str, dict[str, Any]] = {
            name: {} for name in ("camera", "gt", "gt_info", "projector")
        }
        for image, item in enumerate(data[first : first + _PER_SCENE]):
            for name, content in _write_image(item, recipe, scene, image, models).items():
                files[name][str(image)] = content
            if first == image == 0:
                write_json(folder / "camera.json", _sensor(item.rig.camera, files["camera"]["0"]))
            yield first + image + 1
        for name, values in files.items():
            write_json(scene / f"scene_{name}.json", values)
    write_json(folder / "models" / "models_info.json", models.info)


def _write_image(
    item: Sample, recipe: Recipe, scene: Path, image: int, models: _Models
) -> dict[str, Any]:
    """Write one sample's pictures and return its entries of the scene's files."""
    camera, projector = item.rig.camera, item.rig.projector
    if camera.lens.kind != "perspective":
        raise InputError(item.where, "for BOP a perspective camera", camera.lens.kind)
    name, view = f"{image:06d}", _view(item)
    shots = recipe.shots(item)
    lit = recipe.lit(item)
    write_png(scene / "gray" / f"{name}.png", view.picture(lit.frames[0]))
    frames = [f"frames/{name}_{k:03d}.png" for k in range(len(shots.frames))]
    for file, frame in zip(frames, shots.frames, strict=True):
        write_png(scene / file, view.picture(frame))
    scale = depth_scale(view.depth)
    depth = scaled_depth(view.depth, scale)
    write_png(scene / "depth" / f"{name}.png", depth)

    poses: list[dict[str, Any]] = []
    information: list[dict[str, Any]] = []
    for number, placed in enumerate(item.scene.objects):
        if placed.distractor:
            continue
        model, origin = models.add(placed.artefact)
        rotation = camera.pose.rotation.T @ placed.pose.rotation
        translation = camera.pose.to_local(placed.pose.to_world(origin))
        poses.append({"cam_R_m2c": rotation.ravel(), "cam_t_m2c": translation, "obj_id": model})
        whole = silhouette(placed, camera) > 0
        visible = view.object_id == number
        height, width = visible.shape
        inside = _middle(whole) | visible
        for kind, mask in (("mask", inside), ("mask_visib", visible)):
            picture = np.where(mask, 255, 0).astype(np.uint8)
            write_png(scene / kind / f"{name}_{len(information):06d}.png", picture)
        _middle(whole)[:] = inside
        seen, total = int(visible.sum()), int(whole.sum())
        information.append(
            {
                "bbox_obj": box(whole, (width, height)) if seen else _NOTHING,
                "bbox_visib": box(visible),
                "px_count_all": total,
                "px_count_valid": int((depth[inside] > 0).sum()),
                "px_count_visib": seen,
                "visib_fract": seen / total if total else 0.0,
            }
        )
    world = camera.pose.to_local(np.zeros(3))
    return {
        "camera": {
            "cam_K": camera.matrix.ravel(),
            "depth_scale": scale,
            "cam_R_w2c": camera.pose.rotation.T.ravel(),
            "cam_t_w2c": world,
        },
        "gt": poses,
        "gt_info": information,
        "projector": {
            "proj_K": projector.matrix.ravel(),
            "proj_dist": projector.opencv_distortion,
            "proj_size": [projector.width, projector.height],
            "R_c2p": (projector.pose.rotation.T @ camera.pose.rotation).ravel(),
            "t_c2p": projector.pose.to_local(camera.pose.position),
            "patterns": shots.sequence.to_dict(),
            "frames": frames,
            "sample": item.number,
            "camera_dist": camera.opencv_distortion if view.maps else [],
        },
    }


def _sensor(camera: Camera, entry: dict[str, Any]) -> dict[str, Any]:
    matrix = camera.matrix
    return {
        "cx": matrix[0, 2],
        "cy": matrix[1, 2],
        "depth_scale": entry["depth_scale"],
        "fx": matrix[0, 0],
        "fy": matrix[1, 1],
        "height": camera.height,
        "width": camera.width,
    }


@dataclass(frozen=True)
class _View:
    """What a pinhole camera sees of a sample.

    Parameters
    ----------
    depth : (V, U) float
        mm; NaN where no surface is.
    object_id : (V, U) int
        Negative where none is.
    maps : tuple of two (V, U) float32
        Where pixels stand in the sensor's picture, ``u`` and ``v``; none where in the same place.
    """

    depth: NDArray[np.float64]
    object_id: NDArray[np.signedinteger]
    maps: tuple[NDArray[np.float32], ...] = ()

    def picture(self, frame: NDArray[Any]) -> NDArray[Any]:
        """Return a frame of the sensor as the pinhole sees it."""
        return cv2.remap(frame, *self.maps, cv2.INTER_LINEAR) if self.maps else frame


def _view(item: Sample) -> _View:
    """Return what the pinhole of a sample's camera sees, its lens undone."""
    camera, truth = item.rig.camera, item.truth
    if not any(camera.distortion) and not any(camera.tilt_rad):
        return _View(truth.depth, truth.object_id)
    size, matrix = (camera.width, camera.height), camera.matrix
    given = (matrix, camera.opencv_distortion, np.eye(3), matrix, size, cv2.CV_32FC1)
    maps = tuple(cv2.initUndistortRectifyMap(*given))
    sensor = (maps[0] >= 0.0) & (maps[0] <= size[0] - 1.0)
    sensor &= (maps[1] >= 0.0) & (maps[1] <= size[1] - 1.0)
    depth = np.full(sensor.shape, np.inf)
    object_id = np.full(sensor.shape, -1)
    for number, placed in enumerate(item.scene.objects):
        own = _middle(silhouette(placed, camera))
        nearer = sensor & (own > 0) & (own < depth)
        depth[nearer], object_id[nearer] = own[nearer], number
    return _View(np.where(object_id < 0, np.nan, depth), object_id, maps)


def _middle(canvas: NDArray[Any]) -> NDArray[Any]:
    """Return the image in the middle of a canvas of :func:`silhouette`."""
    height, width = canvas.shape[0] // 3, canvas.shape[1] // 3
    return canvas[height : 2 * height, width : 2 * width]


def silhouette(placed: SceneObject, camera: Camera) -> NDArray[np.float64]:
    """Return the depth of an object alone on a canvas of three images' width and height.

    BOP counts the part of a silhouette beyond the image too, on a canvas of that size with
    the image in the middle.

    Returns
    -------
    (3 V, 3 U) float
        mm; 0 where the object is not.
    """
    width, height = camera.width, camera.height
    matrix = camera.matrix
    matrix[:2, 2] += width, height
    mesh = placed.artefact.mesh
    points = camera.pose.to_local(placed.pose.to_world(mesh.vertices))
    return depth_of_mesh(points, mesh.faces, matrix, (3 * width, 3 * height))


def box(mask: NDArray[np.bool_], corner: tuple[int, int] = (0, 0)) -> list[int]:
    """Return a mask's box as the BOP toolkit does: x, y, largest less smallest x and y.

    Parameters
    ----------
    mask : (V, U) bool
    corner : (int, int)
        Pixel that counts as (0, 0).

    Returns
    -------
    list of int
        -1 four times where the mask is empty.
    """
    if not mask.any():
        return list(_NOTHING)
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return [left - corner[0], top - corner[1], width - 1, height - 1]


def diameter(points: NDArray[np.float64]) -> float:
    """Return the largest distance between any two points (n, 3)."""
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:  # flat: every point may count
        points = np.unique(points, axis=0)
    # Two points are no farther apart than the sum of their radii: inner ones drop out.
    centre = points.mean(axis=0)
    radius = np.linalg.norm(points - centre, axis=1)
    far = points[np.argmax(np.linalg.norm(points - points[np.argmax(radius)], axis=1))]
    bound = float(np.linalg.norm(points - far, axis=1).max())
    points = points[radius + radius.max() >= bound - 1e-9]
    rows = range(0, len(points), _BLOCK)
    return max(bound, *(float(cdist(points[k : k + _BLOCK], points).max()) for k in rows))


#: The row of :mod:`slbench.datasets.export.registry`.
EXPORTER = Exporter(write_bop)
