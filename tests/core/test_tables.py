"""CSV files of numbers: what people and spreadsheets write, and what they get wrong."""

import csv

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.core.io import read_table, write_table

COLUMNS = ("n", "z_mm")


@pytest.fixture
def table(tmp_path):
    """Write a text or bytes to a file and read it as a table."""

    def read(content, columns=COLUMNS, **options):
        path = tmp_path / "table.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_table(path, columns, **options)

    return read


def test_file_and_back(tmp_path):
    path = tmp_path / "new" / "table.csv"
    values = np.random.default_rng(1).normal(size=(20, 3)) * [1e-20, 1.0, 1e8]
    write_table(path, ("a", "b", "c"), values)
    # Nine digits: half a unit of the ninth.
    np.testing.assert_allclose(read_table(path, ("a", "b", "c")), values, rtol=5e-9)
    with path.open(newline="") as stream:
        assert next(csv.reader(stream)) == ["a", "b", "c"]
    assert [entry.name for entry in path.parent.iterdir()] == ["table.csv"]  # nothing beside it


def test_what_is_written_is_plain(tmp_path):
    path = tmp_path / "table.csv"
    write_table(path, ("name", "n", "x"), [("a,b", 3, 0.1 + 0.2), ('say "c"', np.int64(4), np.inf)])
    assert path.read_bytes() == b'name,n,x\n"a,b",3,0.3\n"say ""c""",4,inf\n'


def test_whatever_the_order_of_the_columns(table):
    found = table("z_mm, n\n0.5,1\n-2e-1, 3 \n")
    np.testing.assert_array_equal(found, [[1.0, 0.5], [3.0, -0.2]])
    assert found.dtype == np.float64


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbfn,z_mm\r\n1,2\r\n3,4\r\n",  # as spreadsheets save it
        b"n,z_mm\n\n1,2\n\n   \n,\n3,4\n\n",  # empty lines, and empty cells only
        b'"n","z_mm"\n"1","2"\n3,4',  # quoted, no end of the last line
        b"n,z_mm\r1,2\r3,4",
    ],
)
def test_what_does_not_matter(table, content):
    np.testing.assert_array_equal(table(content), [[1.0, 2.0], [3.0, 4.0]])


def test_not_finite_only_where_it_may_be(table):
    found = table("n,z_mm\n1,inf\nnan,-inf\n", finite=False)
    np.testing.assert_array_equal(found, [[1.0, np.inf], [np.nan, -np.inf]])
    for cell in ("inf", "nan", "-inf", "1e999"):
        with pytest.raises(InputError, match=r"line 3: expected 2 finite numbers, got 1,"):
            table(f"n,z_mm\n1,2\n1,{cell}\n")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("n,z_mm\n1,2\n\n3\n", "line 4: expected 2 finite numbers, got 3$"),
        ("n,z_mm\n1,2,3\n", "line 2: expected 2 finite numbers, got 1,2,3$"),
        ("n,z_mm\n1,2\n3,four\n", "line 3: expected 2 finite numbers, got 3,four$"),
        ("n,z_mm\n1,\n", "line 2: expected 2 finite numbers, got 1,$"),
        ("n;z_mm\n1;2\n", "line 1: expected the header n,z_mm, got n;z_mm$"),
        ("n\n1\n", "line 1: expected the header n,z_mm, got n$"),
        ("n,z_mm,extra\n1,2,3\n", "line 1: expected the header n,z_mm, got n,z_mm,extra$"),
        ("n,n\n1,2\n", "line 1: expected the header n,z_mm, got n,n$"),
        ("1,2\n3,4\n", "line 1: expected the header n,z_mm, got 1,2$"),
        ("", "line 1: expected the header n,z_mm, got none$"),
        ("n,z_mm\n", "expected at least one row below the header, got none$"),
        ("n,z_mm\n\n , \n", "expected at least one row below the header, got none$"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "a CSV file in UTF-8, got byte 0x89 in line 1"),
        ("n,z_mm\n1,2\x00\n", "line 2: expected 2 finite numbers"),
        # A line that ends inside a quoted cell is no digit between two others.
        ('n,z_mm\n1,"2\n3"\n', "expected 2 finite numbers, got 1,2 3$"),
        # A quote that is never closed makes one cell of all the rest.
        ('n,z_mm\n1,"2\n' + "3,4\n" * 50_000, "expected"),
    ],
)
def test_refuses_in_one_short_line(table, content, message):
    with pytest.raises(InputError, match=message) as error:
        table(content)
    assert "table.csv" in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_refuses_what_is_no_file(tmp_path):
    with pytest.raises(
        InputError, match=r"^[^ :]*none\.csv: expected a file, got nothing of that name$"
    ):
        read_table(tmp_path / "none.csv", COLUMNS)
    with pytest.raises(InputError, match=r"expected a file, got a folder$"):
        read_table(tmp_path, COLUMNS)
