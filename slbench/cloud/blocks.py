"""Active stereo: two cameras, any random pattern, and block matching by OpenCV.

The pattern gives the surface a texture, and nobody needs to know which.  OpenCV rectifies both
pictures (``cv2.stereoRectify``) and matches blocks half-globally (``cv2.StereoSGBM``; H.
Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", IEEE Trans.
PAMI 30(2), 2008); a pixel stays where the match from the right picture to the left one agrees
within a pixel.  SGBM tells sixteenths of a pixel at best, so its disparities are refined by least
squares (B. D. Lucas, T. Kanade, IJCAI 1981) in all frames at once: with L and R of zero mean and
unit variance over a window, and R warped by the means S of disparities over windows, which follow
what slopes,

    D = S + sum g (R - L) / sum g^2,   g = dR/dx,   sigma_D^2 = sum (L - R)^2 / (n - 2) / sum g^2,

and again with the means of D.

The deviation is *measured*: by what the two windows still differ by.  That holds the noise of both
cameras and what makes their pictures unlike, less what resampling smooths of it: over draws points
spread by a quarter more (0.77 of it is predicted, with one frame as with four).  Points nearer to
each other than a window are not independent, and edges are as round as a window is wide.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from slbench.cloud.joint import JointCloud
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.validation.types import Interval, Measure
from slbench.core.validation.values import checked
from slbench.rig import Camera, Pair, Rig
from slbench.rig.axes import closest_axes

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: A window, px; odd.
Window = Annotated[int, Interval(ge=3, le=51)]
WINDOW_PX = 9
#: Frames that OpenCV matches by: the channels of its pictures.
_CHANNELS = 3
#: Block of OpenCV's own cost, and its penalties a channel for disparities that change.
_BLOCK, _SMALL, _LARGE = 5, 8 * 25, 32 * 25
_UNIQUE, _SPECKLE, _SPECKLE_RANGE = 10, 60, 2
#: Pixels that both directions may differ by.
_BOTH_WAYS_PX = 1.0
#: How far depths are searched about where the cameras look, and about a volume's, of its own
#: depth, where nobody says.
_SHARE, _MARGIN = 0.15, 0.2
_STEPS, _LONGEST_PX = 4, 0.5
#: Contrast of a window, of the picture's, below which it is not matched; correlation likewise.
_CONTRAST, _ALIKE = 0.02, 0.5
_FRACTIONS = 16.0
#: Cosine to the rectified axis of the outermost rays, at the least.
_LEAST_COSINE = 0.2
#: How much larger than the cameras' pictures rectified ones may be.
_LARGEST = 2.5


class _Rectified(NamedTuple):
    """Pictures whose rows are epipolar lines, and how their pixels become rays.

    Parameters
    ----------
    frames : two of (N, V, U) float32
        NaN beyond the cameras' fields.
    turns : two of (3, 3) float
        From each camera's frame to the rectified one.
    focal : (2,) float
        Px.
    centres : two of (2,) float
        Principal points, px.
    reach : float
        Focal length times baseline, px mm: a disparity is this over the depth, with its sign.
    """

    frames: tuple[Image, Image]
    turns: tuple[Array, Array]
    focal: Array
    centres: tuple[Array, Array]
    reach: float


@checked
def match_blocks(
    rig: Rig,
    frames: Mapping[str, NDArray[Any]],
    depth_mm: tuple[Measure, Measure] | None = None,
    window_px: Window = WINDOW_PX,
) -> JointCloud:
    """Triangulate what two cameras see of a random pattern, by block matching.

    Parameters
    ----------
    rig : Rig
        Of the cameras, with perspective lenses; its projectors, if it has any, are ignored.
    frames : mapping of str to (N, V, U) array
        By camera, of two cameras: one frame or more, the same patterns at the same time.
    depth_mm : (float, float), optional
        Nearest and farthest distance along the first camera's axis that are searched.  By default
        they are those of the rig's volume, or 15 % about where the axes of the cameras come
        closest, where the world's origin is not before both.
    window_px : int
        Side of the windows whose grey values are compared, odd.

    Returns
    -------
    JointCloud
        A point for each pixel of the first camera that was matched; `sigma_px` is of the
        disparity, in rectified pixels, as measured.

    Raises
    ------
    InputError
        Unless there are frames of two cameras of the rig, as many of each, and a range of
        depths that is one.
    """
    names, cameras = _two(rig, frames)
    if window_px % 2 == 0:
        raise InputError("window_px", "an odd number", window_px)
    near, far = _depths(rig, *cameras) if depth_mm is None else depth_mm
    if not near < far:
        raise InputError("depth_mm", "a nearest and a farther distance", f"{near}, {far}")
    made = _rectify(cameras, [np.asarray(frames[name]) for name in names])
    # Depths of the field's corners along the rectified axis, which is turned.
    corners = cameras[0].pose.to_local(cameras[0].frustum(near, far)) @ made.turns[0][2]
    least = 0.1 * near
    start, near_both = _matched(made, (max(corners.min(), least), max(corners.max(), 2.0 * least)))
    disparity, sigma, valid = _refined(made, start, near_both, window_px)
    return _points(names, cameras, made, disparity, sigma, valid)


def _two(rig: Rig, frames: Mapping[str, NDArray[Any]]) -> tuple[list[str], list[Camera]]:
    """Check the frames and return their cameras."""
    names = list(frames)
    for name in names:
        if name not in rig.cameras:
            expected = f"cameras of the rig: {', '.join(rig.cameras)}"
            raise InputError("frames", expected, quoted(name, list(rig.cameras)))
    if len(names) != 2:
        raise InputError("frames", "those of two cameras", ", ".join(names) or "none")
    cameras = [rig.cameras[name] for name in names]
    for name, camera in zip(names, cameras, strict=True):
        if camera.lens.kind != "perspective":
            raise InputError(f"the {name} camera", "a perspective lens", camera.lens.kind)
        shape = np.shape(frames[name])
        if len(shape) != 3 or shape[1:] != (camera.height, camera.width) or not shape[0]:
            expected = f"(N, {camera.height}, {camera.width})"
            raise InputError(f"frames of {name}", expected, shape)
    one, two = (len(frames[name]) for name in names)
    if one != two:
        raise InputError(f"frames of {names[1]}", f"{one}, as many as of {names[0]}", two)
    if np.linalg.norm(_shift(*cameras)) < 1e-9:
        raise InputError("rig devices", "two cameras in different places", "one place")
    return names, cameras


def _shift(first: Camera, second: Camera) -> Array:
    """Return T of ``X_second = R X_first + T``."""
    return second.pose.to_local(first.pose.position)


def _depths(rig: Rig, first: Camera, second: Camera) -> tuple[float, float]:
    """Return the range of depths of a rig's volume, or about where both axes come closest."""
    if rig.faces_origin:
        depths = first.pose.to_local(rig.volume_corners)[:, 2]
        more = _MARGIN * float(np.ptp(depths))
        return float(depths.min()) - more, float(depths.max()) + more
    found = closest_axes(first.pose, second.pose)
    if found is None:
        expected = "the depths to search (axes are parallel, or meet behind the cameras)"
        raise InputError("depth_mm", expected, "none")
    return (1.0 - _SHARE) * found.camera_mm, (1.0 + _SHARE) * found.camera_mm


def _rectify(cameras: list[Camera], frames_of: list[NDArray[Any]]) -> _Rectified:
    """Rectify the pictures of two cameras: whole, at the finer one's resolution."""
    first, second = cameras
    turn = second.pose.rotation.T @ first.pose.rotation
    size = (max(first.width, second.width), max(first.height, second.height))
    (k1, d1), (k2, d2) = ((c.matrix, c.opencv_distortion) for c in cameras)
    r1, r2, _, p2 = cv2.stereoRectify(
        k1, d1, k2, d2, size, turn, _shift(first, second)[:, None], flags=0, alpha=-1.0
    )[:4]
    turns = [np.asarray(r, np.float64) for r in (r1, r2)]
    upright = abs(p2[1, 3]) > abs(p2[0, 3])  # the baseline is along v: rows are columns then
    if upright:
        turns = [r[[1, 0, 2]] for r in turns]
    baseline = p2[1, 3] / p2[1, 1] if upright else p2[0, 3] / p2[0, 0]
    fields = [_field(camera, r) for camera, r in zip(cameras, turns, strict=True)]
    low = np.array([field[0] for field in fields])
    span = np.array([field[1] for field in fields]) - low
    top = low[:, 1].min()
    height = float((low[:, 1] + span[:, 1]).max() - top)
    width = float(span[:, 0].max())
    focal = max(float(one) for camera in cameras for one in np.diag(camera.matrix)[:2])
    most = _LARGEST * max(size)
    focal = min(focal, most / width, most / height)
    shape = (int(np.ceil(focal * height)) + 1, int(np.ceil(focal * width)) + 1)
    centres = [np.array([-focal * left, -focal * top]) for left in low[:, 0]]
    pictures = []
    for camera, r, centre, frames in zip(cameras, turns, centres, frames_of, strict=True):
        new = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
        maps = cv2.initUndistortRectifyMap(
            camera.matrix, camera.opencv_distortion, r, new, shape[::-1], cv2.CV_32FC1
        )
        outside = (maps[0] < 0) | (maps[1] < 0)
        outside |= (maps[0] > camera.width - 1) | (maps[1] > camera.height - 1)
        warped = np.empty((len(frames), *shape), np.float32)
        for n, frame in enumerate(frames):
            warped[n] = _at(_spline(frame), maps[0], maps[1])
        warped[:, outside] = np.nan
        pictures.append(warped)
    return _Rectified(
        (pictures[0], pictures[1]),
        (turns[0], turns[1]),
        np.array([focal, focal]),
        (centres[0], centres[1]),
        -focal * float(baseline),
    )


def _spline(frame: NDArray[Any]) -> Array:
    """Return the coefficients of a cubic spline; OpenCV knows places to 1/32 px only."""
    return np.asarray(spline_filter(np.asarray(frame, np.float64), order=3, mode="mirror"))


def _at(spline: Array, u: NDArray[Any], v: NDArray[Any]) -> Array:
    """Return the values of a spline at places, those of the edge beyond it."""
    return np.asarray(
        map_coordinates(spline, [v, u], order=3, mode="mirror", prefilter=False), np.float64
    )


def _field(camera: Camera, turn: Array) -> tuple[Array, Array]:
    """Return the least and largest rectified coordinates, (2,) each, of a camera's picture."""
    u, v = np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64)
    edges = [(u, 0.0 * u), (u, 0.0 * u + v[-1]), (0.0 * v, v), (0.0 * v + u[-1], v)]
    normalised = camera.normalise(np.concatenate([np.stack(edge, axis=1) for edge in edges]))
    rays = np.column_stack((normalised, np.ones(len(normalised)))) @ turn.T
    if not (rays[:, 2] > _LEAST_COSINE * np.linalg.norm(rays, axis=1)).all():
        expected = "two cameras that look across the line between them"
        raise InputError("rig devices", expected, "one that looks along it")
    places = rays[:, :2] / rays[:, 2:]
    return places.min(axis=0), places.max(axis=0)


def _matched(made: _Rectified, depths: tuple[float, float]) -> tuple[Image, Mask]:
    """Return disparities by OpenCV of the first picture's pixels, and where both ways agree.

    Parameters
    ----------
    made : _Rectified
    depths : (float, float)
        That are searched, in the rectified frame, mm.
    """
    # x1 - x2 = reach / z + c1 - c2
    offset = float(made.centres[0][0] - made.centres[1][0])
    ends = [made.reach / z + offset for z in depths]
    low, high = int(np.floor(min(ends))), int(np.ceil(max(ends)))
    width = made.frames[0].shape[2]
    low, high = max(low, 1 - width), min(high, width - 1)
    count = 16 * max(1, -(-(high - low + 1) // 16))
    # OpenCV matches pixels whose every disparity is in the picture: with margins all of them.
    before, after = max(low + count, 0), max(-low, 0)
    margins = ((0, 0), (before, after), (0, 0))
    one, two = (np.pad(_bytes(frames), margins) for frames in made.frames)
    straight = _sgbm(low, count).compute(one, two)
    # The other way round in mirrored pictures, where it is a match to the same side again.
    mirrored = _sgbm(low, count).compute(
        np.ascontiguousarray(two[:, ::-1]), np.ascontiguousarray(one[:, ::-1])
    )[:, ::-1]
    inner = slice(before, before + width)
    disparity = straight[:, inner].astype(np.float32) / _FRACTIONS
    back = mirrored[:, inner].astype(np.float32) / _FRACTIONS
    rows, columns = np.indices(disparity.shape)
    target = np.rint(columns - disparity).astype(np.intp)
    valid = (disparity >= low) & (target >= 0) & (target < width)
    there = back[rows, np.clip(target, 0, width - 1)]
    valid &= (there >= low) & (np.abs(there - disparity) <= _BOTH_WAYS_PX)
    valid &= np.isfinite(made.frames[0]).all(axis=0)
    return disparity, valid


def _sgbm(low: int, count: int) -> Any:
    return cv2.StereoSGBM_create(
        minDisparity=low,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=_SMALL * _CHANNELS,
        P2=_LARGE * _CHANNELS,
        disp12MaxDiff=-1,
        uniquenessRatio=_UNIQUE,
        speckleWindowSize=_SPECKLE,
        speckleRange=_SPECKLE_RANGE,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )


def _bytes(frames: Image) -> NDArray[np.uint8]:
    """Return up to three frames as the channels of a picture of bytes, each of one's own scale."""
    chosen = np.unique(np.linspace(0, len(frames) - 1, _CHANNELS).astype(int))
    channels = []
    for frame in frames[chosen]:
        low, high = np.nanpercentile(frame, (0.5, 99.5)) if np.isfinite(frame).any() else (0, 1)
        scaled = (np.nan_to_num(frame, nan=low) - low) * (255.0 / max(high - low, 1e-9))
        channels.append(np.clip(np.rint(scaled), 0, 255).astype(np.uint8))
    while len(channels) < _CHANNELS:
        channels.append(channels[-1])
    return np.ascontiguousarray(np.stack(channels, axis=-1))


def _box(values: NDArray[Any], window: int) -> Image:
    """Return the sums over windows."""
    flat = np.ascontiguousarray(values, dtype=np.float32)
    summed = cv2.boxFilter(
        flat, cv2.CV_64F, (window, window), None, (-1, -1), False, cv2.BORDER_CONSTANT
    )
    return np.asarray(summed, np.float64)  # type: ignore[return-value]


def _refined(
    made: _Rectified, disparity: Image, valid: Mask, window: int
) -> tuple[Array, Array, Mask]:
    """Refine disparities by least squares over windows and frames; return their deviations too."""
    left, right = made.frames
    columns = np.arange(left.shape[2], dtype=np.float32)[None]
    rows = np.repeat(np.arange(left.shape[1], dtype=np.float32)[:, None], left.shape[2], axis=1)
    splines = [_spline(np.nan_to_num(frame, nan=float(np.nanmean(frame)))) for frame in right]
    seen = [np.isfinite(frame).astype(np.float32) for frame in right]
    found = np.where(valid, disparity, 0.0).astype(np.float64)
    result = np.full(found.shape, np.nan)
    usable = valid
    for _ in range(_STEPS):
        # Warped by means over windows, which their noise is not part of.
        share = _box(usable.astype(np.float64), window)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = _box(np.where(usable, found, 0.0), window) / share
        mean = np.where(share > 0.5, mean, found)
        place = columns - mean
        warped, slopes, inside = [], [], valid.copy()
        for spline, there in zip(splines, seen, strict=True):
            warped.append(_at(spline, place, rows))
            slopes.append(_at(spline, place + 0.5, rows) - _at(spline, place - 0.5, rows))
            inside &= cv2.remap(there, place.astype(np.float32), rows, cv2.INTER_LINEAR) > 0.999
        weight = inside.astype(np.float64)
        count = _box(weight, window) * len(right)
        ours = [np.where(inside, np.nan_to_num(frame), 0.0) for frame in left]
        theirs = [np.where(inside, frame, 0.0) for frame in warped]
        grads = [np.where(inside, frame, 0.0) for frame in slopes]
        # Zero mean and unit variance over the window and all frames.
        with np.errstate(invalid="ignore", divide="ignore"):
            sums = {
                name: sum(_box(a * b, window) for a, b in zip(x, y, strict=True))
                for name, (x, y) in {
                    "ll": (ours, ours),
                    "rr": (theirs, theirs),
                    "lr": (ours, theirs),
                    "gg": (grads, grads),
                    "gl": (grads, ours),
                    "gr": (grads, theirs),
                }.items()
            }
            means = {
                name: sum(_box(a, window) for a in x) / count
                for name, x in (("l", ours), ("r", theirs), ("g", grads))
            }
            var_l = sums["ll"] / count - means["l"] ** 2
            var_r = sums["rr"] / count - means["r"] ** 2
            gain = np.sqrt(var_r / var_l)  # left in the right picture's grey values
            g_l = gain * (sums["gl"] - count * means["g"] * means["l"])
            g_r = sums["gr"] - count * means["g"] * means["r"]
            g_g = sums["gg"] - count * means["g"] ** 2
            # R(x - D): dR/dD = -slope, so that R - L is taken away by + slope.
            step = (g_r - g_l) / g_g
            covariance = sums["lr"] / count - means["l"] * means["r"]
            alike = covariance / np.sqrt(var_l * var_r)
            rest = 2.0 * var_r * (1.0 - alike) * count / np.maximum(count - 2.0, 1.0)
            sigma = np.sqrt(rest / g_g)
        usable = inside & np.isfinite(step) & np.isfinite(sigma)
        move = np.clip(step, -_LONGEST_PX, _LONGEST_PX)
        found = np.asarray(mean + np.where(usable, move, 0.0), np.float64)
    contrast = np.sqrt(np.maximum(var_r, 0.0))
    enough = contrast > _CONTRAST * float(np.nanstd(right)) if right.size else usable
    good = (
        usable
        & enough
        & (alike > _ALIKE)
        & (np.abs(step) < _LONGEST_PX)
        & (np.abs(found - disparity) < 1.0)
    )
    result[good] = found[good]
    return result, np.where(good, sigma, np.nan), good


def _points(
    names: list[str],
    cameras: list[Camera],
    made: _Rectified,
    disparity: Array,
    sigma: Array,
    valid: Mask,
) -> JointCloud:
    """Return the points of the first camera's pixels, between those of its rectified picture."""
    first, second = cameras
    pixels = first.pixel_grid().reshape(-1, 2)
    origins, directions = first.unproject(pixels)
    local = directions @ first.pose.rotation @ made.turns[0].T
    with np.errstate(invalid="ignore", divide="ignore"):
        place = local[:, :2] / local[:, 2:] * made.focal + made.centres[0]
    rows, columns = valid.shape
    inside = (local[:, 2] > 0) & (place >= 0).all(axis=1)
    inside &= (place[:, 0] <= columns - 1.001) & (place[:, 1] <= rows - 1.001)
    place = np.where(inside[:, None], place, 0.0)
    i, j = np.floor(place).astype(np.intp).T
    x, y = (place - np.floor(place)).T
    value, spread = np.zeros(len(place)), np.zeros(len(place))
    for dj, di, weight in (
        (0, 0, (1 - x) * (1 - y)),
        (0, 1, x * (1 - y)),
        (1, 0, (1 - x) * y),
        (1, 1, x * y),
    ):
        at = np.minimum(j + dj, rows - 1), np.minimum(i + di, columns - 1)
        inside &= valid[at]
        value += weight * np.nan_to_num(disparity[at])
        spread += weight * np.nan_to_num(sigma[at])  # neighbours share their windows
    own = np.nonzero(inside)[0]
    place, value, spread = place[own], value[own], spread[own]
    origins, directions = origins[own], directions[own]
    step = 0.01
    ends = [
        _distance(second, made, origins, directions, place, value + e) for e in (-step, 0.0, step)
    ]
    slope = (ends[2] - ends[0]) / (2.0 * step)
    points = origins + ends[1][:, None] * directions
    good = np.isfinite(slope) & (ends[1] > 0.0) & np.isfinite(second.project(points)).all(axis=1)
    points, kept = points[good], pixels[own][good].astype(np.int32)
    count = len(points)
    places = np.stack([kept, second.project(points)], axis=1).astype(np.float32)
    return JointCloud(
        points,
        kept,
        (first.height, first.width),
        ("u",),
        spread[good][:, None],
        (slope[good, None] * directions[good])[:, None],
        pairs=(Pair(names[0]),),
        camera=np.zeros(count, np.int8),
        shapes={n: (c.height, c.width) for n, c in zip(names, cameras, strict=True)},
        rays=np.full(count, 2, np.int8),
        chi_square=np.full(count, np.nan),
        places=places,
    )


def _distance(
    second: Camera,
    made: _Rectified,
    origins: Array,
    directions: Array,
    place: Array,
    disparity: Array,
) -> Array:
    """Return how far along its ray a pixel of a disparity is: nearest to the second one's ray."""
    other = np.column_stack((place[:, 0] - disparity, place[:, 1]))
    ray = np.column_stack(((other - made.centres[1]) / made.focal, np.ones(len(other))))
    along = ray @ made.turns[1] @ second.pose.rotation.T
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    apart = second.pose.position - origins
    cosine = np.einsum("ni,ni->n", directions, along)
    one, two = (np.einsum("ni,ni->n", apart, way) for way in (directions, along))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((one - cosine * two) / (1.0 - cosine**2))
