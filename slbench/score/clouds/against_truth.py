"""A cloud of any decoder against the truth of a scan.

Every point is taken along the ray on which the camera sees it: its error is the vector to the
point from where that ray truly meets the surface.  Of a cloud in the order of pixels that is the
error of the pixel, as a scan's own score has it; of another, whose rays pass between the centres of
pixels, the surface is the tangent plane of the pixel's own true point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.files.measured import MeasuredCloud
from slbench.cloud.triangulation import PointCloud, triangulate
from slbench.core.errors import InputError, warn_user
from slbench.core.io import OutputFolder, read_json
from slbench.objects import Mesh
from slbench.patterns import Axis, PatternSequence, PhaseMap
from slbench.rig import Pose, Rig
from slbench.rig.opencv import read_rig
from slbench.scene.file import objects_of
from slbench.scene.model import SceneObject
from slbench.scene.truth import GroundTruth
from slbench.score.clouds.cloudscore import CloudScore, score_intervals, unmeasured
from slbench.score.clouds.expected import check_part, expected_deviations, question_unit
from slbench.score.clouds.placing import place_on_surface
from slbench.score.clouds.surface import Surface
from slbench.score.clouds.tiles import effective_tiles, tiles_of
from slbench.score.points import point_errors, score

Array = NDArray[np.float64]

#: Share of a cloud that the camera must see, before other places are blamed.
_SEEN = 0.5
#: Sides of a face between true points of neighbouring pixels that are one surface, in those of the
#: usual one.
_BREAK = 5.0
#: Why a feature of a scan's object is not in the score.
_UNTOLD = "too few points on smooth lit surface facing both devices, or they do not tell it"


@dataclass(frozen=True, eq=False, kw_only=True)
class ScannedTruth:
    """What is true of a scan, as its folder has it.

    Parameters
    ----------
    name : str
    rig : Rig
        That was measured with, standing in the world of the truth: moved there where the scan's
        own cloud was.
    truth : GroundTruth
    axes : tuple of "u", "v"
        Coded axes.
    objects : tuple of SceneObject
        Whose features are fitted; none where their files are not at hand.
    """

    name: str
    rig: Rig
    truth: GroundTruth
    axes: tuple[Axis, ...]
    objects: tuple[SceneObject, ...]

    @classmethod
    def read(cls, folder: str | Path) -> ScannedTruth:
        """Read the folder of a scan.

        Raises
        ------
        InputError
            If it has no truth or no rig, they do not fit together, or no pixel is lit.

        Warns
        -----
        InputWarning
            If its objects cannot be loaded here: their features are left out.
        """
        folder = Path(folder)
        if not (folder / "truth.exr").is_file():
            raise InputError(folder, "the folder of a scan, with truth.exr", "none")
        rig = read_rig(folder / "rig.yaml")
        size = (rig.camera.height, rig.camera.width)
        truth = GroundTruth.load(folder / "truth.exr", rig)
        if truth.status.shape != size:
            rows, columns = truth.status.shape
            expected = f"truth of the rig's {size[1]} x {size[0]} px"
            raise InputError(folder, expected, f"{columns} x {rows} px")
        if not truth.lit.any():
            raise InputError(folder, "truth of a lit surface", "none")
        made = OutputFolder("scan", ()).parameters(folder)
        motion = _motion(folder)
        if motion is not None and not _by_model(made.get("scene")):
            rig = _moved(rig, motion)
        return cls(
            name=folder.name or str(folder),
            rig=rig,
            truth=truth,
            axes=_axes(made.get("patterns")),
            objects=_objects(made.get("scene"), folder),
        )

    def surface(self) -> Mesh:
        """Return what is lit as a mesh, two faces between four pixels of one object."""
        truth = self.truth
        index = np.cumsum(truth.lit.ravel()).reshape(truth.lit.shape) - 1
        a, b, c, d = (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1], np.s_[1:, 1:])
        whole = truth.lit[a] & truth.lit[b] & truth.lit[c] & truth.lit[d]
        own = truth.object_id
        whole &= (own[a] == own[b]) & (own[a] == own[c]) & (own[a] == own[d])
        sides = [np.linalg.norm(truth.point[a] - truth.point[x], axis=-1) for x in (b, c, d)]
        longest = np.maximum.reduce(sides)
        if not whole.any():
            raise InputError(self.name, "truth of a lit surface", "none")
        whole &= longest < _BREAK * np.median(longest[whole])
        first, right, below, last = (index[x][whole] for x in (a, b, c, d))
        # Towards the camera: u to the right, v down.
        faces = [np.stack(x, -1) for x in ((first, below, right), (right, below, last))]
        return Mesh(truth.point[truth.lit], np.concatenate(faces))


def _motion(folder: Path) -> Pose | None:
    """Return what a scan's own cloud was aligned by; None where it was not."""
    if not (folder / "score.json").is_file():
        return None
    stored = read_json(folder / "score.json")
    given = stored.get("motion") if isinstance(stored, dict) else None
    if not isinstance(given, dict):
        return None
    turn, place = (np.array(given[key]) for key in ("rotation", "position_mm"))
    return Pose(turn, place)


def _by_model(content: Any) -> bool:
    """Tell whether a scan was measured with a calibration model: its rig is the true one then."""
    table = content.get("calibration") if isinstance(content, dict) else None
    if not isinstance(table, dict):
        return False
    return bool(table.get("model")) or str(table.get("measured_with", "")).endswith(".json")


def _moved(rig: Rig, motion: Pose) -> Rig:
    """Return a rig whose devices stand where a motion takes them."""

    def moved(own: Pose) -> Pose:
        return Pose(motion.rotation @ own.rotation, motion.to_world(own.position))

    devices = {name: device.posed(moved(device.pose)) for name, device in rig.devices.items()}
    return rig.having(**devices)


def _axes(patterns: Any) -> tuple[Axis, ...]:
    """Return the axes that a scan's patterns code; u where they are not known."""
    try:
        return PatternSequence.from_dict(patterns).axes
    except (InputError, TypeError, AttributeError, KeyError):
        return ("u",)


def _objects(content: Any, folder: Path) -> tuple[SceneObject, ...]:
    """Return the objects of a scan's scene."""
    if not isinstance(content, dict):
        return ()
    try:
        return objects_of(content, folder / "scene.toml")
    except InputError as error:
        warn_user(folder, f"features are left out, as an object cannot be loaded: {error}")
        return ()


def score_panel(
    phase: PhaseMap, known: bool, against: ScannedTruth, source: str, expected_um: float | None
) -> CloudScore:
    """Score a panel map pixel by pixel, triangulated with the scan's rig.

    Parameters
    ----------
    phase : PhaseMap
    known : bool
        Whether it has deviations of its own.
    against : ScannedTruth
    source : str
    expected_um : float, optional

    Raises
    ------
    InputError
        As :func:`score_against_truth`.
    """
    cloud = triangulate(against.rig, phase)
    if not len(cloud):
        raise InputError(source, "a panel map whose rays meet", "no point")
    scalars = {"sigma": cloud.sigma_total_mm, "u": cloud.u_total_mm} if known else {}
    measured = MeasuredCloud(cloud.points, scalars=scalars, source=source)
    return _scored(measured, cloud, phase, point_errors(cloud, against.truth), against, expected_um)


def score_against_truth(
    cloud: MeasuredCloud,
    against: ScannedTruth,
    *,
    align: bool = False,
    start: Pose | None = None,
    expected_um: float | None = None,
) -> CloudScore:
    """Score a cloud in any order against the truth of a scan.

    Parameters
    ----------
    cloud : MeasuredCloud
    against : ScannedTruth
    align : bool
        Whether it is moved to the true surface first, from wherever it is.
    start : Pose, optional
        With `align`: about where the true world is in the cloud's frame.
    expected_um : float, optional
        Expected deviation of its points, instead of what the cloud says.

    Returns
    -------
    CloudScore

    Raises
    ------
    InputError
        If the camera does not see half of the points where they are, or fewer than 70 % of them
        lie within three expected deviations of the truth.

    Warns
    -----
    InputWarning
        If the cloud is far larger or smaller than the truth, naming the likely unit.
    """
    truth, rig = against.truth, against.rig
    size = MeasuredCloud(truth.point[truth.lit]).size_mm
    question_unit(cloud, size, f"the truth of {against.name}")
    motion: Pose | None = None
    free: tuple[str, ...] = ()
    if align:
        mesh = against.surface()
        surface = Surface(mesh)
        placed = place_on_surface(cloud.points, mesh, surface, start)
        motion, free = placed.to_part, placed.free
        cloud = cloud.moved(motion)
    with np.errstate(invalid="ignore"):
        place = rig.camera.project(cloud.points)
        pixels = np.rint(np.clip(np.nan_to_num(place, nan=-1e6), -1e6, 1e6)).astype(np.int32)
    inside = np.all((pixels >= 0) & (pixels < truth.status.shape[::-1]), axis=1)
    inside &= rig.camera.pose.to_local(cloud.points)[:, 2] > 0.0
    if np.mean(inside) < _SEEN:
        raise InputError(
            cloud.source,
            "points that the scan's camera sees, in the scan's world",
            f"{100.0 * np.mean(inside):.3g} % of them: another frame (--align) or unit (--unit)?",
        )
    seen = cloud.chosen(inside)
    pixels = pixels[inside]
    triangulated, phase = _as_triangulated(seen, pixels, rig, against.axes)
    errors = _ray_errors(seen.points, pixels, against)
    result = _scored(seen, triangulated, phase, errors, against, expected_um, align)
    return replace(result, motion=motion, free=free)


def _ray_errors(points: Array, pixels: NDArray[np.int32], against: ScannedTruth) -> Array:
    """Return points less where their rays meet the tangent plane of their pixels' true points."""
    truth, camera = against.truth, against.rig.camera
    u, v = pixels.T
    true, normal = truth.point[v, u], truth.normal[v, u]
    ray = points - camera.chief_origin(points)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = np.sum((points - true) * normal, axis=1) / np.sum(ray * normal, axis=1)
        error = along[:, np.newaxis] * ray
    error[~truth.lit[v, u]] = np.nan
    return error


def _as_triangulated(
    cloud: MeasuredCloud, pixels: NDArray[np.int32], rig: Rig, axes: tuple[Axis, ...]
) -> tuple[PointCloud, PhaseMap]:
    """Return points as triangulation would have given them, and the panel coordinates they tell.

    The deviations of the points become those of the first coded axis, whose sensitivity is along
    the camera's ray.  What a cloud states as a whole is steady where no noise is stated of it.
    """
    shape = (rig.camera.height, rig.camera.width)
    panel, jacobian = rig.projector.project_with_jacobian(cloud.points)
    ray = cloud.points - rig.camera.chief_origin(cloud.points)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    k = "uv".index(axes[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        sensitivity = ray / np.sum(jacobian[:, k] * ray, axis=1)[:, np.newaxis]
        per_px = np.linalg.norm(sensitivity, axis=1)
        unknown = np.full(len(cloud), np.nan)
        noise = np.zeros(len(cloud)) if "u" in cloud.scalars else unknown
        sigma = cloud.scalars.get("sigma", noise) / per_px
        whole = cloud.scalars.get("u", unknown) / per_px
        steady = np.sqrt(np.maximum(whole**2 - np.nan_to_num(sigma) ** 2, 0.0))
    triangulated = PointCloud(
        points=cloud.points,
        pixels=pixels,
        shape=shape,
        axes=axes[:1],
        sigma_px=sigma[:, np.newaxis],
        sensitivity=sensitivity[:, np.newaxis],
        steady_px=steady[:, np.newaxis],
    )
    u, v = pixels.T
    mask = np.zeros(shape, bool)
    mask[v, u] = True
    coordinate = {}
    for axis in axes:
        image = np.full(shape, np.nan)
        image[v, u] = panel[:, "uv".index(axis)]
        coordinate[axis] = image
    blank = np.zeros(shape, np.float32)
    sigmas = {axis: np.full(shape, np.nan) for axis in axes}
    return triangulated, PhaseMap(coordinate, sigmas, blank, blank, mask)


def _scored(
    cloud: MeasuredCloud,
    triangulated: PointCloud,
    phase: PhaseMap,
    errors: Array,
    against: ScannedTruth,
    expected_um: float | None,
    aligned: bool = False,
) -> CloudScore:
    """Score points whose errors are known; refuse those of another part."""
    truth = against.truth
    size = MeasuredCloud(truth.point[truth.lit]).size_mm
    away = np.linalg.norm(errors, axis=1)
    expected = expected_deviations(cloud, away, size, expected_um)
    share = check_part(cloud, away, expected, f"what {against.name} scanned")
    found = score(triangulated, truth, phase, against.objects, against.rig, errors, aligned)
    nan = float("nan")
    if "sigma" not in cloud.scalars:
        found = replace(found, predicted_sigma_mm=nan)
        if "u" not in cloud.scalars:
            found = replace(found, predicted_u_mm=nan)
            found = replace(found, coverage_1u=nan, coverage_2u=nan, coverage_3u=nan)
    u, v = triangulated.pixels.T
    side = np.sum(errors * truth.normal[v, u], axis=1)
    lit = np.isfinite(away)
    tiles = tiles_of(triangulated.pixels[lit].astype(np.float64))
    return CloudScore(
        score=found,
        reference="truth",
        name=against.name,
        source=cloud.source,
        points=triangulated.points,
        deviation_mm=side,
        share=share,
        expected=expected,
        intervals=score_intervals(tiles, away[lit], errors[lit, 2]),
        tiles=effective_tiles(tiles),
        dropped=cloud.dropped,
        unmeasured={
            name: why
            for item in against.objects
            for name, why in unmeasured(item.artefact, found, lambda _: _UNTOLD).items()
        },
    )
