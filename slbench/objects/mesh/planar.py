"""Triangulation of plane regions between given outlines, finely inside one of them.

Where outlines are, points are joined by Delaunay's criterion.  A side of an outline is part
of that triangulation if no point lies inside the circle on it as a diameter (Gabriel's
condition), so that points of the regular grid that fills the first region keep their
distance, and sides of the grid meet it among themselves.  Away from the outlines the grid's
squares are halved without a search, which is most of the work saved.
"""

import numpy as np
import scipy.spatial
import shapely
from numpy.typing import NDArray

from slbench.core.errors import InputError

#: Least distance of grid points from points of outlines, in spacings: more than sqrt(1 / 2),
#: by which every point in the circle on a side of one spacing is closer to one of its ends.
_CLEARANCE = 0.72
#: Samples along the longer side of a region when looking for a rectangle.
_SAMPLES = 160


def triangulated(
    rings_mm: list[NDArray[np.float64]], regions: list[shapely.Geometry], spacing_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Triangulate regions that outlines bound, the first one with grid points inside.

    Parameters
    ----------
    rings_mm : list of (k, 2) ndarray of float
        All outlines, with no more than a spacing between neighbouring points; points on
        lines inside a region, if any, come as a ring as well.
    regions : list of shapely geometry
        Disjoint areas between them.
    spacing_mm : float
        Of the grid.

    Returns
    -------
    points_mm : (n, 2) ndarray of float
        The points of the rings, in order, then the grid points.
    faces : (m, 3) ndarray of int
        Triangles, counter-clockwise.
    kinds : (m,) ndarray of int
        The region of each.

    Raises
    ------
    InputError
        If the outlines come too close to one another for their spacing.
    """
    outline = np.concatenate(rings_mm)
    low, high = np.array(regions[0].bounds).reshape(2, 2)
    first, last = np.ceil(low / spacing_mm).astype(int), np.floor(high / spacing_mm).astype(int)
    x, y = (spacing_mm * np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    used = _inside(regions[0], grid)
    near = scipy.spatial.cKDTree(outline).query(
        grid[used], distance_upper_bound=_CLEARANCE * spacing_mm
    )[0]
    used[used] = np.isinf(near)
    # Squares with four such corners: no outline passes through them.
    square = used[:-1, :-1] & used[:-1, 1:] & used[1:, :-1] & used[1:, 1:]
    index = np.full(used.shape, -1)
    index[used] = len(outline) + np.arange(np.count_nonzero(used))
    points = np.concatenate([outline, grid[used]])
    a, b = index[:-1, :-1][square], index[:-1, 1:][square]
    c, d = index[1:, 1:][square], index[1:, :-1][square]
    halves = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)

    around = np.pad(square, 1)
    enclosed = around[:-1, :-1] & around[:-1, 1:] & around[1:, :-1] & around[1:, 1:]
    seeds = np.concatenate([np.arange(len(outline)), index[used & ~enclosed]])
    faces = seeds[scipy.spatial.Delaunay(points[seeds]).simplices]
    faces = np.where((_doubled_areas(points, faces) < 0.0)[:, None], faces[:, ::-1], faces)
    middles = points[faces].mean(axis=1)
    # What lies over the squares is theirs already.
    column, row = (np.floor(middles / spacing_mm).astype(int) - first).T
    within = (column >= 0) & (row >= 0) & (column < square.shape[1]) & (row < square.shape[0])
    over = np.zeros(len(faces), dtype=bool)
    over[within] = square[row[within], column[within]]
    kinds = np.full(len(faces), -1)
    for kind, region in enumerate(regions):
        kinds[~over & _inside(region, middles)] = kind
    faces, kinds = faces[kinds >= 0], kinds[kinds >= 0]
    faces, kinds = np.concatenate([halves, faces]), np.concatenate([np.zeros_like(a), a * 0, kinds])
    doubled = _doubled_areas(points, faces)
    # Only if every outline is made of sides of triangles do the areas come out right.
    areas = np.bincount(kinds, 0.5 * doubled, minlength=len(regions))
    wanted = np.array([region.area for region in regions])
    if doubled.min() <= 0.0 or not np.allclose(areas, wanted, rtol=1e-9, atol=0.0):
        raise InputError("outlines", "at least a spacing apart", "closer ones")
    return points, faces, kinds


def largest_rectangle(
    region: shapely.Geometry, margin_mm: float
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Largest upright rectangle in a region, a margin away from its edges.

    Parameters
    ----------
    region : shapely geometry
        The region.
    margin_mm : float
        Least distance of the rectangle from the region's boundary.

    Returns
    -------
    ((float, float), (float, float)) or None
        Its extent along x and y, mm, found to 1 % of the region's size; None if all are
        narrower than two margins.
    """
    inner = shapely.buffer(region, -margin_mm)
    if inner.is_empty:
        return None
    low, high = np.array(inner.bounds).reshape(2, 2)
    step = float((high - low).max()) / _SAMPLES
    x, y = (np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))
    free = _inside(inner, np.stack(np.meshgrid(x, y), axis=-1))
    best, found = 0, None
    runs = np.zeros(len(x), dtype=np.int64)
    for row in range(len(y)):
        runs = np.where(free[row], runs + 1, 0)
        for left in range(len(x)):
            depths = np.minimum.accumulate(runs[left:])
            sizes = depths * np.arange(1, len(depths) + 1)
            widest = int(sizes.argmax())
            if sizes[widest] > best:
                right, top = left + widest, row + 1 - int(depths[widest])
                box = shapely.box(x[left], y[top], x[right], y[row])
                if inner.covers(box):
                    best, found = int(sizes[widest]), box.bounds
    if found is None or min(found[2] - found[0], found[3] - found[1]) < 2.0 * margin_mm:
        return None
    return (found[0], found[2]), (found[1], found[3])


def _inside(region: shapely.Geometry, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    shapely.prepare(region)
    return np.asarray(shapely.contains_xy(region, points[..., 0], points[..., 1]))


def _doubled_areas(points: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = np.moveaxis(points[faces], 1, 0)
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
