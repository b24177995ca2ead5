"""``slbench scene``: shipped scenes, and pictures of any scene."""

from slbench.cli.lazy import Group

group = Group(
    "scene",
    "Shipped scenes, and pictures of any scene.",
    {
        "Commands": {
            "list": "slbench.cli.scene.list:list_scenes",
            "show": "slbench.cli.scene.show:show",
        }
    },
)
