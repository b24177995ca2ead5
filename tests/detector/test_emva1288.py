"""The detector returns the parameters that were put in, as EMVA 1288 would measure them."""

import numpy as np
import pytest
from scipy import stats

from slbench.core.errors import InputError
from slbench.core.philox import normal
from slbench.detector.emva1288 import (
    _ROUNDING_VARIANCE,
    EXPANSION_READ_NOISE_E,
    EXPANSION_VARIANCE_E2,
    Detector,
    _quantile,
)
from slbench.patterns import PatternSequence, decode

SHAPE = (128, 128)
N_PIXELS = SHAPE[0] * SHAPE[1]
STREAMS = ("pcg64", "philox4x32")


def temporal(detector, level, exposure_s, rng, n=2):
    """Mean and temporal variance of `n` frames at one light level, DN and DN^2."""
    frames = detector.expose(np.full((n, *SHAPE), level), exposure_s, rng).astype(float)
    return frames.mean(), frames.var(axis=0, ddof=1).mean()


@pytest.mark.parametrize("stream", STREAMS)
def test_photon_transfer_curve_returns_the_parameters(stream):
    detector = Detector(
        bit_depth=12,
        full_well_e=20_000,
        read_noise_e=10,
        quantum_efficiency=0.6,
        dsnu_e=3,
        noise_stream=stream,
    )
    rng = np.random.default_rng(10)
    levels = np.linspace(0, 0.8, 30) * 20_000 / 0.6
    mean, variance = np.array([temporal(detector, x, 0.0, rng, n=8) for x in levels]).T
    variance -= 1 / 12  # quantisation, EMVA 1288 eq. 19
    dark_mean, _ = temporal(detector, 0.0, 0.0, rng, n=8)
    slope, _ = np.polyfit(mean - dark_mean, variance, 1, w=1 / variance)
    # Standard errors: each variance 0.4 % (8 frames x 16,384 pixels), the slope of 30 of
    # them 0.1 %, the read noise 0.3 %; 3 % is ten times that or more.
    assert 1 / slope == pytest.approx(detector.e_per_dn, rel=0.03)
    assert np.sqrt(variance[0]) / slope == pytest.approx(10, rel=0.03)
    responsivity, _ = np.polyfit(levels, mean, 1)
    assert responsivity / slope == pytest.approx(0.6, rel=0.03)
    # Saturation: where the mean stops growing and the variance vanishes.
    top, top_variance = temporal(detector, 2 * 20_000 / 0.6, 0.0, rng)
    assert top_variance == 0.0
    assert (top - dark_mean) / slope == pytest.approx(20_000, rel=0.03)


def test_fixed_pattern_and_dark_current():
    detector = Detector(
        bit_depth=14, prnu=0.01, dsnu_e=20, read_noise_e=5, dark_current_e_per_s=200
    )
    rng = np.random.default_rng(11)
    n = 64
    dark = detector.expose(np.zeros((n, *SHAPE)), 0.1, rng).mean(axis=0)
    lit = detector.expose(np.full((n, *SHAPE), 20_000.0), 0.1, rng).mean(axis=0)
    e = detector.e_per_dn
    # Standard errors: a standard deviation over 16,384 pixels 0.6 %; temporal noise left in
    # the mean of 64 frames adds under 1 % (dark: 0.8 e on 20 e; lit: 12.5 e on 100 e).
    assert np.std(dark) * e == pytest.approx(20, rel=0.03)
    assert np.std(lit - dark) * e / 10_000 == pytest.approx(0.01, rel=0.03)
    # 20 e of dark current at 0.1 s, 0.16 e of it a standard error from the DSNU's own mean.
    zero = detector.expose(np.zeros((n, *SHAPE)), 0.0, rng).mean(axis=0)
    assert (dark - zero).mean() * e == pytest.approx(20, rel=0.03)


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_rounding_leaves_no_bias(bit_depth):
    # Read noise of about half a DN makes the rounding error uniform: the bias left is
    # exp(-2 pi^2 sigma^2) / pi < 0.003 DN at 0.5 DN (Widrow).
    detector = Detector(bit_depth=bit_depth, read_noise_e=32, prnu=0, dsnu_e=0)
    rng = np.random.default_rng(bit_depth)
    for level in (37.0, 500.0, 9_001.0, 22_222.0):
        photons = np.full((16, *SHAPE), level)
        frames = detector.expose(photons, 0.02, rng).astype(float)
        expected = detector.expected_dn(photons, 0.02)
        # Four standard errors, false-alarm rate 6e-5 a level, plus the bias bound.
        bound = 4 * frames.std() / np.sqrt(frames.size) + 0.003
        assert abs(frames.mean() - expected.mean()) < bound


@pytest.mark.parametrize("stream", STREAMS)
def test_noise_model_predicts_the_temporal_variance(stream):
    detector = Detector(bit_depth=10, prnu=0.01, noise_stream=stream)
    rng = np.random.default_rng(12)
    for level in (0.0, 3_000.0, 24_000.0):
        mean, variance = temporal(detector, level, 5.0, rng, n=32)
        # A variance from 31 x 16,384 numbers scatters by 0.2 %; Sheppard's 1/12 is good to
        # 1 % where noise is about 1 DN.
        assert variance == pytest.approx(detector.noise_model().variance(mean), rel=0.02)


@pytest.mark.parametrize(
    ("mean", "read_e"),
    [
        (EXPANSION_VARIANCE_E2 - 1.0, EXPANSION_READ_NOISE_E),
        (137.7, EXPANSION_READ_NOISE_E),
        (60.0, 6.5),
        (0.5, 10.0),
        (30.0, 12.0),
        (2_000.0, 2.3),
    ],
)
def test_shot_and_read_noise_in_one_draw(mean, read_e):
    # Deterministic: the expansion's quantiles at normal z, against the exact distribution,
    # a Poisson mixture of normal ones.
    z = np.linspace(-5, 5, 2001, dtype=np.float32)
    charge = np.empty_like(z)
    _quantile(np.full_like(z, mean), np.float32(read_e**2), z, charge)
    counts = np.arange(int(mean + 12 * np.sqrt(mean) + 30))
    given_count = stats.norm.cdf((charge[:, None].astype(float) - counts) / read_e)
    exact = given_count @ stats.poisson.pmf(counts, mean)
    # 2.5e-6 where both limits meet; single precision adds 2e-5 electrons of 2,000: 4e-7.
    assert np.abs(stats.norm.cdf(z.astype(float)) - exact).max() < 3e-6


@pytest.mark.parametrize("mean", [EXPANSION_VARIANCE_E2, 137.7, 2_000.0])
def test_whole_electrons_are_poisson(mean):
    # Deterministic: the expansion rounded, at normal z, against the exact distribution.
    z = np.linspace(-5, 5, 400_001)
    charge = np.empty(z.size, np.float32)
    added = np.float32(-_ROUNDING_VARIANCE)
    _quantile(np.full_like(charge, mean), added, z.astype(np.float32), charge)
    counts = np.rint(charge)
    steps = np.flatnonzero(np.diff(counts) > 0)
    error = stats.norm.cdf(z[steps]) - stats.poisson.cdf(counts[steps], mean)
    # 8e-6 at a mean of 100, falling as mean^-3/2; the grid of z adds up to 1e-5.
    assert np.abs(error).max() < 2e-5


@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize(("read_e", "means"), [(5, (70.0, 80.0)), (0.3, (95.0, 105.0))])
def test_expanded_and_exact_noise_agree(read_e, means, stream):
    # Pixels on either side of the limit, in one frame.
    detector = Detector(
        bit_depth=16,
        full_well_e=60_000,
        read_noise_e=read_e,
        prnu=0,
        dsnu_e=0,
        offset_dn=100,
        gain_e_per_dn=0.05,
        quantum_efficiency=1.0,
        noise_stream=stream,
    )
    photons = np.full((8, *SHAPE), means[0])
    photons[..., ::2] = means[1]
    frames = 0.05 * (detector.expose(photons, 0.0, np.random.default_rng(14)) - 100.0)
    for mean, part in zip(means, (frames[..., 1::2], frames[..., ::2]), strict=True):
        sigma = np.sqrt(mean + read_e**2)
        scaled = (part.ravel() - mean) / sigma
        n = scaled.size
        # Four standard errors of mean, variance and skewness (mean / sigma^3): false-alarm
        # rate 6e-5 each.
        assert abs(scaled.mean()) < 4 / np.sqrt(n)
        assert abs(scaled.var() - 1) < 4 * np.sqrt(2.02 / n)
        assert abs(stats.skew(scaled) - mean / sigma**3) < 4 * np.sqrt(6 / n)


@pytest.mark.parametrize("read_e", [0.0, 12.0])
@pytest.mark.parametrize("photons", [1e30, 1e39, 1e300])
def test_any_light_saturates(photons, read_e):
    detector = Detector(read_noise_e=read_e, gain_e_per_dn=50.0)
    frames = detector.expose(np.full(SHAPE, photons), 0.0, np.random.default_rng(0))
    # DSNU and noise are clipped with the well: 16,000 / 50 is beyond the top of 8 bit.
    assert frames.min() == 255


def test_any_kind_of_number_is_exposed_alike():
    photons = np.round(np.random.default_rng(3).uniform(0, 30_000, (2, 30, 40)))
    wanted = Detector().expose(photons, 0.01, np.random.default_rng(4))
    for kind in (np.float32, np.uint16, np.int64, ">f4", ">f8", ">u2", np.longdouble):
        found = Detector().expose(photons.astype(kind), 0.01, np.random.default_rng(4))
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("full_well_e", [1500.0, 3000.0, 12_000.0, 16_000.0, 18_500.0])
def test_a_full_well_that_meets_the_top_saturates_there(full_well_e):
    assert Detector(full_well_e=full_well_e).saturation_dn == 255


@pytest.mark.parametrize("full_well_e", [1e12, 1e15])
def test_a_saturated_pixel_reads_the_top_whatever_its_offset(full_well_e):
    """The largest of wells, and offsets of a hundredth of them: three times the light fills all."""
    detector = Detector(bit_depth=16, full_well_e=full_well_e, dsnu_e=0.01 * full_well_e)
    photons = np.full((1, 20, 20), 3.0 * full_well_e / detector.quantum_efficiency)
    frames = detector.expose(photons, 0.0, np.random.default_rng(0))
    assert detector.fixed_pattern((20, 20))[1].min() < 0.0
    assert (frames == detector.saturation_dn).all()


def test_scale_turns_radiance_into_photons():
    radiance = np.random.default_rng(15).uniform(0, 3, (2, 60, 80))
    for noise in (True, False):
        wanted, scaled = (
            Detector().expose(light, 0.01, np.random.default_rng(16), noise, scale)
            for light, scale in ((radiance * 1e4, 1.0), (radiance, 1e4))
        )
        # The order of multiplication may move a value across a rounding step.
        assert np.mean(wanted != scaled) < 1e-3
        assert np.abs(wanted.astype(int) - scaled).max() <= 1


@pytest.mark.parametrize("scale", [1e-3, 1e16, 1e20])
def test_a_radiance_may_be_small_beside_its_photons(scale):
    # A watt is 2.8e18 photons of 550 nm a second; ten seconds of a dim panel are beyond 1e15.
    radiance = np.full((1, 20, 30), 1e4 / scale)
    exposed = Detector().expose(radiance, 0.01, noise=False, scale=scale)
    assert np.array_equal(exposed, Detector().expose(radiance * scale, 0.01, noise=False))
    assert 0 < exposed.min() < Detector().saturation_dn


def test_few_electrons_are_exactly_poisson():
    detector = Detector(
        bit_depth=16,
        full_well_e=60_000,
        read_noise_e=0,
        prnu=0,
        dsnu_e=0,
        offset_dn=0,
        gain_e_per_dn=1.0,
        quantum_efficiency=1.0,
    )
    frames = detector.expose(np.full((8, *SHAPE), 3.0), 0.0, np.random.default_rng(13))
    observed = np.bincount(np.minimum(frames.ravel(), 10), minlength=11)
    share = stats.poisson.pmf(np.arange(11), 3.0)
    share[10] = stats.poisson.sf(9, 3.0)
    # Chi-squared at a false-alarm rate of 1e-4.
    assert stats.chisquare(observed, share * frames.size).pvalue > 1e-4


def numbers_of(stream, child, size):
    """Normal numbers that a frame is made with, as the documentation has them."""
    if stream == "pcg64":
        return child.standard_normal(size)
    return normal(child.integers(0, 1 << 32, 2, dtype=np.uint32), size)


@pytest.mark.parametrize("stream", STREAMS)
def test_a_stream_stays_as_it_is(stream):
    """Frames of a seed are the first order of the expansion of the named numbers, spawned a frame.

    With 10^4 e the second order is some 1e-2 e, a thousandth of a DN: rounding differs in one
    of a hundred at most, by one DN.
    """
    detector = Detector(bit_depth=12, prnu=0, dsnu_e=0, quantum_efficiency=1.0, noise_stream=stream)
    mean = 10_000.0
    frames = detector.expose(np.full((2, *SHAPE), mean), 0.0, np.random.default_rng(23))
    for frame, child in zip(frames, np.random.default_rng(23).spawn(2), strict=True):
        z = numbers_of(stream, child, N_PIXELS).reshape(SHAPE)
        variance = mean + detector.read_noise_e**2
        electrons = mean + np.sqrt(variance) * z + mean / variance * (z**2 - 1) / 6
        wanted = np.rint(detector.black_dn + electrons / detector.e_per_dn)
        assert np.abs(frame - wanted).max() <= 1
        assert np.mean(frame != wanted) < 0.01


def test_the_default_stream_is_numpys():
    photons = np.full((1, 60, 80), 9_000.0)
    given, named = (
        detector.expose(photons, 0.0, np.random.default_rng(5)).tobytes()
        for detector in (Detector(), Detector(noise_stream="pcg64"))
    )
    assert given == named
    other = Detector(noise_stream="philox4x32").expose(photons, 0.0, np.random.default_rng(5))
    assert other.tobytes() != given


@pytest.mark.parametrize("stream", STREAMS)
def test_frames_and_pixels_have_noise_of_their_own(stream):
    """Correlations within five standard errors (6e-7 each)."""
    detector = Detector(bit_depth=16, prnu=0, dsnu_e=0, noise_stream=stream)
    frames = detector.expose(np.full((4, *SHAPE), 9_000.0), 0.0, np.random.default_rng(3))
    noise = (frames - frames.mean()) / frames.std()
    flat = noise.reshape(4, -1)
    for one in range(4):
        for two in range(one):
            assert abs(np.mean(flat[one] * flat[two])) < 5 / np.sqrt(N_PIXELS)
    for lag in (1, 2, SHAPE[1], 256, 512, 1024):
        assert abs(np.mean(flat[:, lag:] * flat[:, :-lag])) < 5 / np.sqrt(4 * (N_PIXELS - lag))


@pytest.mark.parametrize("stream", STREAMS)
def test_same_seed_same_bytes(stream):
    detector = Detector(noise_stream=stream)
    photons = np.random.default_rng(0).uniform(0, 30_000, (5, 60, 80))

    def shoot(seed):
        return detector.expose(photons, 0.01, np.random.default_rng(seed))

    assert shoot(1).tobytes() == shoot(1).tobytes()
    assert shoot(1).tobytes() != shoot(2).tobytes()
    rng = np.random.default_rng(1)
    first, second = detector.expose(photons, 0.01, rng), detector.expose(photons, 0.01, rng)
    assert first.tobytes() != second.tobytes()
    assert (shoot(1)[0] != shoot(1)[1]).any()


def test_fixed_pattern_is_the_detectors_own():
    def pattern(seed, rng_seed):
        detector = Detector(bit_depth=16, dsnu_e=50, read_noise_e=1, seed=seed)
        return detector.expose(np.zeros(SHAPE), 0.0, np.random.default_rng(rng_seed)).ravel()

    assert np.corrcoef(pattern(0, 1), pattern(0, 2))[0, 1] > 0.9
    # Independent patterns: the correlation of 16,384 pairs scatters by 0.008; six sigma.
    assert abs(np.corrcoef(pattern(0, 1), pattern(1, 1))[0, 1]) < 0.05


def test_without_noise_the_expectation_is_rounded_once():
    detector = Detector(bit_depth=8, prnu=0.1, dsnu_e=100)
    photons = np.linspace(0, 60_000, 5_000).reshape(50, 100)
    frame = detector.expose(photons, 0.01, noise=False)
    assert frame.dtype == np.uint8
    np.testing.assert_array_equal(frame, np.rint(detector.expected_dn(photons, 0.01)))
    assert frame.min() == 2  # black level
    assert frame.max() == 255
    assert Detector(bit_depth=12).expose(photons, 0.01, noise=False).dtype == np.uint16
    assert Detector(bit_depth=12).expose(photons, 0.01, noise=False).max() == 4095


def test_shapes_and_types():
    detector = Detector()
    rng = np.random.default_rng(0)
    for shape in ((4, 6), (1, 4, 6), (2, 3, 4, 6)):
        assert detector.expose(np.ones(shape), 0.0, rng).shape == shape
    photons = np.linspace(0, 30_000, 24).reshape(4, 6)
    same = [np.asfortranarray(photons), photons.astype(np.float32).astype(float), photons]
    frames = [detector.expose(p, 0.0, np.random.default_rng(5)) for p in same]
    np.testing.assert_array_equal(frames[0], frames[2])


def test_photons_from_irradiance():
    # EMVA 1288 eq. 3: 5.034e24 photons a joule and metre of wavelength.
    photons = Detector().photons([[1e-9]], 0.01, 25e-6)
    assert photons[0, 0] == pytest.approx(5.034e24 * 550e-9 * 1e-9 * 0.01 * 25e-6, rel=1e-4)


def test_auto_exposure_brings_the_percentile_to_the_level():
    detector = Detector()
    white = np.random.default_rng(3).gamma(4.0, 100.0, (200, 200))
    white[:50] = 0.0  # shadow does not count
    scale = detector.exposure_scale(white, 0.7, 95.0)
    electrons = scale * white[50:] * detector.quantum_efficiency
    assert np.percentile(electrons, 95) == pytest.approx(0.7 * detector.full_well_e)


def test_predicted_deviation_covers_decoded_detector_frames():
    """The whole chain: 95 % of coordinates lie within 1.96 predicted deviations."""
    detector = Detector(bit_depth=10, prnu=0.0, dsnu_e=0.0)
    sequence = PatternSequence.parse("1,20", (800, 600))
    _, profiles = sequence.profiles("u")
    columns = np.arange(20, 780)
    photons = np.repeat(profiles[:, np.newaxis, columns], 100, axis=1) * 20_000 + 2_000
    frames = detector.expose(photons, 0.01, np.random.default_rng(6))
    result = decode(frames, sequence, noise=detector.noise_model())
    assert result.mask.all()
    z = (result.coordinate["u"] - columns) / result.sigma["u"]
    # 76,000 pixels: the share scatters by 0.0008, its bound is 4 sigma (6e-5) plus 0.002 for
    # sigma's own noise; 3 % on the deviation is 12 sigma.
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.005)
    assert np.std(z) == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize(
    "call",
    [
        lambda d, r: d.expose(np.zeros(5), 0.0, r),
        lambda d, r: d.expose(np.zeros((0, 5)), 0.0, r),
        lambda d, r: d.expose(np.full((2, 2), np.nan), 0.0, r),
        lambda d, r: d.expose(np.full((2, 2), -1.0), 0.0, r),
        lambda d, r: d.expose(np.full((2, 2), np.inf), 0.0, r),
        lambda d, r: d.expose(np.full((2, 2), np.nan), 0.0, noise=False),
        lambda d, r: d.expose(np.zeros((2, 2)), -1.0, r),
        lambda d, r: d.expose(np.zeros((2, 2)), 0.0, None),
        lambda d, r: d.expose(np.zeros((2, 2), complex), 0.0, r),
        lambda d, r: d.photons([-1.0], 0.1, 1e-5),
        lambda d, r: d.photons([1.0], 0.1, 0),
        lambda d, r: d.exposure_scale(np.zeros((2, 2))),
        lambda d, r: d.exposure_scale(np.ones((2, 2)), level=1.5),
        lambda d, r: d.exposure_scale(np.ones((2, 2)), percentile=0),
    ],
)
def test_bad_input(call):
    with pytest.raises(InputError):
        call(Detector(), np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(20))
def test_exposure_is_limited_by_full_well_and_converter(seed):
    """Whichever is less: the white picture reaches the level, and nearly nothing saturates."""
    rng = np.random.default_rng(seed)
    bits = int(rng.choice([8, 10, 12, 14, 16]))
    detector = Detector(
        bit_depth=bits,
        full_well_e=rng.uniform(5e3, 5e4),
        gain_e_per_dn=rng.uniform(5e3, 5e4) / 2**bits,
        dark_current_e_per_s=0.0,
    )
    counted = (detector.top_dn - detector.black_dn) * detector.e_per_dn
    assert detector.saturation_e == pytest.approx(min(detector.full_well_e, counted))
    light = rng.uniform(0.5, 1.0, (80, 80))
    scale = detector.exposure_scale(light, 0.8)
    frames = detector.expose(light, 0.0, np.random.default_rng(1), scale=scale)
    level = (np.percentile(frames, 99) - detector.black_dn) * detector.e_per_dn
    # Noise of 5e3 e is 1.5 %, and lifts the percentile.
    assert level == pytest.approx(0.8 * detector.saturation_e, rel=0.06)
    assert np.mean(frames >= detector.saturation_dn) < 0.01
