"""Whether a view can be taken up: bodies of devices clear of the part and of the table.

A body is a box behind its lens, or one about each part of a barrel.  It meets a triangle unless one
of the 13 axes of the separating axis theorem parts them (T. Akenine-Möller, "Fast 3D triangle-box
overlap testing", J. Graphics Tools 6(1), 2001); a body all inside the part is found by the winding
number of its middle (A. Van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30(2), 1983).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from slbench.design.views.candidates import Candidate
from slbench.objects import Mesh
from slbench.rig import Device, Rig
from slbench.simulate.viewpoints.views import moved

Array = NDArray[np.float64]


class Clearance:
    """Bodies of a rig against a part.

    Parameters
    ----------
    rig : Rig
        Bodies that are not stated are left out.
    mesh : Mesh
        Of the part.
    clearance_mm : float
        By which bodies are larger on every side.
    above_table : bool
        Whether whole bodies have to be above the table's plane, as a robot's do; otherwise the
        lenses alone, beside a turntable that ends somewhere.
    """

    def __init__(self, rig: Rig, mesh: Mesh, clearance_mm: float, above_table: bool) -> None:
        self._rig, self._mesh, self._clearance = rig, mesh, clearance_mm
        self._above_table = above_table
        self._middle = mesh.bounds.mean(axis=0)
        self._radius = float(np.linalg.norm(mesh.vertices - self._middle, axis=1).max())

    def reason(self, candidate: Candidate) -> str | None:
        """Return why a candidate cannot be taken up, or None."""
        near = moved(self._rig, candidate.pose.inverse)  # devices about the part
        for name, device in near.devices.items():
            if candidate.stands:
                points = self._rig.devices[name].pose.position[np.newaxis]
                if self._above_table:
                    points = np.vstack((points, self._rig.devices[name].body_corners))
                if candidate.table.to_local(points)[:, 2].min() <= 0.0:
                    return f"{name} below the table"
            if any(self._meets(device, *box) for box in _boxes(device)):
                return f"{name} meets the part"
        return None

    def _meets(self, device: Device, size: Array, behind: float) -> bool:
        """Return whether a box so far behind a lens meets the part, in whose frame it is posed."""
        half = 0.5 * size + self._clearance
        middle = device.pose.to_world(np.array([0.0, 0.0, -behind - 0.5 * size[2]]))
        if np.linalg.norm(middle - self._middle) > self._radius + np.linalg.norm(half):
            return False
        corners = (self._mesh.vertices - middle) @ device.pose.rotation
        triangles = corners[self._mesh.faces]
        low, high = triangles.min(axis=1), triangles.max(axis=1)
        close = np.flatnonzero(np.all((low <= half) & (high >= -half), axis=1))
        if len(close) and meets_box(triangles[close], half).any():
            return True
        return winding_number(triangles) > 0.5


def _boxes(device: Device) -> list[tuple[Array, float]]:
    """Return boxes that hold a device's body: their sizes, and how far behind the lens each begins.

    A part of a barrel is taken for the box about it.
    """
    if device.barrel_mm is None:
        return [] if device.body_mm is None else [(np.array(device.body_mm), 0.0)]
    return [
        (np.array([2.0 * max(r, s), 2.0 * max(r, s), b - a]), a)
        for (a, r), (b, s) in pairwise(device.barrel_mm)
    ]


def meets_box(triangles: Array, half: Array) -> NDArray[np.bool_]:
    """Return which triangles meet a box about the origin.

    Parameters
    ----------
    triangles : (n, 3, 3) float
        Corners, in the box's frame.
    half : (3,) float
        Half the box's sides.
    """
    edges = np.roll(triangles, -1, axis=1) - triangles
    axes = [np.broadcast_to(axis, (len(triangles), 3)) for axis in np.eye(3)]
    axes.append(np.cross(edges[:, 0], edges[:, 1]))
    axes += [np.cross(axis, edges[:, k]) for axis in np.eye(3) for k in range(3)]
    apart = np.zeros(len(triangles), np.bool_)
    for axis in axes:
        along = np.einsum("nij,nj->ni", triangles, axis)
        reach = np.abs(axis) @ half
        apart |= (along.min(axis=1) > reach) | (along.max(axis=1) < -reach)
    return ~apart


def winding_number(triangles: Array) -> float:
    """Return how often triangles (n, 3, 3) wind about the origin: 1 inside a closed surface."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
    volume = np.sum(a * np.cross(b, c), axis=1)
    dots = la * lb * lc + np.sum(a * b, axis=1) * lc + np.sum(b * c, axis=1) * la
    dots = dots + np.sum(a * c, axis=1) * lb
    return float(np.sum(np.arctan2(volume, dots)) / (2.0 * np.pi))
