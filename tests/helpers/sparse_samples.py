"""Sparse rows made of samples by SciPy, for tests that need some light transport."""

import numpy as np
import scipy.sparse

from slbench.simulate.rows import SparseRows


def by_scipy(columns, weights, width):
    """Merge samples (rows, samples) with SciPy, in double precision."""
    rows = np.repeat(np.arange(columns.shape[0]), columns.shape[1])
    keep = weights.ravel() > 0
    entries = (weights.ravel()[keep].astype(np.float64), (rows[keep], columns.ravel()[keep]))
    return scipy.sparse.coo_array(entries, shape=(columns.shape[0], width)).tocsr()


def sparse_rows(columns, weights, width, **more):
    """Return the rows of samples whose columns are panel pixels."""
    merged = by_scipy(columns, weights, width)
    indices = merged.indices.astype(columns.dtype)
    return SparseRows(
        merged.indptr.astype(np.int32), indices, merged.data.astype(np.float32), width, **more
    )
