"""Codes of the literature: exact without noise, as noisy as predicted, and what each is for."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, Rule, decode
from slbench.patterns.codes.hamiltonian import HamiltonianCode, cycle
from slbench.patterns.codes.micro import MicroPhaseShifting
from slbench.patterns.codes.orders import PhaseCodedOrders
from slbench.patterns.codes.xor import XorCode
from slbench.patterns.matching.match import match

SIZE = 320
#: Text of the sequence, frames, and what of a column a pixel is known to, px.
CODES = {
    "micro": (7, 0.0),
    "micro11/12.3/13.7/15": (6, 0.0),
    "xor2": (18, 1.0),
    "xor4": (18, 1.0),
    "orders20@4+20@4": (8, 0.0),
    "hamiltonian3": (3, 0.0),
    "hamiltonian4": (4, 0.0),
    "hamiltonian5": (5, 0.0),
    "gray+hamiltonian4x8": (22, 0.0),
}


def sequence_of(text):
    return PatternSequence.parse(text, (SIZE, 200))


def shown(sequence):
    """Frames of a camera that sees the panel one to one, (N, 1, SIZE), 20 to 220 DN."""
    frames = [frame.part.profile(frame.index, SIZE) for frame in sequence.frames()]
    return 20.0 + 200.0 * np.array(frames)[:, np.newaxis]


@pytest.mark.parametrize("text", CODES)
def test_every_code_is_exact_without_noise(text):
    sequence = sequence_of(text)
    assert sequence.n_frames == CODES[text][0]
    result = decode(shown(sequence), sequence)
    assert result.mask.all()
    np.testing.assert_allclose(result.coordinate["u"][0], np.arange(SIZE), atol=1e-4)


@pytest.mark.parametrize("text", CODES)
@pytest.mark.parametrize("axis", "uv")
def test_text_and_table_are_read_back(text, axis):
    sequence = PatternSequence.parse(text, (SIZE, SIZE), axes=axis)
    assert sequence.name == text
    assert PatternSequence.from_dict(sequence.to_dict()) == sequence


@pytest.mark.parametrize("text", CODES)
def test_noise_is_as_predicted(text):
    sequence = sequence_of(text)
    noise = NoiseModel(read_dn=2.0, step_dn=0.0)
    clean = np.repeat(shown(sequence), 200, axis=1)
    frames = clean + np.random.default_rng(5).normal(0.0, 2.0, clean.shape)
    result = decode(frames, sequence, noise=noise)
    error = result.coordinate["u"] - np.arange(SIZE)
    # A circle's two ends are one place.
    inside = np.abs(np.arange(SIZE) - 160.0) < 150.0
    measured = result.mask[:, inside]
    assert measured.mean() > 0.98
    error, sigma = error[:, inside][measured], result.sigma["u"][:, inside][measured]
    # No wrong place in 60,000; at the corners of a curve errors are not quite Gaussian.
    assert np.abs(error / sigma).max() < 8.0
    if CODES[text][1]:  # the column itself, of which a camera pixel may see any place
        assert np.abs(error).max() < 0.5
        np.testing.assert_allclose(sigma, 1.0 / np.sqrt(12.0), rtol=1e-3)
    else:  # 60,000 errors: 5 % are 17 standard deviations of their deviation
        assert np.std(error / sigma) == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize(
    ("text", "plain", "share"), [("micro", "1,20@3", 0.8), ("xor4", "gray", 1.6)]
)
def test_light_from_all_over_the_panel_adds_no_error(text, plain, share):
    """Reflected light is a blur of the whole panel: high frequencies leave none of it."""

    def error(name):
        sequence = sequence_of(name)
        direct = shown(sequence)
        # Each pixel also has a share of what the panel shows 90 px further, over 64 px.
        other = np.roll(uniform_filter1d(direct, 64, axis=-1, mode="wrap"), -90, axis=-1)
        frames = direct + share * other
        result = decode(frames, sequence, saturation=1e9)
        found = np.where(result.mask, result.coordinate["u"], np.inf)
        return np.abs(found[0] - np.arange(SIZE))[20:-20]

    high, low = error(text), error(plain)
    # A window of 64 px holds 4 fringes of micro's 16 px, give or take a tenth of one.
    assert np.median(high) < 0.3
    assert np.mean(high > 2.0) < 0.02
    assert np.mean(low > 2.0) > 0.05


def test_xor_codes_have_no_wide_stripes():
    for base in (2, 4):
        code = XorCode("u", base)
        frames = np.array([code.profile(k, 512) for k in range(code.n_frames((512, 1)))])
        edges = np.abs(np.diff(frames, axis=1)) > 0.5
        for row in edges:
            assert np.diff(np.flatnonzero(row)).max() <= 2 * base


@pytest.mark.parametrize("frames", [3, 4, 5, 6])
def test_hamiltonian_cycles_run_along_edges_through_every_corner_once(frames):
    path = cycle(frames)
    steps = [a ^ b for a, b in zip(path, path[1:] + path[:1], strict=True)]
    assert all(step.bit_count() == 1 for step in steps)
    assert len(set(path)) == len(path)
    assert not {0, 2**frames - 1} & set(path)
    # As long as corners of odd and of even weight can alternate.
    odd = sum(k.bit_count() % 2 for k in range(1, 2**frames - 1))
    assert len(path) == 2 * min(odd, 2**frames - 2 - odd)


def test_a_longer_curve_is_less_noisy():
    sigma = {}
    for frames in (3, 4, 5, 6):
        sequence = sequence_of(f"hamiltonian{frames}")
        sigma[frames] = np.median(decode(shown(sequence), sequence).sigma["u"])
    # The curves have 6, 12, 30 and 60 edges; slope and frames make the deviation fall with them.
    assert sigma[4] < 0.6 * sigma[3]
    assert sigma[5] < 0.5 * sigma[4]
    assert sigma[6] < 0.6 * sigma[5]


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: MicroPhaseShifting(periods_px=(16.0, 30.0)), "within a factor of 1.5"),
        (lambda: MicroPhaseShifting(periods_px=(16.0,)), "periods_px"),
        (lambda: MicroPhaseShifting(periods_px=(2.5, 2.7)), "three panel pixels"),
        (lambda: XorCode("u", 3), "base_px"),  # type: ignore[arg-type]
        (lambda: PhaseCodedOrders(1), "2 to 106"),
        (lambda: PhaseCodedOrders(200), "2 to 106"),
        (lambda: HamiltonianCode(2), "frames"),
        (lambda: HamiltonianCode(6, 10.0), "count: expected at most 2.667"),
    ],
)
def test_refused(make, word):
    with pytest.raises(InputError, match=word):
        PatternSequence((SIZE, 200), (make(),))


@pytest.mark.parametrize("width", [640, 1023])
@pytest.mark.parametrize(
    "text",
    ["hamiltonian4x8", "16@4+hamiltonian4x8", "1@3+hamiltonian4x8", "micro14/14/14"],
)
def test_codes_that_repeat_need_a_coarser_one(text, width):
    with pytest.raises(InputError, match="places that differ, or a coarser code before"):
        PatternSequence.parse(text, (width, 200)).runs()


@pytest.mark.parametrize("width", [320, 640, 1023, 1920])
@pytest.mark.parametrize(
    "text",
    [
        *("gray+hamiltonian4x8", "hamiltonian3", "micro", "xor2", "xor4", "speckle6"),
        *("orders16@4+16@4", "optimised4", "optimised5x32"),
    ],
)
def test_codes_that_do_not_repeat_need_none(text, width):
    assert PatternSequence.parse(text, (width, 200)).runs()


@pytest.mark.parametrize(
    ("text", "finest"),
    [
        ("embedded64x3@3+1@3", "EmbeddedPhaseShifting"),
        ("trapezoid8+1@3", "Trapezoidal"),
        ("gray+64@4+two-plus-one16", "Fringes"),
        ("gray+two-plus-one16+64@4", "Fringes"),
    ],
)
def test_the_finest_is_decoded_last_whatever_was_shown_last(text, finest):
    runs = PatternSequence.parse(text, (640, 200)).runs()
    assert runs[-1].family.__name__ == finest


@pytest.mark.parametrize(("text", "widths"), [("xor2", {1, 2}), ("xor4", {2, 4})])
def test_all_stripes_of_an_exclusive_or_are_narrow(text, widths):
    found = set()
    for frame in sequence_of(text).frames():
        shown = frame.part.profile(frame.index, 1024)
        edges = np.flatnonzero(np.diff(shown))
        found |= set(np.diff(edges).tolist())
    assert found == widths


def test_pixels_between_stripes_are_left_out_and_not_told_wrong():
    """A lens blurs the narrow stripes: where they meet the coarser bits are gone."""
    sequence = sequence_of("xor4")
    u = np.arange(8.0, SIZE - 8.0, 0.05)
    clean = uniform_filter1d(shown(sequence)[:, 0], 2, axis=-1)
    frames = np.array([np.interp(u, np.arange(SIZE), one) for one in clean])
    noise = np.random.default_rng(3).normal(0.0, 1.0, (*frames[:, None].shape[:1], 20, len(u)))
    found = decode(frames[:, None] + noise, sequence, noise=NoiseModel(read_dn=1.0, step_dn=0.0))
    off = np.abs(found.coordinate["u"] - u)
    assert found.mask.mean() > 0.85
    # Half a percent were told wrong when the edge itself was held against the frames.
    assert np.mean(off[found.mask] > 2.0) < 1e-4


@pytest.mark.parametrize(("text", "amplitude"), [("orders16@4", 200), ("orders10@5", 30)])
def test_stairs_are_decoded_by_their_phase_as_by_matching(text, amplitude):
    """The nearest step in phase is the most likely one, and the ends are as sure."""
    sequence = sequence_of(text)
    noise = NoiseModel(read_dn=2.0, step_dn=0.0)
    clean = np.repeat(amplitude / 200.0 * shown(sequence), 200, axis=1)
    frames = clean + np.random.default_rng(5).normal(0.0, 2.0, clean.shape)
    by_phase = decode(frames, sequence, noise=noise)
    (run,) = sequence.runs()
    nearest = match(frames.reshape(len(frames), -1), PhaseCodedOrders.vectors(run), noise)
    sure = by_phase.mask.ravel()
    # Matching also doubts pixels of which few degrees of freedom make the noise look large.
    assert np.mean(sure[nearest.sure]) > 0.999
    same = by_phase.coordinate["u"].ravel()[sure] == nearest.coordinate[sure]
    # In single precision the two nearest of a few pixels are one.
    assert same.mean() > 0.9999
    np.testing.assert_allclose(
        by_phase.sigma["u"].ravel()[sure], nearest.sigma[sure], rtol=1e-12, atol=0
    )
    ends = np.abs(by_phase.coordinate["u"] - np.arange(SIZE)) > SIZE / 2
    # Three standard deviations: 0.13 % of those nearest the end, of which there are few.
    assert ends.mean() < 5e-4


def test_a_place_that_a_coarser_code_has_lost_stays_lost():
    """A period's order is none where the coarse place may be the panel's other end."""
    sequence = sequence_of("trapezoid1+two-plus-one16")
    noise = NoiseModel(read_dn=2.0, step_dn=0.0)
    clean = np.repeat(shown(sequence), 200, axis=1)
    frames = clean + np.random.default_rng(5).normal(0.0, 2.0, clean.shape)
    found = decode(frames, sequence, noise=noise, keep_evidence=True)
    assert np.nanmax(np.abs(found.coordinate["u"] - np.arange(SIZE))) < 2.0
    assert set(np.unique(found.dropped)) == {Rule.KEPT, Rule.END}
    assert 0.98 < found.mask.mean() < 1.0
