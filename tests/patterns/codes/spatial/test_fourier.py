"""Fourier transform profilometry in views whose places are known."""

from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small, truth_of

from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.simulate.scan import scan

PANEL = (512, 96)
NOISE = NoiseModel(read_dn=1.0, step_dn=0.0)


def view(text, u, seed, noise_dn):
    """Frames that see the panel's places `u` (V, U), fringes between the samples too."""
    sequence = PatternSequence.parse(text, PANEL)
    frames = []
    for placed in sequence.placed():
        for k in range(len(placed.frames)):
            fine = placed.code.profile(k, PANEL[0] * 64)  # the same fringes, finer samples
            frames.append(fine[np.round((u + 0.5) * 64 - 0.5).astype(int)])
    dn = 20 + 200 * np.array(frames)
    return sequence, dn + np.random.default_rng(seed).normal(0, noise_dn, dn.shape)


def tilted(bump=0.0):
    """Places that a tilted plane shows, and a bump of some panel pixels on it."""
    y, x = np.mgrid[0:80, 0:400]
    wide = np.exp(-((x - 200) ** 2 + (y - 40) ** 2) / (2 * 40**2))
    return 60 + 0.93 * x + 0.1 * y + bump * wide


@pytest.mark.parametrize("axis", ["u", "v"])
def test_one_frame_gives_the_place_on_a_plane(axis):
    u = tilted()
    sequence, frames = view("1@3+fourier64", u, 0, 0.0)
    if axis == "v":
        sequence = PatternSequence.parse("1@3+fourier64", PANEL[::-1], axes="v")
        frames, u = frames.transpose(0, 2, 1).copy(), u.T
    found = decode(frames, sequence, noise=NOISE)
    assert found.mask.mean() > 0.85  # a fringe and a half at either end
    # The mean's leakage into the window, which the picture's ends cut off, falls off with a fringe.
    assert np.nanmax(np.abs(found.coordinate[axis] - u)) < 0.15
    assert np.nanstd(found.coordinate[axis] - u) < 0.02


def test_single_precision_is_lost_in_the_rounding_of_frames():
    sequence, frames = view("1@3+fourier64", tilted(), 0, 0.0)
    whole = np.rint(frames).astype(np.uint8)
    single = decode(whole, sequence, noise=NOISE)
    double = decode(whole.astype(np.float64), sequence, noise=NOISE, saturation=255.0)
    np.testing.assert_array_equal(single.mask, double.mask)
    # 1e-6 of a range of 200 DN over a modulation of 100 DN, rad, where a fringe has 8 px.
    bound = 2e-6 * PANEL[0] / (2 * np.pi * 64)
    assert np.nanmax(np.abs(single.coordinate["u"] - double.coordinate["u"])) < bound
    np.testing.assert_allclose(single.sigma["u"], double.sigma["u"], rtol=1e-5)


def test_what_is_not_finite_spoils_its_neighbourhood_alone():
    u = tilted()
    sequence, frames = view("1@3+fourier64", u, 0, 0.0)
    frames = frames.astype(np.float32)
    frames[:, 40, 200:202] = np.inf
    frames[:, 40, 202] = np.nan
    found = decode(frames, sequence, noise=NOISE)
    assert not found.mask[40, 200:203].any()
    # Three dark pixels leak as far as the mean does at the picture's ends: 0.15 px (above).
    far = np.abs(np.arange(u.shape[1]) - 201) > 4 * 8
    assert np.nanmax(np.abs(found.coordinate["u"] - u)[:, far]) < 0.15
    assert found.mask[40, far].mean() > 0.85


def test_the_predicted_deviation_is_the_measured_one():
    sequence, clean = view("1@3+fourier64", tilted(), 0, 0.0)
    without = decode(clean, sequence, noise=NOISE).coordinate["u"]
    pulls = []
    for seed in range(4):
        noisy = clean + np.random.default_rng(seed).normal(0, 1.0, clean.shape)
        found = decode(noisy, sequence, noise=NOISE)
        pulls.append((found.coordinate["u"] - without) / found.sigma["u"])
    # 4 x 27,000 pixels, of which a fringe (8.6 px) shares its noise: a hundredth.
    assert np.nanstd(pulls) == pytest.approx(1.0, rel=0.05)


def test_a_surface_without_steps_needs_no_other_frame():
    u = tilted(bump=6.0)
    sequence, frames = view("fourier64", u, 3, 1.0)
    found = decode(frames, replace(sequence, unwrap="spatial"), noise=NOISE)
    error = found.coordinate["u"] - u
    period = PANEL[0] / 64
    shift = np.nanmedian(error) / period
    assert abs(shift - round(shift)) < 0.02  # known up to whole fringes
    assert np.nanmax(np.abs(error - round(shift) * period)) < 0.3


def test_a_rendered_plane_is_decoded():
    scene, truth = small("plane"), truth_of("plane")
    result = scan(scene.with_patterns("1,4@3+fourier24"), seed=3)
    seen = truth.smooth() & result.phase.mask
    error = (result.phase.coordinate["u"] - truth.panel[..., 0])[seen]
    noise = np.sqrt(np.mean(result.phase.sigma["u"][seen] ** 2))
    assert seen.sum() > 0.9 * truth.smooth().sum()
    # What neighbours do beside the plane's edge is most of the error, and is in the floor.
    assert error.std() == pytest.approx(np.hypot(noise, result.floor_rms_px), rel=0.05)
    period = scene.sequence.size("u") / 24
    assert error.std() < 0.02 * period
    assert np.abs(error).max() < 0.25 * period  # no wrong order
