"""Make the free-form meshes of ``mixed.toml``: ``python make_meshes.py``.

Shapes without a flat face or a tooth: a lumpy ball, a knotted tube, an angle bracket.  They
are ours, so that a data set made of them may be given away.
"""

from pathlib import Path

import manifold3d
import numpy as np
import trimesh

from slbench.core.io import write_ply

FOLDER = Path(__file__).parent / "meshes"


def blob() -> trimesh.Trimesh:
    """Return a ball of 10 mm radius with smooth lumps of some 2 mm."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    x, y, z = ball.vertices.T
    lumps = (
        np.sin(3 * x + 1) * np.cos(2 * y) + 0.7 * np.sin(4 * z + 2 * x) + 0.5 * np.cos(5 * y - z)
    )
    return trimesh.Trimesh(ball.vertices * (10.0 + 1.2 * lumps)[:, None], ball.faces)


def knot() -> trimesh.Trimesh:
    """Return a trefoil of tube radius 2.5 mm, some 30 mm wide."""
    along, around = 160, 20
    t = np.linspace(0.0, 2.0 * np.pi, along, endpoint=False)
    line = 4.6 * np.stack(
        [np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1
    )
    tangent = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    vertices = (line[:, None] + 2.5 * ring).reshape(-1, 3)
    i, k = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    i1, k1 = (i + 1) % along, (k + 1) % around
    a, b, c, d = ((p * around + q).ravel() for p, q in ((i, k), (i1, k), (i1, k1), (i, k1)))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return trimesh.Trimesh(vertices, faces)


def bracket() -> trimesh.Trimesh:
    """Return an angle bracket of 30 x 20 x 15 mm with a rib and two holes."""
    solid = manifold3d.Manifold
    plate = solid.cube((30.0, 20.0, 3.0), True)
    wall = solid.cube((3.0, 20.0, 15.0), True).translate((-13.5, 0.0, 6.0))
    profile = manifold3d.CrossSection([[(-12.0, 0.0), (2.0, 0.0), (-12.0, 10.0)]])
    rib = profile.extrude(3.0).rotate((90.0, 0.0, 0.0)).translate((0.0, 1.5, 1.5))
    hole = solid.cylinder(10.0, 3.0, 3.0, 48, True)
    body = (plate + wall + rib) - hole.translate((8.0, 0.0, 0.0))
    mesh = (body - hole.rotate((0.0, 90.0, 0.0)).translate((-13.5, -5.5, 9.0))).to_mesh()
    return trimesh.Trimesh(np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts))


if __name__ == "__main__":
    for make in (blob, knot, bracket):
        shape = make()
        if shape.volume < 0:
            shape.invert()
        assert shape.is_watertight, make.__name__
        write_ply(FOLDER / f"{make.__name__}.ply", shape.vertices, {}, shape.faces)
        print(make.__name__, shape.extents, len(shape.faces))
