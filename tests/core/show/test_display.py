"""Texts of values: short whatever is in them."""

import doctest
from dataclasses import make_dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from slbench.core.show import display
from slbench.core.show.display import block, brief, length, numbers, share

#: What a field may hold: long texts, many items, arrays with and without numbers, other values.
FIELDS = st.recursive(
    st.one_of(
        st.none(),
        st.text(max_size=500),
        st.floats(),
        st.integers(),
        st.binary(max_size=200),
        arrays.arrays(st.sampled_from([float, int, bool]), arrays.array_shapes(max_side=5)),
        st.just(type("Long", (), {"__repr__": lambda self: "<Long\n" + 300 * "x" + "\ny>"})()),
    ),
    lambda one: st.one_of(
        st.lists(one, max_size=20),
        st.tuples(one, one),
        st.dictionaries(st.text(max_size=99), one),
    ),
    max_leaves=20,
)


@given(st.lists(FIELDS, min_size=1, max_size=30))
def test_a_brief_text_is_short_whatever_is_in_it(values):
    kind = make_dataclass("Value", [f"a_field_of_some_length_{k}" for k in range(len(values))])
    text = brief(kind(*values))
    assert len(text) <= 600
    assert len(text.splitlines()) <= 8
    assert text.startswith("Value(")


def test_examples():
    found = doctest.testmod(display)
    assert found.attempted >= 4
    assert found.failed == 0


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.array([1.0, -0.0, 2.5]), "[1, 0, 2.5]"),
        (np.full((3, 4), np.nan), "<(3, 4) float64, all NaN>"),
        (np.array([[1, 7], [3, 4]], np.uint8), "<(2, 2) uint8, 1 to 7>"),
        (np.zeros((2, 3), bool), "<(2, 3) bool>"),
        (np.zeros((0, 3)), "<(0, 3) float64>"),
        (0.1 + 0.2, "0.3"),
        ((1, 2), "(1, 2)"),
        (list(range(7)), "<7 items>"),
        ({"a": 1.5}, "{'a': 1.5}"),
    ],
)
def test_fields_of_a_brief_text(value, text):
    assert brief(make_dataclass("Value", ["x"])(value)) == f"Value(x={text})"


def test_blocks_are_indented_one_in_the_other():
    assert block("A", "b", "", block("C", "d")) == "<A\n  b\n  <C\n    d>>"


def test_numbers_have_their_units():
    assert [length(mm) for mm in (0.0, 0.1, 0.0999, -2.0)] == ["0 mm", "0.1 mm", "99.9 µm", "-2 mm"]
    assert share(0.12345) == "12.3 %"
    assert numbers(np.array([[1.23456, -0.0]]), " x ") == "1.235 x 0"
