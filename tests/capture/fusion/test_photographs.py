"""Photographs as people take them: exposures that differ, focusing that magnifies."""

import cv2
import numpy as np
import pytest
from photograph_stacks import photograph_stack

from slbench.capture.fusion.align import magnified
from slbench.capture.fusion.exposure import differ, frame_gains
from slbench.capture.fusion.folder import Photographs
from slbench.capture.fusion.photographs import FusionMethod, Scale, fuse_photographs
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_exr, read_ply, write_png

STILL = {"breathing": 0.0, "shake_px": 0.0}
#: What differs: nothing, exposure, magnification and shake, all; much noise, few frames.
KINDS = [
    {**STILL, "gains": 0.0},
    STILL,
    {"gains": 0.0},
    {},
    {"noise_dn": 4.0},
    {"frames": 4, "blur_px": 1.6},
]


def made(**kind):
    return photograph_stack(shape=(192, 240), seed=1, **kind)


def taken(folder, frames):
    folder.mkdir()
    for p, frame in enumerate(frames):
        write_png(folder / f"{p}.png", frame)
    return Photographs.open(folder)


def error_dn(image, stack):
    """RMS against the truth but for a border, into which alignment brings what was not seen."""
    return np.sqrt(np.mean((image.astype(float) - stack.truth)[16:-16, 16:-16] ** 2))


@pytest.mark.filterwarnings("ignore::slbench.core.errors.InputWarning")  # of the bad ones
@pytest.mark.parametrize("kind", KINDS)
def test_the_default_is_near_the_best_of_our_own(tmp_path, kind):
    stack = made(**kind)
    photographs = taken(tmp_path / "taken", stack.frames)
    default = error_dn(fuse_photographs(photographs, FusionMethod()).pixels, stack)
    best = min(
        error_dn(fuse_photographs(photographs, FusionMethod(name=n, motion=m)).pixels, stack)
        for n in ("saf", "maximum", "pyramid")
        for m in (None, "magnification", "affine")
    )
    assert default < 1.15 * best
    assert default < 0.6 * error_dn(stack.frames[len(stack.frames) // 2], stack)


def test_exposures_show_neither_as_blotches_nor_as_errors(tmp_path):
    stack, even = made(**STILL), made(**STILL, gains=0.0)
    found = fuse_photographs(taken(tmp_path / "uneven", stack.frames), FusionMethod())
    same = fuse_photographs(taken(tmp_path / "even", even.frames), FusionMethod())
    assert found.to_dict()["balanced"]
    assert not same.to_dict()["balanced"]
    # Rounding to 8 bit of a darker frame is all that is lost.
    assert error_dn(found.pixels, stack) < 1.1 * error_dn(same.pixels, even)
    assert np.std((found.pixels - stack.truth)[stack.plain]) < 1.0
    with pytest.warns(InputWarning, match=r"exposures differ by \d+ %.*balance"):
        left = fuse_photographs(taken(tmp_path / "left", stack.frames), FusionMethod(balance=False))
    assert error_dn(left.pixels, stack) > 4 * error_dn(found.pixels, stack)


def test_gains_are_found_whatever_is_in_focus():
    even = made(**STILL, gains=0.0, noise_dn=0.0).frames.astype(float)
    gains = np.exp(np.random.default_rng(3).normal(0.0, 0.2, len(even)))
    middle = len(even) // 2
    gains /= gains[middle]
    # Blur and rounding leave a few tenths of a per cent.
    np.testing.assert_allclose(
        frame_gains(even / gains[:, None, None], middle, 255), gains, rtol=5e-3
    )
    assert not differ(frame_gains(even, middle, 255))


def test_what_is_clipped_does_not_count():
    even = made(**STILL, gains=0.0).frames.astype(float)
    middle = len(even) // 2
    frames = even.copy()
    frames[0] = np.clip(1.6 * even[0], 0, 255)
    assert (frames[0] == 255).mean() > 0.02
    assert frame_gains(frames, middle, 255)[0] == pytest.approx(1 / 1.6, rel=0.01)
    frames[0] = 255.0  # nothing to tell by
    assert frame_gains(frames, middle, 255)[0] == 1.0


@pytest.mark.parametrize("seed", range(3))
def test_a_still_stack_is_left_where_it_is(seed):
    still = photograph_stack(**STILL, seed=seed).frames
    assert magnified(list(still)) is None
    moving = photograph_stack(shake_px=0.0, seed=seed).frames
    found = magnified(list(moving))
    scales = np.array([np.sqrt(np.linalg.det(t[:2, :2])) for t in found.transforms])
    # Blur that changes across the picture: half a pixel at the corners of 320.
    np.testing.assert_allclose(scales, 1 + 0.004 * np.arange(-4, 5), atol=0.5 / 160)


def test_other_scenes_are_fused_as_they_are_and_warned_of(tmp_path):
    rng = np.random.default_rng(0)
    photographs = taken(tmp_path / "noise", rng.integers(0, 256, (5, 40, 48), dtype=np.uint8))
    with pytest.warns(InputWarning, match="could not be aligned"):
        fused = fuse_photographs(photographs, FusionMethod())
    assert fused.alignment is None


def test_floats_stay_floats(tmp_path):
    stack = made(**STILL, gains=0.0)
    folder = tmp_path / "floats"
    folder.mkdir()
    for p, frame in enumerate(stack.frames):
        np.save(folder / f"{p}.npy", (frame / 255.0).astype(np.float32))
    fused = fuse_photographs(Photographs.open(folder), FusionMethod())
    of_bytes = fuse_photographs(taken(tmp_path / "bytes", stack.frames), FusionMethod())
    np.testing.assert_allclose(255 * fused.pixels, of_bytes.pixels, atol=0.51)  # of rounding
    with pytest.raises(InputError, match=r"\.exr"):
        fused.save(tmp_path / "fused.png")
    fused.save(tmp_path / "fused.exr")
    np.testing.assert_array_equal(read_exr(tmp_path / "fused.exr")["Y"], fused.pixels)


def test_heights_and_points(tmp_path):
    stack = made(**STILL, gains=0.0)
    fused = fuse_photographs(taken(tmp_path / "taken", stack.frames), FusionMethod())
    scale = Scale(step_um=-50.0, pixel_um=2.0)
    out = tmp_path / "sharp.png"
    fused.save(out, scale)
    assert {path.name for path in tmp_path.glob("sharp*")} == {
        path.name for path in fused.files(out, scale)
    }
    heights = read_exr(tmp_path / "sharp-heights.exr")["Y"]
    np.testing.assert_allclose(heights, -0.05 * fused.focus, rtol=1e-6)
    points, fields = read_ply(tmp_path / "sharp-points.ply")
    v, u = np.nonzero(np.isfinite(heights))
    np.testing.assert_allclose(points, np.stack([2e-3 * u, -2e-3 * v, heights[v, u]], 1), rtol=1e-6)
    np.testing.assert_array_equal(fields["grey"], fused.pixels[v, u])
    picture = cv2.imread(str(tmp_path / "sharp-summary.png"))
    assert picture.shape[1] > 3 * 240
    pyramid = fuse_photographs(
        taken(tmp_path / "again", stack.frames), FusionMethod(name="pyramid")
    )
    with pytest.raises(InputError, match="pyramid"):
        pyramid.save(out, scale)
