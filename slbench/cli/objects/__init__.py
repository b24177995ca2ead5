"""``slbench objects``: artefacts with certified dimensions."""

from slbench.cli.lazy import Group

group = Group(
    "objects",
    "Artefacts with certified dimensions.",
    {
        "Commands": {
            "list": "slbench.cli.objects.list:list_objects",
            "build": "slbench.cli.objects.build:build",
            "show": "slbench.cli.objects.show:show",
        }
    },
)
