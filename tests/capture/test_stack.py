"""Focus stacks: settings of a scene, folders, fusion of captures, and what fusion gains."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import scene_of, small, transport_of
from scipy.spatial.transform import Rotation
from stages import capture, ground_truth, shutter_for, trace, with_lit_frame

from slbench import objects
from slbench.capture.capture import Capture
from slbench.capture.focus import Focus
from slbench.capture.fusion import maximum_weights, pyramid_selection, selective_weights
from slbench.capture.stack import FocusStack, modulation_weights
from slbench.core.errors import InputError
from slbench.core.io import read_toml, write_toml
from slbench.patterns import Flat, Fringes, NoiseModel, PatternSequence, relative_phase
from slbench.rig import Pose
from slbench.scene.file import load_scene
from slbench.scene.model import SceneObject
from slbench.scene.surfaces.materials import PRESETS
from slbench.score.fusion import score_fusion
from slbench.simulate.folder import write_scan
from slbench.simulate.scan import scan
from slbench.simulate.sharp import expected_frames
from slbench.simulate.stack import capture_stack

SEQUENCE = PatternSequence((64, 48), (Flat(1.0), Fringes(1), Fringes(4)))


def coloured(phase_shift=0.0, modulation=60.0, mean=100.0, seed=0, sigma=0.0):
    """A capture of a flat field: fringes of given modulation, 32 x 24 camera pixels."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0.1, 0.9, 32)
    frames = []
    for frame in SEQUENCE.frames():
        if isinstance(frame.part, Flat):
            image = np.full(32, mean + modulation)
        else:
            angle = 2 * np.pi * (frame.part.count * u - frame.index / frame.part.shifts)
            image = mean + modulation * np.cos(angle + phase_shift)
        frames.append(np.broadcast_to(image, (24, 32)) + sigma * rng.standard_normal((24, 32)))
    pixels = np.rint(np.array(frames)).astype(np.uint8)
    return Capture(pixels, SEQUENCE, noise=NoiseModel(read_dn=sigma), saturation_dn=250)


# -- settings -----------------------------------------------------------------------------


def focused(camera_mm, projector_mm):
    """Return settings of a rig with one camera and one projector."""
    return Focus({"camera": camera_mm, "projector": projector_mm})


def test_a_sweep_focuses_on_points_above_the_origin():
    rig = load_scene("ch8-plane").rig
    focus = Focus.sweep(rig, (-0.2, 0.0, 0.1))
    # 20 mm from the origin, axes 12.5 and 37.5 deg from the vertical: a point at height z is
    # z cos(angle) nearer along the axis.
    for distances, angle in (
        (focus.distances_mm["camera"], 12.5),
        (focus.distances_mm["projector"], 37.5),
    ):
        expected = 20.0 - np.array([-0.2, 0.0, 0.1]) * np.cos(np.deg2rad(angle))
        np.testing.assert_allclose(distances, expected, atol=1e-5)
    kept = Focus.sweep(rig, (-0.2, 0.1), "camera")
    assert kept.distances_mm["projector"] == (rig.projector.lens.focus_distance_mm,) * 2
    apart = Focus.sweep(rig, (-0.2, 0.1), apart=True)
    assert len(apart) == 4
    assert len(set(zip(*apart.distances_mm.values(), strict=True))) == 4


def test_settings_change_the_focus_and_nothing_else():
    scene = replace(load_scene("ch8-plane"), focus=focused((19.0, 20.5), (20.0, 21.0)))
    second = scene.focused(1)
    assert second.focus is None
    assert second.rig.camera.lens.focus_distance_mm == 20.5
    assert second.rig.projector.lens.focus_distance_mm == 21.0
    points = np.array([[0.1, -0.2, 0.15], [0.0, 0.0, 0.0]])
    for before, after in (
        (scene.rig.camera, second.rig.camera),
        (scene.rig.projector, second.rig.projector),
    ):
        np.testing.assert_array_equal(before.project(points), after.project(points))
        assert before.lens.aperture_radius_mm == after.lens.aperture_radius_mm
    sharp = scene.all_in_focus()
    assert sharp.rig.camera.lens.defocusing_radius_mm == 0
    assert sharp.rig.projector.lens.defocusing_radius_mm == 0
    with pytest.raises(InputError, match=r"focus setting: expected 0\.\.1, got 2"):
        scene.focused(2)


@pytest.mark.parametrize(
    ("table", "count"),
    [
        ({"settings": 5}, 5),
        ({"heights_mm": [-0.1, 0.1], "move": "projector"}, 2),
        ({"heights_mm": [-0.1, 0.1], "apart": True}, 4),
        ({"camera_mm": [19.0, 20.0, 21.0]}, 3),
        ({"camera_mm": [19.0, 20.0], "projector_mm": [20.0, 20.1]}, 2),
    ],
)
def test_scene_files_say_settings_in_four_ways(tmp_path, table, count):
    path = tmp_path / "scene.toml"
    write_toml(path, {"extends": "ch8-plane", "focus": table})
    focus = load_scene(path).focus
    assert len(focus) == count
    if "settings" in table:  # the middles of slices of the volume's 0.5 mm
        cosine = np.cos(np.deg2rad(12.5))
        np.testing.assert_allclose(
            focus.distances_mm["camera"],
            20.0 - cosine * np.array([-0.2, -0.1, 0, 0.1, 0.2]),
            atol=1e-5,
        )


@pytest.mark.parametrize(
    "table",
    [
        {},
        {"settings": 3, "heights_mm": [0.0]},
        {"heights_mm": [0.0, 0.1], "move": "camera", "apart": True},
        {"camera_mm": [19.0, 20.0], "projector_mm": [20.0]},
        {"camera_mm": [19.0], "apart": True},
        {"heights_mm": [100.0]},
    ],
)
def test_settings_that_cannot_be_are_refused(tmp_path, table):
    path = tmp_path / "scene.toml"
    write_toml(path, {"extends": "ch8-plane", "focus": table})
    with pytest.raises(InputError, match="focus") as error:
        load_scene(path)
    assert "\n" not in str(error.value)


# -- folders ------------------------------------------------------------------------------


def test_a_stack_comes_back_from_its_folder(tmp_path):
    captures = [coloured(seed=k, sigma=2.0) for k in range(3)]
    stack = FocusStack(captures, focused((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    stack.save(tmp_path / "stack")
    back = FocusStack.load(tmp_path / "stack")
    assert back.focus == stack.focus
    assert len(back) == 3
    for k in range(3):
        np.testing.assert_array_equal(back.captures[k].frames, captures[k].frames)
        np.testing.assert_array_equal(back.frame(k, 4), captures[k].frames[4])
    ours, theirs = (s.fuse("modulation").capture for s in (stack, back))
    np.testing.assert_array_equal(ours.frames, theirs.frames)


def test_a_stack_of_one_moving_device_is_read_as_it_was_written(tmp_path):
    stack = FocusStack([coloured(seed=k) for k in range(3)], Focus({"camera": (1.0, 2.0, 3.0)}))
    stack.save(tmp_path)
    assert FocusStack.load(tmp_path).focus == stack.focus


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"captures": ["../elsewhere"]}, "elsewhere"),
        ({"captures": ["focus000", "nothing"]}, "nothing"),
        ({"camera_mm": [1.0], "projector_mm": [1.0]}, "a capture for each of 1 settings"),
        ({"camra_mm": [1.0, 2.0, 3.0]}, "did you mean 'camera_mm'"),
    ],
)
def test_bad_stacks_are_refused_in_one_line(tmp_path, change, words):
    FocusStack([coloured(seed=k) for k in range(3)]).save(tmp_path)
    write_toml(tmp_path / "stack.toml", read_toml(tmp_path / "stack.toml") | change)
    with pytest.raises(InputError, match=words) as error:
        FocusStack.load(tmp_path)
    assert "\n" not in str(error.value)


def test_captures_that_differ_are_refused(tmp_path):
    odd = coloured()
    other = Capture(odd.frames[:4], PatternSequence((64, 48), (Flat(1.0), Fringes(1))))
    with pytest.raises(InputError, match=r"captures\[1\]: expected the patterns of the first"):
        FocusStack([odd, other])
    FocusStack([odd, odd]).save(tmp_path)
    shutil.rmtree(tmp_path / "focus001")
    other.save(tmp_path / "focus001")
    with pytest.raises(InputError, match="focus001"):
        FocusStack.load(tmp_path)
    with pytest.raises(InputError, match="at least one capture"):
        FocusStack([])
    dark = PatternSequence((64, 48), (Fringes(1), Fringes(4)))
    unlit = FocusStack([Capture(odd.frames[1:], dark)] * 2)
    with pytest.raises(InputError, match="fully lit frame"):
        unlit.fuse()
    assert unlit.fuse("modulation").capture.frames.shape == (6, 24, 32)


# -- fusion -------------------------------------------------------------------------------


def test_weights_by_modulation_are_the_matched_filter():
    # Modulations 60, 30 and 20, contrast reversed: weights 1, 1/2 and none.
    stack = FocusStack([coloured(), coloured(modulation=30.0), coloured(np.pi, modulation=20.0)])
    weights = modulation_weights(stack)
    inner = np.s_[:, 6:-6, 6:-6]  # beyond the window from the border
    shares = weights.weights[inner] / 65535.0
    # Rounding to whole digital numbers leaves 0.3 DN of 30.
    np.testing.assert_allclose(shares[0], 1.0, atol=1e-4)
    np.testing.assert_allclose(shares[1], 0.5, atol=0.01)
    np.testing.assert_allclose(shares[2], 0.0, atol=1e-6)
    np.testing.assert_array_equal(weights.focus[inner[1:]], 0)


def faint_stack(modulations, sigma, seed, shifts=3, size=96):
    """Captures of fringes of given modulations around 1000 DN in Gaussian noise."""
    rng = np.random.default_rng(seed)
    sequence = PatternSequence((64, 48), (Fringes(1, shifts),))
    phase = 2 * np.pi * 7.3 * np.linspace(0.0, 1.0, size)[None, None]
    shift = 2 * np.pi * np.arange(shifts)[:, None, None] / shifts
    captures = []
    for b in modulations:
        frames = 1000.0 + b * np.cos(phase - shift)
        frames = np.rint(frames + sigma * rng.standard_normal((shifts, size, size)))
        noise = NoiseModel(read_dn=sigma)
        captures.append(Capture(frames.astype(np.uint16), sequence, 16, noise))
    return FocusStack(captures)


@pytest.mark.parametrize("shifts", [3, 5])
@pytest.mark.parametrize("strongest", [8.0, 20.0])
def test_weights_by_modulation_are_without_bias_however_little_is_left(shifts, strongest):
    # Contrast falls to nothing over nine settings; noise of 6 DN makes the phase of the strongest
    # uncertain by up to 0.6 rad.  Windows of 9 x 9: a weight of b / b_max has the error
    # s / (9 b_max), s^2 = 2 sigma^2 / N, and its mean is right within that, the lost ones' (of
    # which one in 44 is not told to be none) within a tenth of it.
    sigma = 6.0
    shares = np.array([1.0, 0.8, 0.6, 0.4, 0.2, 0.0, 0.0, 0.0, -0.5])
    found = []
    for seed in range(6):
        weights = modulation_weights(faint_stack(strongest * shares, sigma, seed, shifts))
        found.append(weights.weights[:, 6:-6, 6:-6].mean(axis=(1, 2)) / 65535.0)
    error = np.sqrt(2.0 / shifts) * sigma / (9.0 * strongest)
    mean = np.mean(found, axis=0)
    np.testing.assert_allclose(mean[:5], shares[:5], atol=error)
    np.testing.assert_allclose(mean[5:], 0.0, atol=0.1 * error)


@pytest.mark.parametrize("strongest", [8.0, 20.0])
def test_settings_whose_fringes_are_lost_do_not_change_the_fused_deviation(strongest):
    # Two settings, then twelve more that show nothing, with the same noise in the two: all that
    # changes is what the lost ones bring.  Noise across the fused wave over its mean length is the
    # deviation of its phase where that is small, and without the bend of an arc where it is not.
    deviations = []
    for lost in (0, 12):
        stack = faint_stack((strongest, 0.6 * strongest, *([0.0] * lost)), 6.0, seed=1)
        weights = modulation_weights(stack)
        frames = [weights.fuse([stack.frame(p, k) for p in range(len(stack))]) for k in range(3)]
        phase, modulation, _ = relative_phase(np.stack(frames))
        true = 2 * np.pi * 7.3 * np.linspace(0.0, 1.0, 96)
        wave = (modulation * np.exp(1j * (phase - true)))[6:-6, 6:-6]
        deviations.append(wave.imag.std() / wave.real.mean())
    # 84 x 84 pixels know a deviation to 0.8 %; the matched filter adds up squares of signal to
    # noise.  What twelve weights of a tenth of their error bring is below 1 %.
    best = np.sqrt(2.0 / 3.0) * 6.0 / np.hypot(strongest, 0.6 * strongest)
    assert deviations[0] == pytest.approx(best, rel=0.03)
    assert deviations[1] == pytest.approx(deviations[0], rel=0.015)


@pytest.mark.filterwarnings("error")
def test_pixels_without_light_are_averaged():
    # Rounding of the window's sums beside lit pixels must not leave weights that are all zero.
    lit = coloured().frames.copy()
    lit[:, :, 12:] = 0
    stack = FocusStack([Capture(lit, SEQUENCE), Capture(lit // 2, SEQUENCE)])
    weights = modulation_weights(stack)
    assert np.all(weights.weights.max(axis=0) == 65535)
    assert np.isnan(weights.focus[:, 24:]).all()
    np.testing.assert_array_equal(stack.fuse("modulation").capture.frames[:, :, 24:], 0)


@pytest.mark.parametrize("repeats", [40, pytest.param(120, marks=pytest.mark.statistics)])
def test_fused_deviations_are_predicted(repeats):
    # Five settings of different modulation, noise of 3 DN, repeated: the decoder's deviation
    # times the gain of the average against the scatter.  40 repeats know a pixel's deviation to
    # 11 %, the root mean square over 500 pixels to 0.5 %; 120 to 6.5 % and 0.3 %.
    modulations = (20.0, 40.0, 60.0, 40.0, 20.0)
    decoded, predicted = [], []
    for repeat in range(repeats):
        captures = [
            coloured(modulation=m, sigma=3.0, seed=10 * repeat + k)
            for k, m in enumerate(modulations)
        ]
        phase = FocusStack(captures).fuse("modulation").decode(min_modulation=0.0)
        decoded.append(phase.coordinate["u"])
        predicted.append(phase.sigma["u"])
    scatter = np.sqrt(np.nanmean(np.nanvar(decoded, axis=0, ddof=1)))
    expected = np.sqrt(np.nanmean(np.square(predicted)))
    # The weights know the noise a little (they come from the same frames): 3 %.
    assert scatter == pytest.approx(expected, rel=0.03)
    single = coloured(modulation=60.0, sigma=3.0).decode().sigma["u"]
    assert expected < 0.75 * np.nanmedian(single)


def test_fused_photographs_keep_the_limits_of_their_depth(tmp_path):
    """Without a noise model: 16-bit frames of 8-bit pictures are no better for their bits."""
    rng = np.random.default_rng(5)
    captures = []
    for seed in range(2):
        shot = coloured(seed=seed, sigma=1.0)
        frames = shot.frames.copy()
        dark = rng.integers(9, 12, (len(frames), 24, 16)).astype(
            np.uint8
        )  # noise of 1 DN, no light
        frames[:, :, :16] = dark
        captures.append(replace(shot, frames=frames, noise=None))
    one = captures[0].decode()
    fused = FocusStack(captures).fuse_with(modulation_weights(FocusStack(captures), 3))
    both = fused.decode()
    # Of 3 DN by 1 DN of noise: none in one picture.  Shadows are not measured by fusing.
    assert one.mask[:, :16].mean() < 0.02
    assert both.mask[:, :16].mean() < 0.02
    assert both.mask[:, 17:].all()
    ratio = np.nanmedian(both.sigma["u"][:, 17:]) / np.nanmedian(one.sigma["u"][:, 17:])
    # Two equal frames, where rounding to 16 bit adds nothing to that to 8 bit.
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.02)
    fused.capture.save(tmp_path)
    loaded = Capture.load(tmp_path)
    assert loaded.min_modulation_dn == 3 * 256
    np.testing.assert_array_equal(loaded.decode().mask, both.mask)
    assert loaded.decode(min_modulation=0.0).mask.sum() >= both.mask.sum()


def test_a_pyramid_fuses_and_decodes():
    captures = [coloured(seed=seed, sigma=1.0) for seed in range(2)]
    stack = FocusStack(captures)
    fused = stack.fuse_with(pyramid_selection(stack.lit()))
    phase = fused.decode()
    assert phase.mask.all()
    np.testing.assert_allclose(
        np.median(phase.sigma["u"]), np.median(captures[0].decode().sigma["u"]), rtol=0.05
    )


def test_saturated_frames_leave_saturated_pixels():
    bright = coloured(mean=100.0)
    frames = bright.frames.copy()
    frames[1, :, 5] = 255
    stack = FocusStack([replace(bright, frames=frames), bright])
    fused = stack.fuse("modulation").capture
    assert fused.saturation_dn == 250 * 256
    assert np.all(fused.frames[1, 6:-6, 5] >= fused.saturation_dn)
    assert not fused.decode().mask[6:-6, 5].any()


# -- scenes -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def speckled():
    """Squares of 20 um, a texture, out of the middle's focus by 0.2 mm, under the microscope."""
    base = load_scene("ch8-plane", preview=True)
    board = objects.build_artefact(
        "chequerboard",
        {"rows": 60, "columns": 60, "square_mm": 0.02, "margin_mm": 0.02, "thickness_mm": 0.1},
    )
    dark, bright = PRESETS["dark-stage"], PRESETS["matt-white-spray"]
    target = SceneObject(
        board, Pose(np.eye(3), np.array([0.0, 0.0, 0.2])), bright, {board_part(board): dark}
    )
    focus = Focus.sweep(base.rig, np.linspace(-0.25, 0.25, 7).tolist())
    return replace(base, objects=(target,), focus=focus)


def board_part(board):
    return next(part for part in board.parts if "dark" in part or "black" in part)


def phase_noise(scene, source, repeats=6):
    """Deviation of the finest fringes' phase over repeats, fused or of the middle setting."""
    transports = [trace(scene.focused(k)) for k in range(len(scene.focus))]
    phases = []
    for r in range(repeats):
        stack = capture_stack(scene, transports, seed=40 + r)
        if source == "middle":
            frames = stack.captures[len(stack) // 2].frames
        else:
            frames = stack.fuse(source).capture.frames
        phases.append(relative_phase(frames[-3:])[0])
    off = np.angle(np.exp(1j * (np.array(phases) - phases[0])))
    return float(np.sqrt(np.median(off.var(axis=0, ddof=1))))


def test_fusion_halves_the_noise_out_of_focus(speckled):
    # The depth of field of 32 fringes ends well before 0.2 mm; that of 16 just there.
    scene = speckled.with_patterns("1,8,32")
    middle = phase_noise(scene, "middle")
    assert phase_noise(scene, "lit") < 0.5 * middle
    assert phase_noise(scene, "modulation") < 0.5 * middle


@pytest.mark.parametrize(("full_well_e", "read_noise_e"), [(1e5, 1.0), (1e3, 20.0)])
def test_every_way_to_fuse_against_the_all_in_focus_truth(speckled, full_well_e, read_noise_e):
    # The texture on a slope of 35 deg, through the depth of field of 16 fringes and beyond.
    pose = Pose(Rotation.from_euler("y", -35.0, degrees=True).as_matrix(), np.zeros(3))
    scene = with_lit_frame(speckled.with_patterns("1,4,16"))
    detector = replace(scene.detector, full_well_e=full_well_e, read_noise_e=read_noise_e)
    slope = replace(scene.objects[0], pose=pose)
    scene = replace(scene, objects=(slope,), detector=detector)
    stack, truth = capture_stack(scene, seed=1), ground_truth(scene)
    sharp = list(
        expected_frames(stack, trace(scene.all_in_focus()), scene.detector, scene.exposure)
    )
    lit = stack.lit()
    ways = {
        "saf": selective_weights(lit),
        "maximum": maximum_weights(lit),
        "pyramid": pyramid_selection(lit),
        "modulation": modulation_weights(stack),
    }
    found = {
        name: score_fusion(stack, stack.fuse_with(weights), sharp, truth)
        for name, weights in ways.items()
    }
    saf = found["saf"]
    assert min(saf.fused_inside.pixels, saf.fused_outside.pixels) > 10_000
    # Measured 0.81 and 0.45 of the middle setting's phase error, 0.70 of intensity: with
    # diffraction defocus costs less, and the sharpest pictures are less sharp.
    assert saf.fused_outside.phase_rms < 0.9 * saf.middle_outside.phase_rms
    assert saf.fused_outside.intensity_rms < 0.8 * saf.middle_outside.intensity_rms
    for other in ("maximum", "pyramid"):
        assert saf.fused_outside.phase_rms < found[other].fused_outside.phase_rms
    # By modulation noise is least: the matched filter; its blur is more.
    noisy = full_well_e < 1e4
    modulation = found["modulation"].fused_outside.phase_rms
    assert (modulation < saf.fused_outside.phase_rms) == noisy


def test_scan_of_a_stack(speckled, tmp_path):
    focus = Focus.sweep(speckled.rig, [-0.2, 0.0, 0.2])
    scene = replace(speckled.with_patterns("1,8,32"), focus=focus)
    result = scan(scene, weights="modulation", seed=3)
    assert len(result.stack) == 3
    assert result.capture.sequence.name == "white+1,8,32"
    assert result.capture.bit_depth == 16
    assert result.fusion.finest == 32
    out = result.fusion.fused_outside
    assert out.pixels > 1000
    assert out.phase_rms < 0.5 * result.fusion.middle_outside.phase_rms
    assert out.intensity_rms < result.fusion.middle_outside.intensity_rms
    assert result.to_dict()["fusion"]["finest"] == 32
    # Folder: the stack, and what a perfect one would have fused to.
    write_scan(result, tmp_path / "scan")
    assert len(FocusStack.load(tmp_path / "scan" / "stack")) == 3
    sharp = Capture.load(tmp_path / "scan" / "all-in-focus")
    assert sharp.sequence == result.capture.sequence
    difference = sharp.frames.astype(float) - result.capture.frames / 256.0
    assert np.sqrt(np.mean(difference**2)) / 255 < 2 * out.intensity_rms
    # The same seed gives the same bytes.
    again = scan(scene, weights="modulation", seed=3)
    np.testing.assert_array_equal(again.capture.frames, result.capture.frames)


def test_all_settings_have_the_exposure_of_the_middle():
    scene = scene_of([SceneObject(objects.build_artefact("plane", {"size_mm": [80, 80]}))])
    scene = replace(scene, focus=focused((400.0, 450.0, 500.0), (800.0, 800.0, 800.0)))
    stack = capture_stack(scene)
    middle = with_lit_frame(scene).focused(1)
    expected = shutter_for(middle, trace(middle))[1]
    np.testing.assert_allclose([c.exposure_s for c in stack.captures], expected, rtol=1e-12)
    # Noise is drawn anew for every setting.
    same = replace(scene, focus=focused((450.0, 450.0), (800.0, 800.0)))
    first, second = capture_stack(same).captures
    assert np.any(first.frames != second.frames)


def test_a_scene_without_settings_is_a_stack_of_one_picture_as_it_was_taken():
    scene, transport = small("plane"), transport_of("plane")
    stack = capture_stack(scene, (transport,), seed=4)
    fused = stack.fuse()
    assert fused.capture is stack.captures[0]
    assert fused.noise_gain == 1.0
    # Its patterns and its seed are the scan's own: no lit frame, no seed of a setting.
    assert fused.capture.sequence == scene.sequence
    expected = capture(scene, transport, seed=4)
    np.testing.assert_array_equal(fused.capture.frames, expected.frames)
    np.testing.assert_array_equal(fused.decode().sigma["u"], expected.decode().sigma["u"])
