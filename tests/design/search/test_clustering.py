"""Clusters of a front: the measures, the rule that chooses the number, and few points."""

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.design.search.clustering import cluster, cluster_front
from slbench.design.search.multisearch import minimize


def blobs(centres, sigma=0.01, count=40, seed=0):
    rng = np.random.default_rng(seed)
    return np.concatenate([c + rng.normal(0, sigma, (count, len(c))) for c in np.array(centres)])


def davies_bouldin(points, labels):
    """The definition, written out."""
    k = labels.max() + 1
    centroids = [points[labels == i].mean(axis=0) for i in range(k)]
    radii = [
        np.linalg.norm(points[labels == i] - c, axis=1).mean() for i, c in enumerate(centroids)
    ]
    return np.mean(
        [
            max(
                (radii[i] + radii[j]) / np.linalg.norm(centroids[i] - centroids[j])
                for j in range(k)
                if j != i
            )
            for i in range(k)
        ]
    )


def r_squared(points, labels):
    total = ((points - points.mean(axis=0)) ** 2).sum()
    between = sum(
        (labels == i).sum() * ((points[labels == i].mean(axis=0) - points.mean(axis=0)) ** 2).sum()
        for i in range(labels.max() + 1)
    )
    return between / total


def test_the_number_of_clusters_is_the_first_to_which_one_more_adds_nothing():
    rng = np.random.default_rng(3)
    result = cluster(rng.random((150, 3)), max_clusters=60)
    r, index = result.r_squared, result.davies_bouldin
    settled = (np.abs(np.diff(r)[1:]) < 0.01 * r[1:-1]) & (
        np.abs(np.diff(index)[1:]) < 0.05 * index[1:-1]
    )
    np.testing.assert_array_equal(result.counts, np.arange(1, len(r) + 1))
    assert settled[-1]
    assert not settled[:-1].any()
    assert len(result) == result.counts[-2]


def test_the_measures_are_those_of_the_definitions():
    points = blobs([[0.1, 0.1], [0.8, 0.2], [0.5, 0.9]])
    result = cluster(points, max_clusters=3)
    assert len(result) == 3
    # Rounding of sums over 120 points.
    assert result.r_squared[-1] == pytest.approx(r_squared(points, result.labels), rel=1e-10)
    assert result.davies_bouldin[-1] == pytest.approx(
        davies_bouldin(points, result.labels), rel=1e-10
    )
    assert result.r_squared[0] == 0.0
    assert np.isnan(result.davies_bouldin[0])


def test_groups_far_apart_are_found_largest_first():
    centres = np.array([[0.1, 0.1], [0.8, 0.2], [0.5, 0.9]])
    points = np.concatenate([blobs(centres[[i]], count=n) for i, n in enumerate((20, 60, 40))])
    # Up to five clusters, the index is least at three: a split group has a ratio near one.
    result = cluster(points, max_clusters=5)
    np.testing.assert_array_equal(np.bincount(result.labels), [60, 40, 20])
    np.testing.assert_allclose(result.centroids, centres[[1, 2, 0]], atol=0.01)  # 4 sigma


def test_representatives_are_the_members_nearest_to_the_centroids():
    rng = np.random.default_rng(5)
    points = rng.random((200, 4))
    result = cluster(points)
    for i, (centroid, row) in enumerate(zip(result.centroids, result.representatives, strict=True)):
        members = points[result.labels == i]
        np.testing.assert_allclose(centroid, members.mean(axis=0), rtol=1e-12)
        assert result.labels[row] == i
        nearest = np.linalg.norm(members - centroid, axis=1).min()
        assert np.linalg.norm(points[row] - centroid) == pytest.approx(nearest, rel=1e-12)


def test_the_same_seed_gives_the_same_clusters():
    points = np.random.default_rng(7).random((150, 3))
    one, two = cluster(points, seed=4), cluster(points, seed=4)
    np.testing.assert_array_equal(one.labels, two.labels)
    np.testing.assert_array_equal(one.representatives, two.representatives)


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([[0.3, 0.4]], [0]),
        ([[0.3, 0.4]] * 5, [0] * 5),
        ([[0.3, 0.4], [0.9, 0.1]], [0, 1]),
        ([[0.3, 0.4], [0.9, 0.1], [0.9, 0.1]], [1, 0, 0]),
        ([[0.0, 0.0], [0.1, 0.0], [0.9, 0.0]], [0, 0, 1]),
    ],
)
def test_few_points(points, expected):
    result = cluster(points)
    np.testing.assert_array_equal(result.labels, expected)
    assert len(result) == max(expected) + 1
    np.testing.assert_array_equal(result.labels[result.representatives], range(len(result)))


def test_one_cluster_when_no_more_are_allowed():
    result = cluster([[0.0], [1.0]], max_clusters=1)
    np.testing.assert_array_equal(result.labels, [0, 0])
    np.testing.assert_allclose(result.centroids, [[0.5]])


def test_a_front_is_clustered_by_its_scaled_variables():
    # In units that differ by 1e6, the second variable alone would decide.
    front = minimize(
        lambda x: np.stack([x[:, 0], 1 - x[:, 0] + 1e-6 * x[:, 1]], axis=1),
        [0.0, 0.0],
        [1.0, 1e6],
        max_evaluations=200,
    )
    expected = cluster((front.x - front.lower) / (front.upper - front.lower))
    np.testing.assert_array_equal(cluster_front(front).labels, expected.labels)


@pytest.mark.parametrize(
    "arguments",
    [
        (np.empty((0, 2)),),
        ([0.1, 0.2],),
        ([[0.1, np.nan]],),
        ([[0.1]], -1),
        ([[0.1]], 0, 0),
        ([[0.1]], 0, True),
    ],
)
def test_bad_input_is_refused(arguments):
    with pytest.raises(InputError, match="expected"):
        cluster(*arguments)
