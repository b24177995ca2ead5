"""The evaluator's mathematics once more, slowly: plain NumPy on posed devices.

Nothing is shared with the kernels: rays come from :meth:`Device.unproject`, panel pixels from
:meth:`Device.project`, neighbours from SciPy's k-d tree, the silhouette from Shapely.
"""

import numpy as np
import shapely
from scipy.spatial import KDTree


def reference(hardware, variables, stride=(20, 24), planes_mm=None):
    """Return mu, sigma, eta, n, d of one configuration (DesignVariables)."""
    rig = hardware.rig(variables)
    half = np.array(rig.volume_mm) / 2
    planes = half[2] * np.array([-1, -0.5, 0, 0.5, 1]) if planes_mm is None else planes_mm
    errors, points = [], []
    for z in planes:
        e, t = _plane(rig, z, half, stride, hardware.coded_axes)
        errors.append(e)
        points.append(t)
    e, t = np.concatenate(errors), np.concatenate(points)
    distance = KDTree(t).query(t, k=2)[0][:, 1].mean() if len(t) > 1 else np.nan
    sigma = e.std(ddof=1) if len(e) > 1 else np.nan
    return e.mean() if len(e) else np.nan, sigma, _eta(rig), len(e), distance


def _plane(rig, z, half, stride, coded_axes):
    camera, projector = rig.camera, rig.projector
    v, u = np.mgrid[0 : camera.height : stride[1], 0 : camera.width : stride[0]]
    pixels = np.stack((u.ravel(), v.ravel()), axis=-1).astype(float)
    offsets = np.array([[i, j] for j in (-0.25, 0, 0.25) for i in (-0.25, 0, 0.25)])
    hits = _meet(camera, pixels[:, None] + offsets, z)
    # A ray on an edge meets the pixel to the right, or below, whatever rounding says.
    panel = np.floor(projector.project(hits) + 0.5 + 1e-9)
    on_panel = projector.contains(panel)
    same = np.all(panel[:, :, None] == panel[:, None, :], axis=-1)
    votes = np.sum(same & on_panel[:, None, :] & on_panel[:, :, None], axis=-1)
    winner = np.argmax(votes, axis=-1)
    point = hits[:, 4]
    keep = votes.max(axis=-1) >= 5
    keep &= np.all(np.abs(point[:, :2]) <= (1 + 1e-9) * half[:2], axis=-1) & (abs(z) <= half[2])
    point, pixels = point[keep], pixels[keep]
    target = panel[np.arange(len(keep)), winner][keep]
    origin, direction = camera.unproject(pixels)
    if coded_axes in ("u", "v"):
        axis = "uv".index(coded_axes)
        found = _column(projector, point, direction, target[:, axis], axis)
    else:
        found = _midpoint(origin, direction, *projector.unproject(target))
    return np.linalg.norm(found - point, axis=-1), point


def _meet(device, pixels, z):
    """Where the pixels' rays meet the plane; NaN where they do not."""
    origin, direction = device.unproject(pixels)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (z - origin[..., 2]) / direction[..., 2]
        return origin + np.where(t > 0, t, np.nan)[..., None] * direction


def _column(projector, point, direction, column, axis):
    """Newton along the ray until the panel column (or row) is met.

    Rays nearly in its surface may meet it nowhere that the projector sees: to first order there.
    """
    found, first = point.copy(), None
    for _ in range(30):
        pixel, jacobian = projector.project_with_jacobian(found)
        slope = np.einsum("ni,ni->n", jacobian[:, axis], direction)
        step = (column - pixel[:, axis]) / slope
        first = step if first is None else first
        found += step[:, None] * direction
    met = np.abs(projector.project(found)[:, axis] - column) < 1e-9
    return np.where(met[:, None], found, point + first[:, None] * direction)


def _midpoint(a, d, b, q):
    """The point with the least sum of squared distances to two lines, by normal equations."""
    matrix = np.zeros((len(a), 3, 3))
    right = np.zeros((len(a), 3))
    for origin, direction in ((a, d), (b, q)):
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        matrix += across
        right += np.einsum("nij,nj->ni", across, origin)
    return np.linalg.solve(matrix, right[..., None])[..., 0]


def _eta(rig):
    panel = rig.projector
    corners = panel.project(rig.volume_corners)
    if np.any(np.isnan(corners)):
        return np.nan
    hull = shapely.MultiPoint(corners).convex_hull
    frame = shapely.box(-0.5, -0.5, panel.width - 0.5, panel.height - 0.5)
    return hull.intersection(frame).area / frame.area
