"""A set decoded with the projector's response taken out is compared with the same set without."""

import numpy as np
import pytest
from scenes_small import small, transport_of, truth_of

from slbench.bench.compare.compare import compare
from slbench.bench.compare.sets import pattern_sets
from slbench.core.errors import InputError
from slbench.core.io import write_table
from slbench.simulate.floors import noise_free_coordinates

LIGHT = "plane"  # the projector's gamma is no part of it
TEXT = "gray+16@3"
PERIOD_PX = 640 / 16


@pytest.fixture(scope="module")
def scene():
    return small("gamma")


def harmonic_error_px(gamma, shifts):
    """Return the RMS error of a phase by least squares of sinusoids to the power of gamma, px."""
    phase = np.linspace(0.0, 2.0 * np.pi, 20_000, endpoint=False)
    steps = 2.0 * np.pi * np.arange(shifts) / shifts
    frames = (0.5 + 0.5 * np.cos(phase - steps[:, np.newaxis])) ** gamma
    error = np.angle((np.exp(1j * steps) @ frames) * np.exp(-1j * phase))
    return np.sqrt(np.mean(error**2)) * PERIOD_PX / (2.0 * np.pi)


def ripple_px(scene, given):
    truth = truth_of(LIGHT)
    coordinate = noise_free_coordinates(
        transport_of(LIGHT), given.sequence, scene.rig.projector, response=given.response
    )["u"]
    error = (coordinate - truth.panel[..., 0])[truth.smooth()]
    return np.sqrt(np.nanmean(error**2))


def test_three_shifts_lose_their_ripple(scene):
    plain, corrected = pattern_sets([TEXT, f"{TEXT} | gamma=2.2"], scene)
    expected = harmonic_error_px(2.2, 3)
    # The lens blurs a period of 40 px little, the second harmonic by four times as much: it takes
    # less than a tenth of the ripple, and by as much the correction is too large.
    assert ripple_px(scene, plain) == pytest.approx(expected, rel=0.1)
    assert ripple_px(scene, corrected) < 0.1 * expected


def test_both_are_sets_of_one_comparison(scene, tmp_path):
    values = np.linspace(0.0, 1.0, 256)
    write_table(
        tmp_path / "curve.csv", ("value", "radiance"), np.stack([values, values**2.2], axis=1)
    )
    sets = [TEXT, f"{TEXT} | gamma=2.2", f"{TEXT}|response=curve.csv"]
    found = compare(
        scene, pattern_sets(sets, scene, folder=tmp_path), repeats=4,
        transports=(transport_of(LIGHT),), truth=truth_of(LIGHT),
    )  # fmt: skip
    plain, gamma, curve = found.sets
    assert [one.name for one in found.sets] == [
        TEXT,
        f"{TEXT}|gamma=2.2",
        f"{TEXT}|response=curve.csv",
    ]
    # With noise of 0.03 mm a point: 0.6 mm of ripple, 0.06 mm without it.
    assert gamma.error_median_mm < 0.15 * plain.error_median_mm
    assert curve.error_median_mm == pytest.approx(gamma.error_median_mm, rel=0.05)
    # The noise is near its bound, which is that of the frames as the projector shows them.
    assert 0.9 < gamma.bound_share < 1.05


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gray+16@3 | gama=2.2", "gamma"),
        ("gray+16@3 | gamma=-1", "a number > 0"),
        ("gray+16@3 | gamma=two", "a number > 0"),
        ("gray+16@3 | response=none.csv", "none.csv"),
        ("gray+modulated8@3 | gamma=2.2", "modulated"),
        ("gray+16@3 | gamma=9", "two phases look alike"),
    ],
)
def test_what_cannot_be_taken_out_is_refused_before_light_is_traced(scene, text, said, tmp_path):
    with pytest.raises(InputError, match=said) as refused:
        pattern_sets([text], scene, folder=tmp_path)
    assert str(refused.value).startswith("set ")
