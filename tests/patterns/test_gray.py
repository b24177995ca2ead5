"""Gray and binary codes of any cells, thresholds and bits; and of pixels that do not decide all."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from photographed import photograph

from slbench.core.errors import InputError
from slbench.patterns import Flat, Fringes, GrayCode, PatternSequence, decode

COLUMNS = np.arange(96.0)[np.newaxis]


def seen(*parts, panel=(96, 4), columns=COLUMNS, change=lambda frames: frames, **options):
    sequence = PatternSequence(panel, parts)
    frames = change(np.round(photograph(sequence, {"u": columns})))
    return decode(frames.astype(np.uint8), sequence, **options)


def check(result, expected, sigma):
    np.testing.assert_allclose(result.coordinate["u"], expected, atol=1e-9)
    np.testing.assert_allclose(result.sigma["u"], sigma, rtol=1e-12)


codes = st.builds(
    GrayCode,
    axis=st.sampled_from("uv"),
    inverse=st.booleans(),
    code=st.sampled_from(["reflected", "binary"]),
    cell_px=st.sampled_from([1.0, 1.5, 2.0, 3.7, 12.0]),
    offset_px=st.sampled_from([0.0, 0.5, 3.0, 16.0]),
    threshold=st.sampled_from([None, "flats", "range", 120.0]),
    complementary=st.booleans(),
)


@settings(max_examples=60, deadline=None)
@given(code=codes, width=st.integers(40, 300), more=st.integers(0, 2), data=st.data())
def test_any_code_gives_the_middle_of_the_cell(code, width, more, data):
    panel = (width, width)
    if data.draw(st.booleans()) and not code.complementary:
        code = GrayCode(**(code.to_table(None) | {"shifted": True}))
    if more:
        own = GrayCode(**(code.to_table(None) | {"complementary": False, "shifted": False}))
        code = GrayCode(**(code.to_table(None) | {"bits": own.n_bits(width) + more}))
    sequence = PatternSequence(panel, (Flat(1.0), Flat(0.0), code))
    assert PatternSequence.from_dict(sequence.to_dict()) == sequence
    columns = np.arange(width, dtype=float)[np.newaxis]
    result = decode(photograph(sequence, {code.axis: columns}), sequence)
    cell = code.cell_px / (2.0 if code.divides else 1.0)
    number = np.floor((columns + 0.5 + code.offset_px) / cell)
    begins = np.maximum(number * cell - code.offset_px, 0.0)
    ends = np.minimum((number + 1.0) * cell - code.offset_px, width)
    decided = result.mask
    # The darkest and brightest frames of a cell that never changes are one: it has no threshold.
    assert decided.all() or code.threshold == "range"
    expected = np.where(decided, 0.5 * (begins + ends) - 0.5, np.nan)
    np.testing.assert_allclose(result.coordinate[code.axis], expected, atol=1e-9)
    np.testing.assert_allclose(result.sigma[code.axis][decided], cell / np.sqrt(12))


def test_bits_that_the_lens_does_not_resolve_are_left_out():
    def blurred(frames):
        frames[10:] = 120.0  # both frames of the two finest of seven bits
        return frames

    check(seen(GrayCode(), change=blurred), 4.0 * np.floor(COLUMNS / 4) + 1.5, 4 / np.sqrt(12))
    forced = seen(GrayCode(use_bits=5))
    check(forced, 4.0 * np.floor(COLUMNS / 4) + 1.5, 4 / np.sqrt(12))
    assert not seen(GrayCode(use_bits=7), change=blurred).mask.any()


def test_no_place_is_made_of_a_few_coarse_bits():
    def blurred(frames):
        frames[6:] = 120.0  # four of seven bits
        return frames

    assert not seen(GrayCode(), change=blurred).mask.any()


@pytest.mark.parametrize("inverse", [True, False])
def test_a_pixel_on_an_edge_sees_the_edge(inverse):
    """One bit is half lit there; everywhere else that would be no code."""
    code = GrayCode(inverse=inverse, cell_px=12.0)
    sequence = PatternSequence((96, 4), (Flat(1.0), Flat(0.0), code))
    middles = np.arange(8) * 12.0 + 5.5
    frames = photograph(sequence, {"u": middles[np.newaxis]})
    edges = 0.5 * (frames[:, :, :-1] + frames[:, :, 1:])
    result = decode(edges, sequence)
    # The edge of the finest bit is as well the middle of a pair that it does not tell apart.
    check(result, np.arange(1, 8)[np.newaxis] * 12.0 - 0.5, [[24, 12] * 3 + [24]] / np.sqrt(12))

    # The first bit of cell 1 (001) has its edge between cells 3 and 4: nothing is left.
    odd = frames[:, :, 1:2].copy()
    odd[2 : 4 if inverse else 3] = 120.0
    assert not decode(odd, sequence).mask.any()


def test_the_second_bit_away_from_its_edge_leaves_the_first():
    code = GrayCode(cell_px=12.0)
    sequence = PatternSequence((96, 4), (code,))
    frames = photograph(sequence, {"u": np.array([[41.5]])})  # cell 3: 010
    frames[2:4] = 120.0
    # Cells 0 to 3 have the first bit in common.
    check(decode(frames, sequence), 23.5, 48 / np.sqrt(12))


def test_a_saturated_lit_bit_beside_a_dark_inverse_is_decided():
    def bright(frames):
        return np.where(frames > 120.0, 255.0, 28.0)

    check(seen(GrayCode(), change=bright), COLUMNS, 1 / np.sqrt(12))

    def clipped(frames):  # the Gray code alone: fringes reach 200
        frames[:14] = bright(frames[:14])
        frames[14:] = 110.0 + (frames[14:] - 120.0) * 0.9
        return frames

    result = seen(GrayCode(), Fringes(8, 4), change=clipped)
    assert result.mask.all()
    np.testing.assert_allclose(result.coordinate["u"], COLUMNS, atol=0.02)  # of 8 bits


def test_both_frames_saturated_decide_nothing():
    def bright(frames):
        frames[2:4] = 255.0
        return frames

    assert not seen(GrayCode(), change=bright).mask.all()


def test_a_white_frame_that_nothing_is_decoded_from_may_saturate():
    def over(frames):
        frames[0] = 255.0
        return frames

    assert seen(Flat(1.0), Fringes(1, 4), Fringes(8, 4), change=over).mask[:, 4:-4].all()
    assert seen(Flat(1.0), GrayCode(), change=over).mask.all()


def test_orders_of_fringes_are_resolved_by_cells_of_one_fringe():
    code = GrayCode(inverse=False, cell_px=12.0, bits=3)
    result = seen(Flat(1.0), Flat(0.0), code, Fringes(8, 4))
    assert result.mask.all()
    np.testing.assert_allclose(result.coordinate["u"], COLUMNS, atol=0.02)


@pytest.mark.parametrize("key", ["complementary", "shifted"])
@pytest.mark.parametrize("code", ["reflected", "binary"])
def test_half_cells_resolve_fringes_that_do_not_begin_with_a_cell(key, code):
    """Cells off by a bit, as by a lens or by noise, do not matter where half a cell is known."""
    cells = {"inverse": False, "cell_px": 12.0, "bits": 4, "code": code, "offset_px": 2.0}
    parts = Flat(1.0), Flat(0.0), Fringes(8, 4)
    told = PatternSequence((96, 4), (*parts, GrayCode(**cells, **{key: True})))
    shown = PatternSequence(
        (96, 4), (*parts, GrayCode(**cells | {"offset_px": 4.0}, **{key: True}))
    )
    result = decode(photograph(shown, {"u": COLUMNS}), told)
    assert result.mask.all()
    np.testing.assert_allclose(result.coordinate["u"], COLUMNS, atol=1e-9)
    whole = [
        PatternSequence((96, 4), (*parts, GrayCode(**cells | {"offset_px": offset})))
        for offset in (4.0, 2.0)
    ]
    alone = decode(photograph(whole[0], {"u": COLUMNS}), whole[1])
    assert not np.allclose(np.nan_to_num(alone.coordinate["u"]), COLUMNS, atol=1.0)


@pytest.mark.parametrize("spare", [False, True])
def test_fringes_write_over_a_coarser_place_that_is_spare(spare, monkeypatch):
    sequence = PatternSequence.parse("gray+16@4", (128, 8))
    frames = photograph(sequence, {"u": np.tile(np.linspace(0.0, 127.0, 300), (4, 1))})
    expected = decode(frames, sequence, keep_evidence=True)  # which needs the coarser place
    run, seen = GrayCode.decode_run.__func__, []

    def decoded(cls, *given):
        (one,) = run(cls, *given).values()
        seen.append((one.coordinate, one.coordinate.copy(), one.sigma, one.sigma.copy()))
        return {"u": replace(one, spare=one.spare and spare)}

    monkeypatch.setattr(GrayCode, "decode_run", classmethod(decoded))
    found = decode(frames, sequence)
    np.testing.assert_array_equal(found.coordinate["u"], expected.coordinate["u"])
    np.testing.assert_array_equal(found.sigma["u"], expected.sigma["u"])
    ((place, place_before, sigma, sigma_before),) = seen
    assert np.array_equal(place, place_before, equal_nan=True) is not spare
    assert np.array_equal(sigma, sigma_before) is not spare
    assert np.shares_memory(found.coordinate["u"], place) is spare


def test_the_mean_of_the_fringes_is_a_threshold():
    code = GrayCode(inverse=False, threshold="mean")
    result = seen(code, Fringes(8, 4))
    assert result.mask.all()
    np.testing.assert_allclose(result.coordinate["u"], COLUMNS, atol=0.02)
    with pytest.raises(InputError, match="fringe frames that are even on the whole, for threshold"):
        seen(code)


def test_a_threshold_that_is_a_number():
    check(seen(GrayCode(inverse=False, threshold=120.0)), COLUMNS, 1 / np.sqrt(12))
    assert not seen(GrayCode(inverse=False, threshold=220.0)).mask.all()


def test_frames_that_are_no_numbers_decide_nothing():
    sequence = PatternSequence((96, 4), (GrayCode(),))
    frames = photograph(sequence, {"u": COLUMNS})
    frames[0, 0, 10] = np.nan
    frames[13, 0, 20] = np.nan
    result = decode(frames, sequence)
    assert not result.mask[0, 10]
    # The finest bit of column 20 is left out.
    assert result.coordinate["u"][0, 20] == 20.5
    assert result.mask.sum() == 95


@pytest.mark.parametrize(
    ("keys", "word"),
    [
        ({"bits": 3}, "bits: expected at least 7, for 96 px in cells of 1"),
        ({"bits": 21}, "bits"),
        ({"cell_px": 0.5}, "cell_px"),
        ({"cell_px": 96.0}, "cell_px: expected less than the panel's 96 px"),
        ({"offset_px": -1.0}, "offset_px"),
        ({"threshold": "white"}, "threshold"),
        ({"inverse": False, "threshold": "inverse"}, "threshold"),
        ({"complementary": True, "shifted": True}, "shifted: expected complementary or shifted"),
        ({"use_bits": 8}, "use_bits: expected at most 7"),
        ({"use_bits": "all"}, "use_bits"),
        ({"code": "grey"}, "code"),
    ],
)
def test_refused(keys, word):
    with pytest.raises(InputError, match=word):
        PatternSequence((96, 4), (GrayCode(**keys),))
