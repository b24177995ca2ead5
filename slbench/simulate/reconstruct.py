"""Points of a decoded scan, by what the scene is measured with.

Usually that is the rig that is rendered.  A scene with a ``calibration``
(:mod:`slbench.scene.calibration`) is rendered with the one and measured with the other.

*Frames.*  What is measured with has a world of its own.  The motion that brings it to the scene's
is that of the whole measurement volume: true places in it, as both devices see them, are measured
without noise, and the motion between what comes out and what is true is what the frames differ by.
Neither the object nor its points take part: by its own points a staircase whose steps are all too
high would be leant until it looks right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slbench.calibration.apply import measure
from slbench.calibration.doubts import resolution_doubt
from slbench.calibration.models.model import CalibrationModel
from slbench.capture.stack import FusedCapture
from slbench.cloud.calibrated import with_calibration
from slbench.cloud.gaps import lost_points, ray_gap, rig_doubts
from slbench.cloud.triangulation import Axis, PointCloud, meet, triangulate
from slbench.core.errors import InputError, located
from slbench.core.show.display import length
from slbench.patterns import PhaseMap
from slbench.rig import Pose, Rig
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.alignment import rigid_fit

#: Distance on a sensor or panel between where true points are and where another rig sees them
#: that no calibration of the same devices has, as a share of its width.
_FAR = 0.02
#: Share of the pixels outside a model's domain that tells of another camera.
_OUTSIDE = 0.5
#: Places in the volume, along each axis, by which frames are joined, and how many are needed.
_PLACES, _LEAST_PLACES = 9, 27
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


def decoded(scene: Scene, fused: FusedCapture) -> PhaseMap:
    """Decode the frames of a scene, its motion taken out of them where it asks for that.

    Raises
    ------
    InputError
        As :func:`slbench.cloud.motion.at_rest` and :func:`slbench.cloud.motion.estimated_motion`.
    """
    if scene.compensate == "none" or not scene.moves:
        return fused.decode()
    from slbench.cloud.motion import at_rest, estimated_motion  # SciPy's, for few scenes

    with located(f"scene {scene.name}: decode"):
        if scene.compensate == "known":
            moving = scene.common_path
        else:
            moving = estimated_motion(fused.capture).motion.at
        return at_rest(fused.capture, moving).decode()


def reconstruct(scene: Scene, phase: PhaseMap, *, seed: int = 0) -> Reconstruction:
    """Turn panel coordinates into points.

    Parameters
    ----------
    scene : Scene
    phase : PhaseMap
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
        motion = joining_motion(scene, made.model or rig, tuple(phase.coordinate))
    return Reconstruction(cloud=cloud.moved(motion), rig=rig, motion=motion)


def joining_motion(
    scene: Scene, measured_with: Rig | CalibrationModel, axes: Sequence[Axis]
) -> Pose:
    """Return the motion from the frame of a rig or model to the scene's, by the whole volume.

    Parameters
    ----------
    scene : Scene
        Its rig is true.
    measured_with : Rig or CalibrationModel
    axes : sequence of "u", "v"
        That are coded.

    Returns
    -------
    Pose
        ``to_world`` moves points that were measured.

    Raises
    ------
    InputError
        If fewer than 27 places of the volume are seen by both devices and measured.
    """
    steps = [np.linspace(-0.5, 0.5, _PLACES) * size for size in scene.rig.volume_mm]
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    places = scene.place.to_world(grid)
    with np.errstate(invalid="ignore"):
        pixels, panel = scene.rig.camera.project(places), scene.rig.projector.project(places)
        seen = scene.rig.camera.contains(pixels) & scene.rig.projector.contains(panel)
    places, pixels = places[seen], pixels[seen]
    coded = panel[seen][:, ["uv".index(axis) for axis in axes]]
    if isinstance(measured_with, Rig):
        found, _ = meet(measured_with, pixels, tuple(axes), coded, np.ones_like(coded))
    else:
        wanted = coded[:, [axes.index(axis) for axis in measured_with.axes]]
        measured = measured_with.measure(np.concatenate((pixels, wanted), axis=1))
        found = np.where(measured.inside[:, np.newaxis], measured.points, np.nan)
    told = np.isfinite(found).all(axis=1)
    if np.count_nonzero(told) < _LEAST_PLACES:
        expected = "places of the volume that both devices see and the calibration measures"
        raise InputError("align", f"at least {_LEAST_PLACES} {expected}", int(told.sum()))
    return rigid_fit(found[told], places[told])


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
