"""``slbench rig``: files of rigs, ours and those of other programs."""

from slbench.cli.lazy import Group

group = Group(
    "rig",
    "Files of rigs: show them, convert those of other programs.",
    {
        "Commands": {
            "show": "slbench.cli.rig.show:show",
            "convert": "slbench.cli.rig.convert:convert",
        }
    },
)
