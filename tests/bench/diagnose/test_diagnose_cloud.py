"""Clouds of a plane or a ball with errors that are put in, alone and together."""

import numpy as np
import pytest

from slbench.bench.diagnose.cloud import diagnose_cloud
from slbench.core.errors import InputError, InputWarning

NOISE = 0.010
#: Period of the fringes in the middle of the plane, mm, and how much wider they are at its ends.
FRINGE, BEND = 2.0, 0.004


def lattice(shape=(110, 130), spacing=0.4, seed=0):
    """Return places on a plane, (N, 2) mm, a little off a lattice as a camera's are."""
    rows, columns = np.indices(shape, np.float64)
    places = spacing * np.stack([columns, rows], axis=-1).reshape(-1, 2)
    jitter = np.random.default_rng(seed).uniform(-0.05, 0.05, places.shape)
    return places - places.mean(axis=0) + jitter


def fringes(places, turns=1.0):
    """Return a ripple of RMS one: fringes under perspective."""
    x = places[:, 0] / (1.0 + BEND * places[:, 0])
    return np.sqrt(2.0) * np.sin(2.0 * np.pi * turns * x / FRINGE + 0.7)


def on_a_plane(places, errors, seed=0):
    """Return points (N, 3) on a tilted plane, off along its normal."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    off = errors + rng.normal(0.0, NOISE, len(places))
    return np.column_stack([places, off]) @ axes.T + rng.normal(0.0, 50.0, 3)


def names(found):
    return [cause.name for cause in found.named]


def test_noise_alone_has_no_cause():
    places = lattice()
    sigma = np.full(len(places), NOISE)
    found = diagnose_cloud(on_a_plane(places, 0.0), {"sigma": sigma})
    assert names(found) == []
    # 3 %: of some 13,000 points noise is known to 0.6 %.
    assert found["noise"].rms_mm == pytest.approx(NOISE, rel=0.03)
    assert found.predicted_mm == pytest.approx(NOISE)
    assert "orders" not in [cause.name for cause in found.causes]


def test_a_ripple_has_its_period_and_its_size():
    places = lattice()
    found = diagnose_cloud(on_a_plane(places, 0.006 * fringes(places)))
    assert names(found) == ["ripple"]
    assert found["ripple"].rms_mm == pytest.approx(0.006, rel=0.05)
    assert found.share(found["ripple"]) == pytest.approx(36.0 / 136.0, rel=0.1)
    assert "period 2 mm" in found["ripple"].note.replace("1.999", "2").replace("2.001", "2")
    assert any("--fringe-mm" in note for note in found.notes)


@pytest.mark.parametrize(
    ("turns", "cause"), [(1, "unequal light"), (2, "vibration"), (3, "response"), (2.5, "ripple")]
)
def test_the_fringes_period_names_the_ripple(turns, cause):
    places = lattice(spacing=0.25)
    points = on_a_plane(places, 0.008 * fringes(places, turns))
    found = diagnose_cloud(points, fringe_mm=FRINGE, shifts=3)
    assert names(found) == [cause]
    assert found[cause].rms_mm == pytest.approx(0.008, rel=0.05)


def test_two_ripples_and_a_bowl_are_all_told():
    places = lattice(spacing=0.25)
    x = places[:, 0] / np.abs(places[:, 0]).max()
    bowl = x**2 - np.mean(x**2)
    bowl *= 0.012 / np.sqrt(np.mean(bowl**2))
    off = bowl + 0.009 * fringes(places, 2) + 0.006 * fringes(places, 3)
    found = diagnose_cloud(on_a_plane(places, off), fringe_mm=FRINGE, shifts=3)
    assert sorted(names(found)) == ["bowl", "response", "vibration"]
    # The rim, three points wide, is left out, where a bowl is largest.
    inner = np.zeros((110, 130), np.bool_)
    inner[3:-3, 3:-3] = True
    left = bowl[inner.ravel()].std()
    for cause, size in (("bowl", left), ("vibration", 0.009), ("response", 0.006)):
        assert found[cause].rms_mm == pytest.approx(size, rel=0.05)
    assert sum(found.share(c) for c in found.causes if not c.far) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("seed", range(4))
def test_streaks_are_correlated_and_no_ripple(seed):
    from scipy.ndimage import gaussian_filter

    places = lattice()
    rough = gaussian_filter(np.random.default_rng(seed).normal(size=(110, 130)), 2.5).ravel()
    found = diagnose_cloud(on_a_plane(places, 0.01 * rough / rough.std()))
    assert "correlated" in names(found)
    assert not any("ripple" in name for name in names(found))
    # Cells three apart hold points two to four apart, where a Gaussian of 2.5 has kept
    # exp(-16 / 25) to exp(-4 / 25) of its variance; the bowl takes up to a tenth.
    assert 0.9e-4 * np.exp(-16 / 25) < found["correlated"].mean_square_mm2 < 1e-4 * np.exp(-4 / 25)


def test_a_step_is_said_and_not_named_by_a_guess():
    places = lattice()
    off = np.where((np.abs(places) < 4.0).all(axis=1), 1.7, 0.0)
    found = diagnose_cloud(on_a_plane(places, off))
    assert names(found) == []
    assert "a step of 1.7 mm" in found["gross"].note.replace("-", "")


def test_a_ball_and_its_scale():
    rng = np.random.default_rng(4)
    places = lattice((120, 120), 0.15)
    height = np.sqrt(12.5**2 - np.sum(places**2, axis=1))
    outward = np.column_stack([places, height]) / 12.5
    points = outward * (12.503 + rng.normal(0.0, NOISE, len(places)))[:, None] + [5.0, 9.0, 700.0]
    found = diagnose_cloud(points, diameter_mm=25.0)
    assert names(found) == []
    assert abs(2.0 * found.shape.radius - 25.006) < 4.0 * found.diameter_deviation_mm
    # As many fits of other noise have that spread: see the statistics below.
    assert 0.0001 < found.diameter_deviation_mm < 0.003


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_another_surface_is_refused(share):
    places = lattice()
    off = np.where(places[:, 0] > np.quantile(places[:, 0], 1.0 - share), 2.5, 0.0)
    with pytest.raises(InputError, match="points of one plane"):
        diagnose_cloud(on_a_plane(places, off), shape="plane", where="block.ply")


def test_metres_are_questioned():
    places = lattice()
    points = on_a_plane(places, 0.0)
    with pytest.warns(InputWarning, match="in metres it would be"):
        diagnose_cloud(1e-3 * points)


def test_few_points_and_a_line_are_refused():
    with pytest.raises(InputError, match="500 points"):
        diagnose_cloud(np.zeros((499, 3)))
    with pytest.raises(InputError, match="do not determine"):
        diagnose_cloud(np.linspace(0.0, 1.0, 900)[:, None] * np.ones(3))


def test_points_that_cover_nothing_and_doubles_are_refused():
    places = lattice((30, 30))
    with pytest.raises(InputError, match="500 points at least"):
        diagnose_cloud(np.repeat(on_a_plane(places[:400], 0.0), 5, axis=0))
    far = np.vstack([places, [[1e6, 0.0], [0.0, 1e6]]])
    flat = np.column_stack([far, np.zeros(len(far))])
    with pytest.raises(InputError, match="points that cover a surface"):
        diagnose_cloud(flat)


def test_an_exact_plane_has_no_errors():
    places = lattice((30, 30))
    found = diagnose_cloud(np.column_stack([places, np.zeros(len(places))]))
    assert found.rms_mm < 1e-9
    assert names(found) == []
    assert "nan" not in str(found.table().texts())


@pytest.mark.statistics
def test_noise_is_rarely_given_a_cause():
    """Of 200 clouds of noise some tests find one by chance, each with its stated probability."""
    small: list[float] = []
    alarms = 0
    for seed in range(200):
        places = lattice((80, 90), seed=seed)
        found = diagnose_cloud(on_a_plane(places, 0.0, seed))
        alarms += bool(found.named)
        small += [cause.p for cause in found.causes if cause.name in ("bowl", "correlated")]
    # Three tests of 0.001 each: 0.6 clouds are expected, and more than 4 in 1 of 3000 trials.
    assert alarms <= 4
    # A probability of 0.05 is not rarer than said, with 4 deviations of a binomial of 400; what
    # is fitted takes some correlation of the rest, so that of neighbours is a little too large.
    share = np.mean(np.array(small) < 0.05)
    assert 0.01 < share < 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / 400)


@pytest.mark.statistics
def test_intervals_hold_the_share():
    """The 95 % interval of a ripple's share holds the true one about as often as it says."""
    held = []
    for seed in range(150):
        places = lattice((80, 90), seed=seed)
        found = diagnose_cloud(on_a_plane(places, 0.004 * fringes(places), seed))
        low, high = found.share_ci95(found["ripple"])
        held.append(low <= 0.004**2 / (0.004**2 + NOISE**2) <= high)
    # 150 trials: 95 % within 4 deviations is 88 % and more.
    assert np.mean(held) > 0.88
