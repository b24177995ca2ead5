"""Parts with known occlusions and the scenes that look at them, for planning of views."""

import functools
from dataclasses import replace

import numpy as np
from scenes_small import small

from slbench import objects
from slbench.objects import Artefact, Mesh
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.scene.model import Scene, SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material

#: Corners of the L's outline in x and z, mm: a floor 30 long at z = 10, and a wall 30 high.
L_OUTLINE = np.array([(0, 0), (40, 0), (40, 10), (10, 10), (10, 40), (0, 40)], float) - (20, 20)
L_WIDTH = 30.0


@functools.cache
def l_block() -> Artefact:
    """Return an L-shaped block: `L_OUTLINE` in x and z, `L_WIDTH` along y, about the origin."""
    count = len(L_OUTLINE)
    front = np.column_stack((L_OUTLINE[:, 0], np.full(count, -L_WIDTH / 2), L_OUTLINE[:, 1]))
    vertices = np.vstack((front, front + np.array([0.0, L_WIDTH, 0.0])))
    caps = [(0, k, k + 1) for k in range(1, count - 1)]  # the corner (0, 0) sees all others
    faces = [*caps, *((a + count, c + count, b + count) for a, b, c in caps)]
    for k in range(count):
        n = (k + 1) % count
        faces += [(k, k + count, n), (n, k + count, n + count)]
    mesh = Mesh(vertices, np.array(faces))
    assert mesh.is_watertight
    assert np.isclose(mesh.volume, (40 * 10 + 10 * 30) * L_WIDTH)
    return Artefact("l-block", "mesh", {}, mesh, {})


def part_scene(artefact: Artefact, divisor: int = 4, albedo: float = 0.7) -> Scene:
    """Return the shipped macro rig with a matt part in the origin."""
    scene = small("plane", divisor=divisor)
    part = SceneObject(artefact, Pose(), Material(Diffuse(albedo=albedo)))
    specification = {**scene.specification, "objects": [{"artefact": artefact.name}]}
    return replace(scene, objects=(part,), specification=specification)


def shipped_part(name: str, divisor: int = 4) -> Scene:
    """Return the shipped macro rig with a shipped artefact."""
    return part_scene(objects.load_artefact(name), divisor)


def above(scene: Scene, projector_at: tuple[float, float, float]) -> Scene:
    """Return a scene with pinholes: a camera 600 mm above the origin, a projector elsewhere."""
    lens = Lens(16.0, 0.0, 600.0)
    down = (0.0, -1.0, 0.0)
    camera = Camera(
        640, 480, (0.0074, 0.0074), lens, pose=Pose.looking_at((0.0, 0.0, 600.0), (0, 0, 0), down)
    )
    projector = Projector(
        640, 480, (0.0108, 0.0108), lens, pose=Pose.looking_at(projector_at, (0, 0, 0), down)
    )
    return replace(scene, rig=Rig(camera, projector, (200.0, 200.0, 200.0)))
