"""Pictures as a code, decoded by matching along one axis or over the whole panel."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.io.images import write_png
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.patterns.images import Images
from slbench.patterns.matching.bound import cramer_rao
from slbench.patterns.matching.match import match
from slbench.patterns.matching.vectors import CodeVectors

PANEL = (96, 64)
NOISE = NoiseModel(read_dn=1.0)


def smooth(count, seed, along="uv"):
    """Pictures of a few random waves, the same along the axis that is not named."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(PANEL[0]) / PANEL[0], np.arange(PANEL[1]) / PANEL[1])
    pictures = []
    for _ in range(count):
        waves = np.zeros(x.shape)
        for _ in range(8):
            a, b, phase = rng.uniform(-5, 5), rng.uniform(-5, 5), rng.uniform(0, 6)
            waves += np.cos(2 * np.pi * (a * x * ("u" in along) + b * y * ("v" in along)) + phase)
        pictures.append(np.rint(255 * (waves - waves.min()) / np.ptp(waves)))
    return np.array(pictures, np.uint8)


def seen(pictures, u, v, seed):
    """Frames at whole places, with noise of 1 DN."""
    frames = 30 + 0.6 * pictures[:, v, u].astype(float)
    return (frames + np.random.default_rng(seed).normal(0, 1, frames.shape))[:, np.newaxis]


def places(seed, count=3000):
    rng = np.random.default_rng(seed)
    return rng.integers(2, PANEL[0] - 2, count), rng.integers(2, PANEL[1] - 2, count)


@pytest.mark.parametrize("coded", ["uv", "u", "v"])
def test_smooth_pictures_are_decoded_over_the_panel(coded):
    pictures = smooth(12, 1)
    sequence = PatternSequence(PANEL, (Images(pictures, coded),))
    assert sequence.variations == ("uv",)
    u, v = places(2)
    found = decode(seen(pictures, u, v, 3), sequence, noise=NOISE, keep_evidence=True)
    assert set(found.coordinate) == set(coded)
    assert found.mask.mean() > 0.95
    for axis in coded:
        error = (found.coordinate[axis][0] - (u if axis == "u" else v))[found.mask[0]]
        ratio = error / found.sigma[axis][0][found.mask[0]]
        assert np.abs(error).max() < 2.0  # no wrong place
        # Slopes are differences over two pixels, some per cent small for waves of ten pixels.
        assert ratio.std() == pytest.approx(1.0, rel=0.1)
    assert found.evidence[0]["correlation"].min() > 0.95


def test_random_dots_are_decoded_to_their_pixel():
    dots = 255 * np.random.default_rng(4).integers(0, 2, (20, PANEL[1], PANEL[0])).astype(np.uint8)
    sequence = PatternSequence(PANEL, (Images(dots, "uv"),))
    u, v = places(5)
    found = decode(seen(dots, u, v, 6), sequence, noise=NOISE)
    assert found.mask.mean() > 0.95
    np.testing.assert_array_equal(found.coordinate["u"][found.mask], u[found.mask[0]])
    np.testing.assert_array_equal(found.coordinate["v"][found.mask], v[found.mask[0]])
    np.testing.assert_allclose(found.sigma["u"][found.mask], 12**-0.5, rtol=1e-3)


def test_places_that_look_alike_are_masked():
    half = smooth(12, 7)[:, :, : PANEL[0] // 2]
    pictures = np.concatenate([half, half], axis=2)
    sequence = PatternSequence(PANEL, (Images(pictures, "uv"),))
    u, v = places(8, 500)
    assert not decode(seen(pictures, u, v, 9), sequence, noise=NOISE).mask.any()


def test_pictures_of_one_axis_are_matched_along_it():
    pictures = smooth(8, 10, along="v")
    sequence = PatternSequence(PANEL, (Images(pictures, "v"),))
    assert sequence.variations == ("v",)
    u, v = places(11)
    found = decode(seen(pictures, u, v, 12), sequence, noise=NOISE)
    error = (found.coordinate["v"][0] - v)[found.mask[0]]
    assert found.mask.mean() > 0.95
    assert (error / found.sigma["v"][0][found.mask[0]]).std() == pytest.approx(1.0, rel=0.05)


def test_pictures_are_read_from_and_kept_beside_a_manifest(tmp_path):
    pictures = smooth(11, 13)
    for k, picture in enumerate(pictures):
        write_png(tmp_path / f"mine_{k}.png", picture)  # 10 comes after 9
    table = {"kind": "images", "axes": "uv", "files": "mine_*.png"}
    sequence = PatternSequence.from_dict({"panel": PANEL, "parts": [table]}, tmp_path)
    assert sequence.parts == (Images(pictures, "uv"),)
    saved = tmp_path / "capture"
    Capture(np.rint(200 * sequence.images()).astype(np.uint8), sequence).save(saved)
    assert Capture.load(saved).sequence == sequence


@pytest.mark.parametrize("coded", ["u", "uv"])
def test_binary_pictures_that_a_lens_softened_are_decoded_within_a_pixel(coded):
    """Sharp, they tell a pixel from the next; a known blur tells places between them."""
    blur, count = 1.2, 14 if coded == "u" else 24
    rng = np.random.default_rng(14)
    bits = rng.integers(0, 2, (count, 1 if coded == "u" else PANEL[1], PANEL[0]))
    bits = np.repeat(bits, PANEL[1] // bits.shape[1], axis=1)
    sharp = (255 * bits).astype(np.uint8)
    soft = gaussian_filter(255.0 * bits, blur, mode="nearest", axes=(1, 2))
    u, v = rng.uniform(6, PANEL[0] - 6, 600), rng.integers(6, PANEL[1] - 6, 600)
    if coded == "uv":
        u = np.rint(u)
    frames = np.array([map_coordinates(one, (v, u), order=3) for one in soft])
    frames = (30 + 0.6 * frames + rng.normal(0, 1, frames.shape))[:, np.newaxis]

    def found(blur_px):
        sequence = PatternSequence(PANEL, (Images(sharp, coded, blur_px=blur_px),))
        return decode(frames, sequence, noise=NOISE)

    known = found(blur)
    error = known.coordinate["u"][0] - u
    assert known.mask.mean() > 0.95
    ratio = (error / known.sigma["u"][0])[known.mask[0]]
    # 600 draws tell a deviation to 3 %; slopes over two pixels are some per cent small.
    assert ratio.std() == pytest.approx(1.0, rel=0.15)
    assert np.median(np.abs(error[known.mask[0]])) < 0.1
    plain = found(0.0)
    off = np.abs(plain.coordinate["u"][0] - u)[plain.mask[0]]
    assert not plain.mask.any() or np.median(off) > 2.0 * np.median(np.abs(error[known.mask[0]]))


@pytest.mark.parametrize("finer", [1, 4])
def test_places_are_found_to_the_panels_very_edges(finer):
    """Half a pixel beyond the middle of the outer ones, between columns or not."""
    bits = np.random.default_rng(17).integers(0, 2, (10, 640))
    vectors = CodeVectors(gaussian_filter(1.0 * bits, 1.0, axes=1), np.zeros(10, np.int64))
    u = np.array([-0.45, -0.2, 0.3, 320.6, 639.2, 639.4])
    pieces, piece = vectors.pieces(), np.clip(u, 0, 638).astype(int)
    t = (u - piece)[:, np.newaxis]
    a, b, c, d = pieces[piece].transpose(1, 0, 2)
    frames = 30 + 150 * (a + t * (b + t * (c + t * d))).T
    found = match(frames, vectors, NoiseModel(read_dn=0.01), None, finer)
    assert found.sure.all()
    np.testing.assert_allclose(found.coordinate, u, atol=1e-3)


def test_the_bound_of_binary_pictures_knows_their_blur():
    """The lens has made slopes of the edges, by which places are told."""
    bits = np.random.default_rng(18).integers(0, 2, (6, 1, 640))
    sharp = (255 * np.repeat(bits, 12, axis=1)).astype(np.uint8)
    light = {"modulation": 70.0, "mean": 100.0, "noise": NOISE}
    for blur, told in ((1.0, True), (0.0, False)):
        sequence = PatternSequence((640, 12), (Images(sharp, "u", blur_px=blur),))
        assert np.isfinite(cramer_rao(sequence, **light)).all() == told


def test_a_known_blur_is_kept_with_the_pictures(tmp_path):
    sequence = PatternSequence(PANEL, (Images(smooth(5, 15, "u"), "u", blur_px=0.8),))
    again = PatternSequence.from_dict(sequence.to_dict(tmp_path), tmp_path)
    assert again == sequence
    assert again.parts[0].blur_px == 0.8
    assert sequence != PatternSequence(PANEL, (Images(smooth(5, 15, "u"), "u"),))


@pytest.mark.parametrize("blur", [-0.1, float("nan"), 7.0, "2"])
def test_a_blur_that_is_none_is_refused(blur):
    with pytest.raises(InputError, match=r"blur_px: expected .*(panel pixels|\(px\))"):
        Images(smooth(3, 16), "u", blur_px=blur)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"files": "none_*.png"}, r"files: expected pictures in .*, got no none_"),
        ({"files": "mine_0.png"}, r'files: expected names of pictures such as "mine_\*.png"'),
        ({"files": "../mine_*.png"}, "expected"),
        ({"files": "mine_*.png", "axes": "w"}, r'axes: expected "u", "v" or "uv"'),
        ({"files": "mine_*.png", "axis": "u"}, r"axis: expected one of the keys axes, files"),
        ({"files": "mine_*.png"}, r"files: expected pictures of the panel's 32 x 20 px, got 96 x"),
    ],
)
def test_mistakes_are_named(tmp_path, table, message):
    write_png(tmp_path / "mine_0.png", smooth(1, 14)[0])
    with pytest.raises(InputError, match=message):
        PatternSequence.from_dict(
            {"panel": [32, 20], "parts": [{"kind": "images"} | table]}, tmp_path
        )
