"""Hostile input, a row a kind: no traceback, one line, no hang, nothing of others touched."""

import fuzz
import pytest
from rows import ROWS

#: Cases of a row of weight 1: quick, in all tiers, and in the thorough one.
FEW, MANY, PROCESSES = 3, 200, 6


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Good input of each row, made when it is needed."""
    made = {}

    def of(row):
        if row.name not in made:
            folder = tmp_path_factory.mktemp("row")
            row.prepare(folder)
            if row.name != "command line":
                fuzz.check_good(row, folder)
            made[row.name] = folder
        return made[row.name]

    return of


def check(row, folder, numbers, **options):
    found = [
        f"{row.name} {number}: {'; '.join(faults)}: {outcome.err[:300]} {case.arguments}"
        for number, case, outcome, faults in fuzz.trial(row, folder, numbers, **options)
        if faults
    ]
    assert not found, "\n".join(found)


#: Rows whose good input is dear to make, or a case dear to run, are left to the thorough tier.
QUICK = [row for row in ROWS if row.weight >= 0.5 and not row.name.startswith("data set")]


@pytest.mark.parametrize("row", QUICK, ids=lambda row: row.name)
def test_a_few_of_each_kind(row, folders):
    check(row, folders(row), range(FEW))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_many_of_each_kind(row, folders):
    check(row, folders(row), range(max(1, round(MANY * row.weight))), seed=1)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("row", [row for row in ROWS if row.call is None], ids=lambda row: row.name)
def test_some_as_processes(row, folders):
    check(row, folders(row), range(max(1, round(PROCESSES * row.weight))), seed=2, process=True)
