"""``slbench scene list``."""

from __future__ import annotations

from slbench.cli.lazy import command


@command("slbench scene list", name="list")
def list_scenes() -> None:
    """List the shipped scenes."""
    from slbench.core import resources
    from slbench.core.io import read_toml

    for name in resources.names("scenes"):
        content = read_toml(resources.find("scenes", name))
        print(f"{name:20} {content.get('description', '')}")
