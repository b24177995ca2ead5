"""Names of quantities in tables of a terminal: brackets are no markup."""

from slbench.cli.common import print_table
from slbench.core.show.document import Table


def test_a_quantity_in_a_title_and_in_cells_is_shown_whole(capsys):
    name = "dimension[pin height].error_mm"
    print_table(Table(f"Budget of {name}", ("quantity", "value"), ((name, 1.0),)))
    assert capsys.readouterr().out.count(name) == 2


def test_a_narrow_terminal_breaks_no_word_of_a_name(capsys, monkeypatch):
    """Names give way between words, and headings before them."""
    monkeypatch.setenv("COLUMNS", "80")
    columns = ("test", "places", "worst", "error / µm", "u / µm", "limit / µm", "verdict")
    rows = (("probing dispersion", "10", "ball bar 10", 51.74, 3.916, None, "undecided"),)
    print_table(Table("Acceptance", columns, rows), left=2)
    shown = capsys.readouterr().out
    assert "dispersion " in shown
    assert max(map(len, shown.splitlines())) <= 80
