"""Every key of a fringe set: what it shows, how it is written and read, what is decoded."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from photographed import fringe_phase, photograph

from slbench.core.errors import InputError
from slbench.patterns import (
    Flat,
    Fringes,
    GrayCode,
    NoiseModel,
    PatternSequence,
    decode,
    relative_phase,
)

PANEL = (96, 60)
ROUNDLESS = NoiseModel(step_dn=0.0)


@st.composite
def fringe_sets(draw, least=1.0, most=9.0, axes="uv"):
    """Any set that a panel of 96 x 60 px can show."""
    given_ = {"axis": draw(st.sampled_from(axes))}
    size = PANEL["uv".index(given_["axis"])]
    count = draw(st.integers(int(least), int(most)) | st.floats(least, most))
    if draw(st.booleans()):
        given_["count"] = count
    else:
        given_["period_px"] = size / count
    if draw(st.booleans()):
        given_["shifts"] = draw(st.integers(3, 12))
    else:
        # At least three phases that are well apart, then any others.
        first = draw(st.floats(-720, 720))
        rest = draw(st.lists(st.floats(-720, 720), max_size=5))
        given_["shifts_deg"] = [first, first + 90, first + draw(st.floats(150, 250)), *rest]
    given_["direction"] = draw(st.sampled_from([1, -1]))
    given_["phase_deg"] = draw(st.sampled_from([0.0, -90.0]) | st.floats(-400, 400))
    given_["origin"] = draw(st.sampled_from(["edge", "centre"]))
    return Fringes.from_table(given_, None)


@settings(max_examples=60, deadline=None)
@given(code=fringe_sets())
def test_profiles_are_those_of_the_equation(code):
    size = PANEL["uv".index(code.axis)]
    for k in range(code.n_frames(PANEL)):
        phase = fringe_phase(code, k, np.arange(size), size)
        # Phases of a few hundred radians in double precision.
        np.testing.assert_allclose(code.profile(k, size), 0.5 + 0.5 * np.cos(phase), atol=1e-12)


def test_sines_are_cosines_a_quarter_turn_late():
    columns = np.arange(96)
    sine = 0.5 + 0.5 * np.sin(2 * np.pi * 7 * (columns + 0.5) / 96 - 2 * np.pi / 3)
    np.testing.assert_allclose(Fringes(7, phase_deg=-90.0).profile(1, 96), sine, atol=1e-14)


def test_a_period_is_a_count_where_the_panel_is_known():
    code = Fringes(period_px=10.0)
    assert code.fringe_count((96, 60)) == 9.6
    assert repr(code.fringe_count((120, 60))) == "12"
    assert repr(Fringes(28.0)) == "Fringes(count=28, shifts=3, axis='u')"
    np.testing.assert_array_equal(code.profile(1, 96), Fringes(9.6).profile(1, 96))


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_sets_in_any_order_are_decoded(data):
    sets = [data.draw(fringe_sets(2.0, 20.0, "u")) for _ in range(2)]
    base = data.draw(st.sampled_from([Fringes(1, 4), GrayCode("u")]))
    parts = data.draw(st.permutations([*sets, base, Flat(1.0)]))
    sequence = PatternSequence(PANEL, tuple(parts))
    truth = {"u": np.random.default_rng(0).uniform(5.0, 90.0, (4, 60))}
    if isinstance(base, GrayCode):  # clear of edges between columns, where a column is a coin toss
        truth["u"] = np.rint(truth["u"]) + 0.4 * np.sin(truth["u"])
    found = decode(photograph(sequence, truth), sequence, noise=ROUNDLESS, max_order_residual=0.5)
    # Two counts that are nearly whole multiples of a turn apart are no trouble without noise.
    assert found.mask.all()
    np.testing.assert_allclose(found.coordinate["u"], truth["u"], atol=1e-6)
    np.testing.assert_allclose(found.modulation, 100, rtol=1e-6)
    np.testing.assert_allclose(found.mean, 120, rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(code=fringe_sets(1.0, 9.0, "u"))
def test_relative_phase_begins_at_the_edge_however_it_was_shown(code):
    columns = np.linspace(0.0, 95.0, 50)[np.newaxis]
    sequence = PatternSequence(PANEL, (code,))
    phase, modulation, mean = code.relative_phase(photograph(sequence, {"u": columns}), PANEL)
    exact = 2 * np.pi * code.fringe_count(PANEL) * (columns + 0.5) / 96
    # Double precision, times what lists with phases close together amplify.
    np.testing.assert_allclose(np.exp(1j * phase), np.exp(1j * exact), atol=1e-9)
    np.testing.assert_allclose(modulation, 100, atol=1e-7)
    np.testing.assert_allclose(mean, 120, atol=1e-7)
    assert np.all((phase >= 0) & (phase < 2 * np.pi))


def test_relative_phase_is_the_least_squares_fit():
    rng = np.random.default_rng(3)
    steps = np.radians([0.0, 80.0, 95.0, 200.0, 290.0])
    frames = rng.uniform(0, 255, (5, 8, 9))
    phase, modulation, mean = relative_phase(frames, steps)
    design = np.stack([np.ones(5), np.cos(steps), np.sin(steps)], axis=1)
    fit = np.linalg.lstsq(design, frames.reshape(5, -1), rcond=None)[0].reshape(3, 8, 9)
    np.testing.assert_allclose(mean, fit[0], rtol=1e-10)
    np.testing.assert_allclose(modulation * np.exp(1j * phase), fit[1] + 1j * fit[2], rtol=1e-9)


# The deviation of n Gaussian numbers scatters by 1/sqrt(2 n): with n = 40,000 a 3 % bound is 8.5
# standard deviations.  The seed is fixed.
@pytest.mark.parametrize(
    "code",
    [
        Fringes(10, shifts_deg=(0.0, 90.0, 180.0)),
        Fringes(10, shifts_deg=(0.0, 40.0, 100.0, 310.0, 320.0), direction=-1),
        Fringes(10, 3, phase_deg=70.0, origin="centre"),
        Fringes(10, 5, direction=-1, phase_deg=20.0),
    ],
)
@pytest.mark.parametrize("column", [100.0, 107.3, 112.0])
def test_noise_is_predicted_for_any_list_of_shifts(code, column):
    n = 40_000
    noise = NoiseModel(read_dn=0.3, gain_dn_per_e=0.05, offset_dn=15.0, step_dn=0.0)
    sequence = PatternSequence((400, 300), (Fringes(1, 8), code))
    clean = photograph(sequence, {"u": np.full((200, 200), column)})
    rng = np.random.default_rng(5)
    frames = clean + rng.standard_normal(clean.shape) * np.sqrt(noise.variance(clean))
    found = decode(frames, sequence, noise=noise)
    error = found.coordinate["u"] - column
    # The prediction uses the measured a, b and phase, each noisy by about 1 %.
    assert np.std(error) == pytest.approx(np.median(found.sigma["u"]), rel=0.03)
    assert np.mean(error) == pytest.approx(0.0, abs=5 * np.std(error) / np.sqrt(n))


# Written and read.


@settings(max_examples=100, deadline=None)
@given(sets=st.lists(fringe_sets(), min_size=1, max_size=4), way=st.sampled_from(["auto", "none"]))
def test_tables_are_read_back(sets, way):
    sequence = PatternSequence(PANEL, tuple(sets), way, 0.25)
    assert PatternSequence.from_dict(sequence.to_dict()) == sequence


@settings(max_examples=100, deadline=None)
@given(sets=st.lists(fringe_sets(axes="u"), min_size=1, max_size=4))
def test_short_text_is_read_back_where_it_has_words(sets):
    plain = [
        Fringes(code.count, code.shifts, "u", code.period_px, code.shifts_deg) for code in sets
    ]
    sequence = PatternSequence(PANEL, tuple(plain))
    assert PatternSequence.parse(sequence.name, PANEL) == sequence


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("28.8@4", Fringes(28.8, 4)),
        ("22.5px", Fringes(period_px=22.5)),
        ("12@0/90/180", Fringes(12, shifts_deg=(0, 90, 180))),
        ("12px@-45.5/90/180/270", Fringes(period_px=12, shifts_deg=(-45.5, 90, 180, 270))),
    ],
)
def test_words(text, code):
    (found,) = PatternSequence.parse(text, PANEL).parts
    assert found == code
    assert PatternSequence(PANEL, (code,)).name == text


def test_what_has_no_word_is_shown():
    code = Fringes(12, 4, direction=-1, phase_deg=-90, origin="centre")
    shown = PatternSequence(PANEL, (Fringes(1, 4), code)).name
    assert shown == "1,12@4(phase -90 direction -1 origin centre)"


def test_what_is_usual_stays_as_it_was_written():
    table = {"kind": "fringes", "count": 10, "shifts": 4, "axis": "u"}
    data = {"panel": [96, 60], "parts": [table]}
    assert PatternSequence.from_dict(data).to_dict() == data


@pytest.mark.parametrize(
    ("table", "where", "expected"),
    [
        ({}, "parts[0].count", "count or period_px"),
        ({"count": 3, "period_px": 12.0}, "parts[0].period_px", "count or period_px"),
        ({"count": 3, "shifts": 4, "shifts_deg": [0, 90, 180]}, "shifts_deg", "shifts or shifts_"),
        ({"count": 3, "shifts_deg": [0, 90, 360, 450]}, "shifts_deg", "3 distinct phases"),
        ({"count": 3, "shifts_deg": [0, 90]}, "shifts_deg", "at least 3"),
        ({"count": 3, "direction": 0}, "parts[0].direction", "1 or -1"),
        ({"count": 3, "origin": "center"}, "parts[0].origin", "edge or centre"),
        ({"count": 32.5}, "parts[0].count", "at most 32 fringes on 96"),
        ({"period_px": 2.5}, "parts[0].period_px", "at most 32 fringes on 96"),
        ({"count": float("inf")}, "parts[0].count", "number"),
    ],
)
def test_bad_tables(table, where, expected):
    with pytest.raises(InputError) as caught:
        PatternSequence.from_dict({"panel": [96, 60], "parts": [{"kind": "fringes"} | table]})
    assert where in caught.value.where
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["1,1.5.2", "12pxx", "12@0/90", "12@0/", "12@/90/180", "px@4"])
def test_bad_words(text):
    with pytest.raises(InputError):
        PatternSequence.parse(text, PANEL)


# What a sinusoid leaves of the frames.


@pytest.mark.parametrize(
    "code", [Fringes(10, 4), Fringes(10, 9), Fringes(10, shifts_deg=(0, 50, 90, 200, 200, 300))]
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_fit_residual_is_that_of_least_squares(code, dtype):
    sequence = PatternSequence((400, 300), (Fringes(1), code))
    rng = np.random.default_rng(8)
    clean = photograph(sequence, {"u": rng.uniform(20, 380, (30, 41))})
    frames = np.rint(clean + rng.normal(0, 3, clean.shape)).clip(0, 255).astype(dtype)
    evidence = decode(frames, sequence, keep_evidence=True).evidence
    assert "fit_residual_dn" not in evidence.get(0, {})  # three frames are fitted exactly
    own = frames[3:].reshape(len(frames) - 3, -1).astype(float)
    steps = code.steps(400)
    design = np.stack([np.ones(len(steps)), np.cos(steps), np.sin(steps)], axis=1)
    left = own - design @ np.linalg.lstsq(design, own, rcond=None)[0]
    exact = np.sqrt((left**2).sum(axis=0) / (len(steps) - 3)).reshape(30, 41)
    # float32
    np.testing.assert_allclose(evidence[1]["fit_residual_dn"], exact, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shifts", [4, 5, 8])
def test_fit_residual_measures_the_noise(shifts):
    n, sigma = 40_000, 2.5
    sequence = PatternSequence((400, 300), (Fringes(1, shifts), Fringes(10, shifts)))
    clean = photograph(sequence, {"u": np.full((200, 200), 111.3)})
    frames = clean + np.random.default_rng(9).normal(0, sigma, clean.shape)
    for evidence in decode(frames, sequence, keep_evidence=True).evidence.values():
        measured = np.sqrt(np.mean(np.square(evidence["fit_residual_dn"], dtype=float)))
        # A mean of n squares with N - 3 degrees of freedom each: 5 standard errors of its root.
        assert measured == pytest.approx(sigma, rel=5 / np.sqrt(2 * n * (shifts - 3)))


def test_fit_residual_sees_a_response_that_is_not_linear():
    sequence = PatternSequence((400, 300), (Fringes(1, 8), Fringes(10, 8)))
    clean = photograph(sequence, {"u": np.linspace(30, 370, 300)[np.newaxis]})
    bent = 255 * (clean / 255) ** 2.2
    evidence = decode(bent, sequence, keep_evidence=True).evidence
    straight = decode(clean, sequence, keep_evidence=True).evidence
    assert straight[1]["fit_residual_dn"].max() < 1e-4
    assert evidence[1]["fit_residual_dn"].min() > 5.0
