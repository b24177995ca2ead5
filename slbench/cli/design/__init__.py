"""``slbench design``: design of rigs and pattern sequences."""

from slbench.cli.lazy import Group

group = Group(
    "design",
    "Design rigs and pattern sequences.",
    {
        "Rigs": {
            "rig": "slbench.cli.design.rig:rig",
            "evaluate": "slbench.cli.design.evaluate:evaluate",
            "verify": "slbench.cli.design.verify:verify",
        },
        "Patterns": {
            "patterns": "slbench.cli.design.patterns:patterns",
            "noise": "slbench.cli.design.noise:noise",
        },
    },
)
