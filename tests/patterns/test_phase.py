"""Spatial unwrapping: against the surface that was wrapped, and NumPy's along a line.

Every neighbouring pair of the surfaces here differs by less than half a fringe, so what is
unwrapped is the surface itself but for one multiple of 2 pi a region.  Only that multiple,
added and taken away again, is rounded: 1e-9 rad is far above it and far below a fringe.
"""

import numpy as np
import pytest
from scipy.ndimage import label

from slbench.core.errors import InputError
from slbench.patterns import unwrap_spatially

TURN = 2.0 * np.pi
ROUNDING = 1e-9

V, U = np.mgrid[0:60, 0:90].astype(float)
SURFACES = {
    "ramp": 0.9 * U - 0.4 * V + 0.3,  # 13 fringes along u, 4 against v
    "dome": 60.0 * np.exp(-((U - 50.0) ** 2 + (V - 25.0) ** 2) / 800.0),  # 10 fringes high
    "saddle": 0.02 * ((U - 40.0) ** 2 - (V - 30.0) ** 2) + 0.1 * V,
}


def wrapped(surface):
    """The relative phase in [0, 2 pi), as the decoder gives it."""
    return np.mod(surface, TURN)


def check_same_but_for_turns(found, surface):
    """One multiple of 2 pi for all pixels, and nothing else."""
    turns = (found - surface) / TURN
    assert np.ptp(turns) < ROUNDING
    assert turns.flat[0] == pytest.approx(np.rint(turns.flat[0]), abs=ROUNDING)


@pytest.mark.parametrize("name", SURFACES)
def test_a_smooth_surface_comes_back_but_for_one_multiple_of_2_pi(name):
    surface = SURFACES[name]
    assert np.abs(np.diff(surface, axis=0)).max() < np.pi  # what makes it unambiguous
    assert np.abs(np.diff(surface, axis=1)).max() < np.pi
    assert np.ptp(surface) > 5 * TURN  # many wraps
    phase = wrapped(surface)
    before = phase.copy()
    found = unwrap_spatially(phase)
    check_same_but_for_turns(found, surface)
    np.testing.assert_array_equal(phase, before)  # the argument stays as it was


@pytest.mark.parametrize("name", SURFACES)
def test_every_line_is_numpys_but_for_one_multiple_of_2_pi(name):
    phase = wrapped(SURFACES[name])
    found = unwrap_spatially(phase)
    for ours, relative in ((found[17], phase[17]), (found[:, 41], phase[:, 41])):
        check_same_but_for_turns(ours, np.unwrap(relative))


def test_the_unwrapped_phase_wraps_to_the_given_one_whatever_it_is():
    # Noise of more than a fringe: no surface comes back, but no pixel's phase may change, and
    # the same input gives the same output.
    phase = wrapped(np.random.default_rng(1).normal(scale=5.0, size=(40, 50)))
    found = unwrap_spatially(phase)
    turns = (found - phase) / TURN
    np.testing.assert_allclose(turns, np.rint(turns), rtol=0, atol=ROUNDING)
    for _ in range(100):  # whatever other arrays have left in memory
        junk = [np.full(1000 * k, 255, np.uint8) for k in range(1, 20)]
        del junk
        np.testing.assert_array_equal(unwrap_spatially(phase), found)


def test_outside_the_mask_is_nan_and_does_not_matter():
    surface = SURFACES["dome"]
    mask = (U - 45.0) ** 2 + (V - 30.0) ** 2 < 25.0**2
    mask &= (U - 45.0) ** 2 + (V - 30.0) ** 2 > 6.0**2  # a hole, too
    phase = wrapped(surface)
    found = unwrap_spatially(phase, mask)
    np.testing.assert_array_equal(np.isfinite(found), mask)
    assert np.isnan(found[~mask]).all()
    check_same_but_for_turns(found[mask], surface[mask])
    noise = np.random.default_rng(2).uniform(0.0, TURN, phase.shape)
    np.testing.assert_array_equal(unwrap_spatially(np.where(mask, phase, noise), mask), found)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_pixels_without_a_phase_are_left_out_by_themselves(bad):
    surface = SURFACES["ramp"]
    hidden = np.random.default_rng(3).random(surface.shape) < 0.3
    found = unwrap_spatially(np.where(hidden, bad, wrapped(surface)))
    np.testing.assert_array_equal(np.isnan(found), hidden)
    # Here and there they enclose a pixel or two, by edges: regions of their own.
    regions, count = label(~hidden)
    assert count > 1
    for region in range(1, count + 1):
        check_same_but_for_turns(found[regions == region], surface[regions == region])
    # A mask that names them as valid does not make them so.
    given = unwrap_spatially(np.where(hidden, bad, wrapped(surface)), np.ones_like(hidden))
    np.testing.assert_array_equal(given, found)


def test_each_island_has_a_multiple_of_2_pi_of_its_own():
    # Four islands, far apart in height: nothing between them says by how many fringes.
    surface = SURFACES["dome"] + 40.0 * TURN * (U > 30.0) - 20.0 * TURN * (V > 40.0)
    mask = (np.abs(U - 30.5) > 2.0) & (np.abs(V - 40.5) > 2.0)
    found = unwrap_spatially(wrapped(surface), mask)
    for right in (False, True):
        for below in (False, True):
            island = mask & ((U > 30.0) == right) & ((V > 40.0) == below)
            check_same_but_for_turns(found[island], surface[island])
    # What the baseline cannot know: over the islands together it is no single multiple.
    assert np.ptp((found - surface)[mask]) > TURN


@pytest.mark.parametrize(("step", "seen"), [(0.4, 0.4), (0.6, -0.4), (1.25, 0.25)])
def test_a_step_of_more_than_half_a_fringe_is_taken_for_a_smaller_one(step, seen):
    surface = 0.1 * U + 0.05 * V + TURN * step * (U >= 45)
    found = unwrap_spatially(wrapped(surface))
    across = found[:, 45] - found[:, 44] - 0.1
    np.testing.assert_allclose(across, TURN * seen, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("phase", "mask", "message"),
    [
        (np.zeros(5), None, r"phase: expected real .*, got \(5,\) float64"),
        (np.zeros((3, 4, 5)), None, r"phase: expected real .*, got \(3, 4, 5\) float64"),
        (np.zeros((0, 4)), None, r"phase: expected real .*, got \(0, 4\) float64"),
        (1.0, None, r"phase: expected real .*, got \(\) float64"),
        (np.zeros((1, 9)), None, r"phase: expected .* 2 x 2 or more, got \(1, 9\) float64"),
        (np.zeros((3, 4), complex), None, "phase: expected real .* complex128"),
        ([[1.0], [1.0, 2.0]], None, r"phase: expected .*, got \(0,\) float64"),
        (np.zeros((3, 4)), np.ones((4, 3)), r"mask: expected shape \(3, 4\), got \(4, 3\)"),
        (np.zeros((3, 4)), np.ones(4), r"mask: expected shape \(3, 4\), got \(4,\)"),
        (np.zeros((3, 4)), np.zeros((3, 4)), "mask: expected at least one valid pixel, got none"),
        (np.full((3, 4), np.nan), None, "mask: expected at least one valid pixel, got none"),
    ],
)
def test_refuses_what_is_no_phase_map_in_one_line(phase, mask, message):
    with pytest.raises(InputError, match=f"^unwrap_spatially: {message}$") as error:
        unwrap_spatially(phase, mask)
    assert "\n" not in str(error.value)
