"""How fast a cloud of five million points is scored against a mesh of a million triangles.

Nearest points are the bulk of it: they are compared with SciPy's tree of the mesh's vertices within
one run, which gives nearest vertices alone.
"""

import time

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import slbench as sl
from slbench.cloud import MeasuredCloud
from slbench.objects import Mesh
from slbench.rig import Pose
from slbench.score.clouds.surface import Surface

POINTS = 5_000_000
#: Seconds on two idle cores, registration included.
LIMIT = 20.0


@pytest.fixture(scope="module")
def part():
    """A rounded body without symmetry, 1.3 million faces."""
    solid = trimesh.creation.icosphere(8)
    unit = np.asarray(solid.vertices)
    bumps = (
        1.0 + 0.08 * np.sin(3.0 * unit[:, 0] + 1.0) + 0.05 * np.cos(5.0 * unit[:, 1] * unit[:, 2])
    )
    return Mesh(unit * bumps[:, np.newaxis] * [30.0, 22.0, 15.0], np.asarray(solid.faces))


@pytest.fixture(scope="module")
def cloud(part):
    rng = np.random.default_rng(0)
    points, _ = Surface(part).sample(POINTS, 1)
    points += rng.normal(0.0, 0.01, points.shape)
    wrong = POINTS // 20
    points[:wrong] = rng.uniform(points.min(axis=0), points.max(axis=0), (wrong, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return MeasuredCloud(Pose(turn, np.array([10.0, 20.0, 30.0])).to_world(points))


def test_five_million_points_against_a_million_faces(part, cloud, tmp_path, benchmark):
    path = tmp_path / "part.ply"
    part.as_trimesh.export(path)

    def scored():
        start = time.perf_counter()
        found = sl.score_cloud(cloud, mesh=path)
        return time.perf_counter() - start, found

    seconds, found = benchmark.pedantic(scored, rounds=1)
    assert found.share > 0.9
    assert seconds < LIMIT


def test_nearest_points_take_no_longer_than_nearest_vertices(part, cloud, benchmark):
    surface, tree = Surface(part), cKDTree(part.vertices)
    some = cloud.points[::10] - cloud.points.mean(axis=0)
    surface.nearest(some[:10])

    def ratio():
        start = time.perf_counter()
        surface.nearest(some)
        middle = time.perf_counter()
        tree.query(some, workers=-1)
        return (middle - start) / (time.perf_counter() - middle)

    found = benchmark.pedantic(ratio, rounds=1)
    benchmark.extra_info["ratio"] = found
    assert found < 4.0
