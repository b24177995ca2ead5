"""De Bruijn stripes in views whose places are known."""

import numpy as np
import pytest
from scenes_small import small, truth_of

from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.patterns.codes.spatial.de_bruijn import DeBruijn, sequence
from slbench.patterns.matching.vectors import blurred
from slbench.rig.optics.spread import Spread
from slbench.simulate.scan import scan

PANEL = (512, 64)
NOISE = NoiseModel(read_dn=1.0, step_dn=0.0)


def view(u, blur_px=1.2, stripe_px=8, panel=PANEL):
    """Frames that see the panel's places `u` (V, U) through a lens, without noise."""
    patterns = PatternSequence.parse(f"white+black+de-bruijn{stripe_px}px", panel)
    fine = 16
    frames = []
    for placed in patterns.placed():
        for k in range(len(placed.frames)):
            shown = np.repeat(placed.code.profile(k, panel[0]), fine)[np.newaxis]
            shown = blurred(shown, Spread(blur_px=blur_px * fine))[0]
            frames.append(np.interp(u, (np.arange(len(shown)) + 0.5) / fine - 0.5, shown))
    return patterns, 20 + 200 * np.array(frames)


def tilted():
    y, x = np.mgrid[0:60, 0:380]
    return 30 + 1.07 * x + 0.11 * y


def test_any_three_edges_stand_once():
    edges = sequence()
    windows = {edges[k : k + 3] for k in range(len(edges) - 2)}
    assert len(windows) == len(edges) - 2 == 7**3
    shown = np.array([DeBruijn(2.0).profile(k, 600) for k in range(3)])
    assert (np.abs(np.diff(shown[:, ::2])).sum(axis=0) >= 1).all()  # every stripe is another


@pytest.mark.parametrize("axis", ["u", "v"])
def test_places_are_found_without_noise(axis):
    u = tilted()
    patterns, frames = view(u)
    if axis == "v":
        patterns = PatternSequence.parse("white+black+de-bruijn8px", PANEL[::-1], axes="v")
        frames, u = frames.transpose(0, 2, 1).copy(), u.T
    found = decode(frames, patterns, noise=NOISE)
    assert found.mask.mean() > 0.9  # two edges and what lies before them, at either end
    # Straight lines through a blurred edge, sampled at whole pixels.
    assert np.nanmax(np.abs(found.coordinate[axis] - u)) < 0.15


def test_the_predicted_deviation_is_the_measured_one():
    u = tilted()
    patterns, clean = view(u)
    without = decode(clean, patterns, noise=NOISE).coordinate["u"]
    pulls = []
    for seed in range(6):
        noisy = clean + np.random.default_rng(seed).normal(0, 1.0, clean.shape)
        found = decode(noisy, patterns, noise=NOISE)
        assert found.mask.mean() > 0.85
        pull = (found.coordinate["u"] - without) / found.sigma["u"]
        pulls.append(pull[np.isfinite(pull)])
    pull = np.concatenate(pulls)
    # Where noise moves an edge past a pixel its straight line is another: rare, and small.
    assert pull.std() == pytest.approx(1.0, rel=0.05)


def test_a_step_breaks_the_line_and_no_place_is_wrong():
    u = tilted()
    u[:, 200:] += 41.0
    patterns, frames = view(u)
    frames[:, 20:30, 100:104] = 20.0  # no light
    frames += np.random.default_rng(1).normal(0, 1.0, frames.shape)
    found = decode(frames, patterns, noise=NOISE)
    assert found.mask.mean() > 0.8
    error = np.abs(found.coordinate["u"] - u)
    away = np.abs(np.arange(380) - 200) > 8
    assert np.nanmax(error[:, away]) < 0.5


def test_text_table_and_refusals():
    patterns = PatternSequence.parse("white+black+de-bruijn6.5px", PANEL)
    assert patterns.name == "white+black+de-bruijn6.5px"
    assert PatternSequence.from_dict(patterns.to_dict()) == patterns
    with pytest.raises(InputError, match="expected a white and a black frame"):
        decode(np.ones((3, 1, 9)), PatternSequence.parse("de-bruijn8px", PANEL))
    with pytest.raises(InputError, match=r"stripe_px: expected 2.96 to 204.8 panel pixels"):
        PatternSequence.parse("de-bruijn2px", (1024, 64))


def test_a_rendered_plane_is_decoded():
    scene, truth = small("plane"), truth_of("plane")
    result = scan(scene.with_patterns("white+black+de-bruijn32px"), seed=3)
    seen = truth.smooth() & result.phase.mask
    error = (result.phase.coordinate["u"] - truth.panel[..., 0])[seen]
    noise = np.sqrt(np.mean(result.phase.sigma["u"][seen] ** 2))
    # Two edges and what lies before them are lost at either end of every line.
    assert seen.sum() > 0.6 * truth.smooth().sum()
    # Edges as sharp as a camera pixel: a straight line is a tenth of a pixel off.
    pixel = np.nanmedian(np.diff(truth.panel[..., 0], axis=1))
    assert error.std() < 0.1 * pixel
    assert abs(np.median(error)) < 0.1 * pixel
    assert error.std() < 1.1 * np.hypot(noise, result.floor_rms_px)
    assert np.abs(error).max() < 0.5 * pixel  # no wrong edge
