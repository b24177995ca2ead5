"""Scenes in colour from light to points: each band a scene of its own, mixed by a camera."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes_small import run_cli, small, truth_of

from slbench.bench.compare.compare import compare
from slbench.capture.capture import Capture
from slbench.capture.focus import Focus
from slbench.core.colour import BANDS, decode_srgb
from slbench.core.errors import InputError
from slbench.core.io import read_colour
from slbench.detector.emva1288 import Detector
from slbench.patterns import PatternSequence
from slbench.scene.colour import Colour
from slbench.scene.model import Light
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material
from slbench.scene.surfaces.textures import Tint
from slbench.simulate.colour import ColourTransport, chips, demosaiced, exposed
from slbench.simulate.expose import capture, radiance_batches, shutter_for
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan
from slbench.simulate.stack import capture_stack, traced
from slbench.simulate.transport import LightTransport
from slbench.twin import TwinObject, make_twin

PRIMARIES = ((0.9, 0.05, 0.0), (0.1, 0.9, 0.1), (0.0, 0.05, 0.9))
RESPONSE = ((0.85, 0.15, 0.0), (0.1, 0.8, 0.1), (0.0, 0.15, 0.85))
PAINT = (0.8, 0.5, 0.3)


def painted(scene, albedo):
    """Return a scene whose objects are Lambertian of one albedo, or of three."""
    value = Tint(values=albedo) if isinstance(albedo, tuple) else albedo
    material = Material(Diffuse(albedo=value))
    objects = tuple(replace(one, material=material) for one in scene.objects)
    return replace(scene, objects=objects)


@functools.cache
def coloured(patterns="1,16@3", albedo=PAINT, name="plane", axes="u", **colour):
    """Return a small scene in colour."""
    scene = small(name, patterns, axes=axes)
    if albedo is not None:
        scene = painted(scene, albedo)
    return replace(scene, colour=Colour(**colour))


@functools.cache
def light(scene):
    return traced(scene, seed=3)


@pytest.mark.parametrize("bounces", [0, 1])
def test_channels_are_three_monochrome_scenes_where_nothing_mixes(bounces):
    lit = Light(ambient_w_per_mm2=2e-7, bounces=bounces)
    scene = replace(coloured(name="bowl"), light=lit)
    (transport,) = traced(scene, seed=3)
    panels = np.random.default_rng(0).random((2, 640))
    seen = transport.seen(np.stack([panels] * 3))
    for k, albedo in enumerate(PAINT):
        alone = replace(painted(small("bowl", "1,16@3"), albedo), light=lit)
        (own,) = traced(alone, seed=3)
        # The same rays; sums of the product and of the ambient light round apart, 24 bits each.
        np.testing.assert_allclose(seen[k], own.relight(panels), rtol=1e-5, atol=0.0)


def test_frames_of_a_channel_are_those_of_its_monochrome_scene():
    scene = coloured()
    (transport,) = light(scene)
    # What the brightest channel is exposed with, given to all: the red one.
    shutter = shutter_for(transport, scene.rig.camera, scene.detector, scene.exposure)
    shots = capture(
        transport, scene.sequence, scene.rig, scene.detector, scene.exposure, noise=False
    )
    assert shots.pictures.values.shape == (6, *transport.shape, 3)
    for k, albedo in enumerate(PAINT):
        alone = painted(small("plane", "1,16@3"), albedo)
        (own,) = traced(alone, seed=3)
        parts = own, alone.sequence, alone.rig, alone.detector, alone.exposure
        frames = capture(*parts, noise=False, shutter=shutter).frames
        # Sums in single precision may be rounded to the next whole number.
        assert np.abs(shots.pictures.values[..., k].astype(int) - frames).max() <= 1
        assert np.mean(shots.pictures.values[..., k] != frames) < 1e-3
    np.testing.assert_array_equal(shots.frames, shots.pictures.values[..., 1])


def test_the_brightest_channel_decides_the_exposure():
    scene = coloured(ambient=(0.0, 0.0, 0.0))
    (shots,) = capture_stack(scene, light(scene), noise=False).captures
    white = replace(scene, sequence=PatternSequence.parse("white", scene.sequence.panel))
    (shots,) = capture_stack(white, light(scene), noise=False).captures
    top = scene.detector.saturation_dn - scene.detector.black_dn
    for k, albedo in enumerate(PAINT):
        level = np.percentile(shots.pictures.values[..., k], 99.0) - scene.detector.black_dn
        # Full white is 0.8 of saturation in red, of which a rounding is half a DN.
        assert level == pytest.approx(0.8 * top * albedo / PAINT[0], abs=1.0)


def mixed_alone(scene, primaries, panels):
    """Return what channels see, band by band from the scenes of the bands alone."""
    emitted = np.einsum("kj,jnw->knw", np.array(primaries), panels)
    each = []
    for k, band in enumerate(BANDS):
        (own,) = traced(scene.in_band(band), seed=3)
        each.append(own.relight(emitted[k]).astype(float))
    return np.einsum("ik,knvu->invu", np.array(scene.colour.response), each)


def test_light_is_mixed_by_primaries_and_response():
    scene = coloured(primaries=PRIMARIES, response=RESPONSE)
    scene = replace(scene, light=Light(ambient_w_per_mm2=3e-7))
    (transport,) = traced(scene, seed=3)
    panels = np.random.default_rng(1).random((3, 2, 640))
    expected = mixed_alone(scene, PRIMARIES, panels)
    # Values of single precision, summed in another order.
    np.testing.assert_allclose(transport.seen(panels), expected, rtol=2e-5)
    # Of grey patterns it is a light transport, whose white is its whites'.
    grey = panels[0]
    both = mixed_alone(scene, PRIMARIES, np.stack([grey] * 3))[1]
    np.testing.assert_allclose(transport.relight(grey), both, rtol=2e-5)
    white = transport.relight(np.ones((1, 640)))[0]
    np.testing.assert_allclose(transport.white(), white, rtol=2e-5)


def test_a_grey_scene_is_traced_once(monkeypatch):
    scene = coloured(albedo=None, response=RESPONSE)
    (transport,) = light(scene)
    assert transport.bands[0] is transport.bands[1] is transport.bands[2]
    apart = coloured(albedo=None, camera_scale=(1.0005, 1.0, 1.0))
    (transport,) = light(apart)
    assert transport.bands[0] is not transport.bands[1]
    assert transport.bands[1] is transport.bands[2]


def test_packed_pictures_are_what_the_transport_mixes():
    scene = coloured("1,16@3+rgb", albedo=None, response=RESPONSE)
    (transport,) = light(scene)
    given = scene.sequence
    shown = given.shown(np.arange(6), "u").reshape(2, 3, 640).swapaxes(0, 1)
    expected = transport.seen(shown).swapaxes(0, 1).reshape(6, *transport.shape)
    found = np.empty_like(expected)
    for indices, radiance in radiance_batches(transport, given, scene.rig.projector.linear()):
        found[indices] = radiance
    # The panel's levels are those of its bits: half of 1/255 of white.
    np.testing.assert_allclose(found, expected, atol=0.51 / 255 * expected.max())


def test_three_shifts_in_one_picture_measure_as_well_as_their_frames_alone():
    alone = scan(small("plane", "1,16@3"), seed=1)
    packed = scan(
        coloured("1,16@3+rgb", albedo=None, primaries=PRIMARIES, response=RESPONSE), seed=1
    )
    assert packed.capture.pictures.values.shape[0] == 2
    assert packed.score.completeness > 0.95
    # Channels that are taken apart have the noise of their inverse.  Of three shifts a phase takes
    # what is left of it beside their mean; the brightest channel of white decides the light.
    matrix = np.array(packed.scene.colour.crosstalk)
    inverse = np.linalg.inv(matrix)
    beside = np.eye(3) - np.full((3, 3), 1.0 / 3.0)
    worse = np.sqrt(np.trace(beside @ inverse @ inverse.T) / 2.0) * matrix.sum(axis=1).max()
    ratio = packed.score.smooth_rms_px["u"] / alone.score.smooth_rms_px["u"]
    # Shot noise is that of the mixed channels, whose levels are nearer to each other.
    assert ratio == pytest.approx(worse, rel=0.15)
    # A matrix that is not known is an error that no noise hides.
    wrong = scan(
        coloured("1,16@3+rgb", albedo=None, primaries=PRIMARIES, response=RESPONSE, unmix=False),
        seed=1,
    )
    assert wrong.floor_rms_px > 5.0 * packed.floor_rms_px


@pytest.mark.parametrize("albedo", [None, PAINT])
def test_stripes_in_colour(albedo):
    scene = coloured("white+black+de-bruijn8px+rgb", albedo=albedo, response=RESPONSE)
    found = scan(scene, seed=1)
    assert found.capture.pictures.values.shape[0] == 3
    # As of three grey frames of a grey plate (its test): white pictures take the colour out.
    assert found.score.completeness > 0.7
    assert found.score.smooth_rms_px["u"] < 0.2


def test_deviations_are_predicted_of_each_channel():
    for channel in BANDS:
        scene = coloured(channel=channel, response=RESPONSE)
        found = compare(scene, ["1,16@3"], repeats=8, truth=truth_of("plane"))
        assert found["1,16@3"].std_over_predicted == pytest.approx(1.0, abs=0.05)


def test_lateral_colour_is_an_error_of_the_channel_that_has_it():
    plain = scan(coloured(albedo=None), seed=1, noise=False)
    for channel, factor in (("green", 0.0), ("red", 1.0)):
        scene = coloured(albedo=None, projector_scale=(1.001, 1.0, 0.999), channel=channel)
        found = scan(scene, seed=1, noise=False)
        errors = found.phase.coordinate["u"] - plain.phase.coordinate["u"]
        # A column is seen a thousandth of its distance from the axis too near.
        distance = plain.phase.coordinate["u"] - scene.rig.projector.centre[0]
        left = errors + factor * 0.001 / 1.001 * distance
        good = np.isfinite(left)
        # Rounding to 8 bits is 0.02 px of sixteen fringes; the largest shift is 0.15 px.
        assert np.sqrt(np.mean(left[good] ** 2)) < 0.04
        assert np.abs(distance[good]).max() > 150.0


def test_a_mosaic_is_sampled_before_noise_and_filled_after():
    colour = Colour(bayer="GRBG")
    detector = coloured().detector
    radiance = np.zeros((3, 1, 6, 8), np.float32)
    radiance[0], radiance[1], radiance[2] = 3000.0, 9000.0, 6000.0
    rngs = np.random.default_rng(0).spawn(3)
    (picture,) = exposed(radiance, colour, detector, 0.01, rngs, noise=False, scale=1.0)
    for k, photons in enumerate((3000.0, 9000.0, 6000.0)):  # flat: what is filled is the same
        np.testing.assert_array_equal(
            picture[..., k], np.rint(detector.expected_dn(photons, 0.01)).astype(np.uint8)
        )
    radiance[1, 0, 0, 1] = 1e6  # a red site: nobody sees the green light there
    (again,) = exposed(radiance, colour, detector, 0.01, rngs, noise=False, scale=1.0)
    np.testing.assert_array_equal(again, picture)
    radiance[1, 0, 0, 0] = 0.0  # a green site
    (again,) = exposed(radiance, colour, detector, 0.01, rngs, noise=False, scale=1.0)
    assert again[0, 0, 1] < picture[0, 0, 1]


@pytest.mark.parametrize("bayer", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("demosaic", ["bilinear", "edge-aware"])
@pytest.mark.parametrize("shape", [(8, 10), (7, 9)])
def test_colours_of_a_mosaic_come_back_in_their_places(bayer, demosaic, shape):
    colour = Colour(bayer=bayer, demosaic=demosaic)
    levels = np.array([40, 120, 200], np.uint16)
    mosaic = levels[colour.sites(shape)]
    # Also the border, which OpenCV's own edge-aware demosaic leaves black.
    np.testing.assert_array_equal(demosaiced(mosaic, colour), np.broadcast_to(levels, (*shape, 3)))


def test_a_demosaic_is_that_of_opencv():
    frame = np.random.default_rng(1).integers(0, 4096, (20, 24), np.uint16)
    inner = (slice(2, -2), slice(2, -2))
    for demosaic, code in (
        ("bilinear", cv2.COLOR_BayerRGGB2RGB),
        ("edge-aware", cv2.COLOR_BayerRGGB2RGB_EA),
    ):
        found = demosaiced(frame, Colour(bayer="RGGB", demosaic=demosaic))
        np.testing.assert_array_equal(found[inner], cv2.cvtColor(frame, code)[inner])


def test_noise_under_a_mosaic_is_that_of_filled_pixels():
    scene = coloured("white", albedo=None, bayer="RGGB")
    shots = [capture_stack(scene, light(scene), seed=s).captures[0] for s in range(12)]
    frames = np.array([one.frames[0] for one in shots], float)
    variance = frames.var(axis=0, ddof=1)
    lit = frames.mean(axis=0) > 0.5 * frames.mean(axis=0).max()
    predicted = shots[0].noise.variance(frames.mean(axis=0))
    # 12 frames of some 10,000 pixels, a quarter of them independent: 1 %, and rounding twice.
    assert variance[lit].mean() / predicted[lit].mean() == pytest.approx(1.0, abs=0.06)
    native = Colour(bayer="RGGB").sites(lit.shape) == 1
    # Between green pixels four are averaged: a quarter of the variance, and rounding.
    ratio = variance[lit & ~native].mean() / variance[lit & native].mean()
    assert 0.2 < ratio < 0.4


def test_a_capture_in_colour_is_saved_as_pictures_in_colour(tmp_path):
    for patterns in ("1,16@3", "1,16@3+rgb"):
        scene = coloured(patterns, response=RESPONSE)
        (shots,) = capture_stack(scene, light(scene), seed=1).captures
        folder = tmp_path / patterns
        shots.save(folder)
        count = 6 // scene.sequence.channels
        assert len(list((folder / "frames").iterdir())) == count
        for k in range(count):
            picture = read_colour(folder / f"frames/{k:03d}.png")
            np.testing.assert_array_equal(picture, shots.pictures.values[k])
        back = Capture.load(folder)
        np.testing.assert_array_equal(back.frames, shots.frames)
        assert back.sequence == scene.sequence


@pytest.mark.parametrize("patterns", ["1,16@3", "1,16@3+rgb"])
def test_frames_that_were_processed_are_saved_and_not_their_pictures(patterns, tmp_path):
    scene = coloured(patterns, response=RESPONSE)
    (shots,) = capture_stack(scene, light(scene), seed=1).captures
    assert replace(shots, exposure_s=1.0).pictures is shots.pictures
    halved = replace(shots, frames=shots.frames // 2)
    assert halved.pictures is None
    halved.save(tmp_path / "halved")
    np.testing.assert_array_equal(Capture.load(tmp_path / "halved").frames, shots.frames // 2)
    cut = replace(shots, frames=np.ascontiguousarray(shots.frames[:, ::2]), rig=None)
    assert cut.pictures is None


def test_fixed_patterns_of_three_sensors_are_of_no_other_detector():
    one, other = (chips(Detector(seed=seed)) for seed in (0, 1))
    seeds = [chip.seed for chip in (*one, *other)]
    assert len(set(seeds)) == 6
    assert (one[1].seed, other[1].seed) == (0, 1)


def test_vibration_moves_the_channels_of_a_picture_together():
    scene = coloured("white", albedo=None)
    shaken = replace(scene, exposure=replace(scene.exposure, vibration_px=2.0))
    (shots,) = capture_stack(shaken, light(scene), seed=5).captures
    red, green, blue = (shots.pictures.values[0, ..., k].astype(float) for k in range(3))
    (still,) = capture_stack(scene, light(scene), seed=5).captures
    alike = np.abs(red - blue).mean()
    # Noise alone tells channels apart; two pixels move the plate's edges by more.
    moved = np.abs(green - still.pictures.values[0, ..., 1]).max()
    assert alike < 6.0 < 30.0 < moved


def test_light_in_colour_is_kept(tmp_path):
    scene = coloured(primaries=PRIMARIES, response=RESPONSE, channel="blue")
    (transport,) = light(scene)
    path = tmp_path / "transport.npz"
    transport.save(path)
    back = ColourTransport.load(path)
    panels = np.random.default_rng(2).random((3, 1, 640))
    np.testing.assert_array_equal(back.seen(panels), transport.seen(panels))
    np.testing.assert_array_equal(back.white(), transport.white())
    with pytest.raises(InputError, match=r"ColourTransport\.load.*got 3"):
        LightTransport.load(path)
    transport.bands[0].save(path)
    with pytest.raises(InputError, match=r"format: expected 3, of light transport in colour"):
        ColourTransport.load(path)
    (grey,) = light(coloured(albedo=None))
    grey.save(path)
    back = ColourTransport.load(path)
    assert back.bands[0] is back.bands[2]
    for refused in (back.to_scipy, back.torch, back.factors):
        with pytest.raises(InputError, match=r"one band \(bands\[1\] is green\)"):
            refused()


def test_light_is_kept_for_another_camera():
    lights = Lights(seed=3)
    first = coloured()
    lights.traced(first)
    other = replace(first, colour=Colour(response=RESPONSE, bayer="RGGB"))
    (found,) = lights.traced(other)
    assert lights.traces == 1
    assert found.colour == other.colour
    lights.traced(replace(first, colour=Colour(camera_scale=(1.001, 1.0, 1.0))))
    assert lights.traces == 2


def test_scan_from_the_command_line(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        'extends = "plane"\nname = "own"\n[camera]\nresolution_px = [160, 120]\npitch_um = 29.6\n'
        '[colour]\nbayer = "RGGB"\n'
    )
    out = tmp_path / "out"
    done = run_cli("scan", path, "--patterns", "1,16@3+rgb", "--out", out)
    assert done.status == 0, done.err
    assert sorted(one.name for one in (out / "frames").iterdir()) == ["000.png", "001.png"]
    assert run_cli("decode", out).status == 0
    refused = run_cli("scan", path, "--patterns", "1,16@3+rgb", "--set", "colour.bayer=RGBG")
    assert refused.status == 2
    assert len(refused.err.splitlines()) == 1


def images_of(figure):
    return [image.get_array() for axes in figure.axes for image in axes.get_images()]


def test_pictures_are_shown_in_colour():
    found = scan(coloured("1,16@3+rgb", response=RESPONSE), seed=1)
    shown = [one for one in images_of(found.plot()) if one.ndim == 3 and one.shape[2] == 3]
    values = found.capture.pictures.values
    assert len(shown) == 1
    # The first of the finest fringes is the second picture; brightness is that of a display.
    assert shown[0].shape == values[1].shape
    np.testing.assert_allclose(decode_srgb(shown[0]), values[1] / 255.0, atol=1e-9)
    drawn = images_of(found.capture.plot())
    assert [one.shape for one in drawn] == [values[0].shape] * 2


def test_a_focus_stack_in_colour_is_fused_frame_by_frame(tmp_path):
    distances = small("plane").rig.camera.lens.focus_distance_mm
    focus = Focus({"camera": (0.97 * distances, distances), "projector": (800.0, 800.0)})
    scene = replace(coloured("white+1,16@3", response=RESPONSE), focus=focus)
    found = scan(scene, seed=1)
    assert [len(one.pictures.values) for one in found.stack.captures] == [7, 7]
    # What is fused is the decoded channel; pictures of single settings stay as they were seen.
    assert found.capture.pictures is None
    assert found.score.completeness > 0.9
    found.stack.save(tmp_path / "stack")
    pictures = list((tmp_path / "stack").glob("focus*/frames/*.png"))
    assert len(pictures) == 14
    assert read_colour(pictures[0]).ndim == 3


def test_pictures_for_a_projector_in_colour(tmp_path):
    words = ("patterns", "write", "white+1,16@3+rgb", "--panel", "64x48")
    done = run_cli(*words, "--out", tmp_path / "shown")
    assert done.status == 0, done.err
    white, first, _ = (read_colour(tmp_path / f"shown/patterns/{k:03d}.png") for k in range(3))
    assert white.min() == 255
    sequence = PatternSequence.parse("1@3", (64, 48))
    for k in range(3):  # three shifts, to half a level of the panel
        np.testing.assert_allclose(first[..., k], 255.0 * sequence.image(k), atol=0.51)


def test_a_matrix_of_ones_own_is_what_an_operator_believes():
    sequence = coloured("1,16@3+rgb", albedo=None, response=RESPONSE).sequence
    believed = ((0.9, 0.1, 0.0), (0.1, 0.8, 0.1), (0.0, 0.1, 0.9))
    stated = replace(sequence, crosstalk=believed)
    scene = coloured("1,16@3+rgb", albedo=None, response=RESPONSE)
    wrong = scan(replace(scene, sequence=stated), seed=1, noise=False)
    right = scan(scene, seed=1, noise=False)
    assert wrong.capture.sequence.crosstalk == believed
    np.testing.assert_array_equal(wrong.capture.frames, right.capture.frames)
    # A twentieth of the light in another channel, beside sampling and square pixels alone.
    assert wrong.floor_rms_px > 3.0 * right.floor_rms_px


def test_a_scene_in_colour_is_drawn_in_colour(tmp_path):
    for name, coloured_there in (("colour", True), ("plane", False)):
        done = run_cli("scene", "show", name, "--out", tmp_path / f"{name}.png")
        assert done.status == 0, done.err
        # The camera's view is the right third of the picture; drawings are left of it.
        drawn = read_colour(tmp_path / f"{name}.png")
        view = drawn[:, 2 * drawn.shape[1] // 3 :].astype(int)
        saturated = np.ptp(view, axis=2) > 60  # the balls' colours, of which a grey view has none
        assert (saturated.mean() > 0.005) == coloured_there


def test_deviations_under_a_mosaic_are_predicted_on_the_whole():
    for patterns in ("1,16@3", "1,16@3+rgb"):
        scene = coloured("1,16@3", albedo=None, bayer="RGGB")
        found = compare(scene, [patterns], repeats=8, truth=truth_of("plane"))
        assert found[patterns].std_over_predicted == pytest.approx(1.0, abs=0.05)


def test_deviations_of_stripes_in_colour_are_predicted():
    name = "white+black+de-bruijn8px+rgb"
    for albedo in (None, PAINT):
        scene = coloured("1,16@3", albedo=albedo, response=RESPONSE)
        found = compare(scene, [name], repeats=8, truth=truth_of("plane"))
        # What channels share once they are taken apart, an edge counts as if each had it alone.
        assert found[name].std_over_predicted == pytest.approx(1.05, abs=0.1)


def test_what_has_one_band_refuses_scenes_in_colour(tmp_path):
    done = run_cli("export", "colour", tmp_path / "scene.xml")
    assert done.status == 2
    assert 'in_band("green")' in done.err
    assert not list(tmp_path.iterdir())
    scene = coloured(albedo=None)
    (shots,) = capture_stack(scene, light(scene), seed=1).captures
    with pytest.raises(InputError, match="grey frames"):
        make_twin(shots, [TwinObject(shape="plane")])
    grey = replace(shots, pictures=None)
    with pytest.raises(InputError, match="grey frames"):
        make_twin(grey, [TwinObject(shape="plane")], held_out=[shots])
