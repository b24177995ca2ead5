"""``slbench design``: design of rigs, pattern sequences and views."""

from slbench.cli.lazy import Group

group = Group(
    "design",
    "Design rigs, pattern sequences and views.",
    {
        "Rigs": {
            "rig": "slbench.cli.design.rig:rig",
            "evaluate": "slbench.cli.design.evaluate:evaluate",
            "verify": "slbench.cli.design.verify:verify",
        },
        "Views": {"views": "slbench.cli.design.views:views"},
        "Patterns": {
            "patterns": "slbench.cli.design.patterns:patterns",
            "adaptive": "slbench.cli.design.adaptive:adaptive",
            "noise": "slbench.cli.design.noise:noise",
        },
    },
)
