"""Every number that README.md states stands in a claim, or is none that could be measured.

Numbers are digits and words for them, in prose and tables.  Code blocks, inline code and the
targets of links are commands and names, not statements.
"""

import re
from pathlib import Path

import pytest

from slbench.bench.claims.file import load_claims

ROOT = Path(__file__).resolve().parents[3]

#: Words of the README with numbers that claim nothing measured, and why.
NOT_CLAIMS = {
    "Mitsuba 3": "the name of a library",
    "Python 3.11": "a requirement",
    "about half a minute; later ones": "compiling, before any claim could be measured",
    "HDF5": "the name of a file format",
    "the 3D Surface Profiling of": "a title",
    "Thousands of scans": "a use, not a measurement",
    "takes twenty minutes": "the time of a reader",
    "At 640 x 480 with 16 samples a pixel": "the setting of the claims that follow",
    "one of them with 64": "the yardstick of the claims",
}

NUMBER = re.compile(
    r"\d[\d.,]*\d|\d"
    r"|\b(?:half|third|quarter|tenth|hundredth|thousandth|millionth|twice|double|dozen"
    r"|two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|\w+teen|twenty|thirty|forty"
    r"|fifty|sixty|seventy|eighty|ninety|hundred|thousand|million|percent)s?\b",
    re.IGNORECASE,
)
#: What is not prose: fenced and indented code, inline code, pictures, targets of links, tags.
NOT_PROSE = (
    re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE),
    re.compile(r"(?:\A|(?<=\n\n))(?: {4}.*(?:\n+|\Z))+"),
    re.compile(r"`[^`]*`"),
    re.compile(r"!\[[^\]]*\]\([^)]*\)"),
    re.compile(r"(?<=\])\([^)]*\)"),
    re.compile(r"<[^>\n]*>|https?://\S+"),
)


def one_line(text):
    return " ".join(text.split())


def prose(markdown):
    """The text without code, targets of links and pictures, on one line."""
    for pattern in NOT_PROSE:
        markdown = pattern.sub(" ", markdown)
    return one_line(markdown)


def stray_numbers(text, phrases):
    """Numbers of a text that are not within one of the phrases, each with what is around it."""
    covered = [
        match.span()
        for phrase in phrases
        for match in re.finditer(re.escape(one_line(phrase)), text)
    ]
    return [
        text[max(match.start() - 30, 0) : match.end() + 30]
        for match in NUMBER.finditer(text)
        if not any(start <= match.start() and match.end() <= end for start, end in covered)
    ]


@pytest.fixture(scope="module")
def readme():
    return prose((ROOT / "README.md").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def claims():
    return load_claims(ROOT / "tests" / "claims" / "readme.claims.toml")


def test_what_counts_as_a_number():
    text = (
        "Costs 1.3 renders, a thousandth, 4x less, 2,048 px in [32 ways](docs/7.md).\n\n"
        "    run --seed 5\n\n```\n6\n```\n\n| `9` | 12 % |\n|---|---|\n"
    )
    found = [match[0] for match in NUMBER.finditer(prose(text))]
    assert found == ["1.3", "thousandth", "4", "2,048", "32", "12"]
    stray = stray_numbers(prose(text), ["Costs 1.3\nrenders", "32 ways", "12 %", "2,048"])
    assert [("thousandth" in line, "4x" in line) for line in stray] == [(True, True)] * 2


def test_every_claim_of_the_readme_quotes_it(readme, claims):
    for claim in claims:
        assert claim.readme is not None, claim.name
        assert NUMBER.search(claim.readme), claim.readme
        assert one_line(claim.readme) in readme, claim.name


def test_every_number_of_the_readme_is_claimed(readme, claims):
    phrases = [claim.readme for claim in claims] + list(NOT_CLAIMS)
    assert stray_numbers(readme, phrases) == []


def test_no_exception_is_left_over(readme):
    assert [words for words in NOT_CLAIMS if words not in readme] == []
