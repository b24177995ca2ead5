"""``slbench patterns``: what can be projected."""

from slbench.cli.lazy import Group

group = Group(
    "patterns",
    "Pattern sets, and their pictures for a projector.",
    {
        "Commands": {
            "list": "slbench.cli.patterns.list:list_patterns",
            "show": "slbench.cli.patterns.show:show",
            "write": "slbench.cli.patterns.write:write",
        }
    },
)
