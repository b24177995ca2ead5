"""Points of a decoded scan, by what the scene is measured with.

Usually that is the rig that is rendered.  A scene with a ``calibration``
(:mod:`slbench.scene.calibration`) is rendered with the one and measured with the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slbench.calibration.apply import measure
from slbench.calibration.doubts import resolution_doubt
from slbench.cloud.calibrated import with_calibration
from slbench.cloud.gaps import lost_points, ray_gap, rig_doubts
from slbench.cloud.triangulation import PointCloud, triangulate
from slbench.core.errors import located
from slbench.core.show.display import length
from slbench.patterns import PhaseMap
from slbench.rig import Pose, Rig
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.alignment import aligned

#: Distance on a sensor or panel between where true points are and where another rig sees them
#: that no calibration of the same devices has, as a share of its width.
_FAR = 0.02
#: Share of the pixels outside a model's domain that tells of another camera.
_OUTSIDE = 0.5
#: Pixels that a doubt needs.
_LEAST = 100


@dataclass(frozen=True, eq=False, kw_only=True)
class Reconstruction:
    """Points of a scan and what they were measured with.

    Parameters
    ----------
    cloud : PointCloud
        Aligned where the scene asks for it.
    rig : Rig
        That was measured with; the scene's own beside a model.
    motion : Pose or None
        What aligned the cloud.
    """

    cloud: PointCloud
    rig: Rig
    motion: Pose | None = None


def reconstruct(
    scene: Scene, phase: PhaseMap, truth: GroundTruth, *, seed: int = 0
) -> Reconstruction:
    """Turn panel coordinates into points.

    Parameters
    ----------
    scene : Scene
    phase : PhaseMap
    truth : GroundTruth
        For the alignment.
    seed : int
        Of the scan, where every scan has a calibration error of its own.

    Raises
    ------
    InputError
        For a model that needs axes which are not coded, and where nothing can be aligned.
    """
    made = scene.calibration
    if made is None:
        return Reconstruction(cloud=triangulate(scene.rig, phase), rig=scene.rig)
    rig = made.rig_for(scene.rig, seed)
    with located(f"scene {scene.name}: calibration"):
        if made.model is not None:
            cloud = measure(made.model, phase).cloud
        else:
            cloud = triangulate(rig, phase)
            if made.covariance is not None:
                cloud = with_calibration(cloud, rig, phase, made.covariance)
        if not made.align or not len(cloud):
            return Reconstruction(cloud=cloud, rig=rig)
        cloud, motion = aligned(cloud, truth)
    return Reconstruction(cloud=cloud, rig=rig, motion=motion)


def calibration_doubts(
    scene: Scene, phase: PhaseMap, truth: GroundTruth, made: Reconstruction
) -> list[str]:
    """Question a calibration that plainly is not one of this scene's rig.

    Returns
    -------
    list of str
        Sentences, for a rig whose rays miss each other or that sees true points elsewhere, and for
        a model most pixels are outside the domain of.
    """
    calibration = scene.calibration
    if calibration is None:
        return []
    if calibration.model is not None:
        measured = measure(calibration.model, phase)
        outside = int(np.count_nonzero(measured.extrapolated))
        if outside <= _OUTSIDE * len(measured.cloud) or len(measured.cloud) < _LEAST:
            return []
        why = resolution_doubt(calibration.model, phase.mask.shape)
        share = f"{outside} of {len(measured.cloud)} pixels are outside the model's domain"
        return [f"{share}: {why or 'another camera, or a larger object?'}"]
    cloud = made.cloud if made.motion is None else triangulate(made.rig, phase)
    found = rig_doubts(phase, lost_points(made.rig, phase, cloud), ray_gap(made.rig, phase, cloud))
    smooth = truth.smooth()
    if np.count_nonzero(smooth) < _LEAST or calibration.align:
        return found
    points, far = truth.point[smooth], []
    v, u = np.nonzero(smooth)
    seen = {"camera": np.column_stack((u, v)), "projector": truth.panel[smooth]}
    for role, pixels in seen.items():
        device = getattr(made.rig, role)
        with np.errstate(invalid="ignore"):
            off = np.linalg.norm(device.project(points) - pixels, axis=1)
        median = float(np.median(np.nan_to_num(off, nan=np.inf)))
        if median > _FAR * device.width:
            far.append(f"{median:.3g} px in the {role}")
    if far:
        rows, columns = cloud.pixels[:, 1], cloud.pixels[:, 0]
        away = np.linalg.norm(cloud.points - truth.point[rows, columns], axis=1)
        away = away[np.isfinite(away)]
        points_too = f", points by {length(float(np.median(away)))}" if len(away) else ""
        found.append(
            f"true points are off by {' and '.join(far)}{points_too} (medians): the rig of another "
            "setup, or another world frame (--align, align = true)?"
        )
    return found
