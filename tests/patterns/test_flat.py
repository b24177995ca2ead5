"""Words of flat frames, and the set by which hardware is characterised."""

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.patterns import Flat, PatternSequence

PANEL = (1280, 800)


def levels(text):
    return [part.level for part in PatternSequence.parse(text, PANEL).parts]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("white+grey0.25+black", [1.0, 0.25, 0.0]),
        ("grey.5", [0.5]),
        ("ramp3", [0.0, 0.5, 1.0]),
        ("ramp9", np.linspace(0.0, 1.0, 9).tolist()),
        ("ramp4+white+ramp3+ramp3", [*np.linspace(0, 1, 4).tolist(), 1.0, *[0.0, 0.5, 1.0] * 2]),
    ],
)
def test_words_are_levels_and_are_read_back(text, expected):
    assert levels(text) == expected
    name = PatternSequence.parse(text, PANEL).name
    assert levels(name) == expected
    if "." not in text:
        assert name == text


def test_any_level_is_read_back():
    for level in (1.0 / 3.0, 1e-5, 0.1 + 0.2, 254.0 / 255.0):
        assert levels(PatternSequence(PANEL, (Flat(level),)).name) == [level]


@pytest.mark.parametrize("word", ["ramp2", "ramp1000", "grey1.5", "grey"])
def test_other_words_are_refused(word):
    with pytest.raises(InputError, match=r"grey|ramp|level"):
        PatternSequence.parse(word, PANEL)


def test_the_characterisation_has_a_name():
    sequence = PatternSequence.parse(" characterisation ", PANEL)
    flats = [part.level for part in sequence.parts if isinstance(part, Flat)]
    assert len(flats) == 36
    assert len(set(flats)) == 9
    assert PatternSequence.parse(sequence.name, PANEL) == sequence
    sequence.runs()
    more = PatternSequence.parse("characterisation+grey0.1", PANEL)
    assert more.parts == (*sequence.parts, Flat(0.1))
    with pytest.raises(InputError, match="did you mean 'characterisation'"):
        PatternSequence.parse("characterization", PANEL)
