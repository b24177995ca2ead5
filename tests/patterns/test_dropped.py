"""By which rule a pixel has no coordinate: each rule planted by hand in frames that are right."""

import numpy as np
import pytest

from slbench.patterns import NoiseModel, PatternSequence, Rule, decode

PANEL = (96, 8)
SIZE = PANEL[0]


def shot(text, unwrap="auto", level=200.0):
    """Frames of a camera that sees the panel one to one, uint8, and their sequence."""
    parsed = PatternSequence.parse(text, PANEL, 4)
    sequence = PatternSequence(PANEL, parsed.parts, unwrap)
    return np.rint(20.0 + level * sequence.images()).astype(np.uint8), sequence


def rules(frames, sequence, **options):
    found = decode(frames, sequence, keep_evidence=True, **options)
    assert np.array_equal(found.dropped == Rule.KEPT, found.mask)
    return found.dropped


@pytest.mark.parametrize("text", ["1,8", "gray+8", "gray", "8,9", "7,8,9"])
def test_rules_of_light(text):
    """A saturated pixel, one that is dark, and one whose number is missing."""
    unwrap = "heterodyne" if text == "8,9" else "auto"
    frames, sequence = shot(text, unwrap)
    frames[:, 2, 30] = 255
    frames[:, 3, 40] = 20
    dropped = rules(frames, sequence)
    assert dropped[2, 30] == Rule.SATURATED
    assert dropped[3, 40] == Rule.MODULATION
    floating = frames.astype(np.float32)
    floating[-1, 4, 50] = np.nan
    if text != "gray":  # a bit may be missing at an edge
        assert rules(floating, sequence, saturation=255.0)[4, 50] == Rule.SATURATED


def test_a_wrong_order_is_the_order_s_fault():
    frames, sequence = shot("1,8")
    frames[4:, 2, 30] = frames[4:, 2, 36]  # half a fringe further
    assert rules(frames, sequence)[2, 30] == Rule.ORDER
    assert np.count_nonzero(rules(frames, sequence, max_order_residual=0.5) == Rule.ORDER) == 0


def test_ends_of_the_panel_are_told():
    """Fringes alone code a circle: within three deviations of an end nothing is known."""
    frames, sequence = shot("1,8")
    dropped = rules(frames, sequence, noise=NoiseModel(read_dn=20.0), min_snr=0.0)
    assert np.all(dropped[:, 0] == Rule.END)
    assert np.all(dropped[:, -1] == Rule.END)
    assert np.all(dropped[:, 30:60] == Rule.KEPT)


def test_an_undecided_bit():
    """The first bit has no contrast where its cell is not at its edge."""
    frames, sequence = shot("gray")
    frames[0:2, 2, 30] = 120
    assert rules(frames, sequence)[2, 30] == Rule.BIT
    frames, sequence = shot("gray+8")
    frames[0:2, 2, 30] = 120
    dropped = rules(frames, sequence)
    assert dropped[2, 30] in (Rule.KEPT, Rule.BIT)  # fringes may judge the place for themselves


def test_relative_phases_are_no_fault():
    frames, sequence = shot("8", "none")
    frames[:, 2, 30] = 20
    dropped = decode(frames, sequence, keep_evidence=True).dropped
    assert dropped[2, 30] == Rule.MODULATION
    assert np.count_nonzero(dropped == Rule.RELATIVE) == dropped.size - 1


def test_the_first_rule_of_both_axes_holds():
    parsed = PatternSequence.parse("1,4", (96, 96), 4, "uv")
    frames = np.rint(20.0 + 200.0 * parsed.images()).astype(np.uint8)
    frames[8:, 20, 30] = 20  # only along v
    frames[12:, 40, 30] = frames[12:, 52, 30]
    dropped = rules(frames, parsed)
    assert dropped[20, 30] == Rule.MODULATION
    assert dropped[40, 30] == Rule.ORDER


def test_nothing_is_kept_that_is_not_asked_for():
    frames, sequence = shot("1,8")
    assert decode(frames, sequence).dropped is None
