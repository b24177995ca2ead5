"""``slbench scene``: shipped scenes and hardware, new scenes, and pictures of any scene."""

from slbench.cli.lazy import Group

group = Group(
    "scene",
    "Shipped scenes, new ones, and pictures of any scene.",
    {
        "Commands": {
            "list": "slbench.cli.scene.list:list_scenes",
            "new": "slbench.cli.scene.new:new",
            "copy": "slbench.cli.scene.copy:copy",
            "show": "slbench.cli.scene.show:show",
        }
    },
)
