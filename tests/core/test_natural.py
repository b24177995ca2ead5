"""Names sorted as people count them."""

from hypothesis import given
from hypothesis import strategies as st

from slbench.core.natural import natural


def test_numbers_count_by_value():
    names = ["b10.png", "b9.png", "B8.png", "a", "a1", "a01", "1", "frame"]
    expected = ["1", "a", "a01", "a1", "B8.png", "b9.png", "b10.png", "frame"]
    assert sorted(names, key=natural) == expected


@given(st.lists(st.text(alphabet="aB01²٣. ", max_size=6)))
def test_any_names_have_an_order_that_does_not_depend_on_their_first(names):
    assert sorted(names, key=natural) == sorted(sorted(names), key=natural)
