"""Pictures of an artefact for people: orthographic, shaded, to scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slbench.objects import Artefact
from slbench.rig import Pose, box_corners
from slbench.scene.model import SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material, own_materials
from slbench.simulate.render.mitsuba import mi
from slbench.simulate.render.plugins.register import register
from slbench.simulate.render.translate import shapes

#: Azimuth and elevation of the view: the object's x axis stays horizontal to the right.
_AZIMUTH, _ELEVATION = np.deg2rad(-70.0), np.deg2rad(42.0)
_BACKGROUND = 0.95
#: Parts of targets that are shown dark where no material is asked for.
_DARK_PARTS = ("dots", "black")


def shade(
    artefact: Artefact,
    *,
    material: Material | None = None,
    materials: Mapping[str, Material] | None = None,
    size_px: int = 640,
    samples: int = 64,
) -> tuple[NDArray[np.float64], float]:
    """Render an artefact under soft light, seen obliquely from above.

    Parameters
    ----------
    artefact : Artefact
    material : Material, optional
        Of the parts that `materials` does not name; translucent ones are drawn opaque, in the
        same grey.  By default as the mesh file has it, or grey.
    materials : mapping of str to Material, optional
    size_px : int
        Width and height of the picture.
    samples : int
        Monte Carlo samples a pixel.

    Returns
    -------
    image : (size_px, size_px) float
        In [0, 1], for a display of gamma 2.2; the background is nearly white.
    mm_per_px : float
        Across the line of sight.
    """
    register()
    chosen = dict(materials or {})
    if material is None:
        dark = {
            part: Material(Diffuse(albedo=0.1)) for part in _DARK_PARTS if part in artefact.parts
        }
        chosen = dark | own_materials(artefact) | chosen
    item = SceneObject(artefact, Pose(), material or Material(Diffuse(albedo=0.6)), chosen)
    low, high = artefact.mesh.bounds
    radius = float(np.linalg.norm(high - low) / 2.0)
    centre, (right, up, toward), half = _view(artefact)
    view = mi.ScalarTransform4f().look_at(
        origin=(centre + toward * 4.0 * radius).tolist(), target=centre.tolist(), up=[0, 0, 1]
    )
    sun = right * -0.5 + up * 0.9 + toward * 0.7
    content = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4, "hide_emitters": True},
        "camera": {
            "type": "orthographic",
            "to_world": view @ mi.ScalarTransform4f().scale([half, half, 1.0]),
            "near_clip": 1e-3 * radius,
            "far_clip": 10.0 * radius,
            "film": {
                "type": "hdrfilm",
                "width": size_px,
                "height": size_px,
                "pixel_format": "luminance_alpha",
                "rfilter": {"type": "gaussian"},
            },
        },
        "sky": {"type": "constant", "radiance": 0.5},
        "sun": {"type": "directional", "direction": (-sun).tolist(), "irradiance": 2.0},
    }
    for shape in shapes([item]):
        inside = shape.material.bsdf.interior
        if inside is not None and not inside.clear:  # which this integrator does not see
            shape = replace(shape, material=Material(Diffuse(albedo=inside.diffuse_reflectance)))
        content[shape.name] = shape.mesh()
    rendered = np.asarray(mi.render(mi.load_dict(content), spp=samples, seed=0))
    light, alpha = rendered[..., 0].astype(np.float64), rendered[..., 1].astype(np.float64)
    image = np.clip(light, 0.0, 1.0) ** (1.0 / 2.2)
    return image * alpha + _BACKGROUND * (1.0 - alpha), 2.0 * half / size_px


def places(artefact: Artefact, points: NDArray[np.float64], size_px: int) -> NDArray[np.float64]:
    """Return where points (k, 3), object frame, are in the picture of :func:`shade`, (k, 2) px."""
    centre, (right, up, _), half = _view(artefact)
    across = np.stack(((points - centre) @ right, (points - centre) @ up), axis=-1)
    return np.asarray(0.5 * size_px * (1.0 + across / half * [1.0, -1.0]) - 0.5)


def _view(artefact: Artefact) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return the middle of the view (3,), its axes to the right, up and nearer (3, 3), and half."""
    low, high = artefact.mesh.bounds
    centre = (low + high) / 2.0
    toward = np.array(
        [
            np.cos(_ELEVATION) * np.cos(_AZIMUTH),
            np.cos(_ELEVATION) * np.sin(_AZIMUTH),
            np.sin(_ELEVATION),
        ]
    )
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    up = np.cross(toward, right)
    # Corners of the bounding box, seen along the view, decide the scale.
    corners = box_corners(low, high) - centre
    half = 1.08 * float(max(np.abs(corners @ right).max(), np.abs(corners @ up).max()))
    return centre, np.stack((right, up, toward)), half
