"""Fusion by bands of rows: the same bits as in one piece, and memory that is bounded."""

import tracemalloc

import numpy as np
import pytest
from focus_stacks import slanted_plane

from slbench.capture.fusion import Alignment, align, maximum_weights, selective, selective_weights
from slbench.capture.fusion.exposure import Balanced, differ, frame_gains
from slbench.capture.fusion.folder import Luminance
from slbench.capture.fusion.measures import focus_measures
from slbench.capture.fusion.photographs import FusionMethod, fuse_photographs
from slbench.capture.fusion.stack import Kept, banded

COUNT, SHAPE = 6, (140, 96)


def stack_of(dtype, colour=False, seed=0):
    rng = np.random.default_rng(seed)
    plane = slanted_plane(COUNT, SHAPE, margin=1.0, blur_px=0.6, seed=seed)
    found = []
    for p in range(COUNT):
        image = np.clip(plane.image(plane.blur(p)) + 0.01 * rng.normal(size=SHAPE), 0, 1)
        if colour:
            image = np.stack([image, 0.8 * image, rng.random() * image**2], axis=2)
        whole = np.issubdtype(dtype, np.integer)
        found.append(
            np.rint(image * np.iinfo(dtype).max).astype(dtype) if whole else image.astype(dtype)
        )
    return found


def moves():
    """Shift, magnification, a turn and perspective, of which one frame stays."""
    found = np.repeat(np.eye(3)[None], COUNT, axis=0)
    for p in range(COUNT):
        step = p - 2
        found[p] += np.array([[0.01, 0.004, 3.3], [-0.004, 0.01, -7.7], [1e-5, -2e-5, 0.0]]) * step
    return Alignment(found, np.ones(COUNT), 2)


class Photos:
    """Photographs in memory instead of on disk."""

    def __init__(self, images):
        self.images, self.shape, self.dtype = images, images[0].shape, images[0].dtype

    def __len__(self):
        return len(self.images)

    def __getitem__(self, index):
        return self.images[index]


def in_bands(monkeypatch, rows):
    monkeypatch.setattr(selective, "_LEAST_ROWS", rows)
    monkeypatch.setattr(selective, "_BAND_BYTES", 0)


@pytest.mark.parametrize("rows", [1, 7, 32, 139])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("aligned", [False, True])
def test_weights_by_bands_are_those_of_the_whole(monkeypatch, rows, dtype, aligned):
    stack = stack_of(dtype)
    stack = moves().apply(stack) if aligned else stack
    positions = [0.0, 3.0, 1.0, 2.0, 4.5, 9.0]
    for measure in (*focus_measures.names(), "published", "maximum"):
        options = {"positions": positions, "window": 5}
        make = maximum_weights if measure == "maximum" else selective_weights
        if measure == "published":
            options["variant"] = "published"
        elif measure != "maximum":
            options["measure"] = measure
        monkeypatch.undo()
        whole = make(stack, **options)
        in_bands(monkeypatch, rows)
        parts = make(stack, **options)
        for name in ("weights", "focus", "selectivity_db"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("name", ["saf", "maximum", "pyramid"])
@pytest.mark.parametrize("motion", [None, "affine"])
def test_photographs_by_bands_are_fused_as_their_weights_fuse_them(
    monkeypatch, colour, name, motion
):
    photographs = Photos(stack_of(np.uint8, colour))
    method = FusionMethod(name=name, window=5, motion=motion)
    grey, stack = Luminance(photographs), photographs
    if motion is not None:
        alignment = align(grey, motion=motion)
        grey, stack = alignment.apply(grey), alignment.apply(photographs)
    gains = frame_gains(grey, COUNT // 2, 255.0)
    if differ(gains):
        grey, stack = Balanced(grey, gains), Balanced(stack, gains)
    weights = method.weights(grey)
    expected = np.clip(np.rint(weights.fuse(stack)), 0, 255)
    for rows in (11, 1000):
        in_bands(monkeypatch, rows)
        fused = fuse_photographs(photographs, method)
        np.testing.assert_array_equal(fused.pixels, expected)
        if name != "pyramid":
            for key in ("focus", "selectivity_db", "noise_gain"):
                np.testing.assert_array_equal(getattr(fused, key), getattr(weights, key))


def test_rows_of_moved_frames_are_those_of_the_whole():
    stack = stack_of(np.uint8, colour=True)
    for moved in (moves().apply(stack), moves().apply(Luminance(stack))):
        bands = Kept(banded(moved))
        for p in range(COUNT):
            whole = moved[p]
            for top, bottom in ((0, 140), (20, 60), (30, 50), (0, 1), (139, 140), (55, 90)):
                np.testing.assert_array_equal(bands.rows(p, top, bottom), whole[top:bottom])


def test_memory_beyond_the_frames_does_not_grow_with_their_number(monkeypatch):
    monkeypatch.setattr(selective, "_BAND_BYTES", 1 << 18)
    rng = np.random.default_rng(0)
    image_bytes = 400 * 300
    beyond = {}
    for count in (6, 48):
        photographs = Photos(
            [rng.integers(0, 256, (400, 300), dtype=np.uint8) for _ in range(count)]
        )
        method = FusionMethod(motion=None)  # frames of noise have none
        fuse_photographs(photographs, method)
        tracemalloc.start()
        fuse_photographs(photographs, method)
        beyond[count] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    # In one piece 42 frames more cost six bytes a pixel each.
    assert beyond[48] - beyond[6] < 0.25 * 42 * 6 * image_bytes
