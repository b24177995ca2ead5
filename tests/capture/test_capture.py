"""Capture: frames from an analytic light transport, and folders of frames from anywhere.

The transport is written down, not traced: a pixel sees the panel through a Gaussian window
around a known coordinate.  A sinusoid through a Gaussian window keeps its phase exactly (the
aliases are below exp(-2 pi^2 s^2) < 1e-30 for s = 2 px), so decoded coordinates have a truth.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import tomli_w
from sparse_samples import sparse_rows
from stages import capture, noise_free_coordinates, shutter_for

from slbench import objects
from slbench.capture.capture import Capture
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.core.io import read_toml, write_png, write_toml
from slbench.detector.emva1288 import Detector
from slbench.patterns import NoiseModel, PatternSequence
from slbench.rig import Camera, Lens, Pair, Pose, Projector, Rig
from slbench.rig.opencv import write_rig
from slbench.scene.model import Exposure, Scene, SceneObject
from slbench.simulate.expose import move_pictures
from slbench.simulate.transport import LightTransport

SHAPE = (48, 64)  # camera rows, columns
PANEL = (256, 192)
WINDOW = 2.0  # standard deviation of the Gaussian window, panel px
SLOPE = (np.pi, np.sqrt(0.05))  # of the panel's u along the camera's u and v
#: A detector whose temporal noise is far below its rounding, which is far below a pixel.
CLEAN = Detector(bit_depth=16, full_well_e=1e12, read_noise_e=0, prnu=0, dsnu_e=0)


def rig():
    camera = Camera(
        SHAPE[1],
        SHAPE[0],
        (0.05, 0.05),
        Lens(16.0, 2.0, 450.0),
        pose=Pose.looking_at((-250.0, 60.0, 380.0), (0, 0, 0), (0, -1, 0)),
    )
    projector = Projector(
        *PANEL,
        (0.02, 0.02),
        Lens(28.0, 4.0, 780.0),
        pose=Pose.looking_at((150.0, 0.0, 760.0), (0, 0, 0), (0, -1, 0)),
        bit_depth=None,
    )
    return Rig(camera, projector)


def scene(patterns="1,8,32", shifts=3, axes="u", **more):
    plate = SceneObject(objects.build_artefact("plane", {"size_mm": (100.0, 100.0)}))
    sequence = PatternSequence.parse(patterns, PANEL, shifts, axes)
    return Scene("analytic", rig(), (plate,), sequence, **({"detector": CLEAN} | more))


def coordinates():
    """Panel coordinates (u, v) that the pixels look at: smooth, sloped, off the panel's ends.

    The slopes are irrational, so that no two pixels round alike.
    """
    v, u = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
    return {
        "u": 25.3 + SLOPE[0] * u + SLOPE[1] * v,
        "v": 20.7 + np.sqrt(0.02) * u + np.e * v,
    }


def transport(brightness=1.0, ambient=0.0):
    """Transport of `brightness` (scalar or image) through the Gaussian window."""
    scale = np.broadcast_to(np.asarray(brightness, float), SHAPE).reshape(-1, 1)
    marginals = {}
    for axis, size in zip("uv", PANEL, strict=True):
        centre = coordinates()[axis].reshape(-1, 1)
        first = np.floor(centre).astype(int) - 14  # 7 standard deviations
        columns = first + np.arange(30)
        weights = np.exp(-0.5 * ((columns - centre) / WINDOW) ** 2)
        weights *= scale / weights.sum(axis=1, keepdims=True)
        marginals[axis] = sparse_rows(columns.astype(np.uint16), weights.astype(np.float32), size)
    return LightTransport(marginals, np.full(SHAPE, ambient, np.float32), PANEL, 30)


# -- decoding what was captured --------------------------------------------------------------


@pytest.mark.parametrize("axes", ["u", "v", "uv"])
def test_noise_free_coordinates_are_exact(axes):
    found = noise_free_coordinates(scene(axes=axes), transport())
    assert tuple(found) == tuple(axes)
    for axis in axes:
        # Frames are float32: 6e-8 of a phase of 2 pi 32 is 1e-5 px, times a few operations.
        np.testing.assert_allclose(found[axis], coordinates()[axis], rtol=0, atol=1e-4)


def test_noise_free_coordinates_do_not_depend_on_the_bands(monkeypatch):
    whole = noise_free_coordinates(scene(axes="uv"), transport())
    monkeypatch.setattr("slbench.simulate.floors._BAND_BYTES", 5 * 4 * SHAPE[1] * 18)
    banded = noise_free_coordinates(scene(axes="uv"), transport())
    for axis in "uv":
        np.testing.assert_array_equal(whole[axis], banded[axis])


def test_dark_pixels_have_no_noise_free_coordinate():
    brightness = np.ones(SHAPE)
    brightness[:10] = 1e-4
    brightness[10:12] = 0.0
    found = noise_free_coordinates(scene(), transport(brightness))["u"]
    assert np.isnan(found[:12]).all()
    assert np.isfinite(found[12:]).all()


def test_a_detector_is_given_irradiance_and_the_photosensitive_area(monkeypatch):
    """Of half a pixel: the irradiance of the sensor does not change, what a pixel collects does."""
    given = []

    def photons(self, irradiance, exposure_s, area):
        given.append((float(irradiance), area))
        return right(self, irradiance, exposure_s, area)

    right = Detector.photons
    monkeypatch.setattr(Detector, "photons", photons)
    whole = replace(scene(), exposure=Exposure(time_s=0.01))
    camera = replace(whole.rig.camera, fill_factor=0.5)
    half = replace(whole, rig=whole.rig.having(camera=camera))
    shutters = [shutter_for(one, transport()) for one in (whole, half)]
    (irradiance, area), (same, smaller) = given
    assert same == pytest.approx(irradiance, rel=1e-12)
    assert smaller == pytest.approx(0.5 * area, rel=1e-12)
    assert area == pytest.approx(camera.pitch_mm[0] * camera.pitch_mm[1], rel=1e-12)
    assert shutters[1].photons == pytest.approx(0.5 * shutters[0].photons, rel=1e-12)


@pytest.mark.parametrize("bit_depth", [8, 10, 12, 14, 16])
def test_without_noise_only_rounding_is_left(bit_depth):
    detector = Detector(bit_depth=bit_depth)
    shots = capture(scene(detector=detector), transport(), noise=False)
    assert shots.frames.dtype == (np.uint8 if bit_depth == 8 else np.uint16)
    assert shots.frames.max() < 2**bit_depth
    phase = shots.decode()
    assert phase.mask.all()
    error = phase.coordinate["u"] - coordinates()["u"]
    # Rounding is +-1/2 DN a frame, so the phase is off by at most (2 / 3 b) sum |sin| / 2
    # <= 0.67 / b; one fringe is 8 px wide and the modulation 0.4 of the range x 0.29 (the
    # window blurs 32 fringes by exp(-2 pi^2 4 / 64)).
    b = phase.modulation.min()
    assert np.abs(error).max() < 0.67 / b * 8 / (2 * np.pi) + 1e-4
    # The prediction is the rounding's own standard deviation (8 bits: rounding errors of
    # neighbouring pixels are independent enough for 10 %).
    if bit_depth <= 12:
        assert error.std() == pytest.approx(phase.sigma["u"].mean(), rel=0.1)


def test_noise_free_frames_do_not_depend_on_the_seed():
    first, second = (capture(scene(), transport(), seed=s, noise=False).frames for s in (1, 2))
    np.testing.assert_array_equal(first, second)


def test_same_seed_same_frames_another_seed_others():
    detector = Detector()
    shaken = scene(detector=detector, exposure=Exposure(vibration_px=0.2))
    frames = [capture(shaken, transport(), seed=seed).frames for seed in (3, 3, 4)]
    np.testing.assert_array_equal(frames[0], frames[1])
    assert np.mean(frames[0] != frames[2]) > 0.3


def test_frames_do_not_depend_on_how_they_are_batched(monkeypatch):
    # Vibration and noise are drawn frame by frame, in the order of the patterns.
    shaken = scene(detector=Detector(), exposure=Exposure(vibration_px=0.2))
    together = capture(shaken, transport(), seed=5).frames
    batches = LightTransport.batches
    monkeypatch.setattr(
        LightTransport,
        "batches",
        lambda self, n, along: batches(self, n, 2 * 4 * self.ambient.size),
    )
    np.testing.assert_array_equal(capture(shaken, transport(), seed=5).frames, together)


def test_progress_ends_at_one():
    seen = []
    capture(scene(axes="uv"), transport(), noise=False, on_progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


# -- exposure ---------------------------------------------------------------------------------


def test_automatic_exposure_reaches_the_white_level():
    detector = Detector(bit_depth=12, read_noise_e=0, prnu=0, dsnu_e=0, dark_current_e_per_s=0)
    brightness = 1e-4 * np.linspace(0.2, 1.0, SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    for level in (0.3, 0.8):
        given = scene("white+1", detector=detector, exposure=Exposure(white_level=level))
        shots = capture(given, transport(brightness), noise=False)
        white = shots.frames[0].astype(float)
        reached = (np.percentile(white, 99) - detector.black_dn) / (4095 - detector.black_dn)
        # One rounding to 12 bits.
        assert reached == pytest.approx(level, abs=0.5 / 4095 + 1e-6)


def test_ambient_light_lowers_contrast_but_not_coordinates():
    shots = [capture(scene(), transport(1.0, ambient), noise=False) for ambient in (0.0, 0.3)]
    first, second = (one.decode() for one in shots)
    # The exposure brings projector and ambient light together to the white level ...
    np.testing.assert_allclose(second.modulation, first.modulation / 1.3, rtol=1e-3)
    # ... and of that a part has no contrast: b / a from 0.5 / 0.5 to 0.5 / (0.5 + 0.3) ...
    black = shots[0].noise.offset_dn
    contrast = [(p.modulation / (p.mean - black)).mean() for p in (first, second)]
    assert contrast[1] / contrast[0] == pytest.approx(0.5 / 0.8, rel=1e-3)
    # ... but the coordinates stay where they are, up to rounding to 16 bits.
    difference = second.coordinate["u"] - first.coordinate["u"]
    assert np.abs(difference).max() < 2e-3


def test_ambient_light_costs_precision_as_predicted():
    detector = Detector(prnu=0, dsnu_e=0)
    deviation, predicted = [], []
    for ambient in (0.0, 0.15):
        light = transport(1.0, ambient)
        errors = []
        for seed in range(8):
            phase = capture(scene(detector=detector), light, seed=seed).decode()
            errors.append(phase.coordinate["u"] - coordinates()["u"])
        deviation.append(np.std(errors))
        predicted.append(np.sqrt(np.mean(phase.sigma["u"] ** 2)))
    # 24,576 errors: a standard deviation is good to 0.5 %; 3 % are six of those.
    assert deviation == pytest.approx(predicted, rel=0.03)
    assert predicted[1] > 1.1 * predicted[0]


def test_absolute_exposure_needs_an_aperture():
    given = scene(exposure=Exposure(time_s=0.01))
    factor, time = shutter_for(given, transport())
    assert time == 0.01
    assert shutter_for(replace(given, exposure=Exposure(time_s=0.02)), transport())[0] == (
        pytest.approx(2 * factor)
    )
    camera = replace(given.rig.camera, lens=Lens(16.0))
    pinhole = replace(given, rig=given.rig.having(camera=camera))
    with pytest.raises(InputError, match=r"camera aperture: expected an aperture \(f_number\)"):
        capture(pinhole, transport())


def test_automatic_exposure_is_told_as_a_time():
    given = scene()
    factor, time = shutter_for(given, transport(1e-5))
    again, _ = shutter_for(replace(given, exposure=Exposure(time_s=time)), transport(1e-5))
    assert again == pytest.approx(factor)


def test_a_projector_that_lights_nothing_is_refused():
    with pytest.raises(InputError, match="an object that the projector lights, got none"):
        capture(scene(), transport(0.0, ambient=1.0))


# -- vibration ---------------------------------------------------------------------------------


@pytest.mark.parametrize("shifts", [3, 5])
def test_vibration_moves_coordinates_as_predicted(shifts):
    # A frame that moves by d px sees the phase of a coordinate g d away, g the slope of the
    # panel coordinate.  The decoded phase is off by (2 / N) sum d_k sin^2(phi_k); over all
    # phases (sin^4 has the mean 3/8) that is a standard deviation of g sigma sqrt(3 / (2 N)).
    sigma = 0.02
    shaken = scene("1,4", shifts, exposure=Exposure(vibration_px=sigma))
    light = transport()
    inner = np.s_[4:-4, 4:-4]  # replicated edges do not move
    errors = np.array(
        [
            (capture(shaken, light, seed=seed).decode().coordinate["u"] - coordinates()["u"])[inner]
            for seed in range(40)
        ]
    )
    predicted = np.hypot(*SLOPE) * sigma * np.sqrt(1.5 / shifts)
    # All pixels of a repeat share its N shifts: 40 N = 120 or 200 independent draws, a standard
    # error of 6.5 %.  25 % are almost four of those: false alarms below 1e-3.
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(predicted, rel=0.25)


@pytest.mark.parametrize("sigma", [0.01, 0.3, 4.0])
def test_pictures_move_by_what_was_drawn(sigma):
    v, u = np.mgrid[0:60, 0:80].astype(float)

    def picture(du, dv):
        return 500 + 200 * np.cos(2 * np.pi * (u - du) / 10) + 100 * np.sin((v - dv) / 3) + u - du

    frames = np.stack([picture(0, 0)] * 4).astype(np.float32)
    shifts = np.random.default_rng(1).normal(0.0, sigma, (4, 2))
    move_pictures(frames, shifts)
    inner = np.s_[20:-20, 20:-20]
    for frame, (du, dv) in zip(frames, shifts, strict=True):
        still = np.abs(picture(0, 0) - picture(du, dv))[inner].max()
        # 0.2 % of small shifts; half a pixel between samples is worst, 0.3 DN of 200.
        tolerance = min(0.003 * still, 0.5) + 1e-3
        np.testing.assert_allclose(frame[inner], picture(du, dv)[inner], rtol=0, atol=tolerance)


def test_without_noise_nothing_vibrates():
    shaken = scene(exposure=Exposure(vibration_px=1.0))
    still = capture(scene(), transport(), noise=False).frames
    np.testing.assert_array_equal(capture(shaken, transport(), noise=False).frames, still)


# -- folders -------------------------------------------------------------------------------------


def test_named_devices_keep_their_names_in_a_folder(tmp_path):
    shots = capture(scene(), transport(), seed=1)
    pair = Pair("left", "beamer")
    rig = Rig({"left": shots.rig.camera}, {"beamer": shots.rig.projector}, shots.rig.volume_mm)
    with pytest.raises(InputError, match="left"):
        replace(shots, pair=pair)  # which the rig does not have
    replace(shots, pair=pair, rig=rig).save(tmp_path)
    again = Capture.load(tmp_path)
    assert again.pair == again.rig.only == pair
    manifest = tmp_path / "capture.toml"
    manifest.write_text(manifest.read_text().replace('"left"', '"right"'))
    with pytest.raises(InputError, match=r"capture.toml.*left-beamer.*right-beamer"):
        Capture.load(tmp_path)


def test_a_manifest_names_the_devices_of_a_calibration_that_does_not(tmp_path):
    capture(scene(), transport(), seed=1).save(tmp_path)
    manifest = tmp_path / "capture.toml"
    assert "camera" not in read_toml(manifest)  # nothing to be said
    manifest.write_text('camera = "top"\n' + manifest.read_text())
    assert Capture.load(tmp_path).rig.only == ("top", "projector")
    manifest.write_text(manifest.read_text().replace('"top"', "3", 1))
    with pytest.raises(InputError, match=r"capture.toml: camera"):
        Capture.load(tmp_path)


@pytest.mark.parametrize("bit_depth", [8, 10, 12, 14, 16])
def test_what_is_saved_is_loaded(bit_depth, tmp_path):
    given = scene("white+1,8@4", axes="uv", detector=Detector(bit_depth=bit_depth))
    shots = capture(given, transport(), seed=1)
    shots.save(tmp_path)
    again = Capture.load(tmp_path)
    np.testing.assert_array_equal(again.frames, shots.frames)
    assert again.frames.dtype == shots.frames.dtype
    assert again.sequence == shots.sequence
    assert again.bit_depth == bit_depth
    assert again.noise == shots.noise
    assert again.exposure_s == pytest.approx(shots.exposure_s, rel=1e-15)
    # The manifest may be named too.
    np.testing.assert_array_equal(Capture.load(tmp_path / "capture.toml").frames, shots.frames)
    first, second = shots.decode(), again.decode()
    for axis in "uv":
        np.testing.assert_array_equal(first.coordinate[axis], second.coordinate[axis])
        np.testing.assert_array_equal(first.sigma[axis], second.sigma[axis])
    ours, theirs = triangulate(shots.rig, first), triangulate(again.rig, second)
    # The rig goes through OpenCV's YAML, 16 digits of poses and focal lengths: points at
    # 800 mm move by some 1e-12 mm.
    np.testing.assert_array_equal(ours.pixels, theirs.pixels)
    np.testing.assert_allclose(theirs.points, ours.points, rtol=0, atol=1e-9)


def test_a_saturated_pixel_is_known_from_the_bit_depth(tmp_path):
    # 10 bits in a 16 bit file: 1023 is the top, not 65535.
    given = scene(detector=Detector(bit_depth=10))
    shots = capture(given, transport(), noise=False)
    shots.frames[3, 7, 9] = 1023
    shots.save(tmp_path)
    mask = Capture.load(tmp_path).decode().mask
    assert not mask[7, 9]
    assert np.count_nonzero(~mask) == 1


def photographs(folder, colour=True):
    """Write frames as a person would: colour files of any name, a minimal manifest."""
    shots = capture(scene("1,8", 4), transport(), noise=False)
    frames = (shots.frames >> 8).astype(np.uint8)
    names = [f"DSC_{4711 + 3 * k}.PNG" for k in range(len(frames))]
    for name, frame in zip(names, frames, strict=True):
        write_png(folder / name, np.stack([frame] * 3, axis=-1) if colour else frame)
    parts = [{"kind": "fringes", "count": n, "shifts": 4, "axis": "u"} for n in (1, 8)]
    write_toml(
        folder / "capture.toml",
        {"frames": names, "patterns": {"panel": list(PANEL), "parts": parts}},
    )
    return shots


@pytest.mark.parametrize("colour", [True, False])
def test_photographs_with_a_minimal_manifest(colour, tmp_path):
    photographs(tmp_path, colour)
    shots = Capture.load(tmp_path)
    assert shots.bit_depth == 8
    assert shots.rig is None
    assert shots.noise is None
    assert shots.exposure_s is None
    phase = shots.decode()
    assert phase.mask.all()
    # Eight bits over 32 px a fringe at a modulation of some 90 DN: 0.04 px at the worst.
    assert np.abs(phase.coordinate["u"] - coordinates()["u"]).max() < 0.05


def test_photographs_with_a_plain_opencv_rig(tmp_path):
    photographs(tmp_path)
    real = rig()
    storage = cv2.FileStorage(str(tmp_path / "stereo.yml"), cv2.FILE_STORAGE_WRITE)
    for name, device in (("camera", real.camera), ("projector", real.projector)):
        storage.write(f"K_{name}", device.matrix)
        storage.write(f"dist_{name}", np.zeros((5, 1)))
        storage.write(f"size_{name}", np.array([[device.width], [device.height]], float))
    relative = real.projector.pose.rotation.T @ real.camera.pose.rotation
    storage.write("R", relative)
    storage.write("T", real.projector.pose.to_local(real.camera.pose.position).reshape(3, 1))
    storage.release()
    manifest = read_toml(tmp_path / "capture.toml")
    write_toml(tmp_path / "capture.toml", manifest | {"rig": "stereo.yml"})
    shots = Capture.load(tmp_path)
    cloud = triangulate(shots.rig, shots.decode())
    # Without R_world, the world is the camera's frame.
    expected = triangulate(real, shots.decode())
    np.testing.assert_allclose(
        cloud.points, real.camera.pose.to_local(expected.points), rtol=0, atol=1e-9
    )
    assert len(cloud) == SHAPE[0] * SHAPE[1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"frames": ["DSC_4711.PNG"]}, "8, as many as patterns"),
        ({"frames": ["gone.png"] * 8}, "gone.png: expected a file"),
        ({"frames": ["../a.png"] * 8}, "which leaves it"),
        ({"frames": ["/etc/passwd"] * 8}, "a relative path inside"),
        ({"rig": "../rig.yaml"}, "which leaves it"),
        ({"rig": "gone.yaml"}, "gone.yaml: expected a file"),
        ({"bit_depth": 12}, "12 bit frames"),
        ({"patterns": {"panel": [256, 192]}}, "patterns.parts"),
        ({"patterns": {"panel": [256, 192], "parts": [{"kind": "sine"}]}}, "parts[0].kind"),
    ],
)
def test_manifests_that_cannot_be_used_name_the_key(change, said, tmp_path):
    photographs(tmp_path)
    manifest = read_toml(tmp_path / "capture.toml") | change
    (tmp_path / "capture.toml").write_text(tomli_w.dumps(manifest))
    with pytest.raises(InputError) as caught:
        Capture.load(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / 'capture.toml'}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_frames_of_different_sizes_are_refused(tmp_path):
    photographs(tmp_path)
    write_png(tmp_path / "DSC_4717.PNG", np.zeros((48, 60), np.uint8))
    with pytest.raises(InputError, match=r"DSC_4717.PNG: expected 64 x 48 px uint8 .* got 60 x 48"):
        Capture.load(tmp_path)


def test_a_corrupt_frame_is_refused(tmp_path):
    photographs(tmp_path)
    frame = tmp_path / "DSC_4714.PNG"
    frame.write_bytes(frame.read_bytes()[:40])
    with pytest.raises(InputError, match=r"DSC_4714.PNG: expected an image file"):
        Capture.load(tmp_path)


@pytest.mark.parametrize(("part", "said"), [("camera", "frames"), ("projector", "patterns.panel")])
def test_a_rig_of_other_sizes_is_refused(part, said, tmp_path):
    photographs(tmp_path)
    other = rig()
    device = getattr(other, part)
    write_rig(tmp_path / "rig.yaml", other.having(**{part: replace(device, width=99)}))
    manifest = read_toml(tmp_path / "capture.toml")
    write_toml(tmp_path / "capture.toml", manifest | {"rig": "rig.yaml"})
    with pytest.raises(InputError, match=rf"{said}: expected the rig's 99 x"):
        Capture.load(tmp_path)


@pytest.mark.parametrize(
    ("frames", "bits"),
    [
        (np.zeros((3, 4), np.uint8), 8),
        (np.zeros((3, 4, 5), np.int32), 8),
        (np.zeros((3, 4, 5), np.uint16), None),
        (np.zeros((3, 0, 5), np.uint8), 8),
        (np.zeros((4, 4, 5), np.uint8), 8),
        (np.zeros((3, 4, 5), np.uint8), 7),
        (np.zeros((3, 4, 5), np.uint8), 10),
    ],
)
def test_frames_that_are_none_are_refused(frames, bits):
    with pytest.raises(InputError, match=r"capture frames|bit_depth"):
        Capture(frames, PatternSequence.parse("1", (64, 64)), bits, NoiseModel())
