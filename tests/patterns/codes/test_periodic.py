"""Codes that repeat themselves, against places that are known and the deviation they predict."""

import numpy as np
import pytest
from scenes_small import small, truth_of

from slbench.core.errors import InputError
from slbench.patterns import GrayCode, NoiseModel, PatternSequence, decode
from slbench.patterns.codes.modulated import ModulatedPhaseShifting
from slbench.patterns.codes.trapezoidal import Trapezoidal
from slbench.patterns.codes.two_plus_one import TwoPlusOne
from slbench.patterns.matching.vectors import blurred
from slbench.rig.optics.spread import Spread
from slbench.simulate.scan import scan

WIDTH = 1024
PANEL = (WIDTH, 96)
PIXELS = 20_000
NOISE = NoiseModel(read_dn=1.0, step_dn=0.0)
#: One of each family, along an axis, resolved; and what finds the order.
SETS = [
    "two-plus-one1+two-plus-one10",
    "1@3+two-plus-one16",
    "gray+two-step16+white+black",
    "white+black+two-step1+two-step12.5",
    "trapezoid1",
    "gray+trapezoid8",
    "embedded64x3@3",
    "embedded36.5x3@4",
    "1@5+modulated10@3",
    "modulated1@3+modulated8@4",
]


def exposed(sequence, u, seed, noise_dn=1.0, spread=None):
    """Frames of pixels at places `u` of some rows, by straight lines between samples."""
    rows = np.random.default_rng(seed + 1).integers(0, sequence.panel[1], len(u))
    left = np.clip(np.floor(u).astype(int), 0, sequence.panel[0] - 2)
    part = u - left
    frames = []
    for image in sequence.images():
        shown = image if spread is None else blurred(blurred(image, spread).T, spread).T
        frames.append((1 - part) * shown[rows, left] + part * shown[rows, left + 1])
    dn = 20 + 200 * np.array(frames)
    return (dn + np.random.default_rng(seed).normal(0, noise_dn, dn.shape))[:, np.newaxis]


@pytest.mark.parametrize("text", SETS)
def test_places_are_found_without_noise(text):
    sequence = PatternSequence.parse(text, PANEL)
    u = np.arange(4, WIDTH - 4).astype(float)  # the samples themselves: no interpolation
    found = decode(exposed(sequence, u, 0, 0.0), sequence, noise=NOISE)
    assert found.mask.mean() > 0.98
    assert np.nanmax(np.abs(found.coordinate["u"][0] - u)) < 1e-6


@pytest.mark.parametrize("text", SETS)
def test_the_predicted_deviation_is_the_measured_one(text):
    sequence = PatternSequence.parse(text, PANEL)
    u = np.random.default_rng(3).integers(20, WIDTH - 20, PIXELS).astype(float)
    found = decode(exposed(sequence, u, 4), sequence, noise=NOISE)
    inside = found.mask[0]
    assert inside.mean() > 0.97  # ends of the panel, where there is no Gray code
    pull = (found.coordinate["u"][0] - u)[inside] / found.sigma["u"][0][inside]
    assert np.abs(pull).max() < 6  # no wrong order
    # 20,000 pixels: the deviation scatters by half a hundredth.
    assert pull.std() == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize("family", [TwoPlusOne, Trapezoidal, ModulatedPhaseShifting])
def test_cells_of_one_period_tell_periods_apart(family):
    """Their middle is up to half a period off every place, which is no wrong order."""
    code = GrayCode(cell_px=64.0)
    sequence = PatternSequence(PANEL, (code, family(16)))
    u = np.arange(4, WIDTH - 4).astype(float)
    found = decode(exposed(sequence, u, 0, 0.0), sequence, noise=NOISE)
    # The last places of a period may be counted to the next one; a cell's edge lies there.
    assert found.mask.mean() > 0.98
    off = np.abs(found.coordinate["u"][0] - u)
    assert np.nanmax(np.minimum(off, np.abs(off - 64.0))) < 1e-6
    assert np.nanmean(off > 1.0) < 0.02
    # Cells of two periods do not.
    wide = PatternSequence(PANEL, (GrayCode(cell_px=128.0), family(16)))
    assert not decode(exposed(wide, u, 0, 0.0), wide, noise=NOISE).mask.any()


@pytest.mark.parametrize("text", SETS)
def test_texts_and_tables_are_read_back(text):
    sequence = PatternSequence.parse(text, PANEL)
    assert PatternSequence.parse(sequence.name, PANEL) == sequence
    assert PatternSequence.from_dict(sequence.to_dict()) == sequence
    along_v = PatternSequence.parse(text, (96, WIDTH), axes="v")
    assert along_v.images().shape == (sequence.n_frames, WIDTH, 96)
    np.testing.assert_allclose(along_v.images()[-1], sequence.images()[-1].T, atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "white+black+two-step1+two-step10",
        "1@3+two-plus-one16",
        "gray+trapezoid4",
        "embedded36x3@3",
        "1@3+modulated8@3",
    ],
)
def test_a_rendered_plane_is_decoded(text):
    scene, truth = small("plane"), truth_of("plane")
    result = scan(scene.with_patterns(text), seed=3)
    seen = truth.smooth() & result.phase.mask
    assert seen.sum() > 0.95 * truth.smooth().sum()
    error = (result.phase.coordinate["u"] - truth.panel[..., 0])[seen]
    noise = np.sqrt(np.mean(result.phase.sigma["u"][seen] ** 2))
    # What the renderer leaves without noise adds to it; some 10,000 pixels scatter by a hundredth.
    assert error.std() == pytest.approx(np.hypot(noise, result.floor_rms_px), rel=0.05)
    assert abs(np.median(error)) < 0.05 * noise
    assert np.abs(error).max() < 6.5 * noise  # no wrong order


def test_shot_noise_is_predicted():
    # Variance by grey value: frames of one pixel have different noise.
    noise = NoiseModel(read_dn=0.3, gain_dn_per_e=0.02, offset_dn=20.0, step_dn=0.0)
    for text in ("1@3+two-plus-one16", "gray+trapezoid8", "1@3+modulated10@3"):
        sequence = PatternSequence.parse(text, PANEL)
        u = np.random.default_rng(5).integers(20, WIDTH - 20, PIXELS).astype(float)
        clean = exposed(sequence, u, 6, 0.0)
        drawn = np.random.default_rng(7).normal(size=clean.shape)
        found = decode(clean + np.sqrt(noise.variance(clean)) * drawn, sequence, noise=noise)
        inside = found.mask[0]
        pull = (found.coordinate["u"][0] - u)[inside] / found.sigma["u"][0][inside]
        assert pull.std() == pytest.approx(1.0, rel=0.03)


def ripple(period_px, spread):
    """Deviation that three shifts of square fringes have, px, by their harmonics 6 j +- 1.

    The harmonics m of a square have amplitudes 1 / m and signs that alternate, so that of each
    pair both ripple the phase alike, 6 j times a period, by b_m / b_1 rad.
    """

    def left(m):
        return spread.contrast(m / period_px) / spread.contrast(1 / period_px) / m

    pairs = [left(6 * j - 1) + left(6 * j + 1) for j in range(1, int(period_px / 12))]
    return period_px / (2 * np.pi) * np.sqrt(0.5 * np.sum(np.square(pairs)))


def out_of_focus(text, blur_px):
    """Deviation of the coordinate, px, the fringes blurred and the Gray code sharp."""
    sequence = PatternSequence.parse(text, (960, 64))
    assert set(np.unique(sequence.images())) == {0.0, 1.0}
    u = np.random.default_rng(8).integers(60, 900, 4000).astype(float)
    frames = exposed(sequence, u, 9, 0.0, Spread(blur_px=blur_px))
    frames[:20] = exposed(sequence, u, 9, 0.0)[:20]
    found = decode(frames, sequence, noise=NOISE)
    assert found.mask.mean() > 0.98
    return np.nanstd(found.coordinate["u"][0] - u)


@pytest.mark.parametrize("blur_px", [1.0, 2.0, 3.0])
def test_what_defocus_leaves_of_square_fringes_is_known(blur_px):
    # Shifts of 20 px, whole ones: edges lie between pixels.  To first order in the ripple.
    expected = ripple(60, Spread(blur_px=blur_px))
    found = out_of_focus("gray+square60px@3", blur_px)
    assert found == pytest.approx(expected, rel=0.05)


def test_dithered_fringes_need_less_blur_than_square_ones():
    # Little blur takes the dots of the matrix and not the square's harmonics.  What 64 levels laid
    # on a slope leave is coarse, some 0.03 rad, and no blur takes it: the square is then better.
    near = [out_of_focus(f"gray+{name}60px@3", 1.5) for name in ("dithered", "square")]
    far = [out_of_focus(f"gray+{name}60px@3", 5.0) for name in ("dithered", "square")]
    assert max(near[0], far[0]) < 0.06 * 60 / (2 * np.pi)
    assert near[0] < 0.4 * near[1]
    assert far[0] > 2 * far[1]


def test_refusals():
    with pytest.raises(InputError, match="one period or less, a coarser code"):
        PatternSequence.parse("two-plus-one16", PANEL).runs()
    sequence = PatternSequence.parse("gray+two-step16+white", PANEL)
    with pytest.raises(InputError, match="expected a white and a black frame"):
        decode(np.ones((sequence.n_frames, 1, 2)), sequence)
    with pytest.raises(InputError, match=r"count: expected at most 341\.3"):
        PatternSequence.parse("trapezoid400", PANEL)
    with pytest.raises(InputError, match="count: expected sets of at most 341 fringes"):
        PatternSequence.parse("embedded330", PANEL)
    with pytest.raises(InputError, match="did you mean 'two-step16'"):
        PatternSequence.parse("two-stp16", PANEL)
