"""The Cramer-Rao bound against its closed form for fringes, and against what decoders reach."""

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.patterns.matching.bound import cramer_rao, sequence_vectors
from slbench.patterns.matching.match import match
from slbench.patterns.matching.vectors import Nuisance
from slbench.rig.optics.spread import Spread

PANEL = (1024, 600)
NOISE = NoiseModel(read_dn=1.0, step_dn=0.0)
NUISANCES = [Nuisance(), Nuisance("part", "common"), Nuisance("part", "part")]


def of_fringes(counts, shifts, sigma_over_modulation, width=1024):
    """Independent parts: the information of N frames of n fringes is N / 2 (2 pi n b / W s)^2."""
    information = sum(shifts / 2 * (2 * np.pi * n / width) ** 2 for n in counts)
    return sigma_over_modulation / np.sqrt(information)


@pytest.mark.parametrize("nuisance", NUISANCES)
@pytest.mark.parametrize(
    ("counts", "shifts", "published"),
    [((1, 16), 3, 0.1039), ((1, 10, 50), 3, 0.0331), ((1, 16), 5, 0.0805)],
)
def test_of_fringes_is_the_closed_form(counts, shifts, published, nuisance):
    sequence = PatternSequence.parse(f"{','.join(map(str, counts))}@{shifts}", PANEL)
    bound = cramer_rao(sequence, modulation=80.0, mean=120.0, noise=NOISE, nuisance=nuisance)
    assert bound.shape == (1024,)
    # Away from the ends, where the spline through the samples ends; its slope is good to 1e-4.
    inner = bound[5:-5]
    np.testing.assert_allclose(inner, of_fringes(counts, shifts, 1 / 80), rtol=2e-4)
    # Computed beforehand by other means, to the scatter of that computation.
    assert np.median(inner) == pytest.approx(published, rel=0.02)


def test_shot_noise_a_spread_and_less_contrast_raise_it():
    sequence = PatternSequence.parse("1,50@4", PANEL)

    def least(**given):
        settings = {"modulation": 80.0, "mean": 120.0, "noise": NOISE} | given
        return np.median(cramer_rao(sequence, **settings))

    assert least(modulation=40.0) == pytest.approx(2 * least(), rel=1e-6)
    shot = NoiseModel(read_dn=1.0, gain_dn_per_e=0.1, step_dn=0.0)
    # Weighted by their own noise the frames tell more than with the noise of their mean.
    assert least() < least(noise=shot) < least() * np.sqrt(1 + 0.1 * 120)
    spread = Spread(blur_px=2.0)
    kept = spread.contrast(50 / 1024) * np.sinc(50 / 1024)
    assert least(spread=spread) == pytest.approx(least() / kept, rel=0.01)


def test_edges_have_no_slope():
    bound = cramer_rao(PatternSequence.parse("gray", PANEL), modulation=80, mean=120, noise=NOISE)
    assert np.isinf(bound).all()
    fringes = cramer_rao(PatternSequence.parse("50@4", PANEL), modulation=80, mean=120, noise=NOISE)
    both = cramer_rao(
        PatternSequence.parse("gray+50@4", PANEL), modulation=80, mean=120, noise=NOISE
    )
    # Bits tell the gain and offset, not the place; equal shifts knew those already.
    np.testing.assert_allclose(both, fringes, rtol=1e-3)


def test_an_axis_that_nothing_codes_is_refused():
    with pytest.raises(InputError, match="axis: expected an axis that frames of 1,16 vary along"):
        cramer_rao(
            PatternSequence.parse("1,16", PANEL), modulation=1, mean=1, noise=NOISE, axis="v"
        )


@pytest.mark.parametrize("nuisance", NUISANCES)
@pytest.mark.parametrize("text", ["1,16@3", "1,10,50@3", "1,16@5"])
def test_matching_reaches_it(text, nuisance):
    """Over three draws of places and noise, shot noise included."""
    noise = NoiseModel(read_dn=0.5, gain_dn_per_e=0.01, step_dn=0.0)
    sequence = PatternSequence.parse(text, PANEL)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u = rng.uniform(30, 994, 20_000)
        shown = [
            120 + 80 * np.cos(2 * np.pi * (frame.part.count * (u + 0.5) / 1024 - frame.index / n))
            for frame in sequence.frames()
            for n in [frame.part.n_frames(PANEL)]
        ]
        frames = np.array(shown)
        frames += np.sqrt(noise.variance(frames)) * rng.normal(size=frames.shape)
        found = match(frames, sequence_vectors(sequence, "u", nuisance), noise)
        error = found.coordinate - u
        bound = cramer_rao(
            sequence, modulation=80.0, mean=120.0, noise=noise, coordinate=u, nuisance=nuisance
        )
        assert found.sure.all()
        assert (error / bound).std() == pytest.approx(1.0, rel=0.03)
        assert abs((error / bound).mean()) < 4 / np.sqrt(len(u))
        assert np.abs(error / bound).max() < 7  # no wrong order
        closed = decode(frames[:, np.newaxis], sequence, noise=noise).coordinate["u"][0] - u
        assert error.std() < 1.01 * closed.std()
