"""Colour pictures: channels mixed by cross-talk, and taken apart again."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from photographed import photograph
from scipy.interpolate import CubicSpline

from slbench.capture.capture import Capture
from slbench.capture.shown import write_pictures
from slbench.cloud.decoded import decode_capture
from slbench.core.errors import InputError, InputWarning
from slbench.patterns import Flat, Fringes, GrayCode, PatternSequence, decode
from slbench.patterns.crosstalk import mixed
from slbench.patterns.matching.bound import cramer_rao
from slbench.patterns.noise import NoiseModel

#: Measured of a consumer projector and camera in the literature's size: 3 to 15 % beside.
MATRIX = ((0.84, 0.12, 0.04), (0.10, 0.78, 0.12), (0.02, 0.15, 0.83))
PANEL = (480, 40)
NOISE = NoiseModel(read_dn=1.0, gain_dn_per_e=0.02, offset_dn=8.0)


def sequence_of(text, matrix=MATRIX):
    return replace(PatternSequence.parse(text, PANEL), crosstalk=matrix)


def places(shape=(60, 80)):
    return np.random.default_rng(3).uniform(20.0, 460.0, shape)


def seen(sequence, u, matrix=None, noise=NOISE, b=60.0):
    """Frames of colour pictures, DN, before noise."""
    alone = photograph(sequence, {"u": u}, a=90.0, b=b)
    return noise.offset_dn + mixed(alone, matrix or sequence.crosstalk)


@pytest.mark.parametrize(
    "text", ["1,16@3", "1,10,50@4", "15,16@3+heterodyne", "16@3+1@3", "1,16@0/90/180"]
)
def test_channels_are_taken_apart(text):
    u = places()
    sequence = sequence_of(text)
    found = decode(seen(sequence, u), sequence, noise=NOISE)
    assert found.mask.all()
    # Frames that are taken apart are float32.
    np.testing.assert_allclose(found.coordinate["u"], u, atol=2e-4)
    # The modulation is that of a channel alone.
    np.testing.assert_allclose(found.modulation, 60.0, rtol=1e-5)


def test_two_channels_and_a_gray_code():
    sequence = replace(
        PatternSequence(PANEL, (GrayCode("u"), Fringes(16, 4))),
        crosstalk=((0.9, 0.1), (0.2, 0.8)),
    )
    u = np.rint(places()) + 0.2
    found = decode(seen(sequence, u), sequence, noise=NOISE)
    np.testing.assert_allclose(found.coordinate["u"][found.mask], u[found.mask], atol=2e-4)
    assert found.mask.mean() > 0.99


@pytest.mark.parametrize(
    ("text", "own"),
    [("1,16@3", True), ("1,16@6", True), ("1,10,40@4", False), ("speckle12", False)],
)
def test_deviations_are_those_of_repeats(text, own):
    """The noise of what the channels become is not independent: the decoder carries it through."""
    u = np.full((40, 40), 203.3) + np.arange(40) * 3.0
    sequence = sequence_of(text)
    if text.startswith("speckle"):
        (part,) = sequence.parts
        profiles = np.array([part.profile(k, PANEL[0]) for k in range(12)])
        alone = np.array([30 + 120 * np.interp(u, np.arange(PANEL[0]), p) for p in profiles])
        clean = NOISE.offset_dn + mixed(alone, MATRIX)
    else:
        clean = seen(sequence, u)
    rng = np.random.default_rng(5)
    squares, predicted = [], []
    for _ in range(12):
        noisy = clean + rng.standard_normal(clean.shape) * np.sqrt(NOISE.variance(clean))
        found = decode(noisy.astype(np.float32), sequence, noise=replace(NOISE, step_dn=0.0))
        error = (found.coordinate["u"] - u)[found.mask]
        right = np.abs(error) < 8.0
        squares.append(np.mean((error / found.sigma["u"][found.mask])[right] ** 2))
        predicted.append(found.sigma["u"][found.mask].mean())
    # 19,200 deviations: 0.5 %; the shot noise of the mean frame instead of the true one less.
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.05)
    if own:
        # As if channels were independent it would be wrong by this much: the test can fail.
        factor = np.mean(np.sum(np.linalg.inv(MATRIX) ** 2, axis=1))
        alone = decode(
            np.linalg.solve(MATRIX, (clean - 8.0).reshape(-1, 3, 1600))
            .reshape(clean.shape)
            .astype(np.float32),
            replace(sequence, crosstalk=None),
            noise=NoiseModel(NOISE.read_dn * factor**0.5, NOISE.gain_dn_per_e * factor, 0.0, 0.0),
        )
        assert np.mean(predicted) != pytest.approx(alone.sigma["u"].mean(), rel=0.08)


@pytest.mark.parametrize("text", ["1,16@3", "white+white+white+1,8@3", "speckle12"])
def test_the_bound_is_that_of_mixed_channels(text):
    """The inverse of the whole Fisher matrix of place, gain and offset, row by row."""
    sequence, b, mean = sequence_of(text), 40.0, 90.0
    found = cramer_rao(sequence, modulation=b, mean=mean, noise=NOISE)
    profiles = np.array([f.part.profile(f.index, PANEL[0]) for f in sequence.frames()])
    shown = mixed(profiles, MATRIX)
    slope = CubicSpline(np.arange(PANEL[0]), shown.T)(np.arange(PANEL[0]), 1).T
    for x in (33, 200, 377):
        weight = 1.0 / NOISE.variance(mean + 2.0 * b * (shown[:, x] - 0.5))
        design = np.stack([2.0 * b * slope[:, x], shown[:, x], np.ones(len(shown))])
        covariance = np.linalg.inv(design * weight @ design.T)
        assert found[x] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-6)


def test_without_its_matrix_a_capture_is_wrong_and_said_to_be():
    u = places()
    sequence = PatternSequence.parse("1,8@6", PANEL)
    frames = seen(replace(sequence, crosstalk=MATRIX), u).astype(np.float32)
    wrong = decode(frames, sequence, noise=NOISE)
    assert np.nanstd(wrong.coordinate["u"] - u) > 0.1
    with pytest.warns(InputWarning, match=r"sinusoid"):
        decode_capture(Capture(frames, sequence, None, NOISE))
    right = decode_capture(Capture(frames, replace(sequence, crosstalk=MATRIX), None, NOISE))
    assert right.warnings == ()


def test_measured_noise_is_that_of_the_camera():
    u = places((200, 200))
    sequence = sequence_of("1,8@6")
    noise = NoiseModel(read_dn=1.5, step_dn=0.0)
    clean = seen(sequence, u, noise=noise)
    noisy = clean + np.random.default_rng(1).normal(0.0, 1.5, clean.shape)
    found = decode_capture(Capture(noisy.astype(np.float32), sequence, None))
    assert found.noise_kind == "measured"
    # 40,000 pixels of nine degrees of freedom over both sets: 0.2 %, and the trimmed mean's own.
    assert np.sqrt(found.noise.variance(90.0)) == pytest.approx(1.5, rel=0.02)


def test_saturation_is_that_of_the_camera_s_channels():
    u = places()
    sequence = sequence_of("1,16@3")
    frames = np.rint(seen(sequence, u)).astype(np.uint8)
    frames[4, 0, :] = 255  # one channel of the second picture
    found = decode(frames, sequence, noise=NOISE)
    assert not found.mask[0].any()
    assert found.mask[1:].all()


@pytest.mark.parametrize(
    ("matrix", "text", "said"),
    [
        (((1.0, 0.2), (0.1, 1.0), (0.0, 0.0)), "1,16@3", "square"),
        (((1.0,),), "1,16@3", "square"),
        ((), "1,16@3", "square"),
        (((1.0, 1.0), (1.0, 1.0)), "1,16@3", "told apart"),
        (((1.0, 0.0), (0.0, 1e-4)), "1,16@3", "told apart"),
        (((1.0, -0.1), (0.1, 1.0)), "1,16@3", "crosstalk"),
        (((1.0, float("nan")), (0.1, 1.0)), "1,16@3", "crosstalk"),
        (((84.0, 12.0), (10.0, 78.0)), "1,16@3", "not 84 %"),
        (MATRIX, "1,16@4", "multiple of 3"),
    ],
)
def test_what_is_no_crosstalk_is_refused(matrix, text, said):
    with pytest.raises(InputError, match=said):
        sequence_of(text, matrix)


def test_channels_of_a_picture_vary_along_one_axis():
    parts = (Fringes(1, 3), Fringes(1, 3, "v"))
    PatternSequence(PANEL, parts, crosstalk=MATRIX)
    with pytest.raises(InputError, match="frames 2 to 3 along u and v"):
        PatternSequence(PANEL, parts, crosstalk=((1.0, 0.1), (0.1, 1.0)))


def test_flat_frames_go_with_the_others_of_their_picture():
    parts = (Fringes(1, 3), Flat(1.0), Fringes(1, 3, "v"), Flat(0.0))
    sequence = PatternSequence(PANEL, parts, crosstalk=((1.0, 0.1), (0.1, 1.0)))
    assert sequence.frames_along("u").tolist() == [0, 1, 2, 3]
    assert sequence.frames_along("v").tolist() == [4, 5, 6, 7]


def test_tables_keep_it():
    sequence = sequence_of("1,16@3")
    table = sequence.to_dict()
    assert table["crosstalk"] == [list(row) for row in MATRIX]
    assert PatternSequence.from_dict(table) == sequence


def test_pictures_for_a_projector_and_their_photographs(tmp_path):
    sequence = sequence_of("1,8@3")
    write_pictures(sequence, tmp_path / "out")
    shown = sorted((tmp_path / "out" / "patterns").iterdir())
    assert [path.name for path in shown] == ["000.png", "001.png"]
    photographs = tmp_path / "out" / "photographs"
    photographs.mkdir()
    for path in shown:
        picture = cv2.imread(str(path))[..., ::-1] / 255.0  # red first
        photograph_ = 10.0 + 200.0 * np.einsum("ij,vuj->vui", MATRIX, picture)
        cv2.imwrite(str(photographs / path.name), np.rint(photograph_)[..., ::-1])
    found = Capture.load(tmp_path / "out").decode()
    error = found.coordinate["u"] - np.arange(PANEL[0])
    inside = np.s_[:, 10:-10]
    assert found.mask[inside].all()
    # Rounded to 255 levels: 0.4 DN of a modulation of 100, some 10 px a radian.
    assert np.abs(error[inside]).max() < 0.15
