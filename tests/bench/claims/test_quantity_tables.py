"""Names of quantities in tables of a terminal: brackets are no markup."""

from slbench.cli.common import print_table
from slbench.core.show.document import Table


def test_a_quantity_in_a_title_and_in_cells_is_shown_whole(capsys):
    name = "dimension[pin height].error_mm"
    print_table(Table(f"Budget of {name}", ("quantity", "value"), ((name, 1.0),)))
    assert capsys.readouterr().out.count(name) == 2
