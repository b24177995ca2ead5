"""Several exposures of one scan: which frames a pixel takes, and folders that hold all of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench.bench.compare.sets import pattern_sets
from slbench.calibration.characterise.frames import check_alike
from slbench.capture.capture import Capture
from slbench.capture.exposures import Bracket
from slbench.capture.stack import FocusStack
from slbench.cloud.decoded import decode_capture
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_toml, write_png, write_toml
from slbench.datasets.spec.specification import load as load_specification
from slbench.detector import Detector
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.scene.file import load_scene
from slbench.scene.model import Exposure
from slbench.simulate.expose import Shutter, bracket_seed, capture
from slbench.simulate.transport import LightTransport

#: A camera that sees a panel of as many pixels, each row half as bright as the one before.
SIZE = (64, 8)
ROWS = 0.5 ** np.arange(SIZE[1])
FACING = np.diag([1.0, -1.0, -1.0])
RIG = Rig(
    Camera(*SIZE, (0.1, 0.1), Lens(20.0), pose=Pose(FACING, np.array([-20.0, 0.0, 200.0]))),
    Projector(*SIZE, (0.1, 0.1), Lens(20.0), pose=Pose(FACING, np.array([20.0, 0.0, 200.0]))),
)
DETECTOR = Detector(prnu=0.0, dsnu_e=0.0)
#: Exposes the brightest row to six times saturation.
SHUTTER = Shutter(6.0 * DETECTOR.saturation_e / DETECTOR.quantum_efficiency, 0.032)
BRACKET = (0.0625, 0.25, 1.0)
SEQUENCE = PatternSequence.parse("1,8@4", SIZE)


def transport():
    pixels = np.arange(SIZE[0] * SIZE[1])
    dark = np.zeros(SIZE[::-1])
    return LightTransport.from_entries(
        pixels, pixels, np.repeat(ROWS, SIZE[0]), SIZE[::-1], SIZE, dark
    )


TRANSPORT = transport()


def shots(bracket=BRACKET, seed=3, **options):
    given = TRANSPORT, SEQUENCE, RIG, DETECTOR, Exposure(bracket=bracket)
    return capture(*given, seed=seed, shutter=SHUTTER, **options)


def singles(seed=3):
    """Return the exposures of `shots` as captures of their own."""
    return [shots((f,), bracket_seed(seed, k)) for k, f in enumerate(BRACKET)]


def test_a_pixel_has_all_its_frames_from_the_longest_exposure_that_is_not_saturated():
    """By brute force, pixel by pixel."""
    found, alone = shots(), singles()
    for v in range(SIZE[1]):
        for u in range(SIZE[0]):
            good = [k for k in range(3) if alone[k].frames[:, v, u].max() < alone[k].top_dn]
            assert found.bracket.chosen[v, u] == max(good, default=0)
            np.testing.assert_array_equal(
                found.frames[:, v, u], alone[max(good, default=0)].frames[:, v, u]
            )
    # White of 0.375, 1.5 and 6 times saturation in the first row, and of half as much in each next.
    np.testing.assert_array_equal(found.bracket.chosen[:, 0], [0, 1, 1, 2, 2, 2, 2, 2])
    assert np.ptp(found.bracket.chosen, axis=1).max() == 0


def test_one_exposure_is_the_single_capture_byte_by_byte():
    found, alone = (
        shots((1.0,)),
        capture(TRANSPORT, SEQUENCE, RIG, DETECTOR, Exposure(), seed=3, shutter=SHUTTER),
    )
    assert found.bracket is None
    assert found.exposure_s == alone.exposure_s
    np.testing.assert_array_equal(found.frames, alone.frames)
    # The first of several is it too.
    np.testing.assert_array_equal(shots((1.0, 0.25)).bracket.values[0], alone.frames)


@given(st.permutations(range(3)))
@settings(max_examples=6, deadline=None)
def test_the_order_of_exposures_does_not_matter(order):
    bracket = shots().bracket
    times = [bracket.times_s[k] for k in order]
    found = Bracket.of(bracket.values[list(order)], times, 255)
    np.testing.assert_array_equal(found.frames, bracket.frames)


def test_deviations_are_those_of_the_exposure_a_pixel_takes():
    """sigma = W / (2 pi n) sqrt(2 (alpha + beta a) / N) / b, with light of its exposure."""
    phase, found = shots().decode(), shots()
    factors = np.array(BRACKET)[found.bracket.chosen]
    light = 6.0 * ROWS[:, np.newaxis] * factors * DETECTOR.saturation_e  # of white, electrons
    dark = DETECTOR.dark_current_e_per_s * SHUTTER.time_s * factors
    gain, noise = 1.0 / DETECTOR.e_per_dn, DETECTOR.noise_model()
    variance = noise.constant_variance + gain * gain * (0.5 * light + dark)
    expected = SIZE[0] / (2 * np.pi * 8) * np.sqrt(0.5 * variance) / (0.5 * gain * light)
    lit = phase.mask
    assert lit[:7].all()
    # Predictions take the measured modulation and mean, which noise moves by a few per cent.
    ratio = phase.sigma["u"][lit] / expected[lit]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.01)


def test_stated_deviations_are_right_over_many_draws():
    deep = replace(DETECTOR, bit_depth=12)  # whose rounding is no noise to speak of
    given = TRANSPORT, SEQUENCE, RIG, deep, Exposure(bracket=BRACKET)
    scores = []
    for seed in range(60):
        phase = capture(*given, seed=seed, shutter=SHUTTER).decode()
        scores.append((phase.coordinate["u"] - np.arange(SIZE[0])) / phase.sigma["u"])
    z = np.array(scores)
    assert np.isfinite(z[:, :7]).all()
    # 60 x 64 numbers a row: their RMS is known to 1.1 %, of eight rows to 0.4 %.
    rms = np.sqrt(np.nanmean(z**2, axis=(0, 2)))
    np.testing.assert_allclose(rms, 1.0, atol=0.045)
    assert np.sqrt(np.nanmean(z**2)) == pytest.approx(1.0, abs=0.016)
    assert np.nanmean(z) == pytest.approx(0.0, abs=4 / np.sqrt(z.size))


def test_it_measures_more_than_any_exposure_and_as_well_as_the_best_of_each_pixel():
    found, alone = shots().decode(), [one.decode() for one in singles()]
    assert found.mask.mean() > max(one.mask.mean() for one in alone)
    sigma = np.stack([one.sigma["u"] for one in alone])
    best = np.nanmin(sigma[:, found.mask], axis=0)
    np.testing.assert_array_equal(found.sigma["u"][found.mask], best)
    # 16 times the light: the root of it where shot noise rules, all of it where read noise does.
    rows = found.mask & alone[0].mask & (shots().bracket.chosen == 2)
    ratio = sigma[0][rows] / found.sigma["u"][rows]
    assert 4.0 < np.median(ratio) < 16.0


def test_saturated_at_all_exposures_is_masked():
    given = TRANSPORT, SEQUENCE, RIG, DETECTOR, Exposure(bracket=(1.0, 2.0))
    found = capture(*given, seed=3, shutter=SHUTTER)
    assert (found.bracket.chosen[:3] == 0).all()
    phase = found.decode()
    assert not phase.mask[:3].any()  # 6, 3 and 1.5 times saturation
    assert phase.mask[3:].all()
    bright = capture(*given[:-1], Exposure(bracket=(100.0, 200.0)), seed=3, shutter=SHUTTER)
    with pytest.warns(InputWarning, match="saturated"):  # of most, the exposures are questioned
        decode_capture(bright)


# -- folders ------------------------------------------------------------------------------------


def test_a_folder_holds_all_exposures(tmp_path):
    found = shots()
    found.save(tmp_path / "shots")
    manifest = read_toml(tmp_path / "shots" / "capture.toml")
    assert manifest["exposures_ms"] == pytest.approx([2, 8, 32])
    assert "exposure_ms" not in manifest
    assert len(manifest["frames"]) == 3 * 8
    again = Capture.load(tmp_path / "shots")
    np.testing.assert_array_equal(again.frames, found.frames)
    np.testing.assert_array_equal(again.bracket.values, found.bracket.values)
    assert again.bracket.times_s == pytest.approx(found.bracket.times_s)
    assert again.exposure_s == pytest.approx(0.032)
    assert "exposures 2, 8, 32 ms" in repr(again)
    assert repr(again.bracket).startswith("<Bracket, pixels from 2 ms ")
    decoded = decode_capture(replace(again, rig=None))  # rays of a camera like this do not meet
    counts = {one["ms"]: one["valid_pixels"] for one in decoded.to_dict()["exposures"]}
    assert sum(counts.values()) == decoded.to_dict()["valid_pixels"]
    assert ("valid_pixels at 2 ms", str(counts[2.0])) in decoded.rows()
    # Frames that were processed are saved themselves.
    other = replace(found, frames=found.frames // 2)
    assert other.bracket is None


def photographed(folder, values, times, depth_shift=0, **more):
    """Write a folder as a person would: pictures of each exposure, and a manifest."""
    names = []
    for time, frames in zip(times, values, strict=True):
        for k, frame in enumerate(frames):
            names.append(f"{time:g}ms-{k:02d}.png")
            write_png(folder / names[-1], (frame << depth_shift).astype(frame.dtype))
    table = {"frames": names, "exposures_ms": list(times), "patterns": SEQUENCE.to_dict()}
    write_toml(folder / "capture.toml", table | more)
    return folder


def test_real_photographs_without_a_noise_model(tmp_path):
    """Whatever the order of the exposures; the noise is measured by what a sinusoid leaves."""
    values = shots().bracket.values[::-1]
    folder = photographed(tmp_path, values, [32, 8, 2])
    found = Capture.load(folder)
    np.testing.assert_array_equal(found.frames, shots().frames)
    decoded = decode_capture(found)
    assert decoded.noise_kind == "measured"
    assert decoded.warnings == ()
    stated = shots().decode()
    ratio = decoded.phase.sigma["u"][stated.mask] / stated.sigma["u"][stated.mask]
    # 448 pixels with one degree of freedom each, twice: 5 %, and a line through their variances.
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.15)


def test_twelve_bits_left_aligned(tmp_path):
    deep = replace(DETECTOR, bit_depth=12)
    given = TRANSPORT, SEQUENCE, RIG, deep, Exposure(bracket=BRACKET)
    found = capture(*given, seed=3, shutter=SHUTTER)
    folder = photographed(tmp_path, found.bracket.values, [2, 8, 32], depth_shift=4)
    with pytest.warns(InputWarning, match="taken for 12 bit"):
        again = Capture.load(folder)
    np.testing.assert_array_equal(again.frames, found.frames)
    np.testing.assert_array_equal(again.bracket.chosen, found.bracket.chosen)


def test_a_single_listed_exposure_is_a_plain_capture(tmp_path):
    folder = photographed(tmp_path, shots().bracket.values[:1], [2])
    found = Capture.load(folder)
    assert found.bracket is None
    assert found.exposure_s == pytest.approx(0.002)


def test_pictures_are_evened():
    """White as the longest exposure would have it without a top; where one was taken, itself."""
    found = shots()
    phase = found.decode()
    grey = found.evened(phase.mean)[phase.mask].reshape(-1, SIZE[0])
    above = grey.mean(axis=1) - DETECTOR.black_dn
    expected = 3.0 * ROWS[: len(above)] * DETECTOR.saturation_e / DETECTOR.e_per_dn
    # Dark current and rounding leave less than a tenth of a DN.
    np.testing.assert_allclose(above, expected, rtol=0.01, atol=0.1)
    frame = singles()[0].frames[0]
    assert singles()[0].evened(frame) is frame


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"exposures_ms": [2, 8, 8]}, "exposures_ms: expected every exposure once, got 8 twice"),
        ({"exposures_ms": [2, 8]}, r"frames: expected 16, as many as patterns \(1,8@4 at 2 expo"),
        ({"exposures_ms": []}, "exposures_ms"),
        ({"exposures_ms": [2, 8, -1]}, "exposures_ms"),
        ({"exposures_ms": [2, 8, float("nan")]}, "exposures_ms"),
        ({"exposure_ms": 2.0}, "exposures_ms: expected none beside exposure_ms, got both"),
    ],
)
def test_bad_manifests(tmp_path, changes, line):
    folder = photographed(tmp_path, shots().bracket.values, [2, 8, 32])
    manifest = read_toml(folder / "capture.toml") | changes
    write_toml(folder / "capture.toml", manifest)
    with pytest.raises(InputError, match=line):
        Capture.load(folder)


def test_floats_need_a_top():
    values = shots().bracket.values.astype(np.float32)
    with pytest.raises(InputError, match="saturation_dn or bit_depth"):
        Bracket.of(values, [1, 2, 3], np.inf)
    # A frame that is not there is not taken.
    values[2, 0, 4, 5] = np.nan
    found = Bracket.of(values, [0.002, 0.008, 0.032], 255)
    assert found.chosen[4, 5] == 1
    assert Capture(found.frames, SEQUENCE, bracket=found).bracket is found


# -- what takes one exposure --------------------------------------------------------------------


def test_who_takes_one_exposure_says_so():
    found = shots()
    with pytest.raises(InputError, match="a: expected a capture of one exposure, got"):
        check_alike({"a": found})
    with pytest.raises(InputError, match=r"captures\[0\]: expected a capture of one exposure"):
        FocusStack([found, found])


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"exposure.bracket": [1, 1]}, "exposure.bracket: expected every exposure once"),
        ({"exposure.bracket": [0]}, "bracket"),
        ({"exposure.bracket": []}, "bracket"),
        ({"exposure.exposures_ms": [2, 8], "exposure.time_ms": 2}, "exposures_ms alone"),
        ({"exposure.exposures_ms": [2, 8], "exposure.bracket": [1, 2]}, "exposures_ms alone"),
        ({"exposure.bracket": [1, 2], "exposure.drift.change": 0.1}, "one exposure beside bit_pl"),
        ({"exposure.bracket": [1, 2], "focus.settings": 2}, "got several, and focus settings"),
        ({"exposure.bracket": [1, 2], "patterns.sequence": "m-array16px"}, "their neighbours"),
    ],
)
def test_bad_scenes(changes, line):
    with pytest.raises(InputError, match=line):
        load_scene("plane", changes=changes)


def test_scenes_in_colour_and_data_sets_have_one(tmp_path):
    with pytest.raises(InputError, match="got several, and a scene in colour"):
        load_scene("colour", changes={"exposure.bracket": [1, 2]})
    text = 'name = "d"\n[scene]\nextends = "plane"\n[scene.exposure]\nbracket = [1, 2]\n'
    (tmp_path / "d.toml").write_text(text)
    with pytest.raises(InputError, match="bracket: expected one exposure"):
        load_specification(tmp_path / "d.toml")


def test_times_of_a_scene():
    given = load_scene("plane", changes={"exposure.exposures_ms": [32, 2, 8]})
    assert given.exposure.time_s == 0.002
    assert given.exposure.bracket == (16.0, 1.0, 4.0)


# -- sets of a comparison -----------------------------------------------------------------------


def test_frames_and_light_of_sets_count_every_exposure():
    scene = load_scene("plane", preview=True)
    texts = ["1,8@4", "1,8@4 | bracket=0.25/1/4"]
    plain, several = pattern_sets(texts, scene)
    assert (plain.frames, several.frames) == (8, 24)
    assert (plain.light, several.light) == (8, 8 * 5.25)
    assert several.of(scene).exposure.bracket == (0.25, 1.0, 4.0)
    frames = pattern_sets(texts, scene, equal="frames")
    assert [one.frames for one in frames] == [24, 24]
    assert frames[0].note == "8 fringes with 20 shifts"
    photons = pattern_sets(texts, scene, equal="photons")
    assert photons[1].exposure_share == pytest.approx(1 / 5.25)
    assert photons[1].light * photons[1].exposure_share == pytest.approx(photons[0].light)
    # A scene's own exposures are those of all sets that state none.
    bracketed = replace(scene, exposure=replace(scene.exposure, bracket=(1.0, 4.0)))
    assert [one.frames for one in pattern_sets(texts, bracketed)] == [16, 24]
    one = replace(scene, exposure=replace(scene.exposure, bracket=(2.5,)))
    alike = pattern_sets(["1,8@4", "1,8@4 | bracket=1/4"], one, equal="photons")
    light = [a.exposure_share * sum(a.of(one).exposure.bracket) * 8 for a in alike]
    assert light[0] == pytest.approx(light[1])
    # What is left of the frames and does not do for a shift at both exposures is not used.
    odd = pattern_sets(["1,8@4 | bracket=1/4", "1,8@4,16@11"], scene, equal="frames")
    assert [one.frames for one in odd] == [18, 19]
    for text in ("1,8 | bracket=", "1,8 | bracket=a/b", "1,8 | bracket=1/1", "1,8 | bracket=0/1"):
        with pytest.raises(InputError, match="bracket: expected"):
            pattern_sets([text], scene)
