"""Decoding: exact round trips, the noise that theory predicts, masks, bad input.

Frames are made from panel coordinates by the fringe equation itself, so every expected
value here is analytic.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from slbench.core.errors import InputError
from slbench.patterns import (
    Flat,
    Fringes,
    GrayCode,
    NoiseModel,
    PatternSequence,
    decode,
    order_error_probability,
    relative_phase,
    unwrap,
)
from slbench.patterns.kernels.fringes import angle
from slbench.patterns.phase import false_modulation_probability, squared_modulation_bias

ROUNDLESS = NoiseModel(step_dn=0.0)


def photograph(sequence, coordinates, a=120.0, b=100.0):
    """Frames (N, V, U) of fringes a + b cos at exact real-valued panel coordinates."""
    rows = []
    for frame in sequence.frames():
        if isinstance(frame.part, Fringes):
            size = sequence.size(frame.along)
            phase = 2 * np.pi * frame.part.count * (coordinates[frame.along] + 0.5) / size
            rows.append(a + b * np.cos(phase - 2 * np.pi * frame.index / frame.part.shifts))
        elif isinstance(frame.part, GrayCode):
            profile = frame.part.profile(frame.index, sequence.size(frame.along))
            rows.append(a + b * (2 * profile[np.rint(coordinates[frame.along]).astype(int)] - 1))
        else:
            rows.append(
                np.full_like(next(iter(coordinates.values())), a - b + 2 * b * frame.part.level)
            )
    return np.array(rows)


def test_angle_is_atan2():
    rng = np.random.default_rng(1)
    y, x = rng.normal(size=(2, 20_000)) * 10.0 ** rng.integers(-9, 9, size=(2, 20_000))
    exact = np.mod(np.arctan2(y, x), 2 * np.pi)
    got = np.array([angle(a, b) for a, b in zip(y, x, strict=True)])
    # Polynomial error 1e-15 rad plus the rounding of angles up to 2 pi.
    assert np.abs(np.angle(np.exp(1j * (got - exact)))).max() < 4e-15
    corners = [angle(0.0, 1.0), angle(1.0, 0.0), angle(0.0, -1.0), angle(-1.0, 0.0)]
    np.testing.assert_allclose(corners, np.arange(4) * np.pi / 2, atol=1e-15)
    assert np.isnan(angle(0.0, 0.0))


@pytest.mark.parametrize("shifts", range(3, 17))
def test_any_number_of_shifts_both_axes(shifts):
    sequence = PatternSequence.parse("1,7,20", (100, 60), shifts=shifts, axes="uv")
    rng = np.random.default_rng(shifts)
    truth = {"u": rng.uniform(1, 98, (40, 50)), "v": rng.uniform(1, 58, (40, 50))}
    result = decode(photograph(sequence, truth), sequence, noise=ROUNDLESS)
    assert result.mask.all()
    for axis in "uv":
        # Double precision through a sum of 16 and a panel of 100 px: about 1e-13 px.
        np.testing.assert_allclose(result.coordinate[axis], truth[axis], atol=1e-10)
    np.testing.assert_allclose(result.modulation, 100, rtol=1e-12)
    np.testing.assert_allclose(result.mean, 120, rtol=1e-12)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_kernel_equals_the_building_blocks(dtype):
    sequence = PatternSequence.parse("1@3,6@4,30@5", (640, 480))
    rng = np.random.default_rng(2)
    truth = {"u": rng.uniform(30, 600, (37, 41))}  # odd sizes leave a partial block
    frames = np.rint(photograph(sequence, truth) + rng.normal(0, 2, (12, 37, 41))).astype(dtype)
    result = decode(frames, sequence, keep_relative=True)
    phase, modulation, mean = relative_phase(frames[:3])
    absolute, fringes, first = phase, 1, 3
    for n, shifts in ((6, 4), (30, 5)):
        phase, modulation, mean = relative_phase(frames[first : first + shifts])
        absolute = unwrap(phase, n, absolute, fringes)
        fringes, first = n, first + shifts
    assert result.mask.all()
    coordinate = absolute * 640 / (2 * np.pi * 30) - 0.5
    np.testing.assert_allclose(result.coordinate["u"], coordinate, atol=1e-9)
    np.testing.assert_allclose(result.relative["u"][2][1], phase, atol=1e-9)
    assert [n for n, _ in result.relative["u"]] == [1, 6, 30]
    np.testing.assert_allclose(result.modulation, modulation, atol=1e-9)
    np.testing.assert_allclose(result.mean, mean, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(width=st.integers(2, 700), inverse=st.booleans(), axis=st.sampled_from("uv"))
def test_gray_code_round_trip_for_any_width(width, inverse, axis):
    panel = (width, 5) if axis == "u" else (5, width)
    sequence = PatternSequence(panel, (Flat(1.0), Flat(0.0), GrayCode(axis, inverse)))
    columns = np.arange(width, dtype=float)[np.newaxis]
    result = decode(photograph(sequence, {axis: columns}), sequence)
    np.testing.assert_array_equal(result.coordinate[axis], columns)
    np.testing.assert_array_equal(result.sigma[axis], 1 / np.sqrt(12))
    np.testing.assert_allclose(result.modulation, 100)
    np.testing.assert_allclose(result.mean, 120)


def test_gray_code_unwraps_fringes_up_to_the_ends_of_the_panel():
    sequence = PatternSequence.parse("gray+16@4", (200, 100))
    truth = {"u": np.linspace(-0.49, 199.49, 999)[np.newaxis]}
    result = decode(photograph(sequence, truth), sequence)
    assert result.mask.all()
    np.testing.assert_allclose(result.coordinate["u"], truth["u"], atol=1e-10)


def test_gray_codes_beyond_the_panel_and_undecided_codes_are_masked():
    sequence = PatternSequence.parse("gray", (5, 5))  # 3 bits, codes 5..7 are unused
    bits = np.array([[1, 0, 0], [1, 1, 1], [0, 1, 0]]).T  # Gray 100 = 7, 111 = 5, 010 = 3
    frames = np.empty((6, 1, 4))
    frames[0::2, 0, :3] = 20 + 200 * bits
    frames[1::2, 0, :3] = 220 - 200 * bits
    frames[:, 0, 3] = 120  # no bit decided
    result = decode(frames, sequence)
    np.testing.assert_array_equal(result.mask, [[False, False, True, False]])
    np.testing.assert_array_equal(result.coordinate["u"], [[np.nan, np.nan, 3, np.nan]])


# False-alarm rates: the standard deviation of n Gaussian numbers scatters by 1/sqrt(2 n);
# with n = 40,000 a 3 % bound is 8.5 sigma (< 1e-16), and the coverage bounds below are 4
# sigma (6e-5 each).  Seeds are fixed.
@pytest.mark.parametrize("shifts", [3, 4, 8])
@pytest.mark.parametrize("column", [100.0, 104.0, 107.3, 112.0])
def test_noise_of_the_coordinate_is_the_closed_form(shifts, column):
    n = 40_000
    # Strong shot noise: with three shifts its third harmonic changes the variance by +-40 %.
    noise = NoiseModel(read_dn=0.3, gain_dn_per_e=0.05, offset_dn=15.0, step_dn=0.0)
    sequence = PatternSequence.parse("1,10", (400, 300), shifts=shifts)
    clean = photograph(sequence, {"u": np.full((200, 200), column)})
    rng = np.random.default_rng([shifts, int(10 * column)])
    frames = clean + rng.standard_normal(clean.shape) * np.sqrt(noise.variance(clean))
    result = decode(frames, sequence, noise=noise)
    error = result.coordinate["u"] - column

    phi = 2 * np.pi * 10 * (column + 0.5) / 400
    theta = phi - 2 * np.pi * np.arange(shifts) / shifts
    variance = noise.variance(120 + 100 * np.cos(theta))
    direct = np.sqrt(4 / (shifts * 100) ** 2 * np.sum(variance * np.sin(theta) ** 2))
    direct *= 400 / (2 * np.pi * 10)
    assert np.std(error) == pytest.approx(direct, rel=0.03)
    # The prediction uses measured a, b and phi, each noisy by under 1 %.
    assert np.median(result.sigma["u"]) == pytest.approx(direct, rel=0.01)
    covered = np.mean(np.abs(error) < 1.96 * result.sigma["u"])
    assert covered == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / n) + 0.002)


@pytest.mark.parametrize(("fringes", "sigma_dn"), [(20, 14.0), (40, 4.0), (50, 5.0)])
def test_fringe_order_errors_come_at_the_predicted_rate(fringes, sigma_dn):
    n = 250_000
    width = 400
    noise = NoiseModel(read_dn=sigma_dn, step_dn=0.0)
    sequence = PatternSequence.parse(f"1,{fringes}@4", (width, 300))
    clean = photograph(sequence, {"u": np.full((500, 500), 201.7)})
    rng = np.random.default_rng(fringes)
    frames = clean + rng.normal(0, sigma_dn, clean.shape)
    result = decode(frames, sequence, noise=noise, max_order_residual=0.5)
    assert result.mask.all()
    period = width / fringes
    wrong = int(np.sum(np.abs(result.coordinate["u"] - 201.7) > period / 2))
    sigma_phi = np.sqrt(2 / 4) * sigma_dn / 100
    rate = order_error_probability(sigma_phi, sigma_phi, 1, fringes)
    assert 1e-3 < rate < 0.2
    # Binomial test at a false-alarm rate of 1e-4.  First-order theory is itself good to
    # order sigma_phi^2 (1 %), within the test's resolution here.
    assert stats.binomtest(wrong, n, rate).pvalue > 1e-4


def test_order_error_probability_against_sampling_of_unwrap():
    rng = np.random.default_rng(3)
    n = 200_000
    reference = rng.normal(1.0, 0.1, n)
    phi = np.mod(10.0 + rng.normal(0, 0.2, n), 2 * np.pi)
    wrong = np.sum(np.abs(unwrap(phi, 20, reference, 2) - 10.0) > np.pi)
    rate = order_error_probability(0.1, 0.2, 2, 20, "gaussian")
    assert stats.binomtest(int(wrong), n, rate).pvalue > 1e-4  # false-alarm rate 1e-4
    assert order_error_probability(0.0, 0.0, 1, 10) == 0.0


def test_ends_of_the_panel():
    noise = NoiseModel(read_dn=3.0, step_dn=0.0)
    sequence = PatternSequence.parse("1,10@4", (400, 300))
    rng = np.random.default_rng(4)
    # Within the reference's noise of an end (1.4 px), beyond 5 sigma of the finest (0.14 px).
    for column in (0.2, 398.8):
        clean = photograph(sequence, {"u": np.full((100, 100), column)})
        result = decode(clean + rng.normal(0, 3, clean.shape), sequence, noise=noise)
        assert np.mean(result.mask) > 0.97  # 2 sigma of margin left on average
        assert np.nanmax(np.abs(result.coordinate["u"] - column)) < 1.0
    # At the very end nothing tells one end from the other: all that is kept is right.
    clean = photograph(sequence, {"u": np.full((100, 100), -0.5)})
    result = decode(clean + rng.normal(0, 3, clean.shape), sequence, noise=noise)
    assert np.mean(result.mask) < 0.01


def test_masks():
    sequence = PatternSequence.parse("white+1,10@4", (400, 300))
    frames = photograph(sequence, {"u": np.full((1, 8), 200.0)})
    frames[1:, 0, 0] = 120 + (frames[1:, 0, 0] - 120) * 0.02  # modulation 2 < 3
    frames[4, 0, 1] = 255.0  # saturated, in a frame of the first set
    frames[0, 0, 2] = 255.0  # saturated in the white frame only, of which nothing is decoded
    frames[6, 0, 3] = np.nan
    frames[0, 0, 4] = np.inf
    frames[1:, 0, 5] = 120.0  # no fringes at all
    frames[1:5, 0, 6] = 120 + (frames[1:5, 0, 6] - 120) * 0.02  # the first set only
    result = decode(frames, sequence, saturation=255.0)
    good = [False, False, True, False, True, False, False, True]
    np.testing.assert_array_equal(result.mask, [good])
    np.testing.assert_array_equal(np.isnan(result.coordinate["u"]), ~result.mask)
    np.testing.assert_array_equal(np.isnan(result.sigma["u"]), ~result.mask)
    loose = decode(frames, sequence, min_modulation=0.0, min_snr=0.0)
    np.testing.assert_array_equal(loose.mask[0], [True, True, True, False, True, False, True, True])
    noisy = decode(frames, sequence, noise=NoiseModel(read_dn=40.0))  # 100 / 40 < 3
    assert not noisy.mask.any()


@pytest.mark.parametrize(("shifts", "min_snr"), [(3, 1.5), (4, 1.0), (3, 3.0)])
@pytest.mark.parametrize("contrast", [0.0, 0.5, 2.0])
def test_noise_passes_a_limit_with_the_stated_probability(shifts, min_snr, contrast):
    # 400,000 pixels of fringes that are weaker than noise of 5 DN: the ratio of modulation to
    # noise is Rice distributed.  A share of pixels is compared within four binomial deviations.
    sigma, count = 5.0, 400_000
    rng = np.random.default_rng(shifts)
    sequence = PatternSequence((64, 1), (Fringes(1, shifts),))
    frames = photograph(sequence, {"u": np.full((1, count), 31.0)}, b=contrast * sigma)
    frames += sigma * rng.standard_normal(frames.shape)
    noise = NoiseModel(read_dn=sigma, step_dn=0.0)
    found = decode(frames, sequence, noise=noise, min_modulation=0.0, min_snr=min_snr)
    seen = found.modulation >= min_snr * sigma  # the mask leaves out the panel's ends too
    np.testing.assert_array_less(found.mask, seen + 0.5)
    scale = np.sqrt(2.0 / shifts)  # of either component of the modulation, frames' deviations
    expected = stats.rice.sf(min_snr, contrast / scale, scale=scale)
    if contrast == 0.0:
        assert expected == pytest.approx(false_modulation_probability(min_snr, shifts), rel=1e-9)
    error = np.sqrt(expected * (1.0 - expected) / count)
    assert seen.mean() == pytest.approx(expected, abs=4.0 * error)


@pytest.mark.parametrize("shifts", [3, 4, 7])
@pytest.mark.parametrize("b", [0.0, 1.0, 10.0])
def test_the_bias_of_a_squared_modulation(shifts, b):
    # Shot noise, whose variance differs from frame to frame, of 2 DN a DN, and noise of 4 DN.
    rng = np.random.default_rng(7)
    exact = photograph(PatternSequence((64, 1), (Fringes(1, shifts),)), {"u": np.zeros(1)}, 50, b)
    frames = exact[:, :, None] + rng.standard_normal((shifts, 1, 300_000)) * np.sqrt(
        16.0 + 2.0 * exact[:, :, None]
    )
    square = np.square(relative_phase(frames)[1])
    bias = squared_modulation_bias(16.0 + 2.0 * 50.0, shifts)
    error = square.std() / np.sqrt(square.size)
    assert square.mean() - bias == pytest.approx(b**2, abs=4.0 * error)
    if b == 0.0:  # and of the modulation itself
        mean = relative_phase(frames)[1].mean()
        assert mean == pytest.approx(np.sqrt(np.pi * 116.0 / shifts), rel=0.004)


def test_saturation_defaults_to_the_top_of_integer_types():
    sequence = PatternSequence.parse("1,10@4", (400, 300))
    frames = np.rint(photograph(sequence, {"u": np.full((1, 2), 200.0)}))
    frames[0, 0, 0] = 255
    assert decode(frames.astype(np.uint8), sequence).mask.tolist() == [[False, True]]
    assert decode(frames.astype(np.uint16), sequence).mask.tolist() == [[True, True]]


def test_two_axes_share_one_mask():
    sequence = PatternSequence.parse("1,10@4", (400, 300), axes="uv")
    truth = {"u": np.full((2, 2), 150.0), "v": np.full((2, 2), 99.0)}
    frames = photograph(sequence, truth)
    frames[-1, 0, 0] = np.nan  # of axis v
    frames[0, 1, 1] = np.nan  # of axis u
    result = decode(frames, sequence)
    assert result.mask.tolist() == [[False, True], [True, False]]
    for axis in "uv":
        np.testing.assert_array_equal(np.isnan(result.coordinate[axis]), ~result.mask)


def test_strided_and_big_endian_frames():
    sequence = PatternSequence.parse("1,10@4", (400, 300))
    frames = photograph(sequence, {"u": np.linspace(5, 390, 60).reshape(6, 10)})
    expected = decode(frames, sequence).coordinate["u"]
    turned = np.ascontiguousarray(frames.transpose(1, 2, 0)).transpose(2, 0, 1)
    np.testing.assert_array_equal(decode(turned, sequence).coordinate["u"], expected)
    swapped = frames.astype(">f8")
    np.testing.assert_array_equal(decode(swapped, sequence).coordinate["u"], expected)


@pytest.mark.parametrize("text", ["1,6@4,30@5", "gray+30@5"])
def test_evidence_is_the_residual_of_every_fringe_order(text):
    sequence = PatternSequence.parse(text, (640, 480))
    rng = np.random.default_rng(6)
    truth = {"u": rng.uniform(30, 600, (20, 30))}
    clean = photograph(sequence, truth)
    frames = clean + rng.normal(0, 8, clean.shape)
    plain = decode(frames, sequence, keep_relative=True)
    found = decode(frames, sequence, keep_relative=True, keep_evidence=True)
    assert plain.evidence == {}
    np.testing.assert_array_equal(found.coordinate["u"], plain.coordinate["u"])
    phases = found.relative["u"]
    if text.startswith("gray"):
        column = np.rint(truth["u"])  # the noise turns no bit
        absolute, fringes, first = 2 * np.pi * (column + 0.5) / 640, 1, 0
        assert set(found.evidence) == {0, 1}
    else:
        (fringes, absolute), first = phases[0], 1
        ordered = {k for k, one in found.evidence.items() if "order_residual" in one}
        assert ordered == {1, 2}  # the first set is its own reference
    for part, (count, phase) in enumerate(phases[first:], start=1):
        order = (count / fringes * absolute - phase) / (2 * np.pi)
        residual = found.evidence[part]["order_residual"]
        # Double precision of an order up to 30.
        np.testing.assert_allclose(residual, order - np.rint(order), atol=1e-11)
        assert 0.001 < np.std(residual) < 0.2  # the noise is in it, and no order is lost
        absolute, fringes = unwrap(phase, count, absolute, fringes), count


def test_evidence_of_a_wrong_count_is_a_uniform_residual():
    shown = PatternSequence.parse("1,37@4", (640, 480))
    truth = {"u": np.linspace(5, 630, 4000).reshape(40, 100)}
    told = PatternSequence.parse("1,30@4", (640, 480))
    residual = decode(photograph(shown, truth), told, keep_evidence=True).evidence[1]
    # Seven fringes too many go through all residuals seven times: uniform, deviation 1/sqrt(12).
    assert np.std(residual["order_residual"]) == pytest.approx(1 / np.sqrt(12), rel=0.02)


@pytest.mark.parametrize("inverse", [True, False])
def test_evidence_of_a_gray_code_is_the_contrast_of_every_bit(inverse):
    sequence = PatternSequence((8, 5), (Flat(1.0), Flat(0.0), GrayCode("u", inverse)))
    frames = photograph(sequence, {"u": np.arange(8.0)[np.newaxis]})
    first = 2 + (2 if inverse else 1)
    frames[first, 0, 5] += 30.0  # the second bit of one pixel
    contrast = decode(frames, sequence, keep_evidence=True).evidence[2]["bit_contrast"]
    expected = np.full((3, 1, 8), 100.0)
    # Unlit in column 5 (Gray 111: lit) or lit: a frame 30 DN off changes half the difference to its
    # inverse by 15, that to the threshold by all of it.
    expected[1, 0, 5] += 15.0 if inverse else 30.0
    np.testing.assert_allclose(contrast, expected)


GOOD = PatternSequence.parse("1,10", (400, 300))


@pytest.mark.parametrize(
    "frames",
    [
        np.zeros((5, 4, 4)),
        np.zeros((6, 4)),
        np.zeros((6, 0, 4)),
        np.zeros((6, 4, 4), np.int32),
        np.zeros((6, 4, 4), complex),
        [[1, 2], [3, 4]],
    ],
)
def test_frames_that_do_not_fit(frames):
    with pytest.raises(InputError, match="decode: frames: expected") as caught:
        decode(frames, GOOD)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((Fringes(10),), "one fringe or a Gray code first"),
        ((Flat(1.0),), "fringes or a Gray code"),
        ((Flat(1.0), GrayCode(inverse=False)), "white and a black"),
    ],
)
def test_sequences_that_cannot_be_unwrapped(parts, message):
    sequence = PatternSequence((400, 300), parts)
    with pytest.raises(InputError, match=message):
        decode(np.zeros((sequence.n_frames, 4, 4)), sequence)


@pytest.mark.parametrize(
    "call",
    [
        lambda: decode(np.zeros((6, 4, 4)), GOOD, min_snr=-1),
        lambda: decode(np.zeros((6, 4, 4)), GOOD, saturation=np.nan),
        lambda: relative_phase(np.zeros((2, 4, 4))),
        lambda: unwrap([0.1], 0, [0.1], 1),
        lambda: order_error_probability(-1, 1, 1, 10),
        lambda: order_error_probability(1, 1, 0, 10),
    ],
)
def test_bad_parameters(call):
    with pytest.raises(InputError):
        call()
