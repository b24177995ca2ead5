"""A few distinct designs out of a front: k-means on the scaled design variables.

The number of clusters grows until one more changes neither measure of the partition (thesis
3.2.4): R^2, the share of the variance that lies between clusters, by less than 1 %, and the
Davies-Bouldin index, the mean over clusters of the worst ratio of two clusters' radii to the
distance of their centroids, by less than 5 %; both relative to the value before.  The number
before that one more is taken.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.cluster import KMeans
from sklearn.metrics import davies_bouldin_score
from threadpoolctl import threadpool_limits

from slbench.core.errors import InputError
from slbench.core.validation.types import Count, Seed
from slbench.core.validation.values import checked
from slbench.design.search.front import Front

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

R_SQUARED_CHANGE = 0.01
DAVIES_BOULDIN_CHANGE = 0.05

# k-means finds a local optimum; the best of this many starts is near enough to the global one
# for the measures to be smooth in the number of clusters.
_STARTS = 10


@dataclass(frozen=True, eq=False)
class Clusters:
    """A partition of points, the largest cluster first.

    Parameters
    ----------
    labels : (n,) ndarray of int
        Cluster of each point, 0..k-1.
    centroids : (k, d) ndarray
        Mean of each cluster, scaled to the unit cube.
    representatives : (k,) ndarray of int
        Index of the member nearest to each centroid.
    counts : (K,) ndarray of int
        Numbers of clusters that were tried.
    r_squared, davies_bouldin : (K,) ndarray
        The measures for each of them; NaN where the Davies-Bouldin index is not defined
        (one cluster, or as many as points).
    """

    labels: IntArray
    centroids: FloatArray
    representatives: IntArray
    counts: IntArray
    r_squared: FloatArray
    davies_bouldin: FloatArray

    def __len__(self) -> int:
        return len(self.centroids)


def cluster_front(front: Front, seed: int = 0, max_clusters: int = 20) -> Clusters:
    """Cluster the points of a front by their design variables; see :func:`cluster`.

    Parameters
    ----------
    front : Front
        At least one point.
    seed : int
        Seed of k-means.
    max_clusters : int
        Limit to the number of clusters.

    Returns
    -------
    Clusters
        The partition; indices are those of ``front.x``.

    Raises
    ------
    InputError
        If the front is empty or an argument is not as above.
    """
    return cluster(front.unit, seed, max_clusters)


@checked
def cluster(unit: ArrayLike, seed: Seed = 0, max_clusters: Count = 20) -> Clusters:
    """Cluster points, with as many clusters as the measures call for.

    When the measures do not settle within `max_clusters` (or one less than the number of
    distinct points, beyond which the index is not defined), the number with the least
    Davies-Bouldin index is taken.  One or two distinct points are a cluster each.

    Parameters
    ----------
    unit : (n, d) array_like
        Points, n >= 1, every variable scaled to the same range.
    seed : int
        Seed of k-means.
    max_clusters : int
        Limit to the number of clusters, >= 1.

    Returns
    -------
    Clusters
        The partition; the same for the same seed.

    Raises
    ------
    InputError
        If there is no point, a coordinate is not finite, or an argument is not as above.
    """
    points = np.asarray(unit, dtype=np.float64)
    if points.ndim != 2 or points.size == 0:
        raise InputError("unit", "an (n, d) array, n >= 1", f"shape {points.shape}")
    if not np.isfinite(points).all():
        raise InputError("unit", "finite coordinates", "NaN or infinity")
    distinct, labels = np.unique(points, axis=0, return_inverse=True)
    labels = labels.reshape(-1)
    if len(distinct) <= min(2, max_clusters):
        count = len(distinct)
        none = np.full(1, np.nan)
        return _ordered(points, labels, np.array([count]), np.ones(1), none)
    partitions = [np.zeros(len(points), dtype=np.int64)]
    r_squared, index = [0.0], [np.nan]
    chosen = None
    for count in range(2, min(max_clusters, len(distinct) - 1) + 1):
        # One thread: on a front's few thousand points the others cost up to fifty times what
        # they save, and the order of their sums would depend on how many there are.
        with threadpool_limits(1):
            # Its seeds have 32 bits.
            means = KMeans(n_clusters=count, n_init=_STARTS, random_state=seed % 2**32)
            means.fit(points)
        partitions.append(means.labels_.astype(np.int64))
        r_squared.append(_explained(points, means.labels_))
        index.append(float(davies_bouldin_score(points, means.labels_)))
        settled = (
            abs(r_squared[-1] - r_squared[-2]) < R_SQUARED_CHANGE * r_squared[-2]
            and abs(index[-1] - index[-2]) < DAVIES_BOULDIN_CHANGE * index[-2]
        )
        if settled:
            chosen = len(partitions) - 2  # what the last one added was not worth it
            break
    if chosen is None:
        chosen = int(np.nanargmin(index)) if len(partitions) > 1 else 0
    counts = np.arange(1, len(partitions) + 1)
    return _ordered(points, partitions[chosen], counts, np.array(r_squared), np.array(index))


def _explained(points: FloatArray, labels: IntArray) -> float:
    """Return R^2 = 1 - (squares within clusters) / (squares about the common mean)."""
    within = sum(
        ((points[labels == i] - points[labels == i].mean(axis=0)) ** 2).sum()
        for i in range(labels.max() + 1)
    )
    return float(1.0 - within / ((points - points.mean(axis=0)) ** 2).sum())


def _ordered(
    points: FloatArray,
    labels: IntArray,
    counts: IntArray,
    r_squared: FloatArray,
    davies_bouldin: FloatArray,
) -> Clusters:
    """Sort clusters by size, ties by their first member, and find the representatives."""
    sizes = np.bincount(labels)
    first = np.array([np.flatnonzero(labels == i)[0] for i in range(len(sizes))])
    order = np.lexsort((first, -sizes))
    rank = np.argsort(order)
    labels = rank[labels]
    centroids, representatives = [], []
    for i in range(len(sizes)):
        members = np.flatnonzero(labels == i)
        centroids.append(points[members].mean(axis=0))
        distance = np.linalg.norm(points[members] - centroids[-1], axis=1)
        representatives.append(int(members[np.argmin(distance)]))
    return Clusters(
        labels=labels,
        centroids=np.array(centroids),
        representatives=np.array(representatives),
        counts=counts,
        r_squared=r_squared,
        davies_bouldin=davies_bouldin,
    )
