"""Selective fusion against planes whose sharp image and depth are known, and a plain version."""

import tracemalloc

import numba
import numpy as np
import pytest
import reference_fusion
from focus_stacks import psnr_db, slanted_plane

from slbench.capture.fusion import maximum_weights, pyramid_selection, selective_weights
from slbench.core.errors import InputError

INNER = np.s_[8:-8, 8:-8]  # windows reach past the border elsewhere
NOISE = (0.0, 0.01, 0.02, 0.05, 0.1)  # standard deviation, of full scale
METHODS = {
    "saf": selective_weights,
    "published": lambda stack: selective_weights(stack, variant="published"),
    "maximum": maximum_weights,
    "pyramid": pyramid_selection,
}


@pytest.fixture(scope="module")
def plane():
    return slanted_plane()


@pytest.fixture(scope="module")
def clean(plane):
    return plane.stack()


def noisy(stack, sigma, seed=1):
    return stack + sigma * np.random.default_rng(seed).standard_normal(stack.shape)


@pytest.fixture(scope="module")
def table(plane, clean):
    """PSNR, dB, by noise and method.

    "best" is the frame of least true blur at every pixel: what the best selection of one
    frame could give that knows the depth but not the noise.  (The frame whose value happens
    to be nearest to the truth would need to know the noise.)
    """
    truth = plane.sharp()
    rows = {}
    for sigma in NOISE:
        stack = noisy(clean, sigma)
        rows[sigma] = {"best": psnr_db(plane.select(stack, plane.nearest()), truth)}
        for name, method in METHODS.items():
            rows[sigma][name] = psnr_db(method(stack).fuse(stack), truth)
    print("\nnoise " + "".join(f"{name:>11}" for name in rows[0.0]))
    for sigma, row in rows.items():
        print(f"{sigma:5.2f} " + "".join(f"{value:11.2f}" for value in row.values()))
    return rows


class TestAgainstTruth:
    @pytest.mark.parametrize("sigma", NOISE)
    def test_within_3_db_of_the_best_selection(self, table, sigma):
        assert table[sigma]["saf"] > table[sigma]["best"] - 3.0

    def test_clean_frames_cost_averaging_a_little(self, table):
        # Neighbours of the peak weigh in, blurred: the price of robustness, 1 dB here.
        assert -1.5 < table[0.0]["saf"] - table[0.0]["maximum"] < 0.0

    @pytest.mark.parametrize("sigma", [0.02, 0.05, 0.1])
    @pytest.mark.parametrize("baseline", ["maximum", "pyramid"])
    def test_noisy_frames_gain(self, table, sigma, baseline):
        # The noise in 152 x 176 pixels leaves a PSNR with a spread of some 0.04 dB.
        assert table[sigma]["saf"] > table[sigma][baseline]

    def test_the_gain_grows_with_the_noise(self, table):
        gain = [table[sigma]["saf"] - table[sigma]["maximum"] for sigma in NOISE]
        assert gain[-1] > 1.0
        assert np.all(np.diff(gain) > 0)

    def test_focus_is_the_depth(self, plane, clean):
        """Corrected, the position is good to a fraction of a frame; published, it snaps.

        A uniform error of +/- half a frame has an RMS of 0.289.
        """
        rms = {}
        for variant in ("corrected", "published"):
            focus = selective_weights(clean, variant=variant).focus[INNER]
            assert np.isfinite(focus).all()
            rms[variant] = np.sqrt(np.mean((focus - plane.depth[8:-8]) ** 2))
        # What is left comes from the texture, whose contrast within a window varies along
        # with the depth: it moves either variant.
        assert rms["corrected"] < 0.15
        assert rms["published"] == pytest.approx(0.289, abs=0.02)

    def test_a_fitted_gaussian_is_selective(self, clean):
        corrected = selective_weights(clean).selectivity_db[INNER]
        published = selective_weights(clean, variant="published").selectivity_db[INNER]
        assert np.median(corrected) > np.median(published) + 2.0

    def test_published_snaps_to_samples(self, clean):
        focus = selective_weights(clean, variant="published").focus
        focus = focus[np.isfinite(focus)]
        np.testing.assert_allclose(focus, np.rint(focus), atol=1e-9)
        assert focus.min() >= 2
        assert focus.max() <= len(clean) - 3  # at the ends: to the third sample


class TestExactGaussians:
    """Focus curves that are Gaussians: contrast, in a chequered image, as their square root."""

    x = np.array([0.0, 0.7, 1.9, 3.0, 4.2, 5.0, 6.3])
    chequers = np.indices((24, 24)).sum(axis=0) % 2 - 0.5

    def curve(self, place, width=1.5):
        contrast = np.exp(-((self.x - place) ** 2) / (4 * width**2))
        return 0.5 + contrast[:, None, None] * self.chequers

    @pytest.mark.parametrize("place", [0.3, 0.7, 2.5, 3.0, 5.2, 6.1])
    def test_the_place_is_exact_at_uneven_positions(self, place):
        weights = selective_weights(self.curve(place), positions=self.x)
        # Float32 holds the measure to 1e-6 or so, and the curve's slope is of order one.
        np.testing.assert_allclose(weights.focus[6:-6, 6:-6], place, atol=1e-4)
        assert weights.selectivity_db.min() > 90

    def test_places_beyond_the_stack_are_unknown(self):
        for place in (-1.0, 7.5):
            weights = selective_weights(self.curve(place), positions=self.x)
            assert np.isnan(weights.focus).all()
            sharpest = 0 if place < 0 else len(self.x) - 1
            assert np.all(weights.weights.argmax(axis=0) == sharpest)

    def test_order_of_frames_does_not_matter(self):
        stack, rng = noisy(self.curve(2.5), 0.01), np.random.default_rng(3)
        given = selective_weights(stack, positions=self.x)
        order = rng.permutation(len(self.x))
        shuffled = selective_weights(stack[order], positions=self.x[order])
        np.testing.assert_array_equal(shuffled.weights, given.weights[order])
        np.testing.assert_array_equal(shuffled.focus, given.focus)
        np.testing.assert_array_equal(shuffled.selectivity_db, given.selectivity_db)
        # Sums run in another order.
        np.testing.assert_allclose(
            shuffled.fuse(stack[order]), given.fuse(stack), rtol=1e-13, atol=1e-13
        )


class TestAgainstPlainNumpy:
    @pytest.mark.parametrize("measure", ["variance", "gradient", "laplacian"])
    def test_weights_focus_and_selectivity(self, clean, measure):
        stack = noisy(clean, 0.03)[:, :70, :90]
        found = selective_weights(stack, measure=measure)
        weights, place, selectivity = reference_fusion.selective(stack, name=measure)
        # Half a step of the weights' 65535, and float32 in the focus measure: 1e-6 of it,
        # times the slope of the weights, at most 5 / 2.
        np.testing.assert_allclose(found.weights / 65535, 2 * weights, atol=4e-5)
        np.testing.assert_allclose(found.selectivity_db, selectivity, atol=2e-3)
        np.testing.assert_allclose(found.focus, place, atol=1e-2)
        fused = reference_fusion.fuse(weights, stack)
        np.testing.assert_allclose(found.fuse(stack), fused, atol=2e-5)

    def test_unit_and_type_do_not_matter(self, clean):
        dn = np.rint(65535 * clean[:, :40, :50]).astype(np.uint16)
        integers = selective_weights(dn)
        for stack in (dn / 65535.0, (dn / 65535.0).astype(np.float32), list(dn)):
            other = selective_weights(stack)
            assert np.abs(other.weights.astype(int) - integers.weights).max() <= 4
            np.testing.assert_allclose(other.focus, integers.focus, atol=1e-3)
        fused = integers.fuse(dn)
        assert fused.dtype == np.float64
        np.testing.assert_allclose(fused / 65535, integers.fuse(dn / 65535.0), atol=1e-12)


class TestOtherStacks:
    def test_fringes_keep_their_phase(self, plane, clean):
        """Four-step fringes on the plane, blurred with it, fused by the lit stack's weights."""
        weights = selective_weights(clean)
        frequency, shifts = 1 / 12, 4
        fused = []
        for k in range(shifts):
            fringe = np.array([[0.0, frequency, -2 * np.pi * k / shifts, 0.4]])
            fused.append(weights.fuse(plane.stack(texture=fringe)))
        sine = fused[1] - fused[3]
        cosine = fused[0] - fused[2]
        truth = 2 * np.pi * frequency * np.arange(plane.shape[1])
        error = np.angle(np.exp(1j * (np.arctan2(sine, cosine) - truth)))
        # One set of weights for all shifts: the phase is exact but for rounding.
        np.testing.assert_allclose(error, 0.0, atol=1e-12)
        # Contrast: all of it but 5 %; a frame from the middle has lost nearly all at the ends.
        contrast = 0.5 * np.hypot(sine, cosine)[INNER] / 0.4
        assert contrast.min() > 0.95
        assert np.exp(-2 * np.pi**2 * frequency**2 * plane.blur(7)[8] ** 2) < 0.5

    def test_noise_gain_is_the_noise_of_other_stacks(self, clean):
        """200 repeats of a pixel: a relative spread of its standard deviation of 5 %.

        The mean over 1000 pixels is good to 0.16 %; 1 % is six of those.  A single pixel is
        out by five of its own spreads once in two million.
        """
        weights = selective_weights(noisy(clean, 0.1)[:, :25, :40])
        rng = np.random.default_rng(5)
        shape = weights.weights.shape
        repeats = np.array([weights.fuse(rng.standard_normal(shape)) for _ in range(200)])
        ratio = repeats.std(axis=0, ddof=1) / weights.noise_gain
        assert ratio.mean() == pytest.approx(1.0, abs=0.01)
        assert np.abs(ratio - 1).max() < 0.25
        assert np.median(weights.noise_gain) < 0.8  # so there is something to measure

    def test_noise_gain_at_its_limits(self, clean):
        flat = selective_weights(np.full((7, 20, 20), 0.5))
        np.testing.assert_allclose(flat.noise_gain, 1 / np.sqrt(7))
        np.testing.assert_array_equal(maximum_weights(clean).noise_gain, 1.0)

    def test_channels_are_fused_alike(self, clean):
        grey = clean[:, :30, :40]
        weights = selective_weights(grey)
        colour = np.stack([grey, 1 - grey, 0.5 * grey**2], axis=3)
        fused = weights.fuse(colour)
        assert fused.shape == (30, 40, 3)
        for c in range(3):
            np.testing.assert_array_equal(fused[..., c], weights.fuse(colour[..., c]))


class TestGuards:
    def test_flat_pixels_are_averaged(self):
        # Exactly flat, at different levels: rounding must not make a focus curve.
        levels = np.random.default_rng(0).uniform(0, 1, 9)
        weights = selective_weights(np.broadcast_to(levels[:, None, None], (9, 16, 18)))
        assert np.isnan(weights.focus).all()
        assert np.all(weights.weights == 65535)
        np.testing.assert_allclose(weights.selectivity_db, 0.0, atol=1e-4)
        stack = np.broadcast_to(levels[:, None, None], (9, 16, 18))
        np.testing.assert_allclose(weights.fuse(stack), levels.mean(), rtol=1e-12)

    def test_equal_frames_have_no_peak(self, clean):
        stack = np.repeat(clean[7:8], 8, axis=0)
        weights = selective_weights(stack)
        assert np.isnan(weights.focus).all()
        np.testing.assert_allclose(weights.selectivity_db, 0.0, atol=1e-4)
        np.testing.assert_allclose(weights.fuse(stack), clean[7], rtol=1e-12)

    def test_a_log_convex_curve_counts_without_gaussian(self):
        """F = 1, 1/4, 1/9, ...: no maximum to fit, so e is the mean of F over its peak."""
        f = 1.0 / np.arange(1, 9) ** 2
        chequers = np.indices((20, 20)).sum(axis=0) % 2 - 0.5
        weights = selective_weights(0.5 + np.sqrt(f)[:, None, None] * chequers)
        assert np.isnan(weights.focus).all()
        expected = 20 * np.log10(1 / f.mean())
        np.testing.assert_allclose(weights.selectivity_db[6:-6, 6:-6], expected, atol=1e-2)

    @pytest.mark.parametrize("count", [1, 2, 3, 4])
    def test_few_frames(self, clean, count):
        stack = clean[5 : 5 + count, :40]
        weights = selective_weights(stack)
        assert np.isnan(weights.selectivity_db).all()
        assert np.isfinite(weights.focus).any() == (count >= 3)
        # phi = 1 / alpha: the frame out of focus by far has nearly no part.
        least = (1 + np.tanh(5 * -1)) * 65535
        assert weights.weights.min() >= np.floor(least)
        assert np.all(weights.weights.max(axis=0) == 65535)
        if count == 1:
            np.testing.assert_array_equal(weights.fuse(stack), stack[0])
            np.testing.assert_array_equal(maximum_weights(stack).fuse(stack), stack[0])

    def test_dark_frames_between(self, clean):
        stack = clean[:, :40].copy()
        stack[3] = 0.0
        weights = selective_weights(stack)
        assert np.isfinite(weights.fuse(stack)).all()
        assert np.isfinite(weights.selectivity_db).all()

    @pytest.mark.parametrize(
        ("options", "word"),
        [
            ({"window": 8}, "window"),
            ({"window": 1}, "window"),
            ({"measure": "entropy"}, "measure"),
            ({"variant": "other"}, "variant"),
            ({"alpha": 0.0}, "alpha"),
            ({"alpha": np.nan}, "alpha"),
            ({"threshold_db": np.inf}, "threshold"),
            ({"positions": [1, 2]}, "positions"),
            ({"positions": [0, 1, 2, 3, 4, 4]}, "positions"),
            ({"positions": [0, 1, 2, 3, 4, np.nan]}, "positions"),
            ({"positions": "abcdef"}, "positions"),
        ],
    )
    def test_bad_parameters(self, clean, options, word):
        with pytest.raises(InputError, match=word):
            selective_weights(clean[:6, :20, :20], **options)

    def test_bad_stacks(self, clean):
        stack = clean[:6, :20, :20]
        broken = stack.copy()
        broken[4, 3, 3] = np.nan
        for bad, word in [
            (broken, "frame 4: expected finite"),
            ([], "at least one"),
            ([*stack[:2], stack[0, :10]], "frame 2: expected shape"),
            (np.zeros((3, 0, 4)), "image"),
            (stack[:, :, :, None], "image"),
            (["a", "b"], "image"),
            (stack * 1e200, "float32"),
        ]:
            with pytest.raises(InputError, match=word):
                selective_weights(bad)
        with pytest.raises(InputError, match="at least 5"):
            selective_weights(stack[:4], variant="published")
        weights = selective_weights(stack)
        for bad, word in [
            (broken, "finite"),
            (stack[:5], "6 frames"),
            (stack[:, :10], "shape"),
        ]:
            with pytest.raises(InputError, match=word):
                weights.fuse(bad)


class TestBytes:
    def test_bands_of_rows_give_the_same_bytes(self, clean):
        """Rows with their surroundings: measure, mean error (4 pixels each, twice), median."""
        stack, halo = noisy(clean, 0.02).astype(np.float32), 3 * 4 + 1
        whole = selective_weights(stack)
        for first, last in [(20, 50), (50, 51), (51, 120)]:
            band = selective_weights(stack[:, first - halo : last + halo])
            rows = np.s_[halo : halo + last - first]
            np.testing.assert_array_equal(band.weights[:, rows], whole.weights[:, first:last])
            np.testing.assert_array_equal(band.focus[rows], whole.focus[first:last])
            np.testing.assert_array_equal(
                band.selectivity_db[rows], whole.selectivity_db[first:last]
            )

    def test_threads_do_not_matter(self, clean):
        stack = noisy(clean, 0.02)
        several = selective_weights(stack)
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        try:
            one = selective_weights(stack)
            fused = one.fuse(stack)
        finally:
            numba.set_num_threads(threads)
        np.testing.assert_array_equal(one.weights, several.weights)
        np.testing.assert_array_equal(fused, several.fuse(stack))


class Drawn:
    """A stack that draws its frames when they are asked for, as a folder reads them."""

    def __init__(self, count, side):
        self.count, self.side = count, side

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        rng = np.random.default_rng(index)
        return rng.integers(0, 256, (self.side, self.side), dtype=np.uint8)


def peak_memory(count, side):
    selective_weights(Drawn(5, 16)).fuse(Drawn(5, 16))  # compiled code is not counted
    tracemalloc.start()
    try:
        weights = selective_weights(Drawn(count, side))
        weights.fuse(Drawn(count, side))
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_is_six_bytes_a_sample_and_some_images():
    """Float32 measures and uint16 weights, besides a dozen float64 images."""
    side = 512
    samples, image = 30 * side**2, 8 * side**2
    peak = peak_memory(30, side)
    assert peak < 6 * samples + 12 * image


@pytest.mark.slow
def test_memory_of_thirty_large_frames_is_about_a_gibibyte():
    peak = peak_memory(30, 2048)
    print(f"\n30 frames of 2048 x 2048: {peak / 2**20:.0f} MiB")
    assert peak < 1.2 * 2**30
