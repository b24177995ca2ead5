"""What rays say of a rig: how far they miss each other, and whether they meet before the devices.

With both axes coded a camera pixel and its panel pixel have a ray each.  In a right rig the two
meet but for noise; the gap between them is the distance of two lines,

    g = n . (q - o),  n = d x e / |d x e|,

o + t d the camera's ray and q + s e the projector's.  A change of the panel pixel moves the
projector's ray at the point by dq + s de; only what of that lies along n changes the gap, so that
its deviation is the root of sum_a sigma_a^2 (n . (dq_a + s de_a))^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.triangulation import PointCloud
from slbench.patterns import PhaseMap
from slbench.rig import Rig

Array = NDArray[np.float64]
#: Points that are looked at; medians need no more.
_MOST = 1 << 17
#: Median gap, panel pixels and deviations, that a calibration and a defocused scene do not have.
_FAR_PX, _FAR_SIGMAS = 0.7, 5.0
#: Share of decoded pixels whose rays meet behind a device.
_BEHIND = 0.1
#: Pixels that a doubt needs.
_LEAST = 100


@dataclass(frozen=True, eq=False)
class RayGap:
    """How far the rays of camera and projector miss each other, one a point, (n,).

    Parameters
    ----------
    mm : (n,) float
        Signed.
    deviations : (n,) float
        In predicted standard deviations; infinite where none is predicted.
    px : (n,) float
        In panel pixels.
    """

    mm: Array
    deviations: Array
    px: Array


def ray_gap(rig: Rig, phase: PhaseMap, cloud: PointCloud) -> RayGap | None:
    """Return the gaps of an even choice of a cloud's points; None unless both axes are coded."""
    if len(cloud.axes) < 2 or not len(cloud):
        return None
    chosen = slice(None, None, max(1, len(cloud) // _MOST))
    pixels = cloud.pixels[chosen]
    u, v = pixels.T
    panel = np.stack([phase.coordinate[axis][v, u] for axis in ("u", "v")], axis=-1)
    sigma = np.stack([phase.sigma[axis][v, u] for axis in ("u", "v")], axis=-1)
    o, d = rig.camera.unproject(pixels)
    q, e = rig.projector.unproject(panel)
    normal = np.cross(d, e)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        gap = np.einsum("ni,ni->n", normal, q - o)
        _, s = _nearest(o, d, q, e)
        slopes = np.empty((len(pixels), 2))
        for axis, step in enumerate(np.eye(2) * 0.5):
            (q1, e1), (q2, e2) = (rig.projector.unproject(panel + k * step) for k in (-1, 1))
            moved = q2 - q1 + s[:, None] * (e2 - e1)
            slopes[:, axis] = np.einsum("ni,ni->n", normal, moved)
        deviation = np.sqrt(np.sum((slopes * sigma) ** 2, axis=1))
        found = RayGap(gap, gap / deviation, gap / np.linalg.norm(slopes, axis=1))
    return found


def _nearest(o: Array, d: Array, q: Array, e: Array) -> tuple[Array, Array]:
    """Return the distances along both rays, of unit directions, to where they are nearest."""
    w = q - o
    b, f, g = (np.einsum("ni,ni->n", *pair) for pair in ((d, e), (w, d), (w, e)))
    determinant = 1.0 - b * b
    with np.errstate(invalid="ignore", divide="ignore"):
        return (f - b * g) / determinant, (b * f - g) / determinant


def lost_points(rig: Rig, phase: PhaseMap, cloud: PointCloud) -> dict[str, int]:
    """Return of how many decoded pixels there is no point, by reason.

    Returns
    -------
    dict
        ``behind``: the rays meet behind a device; ``no_meeting``: they are parallel, or the
        panel's coordinate is not on the camera's ray.
    """
    lost = phase.mask.copy()
    lost[cloud.pixels[:, 1], cloud.pixels[:, 0]] = False
    v, u = np.nonzero(lost)
    if not len(u):
        return {"behind": 0, "no_meeting": 0}
    o, d = rig.camera.unproject(np.column_stack((u, v)))
    width, height = rig.projector.width, rig.projector.height
    axes = cloud.axes
    middle = {"u": 0.5 * (width - 1), "v": 0.5 * (height - 1)}
    panel = np.stack(
        [
            phase.coordinate[a][v, u] if a in axes else np.full(len(u), middle[a])
            for a in ("u", "v")
        ],
        axis=-1,
    )
    q, e = rig.projector.unproject(panel)
    with np.errstate(invalid="ignore", divide="ignore"):
        if len(axes) == 2:
            t, s = _nearest(o, d, q, e)
        else:  # the plane of the coordinate, without what distortion bends of it
            other = np.array([0.0, 1.0]) if axes[0] == "u" else np.array([1.0, 0.0])
            q2, e2 = rig.projector.unproject(panel + 0.25 * height * other)
            normal = np.cross(e, e2 + (q2 - q))
            t = np.einsum("ni,ni->n", normal, q - o) / np.einsum("ni,ni->n", normal, d)
            s = rig.projector.pose.to_local(o + t[:, None] * d)[:, 2]
    behind = int(np.count_nonzero((t <= 0.0) | (s <= 0.0)))
    return {"behind": behind, "no_meeting": len(u) - behind}


def rig_doubts(phase: PhaseMap, lost: dict[str, int], gap: RayGap | None) -> list[str]:
    """Question a rig whose rays do not meet, or meet behind a device.

    Parameters
    ----------
    phase : PhaseMap
    lost : dict
        As :func:`lost_points` gives it.
    gap : RayGap or None

    Returns
    -------
    list of str
    """
    found = []
    decoded = int(np.count_nonzero(phase.mask))
    share = lost["behind"] / max(decoded, 1)
    if decoded >= _LEAST and share > _BEHIND:
        found.append(
            f"rays of {100 * share:.0f} % of the decoded pixels meet behind a device: R and T "
            "from projector to camera, T negated, or the patterns' direction?"
        )
    if gap is not None and len(gap.px) >= _LEAST:
        px, sigmas = (float(np.median(np.abs(x))) for x in (gap.px, gap.deviations))
        if px > _FAR_PX and sigmas > _FAR_SIGMAS:
            found.append(
                f"rays of camera and projector miss each other by {px:.3g} panel pixels, "
                f"{sigmas:.3g} deviations (medians): R and T inverted, K of camera and projector "
                "swapped, another rig, or other patterns than stated?"
            )
    return found
