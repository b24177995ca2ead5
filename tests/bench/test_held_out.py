"""A set held to fixed ones: it beats a worse one, and does not beat a better one."""

import pytest
from scenes_small import small, transport_of, truth_of

from slbench.bench.compare.held_out import HeldOut, fixed_sets, hold
from slbench.bench.compare.sets import PatternSet
from slbench.core.errors import InputError
from slbench.patterns import PatternSequence

PANEL = (640, 480)


@pytest.mark.parametrize("frames", [4, 6, 12])
def test_fixed_sets_have_as_many_frames(frames):
    given = fixed_sets(frames, PANEL)
    counts = {PatternSequence.parse(text, PANEL).n_frames for text in given}
    assert counts == {frames}
    assert len(given) >= 3


def held(own, others, places=None):
    transport = transport_of("step-block")
    if places is None:
        scene = small("step-block")
        places = [HeldOut("step-block", scene, (transport,), truth_of("step-block"))]
    sequence = PatternSequence.parse(own, transport.panel)
    return hold(PatternSet("mine", sequence), places, fixed=others, repeats=3)


def test_finer_fringes_beat_coarser_ones_and_not_the_other_way():
    finer = held("1,20@3", ["1,5@3", "1,8@3"])
    assert finer.best == "1,8@3"
    assert finer.beats
    # Noise falls with the count; modulation falls too.
    assert 0.3 < finer.ratio < 0.7
    assert "beats {1,8@3}" in finer.text()
    coarser = held("1,8@3", ["1,5@3", "1,20@3"])
    assert coarser.best == "1,20@3"
    assert not coarser.beats
    assert "does not beat {1,20@3}" in coarser.text()
    assert coarser.ratio == pytest.approx(1.0 / finer.ratio, rel=0.05)


def test_the_same_patterns_do_not_beat_themselves():
    assert not held("1,20@3", ["1,20@3"]).beats


def test_refusals():
    with pytest.raises(InputError, match="one or more"):
        held("1,20@3", ["1,8@3"], places=[])
