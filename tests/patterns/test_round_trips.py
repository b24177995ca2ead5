"""Random sequences of random codes survive every form in which they are written."""

import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from random_codes import PANEL, codes, sequences

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.patterns import PatternSequence, pattern_codes, read_patterns

#: Families that others of the tests add are not the package's.
KINDS = [kind for kind in pattern_codes if pattern_codes.origin(kind) == "slbench"]
#: Fields of fringes for which the short text has no word.
WORDLESS = ("direction", "phase_deg", "origin")
#: A picture takes a file.
FAST = settings(
    max_examples=10,
    deadline=None,
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow],
)


@pytest.mark.parametrize("kind", KINDS)
@FAST
@given(data=st.data())
def test_tables_and_files(kind, data):
    sequence = data.draw(sequences(kind))
    with TemporaryDirectory() as name:
        folder = Path(name)
        text = tomli_w.dumps(sequence.to_dict(folder))
        assert PatternSequence.from_dict(tomllib.loads(text), folder) == sequence
        for file, content in (("whole.toml", text), ("capture.toml", f"[patterns]\n{text}")):
            if file == "capture.toml":
                content = tomli_w.dumps({"frames": ["0.png"], "patterns": tomllib.loads(text)})
            (folder / file).write_text(content)
            found = read_patterns(file, PANEL, folder=folder)
            assert found.sequence == sequence
            assert found.name == file.removesuffix(".toml")
        assert read_patterns(str(folder), PANEL).sequence == sequence


@pytest.mark.parametrize("kind", KINDS)
@FAST
@given(data=st.data())
def test_captures(kind, data):
    sequence = data.draw(sequences(kind))
    assume(sequence.n_frames < 40)
    frames = np.full((sequence.n_frames, 2, 3), 100, np.uint8)
    with TemporaryDirectory() as name:
        Capture(frames, sequence).save(Path(name) / "capture")
        assert Capture.load(Path(name) / "capture").sequence == sequence
        assert read_patterns(Path(name) / "capture", PANEL).sequence == sequence


def text_of(code):
    """Return the short text of one code."""
    return type(code).write_run([code])


def is_read(code):
    """Whether the short text has words for what a code is."""
    try:
        return code.read_word(text_of(code), "u", 3) is not None
    except InputError:
        return False


def words_of(kind):
    """Whether a family has words that are read back."""
    return bool(pattern_codes.get(kind).words)


# The word of composite fringes has more carriers than this panel shows.
@pytest.mark.parametrize("kind", [k for k in KINDS if words_of(k) and k != "composite"])
@FAST
@given(data=st.data())
def test_short_text_of_what_was_read_is_read_again(kind, data):
    """What a word does not say is lost once, and nothing after."""
    drawn = [data.draw(codes(kind, WORDLESS).filter(is_read))]
    drawn += data.draw(st.lists(codes(without=WORDLESS).filter(is_read), max_size=2))
    words = [text_of(code) for code in drawn]
    way = data.draw(st.sampled_from(["", "+spatial", "+none", "+heterodyne", "+sequential"]))
    axes = data.draw(
        st.sampled_from(["u", "v"] if kind in ("flat", "m-array") else ["u", "v", "uv"])
    )
    try:
        sequence = PatternSequence.parse("+".join(words) + way, PANEL, axes=axes)
    except InputError:  # a word that is shown and not read, or codes that do not go together
        assume(False)
    # What codes no axis, or both, is shown once: no word says that it stands between others.
    assume(axes != "uv" or all(len(part.axes) == 1 for part in sequence.parts))
    again = PatternSequence.parse(sequence.name, PANEL, axes=axes)
    assert again == sequence
    assert again.name == sequence.name
    spaced = f" {sequence.name.replace('+', ' + ')} "
    found = read_patterns(spaced, PANEL, axes=axes)
    assert found.sequence == sequence
    assert found.name == sequence.name


def test_the_strategies_reach_options_of_every_family():
    """More than one value of every field, so that round trips say something."""
    for kind in KINDS:
        constant = [name for name, found in values_seen(kind).items() if len(found) < 2]
        assert constant in ([], ["files"]), (kind, constant)


def values_seen(kind):
    """Return what each field of a family was drawn as, in sixty draws."""
    seen = {name: set() for name in pattern_codes.get(kind).fields_of()}

    @settings(max_examples=60, deadline=None, database=None, derandomize=True)
    @given(code=codes(kind))
    def collect(code):
        for name, found in seen.items():
            found.add(repr(getattr(code, name)))

    collect()
    return seen
