"""Block matching of textured surfaces: exact points, spread over draws, OpenCV's own depth."""

from dataclasses import replace

import numpy as np
import pytest
from several_cameras import LEFT, Ball, Plate, camera_at, projector_at, truth

from slbench.cloud.blocks import match_blocks
from slbench.core.errors import InputError
from slbench.rig import Lens, Pair, Rig

#: Cameras of 0.25 mm a pixel, 30 degrees apart.
CAMERA = {"size": (200, 120), "pitch": 0.01}
CAMERAS = {"left": camera_at(-100.0, **CAMERA), "right": camera_at(100.0, **CAMERA)}
RIG = Rig(CAMERAS, {"main": projector_at(0.0)})
FLAT, TILTED, CURVED = [Plate()], [Plate(0.0, 0.3)], [Ball(100.0, -100.0)]
NOISE = 1.5  # DN


def texture(seed):
    """Return random waves on the panel of 6 px to 15 px, of unit deviation."""
    rng = np.random.default_rng(seed)
    angles, periods = rng.uniform(0, 2 * np.pi, 60), rng.uniform(6.0, 15.0, 60)
    ways = 2 * np.pi / periods * np.array([np.cos(angles), np.sin(angles)])
    phases = rng.uniform(0, 2 * np.pi, 60)
    return lambda panel: np.cos(panel @ ways + phases).sum(axis=-1) / np.sqrt(30.0)


def frames(rig, surfaces, count=1, seed=None, gains=(1.0, 1.0)):
    """Return pictures by camera of a textured surface; noise where there is a seed."""
    rng = None if seed is None else np.random.default_rng(seed)
    found = {}
    for (name, _), gain in zip(rig.cameras.items(), gains, strict=True):
        points, lit = truth(rig, Pair(name, "main"), surfaces)
        panel = rig.projectors["main"].project(np.nan_to_num(points))
        stack = np.stack([100.0 + 30.0 * texture(k)(panel) for k in range(count)]) * gain
        stack = np.where(lit, stack, 2.0)
        if rng is not None:
            stack = stack + rng.normal(0.0, NOISE, stack.shape)
        found[name] = stack
    return found


def away(rig, cloud, surfaces):
    true, _ = truth(rig, LEFT, surfaces)
    _, directions = rig.cameras["left"].unproject(cloud.pixels)
    apart = cloud.points - true[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    return np.einsum("ni,ni->n", apart, directions)


@pytest.mark.parametrize("surfaces", [FLAT, TILTED, CURVED], ids=["flat", "tilted", "curved"])
@pytest.mark.parametrize("count", [1, 4])
def test_points_lie_on_the_surface(surfaces, count):
    cloud = match_blocks(RIG, frames(RIG, surfaces, count))
    lit = truth(RIG, LEFT, surfaces)[1].sum()
    assert len(cloud) > 0.6 * lit
    error = away(RIG, cloud, surfaces)
    # A pixel of disparity is 0.25 mm / 2 sin(15 degrees) = 0.5 mm of depth: 0.03 px are left,
    # by windows on slopes and by resampling.
    assert np.median(np.abs(error)) < 0.015
    assert np.percentile(np.abs(error), 99.0) < 0.15


def test_brightness_order_and_lens_do_not_matter():
    bent = {"distortion": (-0.1, 0.05, 0.001, -0.001, 0.0)}
    cameras = {"left": camera_at(-100.0, **CAMERA, **bent), "right": camera_at(100.0, **CAMERA)}
    rig = Rig(cameras, RIG.projectors)
    found = frames(rig, CURVED, 2, gains=(1.0, 0.4))
    cloud = match_blocks(Rig(cameras, {}), found)
    assert np.median(np.abs(away(rig, cloud, CURVED))) < 0.015
    other = match_blocks(rig, {"right": found["right"], "left": found["left"]})
    true, _ = truth(rig, Pair("right", "main"), CURVED)
    apart = other.points - true[other.pixels[:, 1], other.pixels[:, 0]]
    assert np.median(np.linalg.norm(apart, axis=1)) < 0.015
    assert len(other) > 0.5 * len(cloud)


def test_cameras_above_each_other():
    cameras = {"left": camera_at(0.0, 100.0, **CAMERA), "right": camera_at(0.0, -100.0, **CAMERA)}
    rig = Rig(cameras, RIG.projectors)
    cloud = match_blocks(rig, frames(rig, CURVED, 2))
    assert len(cloud) > 8000
    assert np.median(np.abs(away(rig, cloud, CURVED))) < 0.015


def test_measured_deviations_are_those_of_draws():
    scores, known = [], []
    for seed in range(6):
        cloud = match_blocks(RIG, frames(RIG, FLAT, 2, seed=seed))
        image = np.full(truth(RIG, LEFT, FLAT)[1].shape, np.nan)
        image[cloud.pixels[:, 1], cloud.pixels[:, 0]] = away(RIG, cloud, FLAT)
        scores.append(image)
        known.append(np.median(cloud.sigma_total_mm))
    spread = np.nanstd(np.array(scores), axis=0, ddof=1)
    ratio = np.nanmedian(known) / np.nanmedian(spread)
    # Windows share what resampling smooths: deviations are measured to a third.
    assert 0.67 < ratio < 1.5


def test_more_frames_lessen_noise():
    spread = []
    for count in (1, 4):
        clouds = [match_blocks(RIG, frames(RIG, FLAT, count, seed=seed)) for seed in range(4)]
        images = []
        for cloud in clouds:
            image = np.full((120, 200), np.nan)
            image[cloud.pixels[:, 1], cloud.pixels[:, 0]] = cloud.points[:, 2]
            images.append(image)
        spread.append(np.nanmedian(np.nanstd(images, axis=0, ddof=1)))
    assert spread[1] == pytest.approx(spread[0] / 2.0, rel=0.25)


def test_what_one_camera_does_not_see_has_no_points():
    step = [Plate(-10.0), Plate(0.0, x=(-8.0, 8.0))]
    cloud = match_blocks(RIG, frames(RIG, step, 3))
    error = np.abs(away(RIG, cloud, step))
    # Edges are as round as a window, 9 px of 0.25 mm, is wide.
    inside = (
        np.abs(np.abs(truth(RIG, LEFT, step)[0][cloud.pixels[:, 1], cloud.pixels[:, 0], 0]) - 8.0)
        > 3.0
    )
    assert np.median(error) < 0.015
    assert np.percentile(error[inside], 98.0) < 0.3


def test_nothing_is_matched_where_there_is_no_pattern():
    plain = {name: np.full((1, 120, 200), 50.0) for name in CAMERAS}
    assert len(match_blocks(RIG, plain)) == 0


def test_what_cannot_be_matched_says_so():
    found = frames(RIG, FLAT)
    with pytest.raises(InputError, match="two cameras, got left"):
        match_blocks(RIG, {"left": found["left"]})
    with pytest.raises(InputError, match="did you mean 'right'"):
        match_blocks(RIG, {"left": found["left"], "rigt": found["right"]})
    with pytest.raises(InputError, match="frames of right: expected 1, as many as of left, got 2"):
        match_blocks(RIG, {"left": found["left"], "right": np.repeat(found["right"], 2, axis=0)})
    with pytest.raises(InputError, match="odd"):
        match_blocks(RIG, found, window_px=8)
    with pytest.raises(InputError, match="nearest and a farther"):
        match_blocks(RIG, found, (500.0, 300.0))
    with pytest.raises(InputError, match="frames of left"):
        match_blocks(RIG, {"left": found["left"][:, 1:], "right": found["right"]})
    flat = replace(CAMERAS["left"], lens=Lens.telecentric(0.04, 0.0, 430.0))
    with pytest.raises(InputError, match="perspective"):
        match_blocks(Rig({**CAMERAS, "left": flat}, {}), found)
