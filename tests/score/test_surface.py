"""Nearest points of meshes: against every triangle, and the sides against winding numbers."""

import numpy as np
import pytest
import trimesh

from slbench.core.errors import InputError
from slbench.objects import Mesh
from slbench.score.clouds.surface import Surface

RNG = np.random.default_rng(11)
SOLIDS = {
    "box": trimesh.creation.box((1.0, 2.0, 3.0)),
    "sphere": trimesh.creation.icosphere(3),
    "ring": trimesh.creation.annulus(1.0, 2.0, 1.0),  # not convex
    "needles": trimesh.creation.cylinder(1.0, 0.01),  # long thin faces
}


def mesh_of(solid):
    return Mesh(np.asarray(solid.vertices), np.asarray(solid.faces))


def winding_number(triangles, point):
    """Return how often a closed mesh goes round a point (Van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    lengths = [np.linalg.norm(x, axis=1) for x in (a, b, c)]
    above = np.sum(a * np.cross(b, c), axis=1)
    below = np.prod(lengths, axis=0) + sum(
        np.sum(x * y, axis=1) * z
        for x, y, z in ((a, b, lengths[2]), (b, c, lengths[0]), (c, a, lengths[1]))
    )
    return np.arctan2(above, below).sum() / (2.0 * np.pi)


@pytest.mark.parametrize("solid", SOLIDS.values(), ids=SOLIDS)
def test_distances_are_those_of_all_triangles_one_by_one(solid):
    points = RNG.uniform(-3.0, 3.0, (300, 3))
    found = Surface(mesh_of(solid)).nearest(points)
    triangles = np.asarray(solid.triangles)
    for k, point in enumerate(points):
        others = np.broadcast_to(point, (len(triangles), 3))
        nearest = trimesh.triangles.closest_point(triangles, others)
        away = np.linalg.norm(nearest - point, axis=1)
        # Two ways to compute one number in double precision.
        assert abs(found.distance[k]) == pytest.approx(away.min(), abs=1e-12)
        assert np.linalg.norm(found.point[k] - point) == pytest.approx(away.min(), abs=1e-12)
        assert away[found.face[k]] == pytest.approx(away.min(), rel=1e-6)
        inside = winding_number(triangles, point) > 0.5
        assert (found.distance[k] < 0.0) == inside


def test_beyond_the_reach_there_is_nothing():
    box = mesh_of(SOLIDS["box"])
    points = np.array([[0.5 + away, 0.0, 0.0] for away in (0.05, 0.2, 5.0)])
    found = Surface(box).nearest(points, 0.1)
    np.testing.assert_allclose(found.distance, [0.05, np.nan, np.nan], atol=1e-12)
    assert (found.face >= 0).tolist() == [True, False, False]
    assert np.isnan(found.normal[1:]).all()
    np.testing.assert_allclose(found.normal[0], [1.0, 0.0, 0.0], atol=1e-12)


def test_a_point_is_found_whatever_stood_before_it():
    """The search starts from the face of the point before: alone each point gives the same."""
    surface = Surface(mesh_of(SOLIDS["ring"]))
    points = RNG.uniform(-3.0, 3.0, (200, 3))
    together = surface.nearest(points).distance
    alone = [surface.nearest(point[np.newaxis]).distance[0] for point in points]
    np.testing.assert_array_equal(together, alone)


def test_faces_without_area_are_left_out():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]])
    surface = Surface(Mesh(vertices, np.array([[0, 1, 3], [0, 1, 2]])))
    assert surface.nearest(np.array([[1.9, 0.0, 0.0]])).face.tolist() == [1]
    with pytest.raises(InputError, match="area"):
        Surface(Mesh(vertices, np.array([[0, 1, 3]])))


def test_samples_lie_on_the_surface_evenly_by_area():
    surface = Surface(mesh_of(SOLIDS["box"]))
    points, normals = surface.sample(20_000)
    assert np.abs(surface.nearest(points).distance).max() < 1e-12
    # 20,000 draws: deviations of a share are 0.0034 at most; 5 of them.
    for axis, share in enumerate((6.0, 3.0, 2.0)):
        assert np.mean(np.abs(normals[:, axis]) > 0.9) == pytest.approx(share / 11.0, abs=0.017)
