"""Stable poses of parts on a table."""

import numpy as np
from view_parts import l_block

from slbench import objects
from slbench.objects.resting import stable_poses


def test_a_cuboid_rests_on_its_faces_and_mostly_on_the_largest():
    mesh = objects.build_artefact(
        "plane", {"size_mm": [30.0, 20.0], "thickness_mm": 10.0}, "plate"
    ).mesh
    rotations, shares = stable_poses(mesh)
    heights = [np.ptp(mesh.vertices @ turn.T, axis=0)[2] for turn in rotations]
    # Two poses a face, in the order of the faces' areas as their solid angles are.
    assert np.allclose(sorted(heights), [10, 10, 20, 20, 30, 30], atol=1e-9)
    assert np.allclose(heights[:2], 10.0, atol=1e-9)
    assert np.all(np.diff(shares) <= 1e-12)
    assert abs(shares.sum() - 1.0) < 1e-9
    assert all(np.allclose(turn @ turn.T, np.eye(3), atol=1e-9) for turn in rotations)


def test_the_centre_of_mass_is_above_the_support():
    mesh = l_block().mesh
    solid = mesh.as_trimesh
    rotations, shares = stable_poses(mesh)
    assert len(shares) >= 3
    for turn in rotations:
        vertices = mesh.vertices @ turn.T
        on_table = vertices[vertices[:, 2] < vertices[:, 2].min() + 1e-6]
        assert len(on_table) >= 3
        middle = turn @ solid.center_mass
        low, high = on_table[:, :2].min(axis=0), on_table[:, :2].max(axis=0)
        assert np.all(middle[:2] > low)
        assert np.all(middle[:2] < high)
