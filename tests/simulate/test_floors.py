"""Floors: what is left without the detector, which part of it is sampling, when to say so."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small, transport_of, truth_of
from stages import trace

from slbench.bench.compare.compare import compare
from slbench.capture.focus import Focus
from slbench.core.errors import InputWarning
from slbench.design.fringes.trial import noise_of_scene
from slbench.patterns import NoiseModel, decode
from slbench.simulate import floors, stack
from slbench.simulate.floors import (
    floor_of,
    fused_radiance,
    more_samples,
    noise_free_coordinates,
    ordinary_rms,
    phase_map,
)
from slbench.simulate.repeats import noise_free_waves
from slbench.simulate.scan import scan
from slbench.simulate.stack import capture_stack


def blurred(samples, radius_mm=12.0, full_well_e=1e7):
    """Return the step block before a camera far out of focus, whose lens is sampled."""
    scene = small("step-block", samples=samples)
    camera = scene.rig.camera
    lens = replace(camera.lens, aperture_radius_mm=radius_mm, focus_distance_mm=380.0)
    rig = scene.rig.having(camera=replace(camera, lens=lens))
    detector = replace(scene.detector, full_well_e=full_well_e, read_noise_e=0.0, bit_depth=16)
    return replace(scene, rig=rig, detector=detector)


def samples_warned(call):
    """Return the warnings about samples that a call gives, and what it returns."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call()
    words = [str(w.message) for w in caught if issubclass(w.category, InputWarning)]
    return [line for line in words if "by sampling" in line or "sampling makes" in line], result


def test_as_many_samples_are_advised_as_make_sampling_a_twentieth():
    assert more_samples(16, 1.0, 0.3) is None  # 0.09 of the mean square
    # 0.1 of the mean square is the limit: 0.5^2 / 0.1 = 2.5, 1.58 times the limit, squared and up.
    assert more_samples(16, 1.0, 0.5) == 16 * 4
    assert more_samples(16, 2.0, 2.0) == 16 * 16
    assert more_samples(16, 0.0, 1.0) == 16 * 100**2
    assert more_samples(16, 1.0, float("nan")) is None
    assert more_samples(16, float("nan"), 1.0) is None


def test_one_setting_fused_is_that_setting_and_equal_settings_are_too():
    scene, light = small("step-block"), transport_of("step-block")
    alone = noise_free_coordinates(light, scene.sequence, scene.rig.projector)["u"]
    focus = Focus({"camera": (450.0, 450.0), "projector": (800.0, 800.0)})
    stack = capture_stack(replace(scene, focus=focus), (light, light), seed=1)
    weights = stack.weights("modulation")
    both = noise_free_coordinates((light, light), scene.sequence, scene.rig.projector, weights)
    # Weights of 16 bits and their sums: 1e-7 of a radiance of which a fringe is the whole.
    np.testing.assert_allclose(both["u"], alone, rtol=0, atol=1e-4)


def test_fused_radiance_by_bands_is_that_of_the_whole(monkeypatch):
    scene = replace(
        blurred(8), focus=Focus({"camera": (380.0, 450.0), "projector": (800.0, 800.0)})
    )
    lights = [trace(scene.focused(k)) for k in range(2)]
    weights = capture_stack(scene, lights, seed=1).weights("modulation")
    whole = noise_free_coordinates(lights, scene.sequence, scene.rig.projector, weights)["u"]
    monkeypatch.setattr("slbench.simulate.floors._BAND_BYTES", 4 * 160 * 9 * 7)
    banded = noise_free_coordinates(lights, scene.sequence, scene.rig.projector, weights)["u"]
    np.testing.assert_array_equal(whole, banded)
    # And by hand: weighted means of both settings' radiances, decoded.
    frames = np.empty((scene.sequence.n_frames, 120, 160))
    for indices, radiance in fused_radiance(lights, scene.sequence, scene.rig.projector, None):
        frames[indices] = radiance  # of the first setting
    by_hand = np.empty_like(frames)
    second = np.empty_like(frames)
    for indices, radiance in fused_radiance(lights[1:], scene.sequence, scene.rig.projector, None):
        second[indices] = radiance
    share = weights.weights / weights.weights.sum(axis=0, dtype=float)
    by_hand = share[0] * frames + share[1] * second
    expected = decode(by_hand, scene.sequence, noise=NoiseModel(step_dn=0.0), min_modulation=0.0)
    seen = np.isfinite(whole)
    assert seen.mean() > 0.5
    np.testing.assert_allclose(whole[seen], expected.coordinate["u"][seen], rtol=0, atol=2e-4)


def test_the_sampling_part_is_what_many_samples_take_away():
    few, many = blurred(8, 2.0), blurred(512, 2.0)
    light, exact = trace(few, seed=1), trace(many, seed=2)
    truth = truth_of("step-block")
    floor = floor_of(light, few.sequence, few.rig.projector, truth)
    best = floor_of(exact, many.sequence, many.rig.projector, truth)
    found, true = (
        noise_free_coordinates(one, few.sequence, few.rig.projector)["u"] for one in (light, exact)
    )
    off = (found - true)[truth.smooth()]
    error = ordinary_rms([off])
    # Two draws of one distribution over thousands of pixels, whose tails differ by a few pixels.
    assert floor.sampling_rms_px == pytest.approx(error, rel=0.15)
    assert best.sampling_rms_px < 0.3 * floor.sampling_rms_px
    assert best.rms_px < floor.rms_px
    # Pixel by pixel: what lies within one, two, three deviations, as of a Gaussian; halves of
    # eight samples tell an edge's light too seldom, by which deviations are some 10 % low.
    normed = np.abs(off / floor.sampling_px["u"][truth.smooth()])
    normed = normed[np.isfinite(normed)]
    shares = [100.0 * np.mean(normed < k) for k in (1.0, 2.0, 3.0)]
    assert shares == pytest.approx([68.3, 95.4, 99.7], abs=5.0)


def test_where_most_orders_break_the_sampling_part_is_a_third_too_small_at_most():
    """A pixel whose order half of the samples break is left out, and was among the worst."""
    few, many = blurred(8, 12.0), blurred(512, 12.0)
    light, exact = trace(few, seed=1), trace(many, seed=2)
    truth = truth_of("step-block")
    sampling = floor_of(light, few.sequence, few.rig.projector, truth).sampling_rms_px
    found, true = (
        noise_free_coordinates(one, few.sequence, few.rig.projector)["u"] for one in (light, exact)
    )
    error = (found - true)[truth.smooth()]
    assert np.isnan(error).mean() > 0.5
    assert 0.65 * ordinary_rms([error]) < sampling < ordinary_rms([error])


def test_noise_free_points_have_no_deviation():
    scene, light = small("step-block"), transport_of("step-block")
    phase = phase_map(noise_free_coordinates(light, scene.sequence, scene.rig.projector))
    assert phase.mask.sum() == np.isfinite(phase.coordinate["u"]).sum()
    assert np.nanmax(phase.sigma["u"]) == 0.0


# -- phase ----------------------------------------------------------------------------------


def test_waves_of_radiance_and_their_sampling_error():
    few, many = blurred(8), blurred(512)
    pixels = np.flatnonzero(truth_of("step-block").smooth())
    (light,), (exact,) = ([trace(s, ("u",), seed=3 + k)] for k, s in enumerate((few, many)))
    waves, half = noise_free_waves(few, (light,), [1, 16], pixels)
    true, _ = noise_free_waves(many, (exact,), [1, 16], pixels)
    for k in range(2):
        drawn = ordinary_rms([np.angle(half[k] * np.conj(waves[k]))])
        error = ordinary_rms([np.angle(waves[k] * np.conj(true[k]))])
        assert drawn == pytest.approx(error, rel=0.15)


def test_noise_of_a_scene_tells_its_floor_and_its_sampling():
    def noise(samples, fringes):
        scene = blurred(samples)
        return samples_warned(lambda: noise_of_scene(scene, fringes, z_mm=[0.0], repeats=2))

    quiet, found = noise(16, [1, 8, 16])
    assert quiet == []
    assert found.floor_rad.shape == found.monte_carlo_rad.shape == (3, 1)
    assert np.all(found.monte_carlo_rad > 0.0)
    floor, sampling = found.floors()
    np.testing.assert_allclose(floor, found.floor_rad[:, 0])
    np.testing.assert_allclose(sampling, found.monte_carlo_rad[:, 0])
    # 32 fringes have a sixth of their contrast left: measured 0.00203 rad with 16 samples,
    # 0.00116 with 64, 0.00112 with 1024.
    lines, few = noise(16, [1, 32])
    assert len(lines) == 1
    assert "of the noise of 32 fringes at z = 0 mm" in lines[0]
    assert "instead of 16" in lines[0]
    silence, many = noise(64, [1, 32])
    assert silence == []
    assert few.sigma_rad[1, 0] > 1.3 * many.sigma_rad[1, 0]


# -- words ----------------------------------------------------------------------------------


def test_a_result_that_more_samples_would_change_is_questioned_in_one_line():
    few, many, sets = 4, 512, ["1,10,50", "1,2,4"]
    for samples, count in ((few, 1), (many, 0)):
        scene = blurred(samples)
        lines, result = samples_warned(lambda scene=scene: scan(scene, seed=1))
        assert len(lines) == count, (samples, lines, result)
        lines, compared = samples_warned(
            lambda scene=scene: compare(scene, sets, repeats=2, seed=1)
        )
        assert len(lines) == count, (samples, lines)
        for one in compared.sets:
            assert 0.0 < one.monte_carlo_median_mm < 2.0 * one.floor_median_mm
            stated = one.to_dict()
            assert stated["floor_median_mm"] == one.floor_median_mm
            assert stated["monte_carlo_median_mm"] == one.monte_carlo_median_mm
    quiet, _ = samples_warned(
        lambda: compare(blurred(few), sets, repeats=2, seed=1, question=False)
    )
    assert quiet == []


def test_codes_of_neighbours_are_decoded_whole(monkeypatch):
    """Along v the lines of a Fourier transform are columns, which bands would cut."""
    light = transport_of("plane", axes="v")
    sequence = small("plane", "gray+fourier24", axes="v").sequence
    projector = small("plane").rig.projector
    whole = noise_free_coordinates(light, sequence, projector)["v"]
    assert np.isfinite(whole).any()
    monkeypatch.setattr(floors, "_BAND_BYTES", 1)
    np.testing.assert_array_equal(noise_free_coordinates(light, sequence, projector)["v"], whole)


def test_neighbours_resolve_fringes_of_the_whole_picture_and_not_of_its_bands(monkeypatch):
    light = transport_of("step-block")
    projector = small("step-block").rig.projector
    sequence = replace(small("step-block", "10@4").sequence, unwrap="spatial")
    assert stack.with_lit_frame(sequence).unwrap == "spatial"
    whole = noise_free_coordinates(light, sequence, projector)["u"]
    monkeypatch.setattr(floors, "_BAND_BYTES", 1)
    np.testing.assert_array_equal(noise_free_coordinates(light, sequence, projector)["u"], whole)
