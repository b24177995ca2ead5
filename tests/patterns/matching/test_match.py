"""Matching against the closed form of fringes, and of codes that have none."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.patterns import Flat, NoiseModel, PatternSequence, decode
from slbench.patterns.matching import MatchedCode
from slbench.patterns.matching.match import match
from slbench.patterns.matching.vectors import CodeVectors, Nuisance, blurred
from slbench.rig.optics.spread import Spread

WIDTH = 1024
PANEL = (WIDTH, 600)
PIXELS = 20_000


@dataclass(frozen=True)
class Waves(MatchedCode):
    """Sums of a few random sinusoids: smooth, without a closed form."""

    kind: ClassVar[str] = "waves"

    frames: int = 8
    cell: int = 1

    @property
    def axes(self):
        return ("u",)

    def n_frames(self, panel):
        return self.frames

    def profile(self, k, size):
        rng = np.random.default_rng(k)
        x = np.arange(size) // self.cell * self.cell / size
        waves = sum(
            rng.normal() * np.cos(2 * np.pi * n * x + rng.uniform(0, 6)) for n in range(1, 24)
        )
        return (waves - waves.min()) / np.ptp(waves)


def vectors_of(text, nuisance):
    placed = PatternSequence.parse(text, PANEL).placed()
    values = np.concatenate(
        [p.code.image(k, (WIDTH, 1)) for p in placed for k in range(len(p.frames))]
    )
    parts = np.repeat(np.arange(len(placed)), [len(p.frames) for p in placed])
    return CodeVectors(values, parts, nuisance)


def fringe_frames(text, u, seed, falling=1.0):
    """Frames of 80 DN modulation with noise of 1 DN at places `u`, not of the code's samples."""
    rows, modulation = [], 80.0
    for placed in PatternSequence.parse(text, PANEL).placed():
        shifts = len(placed.frames)
        phase = 2 * np.pi * placed.code.count * (u + 0.5) / WIDTH
        rows += [120 + modulation * np.cos(phase - 2 * np.pi * k / shifts) for k in range(shifts)]
        modulation *= falling
    return np.array(rows) + np.random.default_rng(seed).normal(0, 1.0, (len(rows), len(u)))


NOISE = NoiseModel(read_dn=1.0, step_dn=0.0)


@pytest.mark.parametrize("text", ["1,16@3", "1,10,50@3", "1,16@5", "1,7.3,40.9@4"])
@pytest.mark.parametrize(
    "nuisance", [Nuisance(), Nuisance("part", "common"), Nuisance("part", "part")]
)
def test_fringes_are_matched_as_their_closed_form_decodes_them(text, nuisance):
    u = np.random.default_rng(5).uniform(30, WIDTH - 30, PIXELS)
    frames = fringe_frames(text, u, 6)
    found = match(frames, vectors_of(text, nuisance), NOISE)
    closed = decode(frames[:, np.newaxis], PatternSequence.parse(text, PANEL), noise=NOISE)
    error = found.coordinate - u
    assert found.sure.all()
    assert closed.mask.all()
    # The deviation of 20,000 values scatters by 0.5 %.
    assert error.std() == pytest.approx(np.median(found.sigma), rel=0.02)
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(PIXELS)
    assert np.abs(error).max() < 6 * error.std()  # no wrong order
    # The closed form takes the place from the last set alone, matching from all that they hold.
    both = found.coordinate - closed.coordinate["u"][0]
    assert both.std() < 0.25 * error.std()
    assert error.std() <= 1.01 * np.std(closed.coordinate["u"][0] - u)


def test_gains_a_part_follow_a_modulation_that_falls():
    u = np.random.default_rng(7).uniform(30, WIDTH - 30, PIXELS)
    frames = fringe_frames("1,10,50@3", u, 8, falling=0.5)
    each = match(frames, vectors_of("1,10,50@3", Nuisance("part")), NOISE)
    error = each.coordinate - u
    assert error.std() == pytest.approx(np.median(each.sigma), rel=0.02)
    assert np.median(each.gain) == pytest.approx(2 * 80 * 0.25, rel=0.01)
    # One gain for all is the wrong model here, and what it leaves says so.
    common = match(frames, vectors_of("1,10,50@3", Nuisance()), NOISE)
    assert np.median(common.residual_dn) > 5 * np.median(each.residual_dn)


def test_what_a_fit_leaves_measures_the_noise():
    u = np.random.default_rng(9).uniform(30, WIDTH - 30, PIXELS)
    found = match(fringe_frames("1,16@5", u, 10), vectors_of("1,16@5", Nuisance()), NOISE)
    assert np.sqrt(np.mean(found.residual_dn**2)) == pytest.approx(1.0, rel=0.02)


def test_pixels_that_two_places_explain_are_masked():
    # Ten fringes alone: ten places fit equally well.
    u = np.random.default_rng(11).uniform(30, WIDTH - 30, 1000)
    found = match(fringe_frames("10@4", u, 12), vectors_of("10@4", Nuisance()), NOISE)
    assert not found.sure.any()
    assert np.median(found.rival) > 0.999


def exposed(sequence, u, noise_dn, seed):
    """Frames of pixels at places `u` between the panel's own, by straight lines."""
    images = np.array([image[0] for image in sequence.images()])
    places = np.arange(sequence.panel[0])
    frames = 20 + 200 * np.array([np.interp(u, places, row) for row in images])
    frames += np.random.default_rng(seed).normal(0, noise_dn, frames.shape)
    return frames[:, np.newaxis]


def test_a_code_that_only_says_what_it_shows_is_decoded():
    sequence = PatternSequence(PANEL, (Flat(1.0), Waves()))
    u = np.random.default_rng(1).uniform(5, WIDTH - 6, PIXELS)
    frames = exposed(sequence, u, 1.0, 2)
    found = decode(frames, sequence, noise=NOISE, keep_evidence=True)
    error = (found.coordinate["u"][0] - u)[found.mask[0]]
    assert found.mask.mean() > 0.99
    assert np.abs(error).max() < 2.0
    assert (error / found.sigma["u"][0][found.mask[0]]).std() == pytest.approx(1.0, rel=0.05)
    assert set(found.evidence[1]) == {"correlation", "rival", "fit_residual_dn"}
    assert found.evidence[1]["correlation"].min() > 0.98


def test_places_of_equal_vectors_are_known_to_their_cell():
    sequence = PatternSequence(PANEL, (Waves(cell=8),))
    u = np.random.default_rng(3).uniform(0, WIDTH - 1, 5000).round()
    found = decode(exposed(sequence, u, 0.5, 4), sequence, noise=NOISE)
    assert found.mask.mean() > 0.95
    inside = found.mask[0]
    np.testing.assert_array_equal(found.coordinate["u"][0][inside], u[inside] // 8 * 8 + 3.5)
    np.testing.assert_allclose(found.sigma["u"][0][inside], 8 / np.sqrt(12))


def test_a_coarser_code_narrows_the_search():
    # The code repeats itself four times; a Gray code before it tells which.
    @dataclass(frozen=True)
    class Repeated(Waves):
        kind: ClassVar[str] = "repeated"

        def profile(self, k, size):
            return np.tile(super().profile(k, size // 4), 4)

    u = np.random.default_rng(13).uniform(10, WIDTH - 11, 5000).round()
    alone = PatternSequence(PANEL, (Repeated(),))
    with pytest.raises(InputError, match="places that differ, or a coarser code before"):
        alone.runs()
    gray = PatternSequence.parse("gray", PANEL).parts
    both = PatternSequence(PANEL, (*gray, Repeated()))
    found = decode(exposed(both, u, 0.5, 14), both, noise=NOISE)
    assert found.mask.mean() > 0.99
    assert np.nanmax(np.abs(found.coordinate["u"][0] - u)) < 3


def test_too_few_frames_are_refused():
    sequence = PatternSequence(PANEL, (Waves(frames=2),))
    with pytest.raises(InputError, match=r"parts\[0\]: expected at least 3 frames"):
        sequence.runs()


def test_vectors_are_blurred_by_the_line_spread():
    x = np.arange(200)
    wave = np.array([0.5 + 0.5 * np.cos(2 * np.pi * x / 20)])
    spread = Spread(blur_px=2.0)
    kept = np.ptp(blurred(wave, spread)[0][40:-40])
    # The transfer function, times that of a kernel laid on whole pixels: sinc(1 / 20).
    assert kept == pytest.approx(spread.contrast(1 / 20) * np.sinc(1 / 20), abs=2e-3)
