"""What tells fringes apart: every way, in any order of sets; captures of real makers' schemes."""

from itertools import permutations

import numpy as np
import pytest
from photographed import photograph

from slbench.capture import Capture
from slbench.cloud.decoded import decode_capture
from slbench.core.errors import InputError
from slbench.core.io import read_exr
from slbench.patterns import Flat, Fringes, GrayCode, NoiseModel, PatternSequence, decode
from slbench.patterns.fringes.ways import beats, closest_rival

PANEL = (96, 8)
COLUMNS = np.broadcast_to(np.arange(96.0), (8, 96))


def taken(sequence, u=COLUMNS, seed=None, read_dn=0.0):
    """Frames as an 8-bit camera that sees the panel one to one gives them."""
    clean = photograph(sequence, {"u": u}, a=120.0, b=90.0)
    noise = np.random.default_rng(seed).normal(0, read_dn, clean.shape) if read_dn else 0.0
    return np.rint(clean + noise).astype(np.uint8)


def told(*parts, panel=PANEL, **beside):
    return PatternSequence(panel, parts, **beside)


# Right to a tenth of a pixel: rounding to whole DN leaves below 0.02 px of the coarsest fringes
# here, 14 px, and a wrong order is a whole fringe off.
RIGHT = 0.1


def check_right(sequence, frames, off=0.0, share=1.0):
    found = decode(frames, sequence)
    error = (found.coordinate["u"] - COLUMNS)[found.mask]
    assert np.abs(error - off).max() < RIGHT
    assert found.mask.mean() >= share
    return found


# -- schemes that makers use -----------------------------------------------------------------------


@pytest.mark.parametrize("way", ["auto", "heterodyne", "number-theoretic"])
def test_two_periods_whose_beat_is_one_fringe(way):
    sequence = told(Fringes(8, 4), Fringes(9, 4), unwrap=way)
    check_right(sequence, taken(sequence), share=0.99)


def test_phase_from_the_centre_of_the_first_column():
    sequence = told(Fringes(1, origin="centre"), Fringes(8, origin="centre"))
    frames = taken(sequence)
    check_right(sequence, frames, share=0.95)
    # Told otherwise, all columns are half a pixel off and nothing shows it.
    plain = told(Fringes(1), Fringes(8))
    error = decode(frames, plain).coordinate["u"] - COLUMNS
    assert np.nanmedian(error) == pytest.approx(-0.5, abs=RIGHT)


def test_sines_in_place_of_cosines():
    sequence = told(Fringes(1, phase_deg=-90), Fringes(7, phase_deg=-90))
    columns = np.sin(2 * np.pi * 7 * (np.arange(96) + 0.5) / 96)
    np.testing.assert_allclose(sequence.profiles("u")[1][3], 0.5 + 0.5 * columns, atol=1e-12)
    check_right(sequence, taken(sequence), share=0.95)


def test_one_set_alone_is_resolved_by_its_neighbours_or_not_at_all():
    alone = told(Fringes(8, 4))
    frames = taken(alone)
    with pytest.raises(InputError, match=r'unwrap = "spatial" or "none", got 8 fringes'):
        alone.runs()
    found = decode(frames, told(Fringes(8, 4), unwrap="spatial"))
    error = found.coordinate["u"] - COLUMNS
    assert found.mask.all()
    fringes = error / 12.0  # up to a whole number of fringes, one for the whole picture
    assert np.abs(fringes - np.rint(fringes[0, 0])).max() < RIGHT / 12
    assert np.nanmedian(found.coordinate["u"]) == pytest.approx(47.5, abs=6.0 + RIGHT)
    relative = decode(frames, told(Fringes(8, 4), unwrap="none"))
    assert not relative.mask.any()
    assert np.isnan(relative.coordinate["u"]).all()
    ((count, phase),) = relative.relative["u"]
    assert count == 8
    exact = 2 * np.pi * 8 * (COLUMNS + 0.5) / 96
    assert np.abs(np.angle(np.exp(1j * (phase - exact)))).max() < 0.02


def test_neighbours_do_not_see_saturated_pixels():
    sequence = told(Fringes(8, 4), unwrap="spatial")
    frames = taken(sequence)
    frames[:, 3, 40] = 255
    found = decode(frames, sequence)
    assert not found.mask[3, 40]
    assert found.mask.sum() == found.mask.size - 1


@pytest.mark.parametrize("fine", [Fringes(9.6), Fringes(period_px=10.0)])
def test_a_gray_code_and_a_period_that_is_no_part_of_the_panel(fine):
    sequence = told(GrayCode("u"), fine)
    found = check_right(sequence, taken(sequence))
    assert found.mask.all()


def test_the_fine_set_shifted_the_other_way():
    shown = told(Fringes(1, 4), Fringes(8, 4, direction=-1))
    frames = taken(shown)
    check_right(shown, frames, share=0.95)
    residual = decode(frames, told(Fringes(1, 4), Fringes(8, 4)), keep_evidence=True).evidence[1]
    # The order goes through 16 turns over the panel: as even as 96 columns allow, 1/sqrt(12).
    assert np.std(residual["order_residual"]) == pytest.approx(1 / np.sqrt(12), rel=0.03)


def test_wrong_orders_are_masked_by_their_residual():
    # One column of a panel of 480 px, 2 DN of noise on a modulation of 20: an order in sixty is
    # wrong.
    sequence = told(Fringes(1), Fringes(16), panel=(480, 40))
    u = np.broadcast_to(np.arange(30.0, 450.0), (200, 420))
    clean = photograph(sequence, {"u": u}, a=120.0, b=20.0)
    frames = np.rint(clean + np.random.default_rng(0).normal(0, 2.0, clean.shape)).astype(np.uint8)
    noise = NoiseModel(read_dn=2.0)
    every = decode(frames, sequence, noise=noise, max_order_residual=0.5)
    kept = decode(frames, sequence, noise=noise)
    wrong = np.abs(every.coordinate["u"] - u) > 15.0
    left = np.abs(kept.coordinate["u"] - u) > 15.0
    assert 0.01 < wrong.sum() / every.mask.sum() < 0.025
    assert left.sum() < 0.1 * wrong.sum()
    assert np.nanmean(every.sigma["u"][wrong]) < 0.5  # sigma says nothing of them
    same = kept.mask
    np.testing.assert_array_equal(kept.coordinate["u"][same], every.coordinate["u"][same])


# -- order and choice ------------------------------------------------------------------------------


@pytest.mark.parametrize("base", [Fringes(1, 4), GrayCode("u")])
def test_the_order_in_which_sets_were_shown_does_not_matter(base):
    parts = (base, Fringes(4, 3), Fringes(16, 5), Flat(1.0))
    frames = [taken(told(part)) for part in parts]
    first = decode(np.concatenate(frames), told(*parts), keep_relative=True)
    assert first.mask.mean() > 0.9
    for order in permutations(range(4)):
        sequence = told(*(parts[k] for k in order))
        found = decode(np.concatenate([frames[k] for k in order]), sequence, keep_relative=True)
        np.testing.assert_array_equal(found.coordinate["u"], first.coordinate["u"])
        np.testing.assert_array_equal(found.sigma["u"], first.sigma["u"])
        counts = [parts[k].count for k in order if isinstance(parts[k], Fringes)]
        assert [count for count, _ in found.relative["u"]] == counts  # as they were shown


@pytest.mark.parametrize(
    ("parts", "way", "expected"),
    [
        ((Fringes(8), Fringes(12)), "auto", "same 24 px apart|24 px apart|common period"),
        ((Fringes(8), Fringes(12)), "number-theoretic", "nearly the same 24 px apart"),
        ((Fringes(8), Fringes(12)), "heterodyne", "beat in one fringe"),
        ((Fringes(8), Fringes(9)), "sequential", "one fringe or less along u"),
        ((Fringes(1), Fringes(9)), "gray", "a Gray code along u"),
        ((Fringes(19.2), Fringes(28.8)), "auto", "common period"),
        ((Fringes(8),), "heterodyne", "beat in one fringe"),
    ],
)
def test_what_cannot_be_resolved_is_refused_before_anything_is_shown(parts, way, expected):
    sequence = told(*parts, unwrap=way)
    with pytest.raises(InputError, match=expected) as caught:
        sequence.runs()
    assert "\n" not in str(caught.value)


def test_a_way_that_does_not_exist():
    table = {"panel": [96, 8], "parts": [{"kind": "fringes", "count": 1}], "unwrap": "heterodine"}
    with pytest.raises(InputError, match="did you mean 'heterodyne'"):
        PatternSequence.from_dict(table)


def test_less_than_one_fringe_is_a_beginning_too():
    sequence = told(Fringes(0.8, 8), Fringes(7.3, 4))
    check_right(sequence, taken(sequence))


@pytest.mark.parametrize(
    ("counts", "way"),
    [
        *[((9, 8), way) for way in ("heterodyne", "number-theoretic")],
        *[((15.5, 14.75, 12.0), way) for way in ("heterodyne", "number-theoretic")],
        *[((16, 15, 12), way) for way in ("heterodyne", "number-theoretic")],
        ((13, 11, 7), "number-theoretic"),  # no beat of these is one fringe
    ],
)
def test_ways_without_one_fringe_agree_with_truth(counts, way):
    sequence = told(*(Fringes(count, 5) for count in counts), unwrap=way)
    u = np.broadcast_to(np.linspace(0.5, 94.5, 500), (8, 500))
    clean = photograph(sequence, {"u": u}, b=100.0)
    frames = clean + np.random.default_rng(1).normal(0, 1.0, clean.shape)
    found = decode(frames, sequence, noise=NoiseModel(read_dn=1.0, step_dn=0.0))
    assert found.mask.mean() > 0.93
    error = found.coordinate["u"] - u
    assert np.nanmax(np.abs(error)) < 6 * np.nanmax(found.sigma["u"])


def test_chain_of_beats_is_the_classical_one():
    # Towers et al.: 100, 99 and 90 fringes beat in 1, 10 (9 and 10) and 100 fringes.
    chain = beats((90.0, 99.0, 100.0))
    assert [step.count for step in chain if not step.compares] == [1.0, 10.0, 100.0]
    assert chain[0].factors == (0, -1, 1)
    assert chain[1].factors == (-1, 0, 1)
    assert beats((8.0, 12.0)) == ()


@pytest.mark.parametrize("counts", [(8, 9), (13, 11, 7), (9.6, 7.1), (16, 15, 12), (8, 12)])
def test_closest_rival_is_the_least_distance_between_phases(counts):
    # Phases of neighbouring places form a line of direction n in the space of phases; by brute
    # force, how far the line of another combination of orders is from the origin.
    n = np.sort(np.array(counts, dtype=float))
    distance, apart = closest_rival(counts)
    others = np.arange(1, int(np.ceil(n[-1])))
    exact = []
    for j in others:
        r = n * j / n[-1] - np.rint(n * j / n[-1])
        t = np.linspace(-1, 1, 200001)[:, None] / n[-1]
        exact.append(np.sqrt(((r + t * n) ** 2).sum(axis=1).min()))
    assert distance == pytest.approx(min(exact), abs=1e-4)
    assert apart * n[-1] == pytest.approx(others[int(np.argmin(exact))])


def test_noise_picks_the_closest_rival_as_often_as_its_distance_says():
    # Two equally close rivals, one on either side: twice Q(pi d / sigma).
    from scipy.stats import binomtest, norm

    counts, sigma_dn = (8, 9), 20.0
    sequence = told(*(Fringes(count, 8) for count in counts), max_order_residual=0.5)
    u = np.full((400, 500), 47.3)
    clean = photograph(sequence, {"u": u}, b=100.0)
    frames = clean + np.random.default_rng(2).normal(0, sigma_dn, clean.shape)
    noise = NoiseModel(read_dn=sigma_dn, step_dn=0.0)
    found = decode(frames, sequence, noise=noise)
    wrong = int(np.sum(np.abs(found.coordinate["u"] - u) > 96 / 9 / 2))
    sigma = np.sqrt(2 / 8) * sigma_dn / 100
    rate = 2 * norm.sf(np.pi * closest_rival(counts)[0] / sigma)
    assert 1e-3 < rate < 0.1
    # A false alarm in 10,000; the seed is fixed.
    assert binomtest(wrong, int(found.mask.sum()), rate).pvalue > 1e-4


def test_relative_phases_are_written_where_they_are_the_result(tmp_path):
    sequence = told(Fringes(8, 4), Fringes(11, 3), unwrap="none")
    frames = taken(sequence)
    decode_capture(Capture(frames, sequence)).save(tmp_path / "out", {})
    written = read_exr(tmp_path / "out" / "phase.exr")
    relative = decode(frames, sequence).relative["u"]
    for k, (_, phase) in enumerate(relative):
        np.testing.assert_array_equal(written[f"relative.u.{k}"], phase.astype(np.float32))
