"""Pattern sequences: values of the patterns, the short text, files, bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench.core.errors import InputError
from slbench.patterns import Flat, Fringes, GrayCode, PatternSequence, panel_response

PANEL = (96, 60)


def test_fringes_are_those_of_the_equation():
    for shifts in (3, 4, 7):
        part = Fringes(5, shifts)
        for k in range(shifts):
            expected = [
                0.5 + 0.5 * np.cos(2 * np.pi * 5 * (u + 0.5) / 96 - 2 * np.pi * k / shifts)
                for u in range(96)
            ]
            # The same formula in double precision: rounding only.
            np.testing.assert_allclose(part.profile(k, 96), expected, atol=1e-13)


@pytest.mark.parametrize("size", [2, 3, 60, 96, 128, 1000])
def test_gray_code_neighbours_differ_in_one_bit_and_codes_are_unique(size):
    code = GrayCode(inverse=False)
    bits = np.array([code.profile(k, size) for k in range(code.n_frames((size, 5)))])
    assert len(bits) == int(np.ceil(np.log2(size)))
    assert len(np.unique(bits, axis=1).T) == size
    np.testing.assert_array_equal(np.abs(np.diff(bits, axis=1)).sum(axis=0), 1)


def test_gray_code_inverses_follow_their_bits():
    with_inverse, plain = GrayCode("v"), GrayCode("v", inverse=False)
    for k in range(plain.n_frames(PANEL)):
        np.testing.assert_array_equal(with_inverse.profile(2 * k, 60), plain.profile(k, 60))
        np.testing.assert_array_equal(with_inverse.profile(2 * k + 1, 60), 1 - plain.profile(k, 60))


def test_images_profiles_and_frames_tell_the_same_story():
    parts = (Flat(1.0), Fringes(4, 3, "v"), GrayCode("u"), Fringes(2, 4, "u"))
    sequence = PatternSequence(PANEL, parts)
    images = sequence.images()
    assert images.shape == (1 + 3 + 14 + 4, 60, 96) == (sequence.n_frames, *PANEL[::-1])
    assert sequence.axes == ("v", "u")
    assert sequence.fringe_counts("u") == (2,)
    assert sequence.fringe_counts("v") == (4,)
    seen = []
    for axis in sequence.axes:
        indices, values = sequence.profiles(axis)
        seen += indices.tolist()
        for k, row in zip(indices, values, strict=True):
            image = np.tile(row, (60, 1)) if axis == "u" else np.tile(row[:, None], (1, 96))
            np.testing.assert_array_equal(images[k], image)
            np.testing.assert_array_equal(sequence.image(int(k)), image)
    assert sorted(seen) == list(range(sequence.n_frames))
    # Flat frames come with the first coded axis, here v.
    assert 0 in sequence.frames_along("v")
    assert [f.along for f in sequence.frames()] == [None] + ["v"] * 3 + ["u"] * 18
    assert [f.index for f in sequence.frames()][:5] == [0, 0, 1, 2, 0]


def test_what_others_ask_of_the_parts():
    parts = (Flat(0.5), Fringes(8, 4, "v"), Flat(1.0), GrayCode("u"), Fringes(2), Fringes(8))
    sequence = PatternSequence(PANEL, parts)
    assert sequence.lit_frame == 5
    assert PatternSequence(PANEL, parts[:2]).lit_frame is None
    assert [placed.index for placed in sequence.fringe_sets()] == [1, 4, 5]
    assert [placed.index for placed in sequence.fringe_sets("u")] == [4, 5]
    assert sequence.fringe_sets("u")[0].frames == range(20, 23)
    # The last of equals, and along one axis where that is asked for.
    assert sequence.finest().code == Fringes(8)
    assert sequence.finest("v").code == Fringes(8, 4, "v")
    assert PatternSequence(PANEL, parts[2:4]).finest() is None
    assert Fringes(8, 4, "v").extended(3) == Fringes(8, 7, "v")
    assert GrayCode().extended(3) is None


def test_profiles_of_an_axis_without_frames_are_empty():
    indices, values = PatternSequence.parse("1,4", PANEL).profiles("v")
    assert indices.shape == (0,)
    assert values.shape == (0, 60)
    only_flat = PatternSequence(PANEL, (Flat(0.5),))
    assert only_flat.axes == ()
    assert only_flat.profiles("u")[1].shape == (1, 96)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("1,10", (Fringes(1, 3), Fringes(10, 3))),
        ("1,10@4", (Fringes(1, 4), Fringes(10, 4))),
        ("1@3,10@8", (Fringes(1, 3), Fringes(10, 8))),
        ("gray", (GrayCode("u"),)),
        ("white+gray+16@8", (Flat(1.0), GrayCode("u"), Fringes(16, 8))),
    ],
)
def test_short_text(text, parts):
    sequence = PatternSequence.parse(text, PANEL)
    assert sequence.parts == parts
    assert PatternSequence.parse(sequence.name, PANEL) == sequence


@pytest.mark.parametrize("way", ["sequential", "heterodyne", "number-theoretic", "spatial", "none"])
def test_short_text_forces_a_way(way):
    sequence = PatternSequence.parse(f"8, 9@4 + {way}", PANEL, axes="uv")
    assert sequence.unwrap == way
    assert sequence.name == f"8,9@4+{way}"
    assert PatternSequence.parse(sequence.name, PANEL, axes="uv") == sequence


def test_a_way_alone_shows_nothing():
    with pytest.raises(InputError, match="spatial"):
        PatternSequence.parse("spatial", PANEL)


def test_short_text_codes_each_axis_in_turn():
    sequence = PatternSequence.parse("black+1,5", PANEL, shifts=5, axes="uv")
    assert sequence.parts == (
        Flat(0.0),
        Fringes(1, 5, "u"),
        Fringes(5, 5, "u"),
        Fringes(1, 5, "v"),
        Fringes(5, 5, "v"),
    )
    assert sequence.name == "black+1,5@5"


fringes = st.builds(Fringes, st.integers(1, 20), st.integers(3, 16), st.sampled_from("uv"))
flats = st.builds(Flat, st.floats(0, 1))


@settings(max_examples=60, deadline=None)
@given(parts=st.lists(fringes | flats, min_size=1, max_size=6), gray=st.booleans())
def test_dict_round_trip(parts, gray):
    sequence = PatternSequence(PANEL, tuple([GrayCode("v", False)] * gray + parts))
    assert PatternSequence.from_dict(sequence.to_dict()) == sequence


@settings(max_examples=60, deadline=None)
@given(sets=st.lists(st.tuples(st.integers(1, 20), st.integers(3, 16)), min_size=1, max_size=5))
def test_name_round_trip(sets):
    sequence = PatternSequence(PANEL, tuple(Fringes(n, shifts) for n, shifts in sets))
    assert PatternSequence.parse(sequence.name, PANEL) == sequence


@pytest.mark.parametrize("axes", ["u", "v", "uv", "vu"])
@pytest.mark.parametrize(
    "text",
    ["1,10@4+m-array16px+50@4", "gray+m-array16px+16@4", "white+1,10+black", "m-array16px"],
)
def test_names_of_sets_on_two_axes_are_read_back(text, axes):
    """What codes both axes, or none, is shown once, with the first axis."""
    sequence = PatternSequence.parse(text, (640, 480), axes=axes)
    assert sequence.name == text
    assert PatternSequence.parse(sequence.name, (640, 480), axes=axes) == sequence


@pytest.mark.parametrize(
    ("data", "where"),
    [
        ([], "patterns"),
        ({"panel": [96, 60]}, "patterns.parts"),
        ({"panel": [96, 0], "parts": [{"kind": "gray"}]}, "panel"),
        ({"panel": [96.5, 60], "parts": [{"kind": "gray"}]}, "panel"),
        ({"panel": 96, "parts": [{"kind": "gray"}]}, "panel"),
        ({"panel": [96, 60], "parts": []}, "parts"),
        ({"panel": [96, 60], "parts": [{"kind": "stripes"}]}, "parts[0].kind"),
        ({"panel": [96, 60], "parts": [{"kind": "fringes"}]}, "parts[0].count"),
        ({"panel": [96, 60], "parts": [{"kind": "fringes", "count": 0}]}, "parts[0].count"),
        ({"panel": [96, 60], "parts": [{"kind": "fringes", "count": 33}]}, "parts[0].count"),
        (
            {"panel": [96, 60], "parts": [{"kind": "fringes", "count": 1, "shifts": 2}]},
            "parts[0].shifts",
        ),
        ({"panel": [96, 60], "parts": [{"kind": "gray", "axis": "w"}]}, "parts[0].axis"),
        ({"panel": [96, 60], "parts": [{"kind": "gray", "bits": 3}]}, "parts[0]"),
        ({"panel": [96, 60], "parts": [{"kind": "gray", "inverse": 1}]}, "parts[0].inverse"),
        ({"panel": [96, 60], "parts": [{"kind": "flat", "level": 1.5}]}, "parts[0].level"),
        ({"panel": [96, 60], "parts": [{"kind": "flat", "level": float("nan")}]}, "level"),
        ({"panel": [96, 60], "parts": [{"kind": "gray"}, {"kind": "gray"}]}, "parts[1]"),
        ({"panel": [1, 60], "parts": [{"kind": "gray"}]}, "parts[0]"),
        ({"panel": [96, 60], "parts": ["gray"]}, "parts[0]"),
    ],
)
def test_bad_tables_name_the_key(data, where):
    with pytest.raises(InputError) as caught:
        PatternSequence.from_dict(data)
    assert where in caught.value.where
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "1,", "ten", "1,10@", "1;10", "gray+", "1,-4", "0", "1,99"])
def test_bad_short_text(text):
    with pytest.raises(InputError):
        PatternSequence.parse(text, PANEL)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("1 10 50", "1,10,50"),
        ("1 , 4 16", "1,4,16"),
        ("1\t10", "1,10"),
        ("gray 16@8", "gray+16@8"),
        ("1 8@4 heterodyne", "1,8@4+heterodyne"),
    ],
)
def test_spaces_between_words_are_refused_with_what_is_meant(text, shown):
    with pytest.raises(InputError, match="spaces between them") as caught:
        PatternSequence.parse(text, (640, 480))
    assert caught.value.expected.startswith(f'"{shown}"')
    PatternSequence.parse(shown, (640, 480))


def test_spaces_beside_signs_and_units_are_none():
    spaced = PatternSequence.parse(" gray + 4 , 8 @ 4 + 22.5 px@0 / 90 /180 ", PANEL)
    assert spaced == PatternSequence.parse("gray+4,8@4+22.5px@0/90/180", PANEL)


@pytest.mark.parametrize("axes", ["", "w", "uu"])
def test_bad_axes(axes):
    with pytest.raises(InputError, match="axes"):
        PatternSequence.parse("1", PANEL, axes=axes)


def test_frame_index_outside_the_sequence():
    with pytest.raises(InputError, match=r"0\.\.2"):
        PatternSequence.parse("1", PANEL).image(3)


def test_panel_response_quantises_then_applies_gamma():
    values = np.linspace(0, 1, 1001)
    response = panel_response(values, 8, 2.2)
    levels = np.unique(response)
    # Exactly the 256 levels, each raised to gamma; rounding of the power only.
    np.testing.assert_allclose(levels, (np.arange(256) / 255) ** 2.2, rtol=1e-13)
    assert np.abs(panel_response(values, 8) - values).max() <= 0.5 / 255 + 1e-15
    np.testing.assert_array_equal(panel_response(values), values)


@pytest.mark.parametrize(
    ("values", "bits", "gamma"),
    [
        ([1.1], 8, 1),
        ([np.nan], 8, 1),
        ([0.5], 0, 1),
        ([0.5], 17, 1),
        ([0.5], 8, 0),
        ([0.5], 8.0, 1),
    ],
)
def test_panel_response_bad_input(values, bits, gamma):
    with pytest.raises(InputError, match=r"^(panel_response: values|bit_depth|gamma): "):
        panel_response(values, bits, gamma)
